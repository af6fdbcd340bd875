"""A plane as result.json keeps it, back as a model with its covariance: what later work starts from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Real
from service.identification.loop.margins import Beyond, beyond_measured
from service.identification.measured.known import as_identified
from service.identification.measured.points import planes_of
from service.identification.plane.layout import GIVEN, N_MODE, SHIFTS, Layout
from service.identification.plane.model import PlaneModel
from service.identification.rotating.layout import RotatingLayout
from service.identification.rotating.model import RotatingModel, paired
from service.identification.steps.nominal import known_of
from sim.datasheet import Datasheet
from sim.errors import AmbError
from sim.folded import Folded

OTHER_LAW = (
    "the controller that ran is not the one of the datasheet (the twin's effects say how it differs): a law is judged "
    "as it is written; where the same difference would come upon it, write it into the law"
)

NOT_UNSEEN = (
    "its model did not hold on the sweep that no fit has seen: at other amplitudes, or after a while, the rig is "
    "another one by more than the deviations allow; diagnose the gap (ambit gap diagnose)"
)

SPEEDLESS = (
    "judged for a rotor that stands still: the result's model of the turning rotor cannot be read, and the planes have "
    "no gyroscopic coupling; identify the experiments once more (ambit identify --also)"
)

AT_STANDSTILL = (
    "judged without gyroscopic coupling: the commissioning has no model of the turning rotor, so whether the loop "
    "holds at speed, and its zone of ISO 14839-3 there, are not known; measure at speed, too, and identify both "
    "experiments together (ambit identify --also)"
)

BANDLESS = (
    "the commissioning result does not tell up to which frequency the rig was measured; identify its experiment once "
    "more (ambit identify)"
)


@dataclass(frozen=True)
class SavedPlane:
    """An identified plane."""

    plane: str
    axes: tuple[str, str]
    model: PlaneModel
    free: NDArray[np.bool_]
    """(size,) which parameters were fitted."""
    uncertain: NDArray[np.bool_]
    """(size,) which are not known for sure: those, and what was held within the datasheet's tolerances."""
    covariance: Real
    """(m, m) of the uncertain ones, with what is not known of the shapes' splits."""
    covariance_from_data: Real
    """(n, n) of the free ones, the splits held, widened as the fit's residuals asked for."""
    rms_over_sigma: float
    """Residuals of the fit over its noise; about 1 where the model is right."""
    adequate: bool
    rotor_modes: tuple[int, ...]
    """Places among the model's modes of those that are the rotor's, by rising frequency."""
    beyond: NDArray[np.bool_]
    """(modes,) those that stand for what lies beyond the band that was measured."""
    highest_hz: float | None
    """Highest line that it was identified from; None where an older version wrote the result."""
    rig_axes: tuple[str, ...]
    """All axes of the rig, those of the other planes with them."""
    notes: tuple[str, ...] = ()
    """What to know of what the model lacks, in sentences: of effects that the twin names, and of the unseen sweep."""

    def beyond_measured(self, model: PlaneModel, controller: tuple[Real, Real]) -> Beyond:
        """What of its loop with a controller lies above what was measured.

        Parameters
        ----------
        model
            Its own, or that of the same plane at another time.
        """
        if self.highest_hz is None:
            return Beyond(gain=BANDLESS)
        return beyond_measured(model, controller, self.axes, self.highest_hz)


def saved_planes(document: Mapping[str, Any], datasheet: Datasheet) -> dict[str, SavedPlane]:
    """Every plane of a result.json.

    Raises
    ------
    AmbError
        The document does not fit the datasheet, was written before parameters were kept in it, or says nothing of the
        rig.
    """
    if not is_identified(document):
        raise AmbError(
            f"the rig {document.get('rig', '')!r} is not identified by this commissioning result, its figures say "
            "nothing: mend what its notes name and identify it once more, or give another one"
        )
    try:
        return _checked(document, datasheet)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise AmbError(
            f"the commissioning result is incomplete ({type(error).__name__}: {error}); give a result.json that ambit "
            "wrote, as it wrote it"
        ) from error


def is_identified(document: Mapping[str, Any]) -> bool:
    """Whether the figures of a result.json say anything of the rig; one of before this was written does."""
    return document.get("identified") is not False


def _checked(document: Mapping[str, Any], datasheet: Datasheet) -> dict[str, SavedPlane]:
    names = {a[0] for a in datasheet.axes}
    unknown = set(document["planes"]) - names
    if unknown:
        raise AmbError(
            f"the result of rig {document['rig']} has plane {', '.join(sorted(unknown))}, the datasheet "
            f"{datasheet.name} only {', '.join(sorted(names))}; give the datasheet of the rig that was commissioned"
        )
    twin, notes = as_identified(datasheet, document)
    if (twin.datasheet.numerator, twin.datasheet.denominator) != (datasheet.numerator, datasheet.denominator):
        notes = (*notes, OTHER_LAW)
    if document.get("rotating") and saved_rotor(document, datasheet) is None:
        notes = (*notes, SPEEDLESS)
    return {plane: _saved(found, twin, plane, notes) for plane, found in document["planes"].items()}


