"""Which physical effect is missing: parameters first, then every effect at every place, alone and in pairs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.crane_toml import unit_at
from crane_exudyn.effects import registry
from crane_exudyn.parameters import unit_of
from crane_exudyn.recording import Recording

from .fit.data import Data, data_of
from .fit.evidence import log_evidence
from .fit.solve import Fit
from .fit.staged import LOOSE, STIFF, TIGHT, WHOLE, all_parameters, informed_directions, timings
from .fit.variables import EffectVariable, Variable, effect_variables
from .search.candidates import around, scaled, starts
from .search.lean import leaner
from .search.manoeuvre import best_manoeuvre
from .search.screen import Score, screen
from .search.weigh import Hypothesis, Weighed, at_bound, deviations, fitted_values, open_loop_error, weigh
from .workers import results_of

Verdict = str
#: a model is good enough when its level is below LEVEL and at most this share of short windows stays unexplained
LEVEL, SHARE = 1.04, 0.03
#: with something left over, an effect is still named if it repairs this share of the windows and leaves no more than this level
REPAIRED, LEFT_LEVEL = 0.8, 1.3
#: error on a check recording beyond which an effect that leaves something is not named
MISLED = 2.0
#: share of the check recording's excess error that an effect may leave there if it leaves more than that where it was learned
LEFT_OF_CHECK = 0.05
#: log evidence that a further effect must bring, and within which two explanations are tied
PROOF, TIE = 12.0, 6.0
#: how many starts the screen hands on, and how many of the fits are carried to the end
FITTED, FINISHED = 7, 3
#: probability of parameters' moves below which they are no longer taken as within their uncertainty
IMPLAUSIBLE = 1e-9
#: how many of the finished fits are done anew if their parameters are not to be believed
ANEW = 2
#: log of the prior that parameters may lose beside the leading effect before its other places are fitted as well
HELPED = 5.0
#: a long run is so many times worse than short windows only if its start went astray
ASTRAY = 1.3
#: an effect's parameter is told from its neutral value by so many standard deviations
TOLD_APART = 3.0
#: share of the first effect's excess error that a second one may leave
LEFT_BY_SECOND = 0.5
#: a third fit is carried to the end if it lacks no more than this share of what the best gained in loosely joined windows
NEAR = 0.3
#: how many more starts the crane as given may add to them, where the fitted parameters are not to be believed
BESIDE = 3
#: share of the best start's promise below which a start is not fitted
HOPELESS = 0.02


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
    at_bound: tuple[str, ...] = ()
    level: float = math.nan
    fit: Fit | None = field(default=None, repr=False)

    @property
    def name(self) -> str:
        """Effects joined by " + ", or "parameters"."""
        return " + ".join(self.effects) or "parameters"

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON of diagnose."""
        keys = ("evidence", "probability", "error_before", "error_after", "check_error_before", "check_error_after")
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
        where: for "unknown", where and when something is left, worst first.
        recordings: with several recordings, the errors by recording, and what differs from one to another, as in the JSON.
        misses_check: whether what explains the recording does not predict the check recording; then the verdict is "unknown".
    """

    recording: str
    verdict: Verdict
    crane: Crane
    given: Crane
    parameters: Mapping[str, Mapping[str, Any]]
    candidates: tuple[Candidate, ...]
    effects: tuple[str, ...] = ()
    tied_with: tuple[str, ...] = ()
    next_manoeuvre: str = ""
    where: tuple[Mapping[str, Any], ...] = ()
    notes: tuple[str, ...] = ()
    error_before: float = math.nan
    error_after: float = math.nan
    check_error_before: float = math.nan
    check_error_after: float = math.nan
    late: float = 0.0
    seconds: float = 0.0
    misses_check: bool = False
    recordings: tuple[Mapping[str, Any], ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON of diagnose."""
        result = {
            "verdict": self.verdict,
            "parameters": self.parameters,
            "candidates": [c.to_dict() for c in self.candidates],
            "effects": list(self.effects),
            "tied_with": list(self.tied_with),
            "next_manoeuvre": self.next_manoeuvre,
            "error_before": self.error_before,
            "error_after": self.error_after,
            "check_error_before": self.check_error_before,
            "check_error_after": self.check_error_after,
            "notes": list(self.notes),
            "seconds": self.seconds,
        }
        result |= {"where": list(self.where)} if self.verdict == "unknown" else {}
        return result | ({"recordings": list(self.recordings)} if self.recordings else {})

    def __repr__(self) -> str:
        return f"<Diagnosis of {self.recording}: {sentence(self)}>"

    def plot(self) -> Any:
        """Return a figure: how the candidates weigh, and the error before and after."""
        from .search.plots import diagnosis_figure

        return diagnosis_figure(self)

    def to_csv(self, path: str | Path) -> None:
        """Write the candidates, best first, to .csv, .csv.gz, .parquet or .mat; errors in units of the noise."""
        from crane_exudyn.formats import write_table

        keys = ("evidence", "probability", "error_before", "error_after", "check_error_before", "check_error_after")
        numbers = {key: np.array([getattr(c, key) for c in self.candidates]) for key in keys}
        write_table(path, {"effect": np.array([c.name for c in self.candidates], dtype=str)} | numbers)

    def _repr_html_(self) -> str:
        from crane_exudyn.display import table_html

        best = max((c.evidence for c in self.candidates), default=0.0)
        rows = [(c.name, c.evidence - best, c.probability, c.error_after, c.check_error_after) for c in self.candidates]
        columns = ("explanation", "log evidence", "probability", "error / noise", "on check")
        return table_html(columns, rows, title=repr(self).strip("<>"), note=" ".join(self.notes))


