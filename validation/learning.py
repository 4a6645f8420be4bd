"""Laws that nobody wrote: in which balance a machine lacks something, where, over what it runs, and its curve."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects import registry
from crane_exudyn.recording import Recording

from .diagnosis import looked_at
from .fit.evidence import log_evidence
from .fit.solve import Fit
from .fit.staged import LOOSE, STIFF, TIGHT, Stage
from .fit.variables import NominalDirection, Variable, effect_variables
from .history import added
from .learned.fits import Explained, Part, explain, left_out_gain
from .learned.laws import BLOCK, Law, laws_of, unit_over
from .learned.learned_law import LearnedLaw
from .learned.resembles import Resemblance, resembles
from .learned.screen import allowed
from .learned.screen import screened as screened_laws
from .selection.criteria import CRITERIA
from .selection.lean import needed
from .selection.model import Model, excess, misled, plausible, retold, run_error, together
from .selection.moves import scaled
from .selection.screen import likely, screened
from .selection.search import Problem, Progress, silent
from .workers import in_parallel


@dataclass(frozen=True)
class Learned:
    """What was learned from a recording; `crane` has the laws, or is the one given where none was found."""

    recording: str
    crane: Crane
    given: Crane
    laws: tuple[LearnedLaw, ...] = ()
    effects: tuple[str, ...] = ()
    next_manoeuvre: str = ""
    notes: tuple[str, ...] = ()
    error_before: float = math.nan
    error_after: float = math.nan
    check_error_before: float = math.nan
    check_error_after: float = math.nan
    evidence: float = 0.0
    seconds: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON of learn."""
        keys = (
            "effects",
            "next_manoeuvre",
            "notes",
            "error_before",
            "error_after",
            "check_error_before",
            "check_error_after",
            "seconds",
        )
        return {"laws": [law.to_dict() for law in self.laws]} | {k: getattr(self, k) for k in keys}

    def __repr__(self) -> str:
        return f"<Learned from {self.recording}: {sentence(self)}>"

    def plot(self) -> Any:
        """Return a figure: each curve with its interval, and where the recording went."""
        from .learned.plots import figure

        return figure(self.laws)


def sentence(found: Learned) -> str:
    """Return what was learned in one sentence."""
    if not found.laws:
        return "no law found"
    told = (
        f"{law.effect} over {law.over.replace('_', ' ')}" + (f" ({law.resembles})" if law.resembles else "")
        for law in found.laws
    )
    return f"{' and '.join(told)}: error {found.error_before:.3g} -> {found.error_after:.3g} noise units"


def learn(
    crane: Crane,
    recordings: Recording | Sequence[Recording],
    check: Recording | None = None,
    *,
    per_recording: Sequence[str] = (),
    jobs: int = 2,
    progress: Progress = silent,
) -> Learned:
    """Return the laws that recordings show and that neither the crane nor the library has; none where the library's do
    as well.

    Args:
        crane: effects that it has stay, and are fitted along.
        recordings: commands and sensors, of one run or of several of one machine.
        check: another recording of the same machine, which is only predicted.
        per_recording: nominal parameters that differ from recording to recording.
        jobs: processes to use.
        progress: called with a text and the share that is done.

    Raises:
        CraneError: the recording cannot support it.
    """
    began = time.perf_counter()
    problem, notes = looked_at(crane, recordings, check, per_recording, jobs, progress)
    nothing = _explained(problem, [((), problem.base)], (TIGHT, STIFF))
    problem, best, rivals = _searched(problem, nothing[0], progress, notes)
    progress("weighing", 0.85)
    result = _concluded(problem, nothing[0], best, rivals, check, notes)
    return replace(result, seconds=time.perf_counter() - began)


def _explained(
    problem: Problem, tried: Sequence[tuple[tuple[Part, ...], Fit]], stages: Sequence[Stage]
) -> list[Explained]:
    """Return parts fitted from earlier fits through the stages, best first."""
    tasks = [(explain, problem.crane, problem.data, problem.shared, before, parts, stages) for parts, before in tried]
    found = in_parallel(problem.jobs, tasks)
    return sorted((e for e in found if math.isfinite(e.evidence)), key=lambda e: -e.evidence)


def _searched(
    problem: Problem, nothing: Explained, progress: Progress, notes: list[str]
) -> tuple[Problem, Explained, list[Explained]]:
    """Return the best explanation of effects and laws, and all that were carried to the end with it, best first; and
    the problem with the variables that they share.
    """
    best, rivals = nothing, list[Explained]()
    for step in range(CRITERIA.laws):
        if step and best.weighed.good:
            break
        progress("looking for another" if step else "screening all laws", 0.2 + 0.35 * step)
        found = _grown(problem, best, problem.base if not step else best.fit, progress)
        chosen = _chosen(found, best)
        if chosen is None or (step and not _repairs(chosen, best)):
            break
        if len(chosen.laws) > len(best.laws) and not _predicts(problem, best, chosen, notes):
            break
        problem, rivals = _retold(problem, chosen, found)
        best = rivals[0]
    if best.laws and not (_repairs(best, nothing) and plausible(best.fit)):
        names = " and ".join(_name(p) for p in best.parts)
        notes.append(f"{names} would be the best, but leaves too much, or moves parameters too far")
        return problem, nothing, []
    return problem, best, rivals


