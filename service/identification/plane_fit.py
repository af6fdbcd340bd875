"""One plane identified: the six steps, the joint refinement, and what still rang taken out."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from service.experiment.data import Sweep
from service.experiment.speeds import at_standstill
from service.identification.arrays import Real
from service.identification.joint.selection import Selected, choose_modes
from service.identification.joint.uncertainty import Uncertainty, uncertainty_of
from service.identification.measured.block_length import block_samples
from service.identification.measured.data import Data
from service.identification.measured.etfe import FrequencyResponse, etfe
from service.identification.measured.points import PlanePoints, check_excitation, plane_points, planes_of
from service.identification.options import Options
from service.identification.priors.given import Given
from service.identification.priors.tolerances import Tolerances
from service.identification.result.assemble import assemble
from service.identification.result.commissioning import PlaneResult
from service.identification.result.figures import kinds
from service.identification.result.judged import residual_tests, total_rms
from service.identification.ringing.transient import LASTING, Transient, settled, told
from service.identification.steps.amplifier_fit import AmplifierFit
from service.identification.steps.nominal import split_knowledge, start_model
from service.identification.steps.staged import StagedFit, staged_fit
from service.identification.steps.start import joint_start
from sim.chain import Chain
from sim.datasheet import Datasheet
from sim.errors import AmbError


@dataclass(frozen=True)
class FittedPlane:
    """One plane after all its fits, and what they were made from."""

    data: Data
    held_out: PlanePoints | None
    u_to_y: FrequencyResponse
    plant: FrequencyResponse
    amplifiers: tuple[AmplifierFit, AmplifierFit] | None
    staged: StagedFit
    selected: Selected
    transients: tuple[Transient, ...] = ()
    """What rang in the points and was taken out."""
    measured: PlanePoints | None = None
    """The points before, where anything was."""
    given: Given | None = None
    """What is held in place of the datasheet's mass, geometry and sensor gains; None: these."""

    @property
    def residual_over_noise(self) -> float:
        """Of all channels together, in units of the noise."""
        return total_rms(residual_tests(self.selected.refined, self.data.plant)[0])

    @property
    def adequate(self) -> bool:
        """Whether the model explains the data."""
        return self._uncertainty.adequate

    @property
    def sound(self) -> bool:
        """Whether that takes no mode that no rotor has: it stands for something else, as for a mass that is off."""
        model = self.selected.refined.model
        return self.adequate and "patch" not in kinds(model, self._uncertainty, self.data.plant)

    @property
    def _uncertainty(self) -> Uncertainty:
        refined = self.selected.refined
        return uncertainty_of(refined, self.selected.splits, inflation=refined.noise.inflation)

    def result(self, datasheet: Datasheet) -> PlaneResult:
        """Figures with uncertainty, validation, curves."""
        found = assemble(
            datasheet,
            self.data,
            self.held_out,
            self.u_to_y,
            self.plant,
            self.amplifiers,
            self.staged,
            self.selected,
            self.given,
        )
        more = [told(t) for t in self.transients if t.left > LASTING]
        if self.data.prior is not None:
            more += self.data.prior.strained(found.model)
        return replace(found, warnings=(*found.warnings, *more))


def fit_plane(
    main: Sweep,
    amplifier_sweep: Sweep | None,
    validation: Sweep | None,
    axes: tuple[str, ...],
    plane: str,
    datasheet: Datasheet,
    options: Options | None = None,
    chain: Chain | None = None,
    released: Tolerances | None = None,
    given: Given | None = None,
) -> FittedPlane:
    """Identify one plane: the six steps, then the joint refinement.

    Parameters
    ----------
    chain
        What is known of the axes beside the datasheet; the sweeps are led back to where the model begins
        (`measured.known.led_back`).
    released
        What of the datasheet's mass, geometry and sensor gains may move, and how well each is known.
    given
        What is held in place of these; ``released`` then says only how well it is known.
    """
    options = options or Options()
    own = Chain() if chain is None else chain.of(list(planes_of(axes)[plane]))
    points = plane_points(main, axes, plane)
    check_excitation(points)
    told = Tolerances.of(datasheet, points.axes)
    prior = told if options.priors else told.of_amplifiers() if points.I is None else None
    held = given is not None
    freed, loose = (None, released) if held else (released, None)
    data = Data(points, _amplifier_points(amplifier_sweep, axes, plane), prior, freed, loose)
    found = _fit_points(data, datasheet, axes, options, own, given=given)
    found = _settled(found, main, axes, datasheet, options, _block_s(main, points))
    held_out = None
    if validation is not None:
        with suppress(AmbError):  # what cannot be used checks nothing, and costs nothing
            held_out = plane_points(validation, axes, plane)
    if held_out is not None and len(held_out.omega) == 0:
        held_out = None
    return replace(found, held_out=held_out)