def sentence(d: Diagnosis) -> str:
    """Return the verdict in one sentence."""
    fall = f"error {d.error_before:.3g} -> {d.error_after:.3g} noise units"
    if d.verdict == "adequate":
        return f"the model explains the recording (error {d.error_before:.3g} noise units)"
    if d.verdict == "parameters":
        return f"parameters within their uncertainty explain the recording ({fall})"
    if d.misses_check:
        return d.notes[0].removesuffix("?")
    if d.verdict == "unknown":
        return f"something is missing that no known effect explains (error {d.error_before:.3g} noise units)"
    names = " and ".join(d.effects)
    if d.verdict == "tied":
        return f"{names} is missing, or {', or '.join(d.tied_with)}: this recording cannot tell ({fall})"
    return f"{names} is missing ({fall})"


Progress = Callable[[str, float], None]


def _silent(_: str, __: float) -> None:
    return None


@dataclass
class _Search:
    """The state of one diagnosis."""

    crane: Crane
    data: Data
    jobs: int
    progress: Progress
    nominal: Fit  # the crane as it is, in loosely joined windows
    base: Fit  # the same with all uncertain parameters fitted
    shared: list[Variable]

    def run(self, hypotheses: Sequence[tuple[Hypothesis, Fit]], stages: Sequence[Any]) -> list[Weighed]:
        """Return the hypotheses fitted, on as many processes as the search may use, best first."""
        tasks = [(weigh, self.crane, self.data, self.shared, before, h, stages) for h, before in hypotheses]
        found = in_parallel(self.jobs, tasks)
        return sorted((w for w in found if math.isfinite(w.evidence)), key=lambda w: -w.evidence)

    def scores(self, fit: Fit) -> list[Score]:
        """Return the screen at a fit; effects that its crane has already do not take part."""
        return screened(fit, self.data, LOOSE.stiffness)

    def scores_at_nominal(self) -> list[Score]:
        """Return the screen at the crane as it is, all its uncertain parameters free to move."""
        return self.scores(self.unmoved(self.nominal))

    def unmoved(self, fit: Fit, effects: Sequence[EffectVariable] = ()) -> Fit:
        """Return a fit of the crane as given (with effects as they are) in which all uncertain parameters may move from where it states them."""
        known = {v.name: u for v, u in zip(fit.variables, fit.u, strict=True)}
        variables = (*self.base.variables, *effects)
        u = [known.get(v.name, v.begin if isinstance(v, EffectVariable) else 0.0) for v in variables]
        return replace(fit, origin=self.crane, variables=variables, u=np.array(u))


def screened(fit: Fit, data: Data, stiffness: float) -> list[Score]:
    """Return the screen at a fit, best first; what happens at a moment is looked at more closely around the best one.

    A machine that rings has a minimum of its cost once a period: the fit finds only the one where it begins.
    """
    found = screen(fit, starts(fit.crane, data), stiffness)
    best: dict[str, Score] = {}
    for score in found:
        if score.gain >= 1.0:
            best.setdefault(score.start.key, score)
    closer = [start for score in best.values() for start in around(score.start)]
    return sorted([*found, *screen(fit, closer, stiffness)], key=lambda s: -s.gain) if closer else found


def in_parallel(jobs: int, tasks: Sequence[tuple[Any, ...]]) -> list[Any]:
    """Return the results of tasks (function, *arguments) from worker processes that know the user's own effects."""
    if jobs == 1 or len(tasks) < 2:
        return [function(*arguments) for function, *arguments in tasks]
    return list(results_of(tasks, min(jobs, len(tasks))))


