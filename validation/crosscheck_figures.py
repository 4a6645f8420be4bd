"""Pictures of a cross-check: both engines on top of each other along each manoeuvre, and their difference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crane_exudyn.layout import Layout

from . import plots
from .crosscheck import CrossCheck
from .crosscheck_runs import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figure_of(layout: Layout, runs: Sequence[Run]) -> Figure:
    """Return a figure of one manoeuvre: both engines on top of each other, and below each their difference at every
    step.
    """
    columns = {name: layout.index(name) for name in (*layout.coordinates, *layout.chambers)}
    last = runs[-1]
    made = plots.figure(2 * len(columns), height=1.0)
    for row, (name, i) in enumerate(columns.items()):
        above, below = made.axes[2 * row], made.axes[2 * row + 1]
        lines = {"Exudyn": last.first[:, i], "semi-recursive": last.second[:, i]}
        plots.draw_lines(above, last.time, lines, channel=name, layout=layout)
        what = plots.shown(name, layout=layout)
        for k, run in enumerate(runs):
            t, y = plots.thin(run.time, np.abs(run.first - run.second)[:, i] * what.factor)
            below.semilogy(t, np.maximum(y, 1e-16), label=f"difference, {1e3 * run.step:g} ms", **plots.look("", k))
        plots.plain_powers(below.yaxis)
        plots.name_axes(below, what._replace(words=f"{what.words}: difference", symbol=f"|Δ{what.symbol}|"))
    if last.boils < len(last.time):
        for axes in made.axes:
            label = "vapour reached" if axes is made.axes[1] else ""
            axes.axvline(last.time[last.boils], color="0.6", linewidth=1.0, label=label)
    plots.over_time(made)
    return made


def save_figures(result: CrossCheck, directory: Path) -> list[Path]:
    """Write one picture a manoeuvre to `directory` and return their paths."""
    directory.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, runs in by_name(result.runs).items():
        path = directory / f"crosscheck-{name.replace(' ', '-').replace(chr(39), '')}.png"
        plots.save(figure_of(result.layout, runs), path)
        paths.append(path)
    return paths


def by_name(runs: Sequence[Run]) -> Mapping[str, list[Run]]:
    """Return the runs of each manoeuvre."""
    found: dict[str, list[Run]] = {}
    for run in runs:
        found.setdefault(run.name, []).append(run)
    return found
