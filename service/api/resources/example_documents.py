"""Examples of whole documents for the description of the API, cut down to a line of each list."""

from __future__ import annotations

from typing import Any

_AXES = ["xA", "xB"]
_RE = [[[-9.93e-05, 3.1e-06], [2.9e-06, -9.71e-05]]]
_IM = [[[1.27e-06, -2e-08], [-2e-08, 1.31e-06]]]
_STD = [[[4.4e-10, 3.9e-10], [3.8e-10, 4.5e-10]]]
_CURVE = {"frequency_hz": [10.0], "re": _RE, "im": _IM, "std": _STD}
_BODE = {"unit": "m/A", "measured": _CURVE, "unseen": None, "model": _CURVE}
_NYQUIST = {"frequency_hz": [10.0], "re": [[-2.07, -2.05]], "im": [[0.61, 0.62]]}
_STEP = {"unit": "m", "time_s": [1e-4], "displacement": [[[-2.0e-11, 1.0e-13], [1.0e-13, -1.9e-11]]]}
_LINEAR = {"A": [[110.5]], "B": [[-0.054, 0.021]], "C": [[-0.054], [0.061]], "D": [[0.0, 0.0], [0.0, 0.0]]}
_PLANT = {**_LINEAR, "states": ["real pole 110.5 rad/s"], "inputs": ["i_xA", "i_xB"], "outputs": ["y_xA", "y_xB"]}
_AMPLIFIERS = {
    "A": [[-7462.0]],
    "B": [[52.3]],
    "C": [[-142.8]],
    "D": [[0.0]],
    "states": ["amplifier xA mode 5463.4 rad/s (1)"],
    "inputs": ["u_xA"],
    "outputs": ["i_xA"],
}
_KI = {"value": 181.0, "std": 0.02, "unit": "N/A", "nominal": 340.0, "error_percent": 87.8}

RESULT: dict[str, Any] = {
    "format": "amb-commissioning-result",
    "version": 1,
    "rig": "compressor 3",
    "identified": True,
    "experiment": "experiment.h5",
    "planes": {"x": {"stiffness": {"kiA": _KI}, "state_space": _PLANT}},
    "warnings": [],
}
BODE = {"x": {"axes": _AXES, **_BODE}}
NYQUIST = {"x": {"axes": _AXES, **_NYQUIST}}
STEP = {"x": {"axes": _AXES, **_STEP}}
STATE_SPACE = {"x": {"plant": _PLANT, "amplifiers": _AMPLIFIERS}}
CURVES: dict[str, Any] = {
    "format": "amb-model-curves",
    "version": 1,
    "rig": "compressor 3",
    "planes": {"x": {"axes": _AXES, "frequency_response": _BODE, "nyquist": _NYQUIST, "step": _STEP}},
}
GAP: dict[str, Any] = {
    "format": "amb-gap-report",
    "version": 1,
    "verdict": {"kind": "effect", "effects": ["loop_delay"], "indistinguishable": [], "probability": 0.99},
    "shrinkage": {"closure": 0.98},
}
LINEAR_FILE: dict[str, Any] = {
    "format": "amb-state-space",
    "version": 1,
    "name": "compressor 3 x plant",
    "sample_time_s": 0.0,
    **_PLANT,
    "input_units": ["A", "A"],
    "output_units": ["m", "m"],
}
RESPONSES_FILE: dict[str, Any] = {
    "format": "amb-frequency-response",
    "version": 1,
    "name": "compressor 3 x u->y",
    "inputs": ["u_xA", "u_xB"],
    "outputs": ["y_xA", "y_xB"],
    "input_units": ["A", "A"],
    "output_units": ["m", "m"],
    "frequency_hz": [10.0],
    "real": _RE,
    "imag": _IM,
    "std": _STD,
}