def diagnose(
    crane: Crane,
    recording: Recording | Sequence[Recording],
    check: Recording | None = None,
    *,
    per_recording: Sequence[str] = (),
    jobs: int = 2,
    progress: Progress = _silent,
) -> Diagnosis:
    """Return what the recording, or several of one machine, say that the crane file lacks.

    First the nominal parameters may move within their uncertainty. Then every effect at every place is screened, the promising
    ones are fitted together with the parameters and the machine's states, alone and, if one does not do, in pairs, and weighed by
    their marginal likelihood. Without a known effect that explains the recording the verdict is "unknown".

    Args:
        crane: the crane file; effects that it has stay, and are fitted along.
        recording: commands and sensors; several recordings of one machine may differ in sensors and rates.
        check: another recording of the same machine, which is only predicted.
        per_recording: nominal parameters that differ from recording to recording, such as payload.mass.
        jobs: processes to use.
        progress: called with a text and the share that is done.

    Raises:
        CraneError: the recording cannot support a diagnosis.
    """
    from .fitness import check_all

    began = time.perf_counter()
    recordings = several(recording)
    notes = check_all(recordings, check, crane)
    data = data_of(recordings, crane, per_recording)
    progress("fitting the nominal parameters", 0.05)
    search = _prepare(crane, data, jobs, progress)
    nothing = Hypothesis()
    as_given = weigh(crane, data, timings(data), search.nominal, nothing, (TIGHT, STIFF))
    parameters = weigh(crane, data, search.shared, search.base, nothing, (TIGHT, STIFF))
    progress("screening all effects", 0.2)
    loose = _singles(search, PROOF if _good(parameters) else 1.0)
    progress("fitting the likely effects", 0.5)
    finished = _again(search, _elsewhere(search, _finish(search, loose)), parameters)
    if not (_good(parameters) or (finished and _good(finished[0]))):
        progress("trying pairs", 0.7)
        finished = _with_pairs(search, loose, finished, parameters)
    elif finished and finished[0].evidence > parameters.evidence + PROOF:
        finished = _with_seconds(search, finished, recordings[0] if check is None else check)
    progress("weighing", 0.9)
    result = _conclude(search, as_given, parameters, finished, check, notes)
    if result.verdict == "unknown":
        result = replace(result, where=_where(crane, recordings) or result.where)
    result = _held_to_check(_with_errors(result, search, recordings, check, as_given))
    return replace(result, seconds=time.perf_counter() - began)


def _held_to_check(d: Diagnosis) -> Diagnosis:
    """Return the diagnosis; "unknown", if what explains the recording leaves most of what is wrong on the check recording.

    Then the candidates stay, but none of them is what the machine lacks, or the check recording is of another machine.
    """
    after, before = d.check_error_after, d.check_error_before
    if d.verdict == "unknown" or not (after > MISLED and after**2 - 1.0 > LEFT_BY_SECOND * (before**2 - 1.0)):
        return d
    found = " and ".join(d.effects) or "the model" + " with moved parameters" * (d.verdict == "parameters")
    note = (
        f"{found} explains the recording, but does not predict the check recording (error {before:.3g} -> {after:.3g} noise units). Is it of "
        "the same machine, with the same load and the same units?"
    )
    return replace(
        d, verdict="unknown", crane=d.given, effects=(), tied_with=(), next_manoeuvre="", misses_check=True, notes=(note, *d.notes),
        error_after=d.error_before, check_error_after=before,
    )  # fmt: skip


def several(recording: Recording | Sequence[Recording]) -> tuple[Recording, ...]:
    """Return one recording, or several, as a tuple."""
    return (recording,) if isinstance(recording, Recording) else tuple(recording)


def _where(crane: Crane, recordings: Sequence[Recording]) -> tuple[Mapping[str, Any], ...]:
    """Return which balance is violated when, as `compare` finds it, worst first; with several recordings also in which."""
    from .compare import compare

    found = [
        finding.to_dict() | ({"recording": r.name} if len(recordings) > 1 else {})
        for r in recordings
        for finding in compare(crane, r).where
    ]
    return tuple(sorted(found, key=lambda f: -f["score"]))


def _prepare(crane: Crane, data: Data, jobs: int, progress: Progress) -> _Search:
    """Fit all nominal parameters in short windows and keep the directions that the data speak about."""
    nominal, base = all_parameters(replace(crane, uncertainty={}), data), all_parameters(crane, data)
    own: list[Variable] = [v for e in crane.effects for v in effect_variables(e.key, e.parameters, crane.layout)]
    return _Search(crane, data, jobs, progress, nominal, base, [*informed_directions(base), *own])


def _singles(search: _Search, least: float) -> list[Weighed]:
    """Return single effects fitted in short windows, best first: those of which the screen expects at least that gain.

    Parameters that have moved further than their uncertainty allows hide what is missing; then the crane as given is screened too.
    """
    found = [(s, search.base) for s in _likely(search.scores(search.base), FITTED) if s.gain >= least]
    if not _plausible(search.base):
        keys = {s.start.key for s, _ in found}
        others = _likely(search.scores_at_nominal(), FITTED)
        found += [(s, search.nominal) for s in others if s.gain >= least and s.start.key not in keys][:BESIDE]
    hypotheses = [(Hypothesis({s.start.key: scaled(s.start, s.amplitude)}), before) for s, before in found]
    return _best_of_each(search.run(hypotheses, (LOOSE,)))


