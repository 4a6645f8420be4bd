"""Laws that nobody wrote: in which balance a machine lacks something, where, over what it runs, and its curve."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects import registry
from crane_exudyn.recording import Recording

from .criteria import CRITERIA
from .diagnosis import OneRecording, loaded, looked_at
from .fit.staged import STIFF, TIGHT
from .history import added, moved_in_words, with_errors
from .learned.fits import laws_of, refined, spread, tabulated, with_curves
from .learned.laws import unit_over
from .learned.learned_law import LearnedLaw
from .learned.regime import LEARNING, LearningPath, named, sound
from .learned.resembles import Resemblance, as_large, resembles
from .selection.lean import leaner
from .selection.levels import noise_level
from .selection.model import Fitted, misled, run_error, together
from .selection.moves import starts
from .selection.search import Move, Problem, Progress, search, silent
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
    laws = (
        f"{law.effect} over {law.over.replace('_', ' ')}" + (f" ({law.resembles})" if law.resembles else "")
        for law in found.laws
    )
    return f"found {' and '.join(laws)}: error {found.error_before:.3g} -> {found.error_after:.3g} noise units"


def learn(
    crane: Crane | str | Path,
    recordings: OneRecording | Sequence[OneRecording],
    check: OneRecording | None = None,
    *,
    per_recording: Sequence[str] = (),
    jobs: int = 2,
    progress: Progress = silent,
) -> Learned:
    """Return the laws that recordings show and that neither the crane nor the library has; none where the library's do
    as well.

    Args:
        crane: the crane, or a name or file; effects that it has stay, and are fitted along.
        recordings: commands and sensors, or their files, of one run or of several of one machine.
        check: another recording of the same machine, which is only predicted.
        per_recording: nominal parameters that differ from recording to recording.
        jobs: processes to use.
        progress: called with a text and the share that is done.

    Raises:
        CraneError: the recording cannot support it.
    """
    began = time.perf_counter()
    crane, known, checked = loaded(crane, recordings, check)
    problem, notes = looked_at(crane, known, checked, per_recording, jobs, progress)
    path = search(LEARNING, problem, CRITERIA.laws, progress)
    progress("weighing", 0.85)
    return replace(_concluded(path, checked, [*notes, *path.notes]), seconds=time.perf_counter() - began)


def _along_forms(problem: Problem, best: Fitted) -> Fitted:
    """Return the model with each curve that resembles a simple form moving along that alone, where the data do not say
    otherwise.

    A form has two or three numbers where a curve has twenty, and goes on where the recording did not go.
    """
    for key in laws_of(best):
        formed = _along_form(problem, best, key)
        if formed is not None and formed.evidence > best.evidence - CRITERIA.tie and sound(formed):
            best = formed
    return best


def _along_form(problem: Problem, best: Fitted, key: str) -> Fitted | None:
    """Return the model with one curve moving along the form that it resembles, None where it resembles none.

    Where a form bends follows from a curve with knots on either side only roughly, and a curve moves along the slopes
    that a form has there. So what the fit comes to is taken for a form again, until that is the same.
    """
    law, tried, texts = laws_of(best)[key].law, [best], set[str]()
    while len(texts) < CRITERIA.formed:
        form, curves = _form(problem, tried[-1], key), laws_of(tried[-1])
        if form.law is None or form.text in texts:
            break
        texts.add(form.text)
        along = law.along(form.at)
        y, root = form.at(along.x), form.moves(along.x)
        if law.over.from_zero:  # nothing acts there
            y[0], root[0] = 0.0, 0.0
        tried.append(with_curves(problem, tried[-1], {**curves, key: curves[key].along(along, y, root)}))
    return max(tried[1:], key=lambda w: w.evidence, default=None)


def _by_name(problem: Problem, best: Fitted) -> Fitted:
    """Return the model with effects of the library in place of laws that resemble theirs, where these do as well: the
    screen may not have offered them.
    """
    for key in laws_of(best):
        form = _form(problem, best, key)
        named = form.library
        if not named or problem.crane.effect(named) is not None:
            continue
        found = best.as_found
        rest = {k: values for k, values in found.effects.items() if k != key}
        curves = {k: curve for k, curve in found.curves.items() if k != key}
        values = [s.values for s in starts(problem.crane, problem.data) if s.key == named]
        values += [as_large(form, named, v) for v in values[:1]]
        models = [replace(found, effects={**rest, named: v}, curves=curves) for v in values]
        tried = problem.run([Move(model, best.fit) for model in models], (TIGHT, STIFF))
        if tried and tried[0].evidence > best.evidence - CRITERIA.proof:
            best = tried[0]
    return best


def _concluded(path: LearningPath, check: Recording | None, notes: list[str]) -> Learned:
    """Return what was learned, with errors on both recordings; nothing, where the check recording says otherwise."""
    problem, nothing, best = path.problem, path.parameters, path.best
    given = Learned(problem.data.name, problem.crane, problem.crane)
    unchanged = _with_errors(given, nothing, problem, check)
    formed = _by_name(problem, _along_forms(problem, refined(problem, best))) if best.model.curves else best
    if not formed.model.curves:
        if formed.keys:
            names, (errors,) = ", ".join(formed.keys), problem.errors([formed.fit])
            notes.append(
                f"effects of the library explain it equally well: {names}. Continue with `patu diagnose`"
                if (left := together(problem.recordings, errors)) < CRITERIA.misled
                else f"no law explains more than {names}, which leaves {left:.3g} times the noise in a single run: "
                "neither the library nor a law over a state explains it"
            )
        elif best.good and unchanged.error_before > noise_level(problem.data):
            notes.append("nominal parameters within their uncertainty explain it. Continue with `patu diagnose`")
        return replace(unchanged, notes=tuple(notes))
    lean = leaner(problem.crane, problem.data, formed)
    evidence, laws = lean.evidence - nothing.evidence, laws_of(lean)
    found = lean.fit.crane
    for key, f in laws.items():
        found = found.with_effect(key, f.law.values(f.law.physical(*spread(lean, key))))
    learned = replace(
        given, crane=added(problem.crane, found, recording=problem.data.name, evidence=evidence, learned=[*laws])
    )
    learned = _with_errors(learned, lean, problem, check, unchanged)
    after, before = learned.check_error_after, learned.check_error_before
    if misled(before, after):
        notes.append(
            f"{named(best)} explains the recording, but not the check recording (error {before:.3g} -> {after:.3g})"
        )
        return replace(unchanged, notes=tuple(notes))
    with_account = with_errors(learned.crane, (learned.error_before, before), (learned.error_after, after))
    learned = replace(learned, crane=with_account)
    moved = moved_in_words(problem.crane, found)
    if moved:
        notes.append(f"changed with it: {moved}; a file of --write does not contain this")
    ties = [w for w in path.rivals if w.evidence > best.evidence - CRITERIA.tie and sound(w)]
    telling = problem.telling(best.fit.crane, ties[0].fit.crane) if ties else ""
    return replace(
        learned,
        laws=tuple(_learned_law(problem, lean, key, _others(best, ties), evidence) for key in laws),
        effects=tuple(key for key in lean.keys if key not in laws),
        next_manoeuvre=telling,
        notes=tuple(notes),
    )


def _others(best: Fitted, ties: Sequence[Fitted]) -> tuple[str, ...]:
    """Return what is tied, where it differs from the best: "learned_force@lift over speed" or an effect of the
    library.
    """
    own = set(best.names)
    return tuple(" + ".join(n for n in w.names if n not in own) for w in ties)


def _learned_law(problem: Problem, w: Fitted, key: str, tied: tuple[str, ...], evidence: float) -> LearnedLaw:
    law, curve = laws_of(w)[key].law, registry.split_key(key)[0].curve
    assert curve is not None
    knots = law.x, law.physical(*spread(w, key))
    x, y, cov = tabulated(w, key)
    std = np.sqrt(np.maximum(np.diag(cov), 0.0))
    y = replace(law, x=x, reported=None).physical(y, std)
    form = _form(problem, w, key)
    text = form.text + (f", which is {form.library}" if form.library else "")
    return LearnedLaw(
        law.key, law.over.name, unit_over(law, problem.crane.layout), curve.unit, x, y, std,
        law.against, text, tied, evidence, knots, law, form,
    )  # fmt: skip


def _form(problem: Problem, w: Fitted, key: str) -> Resemblance:
    """Return the simple form that a fitted curve resembles."""
    law, curve = laws_of(w)[key].law, registry.split_key(key)[0].curve
    assert curve is not None
    x, y, cov = tabulated(w, key)
    known = replace(law, x=x, reported=None)
    y = known.physical(y, np.sqrt(np.maximum(np.diag(cov), 0.0)))
    over = replace(law.over, unit=unit_over(law, problem.crane.layout))
    return resembles(x, y, cov, over, curve.unit, law.key, law.against)


def _with_errors(
    found: Learned, w: Fitted, problem: Problem, check: Recording | None, before: Learned | None = None
) -> Learned:
    """Add open-loop errors of its crane on all recordings; those of the crane as given are the same, or those of
    `before`.
    """
    recordings, own = problem.recordings, problem.data.own
    tasks: list[tuple[Any, ...]] = []
    for i, r in enumerate(recordings):
        fit = None if found.crane is found.given else w.fit.of(i)
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
