"""What the zone of a check asks for. Of its own, for the API imports it, and compares nothing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sim.datasheet import ISO_14839_3_DB, calm_zones


def zone_is_calm(document: Mapping[str, Any]) -> bool:
    """Whether a check, by its health.json, found the rig in a zone in which it may stay.

    A document without ``zone_limits_db``, which an older version wrote, is judged by ISO 14839-3.

    >>> zone_is_calm({"zone": "B"}), zone_is_calm({"zone": "bad", "zone_limits_db": {"good": 9.5}})
    (True, False)
    """
    limits = document.get("zone_limits_db", dict(ISO_14839_3_DB))
    return document["zone"] in calm_zones(limits.items())
