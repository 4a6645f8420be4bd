"""A quick look at every effect: how much of the misfit would it explain, if it acted in proportion to its term?

Along the trajectory of a fitted model, each effect at each place (with typical parameters) adds a known term to one
balance. The response of all outputs to that term is linear in its amplitude, so one sweep and some linear algebra tell,
for all of them at once, how much the cost would fall, with the nominal parameters and the states free to move as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from crane_exudyn.effects.registry import split_key
from crane_exudyn.geometry import chamber_lengths

from ..criteria import CRITERIA
from ..fit.columns import Columns, Probes, pack
from ..fit.data import FitData
from ..fit.linear import linearised
from ..fit.model import Model, model_of
from ..fit.solve import Fit, Reduced, reduce, with_prior
from ..workers import single_threaded
from .moves import Start, around, moment_of, of_typical_size, sizes, starts

#: hooks by which oil or a mount gets softer, thousandfold perhaps: no slope tells what follows, only a run of the
#: softer machine, since a little of it has nearly the whole effect
_SOFTENS = {"free_gas", "series_compliance"}


@dataclass(frozen=True)
class Score:
    """What a start promises: the fall of the cost (log-likelihood, tempered) and the amplitude at which it is
    reached.
    """

    start: Start
    gain: float
    amplitude: float


@dataclass(frozen=True)
class Projected:
    """Hessian H (n, n) and gradient g (n,) of the cost by probes, all else free; alone (n,): diagonal of H, all else
    held.
    """

    H: np.ndarray
    g: np.ndarray
    alone: np.ndarray


def screen(fit: Fit, starts: Sequence[Start], stiffness: float) -> list[Score]:
    """Return the score of every start at a fit, best first; a start that changes nothing scores 0."""
    room = len(fit.crane.layout.all_states) - fit.knots.shape[1]  # for a pendulum
    by_run = np.array([_softens(s) or _stops(s) for s in starts], dtype=bool)

    def probes(base: Model, data: FitData, recording: int) -> Columns:
        models = [model_of(base.crane.with_effect(s.key, s.values), data, base.late, base) for s in starts]
        columns = pack(base, models, np.ones(len(models)))
        return replace(columns, by_run=columns.by_run | by_run)

    found = projected(fit, np.pad(fit.knots, ((0, 0), (0, room))), probes, stiffness)
    if found is None:
        return [Score(s, 0.0, 1.0) for s in starts]
    rows = zip(starts, found.g, np.diag(found.H), found.alone, strict=True)
    return sorted((_score(*row) for row in rows), key=lambda s: -s.gain)


def screened(fit: Fit, stiffness: float) -> list[Score]:
    """Return the screen of all starts at a fit, best first; of what happens at a moment only the moments that promise
    more than those beside them, of which the best two of an effect are looked at more closely.

    A machine that rings has a minimum of its cost once a period: the fit finds only the one where it begins. While a
    machine rests, many moments promise alike.
    """
    found = tops(screen(fit, starts(fit.crane, fit.data), stiffness))
    closer = [(top, more) for top in _leading(found) if (more := around(top.start))]
    if not closer:
        return found
    seen = screen(fit, [start for _, more in closer for start in more], stiffness)
    best = [max(top, *(s for s in seen if s.start in more), key=_gain) for top, more in closer]
    rest = [s for s in found if all(s is not top for top, _ in closer)]
    return sorted([*rest, *best], key=_gain, reverse=True)


def _gain(score: Score) -> float:
    return score.gain


def tops(scores: Sequence[Score]) -> list[Score]:
    """Return the scores, of effects with a moment those that promise at least as much as the moments beside them."""
    found, timed = list[Score](), dict[str, list[tuple[float, Score]]]()
    for score in scores:
        moment = moment_of(score.start)
        if moment is None:
            found.append(score)
        else:
            timed.setdefault(score.start.key, []).append((moment, score))
    for own in timed.values():
        ordered = [score for _, score in sorted(own, key=lambda pair: pair[0])]
        gains = [-np.inf, *map(_gain, ordered), -np.inf]
        found += [s for k, s in enumerate(ordered) if s.gain >= max(gains[k], gains[k + 2])]
    return sorted(found, key=_gain, reverse=True)


def _leading(scores: Sequence[Score]) -> list[Score]:
    """Return the best two starts of each effect that promises something, the second where it promises nearly as much;
    best first.
    """
    best = {score.start.key: score for score in best_starts(scores)}
    seconds = best_starts([s for s in scores if s is not best.get(s.start.key)])
    rivals = [s for s in seconds if s.gain > CRITERIA.twice * best[s.start.key].gain]
    return sorted([*best.values(), *rivals], key=_gain, reverse=True)


def _softens(start: Start) -> bool:
    return bool(_SOFTENS & set(split_key(start.key)[0].hooks()))


def _stops(start: Start) -> bool:
    """Whether an effect stops a cylinder: along a run that goes through the stop no slope tells its force, which is as
    large as it must be.
    """
    return split_key(start.key)[0].beyond_stroke


def unseen(fit: Fit) -> list[Start]:
    """Return starts of the effects that soften, each in all of its shapes and of the size that is met in practice:
    where parameters stand for it already, not even a run tells what follows, only a fit.
    """
    every = filter(_softens, starts(fit.crane, fit.data))
    found = [Start(s.key, of_typical_size(s.key, s.values)) for s in every]
    return [s for i, s in enumerate(found) if s not in found[:i]]


def stopping(fit: Fit) -> list[Start]:
    """Return starts of what stops a cylinder, where windows of a fit begin beyond its stroke: first states stand for a
    stop there, a void that pulls, say, and no look from these tells of it.
    """
    crane, lay = fit.crane, fit.crane.layout
    lengths = chamber_lengths(crane, fit.knots[:, lay.positions])
    short = lengths.min(axis=0) < 0.0
    long = lengths.max(axis=0) > [high - low for low, high in map(crane.stroke, lay.cylinders)]
    beyond = {c for c, past in zip(lay.cylinders, short | long, strict=True) if past}
    return [s for s in starts(crane, fit.data) if _stops(s) and split_key(s.key)[1] in beyond]


def best_starts(scores: Sequence[Score]) -> list[Score]:
    """Return the best score of each effect that promises something; both best first."""
    best: dict[str, Score] = {}
    for score in scores:
        if score.gain >= CRITERIA.promise:
            best.setdefault(score.start.key, score)
    return list(best.values())


def likely(scores: Sequence[Score], most: int, least: float) -> list[Score]:
    """Return the best scores: at most two starts of one effect at one place, and none that promises less than `least`,
    or next to nothing; all where a slope tells that there is one and not which: of a stop, which a run has gone
    through, and of what cannot be scaled to the size that the screen asks for.
    """
    chosen: list[Score] = []
    for score in scores:
        hopeless = len(chosen) >= CRITERIA.sure and score.gain < CRITERIA.hopeless * scores[0].gain
        if score.gain < least or len(chosen) == most or hopeless:
            break
        most_of_one = 2 if score.gain > CRITERIA.twice * scores[0].gain else 1
        same = [c.start for c in chosen if c.start.key == score.start.key]
        if len(same) < most_of_one:
            chosen.append(score)
    unsized = {c.start.key for c in chosen if _stops(c.start) or (c.amplitude > 1.0 and not sizes(c.start.key))}
    return [*chosen, *(s for s in scores if s.start.key in unsized and s not in chosen)]


@single_threaded()
def projected(fit: Fit, knots: np.ndarray, probes: Probes, stiffness: float) -> Projected | None:
    """Return the normal equations of probes at a fit, with all that the fit moves projected out; None where the model
    failed.
    """
    linear, knots = linearised(fit.origin, fit.data, fit.windows, knots, fit.variables, fit.u, stiffness, probes)
    reduced, m = reduce(linear, knots, knots), len(fit.u)
    if reduced is None:
        return None
    H, g = reduced.H, reduced.g
    if not m:
        return Projected(H, g, np.diag(H))
    own = Reduced(H[:m, :m], g[:m], np.empty(0), np.empty(0))
    A, b = with_prior(own, fit.variables, fit.u)
    cross = np.linalg.lstsq(A, np.column_stack([H[:m, m:], b]), rcond=None)[0]
    return Projected(H[m:, m:] - H[m:, :m] @ cross[:, :-1], g[m:] - H[m:, :m] @ cross[:, -1], np.diag(H)[m:])


def _score(start: Start, slope: float, bend: float, alone: float) -> Score:
    """Return what a probe promises whose cost has that slope and bend (`alone`: before anything was projected out)."""
    if not bend > 1e-9 * max(alone, 1e-12) or not np.isfinite(slope):
        return Score(start, 0.0, 0.0)
    amplitude = -slope / bend
    limited = np.clip(abs(amplitude), CRITERIA.smallest, CRITERIA.largest) * np.sign(amplitude)
    if limited < 0.0 and not start.two_sided:
        return Score(start, 0.0, CRITERIA.smallest)
    gain = -(slope * limited + 0.5 * bend * limited**2)
    return Score(start, float(max(gain, 0.0)), 1.0 if _stops(start) else float(limited))
