"""What a job of the service found, in one line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from service.client import Client, Job


def verdict(ambit: Client, job: Job) -> str:
    """The job's last and most telling result; empty for one that only measured."""
    made = job.result
    if "health" in made:
        return ambit.health.get(made["health"]).sentence
    if "gap" in made:
        told = ambit.gaps.document(made["gap"])["verdict"]
        return str(told.get("sentence") or told["kind"])
    if "model" in made:
        return identified(ambit.models.get(made["model"]).summary)
    return ""


def identified(summary: dict[str, Any]) -> str:
    """Current factors, position stiffness and zone of a model, by plane; of one that says nothing, the sentence.

    >>> ki = {"value": 181.0224, "std": 0.0271, "unit": "N/A"}
    >>> identified({"planes": {"x": {"stiffness": {"kiA": ki, "kiB": ki}, "iso_14839_3_zone": "A"}}})
    'x: kiA 181.022 ± 0.027, kiB 181.022 ± 0.027 N/A, zone A'
    """
    from service.report.format import figures

    if summary.get("tone") == "bad":
        return str(summary["sentence"])
    told = []
    for plane, p in summary["planes"].items():
        parts = []
        for prefix in ("ki", "ks"):
            same = {name: e for name, e in p["stiffness"].items() if name.startswith(prefix)}
            shown = [" ".join((name, "{} ± {}".format(*figures(e["value"], e["std"])))) for name, e in same.items()]
            if same:
                parts.append(f"{', '.join(shown)} {next(iter(same.values()))['unit']}")
        parts.append("zone " + p["iso_14839_3_zone"])
        if not p.get("model_adequate", True):
            parts.append("model not adequate")
        told.append(f"{plane}: {', '.join(parts)}")
    return "; ".join(told)
