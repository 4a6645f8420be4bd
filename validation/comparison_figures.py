"""Pictures of a comparison: what fails when, the open-loop run, and the residual of every balance. They are drawn from
its parts; `Comparison` says which.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from . import plots
from .balances import Balances
from .findings import PREDICTED_BADLY, VIOLATED, Scores, balance_words, people_unit
from .phases import LOW_PRESSURE, REST, REVERSAL, STROKE_END, Phase, kinds, moving, together

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from matplotlib.figure import Figure

    from crane_exudyn.layout import Layout

#: colours of the kinds of work: extending warm, retracting cold, what is special dark
_COLORS = {REST: "#eeeeee", REVERSAL: "#7A5C8E", LOW_PRESSURE: "#3E6E5A", STROKE_END: "#333333"}
_TOGETHER = {"facecolor": "#B9A3C9", "hatch": "++++++"}
#: by the way that a valve is open, of one cylinder and the next
_WARM_AND_COLD = {1: ("#F0C27B", "#E39B57", "#C97B3D"), -1: ("#A7CBE8", "#6FA3CF", "#457FAF")}
#: and hatches, so that they differ without colour
_HATCHES = {REVERSAL: "------"}
_HATCHES_OF_WAYS = {1: ("//////", "......", "oooo"), -1: ("\\\\\\\\\\\\", "xxxxxx", "OOOO")}
#: scores at which the map is white and at which it is darkest
_PALE, _DARK = 1.0, 100.0


def _stacked(ratios: Sequence[float], height: float) -> Figure:
    """Return a figure of panels on one time axis whose heights are as these numbers, `height` inches in all."""
    with plots.style():
        made = plots.empty_figure(plots.WIDTH, height, layout="constrained")
        made.subplots(len(ratios), 1, sharex=True, gridspec_kw={"height_ratios": list(ratios)})
    return made


#: channel -> (time (n,), values (n,))
Series = Mapping[str, tuple[np.ndarray, np.ndarray]]


def where_figure(scores: Scores, time: np.ndarray, commands: np.ndarray, title: str) -> Figure:
    """Return a map of time against channels and equations: the darker, the worse the model; what the crane did, by its
    commands (n, valves) at `time` (n,), stands above.
    """
    rows = [*scores.channel_names, *map(balance_words, scores.layout.equations)]
    values = np.column_stack([scores.channels, np.abs(scores.equations) / (VIOLATED / PREDICTED_BADLY)]).T
    made = _stacked((1.0, 0.22, 0.27 * len(rows)), 2.2 + 0.27 * len(rows))
    with plots.style():
        command_axes, strip, map_axes = made.axes
        _commands(command_axes, time, commands, scores.layout)
        _strip(strip, scores.phases)
        mesh = _map(map_axes, scores.phases, rows, values)
        map_axes.axhline(len(scores.channel_names), color="#444444", lw=1.2)
        bar = made.colorbar(mesh, ax=[command_axes, strip, map_axes], aspect=40, pad=0.01)
        bar.set_label("times what noise explains")
        bar.set_ticks([1, 3, 10, 30, 100], labels=["1", "3", "10", "30", "100"])
        made.suptitle(title, x=0.01, ha="left", fontsize=10)
    return made


def _commands(axes: Axes, time: np.ndarray, commands: np.ndarray, layout: Layout) -> None:
    names = zip(layout.commands, layout.cylinders, strict=True)
    for name, u, look in zip(names, commands.T, cycle(plots.OTHERS), strict=False):
        axes.plot(*plots.thin(time, u), label=" ".join(name), linestyle=look.dashes, color=look.color)
    axes.set_ylabel("command")
    axes.set_ylim(-1.05 * max(0.2, np.abs(commands).max()), 1.05 * max(0.2, np.abs(commands).max()))
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=2)


def _strip(axes: Axes, phases: Sequence[Phase]) -> None:
    for phase in phases:
        axes.axvspan(phase.start, phase.end, **_look(phase.kind, phase.layout))
    axes.set_yticks([])
    axes.grid(visible=False)
    from matplotlib.patches import Patch

    layout = phases[0].layout
    present = [k for k in kinds(layout) if any(p.kind == k for p in phases)]
    axes.legend(
        [Patch(**_look(k, layout)) for k in present], present, loc="lower left", bbox_to_anchor=(0.0, 1.0),
        ncols=3, fontsize=7.5, handlelength=2.0, columnspacing=0.9, borderpad=0.1,
    )  # fmt: skip


def _look(kind: str, layout: Layout) -> dict[str, Any]:
    """Return how matplotlib fills what stands for a kind of work of a machine."""
    fill = {"facecolor": _COLORS.get(kind, ""), "hatch": _HATCHES.get(kind, "")}
    if kind == together(layout):
        fill = _TOGETHER
    for (c, side), name in moving(layout).items():
        if name == kind:
            colors, hatches = _WARM_AND_COLD[side], _HATCHES_OF_WAYS[side]
            fill = {"facecolor": colors[c % len(colors)], "hatch": hatches[c % len(hatches)]}
    return fill | {"edgecolor": "#555555", "lw": 0.0}


def _map(axes: Axes, phases: Sequence[Phase], rows: Sequence[str], values: np.ndarray) -> QuadMesh:
    from matplotlib.colors import LogNorm

    edges = np.array([*(p.start for p in phases), phases[-1].end])
    shown = np.clip(np.nan_to_num(values, nan=_PALE), _PALE, _DARK)
    mesh = axes.pcolormesh(edges, np.arange(len(rows) + 1), shown, cmap="OrRd", norm=LogNorm(_PALE, _DARK))
    axes.set_yticks(np.arange(len(rows)) + 0.5, rows)
    axes.invert_yaxis()
    axes.grid(visible=False)
    axes.vlines(edges, 0, len(rows), color="white", lw=0.6)
    axes.hlines(np.arange(len(rows)), edges[0], edges[-1], color="white", lw=0.6)
    axes.set_xlim(edges[0], edges[-1])
    axes.set_xlabel("time / s")
    return mesh


def open_loop_figure(measured: Series, simulated: Series, errors: Mapping[str, float], layout: Layout) -> Figure:
    """Return every channel over time, measured and simulated open loop, with its error in units of the noise."""
    made = plots.figure(len(errors), height=1.3)
    with plots.style():
        for axes, (name, error) in zip(made.axes, errors.items(), strict=True):
            lines = {"measured": measured[name], "simulated": simulated[name]}
            plots.draw_lines(axes, measured[name][0], lines, channel=name, layout=layout)
            axes.set_title(f"error {error:.3g} × noise", loc="right", fontsize=9)
        made.axes[-1].set_xlabel("time / s")
    plots.legend_above(made)
    return made


def balances_figure(balances: Balances, phases: Sequence[Phase], layout: Layout) -> Figure:
    """Return what each balance lacks over time, with its 95 % interval, below the colours of the work that was done."""
    equations = layout.equations
    made = _stacked((0.18, *[1.0] * len(equations)), 1.2 * len(equations) + 0.9)
    with plots.style():
        _strip(made.axes[0], phases)
        for j, (axes, equation) in enumerate(zip(made.axes[1:], equations, strict=True)):
            unit, factor = people_unit(equation, layout)
            t, y, s = plots.thin(balances.time, balances.values[:, j] / factor, balances.std[:, j] / factor)
            axes.fill_between(t, y - 1.96 * s, y + 1.96 * s, color="#0072B2", alpha=0.25, lw=0)
            axes.plot(t, y, color="#0072B2", lw=1.1)
            axes.axhline(0.0, color="#111111", lw=0.8)
            axes.set_title(
                f"{balance_words(equation)} that the model lacks", loc="left", fontsize=9, color="#444444", pad=3.0
            )
            axes.set_ylabel(unit)
        made.axes[-1].set_xlim(balances.time[0], balances.time[-1])
        made.axes[-1].set_xlabel("time / s")
    return made


def by_work_figure(scores: Scores) -> Figure:
    """Return what each balance lacks in each kind of work: bars with 95 % intervals, moments first, then flows."""
    found, lay = scores.by_kind(), scores.layout
    b = len(lay.equations)
    made = plots.figure((b + 1) // 2, 2, height=0.75 + 0.2 * len(found), sharex=False)
    for axes in made.axes[b:]:
        axes.set_visible(False)
    with plots.style():
        for j, axes in enumerate(made.axes[:b]):
            _work(axes, found, j, lay)
            axes.set_yticks(
                range(len(found)), [k for k, _, _ in found] if j % 2 == 0 else [""] * len(found), fontsize=8
            )
        units = [lay.unit_of(e) for e in lay.equations]
        for unit in set(units):  # one scale for what has one unit
            group = [axes for axes, own in zip(made.axes, units, strict=False) if own == unit]
            widest = 1.05 * max(abs(x) for axes in group for x in axes.get_xlim())
            for axes in group:
                axes.set_xlim(-widest, widest)
    return made


def _work(axes: Axes, found: Sequence[tuple[str, np.ndarray, np.ndarray]], j: int, layout: Layout) -> None:
    """Draw bars of balance j for every kind of work."""
    unit, factor = people_unit(layout.equations[j], layout)
    at = np.arange(len(found))
    mean = np.array([m[j] for _, m, _ in found]) / factor
    half = 1.96 * np.array([s[j] for _, _, s in found]) / factor
    colors = [_look(k, layout)["facecolor"] for k, _, _ in found]
    axes.barh(at, mean, 0.62, color=colors, edgecolor="#555555", lw=0.6)
    axes.errorbar(mean, at, xerr=half, fmt="none", ecolor="#111111", elinewidth=1.0, capsize=2.0)
    axes.axvline(0.0, color="#111111", lw=0.8)
    axes.invert_yaxis()
    axes.set_xlabel(unit)
    axes.set_title(balance_words(layout.equations[j]), loc="left", fontsize=9)


#: panels of a figure of traces, and s that its last one shows
_TRACES, _CLOSER = 3, 1.5


def traces_figure(lines: Mapping[str, Series], layout: Layout) -> Figure:
    """Return the channels in which the first model errs most, over time, and below the worst one where it is worst.

    Args:
        lines: "measured", then models by label: channel -> (time (n,), values (n,)), as `compare.from_one_start` gives
            them.
        layout: of the machine.
    """
    measured, first = lines["measured"], lines[next(label for label in lines if label != "measured")]
    sizes = layout.sensors
    off = {n: np.abs(first[n][1] - y) / sizes[n].sizes.noise for n, (_, y) in measured.items()}
    worst = sorted(off, key=lambda n: -float(np.sqrt(np.mean(off[n] ** 2))))[:_TRACES]
    made = plots.figure(len(worst) + 1, height=1.45, sharex=False)
    time = measured[worst[0]][0]
    peak = float(time[np.argmax(np.convolve(off[worst[0]] ** 2, np.ones(1 + len(time) // 40), "same"))])
    begin = min(max(peak - 0.5 * _CLOSER, time[0]), max(time[-1] - _CLOSER, time[0]))
    for axes, name in zip(made.axes, (*worst, worst[0]), strict=True):
        shown = {label: named[name] for label, named in lines.items()}
        if axes is made.axes[-1]:
            shown = {label: _cut(line, begin, begin + _CLOSER) for label, line in shown.items()}
        plots.draw_lines(axes, shown["measured"][0], shown, channel=name, layout=layout)
    with plots.style():
        made.axes[-1].set_title("closer", loc="right", fontsize=9)
    plots.over_time(made)
    return made


def _cut(line: tuple[np.ndarray, np.ndarray], begin: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    time, values = line
    inside = (time >= begin) & (time <= end)
    return time[inside], values[inside]
