"""Model against measurement: how large the errors are, when they arise, and which balance is violated.

    comparison = compare("patu655", "lift.csv")
    comparison.where[0].text      # "between 7.6 and 8.5 s, while the tilt cylinder extends, chamber p3 receives …"

Three looks at one recording. Open loop: the crane starts where the recording starts (the start is fitted, because a
wrong one alone makes errors of thirty times the noise) and then sees nothing but the commands. Filtered: the Kalman
filter sees every sample and predicts the next. Balances: the smoother is given an unknown flow into each chamber and an
unknown moment at each joint (`balances`), so that what the model lacks shows in the equation in which it is lacking.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from crane_exudyn.crane import Crane, given_crane
from crane_exudyn.engines import engine_class
from crane_exudyn.errors import CraneError, names_of
from crane_exudyn.layout import Layout
from crane_exudyn.parameters import unit_of
from crane_exudyn.recording import Recording, given_recording
from ukf.consistency import noise_slack
from ukf.estimate import Estimate
from ukf.estimator import Estimator
from ukf.noise import ProcessNoise
from ukf.signals import Signals

from .balances import Balances, balances_of
from .findings import Finding, Scores, balance_words, people_unit, scores_of, value_text
from .fit.data import FINE, FitData, known_parameters
from .fit.model import model_of, spool_path
from .fit.objects import with_objects
from .fit.solve import Fit
from .fit.staged import residuals, run_fitted, timing_of
from .fitness import check_recording
from .metrics import pn_rmse, r2, rmse
from .phases import Phase, phases_of
from .report import amount, three_digits
from .selection.levels import noise_level
from .selection.model import open_loop_error

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Engine = Literal["semi-recursive", "exudyn"]
Series = dict[str, tuple[np.ndarray, np.ndarray]]

#: what the filter allows the model to be wrong by: next to nothing, so that whatever the model lacks is left in the
#: innovations
_TRUSTING: tuple[Mapping[str, float], float] = ({"rad": 1e-6, "m": 1e-6}, 1e6)
#: s at the start over which measured and simulated are compared, and by how many times the noise they may differ there
_FIRST, _OFF = 0.1, 3.0
#: a lateness of the commands beyond this is told where the model explains the recording, s
_LATE = 1e-3


@dataclass(frozen=True)
class ChannelError:
    """Open-loop error of one channel in `unit`: RMSE, bias (mean of measured minus model), and what they mean."""

    unit: str
    rmse: float
    pn_rmse: float
    noise_std: float
    error_over_noise: float
    bias: float
    r2: float


@dataclass(frozen=True)
class Comparison:
    """A crane laid beside a recording; SI but for `channels`, which are in the unit they state.

    Attributes:
        channels: open-loop errors by channel.
        estimate: the filter's run: innovations, NIS, whiteness.
        balances: residual flow of each chamber and residual moment of each joint over time, with uncertainty.
        scores: how well each phase of work is explained, by channel and by equation.
        where: where the model fails, worst first.
        measured, simulated: channel -> (time (n,), values (n,)), the open-loop run at the measured instants.
        commands: time (n,) and spool commands (n, valves).
        notes: what a reader should know about the recording.
        parameters: what was fitted to this recording alone, by name: value, nominal, unit (SI).
    """

    recording: str
    crane: str
    engine: str
    channels: Mapping[str, ChannelError]
    estimate: Estimate = field(repr=False)
    balances: Balances = field(repr=False)
    scores: Scores = field(repr=False)
    where: Sequence[Finding]
    measured: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(repr=False)
    simulated: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(repr=False)
    commands: tuple[np.ndarray, np.ndarray] = field(repr=False)
    notes: tuple[str, ...] = ()
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def error(self) -> float:
        """Open-loop RMS error over all samples in units of the noise, as in a diagnosis; 1 means nothing is left but
        noise.
        """
        samples = [len(self.measured[name][0]) for name in self.channels]
        return float(np.sqrt(np.average([c.error_over_noise**2 for c in self.channels.values()], weights=samples)))

    @property
    def consistent(self) -> bool:
        """Whether innovations are as large as the filter expects and white, at the 1 % level each."""
        return self.estimate.consistent

    @property
    def layout(self) -> Layout:
        """Of the machine."""
        return self.estimate.layout

    @property
    def phases(self) -> Sequence[Phase]:
        """What the crane was doing when."""
        return self.scores.phases

    @property
    def verdict(self) -> str:
        """The answer in two sentences: how large the error is, and where the model fails first."""
        size = f"The open-loop error is {self.error:.3g} times the noise of the sensors."
        if not self.where:
            return size + " No channel and no balance of the model is clearly off in any phase of work."
        if self.everywhere:
            return (
                f"{size} Every balance of the model is violated, worst the {balance_words(self.violated[0])}, so no "
                "single place stands out. "
                "Several parameters, or the recording itself, may be wrong."
            )
        first = next((f for f in self.where if f.kind == "equation"), self.where[0])
        return f"{size} {first.text[0].upper()}{first.text[1:]}."

    @property
    def violated(self) -> tuple[str, ...]:
        """The balances that are violated somewhere, worst first."""
        return tuple(dict.fromkeys(f.name for f in self.where if f.kind == "equation"))

    @property
    def everywhere(self) -> bool:
        """Whether every balance is violated, so that none of them says where something is missing."""
        return len(self.violated) == len(self.layout.equations)

    @property
    def started(self) -> str:
        """Where the open-loop run starts: as was measured, or how far from it."""
        off = []
        for name, (time, values) in self.measured.items():
            first = time <= time[0] + _FIRST
            by = float(np.mean((self.simulated[name][1] - values)[first]))
            if abs(by) > _OFF * self.channels[name].noise_std * people_unit(name, self.layout)[1]:
                off.append(f"{name} {value_text(name, abs(by), self.layout)} {'above' if by > 0.0 else 'below'}")
        where = f"away from the measured values: {', '.join(off)}" if off else "at the measured values"
        return f"The run starts {where}; the start was fitted. From there it gets only the commands."

    @property
    def fitted(self) -> str:
        """What was fitted to this recording alone, such as "payload.mass = 219.7 kg, fitted (file: 25 kg)"; else
        nothing.
        """
        return "; ".join(
            f"{n} = {amount(p['value'], p['unit'])}, fitted (file: {amount(p['nominal'], p['unit'])})"
            for n, p in self.parameters.items()
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as `patu compare --json` writes it."""
        return {
            "recording": self.recording,
            "crane": self.crane,
            **({"parameters": self.parameters} if self.parameters else {}),
            "channels": {name: dict(vars(c)) for name, c in self.channels.items()},
            "filter": {
                "nis_mean": self.estimate.nis_mean,
                "nis_bounds": list(self.estimate.nis_bounds),
                "whiteness": self.estimate.whiteness,
                "consistent": self.consistent,
            },
            "where": [finding.to_dict() for finding in self.where],
        }

    def save(self, path: str | Path) -> None:
        """Write what was measured and what the open-loop run gave in SI to .csv, .csv.gz, .parquet or .mat.

        One row an instant of any channel, `z1_measured[rad]`, `z1_simulated[rad]`, …; NaN where a channel has no
        sample.
        """
        from crane_exudyn import channels
        from crane_exudyn.formats import write_table

        time = np.unique(np.concatenate([own for own, _ in self.measured.values()]))
        columns, units = {"time[s]": time}, channels.of(self.layout)
        for name in self.channels:
            for kind, series in (("measured", self.measured), ("simulated", self.simulated)):
                own, values = series[name]
                column = np.full(time.size, np.nan)
                column[np.searchsorted(time, own)] = values
                columns[f"{name}_{kind}[{units[name]}]"] = column
        write_table(path, columns)

    def plot(self) -> Figure:
        """Return the picture for a glance: what fails when, above the commands that were given."""
        from .comparison_figures import where_figure

        return where_figure(self.scores, *self.commands, f"Where {self.crane} fails on {self.recording}")

    def figures(self) -> dict[str, Figure]:
        """Return all pictures by name: "where", "open_loop", "balances", "balances_by_work"."""
        from .comparison_figures import balances_figure, by_work_figure, open_loop_figure

        errors = {name: c.error_over_noise for name, c in self.channels.items()}
        return {
            "where": self.plot(),
            "open_loop": open_loop_figure(self.measured, self.simulated, errors, self.layout),
            "balances": balances_figure(self.balances, self.phases, self.layout),
            "balances_by_work": by_work_figure(self.scores),
        }

    def _repr_html_(self) -> str:
        from crane_exudyn.display import table_html

        columns = ("channel", "unit", "RMSE", "% of range", "bias", "noise", "error / noise", "R²")
        errors = [
            (n, c.unit, c.rmse, c.pn_rmse, c.bias, c.noise_std, three_digits(c.error_over_noise), c.r2)
            for n, c in self.channels.items()
        ]
        worst = [(f.score, f.text) for f in self.where[:8]]
        title = f"{self.recording} against {self.crane}: open loop"
        note = " ".join(filter(None, (self.verdict, f"{self.fitted}." if self.fitted else "")))
        return table_html(columns, errors, title=title, note=note) + (
            table_html(("score", "where"), worst, title="Where the model fails") if worst else ""
        )

    def __repr__(self) -> str:
        filtered = "consistent" if self.consistent else "NOT consistent"
        return (
            f"<Comparison of {self.recording} with {self.crane}: open-loop error {self.error:.3g} noise units, filter "
            f"{filtered} "
            f"(mean NIS {self.estimate.nis_mean:.3g}), {len(self.where)} places where the model fails>"
        )


