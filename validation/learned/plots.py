"""Pictures of what was learned: each curve with its interval and where the recording went."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from crane_exudyn.effects.registry import in_words

from ..plots import OTHERS, style
from ..plots import figure as new_figure
from .laws import curve_at
from .learned_law import LearnedLaw
from .resembles import read_in


def figure(laws: Sequence[LearnedLaw]) -> Any:
    """Return a figure: a panel a law; its curve, 95 % interval, knots, nearest simple form, and how often each place
    was visited.
    """
    made = new_figure(max(1, len(laws)), height=3.4, sharex=False)
    with style():
        if not laws:
            made.axes[0].annotate("no law found", (0.5, 0.5), xycoords="axes fraction", ha="center")
        for axes, law in zip(made.axes, laws, strict=False):
            _panel(axes, law)
    return made


def _panel(axes: Any, law: LearnedLaw) -> None:
    (x_unit, fx), (y_unit, fy) = read_in(law.unit_over), read_in(law.unit)
    at = np.linspace(law.x[0], law.x[-1], 300)
    middle, low, high = (curve_at(law.x, law.y + s * law.std, at) / fy for s in (0.0, -1.96, 1.96))
    color = OTHERS[2].color
    axes.fill_between(at / fx, low, high, color=color, alpha=0.25, linewidth=0, label="95 %")
    axes.plot(at / fx, middle, color=color, label="learned")
    axes.plot(law.x / fx, law.y / fy, "o", color=color, markersize=3)
    if law.form.law is not None:
        axes.plot(at / fx, law.form.at(at) / fy, "--", color=OTHERS[0].color, linewidth=1, label=law.form.name)
    went = law.law.visited[:: max(1, len(law.law.visited) // 400)] / fx
    axes.plot(went, np.full(len(went), 0.02), "|", color="0.4", markersize=6, transform=axes.get_xaxis_transform())
    axes.set_xlabel(f"{law.over.replace('_', ' ')}{f' [{x_unit}]' if x_unit else ''}; marks: where the recording was")
    axes.set_ylabel(f"{in_words(law.effect)}{f' [{y_unit}]' if y_unit else ''}")
    axes.legend()
