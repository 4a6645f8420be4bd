"""Collects what the filter says, instant by instant, into an estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from crane_exudyn.crane import Crane

from .augment import unit_of
from .estimate import Estimate, Event
from .monitor import ABSENT, FROZEN, OUTLIER, USED
from .smoother import smooth
from .visible import show

#: flags of samples that are not believed, in words
REJECTED = {
    OUTLIER: "jumped by more than noise and physics allow: samples rejected",
    FROZEN: "frozen at one value: samples rejected",
}


class Outcome(NamedTuple):
    """What a step tells of k sensors: innovation (k,) and its variance (k,), SI, NaN where there is no sample; flags
    (k,) as of `monitor`; NIS, NaN where no sample was used; log-likelihood as of `Estimate`.
    """

    innovation: np.ndarray
    variance: np.ndarray
    flags: np.ndarray
    nis: float
    log_likelihood: float

    @classmethod
    def none(cls, sensors: int) -> Outcome:
        """Return what a step tells that was corrected by no sensor."""
        unknown = np.full(sensors, np.nan)
        return cls(unknown, unknown.copy(), np.full(sensors, ABSENT, np.uint8), float("nan"), 0.0)


class Recorder:
    """Collects a run into arrays that are allocated once; the smoother's share only where it is asked for."""

    def __init__(
        self, states: Sequence[str], channels: Sequence[str], time: np.ndarray, smooth: bool, keep_covariance: bool
    ) -> None:
        count, n, k = time.size, len(states), len(channels)
        self.states, self.channels, self.smooth = tuple(states), tuple(channels), smooth
        self.mean, self.std = np.empty((count, n)), np.empty((count, n))
        self.innovation, self.spread = np.full((count, k), np.nan), np.full((count, k), np.nan)
        self.flags = np.full((count, k), ABSENT, np.uint8)
        self.nis = np.full(count, np.nan)
        self.log_likelihood = 0.0
        self._at = 0
        size = count if smooth else 0
        self._keeps = smooth or keep_covariance
        self.covariance = np.empty((count if self._keeps else 0, n, n))
        self.prior_covariance, self.cross = np.empty((size, n, n)), np.empty((size, n, n))
        self.prior_mean = np.empty((size, n))

    def start(self, belief: Any) -> None:
        """Note the belief before the first step."""
        self._keep(0, belief)
        if self.smooth:
            self.prior_mean[0], self.prior_covariance[0], self.cross[0] = belief.mean, belief.covariance, 0.0

    def predicted(self, prior: Any) -> None:
        """Note a prediction for the smoother."""
        k = self._at + 1
        self.prior_mean[k], self.prior_covariance[k], self.cross[k] = prior.mean, prior.covariance, prior.cross

    def cut(self, belief: Any) -> None:
        """Tell the smoother that the filter was restarted: nothing passes back over this instant."""
        k = self._at + 1
        self.prior_mean[k], self.prior_covariance[k], self.cross[k] = belief.mean, belief.covariance, 0.0

    def note(self, k: int, belief: Any, outcome: Outcome) -> None:
        """Note the belief after step k, and what the step told."""
        self._keep(k, belief)
        self._at = k
        self.innovation[k], self.spread[k], self.flags[k] = outcome.innovation, outcome.variance, outcome.flags
        self.nis[k] = outcome.nis
        self.log_likelihood += outcome.log_likelihood

    def _keep(self, k: int, belief: Any) -> None:
        covariance = belief.covariance
        self.mean[k] = belief.mean
        self.std[k] = covariance.diagonal()
        if self._keeps:
            self.covariance[k] = covariance

    def estimate(
        self,
        plan: Any,
        events: list[tuple[float, str, str]],
        crane: Crane,
        method: str,
        sensor_std: np.ndarray,
        floor: float,
    ) -> Estimate:
        """Return what was collected; `sensor_std` (k,) and `floor` as in `Estimate`."""
        pressures = crane.layout.pressures
        smoothed = self._smoothed(pressures, floor) if self.smooth else None
        show(self.mean, self.std, pressures, floor)
        result = Estimate(
            time=plan.time,
            state_names=self.states,
            channel_names=self.channels,
            mean=self.mean,
            std=_root_of(self.std),
            measured=plan.values,
            innovation=self.innovation,
            innovation_std=_root_of(self.spread),
            flags=self.flags,
            nis=self.nis,
            dof=(self.flags == USED).sum(axis=1).astype(float),
            log_likelihood=self.log_likelihood,
            events=tuple(merged(events) + flagged(plan.time, self.flags, self.channels)),
            inputs=plan.inputs[plan.inner],
            crane=crane.name,
            method=method,
            sensor_std=sensor_std,
            covariance=self.covariance if self._keeps else None,
            floor=floor,
            pressures=pressures,
            units={n: unit_of(n, crane.layout) for n in (*self.states, *self.channels)},
            layout=crane.layout,
        )
        if smoothed is None:
            return result
        return replace(result, smoothed=replace(result, **smoothed, method=method + " + RTS smoother"))

    def _smoothed(self, pressures: slice, floor: float) -> dict[str, Any]:
        """Return what the smoother makes of mean, std and covariance."""
        mean, covariance = smooth(self.mean, self.covariance, self.prior_mean, self.prior_covariance, self.cross)
        variance = np.einsum("nii->ni", covariance).copy()
        show(mean, variance, pressures, floor)
        return {"mean": mean, "std": _root_of(variance), "covariance": covariance}


def _root_of(variance: np.ndarray) -> np.ndarray:
    """Return the standard deviations of variances, in their place: they are as long as the recording."""
    return np.sqrt(np.maximum(variance, 0.0, out=variance), out=variance)


def merged(events: Sequence[tuple[float, str, str]]) -> list[Event]:
    """Return events in order, those of the same place and kind put together; the first one's details are kept."""
    groups: dict[tuple[str, str], tuple[str, list[float]]] = {}
    for time, where, text in events:
        groups.setdefault((where, kind_of(text)), (text, []))[1].append(time)
    return [Event(min(t), max(t), where, text, len(t)) for (where, _), (text, t) in groups.items()]


def kind_of(text: str) -> str:
    """Return what the text of an event says before its details."""
    return text.split(":")[0]


def flagged(time: np.ndarray, flags: np.ndarray, channels: Sequence[str]) -> list[Event]:
    """Return an event for every run of rejected samples of a channel; runs less than 50 ms apart are one."""
    found = []
    for column, name in enumerate(channels):
        for flag, words in REJECTED.items():
            at = np.flatnonzero(flags[:, column] == flag)
            if at.size:
                runs = np.split(at, np.flatnonzero(np.diff(time[at]) > 0.05) + 1)
                found += [Event(float(time[r[0]]), float(time[r[-1]]), name, words, r.size) for r in runs]
    return sorted(found, key=lambda e: e.start)
