"""Model against measurement: how large the errors are, when they arise, and which balance is violated.

    comparison = compare("patu655", "lift.csv")
    comparison.where[0].text      # "between 7.6 and 8.5 s, while the tilt cylinder extends, chamber p3 receives …"

Three looks at one recording. Open loop: the crane starts where the recording starts (the start is fitted, because a wrong one alone
makes errors of thirty times the noise) and then sees nothing but the commands. Filtered: the Kalman filter sees every sample and
predicts the next. Balances: the smoother is given an unknown flow into each chamber and an unknown moment at each joint
(`balances`), so that what the model lacks shows in the equation in which it is lacking.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.recording import Recording
from ukf.estimate import Estimate
from ukf.estimator import Estimator
from ukf.signals import Signals

from .balances import EQUATIONS, Balances, balances_of
from .fit.data import FitData
from .fit.model import model_of, output_rows, shown, spool_path
from .fit.solve import Fit
from .fit.staged import LOOSE, STIFF, TIGHT, WHOLE, first_knots, residuals, staged
from .fitness import check_recording, usable
from .metrics import pn_rmse, r2, rmse
from .phases import Phase, phases_of

if TYPE_CHECKING:
    pass

Engine = Literal["semi-recursive", "exudyn"]

#: unit for people by the first letter(s) of a channel, and what one of it is in SI
_UNITS = {"dz": ("deg/s", np.pi / 180), "z": ("deg", np.pi / 180), "p": ("bar", 1e5), "s": ("mm", 1e-3)}
#: a phase counts as badly predicted when the innovations' RMS is so many times what the filter expects
_PREDICTED_BADLY = 1.5
#: a balance counts as violated when its residual is so many standard deviations from zero
_VIOLATED = 4.0


@dataclass(frozen=True)
class ChannelError:
    """Open-loop error of one channel in `unit`: RMS, bias (mean of measured minus model), and what they mean."""

    unit: str
    rmse: float
    pn_rmse: float
    noise_std: float
    error_over_noise: float
    bias: float
    r2: float


@dataclass(frozen=True)
class Finding:
    """One place where the model fails: a channel or an equation, from, to (s), phase of work, score, and a sentence.

    The score is in standard deviations: of what the filter expects for a channel, of its own uncertainty for a balance.
    """

    kind: Literal["channel", "equation"]
    name: str
    start: float
    end: float
    phase: str
    score: float
    text: str

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as the JSON of compare has it."""
        place = {self.kind: self.name, "from": self.start, "to": self.end}
        return place | {"phase": self.phase, "score": self.score, "text": self.text}


