"""Compare, diagnose, add, until nothing more is justified; where no effect alone explains a recording, one after the other (`stepwise`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.recording import Recording

from .diagnosis import LEVEL, Candidate, Diagnosis, diagnose, sentence, several, together
from .fit.data import FitData
from .fit.staged import FINE, residuals, rms
from .history import added
from .search.weigh import open_loop_error
from .stepwise import Grown, explained, grow

#: an effect that does not explain everything is still added if the error on what was not fitted falls by this share
WORTH = 0.1
#: the two engines' errors may differ by this share before it is said
AGREEMENT = 0.05


@dataclass(frozen=True)
class Step:
    """One step: what was added (None: the model as given, "parameters", or effects) and what that did to the errors.

    Errors are open-loop RMS in noise units on the Exudyn engine; search_error is the one that the search's engine reported.
    """

    added: str | None
    error: float
    check_error: float
    nis_mean: float
    verdict: str
    search_error: float = math.nan
    text: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON of improve."""
        return {
            k: getattr(self, k)
            for k in ("added", "error", "check_error", "nis_mean", "verdict", "search_error", "text")
        }


@dataclass(frozen=True)
class Improvement:
    """The steps from the crane as given to the one that explains the recording as far as effects are justified.

    `grown`: what was found where no single effect explained the recording, with the evidence for each effect; None otherwise.
    """

    recording: str
    steps: tuple[Step, ...]
    crane: Crane
    verdict: str
    diagnoses: tuple[Diagnosis, ...]
    grown: Grown | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know about the recordings; and what the data demand, cannot separate and leave, where several effects were taken in."""
        about = self.diagnoses[0].notes if self.diagnoses else ()
        return about if self.grown is None else (*about, *explained(self.grown))

    def to_dict(self, path: str | Path = "") -> dict[str, Any]:
        """Return the JSON of improve; `path` is where the crane file was written."""
        steps = [s.to_dict() for s in self.steps]
        return {"steps": steps, "crane": str(path), "verdict": self.verdict, "notes": list(self.notes)}

    def __repr__(self) -> str:
        errors = " -> ".join(f"{s.error:.3g}" for s in self.steps)
        names = ", ".join(s.added for s in self.steps if s.added) or "nothing"
        return f"<Improvement on {self.recording}: added {names}; error {errors} noise units; left: {self.verdict}>"

    def plot(self) -> Any:
        """Return a figure of the falling error."""
        from .search.plots import improvement_figure

        return improvement_figure(self)

    def to_csv(self, path: str | Path) -> None:
        """Write the steps to .csv, .csv.gz, .parquet or .mat; errors in units of the noise."""
        from crane_exudyn.formats import write_table

        columns: dict[str, Any] = {"added": np.array([s.added or "" for s in self.steps], dtype=str)}
        for key in ("error", "check_error", "nis_mean"):
            columns[key] = np.array([getattr(s, key) for s in self.steps])
        columns["verdict"] = np.array([s.verdict for s in self.steps], dtype=str)
        write_table(path, columns)

    def _repr_html_(self) -> str:
        from crane_exudyn.display import table_html

        rows = [(s.added or "as given", s.error, s.check_error, s.nis_mean, s.text) for s in self.steps]
        columns = ("added", "error / noise", "on check", "NIS", "what was found")
        return table_html(columns, rows, title=repr(self).strip("<>"))


Progress = Callable[[str, float], None]


def improve(
    crane: Crane,
    recording: Recording | Sequence[Recording],
    check: Recording | None = None,
    *,
    per_recording: Sequence[str] = (),
    jobs: int = 2,
    most: int = 4,
    told: Callable[[Step], None] = lambda step: None,
    progress: Progress = lambda text, share: None,
) -> Improvement:
    """Return the crane improved step by step; each step's errors are confirmed on the Exudyn engine.

    Args:
        crane: the crane file as given.
        recording, check: learned from (several of one machine together), and only predicted.
        per_recording: nominal parameters that differ from recording to recording.
        jobs: processes to use.
        most: at most so many steps; where effects are taken in one by one, at most so many of them.
        told: called with each step as soon as it is known.
        progress: called with a text and the share that is done of the current step.
    """
    current, best = crane, crane
    judge = _Judge(several(recording), check, tuple(per_recording))
    steps: list[Step] = []
    diagnoses: list[Diagnosis] = []
    while True:
        d = diagnose(current, judge.recordings, check, per_recording=per_recording, jobs=jobs, progress=progress)
        diagnoses.append(d)
        if not steps:
            steps.append(_step(None, crane, d, judge))
            told(steps[-1])
        if d.verdict == "unknown" and not d.misses_check and len(judge.recordings) == 1:
            grown = grow(current, judge.recordings[0], check, jobs=jobs, most=most, progress=progress)
            if grown is not None and _predicts_better(grown):
                return _grown(grown, best, judge, steps, diagnoses, told)
        chosen = _worth_adding(d, steps[-1])
        if chosen is None or len(steps) > most:
            return Improvement(
                d.recording, tuple(steps), best, d.verdict if len(steps) == 1 else _left(d), tuple(diagnoses)
            )
        name = chosen.name
        entry = {
            "recording": d.recording,
            "evidence": chosen.evidence,
            "verdict": d.verdict,
            "error_before": steps[-1].error,
        }
        best = added(best, replace(chosen.crane, history=best.history), **entry)
        steps.append(_step(name, best, d, judge))
        told(steps[-1])
        if not chosen.effects:
            return Improvement(d.recording, tuple(steps), best, "adequate", tuple(diagnoses))
        for key in chosen.effects:
            acting = chosen.crane.effect(key)
            assert acting is not None
            current = current.with_effect(key, acting.parameters)


def _predicts_better(grown: Grown) -> bool:
    """Whether what was not fitted is predicted better by a tenth, on the average of the channels, than by the fitted nominal model."""
    first, last = grown.nominal, grown.predicted
    return sum(math.log(first[c] / last[c]) for c in last) / len(last) > -math.log(1.0 - WORTH)


def _grown(
    grown: Grown,
    best: Crane,
    judge: _Judge,
    steps: list[Step],
    diagnoses: list[Diagnosis],
    told: Callable[[Step], None],
) -> Improvement:
    """Return the improvement by effects that were taken in one by one, confirmed as one step."""
    entry = {
        "recording": judge.recordings[0].name,
        "evidence": sum(grown.needed.values()),
        "verdict": "unknown",
        "error_before": steps[-1].error,
    }
    crane = added(best, replace(grown.crane, history=best.history), **entry)
    error, searched, check_error, nis = judge.errors(crane)
    text = f"no effect alone explains the recording, these together make error {steps[-1].error:.3g} -> {error:.3g} noise units"
    step = Step(
        " + ".join(grown.needed), error, check_error, nis, "unknown", searched,
        text + _disagreement(error, searched),
    )  # fmt: skip
    told(step)
    left = "adequate" if error < LEVEL else "unknown"
    return Improvement(judge.recordings[0].name, (*steps, step), crane, left, tuple(diagnoses), grown)


def _left(d: Diagnosis) -> str:
    """Return the verdict on what is left after a step: parameters that moved along are part of the step."""
    return "adequate" if d.verdict == "parameters" else d.verdict


def _worth_adding(d: Diagnosis, last: Step) -> Candidate | None:
    """Return what a diagnosis justifies to add: its choice, or the best candidate if the error falls by a tenth all the same."""
    if d.verdict == "adequate" or (d.verdict == "parameters" and last.added is not None):
        return None
    if d.verdict in ("effect", "tied", "parameters"):
        return next(c for c in d.candidates if c.effects == d.effects)
    best = next((c for c in d.candidates if c.effects), None)
    if best is None or math.isnan(best.error_after):
        return None
    judged = best.check_error_after if not math.isnan(best.check_error_after) else best.error_after
    before = last.check_error if not math.isnan(best.check_error_after) else last.error
    return best if judged < (1.0 - WORTH) * before else None


@dataclass(frozen=True)
class _Judge:
    """What the steps of an improvement are confirmed on; `own`: parameters that differ from recording to recording."""

    recordings: tuple[Recording, ...]
    check: Recording | None
    own: tuple[str, ...]

    def errors(self, crane: Crane) -> tuple[float, float, float, float]:
        """Return the error on the Exudyn engine, on that of the search, on the check recording, and the filter's mean NIS."""
        own = self.own if len(self.recordings) > 1 else ()
        found = [exudyn_error(crane, r, own) for r in self.recordings]
        exudyn, searched = (together(self.recordings, e) for e in ([f[0] for f in found], [f[1] for f in found]))
        check_error = exudyn_error(crane, self.check, own)[0] if self.check is not None else math.nan
        nis = [nis_mean(f[2], r) for f, r in zip(found, self.recordings, strict=True)]
        return exudyn, searched, check_error, float(np.mean(nis))


