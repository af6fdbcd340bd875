"""What a gap means for the loop, of the report of a diagnosis: peaks of sensitivity, stiffness, the nu-gap."""

from __future__ import annotations

from typing import Any

from service.report import gap_figures as draw
from service.report.format import count, decibel, fixed, number, paragraph, signed, table
from service.report.page import Captioned

SEEN_DB = 0.1
"""Difference of two peaks that is told."""
LISTED = 6
"""Frequencies that are told one by one."""
EXTREMES = {
    "sensitivity": ("largest |S|", 1.0, 2),
    "complementary_sensitivity": ("closed loop: largest |T|", 1.0, 2),
    "dynamic_stiffness": ("smallest dynamic stiffness, N/µm", 1e-6, 3),
}
"""What a quantity's extreme is called, its scale and its digits."""


def loop_parts(document: dict[str, Any]) -> list[str | Captioned]:
    """The section's parts; a sentence where the loop could not be compared."""
    loop = document.get("loop") or {}
    peaks = loop.get("sensitivity_peak")
    if not peaks:
        return [
            paragraph("At fewer than three lines every axis was excited and had settled: the loop cannot be compared.")
        ]
    parts: list[str | Captioned] = [paragraph(told, "note") for told in _left_out(loop)]
    parts.append(_peaks(loop))
    parts += [_extremes(name, of, bool(loop["not_settled_hz"])) for name, of in loop["extremes"].items()]
    nu_gap = draw.nu_gap_figure(document)
    if nu_gap is not None:
        largest = loop["nu_gap"]
        parts.append(
            Captioned(
                nu_gap,
                "Pointwise ν-gap between the measured loop and the twin's: at most "
                f"{number(largest['largest_before'], 3)} before, {number(largest['largest_after'], 3)} after; nought "
                f"is the same, one as far as can be.{_without(loop)}",
            )
        )
    return parts


def _left_out(loop: dict[str, Any]) -> list[str]:
    """Why what is measured of the loop lacks lines, and what that does to its peaks."""
    told = []
    if restless := loop["not_settled_hz"]:
        where = ", ".join(number(f, 4) for f in restless)
        if len(restless) > LISTED:
            where = f"{number(restless[0], 4)} to {number(restless[-1], 4)}"
        were, they = ("was", "it") if len(restless) == 1 else ("were", "them")
        change = fixed(100 * loop["not_settled_change"], 0)
        told.append(
            f"{count(len(restless), 'line')} had not settled and {were} left out of what is measured here: at {where} "
            f"Hz an answer still changed by up to {change} %. {_effect(loop, they)}"
        )
    if single := loop["not_every_axis_hz"]:
        told.append(f"Left out, for not every axis was excited there: {count(len(single), 'line')}.")
    return told


def _effect(loop: dict[str, Any], they: str) -> str:
    """What the lines that had not settled do to the measured peaks; ``they`` stands for those lines."""
    without, whole = loop["sensitivity_peak"]["measured"], loop["sensitivity_peak_with_not_settled"]["measured"]
    higher = max((decibel(whole[axis]) or 0.0) - (decibel(without[axis]) or 0.0) for axis in without)
    if higher < SEEN_DB:
        return f"The measured peaks of |S| are the same with {they}."
    return (
        f"|S| is largest there: with {they} its measured peak is up to {fixed(higher, 1)} dB higher, though known no "
        "better than that change."
    )


def _peaks(loop: dict[str, Any]) -> str:
    """Peaks of |S| at the measured lines, with and without those that had not settled."""
    peaks, whole = loop["sensitivity_peak"], loop["sensitivity_peak_with_not_settled"]
    rows = []
    for axis in peaks["measured"]:
        rows.append([f"{axis}, lines that had settled" if whole else axis, *_of_axis(peaks, axis)])
        if whole:
            rows.append([f"{axis}, with those that had not", *_of_axis(whole, axis)])
    head = ["peak |S| at the measured lines, dB", "measured", "before", "after", "error before", "error after"]
    return table(head, rows)


def _of_axis(peaks: dict[str, Any], axis: str) -> list[str]:
    seen, was, now = (decibel(peaks[k][axis]) or 0.0 for k in ("measured", "before", "after"))
    return [fixed(seen, 2), fixed(was, 2), fixed(now, 2), signed(was - seen), signed(now - seen)]


def _without(loop: dict[str, Any]) -> str:
    missing = len(loop["not_settled_hz"]) + len(loop["not_every_axis_hz"])
    return f" {count(missing, 'line')} left out, as above." if missing else ""


def _extremes(quantity: str, by_axis: dict[str, Any], some_left_out: bool) -> str:
    """Extreme of a quantity: measured at the lines, predicted between them too, each with standard deviation."""
    name, scale, digits = EXTREMES[quantity]

    def told(e: dict[str, Any]) -> str:
        spread = "" if e["std"] is None else f" ± {number(scale * e['std'], 2)}"
        return f"{fixed(scale * e['value'], digits)}{spread} at {number(e['frequency_hz'], 4)} Hz"

    rows = [[axis, *(told(of[k]) for k in ("measured", "before", "after"))] for axis, of in by_axis.items()]
    lines = "measured, at its settled lines" if some_left_out else "measured, at its lines"
    return table([name, lines, "before, between them too", "after, between them too"], rows)
