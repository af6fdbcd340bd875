"""A rig that trips, is noisy or at its limits: measured lower or longer, marked, or left alone."""

from dataclasses import replace

import numpy as np
import pytest

from service.campaign.run import recover
from service.experiment.errors import CampaignError
from service.experiment.file import read
from sim.reference import reference_rig
from tests.support.campaigns import SMALL, Faulty, campaign, plant, relative_error


def test_a_rig_that_trips_easily_is_measured_at_lower_amplitude_and_marked(tmp_path):
    class Fragile(Faulty):
        """Says that it allows 80 um, and trips at one."""

        def capabilities(self):
            return replace(self.inner.capabilities(), displacement_limit_m=80e-6)

    rig = Fragile(lambda k: None, replace(reference_rig(), displacement_limit_m=1.0e-6))
    experiment = campaign(rig, tmp_path, replace(SMALL, points=16, validation_points=2, amplifier_points=2))
    main = experiment.main
    tripped = np.array(["after a displacement trip" in f for f in main.flags])
    assert tripped.any()
    f, _ = plant(main)
    assert len(f) >= 16
    assert np.all(main.amplitude_a > 0)
    assert np.max(np.abs(main.Y[:, :, 1])) < 1.0e-6
    assert rig.status().trip == 0


def test_a_point_that_trips_at_every_amplitude_stays_in_the_sweep(tmp_path):
    class Allergic(Faulty):
        """Trips on every tone of axis 1 between 90 and 130 Hz, as a rig with a loose part might."""

        tripped = False

        def measure(self, tone):
            from drivers.errors import TripError

            if tone.axis == 1 and tone.amplitude_a > 0 and 90 < tone.frequency_hz(10_000) < 130:
                raise TripError("displacement", "displacement of axis xB reached 81 um, over the limit of 80 um")
            return self.inner.measure(tone)

    experiment = campaign(Allergic(None), tmp_path, replace(SMALL, validation_points=2, amplifier_points=2))
    main = experiment.main
    lost = (main.axis == 1) & (main.frequency_hz > 90) & (main.frequency_hz < 130)
    assert lost.any()
    assert np.all(main.amplitude_a[lost] == 0)
    assert all("not measured: displacement trip" in main.flags[k] for k in np.flatnonzero(lost))
    assert np.all(main.amplitude_a[~lost] > 0)
    assert read(tmp_path / "experiment.h5").main.flags == main.flags


def test_a_rig_that_does_not_come_to_rest_is_left_alone(tmp_path):
    from drivers.errors import TripError

    def fault(k):
        if k > 60:
            raise TripError("displacement", "displacement of axis xB reached 300 um, over the limit of 80 um")

    rig = Faulty(fault)
    with pytest.raises(CampaignError, match="did not come to rest"):
        campaign(rig, tmp_path)
    assert rig.n < 70
    assert recover(tmp_path).main.n_points > 4
    # someone has seen to the rig: the campaign goes on, and the point that tripped stays marked
    experiment = campaign(Faulty(lambda k: None), tmp_path)
    assert sum("not measured" in f for s in experiment.sweeps for f in s.flags) == 1


def test_a_fault_of_the_rig_is_left_latched_and_nothing_more_is_excited(tmp_path):
    from drivers.errors import TripError

    def fault(k):
        if k > 30:
            raise TripError("fault", "the rotor is not levitated any more; restart the rig")

    class Counting(Faulty):
        acknowledged = 0

        def acknowledge(self):
            self.acknowledged += 1
            self.inner.acknowledge()

    rig = Counting(fault)
    with pytest.raises(CampaignError, match=r"not levitated any more.*find the cause and acknowledge it"):
        campaign(rig, tmp_path)
    assert rig.n == 31
    assert rig.acknowledged == 0
    assert recover(tmp_path).named("preliminary").n_points > 0
    again = Faulty(lambda k: None)
    assert campaign(again, tmp_path).main.n_points > 0
    assert again.n > 100


