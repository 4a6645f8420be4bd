"""Pictures of an estimate: states with their intervals beside what was measured, and whether the filter can be
believed. They are drawn from series; `Estimate` says which.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from crane_exudyn import plots
from crane_exudyn.plots import Shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BLUE, _BLACK, _RED, _GREY = "#0072B2", "#111111", "#D55E00", "#999999"
_MODELS = ("#E69F00", "#009E73", "#CC79A7", "#56B4E9", _BLACK)  # none of them stands for anything beside it
_MOST = 4000
#: height of a panel, inches
_PANEL = 1.25


class Reading(NamedTuple):
    """What a sensor showed: values (N,) in SI, NaN where there was no sample, and which of them were rejected (N,)."""

    values: np.ndarray
    rejected: np.ndarray


class Line(NamedTuple):
    """One estimated quantity over time, in SI.

    Attributes:
        what: how people call and read it.
        mean, std: (N,).
        floor: the lowest value that is shown.
        truth: (N,), where it is known.
        reading: of the sensor that shows it, where there is one.
    """

    what: Shown
    mean: np.ndarray
    std: np.ndarray
    floor: float
    truth: np.ndarray | None
    reading: Reading | None


class Innovation(NamedTuple):
    """Innovations of one sensor in units of their standard deviations (N,), and the p-value of their whiteness."""

    what: Shown
    scaled: np.ndarray
    white: float


class Judgement(NamedTuple):
    """What a filter is judged by: innovations by sensor, NIS a sensor (N,), how probable (N,) each model was."""

    innovations: Sequence[Innovation]
    nis: np.ndarray
    models: Mapping[str, np.ndarray]

    @property
    def panels(self) -> int:
        """How many panels show it."""
        return len(self.innovations) + 1 + bool(self.models)


def estimate_figure(time: np.ndarray, lines: Sequence[Line], judged: Judgement, title: str) -> Figure:
    """Return a figure for a screen: one panel a quantity on the left, normalised innovations and NIS on the right."""
    height = max(_PANEL * max(len(lines), judged.panels), 2.0)
    with plots.style():
        made = plots.empty_figure(2 * plots.WIDTH, height, layout="constrained")
        # columns of their own: in one grid the time axis of the shorter one would part the longer one's panels
        grid = made.add_gridspec(1, 2)
        left, right = (
            made.add_subfigure(grid[0, column]).subplots(count, 1, sharex=True, squeeze=False)[:, 0]
            for column, count in enumerate((len(lines), judged.panels))
        )
        made.suptitle(title, fontsize=11)
    for axes, line in zip(left, lines, strict=True):
        _state(axes, time, line)
    _judged(list(right), time, judged)
    for panels in (left, right):
        _end(panels[-1])
        made.align_ylabels(list(panels))
    plots.legend_above(made, 6, "outside lower left")
    return made


def states_figure(time: np.ndarray, lines: Sequence[Line]) -> Figure:
    """Return a figure with one panel a quantity, in one column."""
    made = plots.figure(len(lines), height=_PANEL)
    for axes, line in zip(made.axes, lines, strict=True):
        _state(axes, time, line)
    return _column(made)


def innovations_figure(time: np.ndarray, judged: Judgement) -> Figure:
    """Return a figure with the normalised innovations of each sensor and the NIS, in one column."""
    made = plots.figure(judged.panels, height=_PANEL)
    _judged(made.axes, time, judged)
    return _column(made)


def _column(made: Figure) -> Figure:
    _end(made.axes[-1])
    made.align_ylabels()
    plots.legend_above(made, 3, "outside upper left")
    return made


def _judged(panels: Sequence[Axes], time: np.ndarray, judged: Judgement) -> None:
    """Draw the innovations of each sensor, the NIS, and how probable each model was where there were several."""
    for axes, innovation in zip(panels, judged.innovations, strict=False):
        _innovation(axes, time, innovation)
    _nis(panels[len(judged.innovations)], time, judged.nis)
    if judged.models:
        _models(panels[-1], time, judged.models)


def _end(axes: Axes) -> None:
    """Name the time axis below the last panel of a column."""
    with plots.style():
        axes.set_xlabel("time / s")
        axes.tick_params(labelbottom=True)


def _thin(count: int) -> slice:
    return slice(None, None, max(1, count // _MOST))


def _state(axes: Axes, time: np.ndarray, line: Line) -> None:
    part, factor = _thin(time.size), line.what.factor
    at, mean, half = time[part], line.mean[part] * factor, 1.96 * line.std[part] * factor
    floor = line.floor * factor
    lower = np.maximum(mean - half, floor)
    with plots.style():
        axes.fill_between(at, lower, mean + half, color=_BLUE, alpha=0.25, lw=0, label="95 % interval")
        if line.reading is not None:
            _dots(axes, time, line.reading, factor)
        axes.plot(at, mean, color=_BLUE, lw=1.2, label="estimated")
        if line.truth is not None:
            true = np.maximum(line.truth[part] * factor, floor)
            axes.plot(at, true, color=_BLACK, lw=1.0, ls=(0, (4, 2)), label="true")
    settled = slice(at.size // 6, None)  # the interval at the start may be a hundred times as wide
    low, high = min(mean.min(), lower[settled].min()), max(mean.max(), (mean + half)[settled].max())
    _widen(axes, low, high)
    plots.name_axes(axes, line.what)


def _widen(axes: Axes, low: float, high: float) -> None:
    """Set limits that hold all lines and low … high, with a margin; the band alone may reach beyond."""
    lines = [np.asarray(line.get_ydata(), dtype=float) for line in axes.get_lines()]
    low, high = min([low, *(y.min() for y in lines)]), max([high, *(y.max() for y in lines)])
    margin = 0.06 * (high - low) or 0.05 * abs(high) or 1.0
    axes.set_ylim(low - margin, high + margin)


def _dots(axes: Axes, time: np.ndarray, reading: Reading, factor: float) -> None:
    values = reading.values * factor
    known = np.flatnonzero(np.isfinite(values))
    known = known[_thin(known.size)]
    axes.plot(time[known], values[known], ".", ms=2.5, color=_GREY, zorder=1, label="measured")
    if reading.rejected.any():
        bad = reading.rejected
        axes.plot(time[bad], values[bad], "x", ms=4, color=_RED, zorder=2, label="rejected")


def _innovation(axes: Axes, time: np.ndarray, innovation: Innovation) -> None:
    scaled, p = innovation.scaled, innovation.white
    known = np.flatnonzero(np.isfinite(scaled))
    known = known[_thin(known.size)]
    with plots.style():
        axes.plot(time[known], scaled[known], ".", ms=1.8, color=_BLACK, label="innovation / its std")
        beyond = known[np.abs(scaled[known]) > 6.0]
        if beyond.size:
            at = np.clip(scaled[beyond], -5.7, 5.7)
            axes.plot(time[beyond], at, "x", ms=3, color=_RED, label="beyond 6")
        axes.axhspan(-1.96, 1.96, color=_BLUE, alpha=0.15, lw=0, label="95 % should be here")
        axes.set_ylim(-6, 6)
        white = f"white: p {'< 0.001' if p < 1e-3 else f'= {p:.2g}'}" if np.isfinite(p) else "too few samples to judge"
        axes.set_title(white, fontsize=9, loc="right", pad=3.0)
    plots.name_axes(axes, innovation.what._replace(unit=""))


def _nis(axes: Axes, time: np.ndarray, nis: np.ndarray) -> None:
    known = np.isfinite(nis)
    time, ratio = time[known], nis[known]
    window = max(1, ratio.size // 100)
    count = ratio.size // window
    with plots.style():
        if count:
            blocks = ratio[: count * window].reshape(count, window).mean(axis=1)
            axes.step(
                time[: count * window : window], blocks, where="post", color=_BLACK, lw=1.0, label="NIS per sensor"
            )
        axes.axhline(1.0, color=_BLUE, lw=1.0)
        axes.set_yscale("log")
        low, high = axes.get_ylim()
        axes.set_ylim(min(low, 0.5), max(high, 2.0))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("")
    plots.name_axes(axes, Shown("normalised innovation squared per sensor", "NIS", 1.0, ""))


def _models(axes: Axes, time: np.ndarray, models: Mapping[str, np.ndarray]) -> None:
    part = _thin(time.size)
    with plots.style():
        for (name, probability), colour in zip(models.items(), cycle(_MODELS), strict=False):
            axes.plot(time[part], probability[part], color=colour, lw=1.2, label=name)
        axes.set_ylim(-0.05, 1.05)
    plots.name_axes(axes, Shown("probability of each model", "probability", 1.0, ""))
