"""The search to many effects, confirmed on the Exudyn engine; where these leave errors that drift, one after the other
by what they do to whole runs (`selection.drifting`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.description import GaussMarkov
from crane_exudyn.errors import counted
from crane_exudyn.parameters import unit_of
from crane_exudyn.recording import Recording
from ukf.model_error import lasting

from .comparison import filtered, longest_stretch
from .criteria import CRITERIA
from .diagnosis import Candidate, Diagnosis, OneRecording, diagnosis_of, loaded, searched, sentence
from .fit.data import FINE, FitData
from .fit.staged import residuals, rms
from .history import added, learned, with_errors, without_learned
from .learning import Learned
from .learning import learn as learn_laws
from .learning import sentence as learned_sentence
from .selection.drifting import DRIFTING
from .selection.granted import alike
from .selection.levels import Errors, noise_level
from .selection.model import open_loop_error, parameters_of, together
from .selection.proven import Proven
from .selection.search import Progress, search, silent
from .selection.verdict import verdict_of
from .selection.white import WhitePath
from .workers import in_parallel


@dataclass(frozen=True)
class Step:
    """One step: what was added (None: the model as given, "parameters", or effects) and what that did to the errors.

    Errors are open-loop RMS in noise units on the Exudyn engine; search_error is the one that the search's engine
    reported.
    """

    added: str | None
    error: float
    check_error: float
    nis_mean: float
    verdict: str
    search_error: float = math.nan
    text: str = ""

    @property
    def errors(self) -> tuple[float, float]:
        """Errors on what was learned from, and on the check recording."""
        return self.error, self.check_error

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON of improve."""
        return asdict(self)