def compare(
    crane: Crane | str | Path,
    recording: Recording | str | Path,
    engine: Engine = "semi-recursive",
    *,
    progress: Callable[[float], None] | None = None,
) -> Comparison:
    """Return how well a crane's model predicts a recording, and where it fails.

    Args:
        crane: the crane with its effects, or a name or file.
        recording: the recording, or its file.
        engine: which engine runs open loop and in the filter; the start and the residual balances are always found with
            the semi-recursive one, the only one that takes unknown inputs.
        progress: called with the fraction done.

    Raises:
        CraneError: the recording cannot be compared (see `fitness.check_recording`), or an unknown engine.
    """
    engine_class(engine)  # refused at once where there is none
    crane = given_crane(crane, "compare")
    if crane.objects and engine != "exudyn":
        raise CraneError(
            f'{crane.name}: only the Exudyn engine knows user-defined objects. Compare with engine="exudyn".'
        )
    recording = given_recording(recording, crane.layout, "compare")
    done = progress or (lambda fraction: None)
    notes = check_recording(recording, crane)
    data = with_objects(crane, FitData.of(recording, crane))
    bare = replace(crane, objects=())  # what the objects do, the data know
    start = started(bare, data)
    late, starts = start.late, start.starts
    del start  # of ten minutes it holds as much as the recording
    done(0.3)
    data = data.with_step(FINE).shifted(late)
    balances = balances_of(bare, data)
    done(0.6)
    estimate = filtered(crane, data, engine, lambda f: done(0.6 + 0.3 * f))
    estimate = replace(estimate, noise_slack=noise_slack(crane, recording, estimate.channel_names))
    measured, simulated, channels = _open_loop_errors(crane, recording, starts, late, engine)
    scores = scores_of(estimate, balances, _phases(crane, data, balances))
    done(1.0)
    for begin, end in balances.unsettled:
        notes.append(
            f"the residual balances from {begin:.1f} to {end:.1f} s had not converged when the smoother stopped: "
            + ("their ± is too small" if scores.badly_predicted.any() else "they are not judged")
        )
    found = Comparison(
        recording.name, crane.name, engine, channels, estimate, balances, scores, scores.findings(), measured,
        simulated,
        (data.command_time, data.commands), tuple(notes),
    )  # fmt: skip
    clocks = timing_of(data)
    sure = found.error < noise_level(data) and abs(late) < 0.9 * clocks.upper * clocks.scale
    return replace(found, notes=(*lateness_words(late), *notes)) if sure else found