@dataclass(frozen=True)
class Comparison:
    """A crane laid beside a recording; SI but for `channels`, which are in the unit they state.

    Attributes:
        channels: open-loop errors by channel.
        estimate: the filter's run: innovations, NIS, whiteness.
        phases: what the crane was doing when.
        balances: residual flow of each chamber and residual moment of each joint, with uncertainty.
        where: where the model fails, worst first.
        measured, simulated: channel -> (time (n,), values (n,)), the simulation at the measured instants.
        notes: what a reader should know about the recording.
    """

    recording: str
    crane: str
    engine: str
    channels: Mapping[str, ChannelError]
    estimate: Estimate = field(repr=False)
    phases: Sequence[Phase] = field(repr=False)
    balances: Balances = field(repr=False)
    where: Sequence[Finding]
    measured: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(repr=False)
    simulated: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(repr=False)
    notes: tuple[str, ...] = ()

    @property
    def error(self) -> float:
        """Open-loop RMS error over all channels in units of the noise; 1 means nothing is left but noise."""
        return float(np.sqrt(np.mean([c.error_over_noise**2 for c in self.channels.values()])))

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as `patu compare --json` writes it."""
        return {
            "recording": self.recording,
            "crane": self.crane,
            "channels": {name: dict(vars(c)) for name, c in self.channels.items()},
            "filter": {
                "nis_mean": self.estimate.nis_mean,
                "nis_bounds": list(self.estimate.nis_bounds),
                "whiteness": self.estimate.whiteness,
                "consistent": self.estimate.consistent,
            },
            "where": [finding.to_dict() for finding in self.where],
        }


def compare(
    crane: Crane | str,
    recording: Recording | str | Path,
    engine: Engine = "semi-recursive",
    *,
    progress: Callable[[float], None] | None = None,
) -> Comparison:
    """Return how well a crane's model predicts a recording, and where it fails.

    Args:
        crane: the crane with its effects, or a name or file.
        recording: the recording, or its file.
        engine: which engine runs open loop and in the filter; the start and the residual balances are always found with the
            semi-recursive one, the only one that takes unknown inputs.
        progress: called with the fraction done.

    Raises:
        CraneError: the recording cannot be compared (see `fitness.check_recording`), or an unknown engine.
    """
    if engine not in ("semi-recursive", "exudyn"):
        raise CraneError(f'There is no engine {engine!r}. Use "exudyn" or "semi-recursive".')
    crane = Crane.load(crane) if isinstance(crane, str) else crane
    recording = recording if isinstance(recording, Recording) else Recording.load(recording)
    done = progress or (lambda fraction: None)
    notes = check_recording(recording, crane)
    kept = usable(recording)
    data = FitData.of(kept, crane)
    loose = staged(crane, data, (), np.zeros(0), first_knots(crane, data), (LOOSE,))
    start = staged(crane, data, (), np.zeros(0), loose, (TIGHT, STIFF, WHOLE))
    done(0.3)
    measured, simulated = open_loop(crane, FitData.of(kept, crane, rate=np.inf), start, engine)
    done(0.4)
    estimate = filtered(crane, data, engine, lambda f: done(0.4 + 0.3 * f))
    balances = balances_of(crane, data, loose)
    spool = spool_path(crane, data)
    on_instants = np.column_stack([np.interp(balances.time, data.time, u) for u in spool.T])
    phases = phases_of(crane, balances.time, on_instants, balances.states)
    noise = {s.channel: s.noise for s in FitData.of(kept, crane, rate=np.inf).samples}
    channels = {c: _channel_error(c, measured[c][1], simulated[c][1], noise[c]) for c in measured}
    where = sorted(
        [*_badly_predicted(estimate, phases), *_violations(balances, phases)], key=lambda f: f.score, reverse=True
    )
    done(1.0)
    return Comparison(
        recording.name,
        crane.name,
        engine,
        channels,
        estimate,
        phases,
        balances,
        where,
        measured,
        simulated,
        tuple(notes),
    )


# -- the three looks -------------------------------------------------------------------------------------------------

Series = dict[str, tuple[np.ndarray, np.ndarray]]


def open_loop(crane: Crane, data: FitData, start: Fit, engine: Engine) -> tuple[Series, Series]:
    """Return measured and simulated channels, (time, values) each at the measured instants, of a run that sees only commands."""
    measured = {s.channel: (data.time[s.index] + s.fraction * data.step, s.values) for s in data.samples}
    if engine == "semi-recursive":
        left = residuals(crane, data, start.knots[0])
        simulated = {s.channel: (left[s.channel][0], s.values - left[s.channel][1] * s.noise) for s in data.samples}
        return measured, simulated
    from crane_exudyn.engine import ExudynEngine

    model = model_of(crane, data)
    X = ExudynEngine(crane).simulate(start.knots[0], data.time, model.W, step=data.step)
    Z = shown(data.channels, output_rows(data.channels, X, model.P)[0], model.E, data.step)
    simulated = {
        s.channel: (measured[s.channel][0], Z[s.index, j] + s.fraction * (Z[s.index + 1, j] - Z[s.index, j]))
        for j, s in enumerate(data.samples)
    }
    return measured, simulated


def filtered(crane: Crane, data: FitData, engine: Engine, progress: Callable[[float], None] | None = None) -> Estimate:
    """Return the filter's run over the recording, at the recording's own noise."""
    sensors = {s.channel: (data.time[s.index] + s.fraction * data.step, s.values) for s in data.samples}
    supply = {n: (data.time, v) for n, v in zip(("pp", "pt"), data.supply.T, strict=True) if np.isfinite(v).any()}
    signals = Signals(data.time, data.commands, sensors, supply, data.name)
    noise = {s.channel: s.noise for s in data.samples}
    return Estimator(crane, engine, sensors=noise, max_step=data.step).run(signals, progress=progress)


def _channel_error(channel: str, measured: np.ndarray, simulated: np.ndarray, noise: float) -> ChannelError:
    unit, factor = people_unit(channel)
    both = simulated[:, None], measured[:, None]
    error = float(rmse(*both)[0])
    return ChannelError(
        unit, error / factor, float(pn_rmse(*both)[0]), noise / factor, error / noise,
        float(np.mean(measured - simulated)) / factor, float(r2(*both)[0]),
    )  # fmt: skip


def people_unit(channel: str) -> tuple[str, float]:
    """Return the unit in which people read a channel, and what one of it is in SI."""
    return next(_UNITS[head] for head in _UNITS if channel.startswith(head))


# -- where it fails --------------------------------------------------------------------------------------------------


def _badly_predicted(estimate: Estimate, phases: Sequence[Phase]) -> list[Finding]:
    """Return the phases and channels in which the filter's next-sample prediction errs by more than it expects."""
    found = []
    relative = estimate.innovation / estimate.innovation_std
    for phase in phases:
        inside = (estimate.time >= phase.start) & (estimate.time < phase.end)
        for j, channel in enumerate(estimate.channel_names):
            values = relative[inside, j]
            values = values[np.isfinite(values)]
            if len(values) < 5:
                continue
            score = float(np.sqrt(np.mean(values**2)))
            if score > max(_PREDICTED_BADLY, 1.0 + 4.0 / np.sqrt(2.0 * len(values))):
                error = float(np.sqrt(np.nanmean(estimate.innovation[inside, j] ** 2)))
                text = f"{phase.words}, {channel} is {_amount(channel, error)} (RMS) away from what the filter expects next"
                text += f": {score:.1f} times what noise explains"
                found.append(Finding("channel", channel, phase.start, phase.end, phase.kind, score, text))
    return found


