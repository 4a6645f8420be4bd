"""Charts of results in the look that `crane_exudyn.plots` gives to all pictures; its functions are here as well."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from crane_exudyn.plots import (
    LOOKS,
    OTHERS,
    WIDTH,
    Look,
    Shown,
    draw_lines,
    empty_figure,
    figure,
    legend_above,
    look,
    name_axes,
    over_time,
    plain_powers,
    png,
    save,
    shown,
    style,
    thin,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from crane_exudyn.layout import Layout

__all__ = [
    "LOOKS", "OTHERS", "WIDTH", "Look", "Shown", "draw_lines", "empty_figure", "figure", "legend_above", "look",
    "mark_intervals", "name_axes", "over_time", "plain_powers", "png", "save",
    "shown", "style", "thin", "trajectories",
]  # fmt: skip


def trajectories(
    time: np.ndarray,
    lines: Mapping[str, Mapping[str, np.ndarray]],
    *,
    channels: Sequence[str] | None = None,
    layout: Layout | None = None,
    bands: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
    marks: Sequence[tuple[float, float, str]] = (),
) -> Figure:
    """Return a figure with one panel a channel.

    Args:
        time: (n,) s.
        lines: {"measured": {"z1": (n,), …}, "estimated": {…}}, SI; a channel may be missing in any of them.
        channels: which, in what order; by default every channel named in `lines`.
        layout: of the machine; by default that of patu655.
        bands: lower and upper (n,) by channel.
        marks: (from, to, text) intervals shaded in every panel, text in the first.
    """
    chosen = (
        list(channels) if channels is not None else list(dict.fromkeys(c for named in lines.values() for c in named))
    )
    made = figure(max(len(chosen), 1), height=1.35)
    for axes, channel in zip(made.axes, chosen, strict=False):
        parts = {label: named[channel] for label, named in lines.items() if channel in named}
        draw_lines(axes, time, parts, channel=channel, layout=layout, band=(bands or {}).get(channel))
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
