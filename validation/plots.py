"""Plots that every result shares: one look, units for people, legible without colour.

Figures are matplotlib `Figure` objects made without pyplot, so nothing is global, no window opens and no backend is
chosen. Every line differs from its neighbours in dash pattern as well as in colour and lightness.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Look(NamedTuple):
    """How one kind of line is drawn everywhere."""

    color: str
    dashes: str | tuple[int, tuple[float, ...]]
    width: float
    order: int


#: the three sources of a trajectory, drawn alike in plots and, in colour, in pictures of the crane
LOOKS: Mapping[str, Look] = {
    "measured": Look("#111111", "-", 1.6, 3),
    "simulated": Look("#D55E00", (0, (5, 2)), 1.5, 4),
    "estimated": Look("#0072B2", (0, (1.2, 1.2)), 1.9, 5),
    "published": Look("#777777", (0, (7, 2, 1, 2)), 1.3, 3),
}
_OTHERS = (
    Look("#111111", "-", 1.5, 3),
    Look("#D55E00", (0, (5, 2)), 1.5, 3),
    Look("#0072B2", (0, (1.2, 1.2)), 1.8, 3),
    Look("#009E73", (0, (7, 2, 1, 2)), 1.5, 3),
    Look("#9A6BB0", (0, (3, 1, 1, 1, 1, 1)), 1.5, 3),
    Look("#999999", (0, (9, 3)), 1.5, 3),
)
_STYLE: dict[str, Any] = {
    "figure.dpi": 100,
    "savefig.dpi": 160,
    "font.size": 10,
    "font.family": "DejaVu Sans",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.formatter.useoffset": False,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "legend.handlelength": 3.2,
    "hatch.linewidth": 0.5,
    "svg.fonttype": "path",
}
_NAMES = {
    "z1": "lift boom z1", "z4": "outer boom z4", "z4_abs": "outer boom z1+z4", "dz1": "lift boom rate ż1",
    "dz4": "outer boom rate ż4", "dz4_abs": "outer boom rate ż1+ż4", "p1": "lift piston side p1",
    "p2": "lift rod side p2", "p3": "tilt piston side p3", "p4": "tilt rod side p4", "s1": "lift cylinder s1",
    "s2": "tilt cylinder s2", "pp": "pump pp", "pt": "tank pt", "u1": "lift command u1", "u2": "tilt command u2",
    "U1": "lift valve U1", "U2": "tilt valve U2",
}  # fmt: skip


class Shown(NamedTuple):
    """A channel as people read it: multiply SI values by `factor` to get `unit`."""

    name: str
    factor: float
    unit: str

    @property
    def label(self) -> str:
        """The axis label, such as "lift boom z1 / °"."""
        return f"{self.name} / {self.unit}" if self.unit else self.name


def shown(channel: str) -> Shown:
    """Return name, factor and unit in which a channel is drawn: degrees and bar instead of rad and Pa."""
    name = _NAMES.get(channel, channel)
    if channel[:1] == "p" and channel in _NAMES:
        return Shown(name, 1e-5, "bar")
    if channel.startswith("dz"):
        return Shown(name, math.degrees(1.0), "°/s")
    if channel.startswith("z"):
        return Shown(name, math.degrees(1.0), "°")
    return Shown(name, 1e3, "mm") if channel in ("s1", "s2") else Shown(name, 1.0, "V" if channel[:1] == "U" else "")


def style() -> AbstractContextManager[None]:
    """Return a context in which matplotlib draws in this project's style."""
    import matplotlib

    settings: Any = _STYLE  # matplotlib's own stub wants literal keys
    return matplotlib.rc_context(settings)


def figure(rows: int = 1, columns: int = 1, *, height: float = 2.1, width: float = 7.6, sharex: bool = True) -> Figure:
    """Return a figure with rows x columns axes (`figure.axes`), `height` and `width` in inches a row and in all."""
    from matplotlib.figure import Figure

    with style():
        made = Figure(figsize=(width, max(height * rows, 2.0)), layout="constrained")
        made.subplots(rows, columns, sharex=sharex, squeeze=False)
    return made


def look(label: str, position: int) -> dict[str, Any]:
    """Return matplotlib line properties for a label such as "measured", or for the n-th other line."""
    chosen = LOOKS.get(label.split(" ")[0], _OTHERS[position % len(_OTHERS)])
    return {"color": chosen.color, "linestyle": chosen.dashes, "linewidth": chosen.width, "zorder": chosen.order}


