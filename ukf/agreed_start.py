"""Where a recording may be started from: a channel that leaps early on was wrong before it or is wrong after it.

The start is tried both ways, and the filter says with which of them the first samples of all channels agree better.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .monitor import FASTEST, leaps
from .signals import Plan

#: in the first so many seconds of a recording a leap puts the start in doubt; each trial goes on for as long again
_EARLY = 1.0


def agreed_start(estimator: Any, plan: Plan) -> dict[str, float]:
    """Return {channel: time in s} of the channels whose samples before that time the start must not be taken from; an
    `Estimator` tries it.
    """
    since: dict[str, float] = {}
    groups: dict[float, list[str]] = {}
    layout = estimator.crane.layout
    for name, (time, values) in plan.series.items():
        early, std = time <= plan.time[0] + _EARLY, estimator.std_of[name]
        at = leaps(time[early], values[early], std, FASTEST[layout.sensors[name].unit], estimator.options.gate)
        if at.size:
            longest = at[np.argmax(np.diff([*at, early.sum()]))]
            for k in sorted({int(at[0]), int(longest)}):
                groups.setdefault(float(time[k]), []).append(name)
    best = _agreement(estimator, plan, since) if groups else -np.inf
    for begin, names in sorted(groups.items()):
        trial = since | dict.fromkeys(names, begin)
        found = _agreement(estimator, plan, trial)
        if found > best:
            best, since = found, trial
    return since


def _agreement(estimator: Any, plan: Plan, since: Mapping[str, float]) -> float:
    """Return the log-likelihood of the first samples where those of the channels in `since` before their times are not
    believed.
    """
    estimator.reset()
    tried = plan.without(estimator.channel_names, since)
    estimator.start_at(float(plan.time[0]), *tried.first_readings())
    count = plan.until(float(plan.time[0]) + 2.0 * _EARLY)
    left_out = sum(np.count_nonzero(plan.series[name][0] < begin) for name, begin in since.items())
    unlikely = estimator.options.unlikely * left_out  # as readings that the filter rejects
    return float(sum(estimator.on_plan(tried, k).log_likelihood for k in range(1, count)) - unlikely)
