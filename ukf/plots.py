"""The picture of an estimate: states with their intervals beside what was measured, and whether the filter can be believed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .monitor import FROZEN, OUTLIER

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .estimate import Estimate

_BLUE, _BLACK, _RED, _GREY = "#0072B2", "#111111", "#D55E00", "#999999"
_MOST = 4000


def estimate_figure(estimate: Estimate, truth: np.ndarray | None = None) -> Figure:
    """Return a figure: one panel a quantity on the left, normalised innovations and NIS on the right.

    Args:
        estimate: N instants, n quantities, k sensors.
        truth: (N, m) true values of the first m quantities, drawn dashed where they are known.
    """
    from matplotlib.figure import Figure

    left, right = len(estimate.state_names), len(estimate.channel_names) + 1
    rows = max(left, right)
    figure = Figure(figsize=(13, 1.25 * rows + 0.9), layout="constrained")
    grid = figure.add_gridspec(rows, 2, width_ratios=(1.5, 1.0))
    first = None
    for i in range(left):
        axes = figure.add_subplot(grid[i, 0], sharex=first)
        first = first or axes
        _state(axes, estimate, i, truth)
    for k in range(right - 1):
        _innovation(figure.add_subplot(grid[k, 1], sharex=first), estimate, k)
    _nis(figure.add_subplot(grid[right - 1, 1], sharex=first), estimate)
    for axes in figure.axes:
        axes.grid(color="#dddddd", lw=0.6)
        axes.tick_params(labelsize=8)
        axes.spines[["top", "right"]].set_visible(False)
    low, high = estimate.nis_bounds
    figure.suptitle(
        f"Estimate of {estimate.crane} by {estimate.method}: NIS {estimate.nis_mean:.3g} (expected {low:.3g} … {high:.3g}), {estimate.verdict}",
        fontsize=11,
    )
    handles: dict[str, Any] = {}
    for axes in figure.axes:
        handles |= {label: handle for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=6, fontsize=9, frameon=False)
    return figure


def display(name: str, unit: str) -> tuple[float, str]:
    """Return factor and unit in which people read a quantity: degrees and bar."""
    if unit == "rad":
        return float(np.degrees(1.0)), "°"
    if unit == "rad/s":
        return float(np.degrees(1.0)), "°/s"
    return (1e-5, "bar") if unit == "Pa" else (1.0, unit)


def _thin(count: int) -> slice:
    return slice(None, None, max(1, count // _MOST))


def _state(axes: Axes, estimate: Estimate, i: int, truth: np.ndarray | None) -> None:
    name = estimate.state_names[i]
    factor, unit = display(name, estimate.units.get(name, ""))
    part = _thin(estimate.time.size)
    time, mean = estimate.time[part], estimate.mean[part, i] * factor
    half = 1.96 * estimate.std[part, i] * factor
    axes.fill_between(time, mean - half, mean + half, color=_BLUE, alpha=0.25, lw=0, label="95 % interval")
    if name in estimate.channel_names:
        k = estimate.channel_names.index(name)
        _dots(axes, estimate, k, factor)
    axes.plot(time, mean, color=_BLUE, lw=1.2, label="estimated")
    if truth is not None and i < truth.shape[1]:
        axes.plot(time, truth[part, i] * factor, color=_BLACK, lw=1.0, ls=(0, (4, 2)), label="true")
    axes.set_ylabel(f"{name.replace('.', chr(10), 1)}\n/ {unit}" if unit else name, fontsize=8)
    if i == len(estimate.state_names) - 1:
        axes.set_xlabel("time / s", fontsize=9)


def _dots(axes: Axes, estimate: Estimate, k: int, factor: float) -> None:
    values = estimate.measured[:, k] * factor
    known = np.flatnonzero(np.isfinite(values))[_thin(int(np.isfinite(values).sum()))]
    axes.plot(estimate.time[known], values[known], ".", ms=1.5, color=_GREY, zorder=1, label="measured")
    bad = np.flatnonzero((estimate.flags[:, k] == OUTLIER) | (estimate.flags[:, k] == FROZEN))
    if bad.size:
        axes.plot(estimate.time[bad], values[bad], "x", ms=3, color=_RED, zorder=2, label="rejected")


def _innovation(axes: Axes, estimate: Estimate, k: int) -> None:
    name = estimate.channel_names[k]
    scaled = estimate.innovation[:, k] / estimate.innovation_std[:, k]
    known = np.flatnonzero(np.isfinite(scaled))
    known = known[_thin(known.size)]
    axes.plot(
        estimate.time[known], scaled[known], ".", ms=1.2, color=_BLACK, label="innovation / its standard deviation"
    )
    axes.axhspan(-1.96, 1.96, color=_BLUE, alpha=0.15, lw=0)
    axes.set_ylim(-6, 6)
    p = estimate.whiteness[name]
    axes.set_ylabel(name, fontsize=8)
    axes.set_title(
        f"white: p = {p:.2g}" if np.isfinite(p) else "too few samples to judge", fontsize=8, loc="right", pad=2
    )


def _nis(axes: Axes, estimate: Estimate) -> None:
    known = np.isfinite(estimate.nis) & (estimate.dof > 0)
    time, ratio = estimate.time[known], estimate.nis[known] / estimate.dof[known]
    window = max(1, ratio.size // 100)
    count = ratio.size // window
    if count:
        blocks = ratio[: count * window].reshape(count, window).mean(axis=1)
        axes.step(time[: count * window : window], blocks, where="post", color=_BLACK, lw=1.0, label="NIS per sensor")
    axes.axhline(1.0, color=_BLUE, lw=1.0)
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, 0.5), max(high, 2.0))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("")
    axes.set_ylabel("NIS / sensors", fontsize=8)
    axes.set_xlabel("time / s", fontsize=9)
