"""What has to hold before a campaign begins or goes on: controller, datasheet and journal fit one another."""

from __future__ import annotations

from dataclasses import asdict
from hashlib import sha256
from typing import Any

from drivers.controller import Capabilities
from service.experiment import journal, multisine_plan
from service.experiment.aims import Limits, Profile
from service.experiment.errors import CampaignError
from service.experiment.multisine_plan import MultisineProfile
from sim.datasheet import Datasheet
from sim.rig_file import to_toml


def checked_limits(capabilities: Capabilities, datasheet: Datasheet) -> Limits:
    """Limits of controller and datasheet together.

    Raises
    ------
    CampaignError
        They describe different rigs.
    """
    c = capabilities
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
        "limits": asdict(limits),
        "datasheet_sha256": sha256(to_toml(datasheet).encode()).hexdigest(),
        "profile": multisine_plan.documented(profile) if isinstance(profile, MultisineProfile) else asdict(profile),
    }


def profile_of(document: dict[str, Any]) -> Profile | MultisineProfile:
    """The profile that a journal keeps; TypeError when another version wrote it."""
    if "multisine" in document:
        return MultisineProfile(**document["multisine"])
    return Profile(**document)
