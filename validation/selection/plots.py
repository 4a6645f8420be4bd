"""Pictures of a diagnosis and of an improvement, drawn from their numbers; they say which."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from crane_exudyn.effects.registry import in_words

from ..plots import OTHERS, figure, legend_above, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PLAIN, _CHOSEN, _RIVAL = "#b8c4ce", OTHERS[2].color, "#d9dee3"
_HATCH = "///"


def diagnosis_figure(
    gains: Mapping[str, float], chosen: str, errors: Mapping[str, Sequence[float]], found: str = "with the result"
) -> Figure:
    """Return a figure: what explanations gain in evidence over the parameters alone, and the errors.

    Args:
        gains: by explanation, best first.
        chosen: which of them it was.
        errors: of the crane as given, and with what was found where something was, in units of the noise; by what the
            recordings were for.
        found: what the second of these errors are of.
    """
    weighed = len(gains) > 1
    made = figure(1 + weighed, height=2.0 if weighed else 2.4, sharex=False)
    with style():
        if weighed:
            made.set_size_inches(made.get_figwidth(), 3.2 + 0.32 * len(gains))
            _gains(made.axes[0], gains, chosen)
        _errors(made.axes[-1], errors, found)
    legend_above(made)
    return made


def _gains(axes: Axes, gains: Mapping[str, float], chosen: str) -> None:
    for i, (name, gain) in enumerate(gains.items()):
        axes.barh(i, gain, 0.7, edgecolor="white", color=_CHOSEN if name == chosen else _RIVAL)
        axes.annotate(f"{gain:.0f}", (gain, i), (4, 0), textcoords="offset points", va="center", fontsize=8)
    axes.set_yticks(range(len(gains)), [in_words(name).replace(" + ", "\n+ ") for name in gains])
    axes.invert_yaxis()
    axes.set_xscale("symlog", linthresh=10.0)
    axes.margins(x=0.12)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("gain in log evidence over parameters alone")
    axes.grid(axis="y", visible=False)


def _errors(axes: Axes, errors: Mapping[str, Sequence[float]], found: str) -> None:
    known = {name: e for name, e in errors.items() if not math.isnan(e[0])}
    shown = (("as given", (_PLAIN, _HATCH)), (found, (_CHOSEN, "")))
    for k, ((label, look), values) in enumerate(zip(shown, zip(*known.values(), strict=True), strict=False)):
        at = [i + 0.4 * k - 0.2 for i in range(len(known))]
        bars = axes.barh(at, values, 0.36, color=look[0], hatch=look[1], edgecolor="white", label=label)
        axes.bar_label(bars, fmt="%.3g", padding=4, fontsize=8)
    axes.axvline(1.0, color="#111111", lw=0.9, ls=":", label="nothing left but noise")
    axes.set_yticks(range(len(known)), list(known))
    axes.invert_yaxis()
    _noise_axis(axes, [v for values in known.values() for v in values], "x")
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


def improvement_figure(added: Sequence[str], errors: Mapping[str, Sequence[float]]) -> Figure:
    """Return a figure of the errors falling from step to step.

    Args:
        added: what each step but the first, the crane as given, added.
        errors: at each step, in units of the noise, by what the recordings were for.
    """
    made = figure(height=3.0)
    axes = made.axes[0]
    names = ["as given", *(f"+ {in_words(name)}".replace(" (", "\n(") for name in added)]
    known = {label: values for label, values in errors.items() if not math.isnan(values[0])}
    with style():
        for (label, values), marker, look in zip(known.items(), "os", OTHERS, strict=False):
            drawn: dict[str, Any] = {"color": look.color, "linestyle": look.dashes, "linewidth": look.width}
            axes.plot(range(len(names)), values, marker=marker, label=label, **drawn)
        axes.axhline(1.0, color="#111111", lw=0.9, ls=":", label="nothing left but noise")
        axes.set_xticks(range(len(names)), names)
        axes.margins(x=0.2)
        _noise_axis(axes, [v for values in known.values() for v in values], "y")
    legend_above(made)
    return made