@dataclass(frozen=True)
class SavedRotor:
    """The turning rotor of a result, and the speeds of its Campbell diagram."""

    model: RotatingModel
    speeds_rad_s: Real
    """(S,) from standstill to a quarter beyond the fastest that was measured."""
    free: NDArray[np.bool_]
    """(size,) which parameters were fitted."""
    covariance: Real
    """(n, n) of the free ones."""
    rms_over_sigma: float
    """Residuals of the sweep that fits worst over its noise."""
    adequate: bool


def saved_rotor(document: Mapping[str, Any], datasheet: Datasheet) -> SavedRotor | None:
    """The model of all speeds that a result.json holds; None where it holds none that can be read back."""
    found = document.get("rotating")
    if not found:
        return None
    try:
        return _rotor(document, found, as_identified(datasheet, document)[0])
    except (KeyError, TypeError, ValueError, IndexError, AttributeError):
        return None


def _rotor(document: Mapping[str, Any], found: Mapping[str, Any], twin: Folded) -> SavedRotor:
    kept = found["parameters"]
    values: Mapping[str, float] = kept["values"]
    layouts, known = [], []
    for plane in "xy":
        orders = document["planes"][plane]["parameters"]["amplifier_orders"]
        n_modes = sum(name.startswith(f"{plane}_mode_") for name in values) // N_MODE
        layouts.append(Layout((int(orders[0]), int(orders[1])), n_modes))
        chain = twin.chain.of(list(planes_of(twin.datasheet.axes)[plane]))
        shifts = [float(document["planes"][plane]["parameters"]["values"].get(name, 0.0)) for name in SHIFTS]
        known.append(known_of(twin.datasheet, plane, twin.datasheet.axes, chain).with_sensors_at(np.array(shifts)))
    both, models = (layouts[0], layouts[1]), (known[0], known[1])

    def of(pairs: tuple[tuple[int, int], ...]) -> RotatingModel:
        layout = RotatingLayout(both, pairs)
        return RotatingModel(models, layout, np.array([float(values[name]) for name in layout.names]))

    model = of(tuple((int(a), int(b)) for a, b in kept["pairs"]) if "pairs" in kept else paired(*of(()).planes))
    if set(model.layout.names) != set(values):
        raise ValueError("parameters of another model")
    free = np.isin(np.array(model.layout.names), np.array(kept["free"]))
    covariance = np.array(kept["covariance"], dtype=float)
    if covariance.shape != (free.sum(), free.sum()) or not np.isfinite(covariance).all():
        raise ValueError("a covariance of other parameters")
    return SavedRotor(
        model,
        np.array(found["campbell"]["speed_rad_s"], dtype=float),
        free,
        covariance,
        max(float(s["rms_over_sigma"]) for s in found["sweeps"]),
        bool(found["model_adequate"]),
    )


def _saved(found: Mapping[str, Any], twin: Folded, plane: str, notes: tuple[str, ...]) -> SavedPlane:
    kept = found.get("parameters")
    if kept is None:
        raise AmbError(
            f"plane {plane} of the result has no parameters with covariance: an older version wrote it; identify "
            "its experiment once more (ambit identify)"
        )
    layout = Layout((int(kept["amplifier_orders"][0]), int(kept["amplifier_orders"][1])), int(kept["modes"]))
    values: Mapping[str, float] = kept["values"]
    # a result of before sensors could be elsewhere than the datasheet says has them there
    theta = np.array([float(values[name] if name not in SHIFTS else values.get(name, 0.0)) for name in layout.names])
    uncertain = np.isin(np.array(layout.names), np.array(kept["free"]))
    free = uncertain & ~np.isin(np.array(layout.names), np.array(GIVEN))
    fitted = free[uncertain]
    pair = (f"{plane}A", f"{plane}B")
    axes = twin.datasheet.axes
    chain = twin.chain.of(list(planes_of(axes)[plane]))
    model = PlaneModel(known_of(twin.datasheet, plane, axes, chain), layout, theta)
    total = np.array(kept["covariance"], dtype=float)
    own = total if kept["covariance_from_data"] is None else np.array(kept["covariance_from_data"], dtype=float)
    residuals = found["residuals"]
    if found.get("cross_validation_passed") is False:
        notes = (*notes, f"plane {plane}: {NOT_UNSEEN}")
    return SavedPlane(
        plane,
        pair,
        model,
        free,
        uncertain,
        total,
        own[np.ix_(fitted, fitted)] * float(residuals["std_widened_by"] or 1.0) ** 2,
        float(residuals["rms_over_sigma"]),
        bool(residuals["model_adequate"]),
        tuple(_places(model, found["rotor_modes"])),
        np.isin(np.arange(layout.n_modes), _places(model, [m for m in found["other_modes"] if m["kind"] == "beyond"])),
        None if found.get("measured_hz") is None else float(found["measured_hz"][1]),
        tuple(axes),
        notes,
    )


def axes_without_model(planes: Iterable[SavedPlane]) -> tuple[str, ...]:
    """Axes of the rig that are in none of the planes of a result, in the rig's order."""
    told: dict[str, bool] = {}
    for s in planes:
        told |= {a: told.get(a, False) or a in s.axes for a in s.rig_axes}
    return tuple(a for a, has_model in told.items() if not has_model)


def _places(model: PlaneModel, listed: list[Mapping[str, Any]]) -> list[int]:
    """Places among the model's modes of those that the result lists, by their frequency."""
    w = model.natural_frequencies
    return [int(np.argmin(np.abs(w - m["natural_frequency_rad_s"]["value"]))) for m in listed]
