"""What has to hold before a campaign begins or goes on: controller, datasheet and journal fit one another."""

from __future__ import annotations

import math
from dataclasses import asdict
from hashlib import sha256
from typing import Any

from drivers.controller import Capabilities, Controller
from service.campaign import journal
from service.campaign.aims import STEPS_PER_A, Limits, Profile
from service.campaign.multisine import plan as multisine_plan
from service.campaign.multisine.plan import MultisineProfile
from service.experiment.errors import CampaignError, JournalError
from service.experiment.speeds import impossible, same
from sim.datasheet import Datasheet
from sim.rig_file import to_toml


def checked_limits(capabilities: Capabilities, datasheet: Datasheet) -> Limits:
    """Limits of controller and datasheet together.

    Raises
    ------
    CampaignError
        They describe different rigs, or a figure of the controller is none that a plan can go by.
    """
    c = capabilities
    for name in ("sample_rate_hz", "max_amplitude_a", "max_frequency_hz", "displacement_limit_m", "current_limit_a"):
        told = getattr(c, name)
        if not (math.isfinite(told) and told > 0):
            raise CampaignError(
                f"the controller tells identity.{name} as {told:g}, and no experiment can go by that; correct it in "
                "the controller, or its place and type in the map"
            )
    if tuple(c.axes) != datasheet.axes:
        raise CampaignError(
            f"the controller has axes {', '.join(c.axes)}, the datasheet {datasheet.name} has "
            f"{', '.join(datasheet.axes)}; give the datasheet of this rig"
        )
    if abs(c.sample_rate_hz * datasheet.sample_time_s - 1) > 1e-6:
        raise CampaignError(
            f"the controller samples at {c.sample_rate_hz:g} Hz, the datasheet {datasheet.name} says "
            f"{datasheet.sample_rate_hz:g} Hz; correct controller.sample_time_s"
        )
    return Limits.of(
        datasheet,
        c.sample_rate_hz,
        c.max_frequency_hz,
        c.max_samples,
        c.max_amplitude_a,
        c.displacement_limit_m,
        c.current_limit_a,
        c.amplitude_steps_per_a,
    )


def fingerprint(
    capabilities: Capabilities, datasheet: Datasheet, limits: Limits, profile: Profile | MultisineProfile
) -> journal.Entry:
    """What must be the same for a journal to be continued."""
    return {
        "rig": datasheet.name,
        "controller": capabilities.identity,
        "axes": list(capabilities.axes),
        "harmonics": list(capabilities.harmonics),
        "raw_records": capabilities.raw_records,
        "limits": _documented(limits),
        "datasheet_sha256": sha256(to_toml(datasheet).encode()).hexdigest(),
        "profile": multisine_plan.documented(profile) if isinstance(profile, MultisineProfile) else asdict(profile),
    }


def _documented(limits: Limits) -> dict[str, Any]:
    """Limits for a journal; the usual steps are not told, for older journals have none."""
    told = asdict(limits)
    if limits.amplitude_steps_per_a == STEPS_PER_A:
        del told["amplitude_steps_per_a"]
    return told


def speed_now(controller: Controller) -> float:
    """Speed that a controller tells before a campaign, rad/s.

    Raises
    ------
    CampaignError
        No rotor turns so fast: the file of a whole campaign would be refused for it.
    """
    speed_rad_s = float(controller.status().speed_rad_s)
    if why := impossible(speed_rad_s):
        raise CampaignError(f"the speed that the controller tells {why}")
    return speed_rad_s


def speed_of(header: journal.Entry, now_rad_s: float, anew: str = journal.ANEW) -> float:
    """Speed at which a journal's points were measured, and the next ones are, rad/s.

    Parameters
    ----------
    header
        Of the run that began the journal.
    now_rad_s
        At which the rotor turns now.
    anew
        What else there is to do, as an error tells it.

    Raises
    ------
    JournalError
        The rotor has another speed by now.
    """
    began = float(header.get("about", {}).get("speed_rad_s", now_rad_s))
    if same(began, now_rad_s):
        return began
    raise JournalError(
        f"the rotor turned at {began:.4g} rad/s when this campaign began, and turns at {now_rad_s:.4g} rad/s now: one "
        f"sweep has one speed; bring it to that speed to go on; otherwise {anew}"
    )


def profile_of(document: dict[str, Any]) -> Profile | MultisineProfile:
    """The profile that a journal keeps; TypeError when another version wrote it."""
    if "multisine" in document:
        return MultisineProfile(**document["multisine"])
    lists = {name: tuple(value) for name, value in document.items() if isinstance(value, list)}
    return Profile(**document | lists)
