"""Pictures of a diagnosis and of an improvement."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ..plots import figure, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..diagnosis import Diagnosis
    from ..improvement import Improvement

_SHOWN = 8


def diagnosis_figure(d: Diagnosis) -> Figure:
    """Return a figure: what each explanation gains in evidence over the parameters alone, and the error it leaves."""
    with style():
        made = figure(1, 2, height=3.4, sharex=False)
        left, right = made.axes
        shown = d.candidates[:_SHOWN][::-1]
        alone = next((c.evidence for c in d.candidates if not c.effects), d.candidates[-1].evidence)
        names = [c.name.replace(" + ", "\n+ ") for c in shown]
        gains = [max(c.evidence - alone, 0.0) for c in shown]
        left.barh(names, gains, color=["#1b6ca8" if c.effects == d.effects and d.effects else "#b8c4ce" for c in shown])
        left.set_xscale("symlog", linthresh=10.0)
        left.set_xlabel("gain in log evidence over parameters alone")
        pairs = [("learn", d.error_before, d.error_after), ("check", d.check_error_before, d.check_error_after)]
        pairs = [p for p in pairs if not math.isnan(p[1])]
        for i, (_, before, after) in enumerate(pairs):
            right.bar(i - 0.2, before, 0.36, color="#b8c4ce", hatch="//", label="before" if i == 0 else None)
            right.bar(i + 0.2, after, 0.36, color="#1b6ca8", label="after" if i == 0 else None)
        right.axhline(1.0, color="k", lw=0.8, ls=":")
        right.set_yscale("log")
        right.set_xticks(range(len(pairs)), [p[0] for p in pairs])
        right.set_ylabel("open-loop error / noise")
        right.legend(loc="upper right")
        made.suptitle(f"{d.recording}: {d.verdict}" + (f" — {' and '.join(d.effects)}" if d.effects else ""))
    return made


def improvement_figure(result: Improvement) -> Figure:
    """Return a figure of the error falling from step to step."""
    with style():
        made = figure(1, 1, height=3.2)
        axes = made.axes[0]
        names = ["as given", *(f"+ {s.added}" for s in result.steps[1:])]
        axes.plot(names, [s.error for s in result.steps], "o-", color="#1b6ca8", label="learned from")
        if not math.isnan(result.steps[0].check_error):
            axes.plot(names, [s.check_error for s in result.steps], "s--", color="#c0392b", label="only predicted")
        axes.axhline(1.0, color="k", lw=0.8, ls=":")
        axes.set_yscale("log")
        axes.set_ylabel("open-loop error / noise")
        axes.legend()
        made.suptitle(f"{result.recording}: left is {result.verdict}")
    return made
