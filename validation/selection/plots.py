"""Pictures of a diagnosis and of an improvement."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ..plots import OTHERS, figure, legend_above, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..diagnosis import Diagnosis
    from ..improvement import Improvement

_SHOWN = 8
_PLAIN, _CHOSEN = "#b8c4ce", OTHERS[2].color
_HATCH = "///"


def in_words(key: str) -> str:
    """Return effects as people say them: "internal leakage (lift)" of "internal_leakage@lift", several joined by " +
    ".
    """
    said = []
    for part in key.split(" + "):
        name, _, place = part.partition("@")
        said.append(name.replace("_", " ") + (f" ({place})" if place else ""))
    return " + ".join(said)


def diagnosis_figure(d: Diagnosis) -> Figure:
    """Return a figure: what each explanation gains in evidence over the parameters alone, and the error it leaves."""
    shown = d.candidates[:_SHOWN]
    weighed = len(shown) > 1
    made = figure(1 + weighed, height=2.0 if weighed else 2.4, sharex=False)
    with style():
        if weighed:
            made.set_size_inches(made.get_figwidth(), 3.2 + 0.32 * len(shown))
            _gains(made.axes[0], d)
        _errors(made.axes[-1], d)
    legend_above(made)
    return made


def _gains(axes: Axes, d: Diagnosis) -> None:
    shown = d.candidates[:_SHOWN]
    alone = next((c.evidence for c in d.candidates if not c.effects), d.candidates[-1].evidence)
    gains = [max(c.evidence - alone, 0.0) for c in shown]
    for chosen in (True, False):
        rows = [i for i, c in enumerate(shown) if (c.effects == d.effects) == chosen]
        look: dict[str, Any] = {"color": _CHOSEN if chosen else _PLAIN, "hatch": "" if chosen else _HATCH}
        axes.barh(rows, [gains[i] for i in rows], 0.7, edgecolor="white", **look)
    for i, gain in enumerate(gains):
        axes.annotate(f"{gain:.0f}", (gain, i), (4, 0), textcoords="offset points", va="center", fontsize=8)
    axes.set_yticks(range(len(shown)), [in_words(c.name).replace(" + ", "\n+ ") for c in shown])
    axes.invert_yaxis()
    axes.set_xscale("symlog", linthresh=10.0)
    axes.margins(x=0.12)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("gain in log evidence over parameters alone")
    axes.grid(axis="y", visible=False)


def _errors(axes: Axes, d: Diagnosis) -> None:
    pairs = [
        ("learned from", d.error_before, d.error_after),
        ("only predicted", d.check_error_before, d.check_error_after),
    ]
    pairs = [p for p in pairs if not math.isnan(p[1])]
    shown = [("as given", (_PLAIN, _HATCH)), ("with what was found", (_CHOSEN, ""))]
    for k, (label, look) in enumerate(shown[: 1 + (d.crane is not d.given)]):
        at = [i + 0.4 * k - 0.2 for i in range(len(pairs))]
        bars = axes.barh(
            at, [p[1 + k] for p in pairs], 0.36, color=look[0], hatch=look[1], edgecolor="white", label=label
        )
        axes.bar_label(bars, fmt="%.3g", padding=4, fontsize=8)
    axes.axvline(1.0, color="#111111", lw=0.9, ls=":", label="nothing left but noise")
    axes.set_yticks(range(len(pairs)), [p[0] for p in pairs])
    axes.invert_yaxis()
    _noise_axis(axes, [v for p in pairs for v in p[1:]], "x")
    axes.grid(axis="y", visible=False)


def _noise_axis(axes: Axes, values: Sequence[float], which: str) -> None:
    """Make an axis of errors in units of noise logarithmic, with plain numbers, from below 1 to above the greatest."""
    known = [v for v in values if math.isfinite(v) and v > 0.0]
    low, high = 0.5 * min([1.0, *known]), 1.8 * max([2.0, *known])
    axis = axes.xaxis if which == "x" else axes.yaxis
    (axes.set_xscale if which == "x" else axes.set_yscale)("log")
    (axes.set_xlim if which == "x" else axes.set_ylim)(low, high)
    ticks = [t for t in (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 1e4) if low <= t <= high]
    axis.set_ticks(ticks, labels=[f"{t:g}" for t in ticks])
    axis.set_ticks([], minor=True)
    axis.set_label_text("open-loop error / noise")


def improvement_figure(result: Improvement) -> Figure:
    """Return a figure of the error falling from step to step."""
    made = figure(height=3.0)
    axes = made.axes[0]
    names = ["as given", *(f"+ {in_words(s.added or '')}".replace(" (", "\n(") for s in result.steps[1:])]
    lines = [("learned from", "o", OTHERS[0], [s.error for s in result.steps])]
    if not math.isnan(result.steps[0].check_error):
        lines.append(("only predicted", "s", OTHERS[1], [s.check_error for s in result.steps]))
    with style():
        for label, marker, look, errors in lines:
            drawn: dict[str, Any] = {"color": look.color, "linestyle": look.dashes, "linewidth": look.width}
            axes.plot(range(len(names)), errors, marker=marker, label=label, **drawn)
        axes.axhline(1.0, color="#111111", lw=0.9, ls=":", label="nothing left but noise")
        axes.set_xticks(range(len(names)), names)
        axes.margins(x=0.2)
        _noise_axis(axes, [e for *_, errors in lines for e in errors], "y")
    legend_above(made)
    return made