def _settled(
    found: FittedPlane,
    main: Sweep,
    axes: tuple[str, ...],
    datasheet: Datasheet,
    options: Options,
    block_s: Real | float | None,
    suspected: bool = False,
) -> FittedPlane:
    """The plane fitted once more without what was still ringing, where anything was; the last two: see `settled`."""
    if main.kind != "stepped-sine" or not at_standstill(main.speed_rad_s):
        return found
    controller = (np.array(datasheet.numerator), np.array(datasheet.denominator))
    refined = found.selected.refined
    measured = found.measured or found.data.plant
    data, transients = settled(
        replace(found.data, plant=measured), refined.model, refined.fit.free, controller, block_s, suspected
    )
    if data.plant is measured or (refined.relative and not transients):
        return found  # what noise alone kept up is not worth a further fit of a model that does not explain the data
    again = _fit_points(data, datasheet, axes, options, refined.model.known.chain, found.selected, found.given)
    return replace(again, held_out=found.held_out, transients=transients, measured=measured)


def settled_alike(
    found: dict[str, FittedPlane], main: Sweep, axes: tuple[str, ...], datasheet: Datasheet, options: Options
) -> dict[str, FittedPlane]:
    """Planes in which no start still rang, looked at again where one did in another: they were recorded alike.

    With the length of blocks that the other's told, and asked for less evidence than by themselves.
    """
    shown = [t for f in found.values() for t in f.transients]
    if not shown:
        return found
    loudest = max(shown, key=lambda t: t.evidence)
    out = {}
    for plane, f in found.items():
        told = _block_s(main, f.data.plant)
        block_s = loudest.block_s if told is None else told
        out[plane] = f if f.transients else _settled(f, main, axes, datasheet, options, block_s, suspected=True)
    return out


def _block_s(main: Sweep, points: PlanePoints) -> Real | None:
    """Length of each point's blocks, (P,) s, where file or lines tell it."""
    samples = block_samples(main)
    return None if samples is None else samples[points.index] / main.sample_rate_hz


def _fit_points(
    data: Data,
    datasheet: Datasheet,
    axes: tuple[str, ...],
    options: Options,
    chain: Chain,
    before: Selected | None = None,
    given: Given | None = None,
) -> FittedPlane:
    """The six steps and the joint refinement; ``before`` is what was chosen with what still rang in the points."""
    points = data.plant
    u_to_y = etfe(points, "u->y")
    start, fits = start_model(datasheet, points.plane, axes, data, chain)
    if given is not None:
        start = given.of(start)
    gain = start.amplifier_response(u_to_y.omega)
    plant = FrequencyResponse(u_to_y.omega, u_to_y.value / gain[:, None, :], u_to_y.std / np.abs(gain)[:, None, :])
    staged = staged_fit(start, points, plant)
    knowledge = replace(split_knowledge(datasheet, options), end_rad_s=float(points.omega.max()))
    begin = joint_start(staged.rigid_model, staged.rational, points, plant)
    selected = choose_modes(begin, staged.rigid_model, data, plant, staged.lowest_mode_rad_s, knowledge, before)
    return FittedPlane(data, None, u_to_y, plant, fits, staged, selected, given=given)


def _amplifier_points(sweep: Sweep | None, axes: tuple[str, ...], plane: str) -> PlanePoints | None:
    if sweep is None or sweep.I is None:
        return None
    points = plane_points(sweep, axes, plane)
    return points if len(points.omega) else None