@dataclass(frozen=True)
class Improvement:
    """The steps from the crane as given to the one that explains the recording as far as effects are justified.

    `proven`: what was found where no single effect explained the recording, with the evidence for each effect; None
    otherwise. `learned`: what was learned where named effects did not do; None where that was not asked for, or needed.
    """

    recording: str
    steps: tuple[Step, ...]
    crane: Crane
    verdict: str
    diagnoses: tuple[Diagnosis, ...]
    proven: Proven | None = None
    learned: Learned | None = None

    @property
    def about(self) -> Sequence[str]:
        """What was noticed about the recordings."""
        return self.diagnoses[0].notes if self.diagnoses else ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know about the recordings; where several effects were taken in, what the data demand, cannot separate
        and leave; what was said of learning; and what the model still errs by.
        """
        about = self.about
        several = () if self.proven is None else explained(self.proven)
        laws = () if self.learned is None else (n for n in self.learned.notes if n not in about)
        return (*about, *several, *laws, *_model_error_text(self.crane))

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
        from .selection.plots import improvement_figure

        errors = {"learned from": [s.error for s in self.steps], "only predicted": [s.check_error for s in self.steps]}
        return improvement_figure([s.added or "" for s in self.steps[1:]], errors)

    def save(self, path: str | Path) -> None:
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
        columns = ("added", "error / noise", "on check", "NIS", "result")
        return table_html(columns, rows, title=repr(self).strip("<>"))


def improve(
    crane: Crane | str | Path,
    recording: OneRecording | Sequence[OneRecording],
    check: OneRecording | None = None,
    *,
    per_recording: Sequence[str] = (),
    jobs: int = 2,
    most: int = 4,
    learn: bool = False,
    told: Callable[[Step], None] = lambda step: None,
    progress: Progress = silent,
) -> Improvement:
    """Return the crane with what the recordings justify; each step's errors are confirmed on the Exudyn engine.

    Laws that the crane learned before go again where named effects do as well.

    Args:
        crane: the crane as given, or its name or file.
        recording, check: learned from (several of one machine together), and only predicted; or their files.
        per_recording: nominal parameters that differ from recording to recording.
        jobs: processes to use.
        most: at most so many effects.
        learn: whether laws are learned where named effects do not explain the recordings: beside these, or in their
            place where laws alone leave less.
        told: called with each step as soon as it is known.
        progress: called with a text and the share that is done.

    Raises:
        CraneError: the recording cannot support a diagnosis.
    """
    crane, recordings, checked = loaded(crane, recording, check)
    most = counted(most, "most")

    def path_of(given: Crane) -> tuple[WhitePath, list[str]]:
        return searched(given, recordings, checked, per_recording, most, jobs, progress)

    path, notes = path_of(crane)
    replaced = learned(crane)
    if replaced:
        named, _ = path_of(without_learned(crane))
        path, replaced = (named, replaced) if _as_well(named, path) else (path, ())
    d = replace(diagnosis_of(path, checked, notes), given=crane)
    judge = Judge(
        path.problem.recordings,
        alike(path.problem, path.best or path.parameters, checked),
        path.problem.data.own,
        path.problem.crane.sensors,
        jobs,
        noise_level(path.problem.data),
    )
    steps = [judge.step(None, crane, d.verdict, sentence(d))]
    told(steps[0])
    result = _named(
        Improvement(d.recording, tuple(steps), crane, d.verdict, (d,)), path, replaced, judge, most, progress
    )
    for step in result.steps[1:]:
        told(step)
    if learn and result.verdict == "unknown" and not d.misses_check:
        result = _after_learning(result, judge, per_recording, jobs, told, progress)
    return _with_model_error(result, judge, progress)


def _after_learning(
    result: Improvement,
    judge: Judge,
    per_recording: Sequence[str],
    jobs: int,
    told: Callable[[Step], None],
    progress: Progress,
) -> Improvement:
    """Return the improvement with the laws that are learned, beside its named effects or in their place."""
    crane = result.diagnoses[0].given

    def learned_from(given: Crane) -> Learned:
        return learn_laws(
            given, judge.recordings, judge.check, per_recording=per_recording, jobs=jobs, progress=progress
        )

    found = learned_from(crane)
    if len(result.steps) > 1 and not (found.laws and found.error_after < result.steps[-1].search_error):
        found = learned_from(result.crane)
    result = _with_laws(result, found, judge)
    if found.laws:
        told(result.steps[-1])
    return result


def _with_model_error(result: Improvement, judge: Judge, progress: Progress) -> Improvement:
    """Return the improvement with what its crane still errs by, as the innovations of a filter with all sensors tell;
    nothing where nothing but noise is left.
    """
    known: dict[str, GaussMarkov] = {}
    if result.verdict == "unknown":
        crane = result.crane
        whole = [FitData.whole(r, crane) for r in judge.recordings]
        seen = [longest_stretch(data, crane.layout) for data in whole]
        known = lasting(crane, seen, progress=partial(progress, "finding how far the model is off"))
    return replace(result, crane=replace(result.crane, model_error=known))


def _as_well(named: WhitePath, lawful: WhitePath) -> bool:
    """Whether named effects explain recordings as well as the laws that a crane learned: a law must bring the proof
    against them, whatever is found beside it.
    """
    if named.best is None or verdict_of(named).kind not in ("effect", "tied"):
        return False
    with_law = max([lawful.bare, *(w.evidence for w in lawful.weighed)])
    return named.best.evidence > with_law - CRITERIA.proof


def _named(
    result: Improvement, path: WhitePath, replaced: Sequence[str], judge: Judge, most: int, progress: Progress
) -> Improvement:
    """Return the improvement with the named effects that a path justifies, instead of the laws that they replace."""
    (d,), crane = result.diagnoses, result.crane
    proven, chosen = None, _chosen(d)
    if d.verdict == "unknown" and not d.misses_check:
        proven = search(DRIFTING, path.problem, most, progress).proven
        proven = proven if proven is not None and proven.predicts_better else None
    if proven is not None:
        name, improved, evidence = " + ".join(proven.needed), proven.crane, sum(proven.needed.values())
        text = "no single effect and no pair explains the recording; these together do"
        text += "" if proven.explains else ", as far as possible"
    elif chosen is not None:
        name, improved, evidence, text = chosen.name, chosen.crane, _gain(chosen, d), ""
    else:
        return result
    entry: dict[str, Any] = {"recording": d.recording, "verdict": d.verdict}
    entry |= {"evidence_gain": evidence} if math.isfinite(evidence) else {}
    if replaced:
        entry = entry | {"replaced": list(replaced)}
    best = added(crane, replace(improved, history=crane.history), **entry)
    step = judge.step(name, best, d.verdict)
    good = step.search_error < judge.level or (proven is None and chosen is not None and chosen.level < judge.level)
    text = text or ("only noise is left" if good else "more than noise is left")
    if replaced:
        text += f"; it replaces {' and '.join(replaced)}"
    step, left = replace(step, text=text + step.text), "adequate" if good else "unknown"
    best = with_errors(best, result.steps[0].errors, step.errors)
    return replace(result, steps=(*result.steps, step), crane=best, verdict=left, proven=proven)


def _with_laws(result: Improvement, found: Learned, judge: Judge) -> Improvement:
    """Return the improvement with the laws that were learned as its last step."""
    if not found.laws:
        return replace(result, learned=found)
    name, text = " + ".join((*found.effects, *(law.effect for law in found.laws))), learned_sentence(found)
    if found.given is not result.crane:
        text += f"; {result.steps[-1].added}, which leaves a larger error, is removed again"
    step = judge.step(name, found.crane, "unknown", f"learned, because no named effect explains it: {text}")
    left = "adequate" if step.search_error < judge.level else "unknown"
    return replace(result, steps=(*result.steps, step), crane=found.crane, verdict=left, learned=found)


def _gain(chosen: Candidate, d: Diagnosis) -> float:
    """Return by how much the log evidence of effects is above that of parameters moved alone; NaN where it was not
    weighed, or there is no effect.
    """
    plain = max((c.evidence for c in d.candidates if not c.effects), default=math.nan)
    return chosen.evidence - plain if chosen.effects else math.nan


def _chosen(d: Diagnosis) -> Candidate | None:
    """Return what a diagnosis justifies to add: its choice, or the best candidate if the error falls by a tenth all the
    same.
    """
    if d.verdict == "adequate" or d.misses_check:
        return None
    if d.verdict != "unknown":
        return next(c for c in d.candidates if c.effects == d.effects)
    best = next((c for c in d.candidates if c.effects), None)
    return best if best is not None and best.error_after < (1.0 - CRITERIA.worth) * d.error_before else None


@dataclass(frozen=True)
class Judge:
    """What the steps of an improvement are confirmed on; `own`: parameters that differ from recording to recording;
    `sensors`: their noise (SI), the unit of all errors; `jobs`: processes to use; `level`: below which hardly more than
    noise is left.
    """

    recordings: tuple[Recording, ...]
    check: Recording | None
    own: tuple[str, ...]
    sensors: Mapping[str, float]
    jobs: int
    level: float

    def step(self, name: str | None, crane: Crane, verdict: str, text: str = "") -> Step:
        """Return a step to a crane: errors on the Exudyn engine and on that of the search, on the check recording, and
        the mean NIS of the filter with which `compare` looks at it too.

        To `text` is added where the engines disagree.
        """
        crane = replace(crane, sensors=self.sensors)
        tasks: list[tuple[Any, ...]] = [(confirmed, crane, r, self.own, True) for r in self.recordings]
        if self.check is not None:
            tasks.append((confirmed, crane, self.check, self.own, False))
        found: list[Confirmed] = in_parallel(self.jobs, tasks)
        mine = found[: len(self.recordings)]
        exudyn, searched = (
            together(self.recordings, e) for e in ([f.exudyn for f in mine], [f.searched for f in mine])
        )
        check_error = math.nan if self.check is None else found[-1].exudyn
        nis = float(np.mean([f.nis_mean for f in mine]))
        return Step(name, exudyn, check_error, nis, verdict, searched, text + _disagreement(exudyn, searched))


class Confirmed(NamedTuple):
    """Open-loop RMS errors of a crane on a recording, in noise units, from the same start: on the Exudyn engine and on
    that of the search; and the mean normalised innovation squared of a filter that trusts it (expected: the number of
    sensors), NaN where none was run.
    """

    exudyn: float
    searched: float
    nis_mean: float


def _disagreement(error: float, searched: float) -> str:
    """Return what is to be said where the engines do not agree on an error, else nothing."""
    if abs(error - searched) <= CRITERIA.agreement * max(error, searched):
        return ""
    return f"; the engines disagree: error {error:.3g} on Exudyn, {searched:.3g} on the semi-recursive one"


def confirmed(crane: Crane, recording: Recording, own: Sequence[str], filters: bool) -> Confirmed:
    """Return what a crane leaves of a recording, its start fitted.

    Args:
        crane, recording: the model and what it is held against.
        own: parameters that are the recording's own.
        filters: whether a filter is run over it as well.
    """
    from crane_exudyn.engine import ExudynEngine

    searched, fit = open_loop_error(crane, recording, own=own)
    data = FitData.whole(recording, crane)
    exudyn = rms(residuals(fit.crane, data, fit.starts, fit.late, ExudynEngine(fit.crane).simulate))
    if not filters:
        return Confirmed(exudyn, searched, math.nan)
    seen = FitData.of(recording, fit.crane).with_step(FINE).shifted(fit.late)
    return Confirmed(exudyn, searched, filtered(fit.crane, seen, "semi-recursive").nis_mean)


def explained(found: Proven) -> list[str]:
    """Return in plain words what the data demand, what they cannot separate, and what is left."""
    texts = [_demanded(found, key) for key in sorted(found.needed, key=lambda k: -found.needed[k])]
    for step in found.taken:
        serious = [k for k, g in step.rivals.items() if g > CRITERIA.serious * step.evidence]
        near = sorted(serious, key=lambda k: -step.rivals[k])[:3]
        if near:
            texts.append(
                f"Not separated: when {step.key} was added, {', '.join(near)} would have gained half its evidence "
                "or more"
            )
    for (first, other), r in sorted(found.alike.items(), key=lambda p: -abs(p[1]))[:5]:
        texts.append(f"Not separated: {first} and {other} (correlation {r:+.2f}); only their combination is known")
    texts += _identified(found)
    texts.append(
        f"Remaining error, % of each channel's range, open loop over the whole recording: {percent(found, found.after)}"
    )
    texts.append(f"The same for data not fitted when the effects were chosen: {percent(found, found.predicted)}")
    return texts


def _identified(found: Proven) -> list[str]:
    """Return the sentences on the nominal parameters: the furthest moved with their intervals, and those not to be
    believed.
    """
    furthest = sorted(
        (n for n, u in found.moved.items() if abs(u) > CRITERIA.reported), key=lambda n: -abs(found.moved[n])
    )
    values = [
        f"{n} = {found.crane[n]:.4g} ± {found.deviations.get(n, math.inf):.2g} {unit_of(n)}".strip() for n in furthest
    ]
    texts = [f"Parameters that changed with them: {', '.join(values)}"] if values else []
    known = found.crane.uncertainty
    doubted = [n for n in furthest if abs(found.moved[n]) > CRITERIA.doubted and math.isfinite(known[n].std)]
    if doubted:
        far = ", ".join(f"{n} by {abs(found.moved[n]):.1f}" for n in doubted)
        texts.append(
            f"Hardly plausible, in standard uncertainties from the crane file: {far}. They stand in for "
            "something that is not in the model, or that this recording does not separate from them"
        )
    return texts


def _demanded(found: Proven, key: str) -> str:
    """Return the sentence on one effect: evidence, the errors that it mends, its values."""
    without = found.without[key]
    worse = sorted(found.after, key=lambda c: (found.after[c] - without[c]) / found.ranges[c])[:3]
    errors = ", ".join(
        f"{c} {100 * without[c] / found.ranges[c]:.3g} -> {100 * found.after[c] / found.ranges[c]:.3g} %"
        for c in worse
        if without[c] > CRITERIA.worse * found.after[c]
    )
    values = ", ".join(
        f"{n} = {x:.3g} ± {found.deviations.get(f'{key}:{n}', math.inf):.2g}"
        for n, x in parameters_of(found.crane, key).items()
    )
    return f"Needed: {key} ({values}); log evidence lost without it {found.needed[key]:.0f}" + (
        f"; with it {errors} of the range" if errors else ""
    )


def _model_error_text(crane: Crane) -> list[str]:
    """Return the sentence on what a crane still errs by, where its file says so."""
    moments = {n: crane.model_error[n] for n in crane.layout.torques if n in crane.model_error}
    if not moments:
        return []
    sizes = ", ".join(f"{n} ± {e.std:.3g} {crane.layout.unit_of(n)}" for n, e in moments.items())
    return [
        f"The crane file records the remaining model error ([model_error]: {sizes} and more), which `patu estimate` "
        "takes into account"
    ]


def percent(found: Proven, errors: Errors) -> str:
    """Return errors by channel as text, in per cent of the channel's range."""
    return ", ".join(f"{c} {100 * e / found.ranges[c]:.3g}" for c, e in errors.items())
