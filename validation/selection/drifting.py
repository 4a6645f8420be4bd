"""The search where something is always left, because many effects are missing or none is quite the machine's: the
errors of a wrong model drift and ring, and thousands of such samples are not thousands of proofs.

Error levels follow the model (`levels`), so that a round's models share those of the best that it goes on from; windows
are two seconds long, all but joined, so that a ring dies out or a drift shows in them; and models are ranked by
open-loop runs, also over the last part of each recording, which is not fitted before the end (`whole_runs`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest

from ..criteria import CRITERIA
from ..fit.data import Data
from ..fit.solve import Fit, fit
from ..fit.staged import SHORT, Stage, all_parameters, first_knots, informed_directions
from ..fit.variables import CurveDirection, EffectParameter, stated_effects
from ..fit.windows import cut
from ..workers import in_parallel
from .levels import Levels, levels_of
from .model import Fitted, Model, at_bound, best_of_each, effects_of, fitted
from .moves import scaled, starts
from .proven import Proven, proven
from .screen import best_starts, screen
from .search import Move, Path, Problem, Progress, Regime, Round, Stages
from .whole_runs import Standing, Taken, first_part, joined, judged, loose, run, typical


@dataclass(frozen=True)
class DriftingPath(Path[Standing]):
    """The path of a search; `tried` of a round with the error levels of the round, `done` with those that it leaves.

    `proven`: the crane with all effects that are worth it; None where none is.
    """

    proven: Proven | None = None

    @cached_property
    def served(self) -> tuple[Standing, tuple[Standing, ...]]:
        """The best model, and those of its round that are as likely; none where no round served."""
        best, last = self.parameters, tuple[Standing, ...]()
        for r in self.rounds:
            if r.done and r.tried[0].serves(best):
                best = r.done[0]
                last = tuple(one for one in r.done if one.evidence > best.evidence - CRITERIA.proof)
        return best, last


def _begun(problem: Problem) -> DriftingPath:
    """Return the path before its first round: nominal parameters fitted, levels of the channels found."""
    crane = problem.crane
    learned = first_part(problem.data)
    base = all_parameters(crane, learned, loose(5))
    problem = replace(problem, told=(*informed_directions(base), *stated_effects(crane)))
    raised = Levels({c: max(1.0, e) for c, e in base.errors.items()}).raised(learned)
    nominal = fitted(crane, raised, Model(problem.shared), base, joined(8))
    now = Standing(nominal.model, nominal.fit, nominal.loose, Levels(dict.fromkeys(base.errors, math.inf)))
    return DriftingPath(problem, _relevelled(problem, [now])[0])


def _beam(path: DriftingPath, most: int) -> Sequence[Standing]:
    """Return the models of the last round; learning from all of each recording, where the first of them leaves only
    noise in what it learned from: what is still missing shows in the rest alone.
    """
    beam = path.rounds[-1].done if path.rounds else (path.parameters,)
    if len(path.rounds) == min(most, CRITERIA.rounds):
        return ()
    if beam[0].unseen is not None or beam[0].left[0] > CRITERIA.gained:
        return beam
    problem = path.problem
    return _relevelled(problem, in_parallel(problem.jobs, [(_on_all, problem, now) for now in beam]))


def _on_all(problem: Problem, now: Standing) -> Standing:
    near = now.extended(problem)
    found = replace(now.fit, data=near.data, windows=near.windows, knots=near.knots)
    return replace(now, fit=found, levels=Levels(dict.fromkeys(now.levels.of, math.inf)), unseen=now.errors[1])


def _relevelled(problem: Problem, found: Sequence[Standing]) -> list[Standing]:
    """Return models with the channels' levels as the first of them leaves them, never higher than before, all fitted
    again and judged.
    """
    levels = levels_of(found[0].fit, found[0].learned(problem), found[0].levels.of)
    return in_parallel(problem.jobs, [(_at, problem, now, levels) for now in found])


def _at(problem: Problem, now: Standing, levels: Levels) -> Standing:
    """Return a model fitted with other levels, by way of one open-loop run: slow drifts do not show in windows of two
    seconds.
    """
    data = levels.raised(now.learned(problem))
    long = _carried(problem, now.keys, data, now.fit, run(6))
    near = replace(long, knots=now.fit.knots, windows=now.fit.windows)  # its parameters, where the windows stand
    again = _carried(problem, now.keys, data, near, joined(6))
    return replace(now, fit=again, loose=again, levels=levels, errors=judged(problem, again))


def _carried(
    problem: Problem, keys: Sequence[str], data: Data, before: Fit, stages: Stages, held: Sequence[str] = ()
) -> Fit:
    """Return a fit that goes on from another; effects that would become inactive are held as they were before.

    Where everything moves at once, parameters may slide into a valley in which an effect that was found before does
    nothing. Another effect is to come in addition to it.
    """
    effects = effects_of(before.crane, keys)
    crane = problem.crane.changed({}, {k: effects[k] for k in held})
    model = Model(problem.shared, {k: values for k, values in effects.items() if k not in held})
    found = fitted(crane, data, model, before, stages).fit
    inactive = [k for k in model.keys if _neutral(found, k)]
    return _carried(problem, keys, data, before, stages, (*held, *inactive)) if inactive else found


def _neutral(found: Fit, key: str) -> bool:
    """Whether an effect that a fit moves has gone where it does nothing."""
    return not any(isinstance(v, CurveDirection) and v.key == key for v in found.variables) and all(
        abs(u - v.neutral) < CRITERIA.at_end
        for v, u in zip(found.variables, found.u, strict=True)
        if isinstance(v, EffectParameter) and v.key == key and not v.parameter.shape
    )


def _likely(path: DriftingPath, beam: Sequence[Standing]) -> list[Move]:
    """Return what to try beside each model of a beam."""
    problem = path.problem
    begins = in_parallel(problem.jobs, [(_promising, problem, now) for now in beam])
    return [
        Move(Model(problem.shared, now.effects | {key: values}), now.fit)
        for now, own in zip(beam, begins, strict=True)
        for key, values in own.items()
    ]


def _promising(problem: Problem, now: Standing) -> dict[str, Mapping[str, float]]:
    """Return what to try beside a model: the best of a screen in long windows, the best of one in short windows that
    follow the machine, and what was demanded before.

    The long ones show what adds up; in the short ones a chamber that the model takes for stiff still stands where the
    machine's stands, so that an effect that changes all from there on (air) is seen at all.
    """
    begins = starts(now.fit.crane, now.learned(problem))
    looks = (now.fit, CRITERIA.joined), (_following(problem, now), 1.0)
    best = [best_starts(screen(f, begins, stiffness)) for f, stiffness in looks]
    chosen: dict[str, Mapping[str, float]] = {}
    for score in (s for pair in zip_longest(*best) for s in pair if s is not None):
        if len(chosen) < CRITERIA.tried:
            chosen.setdefault(score.start.key, scaled(score.start, score.amplitude))
    return chosen | dict(now.asked)


def _following(problem: Problem, now: Standing) -> Fit:
    """Return the current model in short, loosely joined windows, with the error levels that it has there."""
    learned = data = now.learned(problem)
    knots = first_knots(now.fit.crane, data, SHORT)
    for _ in range(2):
        windows = cut(data, SHORT)
        found = fit(problem.crane, data, windows, knots, now.fit.variables, now.fit.u, stiffness=1.0, iterations=2)
        data = levels_of(found, learned).raised(learned)
    return replace(found, data=data, windows=tuple(cut(data, SHORT)))


def _tried(path: DriftingPath, beam: Sequence[Standing], moves: Sequence[Move]) -> list[Standing]:
    """Return models with one effect more that the data demand, at least half as much as the first beside the same
    model.

    Each begins in three ways: where the model that it grows from stands, and anew in long windows and in short ones. In
    long windows a ring has a false minimum a period, in short ones what adds up slowly is not seen, and may be lost; in
    both, what was found before. The best is carried to the end, if it has a chance.
    """
    problem = replace(path.problem, data=beam[0].fit.data)
    models = list({frozenset(m.model.keys): m.model for m in reversed(moves)}.values())
    begun = [
        *problem.run(moves, joined(CRITERIA.begun)),
        *_anew(problem, models, CRITERIA.window, joined(CRITERIA.begun)),
        *_anew(problem, models, SHORT, (*loose(3), *joined(CRITERIA.begun))),
    ]
    going_on = problem.further(_sifted(beam, begun), joined(CRITERIA.ended))
    ended = {frozenset(w.keys): w for w in going_on if _acting(w)}
    children = []
    for now in beam:
        own = [m.model.keys for m in moves if m.model.keys[:-1] == now.keys]
        children += _demanded(now, {keys: ended[frozenset(keys)] for keys in own if frozenset(keys) in ended})
    return children


def _sifted(beam: Sequence[Standing], begun: Sequence[Fitted]) -> list[Fitted]:
    """Return of each model the best of its fits so far, one in which all effects act before one in which they do not;
    no models that have brought far less than the best beside the same one.
    """
    best = {frozenset(w.keys): w for w in sorted(begun, key=lambda w: (_acting(w), w.evidence))}
    kept = dict[frozenset[str], Fitted]()
    for now in beam:
        gains = {k: w.evidence - now.evidence for k, w in best.items() if k > set(now.keys)}
        least = CRITERIA.chance * max(gains.values(), default=0.0)
        kept |= {k: best[k] for k, gain in gains.items() if gain >= least}
    return list(kept.values())


def _anew(problem: Problem, models: Iterable[Model], seconds: float, stages: Sequence[Stage]) -> list[Fitted]:
    """Return models fitted from the crane as given, each effect of the size that is met in practice.

    Where earlier effects have gone far to do the work of one that was missing, no step leads from there to what they
    are beside it.
    """
    moves = []
    for m in models:
        crane = typical(problem.crane, m.effects)
        knots = first_knots(crane, problem.data, seconds)
        moves.append(Move(Model(problem.shared, effects_of(crane, m.keys)), knots))
    return problem.run(moves, stages)


def _acting(w: Fitted) -> bool:
    """Whether all effects act, the last one within its bounds: else it is a model with fewer, or none."""
    return not at_bound(w.fit, w.keys[-1]) and not any(_neutral(w.fit, key) for key in w.keys)


def _demanded(now: Standing, fits: Mapping[tuple[str, ...], Fitted]) -> list[Standing]:
    """Return a model with each effect that the data demand beside it, at least half as much as the first."""
    found = {keys[-1]: w for keys, w in sorted(fits.items(), key=lambda item: -item[1].evidence)}
    gains = {key: w.evidence - now.evidence for key, w in found.items()}
    serious = max(CRITERIA.demanded, CRITERIA.serious * max(gains.values(), default=0.0))
    demanded = {k: found[k].values(k) for k, gain in gains.items() if gain > CRITERIA.demanded}
    children = []
    for key, gain in gains.items():
        if gain >= serious:
            w, rivals = found[key], {k: g for k, g in gains.items() if k != key}
            model = Model(w.model.variables, effects_of(w.fit.crane, (*now.keys, key)))
            children.append(replace(
                now, model=model, fit=w.fit, loose=w.loose, taken=(*now.taken, Taken(key, gain, rivals)),
                asked={k: values for k, values in demanded.items() if k != key},
            ))  # fmt: skip
    return children


def _judged(path: DriftingPath, beam: Sequence[Standing], tried: Sequence[Standing]) -> Round[Standing]:
    """Return the round: at most as many models as a beam holds, those whose whole runs are best, with the levels that
    they leave.

    Whole runs must fall against the model that one grew from, and below those of the best model with fewer effects,
    over what was learned from and what was not: windows tell what is at work, but not whether it adds up over a whole
    run, and what merely imitates the cause predicts worse.
    """
    problem, (best, _) = path.problem, path.served
    errors = in_parallel(problem.jobs, [(judged, problem, one.fit) for one in tried])
    parents = {now.keys: now for now in beam}
    ran = [(parents[one.keys[:-1]], replace(one, errors=e)) for one, e in zip(tried, errors, strict=True)]
    leading = _leading([one for now, one in ran if one.fall(now) > now.worth and one.fall(best) > 0.0], best)
    return Round(tuple(leading), tuple(_relevelled(problem, leading) if leading else ()))


def _leading(found: Sequence[Standing], before: Standing) -> list[Standing]:
    """Return the models whose whole runs are best, as many as a beam holds; where they differ by less than counts as a
    fall, the evidence decides.
    """
    left, leading = best_of_each(found), list[Standing]()
    while left and len(leading) < CRITERIA.beam:
        most = max(one.fall(before) for one in left)
        first = next(i for i, one in enumerate(left) if one.fall(before) >= most - before.worth)
        leading.append(left.pop(first))
    return leading


def _after(path: DriftingPath, found: Round[Standing]) -> DriftingPath:
    return replace(path, rounds=(*path.rounds, found))


def _gained(path: DriftingPath) -> bool:
    """Whether the last round found anything, and more than noise is left to explain."""
    return bool(path.rounds[-1].done) and sum(path.served[0].left) > CRITERIA.gained


def _finished(path: DriftingPath, most: int, progress: Progress) -> DriftingPath:
    """Return the path with the best of what the last round that served left, fitted to whole runs."""
    _, last = path.served
    if not last:
        return path
    return replace(path, proven=proven(path.problem, last, path.parameters.errors[1], most, progress))


DRIFTING = Regime(_begun, _beam, _likely, _tried, _judged, _after, _gained, _finished)
