"""How results show themselves in notebooks and reports: tables as HTML, numbers as people write them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from html import escape

_AMOUNT = re.compile(r"[-−+<]? ?\d[\d.]*(e[-−+]?\d+)?( ± [\d.]+)?\*? *")
#: texts longer than this get a column of their own width and break into lines
_LONG = 28
#: tables of at most so many rows stay on one page of paper
_SHORT = 14
#: names longer than this may break after _ and @
_BREAKS = 22


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