def _likely(scores: Sequence[Score], most: int) -> list[Score]:
    """Return the best scores: at most two starts of one effect at one place, and none that promises next to nothing."""
    chosen: list[Score] = []
    for score in scores:
        hopeless = len(chosen) >= 3 and score.gain < HOPELESS * scores[0].gain
        if score.gain < 1.0 or len(chosen) == most or hopeless:
            break
        if sum(c.start.key == score.start.key for c in chosen) < (2 if score.gain > 0.5 * scores[0].gain else 1):
            chosen.append(score)
    return chosen


def _best_of_each(found: Sequence[Weighed]) -> list[Weighed]:
    seen: dict[tuple[str, ...], Weighed] = {}
    for w in sorted(found, key=lambda w: -w.evidence):
        seen.setdefault(tuple(sorted(w.hypothesis.keys)), w)
    return list(seen.values())


def _finish(search: _Search, loose: Sequence[Weighed], most: int = FINISHED) -> list[Weighed]:
    """Carry the leading fits from loosely joined short windows to a run without jumps."""
    if not loose:
        return []
    best = loose[0].evidence
    near = max(100.0, NEAR * (best - log_evidence(search.base)))
    leading = [w for i, w in enumerate(loose[:most]) if i < 2 or w.evidence > best - near]
    return search.run([(w.hypothesis, w.fit) for w in leading], (TIGHT, STIFF))


def _elsewhere(search: _Search, finished: list[Weighed]) -> list[Weighed]:
    """Return the finished fits with the leading effect at its other places added, where moved parameters help it.

    An effect at the wrong place explains much of a recording if parameters may help, and they can hide the right place from the screen.
    """
    if not finished or finished[0].fit.prior_cost < HELPED:
        return finished
    best, tried = finished[0], {key for w in finished for key in w.hypothesis.keys}
    effect, _ = registry.split_key(best.hypothesis.keys[0])
    found = [s for s in starts(search.crane, search.data) if s.key in set(effect.keys(search.crane.layout)) - tried]
    others = search.run([(Hypothesis({s.key: s.values}), search.base) for s in found], (LOOSE,)) if found else []
    leading = _best_of_each(others)[:1]
    return _best_of_each([*finished, *search.run([(w.hypothesis, w.fit) for w in leading], (TIGHT, STIFF))])


def _again(search: _Search, finished: Sequence[Weighed], parameters: Weighed, level: float = math.inf) -> list[Weighed]:
    """Return the finished fits, the leading ones (of those below a level) taken further where they are not at their end.

    Where parameters have moved further than they may to do an effect's work, the fit begins anew at the crane as given with the effect as it
    was found, and as one long run: what is slow does not show in short windows. Where it had not converged, it goes on.
    """
    tasks: list[tuple[Any, ...]] = []
    for w in sorted(finished, key=lambda w: w.fit.prior_cost - w.evidence)[:ANEW]:  # rather what parameters help less
        if _good(w) or w.evidence < parameters.evidence + PROOF or w.level > level:
            continue
        if not _plausible(w.fit):
            tasks.append((_anew, search.crane, search.data, search.shared, w))
        elif not w.fit.converged:
            tasks.append((weigh, search.crane, search.data, search.shared, w.fit, w.hypothesis, (STIFF, STIFF)))
    further = [w for w in in_parallel(search.jobs, tasks) if math.isfinite(w.evidence)] if tasks else []
    return _best_of_each([*finished, *further])


def _anew(crane: Crane, data: Data, shared: Sequence[Variable], found: Weighed) -> Weighed:
    values = {key: fitted_values(found, key) for key in found.hypothesis.keys}
    return weigh(crane, data, shared, _held(crane, data, found), Hypothesis(values), (WHOLE, STIFF))


def _with_pairs(
    search: _Search, loose: Sequence[Weighed], finished: Sequence[Weighed], parameters: Weighed
) -> list[Weighed]:
    """Return the finished fits with pairs added: the leading single effects, each with what the screen finds beside it.

    What came in as a second effect may be the one that is missing, and the first a makeshift: such singles are weighed alone,
    and where one of them leads, pairs with it are tried as well.
    """
    done = _again(search, _paired(search, loose[:3]), parameters, LEFT_LEVEL)
    alone = _alone(search, done, finished)
    finished = _best_of_each([*finished, *alone])
    search.progress("finishing pairs", 0.8)
    if alone and finished[0] is alone[0]:
        if _good(alone[0]):
            return finished
        done += _paired(search, alone[:1])
    singles = {w.hypothesis.keys[0]: w.evidence for w in finished}
    bare = max([parameters.evidence, *singles.values()])
    proven = [
        w
        for w in _best_of_each(done)
        if not _idle(w)
        and w.evidence > max([bare, *(singles.get(k, -math.inf) for k in w.hypothesis.keys)]) + PROOF
        and (not finished or _repairs(w, finished[0]))
    ]
    return sorted([*finished, *proven], key=lambda w: -w.evidence)