def _amount(channel: str, value: float) -> str:
    unit, factor = people_unit(channel)
    return f"{value / factor:.2g} {unit}"


def _violations(balances: Balances, phases: Sequence[Phase]) -> list[Finding]:
    """Return the phases and equations whose mean residual is clearly not zero."""
    found = []
    for phase in phases:
        means, stds = balances.mean(phase.first, phase.last)
        for equation, mean, std in zip(EQUATIONS, means, stds, strict=True):
            score = abs(float(mean / std))
            if score > _VIOLATED:
                text = f"{phase.words}, {violation(equation, float(mean), float(std))}"
                found.append(Finding("equation", equation, phase.start, phase.end, phase.kind, score, text))
    return found


_BODY = {"torque.O": "joint O (lift boom)", "torque.A": "joint A (outer boom)"}
_SIDE = {
    "p1": "lift, piston side", "p2": "lift, rod side", "p3": "tilt, piston side", "p4": "tilt, rod side"
}  # fmt: skip


def violation(equation: str, mean: float, std: float) -> str:
    """Return what a residual means, ± its 95 % interval: flows in l/min, moments in N m."""
    if equation.startswith("flow."):
        chamber = equation.removeprefix("flow.")
        amount = rounded(abs(mean) * 6e4, 1.96 * std * 6e4)
        return f"chamber {chamber} ({_SIDE[chamber]}) receives {amount} l/min {'more' if mean > 0 else 'less'} than the model says"
    amount = rounded(abs(mean), 1.96 * std)
    way = "upwards" if mean > 0 else "downwards"
    return f"{_BODY[equation]} is turned {way} by {amount} N m more than the model says"


def rounded(value: float, uncertainty: float) -> str:
    """Return "2.1 ± 0.3": the uncertainty with one or two leading digits, the value to the same place."""
    places = max(
        0,
        1
        - int(np.floor(np.log10(max(uncertainty, 1e-12))))
        - (uncertainty / 10 ** np.floor(np.log10(max(uncertainty, 1e-12))) >= 3),
    )
    return f"{value:.{places}f} ± {uncertainty:.{places}f}"
