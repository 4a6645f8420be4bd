"""Plots that every result shares: one look, units for people, legible without colour and on a phone.

Figures are matplotlib `Figure` objects made without pyplot, so nothing is global, no window opens and no backend is
chosen. Every line differs from its neighbours in dash pattern as well as in colour and lightness.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import AbstractContextManager
from functools import cache, partial
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from unicodedata import normalize

import numpy as np

from . import channels
from .layout import Layout
from .machine_toml import usual_layout
from .units import people_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
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
OTHERS = (
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
    "legend.handlelength": 2.8,
    "legend.columnspacing": 1.4,
    "hatch.linewidth": 0.5,
    "svg.fonttype": "path",
    "text.parse_math": False,  # names of files and cranes are no formulas, whatever signs they hold
}
#: width of a figure in inches: as wide as makes 10 point letters legible on a phone
WIDTH = 5.4


@cache
def _names(layout: Layout) -> dict[str, tuple[str, str]]:
    """Return the words and the symbol of every channel of a machine."""
    bodies = {n: body.replace("_", " ") for n, body in zip(layout.coordinates, layout.bodies, strict=True)}
    dotted = {n: normalize("NFC", f"{n[0]}\u0307{n[1:]}") for n in layout.coordinates}
    pendulum = (("payload's pendulum", "θ"), ("payload's pendulum rate", "θ\u0307"))
    found = dict(zip(layout.added, pendulum, strict=False))
    for name, body in bodies.items():
        path, carriers = layout.absolute(name), layout.carriers(name)
        found[name] = (f"{body} against {bodies[carriers[-1]]}" if carriers else body, name)
        found[f"{name}_abs"] = (body, "+".join(path))
        found[f"d{name}"] = (f"{body} rate", dotted[name])
        found[f"d{name}_abs"] = (f"{body} rate", "+".join(dotted[n] for n in path))
    for names, words in ((layout.commands, "command"), (layout.voltages, "valve"), (layout.lengths, "cylinder")):
        found |= {n: (f"{cylinder} {words}", n) for n, cylinder in zip(names, layout.cylinders, strict=True)}
    found |= {n: (layout.side_of(n).replace(",", ""), n) for n in layout.chambers}
    return found | {n: (words, n) for n, words in zip(layout.supply, ("pump", "tank"), strict=True)}


class Shown(NamedTuple):
    """A channel as people read it: multiply SI values by `factor` to get `unit`; `symbol` is "" where there is none."""

    words: str
    symbol: str
    factor: float
    unit: str

    @property
    def name(self) -> str:
        """Words and symbol, such as "lift boom z1"."""
        return f"{self.words} {self.symbol}".strip()

    @property
    def axis(self) -> str:
        """The label of an axis whose title are the words: symbol and unit, such as "z1 / °"."""
        return " / ".join(filter(None, (self.symbol, self.unit)))


def shown(channel: str, unit: str | None = None, layout: Layout | None = None) -> Shown:
    """Return words, factor and unit in which a channel is drawn: degrees and bar instead of rad and Pa.

    Args:
        channel: a channel of recordings, or any other quantity, such as "payload.mass" or "internal_leakage@lift.k".
        unit: its SI unit, where the channel is none of recordings.
        layout: of the machine; by default that of patu655.
    """
    layout = layout or usual_layout()
    units = channels.of(layout)
    if channel in units:
        words, symbol = _names(layout)[channel]
        return Shown(words, symbol, *_read(units[channel]))
    words = channel.replace("_", " ").replace("@", " of ").replace(".", " ")
    unit = unit or ""
    return Shown(words, "", *(_read(unit) if unit in ("rad", "rad/s", "Pa") else (1.0, unit)))


def _read(si_unit: str) -> tuple[float, str]:
    """Return what one SI unit is in the unit that people read, and the sign of that."""
    unit, one = people_of(si_unit)
    return 1.0 / one, unit.replace("deg", "°")


def style() -> AbstractContextManager[None]:
    """Return a context in which matplotlib draws in this project's style."""
    import matplotlib

    settings: Any = _STYLE  # matplotlib's own stub wants literal keys
    return matplotlib.rc_context(settings)


def figure(
    rows: int = 1, columns: int = 1, *, height: float = 1.5, width: float = WIDTH, sharex: bool = True
) -> Figure:
    """Return a figure with rows x columns axes (`figure.axes`), `height` and `width` in inches a row and in all."""
    with style():
        made = empty_figure(width, max(height * rows, 2.0), layout="constrained")
        made.subplots(rows, columns, sharex=sharex, squeeze=False)
    return made


