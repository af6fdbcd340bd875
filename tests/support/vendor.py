"""A rig with a vendor's own map, looked at through the driver: nothing of the map may show."""

from dataclasses import replace

import numpy as np

from drivers.controller import Controller, State, Tone


def assert_works_like_our_own(controller: Controller, tone: Tone, raw_samples: int) -> None:
    """Capabilities in SI, a tone of 0.1 A on axis 1 as asked for, a raw record of this length, the state after it."""
    assert controller.capabilities().max_amplitude_a == 6.0
    with controller.lease("host"):
        point = controller.measure(tone)
        raw = controller.measure(
            replace(tone, axis=0, amplitude_a=0.02, periods=1, samples=raw_samples, blocks=1, raw=True)
        )
    np.testing.assert_allclose(point.R[:, 1, 1], 0.1)
    assert np.abs(point.Y[:, 1, 1]).min() > 1e-7
    assert raw.records is not None
    assert raw.records["y"].shape == (raw_samples, 4)
    assert controller.status().state is State.DONE