def _paired(search: _Search, firsts: Sequence[Weighed]) -> list[Weighed]:
    """Return the best pairs of one of these effects with what the screen finds beside it, fitted to the end.

    Where parameters have moved further than they may, they do the second effect's work and hide it; then the screen also looks from
    the crane as given with the first effect.
    """
    if not firsts:
        return []
    hypotheses = [h for first in firsts for h in _beside(first, _likely(search.scores(first.fit), 5))]
    strained, lay = [first for first in firsts if not _plausible(first.fit)], search.crane.layout
    held = in_parallel(search.jobs, [(_held, search.crane, search.data, first) for first in strained])
    for first, fit in zip(strained, held, strict=True):
        own = [v for key in first.hypothesis.keys for v in effect_variables(key, fitted_values(first, key), lay)]
        unmoved = search.unmoved(fit, own)
        tried = {h.keys for h, _ in hypotheses}
        more = _beside(first, _likely(search.scores(unmoved), BESIDE), unmoved)
        hypotheses += [h for h in more if h[0].keys not in tried]
    pairs = _best_of_each(search.run(hypotheses, (LOOSE,))) if hypotheses else []
    leading = _leading_pairs(pairs, firsts[0].hypothesis.keys[0])
    return search.run([(w.hypothesis, w.fit) for w in leading], (TIGHT, STIFF))


def _leading_pairs(pairs: Sequence[Weighed], first: str) -> list[Weighed]:
    """Return the pairs to be fitted to the end: the two best, and if parameters help the best too much, the one with `first` that
    they help least."""
    leading = list(pairs[:2])
    if leading and not _plausible(leading[0].fit):
        calmest = min(
            (w for w in pairs if first in w.hypothesis.keys), key=lambda w: w.fit.prior_cost, default=leading[0]
        )
        if all(calmest is not w for w in leading):
            leading.append(calmest)
    return leading


def _held(crane: Crane, data: Data, found: Weighed) -> Fit:
    """Return the crane as given with effects as they were found, none of its parameters moved, in loosely joined windows."""
    held = replace(crane, uncertainty={})
    for key in found.hypothesis.keys:
        held = held.with_effect(key, fitted_values(found, key))
    return all_parameters(held, data)


def _beside(first: Weighed, scores: Sequence[Score], before: Fit | None = None) -> list[tuple[Hypothesis, Fit]]:
    """Return pairs to be fitted: the effects of a fit with each other effect that a screen beside it found; they begin at `before`."""
    own = {k: fitted_values(first, k) for k in first.hypothesis.keys}
    return [
        (Hypothesis(own | {s.start.key: scaled(s.start, s.amplitude)}), before or first.fit)
        for s in scores
        if s.start.key not in own
    ]


def _alone(search: _Search, pairs: Sequence[Weighed], finished: Sequence[Weighed]) -> list[Weighed]:
    """Return effects of pairs weighed alone, best first: those that have not been, and those beside which the other one does nothing.

    A pair whose second effect has stayed neutral may only have found the better minimum.
    """
    known = {w.hypothesis.keys[0] for w in finished}
    own: dict[str, tuple[Hypothesis, Fit]] = {}
    for pair in pairs:
        idle = _idle(pair)
        for key in pair.hypothesis.keys:
            if key not in known or idle - {key}:
                own.setdefault(key, (Hypothesis({key: fitted_values(pair, key)}), pair.fit))
    return search.run(list(own.values()), (TIGHT, STIFF)) if own else []


def _idle(pair: Weighed) -> set[str]:
    """Return the effects of a pair whose parameters cannot be told from their neutral values."""
    return {key for key in pair.hypothesis.keys if _at_neutral(pair, key)}


def _at_neutral(pair: Weighed, key: str) -> bool:
    values, spread = fitted_values(pair, key), deviations(pair, key)
    acting = [p for p in registry.split_key(key)[0].parameters if not p.shape]
    return all(
        math.isinf(values[p.name])
        or (
            math.isinf(spread[p.name])
            if math.isinf(p.neutral)
            else abs(values[p.name] - p.neutral) < TOLD_APART * spread[p.name]
        )
        for p in acting
    )


