"""Which physical effect is missing: the search to two effects (`selection.search`), its verdict, and the errors that go
with it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane, given_crane
from crane_exudyn.crane_toml import unit_at
from crane_exudyn.effects import registry
from crane_exudyn.errors import CraneError, counted, names_of
from crane_exudyn.parameters import unit_of
from crane_exudyn.recording import Recording, given_recording
from crane_exudyn.vetting import vetted

from .criteria import CRITERIA
from .fit.solve import Fit
from .fit.variables import EffectParameter, NominalDirection
from .fitness import check_all
from .report import amount, evidence_difference, three_digits
from .selection.granted import alike, before_search, otherwise
from .selection.lean import leaner
from .selection.model import (
    Fitted,
    best_of_each,
    every_parameter,
    misled,
    open_loop_error,
    parameters_of,
    together,
)
from .selection.search import Problem, Progress, search, silent
from .selection.verdict import Kind, Verdict, verdict_of
from .selection.white import WHITE, WhitePath, taken_otherwise

ERRORS = ("error_before", "error_after", "check_error_before", "check_error_after")

#: so many candidates are drawn
_DRAWN = 8

#: a recording, or the file that it is read from
OneRecording = Recording | str | Path


@dataclass(frozen=True)
class Candidate:
    """One explanation that was weighed; errors are open-loop RMS in noise units, nan where not computed."""

    effects: tuple[str, ...]
    parameters: Mapping[str, Mapping[str, Any]]
    evidence: float
    probability: float
    crane: Crane
    error_before: float = math.nan
    error_after: float = math.nan
    check_error_before: float = math.nan
    check_error_after: float = math.nan
    level: float = math.nan
    fit: Fit | None = field(default=None, repr=False)

    @property
    def name(self) -> str:
        """Effects joined by " + ", or "parameters"."""
        return " + ".join(self.effects) or "parameters"

    @property
    def errors_after(self) -> tuple[float, float]:
        """What is left with it of the recordings and of the check recording, as tables show it."""
        return three_digits(self.error_after), three_digits(self.check_error_after)

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON of diagnose."""
        keys = ("evidence", "probability", *ERRORS)
        return {"effect": self.name, "parameters": self.parameters} | {k: getattr(self, k) for k in keys}


