"""Where the fit of a plane starts: the datasheet's values, and what it tells of the split of its modes."""

from __future__ import annotations

import numpy as np

from service.identification.measured.data import Data
from service.identification.measured.points import planes_of
from service.identification.options import Options
from service.identification.plane.layout import SHIFTS, Layout
from service.identification.plane.model import PlaneModel
from service.identification.plane.parameters import Known
from service.identification.priors.split import Knowledge
from service.identification.steps.amplifier_fit import AmplifierFit, amplifier_fits
from sim.chain import Chain
from sim.datasheet import Datasheet

END_SLOPE = 4.0
"""Change of the first mode's shape towards a free shaft's end, in largest values at bearings and sensors per bearing
span. A uniform beam's slope at its end is 4.65 per length (Blevins, Formulas for Natural Frequency and Mode Shape,
table 8-1) of the value there; over the usual 0.7 to 0.85 of it, and of the smaller values within, it is 4 to 6, less
where discs bend the shape."""


def start_model(
    datasheet: Datasheet, plane: str, axes: tuple[str, ...], data: Data, chain: Chain | None = None
) -> tuple[PlaneModel, tuple[AmplifierFit, AmplifierFit] | None]:
    """Plane with the datasheet's values, and amplifiers fitted where currents are logged (step 3).

    ``chain``: what else is known of the plane.
    """
    pair = list(planes_of(axes)[plane])
    nominal = [_nominal_amplifier(datasheet, k) for k in pair]
    fits = None
    parameters, delay = nominal, 0.0
    if data.plant.I is not None:
        sets = [data.plant] + ([data.amplifier] if data.amplifier is not None else [])
        fits = amplifier_fits(sets, (nominal[0], nominal[1]), datasheet.sample_time_s, datasheet.computing_delay_s)
        parameters = [f.parameters for f in fits]
        delay = float(np.mean([f.delay_s for f in fits]))
    known = known_of(datasheet, plane, axes, chain)
    orders = (len(parameters[0]) - 1, len(parameters[1]) - 1)
    theta = np.concatenate(
        [
            [datasheet.current_stiffness_n_per_a[k] for k in pair],
            [datasheet.position_stiffness_n_per_m[k] for k in pair],
            *parameters,
            [delay],
            [datasheet.mass_kg, datasheet.transverse_inertia_kgm2, 0.0],
            [datasheet.sensor_gain[k] for k in pair],
            np.zeros(len(SHIFTS)),
        ]
    )
    return PlaneModel(known, Layout(orders), theta), fits


def known_of(datasheet: Datasheet, plane: str, axes: tuple[str, ...], chain: Chain | None = None) -> Known:
    """What the datasheet tells of a plane and no fit changes, with the plane's ``chain`` of known blocks."""
    pair = list(planes_of(axes)[plane])
    bandwidth = datasheet.sensor_bandwidth_hz
    return Known(
        datasheet.bearing_from_cog_m,
        datasheet.sensor_from_cog_m,
        np.array([datasheet.bias_current_a[k] for k in pair]),
        datasheet.sample_time_s,
        datasheet.computing_delay_s,
        np.full(2, np.inf) if bandwidth is None else 2 * np.pi * np.array([bandwidth[k] for k in pair]),
        Chain() if chain is None else chain,
    )


def _nominal_amplifier(datasheet: Datasheet, axis: int) -> tuple[float, ...]:
    w = 2 * np.pi * datasheet.amplifier_natural_frequency_hz[axis]
    gain = datasheet.amplifier_gain[axis]
    if datasheet.amplifier_damping_ratio is None:
        return (gain, w)
    return (gain, w, datasheet.amplifier_damping_ratio[axis])


def split_knowledge(datasheet: Datasheet, options: Options) -> Knowledge:
    """What the datasheet tells of the modes' splits."""
    (a, b), (sa, sb) = datasheet.bearing_from_cog_m, datasheet.sensor_from_cog_m
    scale = float(np.clip(END_SLOPE * 0.5 * (abs(sa - a) + abs(sb - b)) / (a + b), 0.05, 0.5))
    modes = datasheet.modes if options.datasheet_modes else ()
    modes = tuple(m for m in modes if any(m.shape_at_bearings) and any(m.shape_at_sensors))
    ratios = [np.log(np.linalg.norm(m.shape_at_sensors) / np.linalg.norm(m.shape_at_bearings)) for m in modes]
    return Knowledge(
        scale if options.closeness else None,
        (sa > a, sb > b),
        2 * np.pi * np.array([m.frequency_hz for m in modes]),
        np.array(ratios),
        float(np.hypot(1.0, 1.0) * datasheet.tolerance.mode_shape),
    )
