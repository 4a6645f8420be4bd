"""The result of a run of the estimator: states with intervals, innovations, consistency, and events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from crane_exudyn.errors import CraneError, nearest
from crane_exudyn.layout import Layout
from crane_exudyn.machine_toml import usual_layout
from crane_exudyn.signals import is_noise_free, noise_std

from . import consistency
from .monitor import FROZEN, OUTLIER, USED

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from crane_exudyn.plots import Shown

    from .plots import Judgement, Line

#: shares of a sensor's noise below which its innovations are small, below which they cannot hold that noise, and below
#: which a recording that does not hold it is taken to be without
_SMALL, _NO_NOISE = 0.5, 0.25
#: quantities that a representation names
_NAMED = 8
#: share of the steps at which a filter may fail and still be judged
_FEW_FAILURES = 0.01

#: what can be said of a filter's intervals, in the order in which it is asked: nothing; they are on the safe side,
#: since the recording has no noise; they hold; the innovations are larger than the filter expects; they are not random,
#: and the intervals allow for an error of the model; they keep their sign, so the model lacks something; the filter
#: takes its sensors to be noisier than they are; or expects more noise than there is
Consistency = Literal[
    "unjudged", "noise-free", "consistent", "too narrow", "allowed for", "lacking", "overstated", "too wide"
]
_VERDICTS: dict[Consistency, str] = {
    "unjudged": "cannot be judged: {}",
    "noise-free": "consistent; the recording has no noise",
    "consistent": "consistent",
    "too narrow": "not consistent: intervals too narrow",
    "allowed for": "not consistent: the model lacks something; the intervals allow for it",
    "lacking": "not consistent: the model lacks something",
    "overstated": "not consistent: intervals too wide",
    "too wide": "not consistent: intervals too wide",
}


@dataclass(frozen=True)
class Event:
    """Something that happened: from, to (s), where (channel, "time" or "filter"), what, and how many samples."""

    start: float
    end: float
    where: str
    text: str
    count: int = 1


@dataclass(frozen=True)
class Account:
    """What became of the model error in an estimate.

    Attributes:
        mode: "auto", "off" or "on", as asked for.
        used: whether it is part of the estimate.
        why: in words.
        found: {name: {"size", "nominal", "value", "std", "unit"}} of each unknown, SI: its size, what it would be if
            the model were right, and what it was at the end.
    """

    mode: str
    used: bool
    why: str
    found: Mapping[str, Mapping[str, Any]]

    def document(self) -> dict[str, Any]:
        """Return what the command writes as JSON."""
        return {"mode": self.mode, "used": self.used, "why": self.why, "unknowns": dict(self.found)}


@dataclass(frozen=True)
class Estimate:
    """The estimate over a recording: N instants, n quantities, k sensors; SI.

    Attributes:
        time: (N,) s.
        state_names, channel_names: names of the n quantities and the k sensors.
        mean, std: (N, n), pressures as gauges would show them (`visible`).
        measured: (N, k), NaN where there was no sample.
        innovation, innovation_std: (N, k), NaN where there was no sample.
        flags: (N, k) uint8, see `monitor`: used, absent, outlier, frozen.
        nis: (N,) and dof: (N,): normalised innovation squared of the samples used, and how many they were.
        log_likelihood: sum over all samples of the log of the density of their innovations, relative to the highest
            density of the sensors' noise: -½ (νᵀ S⁻¹ ν + log det S R⁻¹). A reading that the gate rejects counts as one
            at the gate, -½ gate², and one of a frozen sensor as zero, so that runs with other readings can be compared.
        events: what was unusual, from when to when.
        inputs: (N, valves + 2) spool positions in [-1, 1] and supply pressures, Pa.
        sensor_std: (k,) noise that the filter took the sensors to have.
        covariance: (N, n, n) of the filter's own state, which remembers voids, if it was kept.
        floor: Pa, the lowest pressure that a gauge shows; pressures: which of the n quantities are those of chambers.
        noise_slack: standard deviation of the mean NIS, because sensor noise was estimated from the recording
            (`consistency.noise_slack`).
        model_error: whether unknown errors of the model were estimated, and which, if that was asked for.
        smoothed: the smoothed estimate, if it was asked for.
        models: probability (N,) of each model, by its name, if several ran side by side.
    """

    time: np.ndarray
    state_names: tuple[str, ...]
    channel_names: tuple[str, ...]
    mean: np.ndarray
    std: np.ndarray
    measured: np.ndarray
    innovation: np.ndarray
    innovation_std: np.ndarray
    flags: np.ndarray
    nis: np.ndarray
    dof: np.ndarray
    log_likelihood: float
    events: tuple[Event, ...]
    inputs: np.ndarray
    crane: str = ""
    method: str = "ukf"
    sensor_std: np.ndarray | None = None
    covariance: np.ndarray | None = None
    floor: float = -np.inf
    pressures: slice = field(default_factory=lambda: slice(0))
    noise_slack: float = 0.0
    model_error: Account | None = None
    smoothed: Estimate | None = None
    models: Mapping[str, np.ndarray] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    layout: Layout = field(default_factory=usual_layout, repr=False)

    def __getitem__(self, name: str) -> np.ndarray:
        """Return the estimated mean (N,) of one quantity by its name. Raises CraneError, which lists the names, for
        another one.
        """
        if name not in self.state_names:
            raise CraneError(f"Estimate of {self.crane}: no quantity {name!r}.{nearest(name, list(self.state_names))}")
        return self.mean[:, self.state_names.index(name)]

    def first(self, count: int, **changes: Any) -> Estimate:
        """Return the estimate of the first `count` quantities only, with other attributes changed; the smoothed one
        too.
        """
        covariance = None if self.covariance is None else self.covariance[:, :count, :count]
        return replace(
            self,
            state_names=self.state_names[:count],
            mean=self.mean[:, :count],
            std=self.std[:, :count],
            covariance=covariance,
            smoothed=self.smoothed and self.smoothed.first(count, **changes),
            **changes,
        )

    def interval(self, probability: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Return lower and upper limits (N, n) of the intervals that hold each quantity with this probability.

        Raises:
            CraneError: a probability that is not between 0 and 1.
        """
        from scipy.stats import norm

        if not 0.0 < probability < 1.0:
            raise CraneError(f"interval: {probability:g} is no probability between 0 and 1. Give 0.95 for 95 %.")
        half = norm.ppf(0.5 + probability / 2) * self.std
        return self.visible(self.mean - half), self.mean + half

    def visible(self, states: np.ndarray) -> np.ndarray:
        """Return states (N, m) with no pressure below what a gauge shows; the same array, changed."""
        np.maximum(states[:, self.pressures], self.floor, out=states[:, self.pressures])
        return states

    @property
    def nis_mean(self) -> float:
        """Mean NIS over the instants with a sample; the number of sensors read, if the filter is consistent."""
        return float(np.nanmean(self.nis)) if np.isfinite(self.nis).any() else float("nan")

    @property
    def nis_bounds(self) -> tuple[float, float]:
        """The interval that holds the mean NIS of a consistent filter with a probability of 99 %."""
        known = np.isfinite(self.nis)
        if not known.any():
            return 0.0, 0.0
        low, high = consistency.mean_bounds(float(self.dof[known].mean()), int(known.sum()), 0.99)
        middle, half = 0.5 * (low + high), float(np.hypot(0.5 * (high - low), 2.576 * self.noise_slack))
        return max(middle - half, 0.0), middle + half

    @property
    def _normalised(self) -> np.ndarray:
        return np.where(self.flags == USED, self.innovation / self.innovation_std, np.nan)

    @cached_property
    def whiteness(self) -> dict[str, float]:
        """p-value of whiteness (Ljung-Box) of the normalised innovations of each sensor."""
        used = self._normalised
        return {n: consistency.ljung_box(used[:, i]) for i, n in enumerate(self.channel_names)}

    @property
    def coloured(self) -> tuple[str, ...]:
        """Sensors whose innovations are not white, at the 1 % level of all together."""
        p = self.whiteness
        known = sum(np.isfinite(v) for v in p.values())
        return tuple(n for n, v in p.items() if v < 0.01 / max(known, 1))

    @property
    def persistent(self) -> tuple[str, ...]:
        """Those of the coloured sensors whose innovations keep their sign for a while, which is an error of the model.

        An error that is small beside the noise of the sensor is none that a sensor could show.
        """
        used = dict(zip(self.channel_names, self._normalised.T, strict=True))
        large = dict(zip(self.channel_names, self._size > _SMALL * self._noise, strict=True))
        return tuple(n for n in self.coloured if large[n] and consistency.persistence(used[n]) > 0.0)

    @cached_property
    def _size(self) -> np.ndarray:
        """RMS innovation (k,) of the samples used."""
        used = np.where(self.flags == USED, self.innovation, 0.0)
        return np.asarray(np.sqrt((used**2).sum(axis=0) / np.maximum((self.flags == USED).sum(axis=0), 1)))

    @cached_property
    def _recorded_noise(self) -> np.ndarray:
        """Noise (k,) that the recording shows; where it has none, what looks like it."""
        return np.array([noise_std(y[np.isfinite(y)]) for y in self.measured.T])

    @cached_property
    def _noise(self) -> np.ndarray:
        """Noise (k,) of the sensors: what the filter takes it to be, or what the recording shows where that is less,
        but a quarter of it at least; 0 where it is not known.
        """
        if self.sensor_std is None:
            return np.zeros(len(self.channel_names))
        return np.asarray(np.clip(self._recorded_noise, _NO_NOISE * self.sensor_std, self.sensor_std))

    @cached_property
    def noiseless(self) -> bool:
        """Whether the recording has no noise, as a simulation, and the model explains it to far less than what the
        filter takes its sensors to have. Statistics of noise say nothing of it.
        """
        if self.sensor_std is None or not (self._size < _NO_NOISE * self.sensor_std).all():
            return False
        moves = (
            self._size < _SMALL * self._recorded_noise
        )  # innovations are never less than noise: what looks like more of it
        known = [y[np.isfinite(y)] for y in self.measured.T[~moves]]
        return all(is_noise_free(y) or np.ptp(y) == 0.0 for y in known if y.size)

    @property
    def overstated(self) -> tuple[str, ...]:
        """The sensors that the filter takes to be noisier than the recording shows them, by two or more."""
        std = np.zeros(len(self.channel_names)) if self.sensor_std is None else self.sensor_std
        return tuple(np.array(self.channel_names)[self._noise < _SMALL * std].tolist())

    @property
    def failures(self) -> int:
        """Number of steps at which the filter failed and was restarted; of several models, that of the worst."""
        filters = ("filter", *(f"filter of {name}" for name in self.models))
        return max(sum(e.count for e in self.events if e.where == where) for where in filters)

    @property
    def failed(self) -> bool:
        """Whether the filter failed so often that what it says is no estimate."""
        return self.failures > _FEW_FAILURES * (self.time.size - 1)

    @property
    def unjudged(self) -> str:
        """Why nothing can be said of the consistency, in words; "" where it can."""
        if self.failed:
            return f"the filter failed and was restarted at {self.failures} of {self.time.size - 1} steps"
        if not np.isfinite(self.nis).any():
            return "no sample was used"
        if self.nis_mean <= self.nis_bounds[1] and not any(np.isfinite(p) for p in self.whiteness.values()):
            return f"too few samples; at least {2 * consistency.LAGS} of one sensor are needed"
        return ""

    @property
    def consistent(self) -> bool:
        """Whether innovations have the size that the filter states (NIS) and are white, at the 1 % level each.

        Of a recording without noise: whether they are small.
        """
        return self.judgement in ("consistent", "noise-free")

    @property
    def allowed(self) -> bool:
        """Whether the intervals allow for an error of the model."""
        return self.model_error is not None and self.model_error.used

    @cached_property
    def judgement(self) -> Consistency:
        """Whether the filter's intervals can be believed.

        Innovations that keep their sign are an error of the model, whatever their size: noise that was widened until
        the size fits does not make them random, and what no sensor measures follows the model.
        """
        if self.unjudged:
            return "unjudged"
        if self.noiseless:
            return "noise-free"
        low, high = self.nis_bounds
        if low <= self.nis_mean <= high and not self.coloured:
            return "consistent"
        if self.nis_mean > high:
            return "too narrow"
        if self.allowed:
            return "allowed for"
        if self.persistent:
            return "lacking"
        return "overstated" if self.overstated else "too wide"

    @property
    def verdict(self) -> str:
        """The judgement in a few words."""
        return _VERDICTS[self.judgement].format(self.unjudged)

    def coverage(self, truth: np.ndarray, probability: float = 0.95) -> dict[str, float]:
        """Return the share of instants at which the true states (N, m), m <= n, are inside their intervals."""
        m = truth.shape[1]
        shares = consistency.coverage(self.visible(truth.copy()) - self.mean[:, :m], self.std[:, :m], probability)
        return dict(zip(self.state_names, shares.tolist(), strict=False))

    def document(self) -> dict[str, Any]:
        """Return what the command writes as JSON."""
        last = {
            n: {"value": float(self.mean[-1, i]), "std": float(self.std[-1, i]), "unit": self.units.get(n, "")}
            for i, n in enumerate(self.state_names)
        }
        return {
            "crane": self.crane,
            "method": self.method,
            "samples": int(self.time.size),
            "from": float(self.time[0]),
            "to": float(self.time[-1]),
            "filter": {
                "nis_mean": self.nis_mean,
                "nis_bounds": list(self.nis_bounds),
                "whiteness": self.whiteness,
                "consistent": self.consistent,
                "verdict": self.verdict,
                "log_likelihood": self.log_likelihood,
            },
            **({} if self.model_error is None else {"model_error": self.model_error.document()}),
            **({"models": {n: self._led(n) for n in self.models}} if self.models else {}),
            "sensor_noise": {}
            if self.sensor_std is None
            else dict(zip(self.channel_names, self.sensor_std.tolist(), strict=True)),
            "used": {n: int((self.flags[:, i] == USED).sum()) for i, n in enumerate(self.channel_names)},
            "final": last,
            "events": [
                {"from": e.start, "to": e.end, "where": e.where, "text": e.text, "count": e.count} for e in self.events
            ],
        }

    def _led(self, model: str) -> dict[str, Any]:
        """Return how probable one of several models was: at the end, on the average; and from when to when it was the
        likeliest, s.
        """
        probability, others = self.models[model], [p for name, p in self.models.items() if name != model]
        leads = probability > np.max(others, axis=0)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], leads, [False]])))
        spans = [[float(self.time[a]), float(self.time[b - 1])] for a, b in zip(edges[::2], edges[1::2], strict=True)]
        return {"final": float(probability[-1]), "mean": float(probability.mean()), "leads": spans}

    def save(self, path: str | Path) -> None:
        """Write .csv, .csv.gz, .parquet or .mat in SI, whole or not at all.

        One row an instant: time, spools, each state with its 95 % limits, innovations with their standard deviations,
        NIS.
        """
        from crane_exudyn.formats import write_table

        spools = zip(self.layout.cylinders, self.inputs[:, self.layout.spools].T, strict=True)
        columns = {"time[s]": self.time} | {f"U_{name}[-]": spool for name, spool in spools}
        low, high = self.interval()
        for i, name in enumerate(self.state_names):
            series = {name: self.mean, f"{name}_low95": low, f"{name}_high95": high}
            columns |= {f"{n}[{self._unit(name)}]": values[:, i] for n, values in series.items()}
        for i, name in enumerate(self.channel_names):
            series = {f"innovation_{name}": self.innovation, f"innovation_std_{name}": self.innovation_std}
            columns |= {f"{n}[{self._unit(name)}]": values[:, i] for n, values in series.items()}
        columns["nis[-]"] = self.nis
        columns |= {f"probability_{name}[-]": values for name, values in self.models.items()}
        write_table(path, columns, digits=9)

    def _unit(self, name: str) -> str:
        return self.units.get(name, "") or "-"

    def to_dataframe(self) -> Any:
        """Return estimated quantities and, as "name_std", their standard deviations as a pandas DataFrame over time in
        s; SI, the unit of each column in `attrs["units"]`. A file with units is written by `save`.
        """
        from crane_exudyn.formats import data_frame

        stds = {f"{n}_std": s for n, s in zip(self.state_names, self.std.T, strict=True)}
        columns = dict(zip(self.state_names, self.mean.T, strict=True)) | stds
        units = {n: self.units.get(n.removesuffix("_std"), "") for n in columns}
        return data_frame(self.time, columns, units)

    def plot(self, truth: np.ndarray | None = None) -> Figure:
        """Return a figure of states with 95 % intervals, measurements and innovations; `truth` (N, m) if it is
        known.
        """
        from .plots import estimate_figure

        low, high = self.nis_bounds
        title = (
            f"Estimate of {self.crane} by {self.method}: mean NIS {self.nis_mean:.3g} "
            f"(expected {low:.3g} … {high:.3g}), {self.verdict}"
        )
        return estimate_figure(self.time, self._lines(truth), self._judgement(), title)

    def figures(self, truth: np.ndarray | None = None) -> dict[str, Figure]:
        """Return the two halves of `plot` as figures of one column: "states" and "innovations"."""
        from .plots import innovations_figure, states_figure

        return {
            "states": states_figure(self.time, self._lines(truth)),
            "innovations": innovations_figure(self.time, self._judgement()),
        }

    def _lines(self, truth: np.ndarray | None) -> list[Line]:
        """Return each quantity as it is drawn."""
        from .plots import Line, Reading

        bad = (self.flags == OUTLIER) | (self.flags == FROZEN)
        readings = {n: Reading(self.measured[:, k], bad[:, k]) for k, n in enumerate(self.channel_names)}
        chambers, known = range(len(self.state_names))[self.pressures], 0 if truth is None else truth.shape[1]
        return [
            Line(
                self._shown(name), self.mean[:, i], self.std[:, i], self.floor if i in chambers else -np.inf,
                truth[:, i] if truth is not None and i < known else None, readings.get(name),
            )
            for i, name in enumerate(self.state_names)
        ]  # fmt: skip

    def _judgement(self) -> Judgement:
        """Return what the filter is judged by as it is drawn."""
        from .plots import Innovation, Judgement

        scaled = (self.innovation / self.innovation_std).T
        innovations = [
            Innovation(self._shown(name), values, self.whiteness[name])
            for name, values in zip(self.channel_names, scaled, strict=True)
        ]
        nis = np.divide(self.nis, self.dof, out=np.full(self.time.size, np.nan), where=self.dof > 0)
        return Judgement(innovations, nis, self.models)

    def _shown(self, name: str) -> Shown:
        """Return how people call and read a quantity or a sensor."""
        from crane_exudyn.plots import shown

        return shown(name, self.units.get(name, ""), self.layout)

    def _repr_html_(self) -> str:
        from crane_exudyn.display import table_html

        columns = ("quantity", "unit", "first", "last", "± (95 %)", "min", "max")
        low, high = self.nis_bounds
        note = f"Mean NIS {self.nis_mean:.4g}, expected {low:.3g} … {high:.3g}: {self.verdict}."
        odd = [f"{e.start:.3g} s, {e.where}: {e.text} ({e.count})." for e in self.events[:5]]
        title = f"Estimate of {self.crane} by {self.method}, {self.time[0]:g} … {self.time[-1]:g} s"
        return table_html(columns, self.ranges(), title=title, note=" ".join([note, *odd]))

    def ranges(self) -> list[tuple[str, str, float, float, float, float, float]]:
        """Return rows for people: name, unit, first and last value, half its 95 % interval, smallest, largest value."""
        rows = []
        for i, name in enumerate(self.state_names):
            _, _, factor, unit = self._shown(name)
            values, half = factor * self.mean[:, i], factor * 1.96 * float(self.std[-1, i])
            first, last, lowest, highest = map(float, (values[0], values[-1], values.min(), values.max()))
            rows.append((name, unit, first, last, half, lowest, highest))
        return rows

    def __repr__(self) -> str:
        low, high = self.nis_bounds
        names = self.state_names
        quantities = ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
        return (
            f"<Estimate of {quantities} by {self.method} at {self.time.size} instants, "
            f"{self.time[0]:.3f} … {self.time[-1]:.3f} s; NIS {self.nis_mean:.3g} (expected {low:.3g} … {high:.3g}): "
            f"{self.verdict}; {len(self.events)} event(s)>"
        )