def lateness_words(late: float) -> list[str]:
    """Return the note on commands that were taken to come `late` seconds after their stamps, where that is not little.

    Only to be told where nothing but noise is left: commands that are shifted also do a little of whatever a model
    lacks.
    """
    if abs(late) < _LATE:
        return []
    way, pace = ("after", "slower") if late > 0.0 else ("before", "faster")
    return [
        f"the commands are assumed to act {1e3 * abs(late):.1f} ms {way} their time stamps: clocks differ by "
        f"this, or the valves are {pace} than the crane file says"
    ]


def compare_all(
    crane: Crane,
    recordings: Sequence[Recording],
    engine: Engine = "semi-recursive",
    *,
    per_recording: Sequence[str] = (),
    progress: Callable[[float], None] | None = None,
) -> list[Comparison]:
    """Return one comparison a recording, each with its own value of the nominal parameters `per_recording`, which is
    fitted.

    Raises:
        CraneError: as `compare`, or one of them is no parameter of the crane that is uncertain.
    """
    own = known_parameters(crane, names_of(per_recording, "per_recording"))
    found = []
    for i, recording in enumerate(recordings):
        its = with_its_own(crane, recording, own)
        share = partial(_share, progress, i / len(recordings), 1.0 / len(recordings))
        its_own = own_parameters(its, crane, own)
        found.append(replace(compare(its, recording, engine, progress=share), parameters=its_own))
    return found