def draw_lines(
    axes: Axes,
    time: np.ndarray,
    lines: Mapping[str, np.ndarray | tuple[np.ndarray, np.ndarray]],
    *,
    channel: str = "",
    band: tuple[np.ndarray, np.ndarray] | None = None,
    band_label: str = "95 % interval",
) -> None:
    """Draw lines over time on `axes`, in the channel's display unit.

    Args:
        axes: where to draw.
        time: (n,) s, for all lines that are not a pair (own time, values).
        lines: SI values by label; "measured", "simulated", "estimated" have their own looks.
        channel: name such as "z1", for unit and axis label.
        band: lower and upper (n,) in SI, shaded.
    """
    unit = shown(channel)
    with style():
        if band is not None:
            lower, upper = thin(time, *(np.asarray(b) * unit.factor for b in band))[1:]
            axes.fill_between(thin(time, time)[0], lower, upper, color="#0072B2", alpha=0.22, lw=0, label=band_label)
        for i, (label, values) in enumerate(lines.items()):
            own, y = values if isinstance(values, tuple) else (time, values)
            t, y = thin(own, np.asarray(y, dtype=float) * unit.factor)
            axes.plot(t, y, label=label, **look(label, i))
        if channel:
            *words, symbol = unit.name.split(" ")
            axes.set_title(" ".join(words), loc="left", fontsize=9, color="#444444", pad=3.0)
            axes.set_ylabel(f"{symbol} / {unit.unit}" if unit.unit else symbol)


def thin(time: np.ndarray, *columns: np.ndarray, most: int = 4000) -> tuple[np.ndarray, ...]:
    """Return at most `most` samples of time and each column, evenly chosen: more than a page can show."""
    step = max(1, math.ceil(len(time) / most))
    return tuple(np.asarray(c)[::step] for c in (time, *columns))


def trajectories(
    time: np.ndarray,
    lines: Mapping[str, Mapping[str, np.ndarray]],
    *,
    channels: Sequence[str] | None = None,
    bands: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
    marks: Sequence[tuple[float, float, str]] = (),
) -> Figure:
    """Return a figure with one panel a channel.

    Args:
        time: (n,) s.
        lines: {"measured": {"z1": (n,), …}, "estimated": {…}}, SI; a channel may be missing in any of them.
        channels: which, in what order; by default every channel named in `lines`.
        bands: lower and upper (n,) by channel.
        marks: (from, to, text) intervals shaded in every panel, text in the first.
    """
    chosen = (
        list(channels) if channels is not None else list(dict.fromkeys(c for named in lines.values() for c in named))
    )
    made = figure(max(len(chosen), 1), height=1.55)
    for axes, channel in zip(made.axes, chosen, strict=False):
        parts = {label: named[channel] for label, named in lines.items() if channel in named}
        draw_lines(axes, time, parts, channel=channel, band=(bands or {}).get(channel))
        mark_intervals(axes, marks, text=axes is made.axes[0])
    made.axes[-1].set_xlabel("time / s")
    legend_above(made)
    return made


def mark_intervals(axes: Axes, marks: Sequence[tuple[float, float, str]], *, text: bool = True) -> None:
    """Shade time intervals, hatched so that they show in print, with their text at the top."""
    with style():
        for start, end, words in marks:
            axes.axvspan(start, end, facecolor="#f3e3b3", edgecolor="#b08d2a", hatch="///", alpha=0.5, lw=0, zorder=0)
            if text:
                box = {"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "#b08d2a", "linewidth": 0.6}
                where: dict[str, Any] = {
                    "xycoords": ("data", "axes fraction"),
                    "ha": "center",
                    "va": "top",
                    "zorder": 9,
                }
                axes.annotate(words, ((start + end) / 2, 0.96), fontsize=8, bbox=box, **where)


def legend_above(made: Figure) -> None:
    """Put one legend of all panels above the figure, each label once."""
    found: dict[str, Any] = {}
    for axes in made.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    if found:
        with style():
            made.legend(found.values(), found.keys(), loc="outside upper left", ncols=min(len(found), 4))


def bars(labels: Sequence[str], groups: Mapping[str, Sequence[float]], *, axis: str, log: bool = False) -> Figure:
    """Return a horizontal bar chart with one group of bars a label; bars differ in hatching too."""
    hatches = ("", "///", "...", "xxx")
    made = figure(height=0.9 + len(labels) * (0.16 + 0.17 * len(groups)))
    axes = made.axes[0]
    size = 0.8 / max(len(groups), 1)
    with style():
        for i, (name, values) in enumerate(groups.items()):
            at = np.arange(len(labels)) + (i - (len(groups) - 1) / 2) * size
            fill: dict[str, Any] = {
                "color": _OTHERS[i % len(_OTHERS)].color,
                "hatch": hatches[i % 4],
                "edgecolor": "white",
                "lw": 0.5,
            }
            axes.barh(at, np.asarray(values, dtype=float), size * 0.92, label=name, **fill)
        axes.set_yticks(np.arange(len(labels)), list(labels))
        axes.invert_yaxis()
        axes.set_xlabel(axis)
        axes.grid(axis="y", visible=False)
        if log:
            axes.set_xscale("log")
    if len(groups) > 1:
        legend_above(made)
    return made


def png(made: Figure) -> bytes:
    """Return the figure as PNG at 160 dots an inch."""
    stream = BytesIO()
    with style():
        made.savefig(stream, format="png")
    return stream.getvalue()


def save(made: Figure, path: str | Path) -> None:
    """Write the figure as PNG, SVG or PDF by its ending, whole or not at all."""
    from crane_exudyn.files import replacing

    with replacing(path) as temporary, style():
        made.savefig(temporary, format=Path(path).suffix.lstrip(".") or "png")