def test_an_amplifier_at_its_voltage_limit_is_repeated_lower_and_marked(tmp_path):
    rig = reference_rig()
    limited = replace(rig, amplifiers=replace(rig.amplifiers, slew_limit_a_per_s=np.full(4, 500.0)))
    profile = replace(SMALL, accuracy=0.002, points=16, validation_points=2, amplifier_points=8)
    experiment = campaign(limited, tmp_path, profile)
    flags = [f for s in experiment.sweeps for f in s.flags]
    assert any("current was distorted" in f for f in flags)
    assert not any("trip" in f for f in flags)
    # what the first distorted point showed holds for all that follow
    assert sum("distorted" in f for f in flags) < 8
    for sweep in (experiment.named("main"), experiment.named("amplifier")):
        k = np.arange(sweep.n_points)
        slew = 2 * np.pi * sweep.frequency_hz * np.abs(sweep.I[k, :, 1, sweep.axis]).mean(axis=1)
        assert np.all(slew < 500)


def test_a_noisy_rig_is_excited_harder_and_for_longer(whole, tmp_path):
    from sim.rig import Noise

    loud = reference_rig(noise=Noise(displacement_m=200e-9, current_a=20e-3))
    profile = replace(SMALL, validation_points=2, amplifier_points=2)
    experiment = campaign(loud, tmp_path, profile)
    quiet = whole[1].main
    assert np.median(experiment.main.amplitude_a) > 2 * np.median(quiet.amplitude_a)
    assert np.median(experiment.main.block_samples) > 1.3 * np.median(quiet.block_samples)


def test_a_controller_without_records_gives_the_same_sweeps(tmp_path):
    class NoRecords(Faulty):
        def capabilities(self):
            return replace(self.inner.capabilities(), raw_records=False)

        def measure(self, tone):
            assert not tone.raw
            return super().measure(tone)

    experiment = campaign(NoRecords(lambda k: None), tmp_path, replace(SMALL, points=16))
    assert [s.comment for s in experiment.sweeps] == ["main", "validation", "amplifier", "noise", "preliminary"]
    _, error = relative_error(experiment.main, reference_rig())
    assert np.median(error) < SMALL.accuracy


def test_a_trip_between_two_tones_is_no_trip_of_the_next_one(tmp_path):
    """What hit the rotor then was not the excitation: it stays latched for whoever finds the cause."""
    from drivers.controller import State, TripCause
    from drivers.device.play import Interruption

    def fault(k):
        if k == 30:
            rig.inner._device._latch(Interruption(TripCause.DISPLACEMENT, "displacement of axis xB reached 81 um"))

    rig = Faulty(fault)
    few = replace(SMALL, points=12, validation_points=2, amplifier_points=2)
    with pytest.raises(CampaignError, match=r"tripped while nothing was excited .*81 um.*find the cause and ackn"):
        campaign(rig, tmp_path, few)
    assert rig.status().state is State.TRIPPED
    with rig.lease("who has found it"):
        rig.acknowledge()
    experiment = campaign(rig, tmp_path, few)
    assert not any("trip" in flag for sweep in experiment.sweeps for flag in sweep.flags)


@pytest.mark.parametrize(("from_the", "most"), [(1, 4 * 3 * 8), (80, 10 * 8)])
def test_an_axis_that_trips_at_every_tone_is_not_driven_to_its_limit_at_every_frequency(tmp_path, from_the, most):
    """Each trip is a rotor at its limit, which the campaign itself has acknowledged."""
    from drivers.errors import TripError

    class Touching(Faulty):
        trips = 0

        def measure(self, tone):
            self.n += 1
            if tone.axis == 1 and tone.amplitude_a > 0 and self.n >= from_the:
                self.trips += 1
                raise TripError("displacement", "displacement of axis xB reached 81 um, over the limit of 80 um")
            return self.inner.measure(tone)

    rig = Touching(None)
    with pytest.raises(CampaignError, match=r"axis 1 trips at every amplitude, at \d+ frequencies in a row .*81 um"):
        campaign(rig, tmp_path)
    assert 0 < rig.trips <= most
