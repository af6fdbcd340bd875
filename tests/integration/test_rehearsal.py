"""A campaign rehearsed on a twin is what the rig then gets: its tones, their amplitudes and the time it takes."""

import numpy as np
import pytest

from service.gap.proposal.case import limits_of
from service.gap.proposal.rehearsal import BegunCampaign
from service.gap.proposal.sensor_noise import SensorNoise
from sim.reference import reference_rig
from tests.support.campaigns import SHEET, SMALL


def test_the_rehearsal_tells_what_the_rig_gets(whole):
    _, experiment, _ = whole
    main = experiment.named("main")
    noise = SensorNoise.of(main, reference_rig())
    told = BegunCampaign(reference_rig(), limits_of(SHEET), SMALL, noise).whole()
    assert told.rig_seconds == pytest.approx(float(experiment.attributes["rig_seconds"]), rel=0.15)
    assert set(told.points) == {"preliminary", "main", "validation", "amplifier"}
    for name, points in told.points.items():
        measured = experiment.named(name)
        assert len(points) == pytest.approx(measured.n_points, rel=0.1), name  # a peak may need a line more
        ratio = np.median([p.request.amplitude_a for p in points]) / np.median(measured.amplitude_a)
        assert ratio == pytest.approx(1.0, abs=0.25), name