def _retold(problem: Problem, chosen: Explained, found: Sequence[Explained]) -> tuple[Problem, list[Explained]]:
    """Return the problem with the combinations of parameters that an explanation tells of itself, and it and what is
    tied with it fitted by those that each tells.
    """
    tied = [e for e in found if e is not chosen and e.evidence > chosen.evidence - CRITERIA.tie]
    again: list[Explained] = in_parallel(problem.jobs, [(_by_its_own, e) for e in (chosen, *tied)])
    return replace(problem, shared=again[0].weighed.model.variables), again


def _by_its_own(e: Explained) -> Explained:
    return replace(e, weighed=retold(e.weighed))


def _chosen(found: Sequence[Explained], best: Explained) -> Explained | None:
    """Return the best of the explanations that bring the proof; one with a law must bring it against those without a
    further one as well.
    """
    proven = [e for e in found if e.evidence > best.evidence + CRITERIA.proof and _sound(e)]
    plain = next((e for e in proven if len(e.laws) == len(best.laws)), None)
    if plain is not None and plain.evidence > proven[0].evidence - CRITERIA.proof:
        return plain
    return proven[0] if proven else None


def _repairs(after: Explained, before: Explained) -> bool:
    """Whether an explanation leaves hardly more than noise, or less than half of the excess error of the one before."""
    left, was = (excess(e.weighed.level) for e in (after, before))
    return after.weighed.good or left < CRITERIA.left * was


def _grown(problem: Problem, best: Explained, before: Fit, progress: Progress) -> list[Explained]:
    """Return explanations with one part more, fitted to the end, best first."""
    if best.parts:
        before = explain(problem.crane, problem.data, problem.shared, before, best.parts, (LOOSE,)).fit
    tried = [((*best.parts, part), fit) for fit in _starts(problem, before) for part in _promising(problem, fit)]
    progress("fitting the likely ones", 0.35)
    found = _best_of_each(_explained(problem, tried, (replace(LOOSE, iterations=CRITERIA.sifted),)))
    if not found:
        return []
    least = found[0].evidence - CRITERIA.near * (found[0].evidence - log_evidence(before))
    near = [e for e in found if e.evidence > least]
    plain, curved = ([e for e in near if (len(e.laws) > len(best.laws)) == kind] for kind in (False, True))
    curved = [e if plausible(e.fit) else _anew(problem, e) for e in curved[: CRITERIA.carried]]
    progress("carrying the leading ones to the end", 0.5)
    return _explained(problem, [(e.parts, e.fit) for e in (*curved, *plain[:1])], (TIGHT, STIFF))


def _anew(problem: Problem, e: Explained) -> Explained:
    """Return an explanation fitted anew from the crane as given with its parts as they were found, where that does no
    worse.

    Parameters that did a law's work before it was there come back slowly.
    """
    fit = problem.with_effects({p.key: e.weighed.values(p.key) for p in e.parts})
    keys = {p.key for p in e.parts}
    own = [i for i, v in enumerate(e.fit.variables) if getattr(v, "key", "") in keys]
    variables = (*fit.variables, *(e.fit.variables[i] for i in own))
    before = replace(fit, variables=variables, u=np.concatenate([fit.u, e.fit.u[own]]))
    found = explain(problem.crane, problem.data, problem.shared, before, e.parts, (LOOSE,))
    return found if found.evidence > e.evidence else e


def _starts(problem: Problem, fit: Fit) -> list[Fit]:
    """Return the fits at which further parts are looked for, and from which they are fitted.

    Parameters that have moved further than they may do a law's work and hide it: then the crane as given is one too.
    """
    if fit is not problem.base or plausible(fit):
        return [fit]
    return [fit, problem.unmoved(problem.nominal, Model(problem.shared))]


def _best_of_each(found: Sequence[Explained]) -> list[Explained]:
    """Return explanations, best first, only the best of those with the same parts."""
    return list({tuple(map(_name, e.parts)): e for e in reversed(found)}.values())[::-1]


