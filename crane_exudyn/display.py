"""How results show themselves in notebooks and reports: tables as HTML, numbers as people write them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from html import escape

from .units import people_of

_AMOUNT = re.compile(r"[-−+<]? ?\d[\d.]*(e[-−+]?\d+)?( ± [\d.]+)?\*? *")
#: texts longer than this get a column of their own width and break into lines
_LONG = 28
#: tables of at most so many rows stay on one page of paper
_SHORT = 14
#: names longer than this may break after _ and @
_BREAKS = 22


#: units in which engineers think beside those of all people, by SI unit, and what one of them is in SI
_ENGINEERING = {
    "m^3/s": ("l/min", 1e-3 / 60.0),
    "m^3/s/Pa": ("l/min at 100 bar", 1e-3 / 60.0 / 1e7), "Pa*s/m^3": ("bar at 100 l/min", 1e5 * 600.0),
    "N*m": ("N m", 1.0),
    "N*m*s": ("N m at 10 deg/s", 18.0 / math.pi), "N/m": ("kN/mm", 1e6), "N*s/m": ("N at 10 mm/s", 1e2),
    "m^2": ("N at 100 bar", 1e-7),
}  # fmt: skip


def engineering(unit: str) -> tuple[str, float]:
    """Return the unit in which engineers read a quantity of an SI unit, and what one of it is in SI: 2e-11 m^3/s/Pa are
    12 l/min at 100 bar.
    """
    return _ENGINEERING.get(unit) or people_of(unit)


def rounded(value: float, uncertainty: float) -> str:
    """Return such as "2.1 ± 0.3": the uncertainty with one leading digit (two below 3), the value to the same place.

    NaN stands for an uncertainty that is not known, and is left out.
    """
    if math.isnan(uncertainty):
        return f"{value:.3g}"
    if not (math.isfinite(uncertainty) and uncertainty > 0.0):
        return f"{value:.3g} ± {uncertainty:g}"
    power = math.floor(math.log10(uncertainty))
    places = -power + (1 if round(uncertainty / 10.0**power, 1) < 3.0 else 0)
    if places >= 0:
        return f"{value:.{places}f} ± {uncertainty:.{places}f}"
    return f"{round(value, places):.0f} ± {round(uncertainty, places):.0f}"


def cell(value: object) -> str:
    """Return a table cell's text: four digits, yes and no, a dash for what is not there."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if hasattr(value, "item") and getattr(value, "ndim", 0) == 0:  # numpy numbers
        return cell(value.item())
    if isinstance(value, float):
        return f"{value:.4g}".replace("-", "−")
    text = str(value)
    return text.replace("-", "−") if _AMOUNT.fullmatch(text) else text


def table_html(columns: Sequence[str], rows: Sequence[Sequence[object]], *, title: str = "", note: str = "") -> str:
    """Return a table as an HTML fragment: numbers right, text left, the title above and the note below.

    Raises:
        ValueError: a row that has not as many cells as there are columns.
    """
    wrong = [row for row in rows if len(row) != len(columns)]
    if wrong:
        raise ValueError(f"table {title!r}: row {wrong[0]!r} has not {len(columns)} cells")
    kinds = [_kind([row[i] for row in rows]) for i in range(len(columns))]
    head = "".join(_tag("th", kind, name) for kind, name in zip(kinds, columns, strict=True))
    body = "\n".join(
        f"<tr>{''.join(_tag('td', kind, cell(v)) for kind, v in zip(kinds, row, strict=True))}</tr>" for row in rows
    )
    caption = f"<caption>{escape(title)}</caption>\n" if title else ""
    below = f'\n<p class="note">{escape(note)}</p>' if note else ""
    short = ' class="short"' if len(rows) <= _SHORT else ""
    table = f"<table{short}>\n{caption}<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table>"
    return f'<div class="scroll">{table}</div>{below}'


def _tag(tag: str, kind: str, text: str) -> str:
    """Return one cell; the alignment stands in it, since notebooks have no style sheet of ours."""
    side = "right" if kind == "n" else "left"
    named = f' class="{kind}"' if kind else ""
    shown = escape(text)
    if len(text) > _BREAKS and " " not in text:  # a long name may break where its words meet
        shown = re.sub(r"([_@])", r"\1<wbr>", shown)
    return f'<{tag}{named} style="text-align:{side}">{shown}</{tag}>'


def _kind(values: Sequence[object]) -> str:
    """Return "n" for a column of numbers, "t" for one of long texts, "" for any other."""
    if values and all(v is None or _is_number(v) for v in values):
        return "n"
    return "t" if any(len(str(v)) > _LONG for v in values) else ""


def _is_number(value: object) -> bool:
    if isinstance(value, str):
        return _AMOUNT.fullmatch(value) is not None
    return (isinstance(value, int | float) and not isinstance(value, bool)) or (
        hasattr(value, "item") and getattr(value, "ndim", 1) == 0
    )
