"""Pictures of an estimate: states with their intervals beside what was measured, and whether the filter can be
believed.
"""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np

from crane_exudyn import plots
from crane_exudyn.plots import Shown

from .monitor import FROZEN, OUTLIER

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from crane_exudyn.layout import Layout

    from .estimate import Estimate

_BLUE, _BLACK, _RED, _GREY = "#0072B2", "#111111", "#D55E00", "#999999"
_MODELS = (_BLUE, _RED, "#009E73", "#CC79A7", _BLACK)
_MOST = 4000


def estimate_figure(estimate: Estimate, truth: np.ndarray | None = None) -> Figure:
    """Return a figure for a screen: one panel a quantity on the left, normalised innovations and NIS on the right.

    Args:
        estimate: N instants, n quantities, k sensors.
        truth: (N, m) true values of the first m quantities, drawn dashed where they are known.
    """
    left, right = len(estimate.state_names), len(estimate.channel_names) + 1 + bool(estimate.models)
    rows = max(left, right)
    made = plots.figure(rows, 2, height=1.25, width=2 * plots.WIDTH)
    for i in range(left):
        _state(made.axes[2 * i], estimate, i, truth)
    _judged(made.axes[1 : 2 * right : 2], estimate)
    for column, used in ((0, left), (1, right)):
        _end(made.axes[2 * used - 2 + column])
        for row in range(used, rows):
            made.axes[2 * row + column].set_visible(False)
    _finish(made, estimate, columns=6)
    return made


def states_figure(estimate: Estimate, truth: np.ndarray | None = None) -> Figure:
    """Return a figure with one panel a quantity, in one column; `truth` (N, m) as in `estimate_figure`."""
    made = plots.figure(len(estimate.state_names), height=1.25)
    for i, axes in enumerate(made.axes):
        _state(axes, estimate, i, truth)
    _end(made.axes[-1])
    _finish(made, None)
    return made


def innovations_figure(estimate: Estimate) -> Figure:
    """Return a figure with the normalised innovations of each sensor and the NIS, in one column."""
    made = plots.figure(len(estimate.channel_names) + 1 + bool(estimate.models), height=1.25)
    _judged(made.axes, estimate)
    _end(made.axes[-1])
    _finish(made, None)
    return made


def _judged(panels: Sequence[Axes], estimate: Estimate) -> None:
    """Draw the innovations of each sensor, the NIS, and how probable each model was where there were several."""
    for k in range(len(estimate.channel_names)):
        _innovation(panels[k], estimate, k)
    _nis(panels[len(estimate.channel_names)], estimate)
    if estimate.models:
        _models(panels[-1], estimate)


def display(name: str, unit: str, layout: Layout) -> tuple[float, str]:
    """Return factor and unit in which people read a quantity of a machine: degrees and bar."""
    what = plots.shown(name, unit, layout)
    return what.factor, what.unit


def _finish(made: Figure, estimate: Estimate | None, columns: int = 3) -> None:
    if estimate is not None:
        low, high = estimate.nis_bounds
        with plots.style():
            made.suptitle(
                f"Estimate of {estimate.crane} by {estimate.method}: mean NIS {estimate.nis_mean:.3g} "
                f"(expected {low:.3g} … {high:.3g}), {estimate.verdict}",
                fontsize=11,
            )
    made.align_ylabels()
    plots.legend_above(made, columns, "outside upper left" if estimate is None else "outside lower left")


def _end(axes: Axes) -> None:
    """Name the time axis below the last panel of a column."""
    with plots.style():
        axes.set_xlabel("time / s")
        axes.tick_params(labelbottom=True)


def _what(estimate: Estimate, name: str) -> Shown:
    return plots.shown(name, estimate.units.get(name, ""), estimate.layout)