def _with_seconds(search: _Search, finished: Sequence[Weighed], judge: Recording) -> list[Weighed]:
    """Return the finished fits with second effects added that the screen finds beside one that leaves hardly more than noise.

    Moved parameters can make up for a second effect, but not for nothing: their prior charges for it, and the screen knows that.
    They then predict worse, so the second effect must show in the open-loop error on `judge` as well.
    """
    best = finished[0]
    scores = screened(best.fit, search.data, STIFF.stiffness)
    hypotheses = _beside(best, [s for s in _likely(scores, 2) if s.gain > PROOF])
    done = _best_of_each(search.run(hypotheses, (STIFF,))) if hypotheses else []
    proven = [w for w in done if w.evidence > best.evidence + PROOF and not _idle(w)]
    if proven:
        errors = in_parallel(search.jobs, [(_error, w.fit.crane, judge, None) for w in (best, *proven)])
        excess = [max(e**2 - 1.0, 0.0) for e in errors]
        proven = [w for w, e in zip(proven, excess[1:], strict=True) if e < LEFT_BY_SECOND * excess[0]]
    return sorted([*finished, *proven], key=lambda w: -w.evidence)


def _good(w: Weighed) -> bool:
    """Whether a model leaves hardly more than noise, its parameters within their uncertainty."""
    return w.level < LEVEL and float(w.bad.mean()) <= SHARE and _plausible(w.fit)


def _plausible(fit: Fit) -> bool:
    """Whether the moved parameters, taken together, are what their stated uncertainties allow."""
    from scipy.stats import chi2

    known = sum(math.isfinite(v.prior) for v in fit.variables)
    return known == 0 or 2.0 * fit.prior_cost < float(chi2.isf(IMPLAUSIBLE, known))


def _repairs(pair: Weighed, single: Weighed) -> bool:
    """Whether a second effect takes away most of what the first one leaves.

    What is left of a law that is only nearly the machine's can be told from noise, and many a second effect makes a little of it
    good, with much evidence and no use.
    """
    return _good(pair) or pair.level**2 - 1.0 < LEFT_BY_SECOND * (single.level**2 - 1.0)


def _conclude(
    search: _Search,
    as_given: Weighed,
    parameters: Weighed,
    finished: Sequence[Weighed],
    check: Recording | None,
    notes: list[str],
) -> Diagnosis:
    """Return the verdict."""
    best = finished[0] if finished else None
    enough = _good(as_given) or _good(parameters)
    proof = max(parameters.evidence, as_given.evidence) + PROOF
    if enough and (best is None or best.evidence < proof or _between_samples(search, best)):
        return _without_effect(search, as_given, parameters, finished, notes)
    if best is None or not _explains(search, best, parameters, check, notes):
        return _verdict(search, "unknown", best, parameters, finished, notes)
    return _named(search, parameters, finished, notes)


def _between_samples(search: _Search, best: Weighed) -> bool:
    """Whether what is added is a delay of commands within a sampling interval: where in it a command came is not recorded."""
    interval = max(float(np.median(np.diff(p.command_time))) for p in search.data.parts)
    return all(
        registry.split_key(key)[0].name == "command_delay" and fitted_values(best, key)["T"] < interval
        for key in best.hypothesis.keys
    )


def _named(search: _Search, parameters: Weighed, finished: Sequence[Weighed], notes: list[str]) -> Diagnosis:
    """Return the verdict that names the best fit, tied with what is no worse within the tie and needs no more effects."""
    best = finished[0]
    ties = [
        w
        for w in finished[1:]
        if w.evidence > best.evidence - TIE and len(w.hypothesis.keys) <= len(best.hypothesis.keys)
    ]
    return _verdict(search, "tied" if ties else "effect", best, parameters, finished, notes, ties)


def _explains(search: _Search, best: Weighed, parameters: Weighed, check: Recording | None, notes: list[str]) -> bool:
    """Whether effects explain the recording: hardly more than noise left, or nearly all that was wrong repaired.

    Where more is left, a check recording decides: a law that is nearly the machine's predicts it nearly to its noise, whatever it
    leaves here; a makeshift for what the library lacks does not.
    """
    if best.evidence < parameters.evidence + PROOF or not _plausible(best.fit):
        return False
    if _good(best):
        return True
    wrong = max(1, int(parameters.bad.sum()))
    most = best.level < LEFT_LEVEL and 1.0 - best.bad.sum() / wrong >= REPAIRED
    if check is None:
        return most
    before, after = in_parallel(search.jobs, [(_error, c, check, None) for c in (search.crane, best.fit.crane)])
    if after < LEFT_LEVEL and after**2 - 1.0 < LEFT_OF_CHECK * (before**2 - 1.0):
        notes.append("what comes first predicts the check recording, but its law is not quite the machine's")
        return True
    names = " and ".join(best.hypothesis.keys)
    if most and after > MISLED:
        notes.append(f"{names} would repair most of this recording, but does not predict the other (error {after:.3g})")
    return most and after <= MISLED