@dataclass(frozen=True)
class Diagnosis:
    """What a recording says that a crane file lacks.

    Attributes:
        verdict: "adequate", "parameters", "effect", "tied" or "unknown".
        effects: the chosen effects, empty for adequate, parameters and unknown.
        tied_with: what this recording cannot tell from them.
        candidates: everything that was weighed, best first.
        crane: the crane file with what was found (the one given where nothing was).
        parameters: the nominal parameters that moved; for "unknown" those that bring the model nearest.
        nearest: for "unknown", the crane with these, as it was in each recording; `where` tells where and when
            something is left beside them, worst first.
        recordings: with several recordings, the errors by recording, and what differs from one to another, as in the
            JSON.
        between: open-loop error of runs between the stretches that the choice leaves unexplained, where one run over
            all of a recording goes astray in them; nan elsewhere.
        misses_check: whether what explains the recording does not predict the check recording; then the verdict is
            "unknown".
        left_open: in words, what the recordings leave open of the chosen effects and the check recording tells, where
            what was found leaves much there, and little with that.
    """

    recording: str
    verdict: Kind
    crane: Crane
    given: Crane
    parameters: Mapping[str, Mapping[str, Any]]
    candidates: tuple[Candidate, ...]
    effects: tuple[str, ...] = ()
    tied_with: tuple[str, ...] = ()
    next_manoeuvre: str = ""
    nearest: tuple[Crane, ...] = ()
    where: tuple[Mapping[str, Any], ...] = ()
    notes: tuple[str, ...] = ()
    error_before: float = math.nan
    error_after: float = math.nan
    check_error_before: float = math.nan
    check_error_after: float = math.nan
    between: float = math.nan
    late: float = 0.0
    seconds: float = 0.0
    misses_check: bool = False
    left_open: str = ""
    recordings: tuple[Mapping[str, Any], ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON of diagnose."""
        result: dict[str, Any] = {"verdict": self.verdict, "parameters": self.parameters}
        result |= {"candidates": [c.to_dict() for c in self.candidates], "next_manoeuvre": self.next_manoeuvre}
        result |= {k: list(getattr(self, k)) for k in ("effects", "tied_with", "notes")}
        result |= {k: getattr(self, k) for k in (*ERRORS, "seconds")}
        result |= {"where": list(self.where)} if self.verdict == "unknown" else {}
        return result | ({"recordings": list(self.recordings)} if self.recordings else {})

    def __repr__(self) -> str:
        return f"<Diagnosis of {self.recording}: {sentence(self)}>"

    def plot(self) -> Any:
        """Return a figure: how the candidates weigh, and the error before and after."""
        from .selection.plots import diagnosis_figure

        alone = next((c for c in self.candidates if not c.effects), None)
        least = alone.evidence if alone is not None else math.inf
        gains = {c.name: max(c.evidence - least, 0.0) for c in self.candidates[:_DRAWN]}
        before, after = (self.error_before, self.check_error_before), [(self.error_after, self.check_error_after)]
        found, chosen = "with the result", " + ".join(self.effects) or "parameters"
        if self.verdict == "unknown" and self.parameters and alone is not None:
            found, chosen, after = "with parameters fitted", "", [(alone.error_after, alone.check_error_after)]
        elif self.crane is self.given:
            after = []
        errors = dict(zip(("learned from", "only predicted"), zip(before, *after, strict=True), strict=True))
        return diagnosis_figure(gains, chosen, errors, found)

    def save(self, path: str | Path) -> None:
        """Write the candidates, best first, to .csv, .csv.gz, .parquet or .mat; errors in units of the noise."""
        from crane_exudyn.formats import write_table

        keys = ("evidence", "probability", *ERRORS)
        numbers = {key: np.array([getattr(c, key) for c in self.candidates]) for key in keys}
        write_table(path, {"effect": np.array([c.name for c in self.candidates], dtype=str)} | numbers)

    def _repr_html_(self) -> str:
        from crane_exudyn.display import table_html

        best = max((c.evidence for c in self.candidates), default=0.0)
        rows = [
            (c.name, evidence_difference(c.evidence, best), c.probability, *c.errors_after) for c in self.candidates
        ]
        columns = ("explanation", "log evidence", "probability", "error / noise", "on check")
        return table_html(columns, rows, title=repr(self).strip("<>"), note=" ".join(self.notes))


def sentence(d: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    fall = f"error {d.error_before:.3g} -> {d.error_after:.3g} noise units"
    if math.isfinite(d.between):
        fall += f", {d.between:.3g} outside the stretches that it leaves unexplained"
    if d.verdict == "adequate":
        return f"the model explains the recording (error {d.error_before:.3g} noise units)"
    if d.verdict == "parameters":
        return f"parameters within their uncertainty explain the recording ({fall})"
    if d.misses_check:
        return d.notes[0].removesuffix("?")
    if d.verdict == "unknown":
        moved = next((c.error_after for c in d.candidates if not c.effects), math.nan)
        nearest = f", {moved:.3g} with the parameters fitted" if d.parameters else ""
        return f"something is missing that no known effect explains (error {d.error_before:.3g} noise units{nearest})"
    missing = f"{' and '.join(d.effects)} {'is' if len(d.effects) == 1 else 'are'} missing"
    if d.verdict == "tied":
        return f"{missing}, or {', or '.join(d.tied_with)}: this recording cannot separate them ({fall})"
    return f"{missing} ({fall})"


def own_values(entry: Mapping[str, Any]) -> str:
    """Return in words what one of several recordings has of its own, as an entry of `Diagnosis.recordings` tells it."""
    return ", ".join(f"{n} = {amount(p['value'], p['unit'])}" for n, p in entry.get("parameters", {}).items()) or "–"


def diagnose(
    crane: Crane | str | Path,
    recording: OneRecording | Sequence[OneRecording],
    check: OneRecording | None = None,
    *,
    per_recording: Sequence[str] = (),
    jobs: int = 2,
    progress: Progress = silent,
) -> Diagnosis:
    """Return what the recording, or several of one machine, say that the crane file lacks.

    Models with the nominal parameters moved within their uncertainty, and with up to two effects at any of their
    places, are searched and weighed by their marginal likelihood. Without known effects that explain the recordings the
    verdict is "unknown".

    Args:
        crane: the crane, or a name or file; effects that it has stay, and are fitted along.
        recording: commands and sensors, or their file; several recordings of one machine may differ in sensors and
            rates.
        check: another recording of the same machine, which is only predicted, after all choices.
        per_recording: nominal parameters that differ from recording to recording, such as payload.mass.
        jobs: processes to use.
        progress: called with a text and the share that is done.

    Raises:
        CraneError: the recording cannot support a diagnosis.
    """
    began = time.perf_counter()
    crane, recordings, check = loaded(crane, recording, check)
    path, notes = searched(crane, recordings, check, per_recording, CRITERIA.most, jobs, progress)
    progress("predicting", 0.9)
    return replace(diagnosis_of(path, check, notes), seconds=time.perf_counter() - began)


def loaded(
    crane: Crane | str | Path, recording: OneRecording | Sequence[OneRecording], check: OneRecording | None
) -> tuple[Crane, tuple[Recording, ...], Recording | None]:
    """Return a crane, the recordings and the check recording that were given as such, or by their names or files.

    Raises:
        CraneError: something else, or a file that cannot be read.
    """
    crane = given_crane(crane, "crane")
    one = partial(given_recording, layout=crane.layout, whom="recording")
    several = isinstance(recording, Iterable) and not isinstance(recording, Recording | str)
    given: Iterable[Any] = recording if several else [recording]  # type: ignore[assignment]
    return crane, tuple(map(one, given)), None if check is None else one(check)


def searched(
    crane: Crane,
    recording: Recording | Sequence[Recording],
    check: Recording | None,
    per_recording: Sequence[str],
    most: int,
    jobs: int,
    progress: Progress,
) -> tuple[WhitePath, list[str]]:
    """Return the path of the search, and notes on the recordings, after they were looked at.

    Between samples commands are taken as lines first, steps as coming with the sample that shows them, and noise as
    white. Where a model shows that one of these is wrong, the search is made with what is right: the machine without
    effects before the search, what the search has found after it. Where that leaves hardly more than noise, its models
    are fitted again, but not looked for again.
    """
    problem, notes = looked_at(crane, recording, check, per_recording, jobs, progress)
    path = WHITE.begun(problem)
    bare = path.parameters
    first = before_search(problem, bare)
    if first is not None:
        progress(first.text, 0.1)
    path = search(WHITE, path if first is None else first.problem, most, progress)
    found = path.best or path.parameters
    then = None if found is bare else otherwise(path.problem, found)  # the same model shows the same
    if then is not None:
        progress(then.text, 0.3)
        path = taken_otherwise(path, then.problem) if found.near else search(WHITE, then.problem, most, progress)
    other = [o for o in (first, then) if o is not None]
    found = path.best or path.parameters
    if other or found.near:  # notes with what is known now of its noise
        known = None if check is None else _vouched(check, crane)
        notes = check_all(path.problem.recordings, known, path.problem.crane, found.near)
    return path, [*notes, *dict.fromkeys(note for o in other for note in o.notes)]


def looked_at(
    crane: Crane,
    recording: Recording | Sequence[Recording],
    check: Recording | None,
    per_recording: Sequence[str],
    jobs: int,
    progress: Progress,
) -> tuple[Problem, list[str]]:
    """Return the problem that one recording or several give, with the crane as it is fitted, and notes on them."""
    jobs, per_recording = counted(jobs, "jobs"), names_of(per_recording, "per_recording")
    recordings = (recording,) if isinstance(recording, Recording) else tuple(recording)
    notes = check_all(recordings, check, crane)
    progress("fitting the nominal parameters", 0.05)
    return Problem.of(crane, [_vouched(r, crane) for r in recordings], per_recording, jobs), notes


def _vouched(recording: Recording, crane: Crane) -> Recording:
    """Return a recording with notes on its contents, not to be judged again: they need not fit a crane that was fitted
    to them.
    """
    return replace(vetted(recording, crane), vouched=True)


def diagnosis_of(path: WhitePath, check: Recording | None, notes: Sequence[str] = ()) -> Diagnosis:
    """Return the diagnosis that a path gives, with the errors that it leaves; the check recording is predicted, and
    chooses nothing.
    """
    verdict, problem = verdict_of(path), path.problem
    check = alike(problem, path.best or path.parameters, check)
    named = verdict.kind in ("effect", "tied")
    lean = leaner(problem.crane, problem.data, verdict.chosen) if named else verdict.chosen
    lean = replace(lean, fit=every_parameter(lean.fit)) if verdict.kind not in ("adequate", "unknown") else lean
    result = Diagnosis(
        problem.data.name, verdict.kind, problem.crane if verdict.kind in ("adequate", "unknown") else lean.fit.crane,
        problem.crane,
        {} if verdict.kind in ("adequate", "unknown") else moved_parameters(problem.crane, lean.fit),
        _candidates(path, verdict, lean),
        verdict.chosen.keys if named else (), tuple(" + ".join(w.keys) or "parameters" for w in verdict.ties),
        next_manoeuvre=problem.telling(lean.fit.crane, verdict.ties[0].fit.crane) if verdict.ties else "",
        notes=(*verdict.notes, *notes), late=lean.fit.late,
    )  # fmt: skip
    result = _between_stretches(_with_errors(result, path, check), problem, lean)
    result = held_to_runs(_with_what_is_open(result, problem, lean, check))
    if result.verdict == "unknown" and not result.misses_check:
        result = _with_what_is_left(result, path, check)
    return result


def held_to_runs(d: Diagnosis) -> Diagnosis:
    """Return the diagnosis; "unknown", if what explains short windows leaves much of the recording in one run, or most
    of what is wrong on the check recording.

    Then the candidates stay, but none of them is what the machine lacks, or the check recording is of another machine.
    """
    after, before = d.check_error_after, d.check_error_before
    drifts = np.fmin(d.error_after, d.between) > CRITERIA.misled
    if d.verdict == "unknown" or not (drifts or (misled(before, after) and not d.left_open)):
        return d
    found = _choice(d)
    note = (
        f"{found} explains short parts of the recording, but leaves {d.error_after:.3g} times the noise in one run"
        if drifts
        else f"{found} explains the recording, but does not predict the check recording (error {before:.3g} -> "
        f"{after:.3g} noise units). Is it of the same machine, with the same load and the same units?"
    )
    return replace(
        d, verdict="unknown", crane=d.given, parameters={}, effects=(), tied_with=(), next_manoeuvre="",
        misses_check=not drifts,
        notes=(note, *d.notes),
        error_after=d.error_before, check_error_after=before,
        recordings=tuple(
            {"recording": r["recording"], "error_before": r["error_before"], "error_after": r["error_before"]}
            for r in d.recordings
        ),
    )  # fmt: skip


def _with_what_is_open(d: Diagnosis, problem: Problem, w: Fitted, check: Recording | None) -> Diagnosis:
    """Return the diagnosis, with a note where the recordings do not determine some parameters of its effects.

    A valve that was opened one way only tells nothing of its other side, on which the check recording may depend; one
    that was never opened tells that its dead band is wide enough. So where much is left of the check recording, but
    other values of the effects leave little there and are as good for the recordings, that is no contradiction.
    """
    free = w.undetermined if d.effects else []
    found = None
    if d.effects and check is not None and d.check_error_after > CRITERIA.misled:
        found = _values_for_both(d, problem, w, check)
    if found is not None:
        error, crane = found
        free = [v for v in w.parameters if v in free or _differs(v, w, crane)]
    if not free:
        return d
    note = f"the recording does not determine {' and '.join(v.name for v in free)}"
    if found is not None:
        values = ((v, parameters_of(crane, v.key)[v.parameter.name]) for v in free)
        listed = ", ".join(f"{v.name} = {amount(value, v.parameter.unit)}" for v, value in values)
        note += (
            f"; fitted to the check recording ({listed}), that leaves {error:.3g} instead of "
            f"{d.check_error_after:.3g} times the noise there: learn from both"
        )
        d = replace(d, left_open=note)
    return replace(d, notes=(note, *d.notes))


def _values_for_both(d: Diagnosis, problem: Problem, w: Fitted, check: Recording) -> tuple[float, Crane] | None:
    """Return the error on the check recording with the effects fitted to it, and the crane with these; None if much is
    left there, or more than before of the recordings.
    """
    error, fit = open_loop_error(w.fit.crane, check, own=problem.data.own, free=w.parameters)
    if error > CRITERIA.left_level:
        return None
    effects = {key: parameters_of(fit.crane, key) for key in w.keys}
    cranes = [w.fit.of(i).crane.changed({}, effects) for i in range(len(problem.recordings))]
    pairs = enumerate(zip(cranes, problem.recordings, strict=True))
    learned = together(*problem.errors_over([(crane, i, (r.start, r.end)) for i, (crane, r) in pairs]))
    return (error, cranes[0]) if learned < CRITERIA.worse * max(d.error_after, 1.0) else None


def _differs(v: EffectParameter, w: Fitted, crane: Crane) -> bool:
    """Whether a crane has another value of an effect's parameter than a model, beyond what that is known to."""
    apart = abs(parameters_of(crane, v.key)[v.parameter.name] - v.start)
    return apart > CRITERIA.told_apart * w.deviations(v.key)[v.parameter.name]


def _choice(d: Diagnosis) -> str:
    """Return in words what was chosen."""
    return " and ".join(d.effects) or "the model" + " with fitted parameters" * (d.verdict == "parameters")


def _between_stretches(d: Diagnosis, problem: Problem, w: Fitted) -> Diagnosis:
    """Return the diagnosis; where one run goes astray in stretches that the choice leaves unexplained, with the error
    of runs between them and a note, if these hold.
    """
    if d.verdict == "unknown" or not d.error_after > CRITERIA.misled or not w.bad.any():
        return d
    left = [_unexplained(w, i) for i in range(len(problem.recordings))]
    pairs = enumerate(zip(problem.recordings, left, strict=True))
    parts = [(w.fit.of(i).crane, i, span) for i, (r, own) in pairs for span in _spans_beside(r, own)]
    kept = sum(b - a for _, _, (a, b) in parts) / sum(r.end - r.start for r in problem.recordings)
    if kept < CRITERIA.repaired:
        return d
    between = together(*problem.errors_over(parts))
    if between > CRITERIA.misled:
        return d
    of = [f" of {r.name}" * (len(problem.recordings) > 1) for r in problem.recordings]
    where = [f"{a:.1f}-{b:.1f} s{name}" for name, own in zip(of, left, strict=True) for a, b, _ in own]
    note = (
        f"{_choice(d)} explains the recording except {', '.join(where)}, where a single run diverges: runs between "
        f"leave {between:.3g} times the noise"
    )
    return replace(d, between=between, notes=(note, *d.notes))


def _spans_beside(recording: Recording, left: Sequence[tuple[float, float, float]]) -> list[tuple[float, float]]:
    """Return what a recording has beside stretches (from, to, …) in s, as far as it is long enough for a run."""
    ends = [recording.start, *(t for span in left for t in span[:2]), recording.end]
    return [(a, b) for a, b in zip(ends[::2], ends[1::2], strict=True) if b - a > CRITERIA.window]


def _with_what_is_left(d: Diagnosis, path: WhitePath, check: Recording | None) -> Diagnosis:
    """Return a diagnosis of what no known effect explains with what is left, told beside the fewest parameters that
    bring the model nearest: a load that is not the file's would hide all else.
    """
    problem, n = path.problem, len(path.problem.recordings)
    moved = path.fewest if path.parameters.good else leaner(problem.crane, problem.data, path.parameters)
    moved = replace(moved, fit=every_parameter(moved.fit))
    (errors,) = problem.errors([moved.fit], check)
    after, nearest = together(problem.recordings, errors[:n]), [problem.crane] * n
    if after < d.error_before:
        nearest = [moved.fit.of(i).crane for i in range(n)]
        nearer: dict[str, Any] = {"crane": moved.fit.crane, "fit": moved.fit, "error_after": after}
        nearer["check_error_after"] = errors[-1] if check is not None else math.nan
        candidates = tuple(c if c.effects else replace(c, **nearer) for c in d.candidates)
        d = replace(d, parameters=moved_parameters(problem.crane, moved.fit), candidates=candidates)
    where = _where(problem, nearest) or left_over(path.best or path.parameters)
    return replace(d, nearest=tuple(nearest), where=where)


def _where(problem: Problem, cranes: Sequence[Crane]) -> tuple[Mapping[str, Any], ...]:
    """Return which balance of the crane of each recording is violated when, as `compare` finds it, worst first; with
    several recordings also in which. Nothing of one that a crane cannot follow at all.
    """
    from .comparison import compare

    found = []
    for r, crane in zip(problem.recordings, cranes, strict=True):
        with suppress(CraneError):
            own = {"recording": r.name} if len(problem.recordings) > 1 else {}
            found += [finding.to_dict() | own for finding in compare(crane, r).where]
    return tuple(sorted(found, key=lambda f: -f["score"]))


def _candidates(path: WhitePath, verdict: Verdict, lean: Fitted) -> tuple[Candidate, ...]:
    """Return all that was weighed, best first, by the evidence of fits to the same point; what was chosen with its
    fewest moved parameters.
    """
    named = [w for w in (verdict.chosen, *verdict.ties) if w.keys]
    everything = best_of_each([path.parameters, *path.weighed, *named])
    weights = np.exp(np.clip([w.evidence - everything[0].evidence for w in everything], -700, 0))
    shown = {verdict.chosen.keys: lean, (): path.fewest}
    pairs = zip(everything, weights / weights.sum(), strict=True)
    return tuple(_candidate(shown.get(w.keys, w), w.evidence, float(p)) for w, p in pairs)


def _candidate(w: Fitted, evidence: float, probability: float) -> Candidate:
    parameters = {}
    for key in w.keys:
        values, spread = w.values(key), w.deviations(key)
        prefix = f"{key}:" if len(w.keys) > 1 else ""
        effect, place = registry.split_key(key)
        for p in effect.parameters:
            unit = unit_at(p.unit, place, w.fit.crane.layout)
            parameters[prefix + p.name] = {"value": values[p.name], "std": spread.get(p.name, math.inf), "unit": unit}
    return Candidate(w.keys, parameters, evidence, probability, w.fit.crane, level=w.level, fit=w.fit)


def moved_parameters(crane: Crane, known: Fit) -> dict[str, dict[str, Any]]:
    """Return the nominal parameters of a crane that moved by a telling share of their uncertainty: value, std, nominal,
    unit.

    Args:
        crane: as given.
        known: what was chosen, with every uncertain parameter free (`every_parameter`).
    """
    found, far = dict[str, dict[str, Any]](), dict[str, float]()
    free = {v.name: v for v in known.variables if isinstance(v, NominalDirection) and v.recording is None}
    for name, believed in crane.uncertainty.items():
        if name not in free:
            continue
        prior = believed.std if math.isfinite(believed.std) else 0.25 * (believed.upper - believed.lower)
        value, nominal = known.crane.values[name], crane.values[name]
        if abs(value - nominal) > CRITERIA.moved * prior:
            std = min(known.std(name) * abs(free[name].weights[name]), prior)
            found[name] = {"value": value, "std": std, "nominal": nominal, "unit": unit_of(name)}
            far[name] = abs(value - nominal) / prior
    return dict(sorted(found.items(), key=lambda item: -far[item[0]]))


def left_over(w: Fitted) -> tuple[Mapping[str, Any], ...]:
    """Return the stretches of the recordings that a fit leaves unexplained, worst first."""
    found = [
        {
            "recording": part.name, "channel": "all", "from": start, "to": end, "phase": "", "score": error,
            "text": f"from {start:.2f} to {end:.2f} s errors reach {error:.1f} times the noise",
        }
        for i, part in enumerate(w.fit.data.parts)
        for start, end, error in _unexplained(w, i)
    ]  # fmt: skip
    return tuple(sorted(found, key=lambda e: -e["score"]))


def _unexplained(w: Fitted, recording: int) -> list[tuple[float, float, float]]:
    """Return the stretches (from, to, largest error) of one recording that a fit leaves unexplained, in their order."""
    found: list[tuple[float, float, float]] = []
    for k in np.flatnonzero(w.bad):
        window, error = w.fit.windows[k], float(w.fit.linear.window_error[k])
        if window.recording != recording:
            continue
        start, end = float(window.data.time[0]), float(window.data.time[-1])
        if found and found[-1][1] >= start - 1e-9:
            start, _, before = found.pop()
            error = max(error, before)
        found.append((start, end, error))
    return found


def _with_errors(d: Diagnosis, path: WhitePath, check: Recording | None) -> Diagnosis:
    """Add open-loop errors on all recordings: of the crane as given, of the candidates that came near, of the
    choice.
    """
    problem = path.problem
    recordings = problem.recordings
    best = max((c.evidence for c in d.candidates), default=0.0)
    near = [c for c in d.candidates if c.evidence > best - CRITERIA.shown or c.effects == d.effects]
    fits = [path.given.fit, *(c.fit for c in near if c.fit is not None)]
    each = problem.errors(fits, check)
    learned = [together(recordings, e[: len(recordings)]) for e in each]
    checked = [e[-1] if check is not None else math.nan for e in each]
    before: dict[str, Any] = {"error_before": learned[0], "check_error_before": checked[0]}
    after: dict[tuple[str, ...], dict[str, Any]] = {
        c.effects: {"error_after": e, "check_error_after": k}
        for c, e, k in zip(near, learned[1:], checked[1:], strict=True)
    }
    unchanged = d.verdict in ("adequate", "unknown")
    k = 0 if unchanged else 1 + next(i for i, c in enumerate(near) if c.effects == d.effects)
    by_recording = [
        {"recording": r.name, "error_before": each[0][i], "error_after": each[k][i]} | _own(fits[k], problem, i)
        for i, r in enumerate(recordings)
    ]
    return replace(
        d, recordings=tuple(by_recording) if len(recordings) > 1 else (), error_after=learned[k],
        check_error_after=checked[k], **before,
        candidates=tuple(replace(c, **before, **after.get(c.effects, {})) for c in d.candidates),
    )  # fmt: skip


def _own(fit: Fit, problem: Problem, recording: int) -> dict[str, Any]:
    """Return what a recording's own parameters were found to be, as an entry of its own."""
    crane = fit.of(recording).crane
    found = {n: {"value": crane[n], "nominal": problem.crane[n], "unit": unit_of(n)} for n in problem.data.own}
    return {"parameters": found} if found else {}
