"""An experiment and its datasheet cut to the two axes of one plane, as of a rig with one."""

from __future__ import annotations

from dataclasses import replace

from service.experiment.data import Experiment, Sweep
from sim.datasheet import Datasheet
from sim.reference import reference_datasheet
from sim.rig_file import to_toml
from tests.support.synthetic import known_datasheet


def one_plane(measured: Experiment, datasheet: Datasheet) -> tuple[Experiment, Datasheet]:
    """xA and xB alone, of four axes."""

    def cut(s: Sweep) -> Sweep:
        s = s.select(s.axis < 2)
        current = None if s.I is None else s.I[..., :2]
        return replace(s, R=s.R[..., :2], U=s.U[..., :2], I=current, Y=s.Y[..., :2])

    return replace(measured, axes=measured.axes[:2], sweeps=tuple(map(cut, measured.sweeps))), sheet_of_one_plane(
        datasheet
    )


def sheet_of_one_plane(datasheet: Datasheet) -> Datasheet:
    """xA and xB alone, of four axes."""
    damping = datasheet.amplifier_damping_ratio
    return replace(
        datasheet,
        axes=datasheet.axes[:2],
        current_stiffness_n_per_a=datasheet.current_stiffness_n_per_a[:2],
        position_stiffness_n_per_m=datasheet.position_stiffness_n_per_m[:2],
        bias_current_a=datasheet.bias_current_a[:2],
        amplifier_gain=datasheet.amplifier_gain[:2],
        amplifier_natural_frequency_hz=datasheet.amplifier_natural_frequency_hz[:2],
        amplifier_damping_ratio=None if damping is None else damping[:2],
        sensor_gain=datasheet.sensor_gain[:2],
    )


def true_and_known() -> tuple[str, str]:
    """Two rig.toml: a rig of one plane with its modes, to be served, and what is known of it before it is measured."""
    return to_toml(sheet_of_one_plane(known_datasheet()[1])), to_toml(sheet_of_one_plane(reference_datasheet()))