def empty_figure(width: float, height: float, **options: Any) -> Figure:
    """Return a figure of so many inches that notebooks show, though it is made without pyplot."""
    from matplotlib.figure import Figure

    made = Figure(figsize=(width, height), **options)
    made._repr_png_ = partial(png, made)  # type: ignore[attr-defined]
    return made


def look(label: str, position: int) -> dict[str, Any]:
    """Return matplotlib line properties for a label such as "measured", or for the n-th other line."""
    chosen = LOOKS.get(label.split(" ")[0], OTHERS[position % len(OTHERS)])
    return {"color": chosen.color, "linestyle": chosen.dashes, "linewidth": chosen.width, "zorder": chosen.order}


def draw_lines(
    axes: Axes,
    time: np.ndarray,
    lines: Mapping[str, np.ndarray | tuple[np.ndarray, np.ndarray]],
    *,
    channel: str = "",
    layout: Layout | None = None,
    band: tuple[np.ndarray, np.ndarray] | None = None,
    band_label: str = "95 % interval",
) -> None:
    """Draw lines over time on `axes`, in the channel's display unit.

    Args:
        axes: where to draw.
        time: (n,) s, for all lines that are not a pair (own time, values).
        lines: SI values by label; "measured", "simulated", "estimated" have their own looks.
        channel: name such as "z1", for unit and axis label.
        layout: as in `shown`.
        band: lower and upper (n,) in SI, shaded.
    """
    unit = shown(channel, layout=layout)
    with style():
        if band is not None:
            lower, upper = thin(time, *(np.asarray(b) * unit.factor for b in band))[1:]
            axes.fill_between(thin(time, time)[0], lower, upper, color="#0072B2", alpha=0.22, lw=0, label=band_label)
        for i, (label, values) in enumerate(lines.items()):
            own, y = values if isinstance(values, tuple) else (time, values)
            t, y = thin(own, np.asarray(y, dtype=float) * unit.factor)
            axes.plot(t, y, label=label, **look(label, i))
        if channel:
            name_axes(axes, unit)


def name_axes(axes: Axes, what: Shown) -> None:
    """Write above the axes what is drawn, in words, and beside it symbol and unit."""
    with style():
        axes.set_title(what.words, loc="left", fontsize=9, color="#444444", pad=3.0)
        axes.set_ylabel(what.axis)


#: digits and signs of an exponent
_RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def plain_powers(axis: Axis) -> None:
    """Label a logarithmic axis with powers of ten in plain signs: matplotlib's own labels are formulas, which this
    style takes for text.
    """
    axis.set_major_formatter(lambda value, _: _power(value))
    axis.set_minor_formatter(lambda value, _: "")


def _power(value: float) -> str:
    return "10" + str(round(math.log10(value))).translate(_RAISED) if value > 0.0 else ""


def thin(time: np.ndarray, *columns: np.ndarray, most: int = 4000) -> tuple[np.ndarray, ...]:
    """Return at most `most` samples of time and each column, evenly chosen: more than a page can show."""
    step = max(1, math.ceil(len(time) / most))
    return tuple(np.asarray(c)[::step] for c in (time, *columns))


def legend_above(made: Figure, columns: int = 3, loc: str = "outside upper left") -> None:
    """Put one legend of all panels above the figure, each label once, in at most so many columns."""
    found: dict[str, Any] = {}
    for axes in made.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    if found:
        place: Any = loc  # matplotlib's stub wants a literal
        with style():
            made.legend(list(found.values()), list(found), loc=place, ncols=min(len(found), columns))


def over_time(made: Figure, columns: int = 3) -> None:
    """Name the time axis below a figure of panels, align what stands beside them, and put their legend above."""
    with style():
        made.axes[-1].set_xlabel("time / s")
    made.align_ylabels()
    legend_above(made, columns)


def entitle(made: Figure, title: str) -> None:
    """Write a title above a figure of panels over one time axis, and what that axis is below it."""
    with style():
        made.suptitle(title, x=0.01, ha="left", fontsize=11)
        made.axes[-1].set_xlabel("time / s")
        made.align_ylabels()


def png(made: Figure) -> bytes:
    """Return the figure as PNG at 160 dots an inch."""
    stream = BytesIO()
    with style():
        made.savefig(stream, format="png")
    return stream.getvalue()


def save(made: Figure, path: str | Path) -> None:
    """Write the figure as PNG, SVG or PDF by its ending, whole or not at all."""
    from .files import replacing

    with replacing(path) as temporary, style():
        made.savefig(temporary, format=Path(path).suffix.lstrip(".") or "png")