def with_its_own(crane: Crane, recording: Recording, own: Sequence[str]) -> Crane:
    """Return the crane as it was in a recording: the nominal parameters `own` fitted to that recording, with the
    start.
    """
    return open_loop_error(crane, recording, own=own)[1].crane if own else crane


def own_parameters(crane: Crane, nominal: Crane, own: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the parameters `own` of a crane as it was in a recording, each beside what the crane file says (SI)."""
    return {n: {"value": crane[n], "nominal": nominal[n], "unit": unit_of(n)} for n in own}


def started(crane: Crane, data: FitData) -> Fit:
    """Return the crane as it is, its first state chosen so that the open-loop run explains the recording best.

    Beside the start, only the lateness of the commands against the sensors (a few ms at most) is free: it belongs to
    the recorder, not to the crane.
    """
    return run_fitted(crane, data, (timing_of(data),))


# -- the three looks -------------------------------------------------------------------------------------------------


def _open_loop_errors(
    crane: Crane, recording: Recording, starts: np.ndarray, late: float, engine: Engine
) -> tuple[Series, Series, dict[str, ChannelError]]:
    """Return what was measured at every sample, what an open-loop run gives there, and each channel's error."""
    data = FitData.whole(recording, crane).shifted(late)
    measured, simulated = open_loop(crane, data, starts, engine)
    errors = {
        s.channel: _channel_error(s.channel, crane.layout, measured[s.channel][1], simulated[s.channel][1], s.noise)
        for s in data.samples
    }
    return measured, simulated, errors


def open_loop(crane: Crane, data: FitData, starts: np.ndarray, engine: Engine) -> tuple[Series, Series]:
    """Return measured and simulated channels, (time, values) each at the measured instants, of a run that sees only
    commands.

    It begins with `starts`, (nx,) or (S, nx) for each stretch of known commands.

    Raises:
        CraneError: the run on the Exudyn engine leaves what the crane can do.
    """
    simulate = None
    if engine == "exudyn":
        from crane_exudyn.engine import ExudynEngine

        simulate = partial(ExudynEngine(crane).simulate, step=data.step)
    left = residuals(replace(crane, objects=()), data, starts, simulate=simulate)
    measured = {s.channel: (left[s.channel][0], s.values) for s in data.samples}
    return measured, {s.channel: (left[s.channel][0], s.values - left[s.channel][1] * s.noise) for s in data.samples}


def from_one_start(recording: Recording, cranes: Mapping[str, Crane]) -> dict[str, Series]:
    """Return what was measured, and open-loop runs of several cranes, by label, from the start that suits the last one
    best.
    """
    *_, last = cranes.values()
    start = started(last, FitData.of(recording, last))
    lines: dict[str, Series] = {}
    for label, crane in cranes.items():
        data = FitData.whole(recording, crane).shifted(start.late)
        own = start.starts[:, : model_of(crane, data).nx]  # of a pendulum that only the last one has, nothing
        measured, simulated = open_loop(crane, data, own, "semi-recursive")
        lines |= {"measured": measured, label: simulated}
    return lines


def filtered(crane: Crane, data: FitData, engine: Engine, progress: Callable[[float], None] | None = None) -> Estimate:
    """Return the run of a filter that trusts the model, and believes every sample; it begins anew after unknown
    commands.
    """
    noise = {s.channel: s.noise for s in data.samples}
    estimator = Estimator(
        crane, engine, sensors=noise, noise=ProcessNoise.of(crane.layout, *_TRUSTING), max_step=data.step, gate=None,
        strokes=False,
    )  # fmt: skip
    runs = []
    for first, last in data.stretches:
        done = partial(_share, progress, first / len(data.time), (last - first) / len(data.time))
        runs.append(estimator.run(_signals(data, first, last, crane.layout), progress=done))
    return joined(runs)


def longest_stretch(data: FitData, layout: Layout) -> tuple[Signals, dict[str, float]]:
    """Return what a filter sees of the longest stretch with known commands, and the noise of the sensors."""
    first, last = max(data.stretches, key=lambda s: s[1] - s[0])
    return _signals(data, first, last, layout), {s.channel: s.noise for s in data.samples}


def _share(progress: Callable[[float], None] | None, done: float, share: float, fraction: float) -> None:
    if progress is not None:
        progress(done + share * fraction)


def _signals(data: FitData, first: int, last: int, layout: Layout) -> Signals:
    """Return what the filter sees of the stretch of grid points first … last."""
    sensors = {}
    for s in data.samples:
        own = s.picked((s.index >= first) & (s.index <= last))
        if len(own.values):
            sensors[s.channel] = (data.times(own), own.values)
    supply = {n: (data.time, v) for n, v in zip(layout.supply, data.supply.T, strict=True) if np.isfinite(v).any()}
    return Signals(data.command_time, data.commands, sensors, supply, data.name)


def joined(runs: Sequence[Estimate]) -> Estimate:
    """Return the runs of one estimator over stretches of a recording as one estimate."""
    if len(runs) == 1:
        return runs[0]
    names = ("time", "mean", "std", "measured", "innovation", "innovation_std", "flags", "nis", "dof", "inputs")
    arrays: dict[str, Any] = {name: np.concatenate([getattr(r, name) for r in runs]) for name in names}
    return replace(
        runs[0],
        **arrays,
        log_likelihood=sum(r.log_likelihood for r in runs),
        events=tuple(event for r in runs for event in r.events),
    )


def _phases(crane: Crane, data: FitData, balances: Balances) -> list[Phase]:
    """Return what the crane was doing when, anew after each span of unknown commands, up to the last sample: the grid
    goes a step on.
    """
    spool, end = spool_path(crane, data), max(float(data.times(s).max()) for s in data.samples)
    at_instants = np.column_stack([np.interp(balances.time, data.time, u) for u in spool.T])
    begins = [int(np.searchsorted(balances.time, data.time[first] - 1e-9)) for first, _ in data.stretches]
    found = []
    for a, b in pairwise([*begins, len(balances.time)]):
        own = phases_of(crane, balances.time[a:b], at_instants[a:b], balances.states[a:b])
        found += [replace(p, first=p.first + a, last=p.last + a, end=min(p.end, end)) for p in own]
    return found


def _channel_error(
    channel: str, layout: Layout, measured: np.ndarray, simulated: np.ndarray, noise: float
) -> ChannelError:
    unit, factor = people_unit(channel, layout)
    both = simulated[:, None], measured[:, None]
    error = float(rmse(*both)[0])
    return ChannelError(
        unit, error / factor, float(pn_rmse(*both)[0]), noise / factor, error / noise,
        float(np.mean(measured - simulated)) / factor, float(r2(*both)[0]),
    )  # fmt: skip