def _promising(problem: Problem, fit: Fit) -> list[Part]:
    """Return the laws and the effects of the library that a screen at a fit finds most promising."""
    found = screened_laws(fit, laws_of(fit), LOOSE.stiffness)
    least = max(CRITERIA.proof, CRITERIA.hopeless * found[0].gain) if found else CRITERIA.proof
    laws = [Part.of(f) for f in found if allowed(f) and f.gain > least]
    effects = []
    for score in likely(screened(fit, LOOSE.stiffness), CRITERIA.beside, CRITERIA.promise):
        key = score.start.key
        variables = tuple(effect_variables(key, scaled(score.start, score.amplitude), problem.crane.layout))
        effects.append(Part(key, variables, np.array([v.begin for v in variables])))
    return [*laws[: CRITERIA.screened], *effects]


def _sound(e: Explained) -> bool:
    """Whether all curves have the sign that physics asks of them."""
    for part in e.laws:
        assert part.law is not None
        y, std = e.spread(part)
        astray = (part.law.neutral - y) - CRITERIA.astray * std
        if part.law.one_sided and (astray > CRITERIA.below * np.abs(y - part.law.neutral).max()).any():
            return False
    return True


def _predicts(problem: Problem, before: Explained, after: Explained, notes: list[str]) -> bool:
    """Whether a law gains on blocks of time that were left out what it should, and leaves little enough."""
    outside, inside = left_out_gain(problem.crane, problem.shared, before, after, BLOCK)
    if outside > CRITERIA.predicts * inside:
        return True
    law = after.laws[-1]
    notes.append(
        f"{law.key} would gain {inside:.0f} units of log-likelihood where it was fitted, but {outside:.0f} on blocks "
        "left out: it does not predict"
    )
    return False


def _refined(problem: Problem, best: Explained) -> Explained:
    """Return the explanation with curves that end where they are known, and with more knots where they bend if that is
    better supported.
    """
    narrow = {p.key: p.law.narrowed(*best.spread(p)) for p in best.laws if p.law is not None}
    if any(narrow[p.key] is not p.law for p in best.laws):
        best = _reknotted(problem, best, narrow)
    closer = {p.key: p.law.refined(best.curve(p)[0]) for p in best.laws if p.law is not None}
    found = _reknotted(problem, best, closer)
    return found if found.evidence > best.evidence else best


def _reknotted(problem: Problem, best: Explained, laws: Mapping[str, Law]) -> Explained:
    """Return the explanation fitted again with its laws at other knots."""
    parts = [p if p.found is None else Part.of(p.found.reknotted(laws[p.key], best.curve(p)[0])) for p in best.parts]
    return _with_curves(problem, best, parts)


def _along_forms(problem: Problem, best: Explained) -> Explained:
    """Return the explanation with each curve that resembles a simple form moving along that alone, where the data do
    not say otherwise.

    A form has two or three numbers where a curve has twenty, and goes on where the recording did not go.
    """
    for part in best.laws:
        form = _form(problem, best, part)
        if part.law is None or part.found is None or form.law is None:
            continue
        law = part.law.along(form.at)
        y, root = form.at(law.x), form.moves(law.x)
        if law.over.from_zero:  # nothing acts there
            y[0], root[0] = 0.0, 0.0
        parts = [Part.along(p.found, law, y, root) if p is part and p.found is not None else p for p in best.parts]
        found = _with_curves(problem, best, parts)
        if found.evidence > best.evidence - CRITERIA.tie and _sound(found):
            best = found
    return best


def _with_curves(problem: Problem, best: Explained, parts: Sequence[Part]) -> Explained:
    """Return the explanation fitted again with other curves for its laws."""
    keys = {p.key for p in best.laws}
    shared = [i for i, v in enumerate(best.fit.variables) if getattr(v, "key", "") not in keys]
    before = replace(best.fit, variables=tuple(best.fit.variables[i] for i in shared), u=best.fit.u[shared])
    return explain(problem.crane, problem.data, problem.shared, before, parts, (STIFF,))


def _lean(problem: Problem, best: Explained) -> Explained:
    """Return the explanation with the fewest moved parameters, or the one with all where that is better supported."""
    held: list[Variable] = [v for v in problem.shared if not isinstance(v, NominalDirection)]
    bare = explain(problem.crane, problem.data, held, best.fit, best.parts, (STIFF,))
    tried, let_go = [best, bare], needed(problem.crane, bare.fit, CRITERIA.freed)
    if let_go:
        tried.append(explain(problem.crane, problem.data, [*held, *let_go], best.fit, best.parts, (STIFF,)))
    return max(tried, key=lambda e: e.evidence)