def _step(name: str | None, crane: Crane, d: Diagnosis, judge: _Judge) -> Step:
    error, searched, check_error, nis = judge.errors(crane)
    return Step(name, error, check_error, nis, d.verdict, searched, sentence(d) + _disagreement(error, searched))


def _disagreement(error: float, searched: float) -> str:
    """Return what is to be said where the engines do not agree on an error, else nothing."""
    if abs(error - searched) <= AGREEMENT * max(error, searched):
        return ""
    return f"; the engines disagree: error {error:.3g} on Exudyn, {searched:.3g} on the semi-recursive one"


def exudyn_error(crane: Crane, recording: Recording, own: Sequence[str] = ()) -> tuple[float, float, Crane]:
    """Return the open-loop RMS error in noise units on the Exudyn engine, and on that of the search, from the same start, and the crane with
    the recording's own parameters."""
    from crane_exudyn.engine import ExudynEngine

    searched, fit = open_loop_error(crane, recording, own=own)
    data = FitData.of(recording, crane, rate=math.inf, step=FINE)
    engine = ExudynEngine(fit.crane)
    return rms(residuals(fit.crane, data, fit.starts, fit.late, engine.simulate)), searched, fit.crane


def nis_mean(crane: Crane, recording: Recording) -> float:
    """Return the mean normalised innovation squared of the filter over a recording (expected: the number of sensors)."""
    from ukf.estimator import Estimator

    noise = recording.noise()
    std = {c: crane.sensors.get(c, noise[c]) for c in recording.sensors}
    return float(Estimator(crane, "semi-recursive", std, max_step=2.5e-3).run(recording).nis_mean)
