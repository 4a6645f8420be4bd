"""The equivalents of the paper's Figures 5, 6 and 7."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from . import plots
from .paper import STATES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .paper import Case

_MEASURED = ("z1", "z4", "p1", "p4")


def states(case: Case, names: Sequence[str]) -> Figure:
    """Return measured, true, simulated and estimated states, one panel each."""
    made = plots.figure(len(names), height=1.5)
    time, signals = case.experiment.time, case.experiment.signals.sensors
    for axes, name in zip(made.axes, names, strict=True):
        i = STATES.index(name)
        if name in _MEASURED:
            t, y = plots.thin(*signals[name], most=2500)
            axes.plot(t, y * plots.shown(name).factor, ".", ms=1.5, color="#aaaaaa", label="sensor", zorder=1)
        lines = {
            "true": case.experiment.truth[:, i],
            "simulated, model alone": case.open_loop[:, i],
            "estimated": case.estimate.mean[:, i],
        }
        plots.draw_lines(axes, time, lines, channel=name)
    plots.over_time(made, columns=2)
    return made


def figure_5(case: Case) -> Figure:
    """Return the equivalent of Figure 5: angles and rates."""
    return states(case, STATES[:4])


def figure_6(case: Case) -> Figure:
    """Return the equivalent of Figure 6: pressures."""
    return states(case, STATES[4:])


def figure_7(case: Case) -> Figure:
    """Return the equivalent of Figure 7: the error of each state in its 95 % interval."""
    made = plots.figure(len(STATES), height=1.15)
    time, truth = case.experiment.time, case.experiment.truth
    for axes, name in zip(made.axes, STATES, strict=True):
        i = STATES.index(name)
        error, half = case.estimate.mean[:, i] - truth[:, i], 1.96 * case.estimate.std[:, i]
        plots.draw_lines(axes, time, {"error of the estimate": error}, channel=name, band=(-half, half))
        settled = time > min(1.0, 0.1 * time[-1])
        limit = 1.3 * plots.shown(name).factor * max(np.abs(error[settled]).max(), half[settled].max())
        axes.set_ylim(-limit, limit)  # the start is far outside; what comes after is what the figure is about
        with plots.style():
            axes.set_title(f"inside {100 * case.coverage[name]:.1f} % of the time", loc="right", fontsize=9, pad=3.0)
    plots.over_time(made)
    return made


#: s, and the state shown there: no sensor sees it
_CLOSER = (((4.8, 6.0), "p2"), ((11.8, 13.0), "p3"))


def following_figure(case: Case) -> Figure:
    """Return true, simulated and estimated states: angles over the whole cycle, pressures without a sensor over short
    times.
    """
    made = plots.figure(4, height=1.5, sharex=False)
    time = case.experiment.time
    panels = [((time[0], time[-1]), "z1"), ((time[0], time[-1]), "z4"), *_CLOSER]
    for axes, ((start, end), name) in zip(made.axes, panels, strict=True):
        i, part = STATES.index(name), (time >= start) & (time <= end)
        lines = {
            "true": case.experiment.truth[part, i],
            "simulated, model alone": case.open_loop[part, i],
            "estimated by the filter": case.estimate.mean[part, i],
        }
        plots.draw_lines(axes, time[part], lines, channel=name)
    plots.over_time(made)
    return made