def _thin(count: int) -> slice:
    return slice(None, None, max(1, count // _MOST))


def _state(axes: Axes, estimate: Estimate, i: int, truth: np.ndarray | None) -> None:
    name = estimate.state_names[i]
    what = _what(estimate, name)
    part = _thin(estimate.time.size)
    time, mean = estimate.time[part], estimate.mean[part, i] * what.factor
    half = 1.96 * estimate.std[part, i] * what.factor
    floor = estimate.floor * what.factor if i in range(estimate.mean.shape[1])[estimate.pressures] else -np.inf
    lower = np.maximum(mean - half, floor)
    with plots.style():
        axes.fill_between(time, lower, mean + half, color=_BLUE, alpha=0.25, lw=0, label="95 % interval")
        if name in estimate.channel_names:
            _dots(axes, estimate, estimate.channel_names.index(name), what.factor)
        axes.plot(time, mean, color=_BLUE, lw=1.2, label="estimated")
        if truth is not None and i < truth.shape[1]:
            axes.plot(
                time,
                np.maximum(truth[part, i] * what.factor, floor),
                color=_BLACK,
                lw=1.0,
                ls=(0, (4, 2)),
                label="true",
            )
    settled = slice(time.size // 6, None)  # the interval at the start may be a hundred times as wide
    low, high = min(mean.min(), lower[settled].min()), max(mean.max(), (mean + half)[settled].max())
    _widen(axes, low, high)
    plots.name_axes(axes, what)


def _widen(axes: Axes, low: float, high: float) -> None:
    """Set limits that hold all lines and low … high, with a margin; the band alone may reach beyond."""
    lines = [np.asarray(line.get_ydata(), dtype=float) for line in axes.get_lines()]
    low, high = min([low, *(y.min() for y in lines)]), max([high, *(y.max() for y in lines)])
    margin = 0.06 * (high - low) or 0.05 * abs(high) or 1.0
    axes.set_ylim(low - margin, high + margin)


def _dots(axes: Axes, estimate: Estimate, k: int, factor: float) -> None:
    values = estimate.measured[:, k] * factor
    known = np.flatnonzero(np.isfinite(values))[_thin(int(np.isfinite(values).sum()))]
    axes.plot(estimate.time[known], values[known], ".", ms=2.5, color=_GREY, zorder=1, label="measured")
    bad = np.flatnonzero((estimate.flags[:, k] == OUTLIER) | (estimate.flags[:, k] == FROZEN))
    if bad.size:
        axes.plot(estimate.time[bad], values[bad], "x", ms=4, color=_RED, zorder=2, label="rejected")


def _innovation(axes: Axes, estimate: Estimate, k: int) -> None:
    name = estimate.channel_names[k]
    scaled = estimate.innovation[:, k] / estimate.innovation_std[:, k]
    known = np.flatnonzero(np.isfinite(scaled))
    known = known[_thin(known.size)]
    p = estimate.whiteness[name]
    with plots.style():
        axes.plot(estimate.time[known], scaled[known], ".", ms=1.8, color=_BLACK, label="innovation / its std")
        beyond = known[np.abs(scaled[known]) > 6.0]
        if beyond.size:
            at = np.clip(scaled[beyond], -5.7, 5.7)
            axes.plot(estimate.time[beyond], at, "x", ms=3, color=_RED, label="beyond 6")
        axes.axhspan(-1.96, 1.96, color=_BLUE, alpha=0.15, lw=0, label="where 95 % should be")
        axes.set_ylim(-6, 6)
        white = f"white: p {'< 0.001' if p < 1e-3 else f'= {p:.2g}'}" if np.isfinite(p) else "too few samples to judge"
        axes.set_title(white, fontsize=9, loc="right", pad=3.0)
    plots.name_axes(axes, _what(estimate, name)._replace(unit=""))


def _nis(axes: Axes, estimate: Estimate) -> None:
    known = np.isfinite(estimate.nis) & (estimate.dof > 0)
    time, ratio = estimate.time[known], estimate.nis[known] / estimate.dof[known]
    window = max(1, ratio.size // 100)
    count = ratio.size // window
    with plots.style():
        if count:
            blocks = ratio[: count * window].reshape(count, window).mean(axis=1)
            axes.step(time[: count * window : window], blocks, where="post", color=_BLACK, lw=1.0, label="NIS a sensor")
        axes.axhline(1.0, color=_BLUE, lw=1.0)
        axes.set_yscale("log")
        low, high = axes.get_ylim()
        axes.set_ylim(min(low, 0.5), max(high, 2.0))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("")
    plots.name_axes(axes, Shown("normalised innovation squared, a sensor", "NIS", 1.0, ""))


def _models(axes: Axes, estimate: Estimate) -> None:
    part = _thin(estimate.time.size)
    with plots.style():
        drawn = [(p[part], colour) for p, colour in zip(estimate.models.values(), cycle(_MODELS), strict=False)]
        for (probability, colour), name in zip(drawn, estimate.models, strict=True):
            axes.plot(estimate.time[part], probability, color=colour, lw=1.2, label=name)
        axes.set_ylim(-0.05, 1.05)
    plots.name_axes(axes, Shown("how probable each model is", "probability", 1.0, ""))