def _without_effect(
    search: _Search, as_given: Weighed, parameters: Weighed, finished: Sequence[Weighed], notes: list[str]
) -> Diagnosis:
    adequate = _good(as_given) and parameters.evidence < as_given.evidence + PROOF
    return _verdict(search, "adequate" if adequate else "parameters", None, parameters, finished, notes)


def _verdict(
    search: _Search, verdict: Verdict, best: Weighed | None, parameters: Weighed,
    finished: Sequence[Weighed], notes: list[str], ties: Sequence[Weighed] = (),
) -> Diagnosis:  # fmt: skip
    named = verdict in ("effect", "tied")
    chosen = best if named and best is not None else parameters
    if verdict in ("effect", "tied", "parameters"):
        lean = leaner(search.crane, search.data, chosen)
        best, finished, parameters = _exchanged(chosen, lean, best, finished, parameters)
        chosen = lean
    everything = sorted([parameters, *finished], key=lambda w: -w.evidence)
    weights = np.exp(np.clip([w.evidence - everything[0].evidence for w in everything], -700, 0))
    candidates = tuple(_candidate(w, float(p)) for w, p in zip(everything, weights / weights.sum(), strict=True))
    crane = search.crane if verdict in ("adequate", "unknown") else chosen.fit.crane
    if named and best is not None:
        notes += [f"{k}: {p} is at an end of its range" for k in best.hypothesis.keys for p in at_bound(best, k)]
    return Diagnosis(
        search.data.name, verdict, crane, search.crane, {} if verdict == "adequate" else moved_parameters(search, chosen),
        candidates, best.hypothesis.keys if named and best else (), tuple(" + ".join(w.hypothesis.keys) for w in ties),
        next_manoeuvre=_telling(search, chosen, ties[0]) if ties else "",
        where=left_over(best or parameters) if verdict == "unknown" else (), notes=tuple(notes), late=chosen.fit.late,
    )  # fmt: skip


def _telling(search: _Search, chosen: Weighed, other: Weighed) -> str:
    noise = {s.channel: s.noise for p in search.data.parts for s in p.samples}
    return best_manoeuvre(chosen.fit.crane, other.fit.crane, noise, search.data.channels)


def _exchanged(
    old: Weighed, new: Weighed, best: Weighed | None, finished: Sequence[Weighed], parameters: Weighed
) -> tuple[Weighed | None, list[Weighed], Weighed]:
    """Put the leaner fit in the place of the one it replaces."""
    swap = lambda w: new if w is old else w  # noqa: E731
    return (swap(best) if best is not None else None), [swap(w) for w in finished], swap(parameters)


def _candidate(w: Weighed, probability: float) -> Candidate:
    parameters = {}
    for key in w.hypothesis.keys:
        values, spread = fitted_values(w, key), deviations(w, key)
        prefix = f"{key}:" if len(w.hypothesis.keys) > 1 else ""
        effect, place = registry.split_key(key)
        for p in effect.parameters:
            unit = unit_at(p.unit, place, w.fit.crane.layout)
            parameters[prefix + p.name] = {"value": values[p.name], "std": spread.get(p.name, math.inf), "unit": unit}
    bounds = tuple(f"{k}:{p}" for k in w.hypothesis.keys for p in at_bound(w, k))
    return Candidate(
        w.hypothesis.keys, parameters, w.evidence, probability, w.fit.crane, at_bound=bounds, level=w.level, fit=w.fit
    )


def moved_parameters(search: _Search, chosen: Weighed) -> dict[str, dict[str, Any]]:
    """Return the nominal parameters that moved by more than a tenth of their uncertainty: value, std, nominal, unit."""
    found: dict[str, dict[str, Any]] = {}
    prior = {
        n: (k.std if math.isfinite(k.std) else 0.25 * (k.upper - k.lower)) for n, k in search.crane.uncertainty.items()
    }
    spread = _posterior(search, chosen, prior)
    for name, nominal in search.crane.values.items():
        value = chosen.fit.crane.values[name]
        if name in prior and abs(value - nominal) > 0.1 * prior[name]:
            found[name] = {"value": value, "std": spread[name], "nominal": nominal, "unit": unit_of(name)}
    return dict(sorted(found.items(), key=lambda item: -abs(item[1]["value"] - item[1]["nominal"]) / prior[item[0]]))


def _posterior(search: _Search, chosen: Weighed, prior: Mapping[str, float]) -> dict[str, float]:
    """Return the standard deviation of each nominal parameter: the informed directions' from the fit, the others' from the prior."""
    variance = {n: s**2 for n, s in prior.items()}
    directions = [(i, v) for i, v in enumerate(chosen.fit.variables) if hasattr(v, "weights")]
    cov = chosen.fit.cov
    for name in prior:
        weights = np.array([v.weights.get(name, 0.0) for _, v in directions])
        index = [i for i, _ in directions]
        before = float(
            sum(w**2 * (1.0 if math.isfinite(v.prior) else 0.0) for w, (_, v) in zip(weights, directions, strict=True))
        )
        after = float(weights @ cov[np.ix_(index, index)] @ weights)
        alone = any(not math.isfinite(v.prior) and w for w, (_, v) in zip(weights, directions, strict=True))
        variance[name] = after if alone else max(variance[name] - before, 0.0) + after
    return {n: math.sqrt(max(v, 0.0)) for n, v in variance.items()}


