"""The curves that a page draws are those of the loop, however fast its controller samples."""

from dataclasses import replace

import numpy as np
import pytest

from service.identification.loop.margins import computed_response, sensitivity
from service.identification.plane.model import PlaneModel
from service.report.curves import curves
from sim.reference import pid_with_biquad

PERIODIC_S = 6.0
"""After so long nothing is left of a pulse: the loop's slowest part decays with 3.7 1/s."""


def step_from_frequencies(model: PlaneModel, law: tuple[np.ndarray, np.ndarray], time_s: list[float]) -> np.ndarray:
    """Step of the closed loop, (len(time_s), 2, 2), as the sum of the pulse that its frequency response has.

    An integrator has no response at 0 Hz: with lines half a step higher, the pulse turns by half a turn in a period.
    """
    period = model.known.sample_time_s
    n = round(PERIODIC_S / period)
    omega = 2 * np.pi * (np.arange(n // 2) + 0.5) / (n * period)
    closed = computed_response(model, omega) @ sensitivity(model, law, omega)
    whole = np.concatenate([closed, closed[::-1].conj()])
    pulse = (np.exp(1j * np.pi * np.arange(n) / n)[:, None, None] * np.fft.ifft(whole, axis=0)).real
    return np.cumsum(pulse, axis=0)[np.round(np.array(time_s) / period).astype(int)]


@pytest.mark.parametrize("period", [1e-4, 2e-5])
def test_the_step_is_that_of_the_loop_with_slow_and_with_fast_controllers(result, measured, period):
    law = pid_with_biquad(sample_time_s=period)
    sheet = replace(measured[1], sample_time_s=period, numerator=tuple(law[0]), denominator=tuple(law[1]))
    identified = result.planes["x"]
    known = replace(identified.model.known, sample_time_s=period)
    plane = replace(identified, model=replace(identified.model, known=known))
    step = curves(replace(result, planes={"x": plane}), sheet)["planes"]["x"]["step"]
    expected = step_from_frequencies(plane.model, law, step["time_s"])
    assert step["time_s"][0] == 0.0
    assert step["time_s"][-1] > 0.24
    np.testing.assert_allclose(np.array(step["displacement"], float), expected, atol=1e-5 * np.abs(expected).max())
