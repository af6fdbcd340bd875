"""Figures as a person reads them: digits by their uncertainty, units, HTML."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from html import escape

MISSING = "–"


def figures(value: float, std: float) -> tuple[str, str]:
    """A value and its standard deviation, as many digits as the latter allows.

    >>> figures(181.00188, 0.0337), figures(1.680028e6, 312.4), figures(0.0012161, 2.1e-6)
    (('181.002', '0.034'), ('1680030', '310'), ('0.0012161', '0.0000021'))
    >>> figures(5.0, 0.0), figures(-0.01, 1.4)
    (('5', '–'), ('0.0', '1.4'))
    """
    if not (math.isfinite(std) and std > 0 and math.isfinite(value)):
        return number(value), MISSING
    exponent = math.floor(math.log10(std)) - 1
    if exponent <= 0:
        return f"{value:z.{-exponent}f}", f"{std:.{-exponent}f}"
    step = 10**exponent
    return f"{round(value / step) * step}", f"{round(std / step) * step}"


def change(value: float, std: float) -> str:
    """A change with its sign and its standard deviation, as many digits as the latter allows.

    >>> change(-2.97, 0.0451), change(-2.0998e-05, 0.00057), change(0.01, 1.4), change(1.5, 0.0)
    ('-2.970 ± 0.045', '-0.00002 ± 0.00057', '+0.0 ± 1.4', '+1.5')
    """
    shown, spread = figures(value, std)
    told = shown if shown.startswith(("-", MISSING)) else f"+{shown}"
    return told if spread == MISSING else f"{told} ± {spread}"


def in_unit(name: str, unit: str) -> str:
    """A figure's name with its unit, if it has one.

    >>> in_unit("x.kiA", "N/A"), in_unit("x.zeta1", "1")
    ('x.kiA, N/A', 'x.zeta1')
    """
    return name if unit in ("", "1") else f"{name}, {unit}"


PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))


def quantity(value: float, std: float, unit: str) -> tuple[str, str]:
    """A value with its unit, and its standard deviation; seconds and metres get a prefix.

    >>> quantity(34.7e-6, 4.8e-8, "s"), quantity(0.0641, 0.0054, ""), quantity(1e-6, 1.0, "m")
    (('34.700 µs', '0.048'), ('0.0641', '0.0054'), ('1 µm', 'open'))
    >>> quantity(2.83e-7, 1.0, "s"), quantity(0.5, 0.1, "1")
    (('280 ns', 'open'), ('0.50', '0.10'))
    """
    scale, prefix = 1.0, ""
    if unit in ("s", "m") and value:
        scale, prefix = next(((s, p) for s, p in PREFIXES if abs(value) >= s), PREFIXES[-1])
    name = f" {prefix}{unit}" if unit not in ("", "1") else ""
    if std > abs(value) or not math.isfinite(std):
        return f"{number(float(f'{value / scale:.2g}'))}{name}", "open"
    shown, spread = figures(value / scale, std / scale)
    return f"{shown}{name}", spread


def number(value: float | None, digits: int = 6) -> str:
    """A value without an exponent where that stays short.

    >>> number(1.68e6), number(0.00121602), number(3097.0), number(None), number(float("nan"))
    ('1680000', '0.00121602', '3097', '–', '–')
    >>> number(1.2e-9), number(3e12)
    ('1.2e-09', '3e+12')
    """
    if value is None or not math.isfinite(value):
        return MISSING
    if 1e5 <= abs(value) < 1e9:
        return f"{value:.0f}"
    return f"{value:.{digits}g}"


def signed(value: float | None, digits: int = 2) -> str:
    """A value with its sign, fixed digits; what rounds to nought is not told as below it.

    >>> signed(1.234), signed(-0.001), signed(None)
    ('+1.23', '+0.00', '–')
    """
    return MISSING if value is None or not math.isfinite(value) else f"{value:+z.{digits}f}"


def fixed(value: float | None, digits: int = 1) -> str:
    """A value with fixed digits; "–" for none.

    >>> fixed(12.345), fixed(-0.01), fixed(None)
    ('12.3', '0.0', '–')
    """
    return MISSING if value is None or not math.isfinite(value) else f"{value:z.{digits}f}"


def decibel(ratio: float | None) -> float | None:
    """20 lg of a ratio, None for none."""
    return None if ratio is None or not ratio > 0 else 20 * math.log10(ratio)


def duration(seconds: float) -> str:
    """Seconds in words.

    >>> duration(7.4), duration(75), duration(4000)
    ('7 s', '1 min 15 s', '1 h 06 min')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def moment(iso: str) -> str:
    """A time as people write it, to the minute, in UTC.

    >>> moment("2026-11-26T08:49:31.079657Z"), moment("2026-11-26T09:49:31+01:00")
    ('2026-11-26 08:49 UTC', '2026-11-26 08:49 UTC')
    """
    return f"{datetime.fromisoformat(iso).astimezone(UTC):%Y-%m-%d %H:%M} UTC"


def span(values: list[float], digits: int = 4) -> str:
    """Smallest to largest of some values.

    Both with as many decimals as the one that needs more: 1.680 and 1.879 are known alike.

    >>> span([186.0, 181.0]), span([2.0]), span([1.879, 1.68])
    ('181 to 186', '2', '1.680 to 1.879')
    """
    ends = min(values), max(values)
    told = [number(v, digits) for v in ends]
    if told[0] == told[1]:
        return told[0]
    if not any("e" in t for t in told):
        decimals = max(len(t.partition(".")[2]) for t in told)
        told = [fixed(v, decimals) for v in ends]
    return " to ".join(told)


def count(n: int, noun: str) -> str:
    """A count with its noun.

    >>> count(1, "point"), count(3, "point")
    ('1 point', '3 points')
    """
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def table(head: list[str], rows: list[list[str]], caption: str = "", left: int = 1) -> str:
    """An HTML table; the first ``left`` columns are words, the others numbers. Cells are escaped.

    It scrolls in a box of its own where the screen is narrower.

    >>> table(["a", "b"], [["x", "1 < 2"]]).partition("<tbody>")[2]
    '<tr><td>x</td><td class="n">1 &lt; 2</td></tr></tbody></table></div>'
    """

    def row(tag: str, cells: list[str]) -> str:
        kinds = ["" if k < left else ' class="n"' for k in range(len(cells))]
        parts = [f"<{tag}{kind}>{escape(c)}</{tag}>" for kind, c in zip(kinds, cells, strict=True)]
        return f"<tr>{''.join(parts)}</tr>"

    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    body = "".join(row("td", r) for r in rows)
    return f'<div class="scroll"><table>{title}<thead>{row("th", head)}</thead><tbody>{body}</tbody></table></div>'


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    opening = f'<p class="{kind}">' if kind else "<p>"
    return f"{opening}{escape(text)}</p>"