def left_over(w: Weighed) -> tuple[Mapping[str, Any], ...]:
    """Return the stretches of the recording that a fit leaves unexplained, worst first."""
    found: list[dict[str, Any]] = []
    for k in np.flatnonzero(w.bad):
        window, error = w.fit.windows[k].data, float(w.fit.linear.window_error[k])
        start, end = float(window.time[0]), float(window.time[-1])
        if found and found[-1]["to"] >= start - 1e-9:
            found[-1] |= {"to": end, "score": max(found[-1]["score"], error)}
        else:
            found.append({"channel": "all", "from": start, "to": end, "phase": "", "score": error})
    for entry in found:
        entry["text"] = (
            f"from {entry['from']:.2f} to {entry['to']:.2f} s errors reach {entry['score']:.1f} times the noise"
        )
    return tuple(sorted(found, key=lambda e: -e["score"]))


def _with_errors(
    d: Diagnosis, search: _Search, recordings: Sequence[Recording], check: Recording | None, as_given: Weighed
) -> Diagnosis:
    """Add open-loop errors on both recordings: of the crane as given, of the candidates that came near, of the choice."""
    best = max((c.evidence for c in d.candidates), default=0.0)
    near = [c for c in d.candidates if c.evidence > best - 3 * TIE or c.effects == d.effects]
    cranes = [(search.crane, as_given.fit), *((c.crane, c.fit or search.base) for c in near)]
    own = search.data.own
    tasks: list[tuple[Any, ...]] = [
        (_error, fit.of(i).crane, r, fit.of(i)) for _, fit in cranes for i, r in enumerate(recordings)
    ]
    tasks += [(_error, crane, check, None, own) for crane, _ in cranes] if check is not None else []
    errors = in_parallel(search.jobs, tasks)
    n = len(recordings)
    each = [errors[n * k : n * (k + 1)] for k in range(len(cranes))]
    learned = [together(recordings, e) for e in each]
    checked = errors[n * len(cranes) :] or [math.nan] * len(cranes)
    before, check_before = learned[0], checked[0]
    after = {id(c): (e, k) for c, e, k in zip(near, learned[1:], checked[1:], strict=True)}
    candidates = [
        replace(
            c, error_before=before, check_error_before=check_before,
            error_after=after.get(id(c), (math.nan,) * 2)[0], check_error_after=after.get(id(c), (math.nan,) * 2)[1],
        )
        for c in d.candidates
    ]  # fmt: skip
    unchanged = d.verdict in ("adequate", "unknown")
    chosen = None if unchanged else next(c for c in candidates if c.effects == d.effects)
    k = 0 if unchanged else 1 + next(i for i, c in enumerate(near) if c.effects == d.effects)
    found = [
        {"recording": r.name, "error_before": each[0][i], "error_after": each[k][i]} | _own(cranes[k][1], search, i)
        for i, r in enumerate(recordings)
    ]
    return replace(
        d, recordings=tuple(found) if n > 1 else (), candidates=tuple(candidates), error_before=before, check_error_before=check_before,
        error_after=chosen.error_after if chosen else before,
        check_error_after=chosen.check_error_after if chosen else check_before,
    )  # fmt: skip


def _own(fit: Fit, search: _Search, recording: int) -> dict[str, Any]:
    """Return what a recording's own parameters were found to be, as an entry of its own."""
    crane = fit.of(recording).crane
    found = {n: {"value": crane[n], "nominal": search.crane[n], "unit": unit_of(n)} for n in search.data.own}
    return {"parameters": found} if found else {}


def together(recordings: Sequence[Recording], errors: Sequence[float]) -> float:
    """Return the RMS over all samples of recordings whose own RMS is given."""
    counts = [sum(len(r[c]) for c in r.sensors) for r in recordings]
    return math.sqrt(sum(n * e**2 for n, e in zip(counts, errors, strict=True)) / sum(counts))


def _error(crane: Crane, recording: Recording, knots: Fit | None, own: Sequence[str] = ()) -> float:
    """Return the open-loop error; where a run from the knots of a fit is far worse than the fit, its start is looked for anew as well."""
    error = open_loop_error(crane, recording, knots, own)[0]
    if knots is None or error < ASTRAY * knots.error:
        return error
    return min(error, open_loop_error(crane, recording)[0])
