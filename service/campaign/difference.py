"""In which setting two campaigns differ, as their user wrote it: by its key in the datasheet or the profile."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from typing import Any

SHOWN = 3
"""Settings that are named; of more, how many there are."""
_OF_THE_CONTROLLER = {
    "rig": "the rig's name",
    "controller": "the controller",
    "axes": "the controller's axes",
    "harmonics": "the harmonics that the controller gives",
    "raw_records": "whether the controller sends records",
    "limits.n_axes": "the number of axes",
    "limits.sample_rate_hz": "the controller's sample rate in Hz",
    "limits.max_frequency_hz": "the controller's largest frequency in Hz",
    "limits.max_samples": "the controller's longest tone in samples",
    "limits.max_amplitude_a": "the controller's largest amplitude in A",
    "limits.amplitude_steps_per_a": "the steps per ampere of the map's amplitude",
    "limits.displacement_limit_m": "the controller's displacement limit in m",
    "limits.current_limit_a": "the controller's current limit in A",
}
"""What is no key of a user's: the controller states it."""


def difference(found: dict[str, Any], wanted: dict[str, Any]) -> str:
    """What the campaign of one journal's header was measured with, and what is asked for now.

    Parameters
    ----------
    found, wanted
        Headers of journals, as `service.campaign.beginning.fingerprint` makes them, with "about" where there is one.

    Returns
    -------
    words
        Such as "rotor.mass_kg of the datasheet was 280, now it is 281"; empty where they do not differ.
    """
    if found.get("datasheet_sha256") != wanted.get("datasheet_sha256"):
        return _told(_sheet(found), _sheet(wanted), " of the datasheet") or "the datasheet is another one"
    old, new = (_excitation(header) for header in (found, wanted))
    if old != new:
        return f"the excitation was {old}, now it is {new}"
    return _told(_profile(found), _profile(wanted)) or _told(_stated(found), _stated(wanted))


def _sheet(header: dict[str, Any]) -> dict[str, Any]:
    return dict(_settings(tomllib.loads(header.get("about", {}).get("datasheet", ""))))


def _excitation(header: dict[str, Any]) -> str:
    return "multisine" if "multisine" in header.get("profile", {}) else "stepped-sine"


def _profile(header: dict[str, Any]) -> dict[str, Any]:
    profile = header.get("profile", {})
    return {f"profile.{name}": value for name, value in profile.get("multisine", profile).items()}


def _stated(header: dict[str, Any]) -> dict[str, Any]:
    settings = _settings(header, ("about", "profile"))
    return {_OF_THE_CONTROLLER.get(name, name): value for name, value in settings}


def _settings(part: dict[str, Any], but: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Values by dotted key; of a list of sections, by their place in it."""
    for name, value in part.items():
        if name in but:
            continue
        sections = dict(enumerate(value)) if isinstance(value, list) and _holds_sections(value) else value
        if isinstance(sections, dict):
            yield from ((f"{name}.{key}", each) for key, each in _settings({str(k): v for k, v in sections.items()}))
        else:
            yield name, value


def _holds_sections(values: list[Any]) -> bool:
    return bool(values) and all(isinstance(value, dict) for value in values)


def _told(old: dict[str, Any], new: dict[str, Any], where: str = "") -> str:
    old, new = _apart(old, new), _apart(new, old)
    changed = [name for name in {**old, **new} if old.get(name) != new.get(name)]
    words = [f"{name}{where} was {_value(old, name)}, now it is {_value(new, name)}" for name in changed[:SHOWN]]
    more = len(changed) - len(words)
    return "; ".join(words) + (f"; and {more} more differ" if more else "")


def _apart(values: dict[str, Any], others: dict[str, Any]) -> dict[str, Any]:
    """The same, with lists that are as long in both value by value: one axis of four is soon overlooked."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        other = others.get(name)
        alike = isinstance(value, list) and isinstance(other, list) and len(value) == len(other)
        found |= {f"{name}.{k}": each for k, each in enumerate(value)} if alike else {name: value}
    return found


def _value(values: dict[str, Any], name: str) -> str:
    if values.get(name) is None:
        return "not given"
    text = json.dumps(values[name])
    return text if len(text) <= 60 else text[:57] + "..."
