"""Which tones a controller accepts. Drivers ask before they send, the device asks again."""

from __future__ import annotations

import math

import numpy as np

from drivers.controller import Capabilities, Tone, Waveform
from drivers.errors import LimitError
from drivers.objects import MAX_BLOCKS

MAX_SAMPLES = 2_000_000
MAX_RAW_SAMPLES = 500_000


def check_tone(tone: Tone, capabilities: Capabilities) -> None:
    """Refuse a tone outside the controller's limits.

    Raises
    ------
    LimitError
        Names the value and the limit.
    """
    c = capabilities
    if not 0 <= tone.axis < len(c.axes):
        raise LimitError(f"axis {tone.axis} does not exist; the rig has axes 0 to {len(c.axes) - 1}")
    if not (math.isfinite(tone.amplitude_a) and 0 <= tone.amplitude_a <= c.max_amplitude_a):
        raise LimitError(f"amplitude {tone.amplitude_a} A is outside 0 to {c.max_amplitude_a} A")
    if tone.samples < 2 or tone.periods < 1 or not 1 <= tone.blocks <= MAX_BLOCKS or tone.settle_samples < 0:
        raise LimitError(
            f"a tone has at least 1 period in 2 samples, 1 to {MAX_BLOCKS} blocks and no negative settling, not {tone}"
        )
    frequency = tone.frequency_hz(c.sample_rate_hz)
    if frequency > c.max_frequency_hz:
        raise LimitError(f"frequency {frequency:.6g} Hz is above {c.max_frequency_hz:.6g} Hz")
    total = tone.settle_samples + tone.blocks * tone.samples
    if total > c.max_samples:
        raise LimitError(f"{total} samples of settling and blocks are more than {c.max_samples}")
    if tone.raw and tone.blocks * tone.samples > MAX_RAW_SAMPLES:
        raise LimitError(f"{tone.blocks * tone.samples} samples of raw record are more than {MAX_RAW_SAMPLES}")


def check_waveform(waveform: Waveform, capabilities: Capabilities) -> None:
    """Refuse a periodic waveform outside the controller's limits.

    Raises
    ------
    LimitError
        Names the value and the limit.
    """
    c, w = capabilities, waveform
    if w.r_a.ndim != 2 or w.r_a.shape[1] != len(c.axes) or w.samples < 2:
        raise LimitError(f"a waveform has shape (samples, {len(c.axes)}), a column for each axis, not {w.r_a.shape}")
    if not (np.all(np.isfinite(w.r_a)) and w.peak_a <= c.max_amplitude_a):
        raise LimitError(f"the waveform's largest value, {w.peak_a:.4g} A, is above {c.max_amplitude_a} A")
    if not 1 <= w.periods <= MAX_BLOCKS or w.settle_samples < 0:
        raise LimitError(f"a waveform is recorded for 1 to {MAX_BLOCKS} periods after no negative settling")
    if w.settle_samples + w.periods * w.samples > c.max_samples or w.periods * w.samples > MAX_RAW_SAMPLES:
        raise LimitError(f"{w.periods * w.samples} samples of record are more than {MAX_RAW_SAMPLES}")