def _concluded(
    problem: Problem,
    nothing: Explained,
    best: Explained,
    rivals: Sequence[Explained],
    check: Recording | None,
    notes: list[str],
) -> Learned:
    """Return what was learned, with errors on both recordings; nothing, where the check recording says otherwise."""
    given = Learned(problem.data.name, problem.crane, problem.crane)
    unchanged = _with_errors(given, nothing, problem, check)
    if not best.laws:
        if best.parts:
            names = ", ".join(p.key for p in best.parts)
            notes.append(f"effects of the library do as well: {names}. Go on with `patu diagnose`")
        elif best.weighed.good and unchanged.error_before > CRITERIA.level:
            notes.append("nominal parameters within their uncertainty explain it. Go on with `patu diagnose`")
        return replace(unchanged, notes=tuple(notes))
    lean = _lean(problem, _along_forms(problem, _refined(problem, best)))
    evidence, keys = lean.evidence - nothing.evidence, [p.key for p in lean.laws]
    found = lean.fit.crane
    for part in lean.laws:
        assert part.law is not None
        found = found.with_effect(part.key, part.law.values(part.law.physical(*lean.spread(part))))
    learned = replace(
        given, crane=added(problem.crane, found, recording=problem.data.name, evidence=evidence, learned=keys)
    )
    learned = _with_errors(learned, lean, problem, check, unchanged)
    after, before = learned.check_error_after, learned.check_error_before
    if misled(before, after):
        names = " and ".join(_name(p) for p in best.parts)
        notes.append(f"{names} explains the recording, but not the check recording (error {before:.3g} -> {after:.3g})")
        return replace(unchanged, notes=tuple(notes))
    ties = [e for e in rivals if e is not best and e.evidence > best.evidence - CRITERIA.tie and _sound(e)]
    telling = problem.telling(best.fit.crane, ties[0].fit.crane) if ties else ""
    laws = tuple(_told(problem, lean, p, _names(best, ties), lean.evidence - nothing.evidence) for p in lean.laws)
    effects = tuple(p.key for p in lean.parts if p.law is None)
    return replace(learned, laws=laws, effects=effects, next_manoeuvre=telling, notes=tuple(notes))


def _names(best: Explained, ties: Sequence[Explained]) -> tuple[str, ...]:
    """Return what is tied, the parts in which it differs from the best: "learned_force@lift over speed" or an effect of
    the library.
    """
    own = {_name(p) for p in best.parts}
    return tuple(" + ".join(n for n in map(_name, e.parts) if n not in own) for e in ties)


def _name(part: Part) -> str:
    if part.law is None:
        return part.key
    kind = (
        ""
        if len(part.law.over.against) < 2 or part.law.against == part.law.over.against[0]
        else (" against motion" if part.law.against else " as a spring")
    )
    return f"{part.key} over {part.law.over.name}{kind}"


def _told(problem: Problem, e: Explained, part: Part, tied: tuple[str, ...], evidence: float) -> LearnedLaw:
    law = part.law
    assert law is not None
    curve = registry.split_key(law.key)[0].curve
    assert curve is not None
    knots = law.x, law.physical(*e.spread(part))
    x, y, cov = e.told(part)
    std = np.sqrt(np.maximum(np.diag(cov), 0.0))
    y = replace(law, x=x, told=None).physical(y, std)
    form = _form(problem, e, part)
    text = form.text + (f", which is {form.library}" if form.library else "")
    return LearnedLaw(
        law.key, law.over.name, unit_over(law, problem.crane.layout), curve.unit, x, y, std,
        law.against, text, tied, evidence, knots, law, form,
    )  # fmt: skip


def _form(problem: Problem, e: Explained, part: Part) -> Resemblance:
    """Return the simple form that a fitted curve resembles."""
    law = part.law
    assert law is not None
    curve = registry.split_key(law.key)[0].curve
    assert curve is not None
    x, y, cov = e.told(part)
    known = replace(law, x=x, told=None)
    y = known.physical(y, np.sqrt(np.maximum(np.diag(cov), 0.0)))
    over = replace(law.over, unit=unit_over(law, problem.crane.layout))
    return resembles(x, y, cov, over, curve.unit, law.key, law.against)


def _with_errors(
    found: Learned, e: Explained, problem: Problem, check: Recording | None, before: Learned | None = None
) -> Learned:
    """Add open-loop errors of its crane on all recordings; those of the crane as given are the same, or those of
    `before`.
    """
    recordings, own = problem.recordings, problem.data.own
    tasks: list[tuple[Any, ...]] = []
    for i, r in enumerate(recordings):
        fit = None if found.crane is found.given else e.fit.of(i)
        crane = found.crane if fit is None else found.crane.with_parameters({n: fit.crane[n] for n in own})
        tasks.append((run_error, crane, r, fit, own))
    tasks += [(run_error, found.crane, check, None, own)] if check is not None else []
    errors = in_parallel(problem.jobs, tasks)
    error = together(recordings, errors[: len(recordings)])
    checked = errors[-1] if check is not None else math.nan
    first = before or replace(found, error_before=error, check_error_before=checked)
    return replace(
        found, error_before=first.error_before, error_after=error,
        check_error_before=first.check_error_before, check_error_after=checked,
    )  # fmt: skip
