"""From short windows to one open-loop run: the way by which a fit finds its minimum without getting lost.

In short windows the model stays near the machine even when it lacks something, and the cost is nearly quadratic; the
long run has the full power of the data, and false minima. Each stage starts where the one before ended.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from crane_exudyn.crane import Crane

from ..criteria import BEGINS, CRITERIA
from ..workers import single_threaded
from .data import ACCURACY, ACCURATE, COARSE, FINE, Data, FitData
from .knots import begun_anew, reknot
from .linear import with_states
from .model import Model, model_of
from .solve import Fit, fit, reduce
from .start import knots_of
from .variables import EffectVariable, NominalDirection, Timing, Variable, principal, uncertain_parameters
from .windows import Window, cut

Simulate = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]

#: windows of the stages in s, and iterations; the last stage is one window (or windows of this length in very long
#: recordings)
SHORT, LONG = 0.25, 60.0


@dataclass(frozen=True)
class Stage:
    """Window length in s, expected smallness of jumps between windows, iterations, longest simulation step in s; how
    many seconds are looked at from where each long run begins; local error of a step, in units of the engine's.
    """

    seconds: float
    stiffness: float
    iterations: int
    step: float = COARSE
    reach: float = math.inf
    accuracy: float = ACCURACY

    def windows(self, data: Data) -> list[Window]:
        """Return its windows of a recording, or of several."""
        windows = cut(data, self.seconds)
        if math.isinf(self.reach):
            return windows
        begins = [(w.recording, float(w.data.time[0])) for w in cut(data, LONG)]
        return [w for w in windows if any(i == w.recording and self._reaches(t, w) for i, t in begins)]

    def _reaches(self, begin: float, window: Window) -> bool:
        return begin - self.seconds < window.data.time[0] < begin + self.reach


LOOSE, TIGHT, STIFF = Stage(SHORT, 1.0, 5), Stage(SHORT, 10.0, 5), Stage(SHORT, 100.0, 6, FINE)
STAGES = (LOOSE, TIGHT, STIFF)
WHOLE = Stage(LONG, 1.0, 6, FINE, accuracy=ACCURATE)
#: a crane as it is, its start alone looked for: what comes later than these seconds says nothing more of where it began
_BEGINNING = 4.0
START = (
    Stage(SHORT, 1.0, 3, reach=_BEGINNING), Stage(SHORT, 100.0, 4, FINE, _BEGINNING), replace(WHOLE, iterations=3),
)  # fmt: skip


def staged(
    crane: Crane,
    data: Data,
    variables: Sequence[Variable],
    u: np.ndarray,
    before: Fit | np.ndarray,
    stages: Sequence[Stage] = STAGES,
) -> Fit:
    """Return the fit after all stages, from variable values u and the knots of an earlier fit (or knots for the first
    stage).
    """
    return each_stage(crane, data, variables, u, before, stages)[-1]


def each_stage(
    crane: Crane,
    data: Data,
    variables: Sequence[Variable],
    u: np.ndarray,
    before: Fit | np.ndarray,
    stages: Sequence[Stage],
) -> list[Fit]:
    """Return the fit after each stage."""
    found = list[Fit]()
    for stage in stages:
        data = data.stepped(stage.step, stage.accuracy)
        windows, last = stage.windows(data), found[-1] if found else before
        knots = reknot(last, windows) if isinstance(last, Fit) else last
        u = found[-1].u if found else u
        knots = begun_anew(crane, data, windows, knots, variables, u, stage.stiffness)
        found.append(fit(
            crane, data, windows, knots, variables, u, stiffness=stage.stiffness,
            iterations=stage.iterations, before=found[-1] if found else None, keep=True,
        ))  # fmt: skip
        for earlier in found[:-1]:
            earlier.linear.swept = ()
    found[-1].linear.swept = ()
    return found


def first_knots(crane: Crane, data: Data, seconds: float = SHORT) -> np.ndarray:
    """Return guessed first states of windows of that length."""
    return np.concatenate([knots_of(crane, part, cut(part, seconds)) for part in data.parts])


def run_fitted(crane: Crane, data: FitData, variables: Sequence[Variable] = ()) -> Fit:
    """Return the fit of an open-loop run: the crane as it is but for the variables, its first state chosen to explain
    the recording best. Effects begin as large as their variables say, all else as the crane has it.

    Where nothing but the start and the clock is looked for, only the beginning is looked at before the run itself.
    """
    short = all(isinstance(v, Timing) for v in variables)
    stages = START if short else tuple(replace(s, reach=math.inf) for s in START)
    data = data.stepped(stages[0].step)
    knots = knots_of(crane, data, stages[0].windows(data))
    u = [v.begin if isinstance(v, EffectVariable) else 0.0 for v in variables]
    return staged(crane, data, variables, np.array(u), knots, stages)


@single_threaded()
def informed_directions(result: Fit) -> list[Variable]:
    """Return the combinations of nominal parameters that a fit of all of them found the data to speak about.

    The others stay at their nominal values: the data could not move them, so they need not be carried along. All of
    them where the model runs away.
    """
    nominal = [v for v in result.variables if isinstance(v, NominalDirection)]
    gaussian = [i for i, v in enumerate(nominal) if math.isfinite(v.prior) and v.recording is None]
    free = [v for i, v in enumerate(nominal) if i not in gaussian]
    reduced = reduce(result.linear, result.knots, result.knots)
    if reduced is None:
        return list(result.variables)
    others = [i for i in range(len(nominal)) if i not in gaussian]
    H = reduced.H[np.ix_(gaussian, gaussian)]
    if others:
        cross = reduced.H[np.ix_(gaussian, others)]
        H = H - cross @ np.linalg.pinv(reduced.H[np.ix_(others, others)], hermitian=True) @ cross.T
    values, vectors = np.linalg.eigh(0.5 * (H + H.T))
    keep = values / (1.0 + values) > CRITERIA.informed
    timing = [v for v in result.variables if isinstance(v, Timing)]
    return [*timing, *free, *principal([nominal[i] for i in gaussian], vectors[:, keep])]


def residuals(
    crane: Crane, data: FitData, starts: np.ndarray, late: float = 0.0, simulate: Simulate | None = None
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return per channel the sample times and the residuals in noise units of an open-loop run.

    Args:
        crane, data: the model and what it is held against.
        starts: first state (nx,), or (S, nx) of each stretch with known commands; where there are fewer, the others
            begin as measured.
        late: seconds by which the commands come after their stamps.
        simulate: (x0, time (n,), inputs (n, valves + 2)) -> states (n, nx); by default the semi-recursive engine.
    """
    model = model_of(crane, data, late)
    own = lambda x0, time, W: model.whole(x0, W, time, data.step)[0]  # noqa: E731
    X = _states(crane, data, model, np.atleast_2d(np.asarray(starts, dtype=float)), simulate or own)
    found = {}
    times = {id(s.index): data.times(s) for s in data.samples}
    for s in data.samples:  # one by one: all of ten minutes would be another hundred megabytes
        z = model.measurement((s.channel,)).shown(X, data.time)[:, 0]
        found[s.channel] = (times[id(s.index)], s.residuals(z))
    return found


def _states(crane: Crane, data: FitData, model: Model, starts: np.ndarray, simulate: Simulate) -> np.ndarray:
    """Return states (N, nx) that begin anew after each blind span, and stand still in it."""
    X = np.empty((len(data.time), starts.shape[1]))
    if len(starts) < len(data.stretches):
        begins = [Window(first, data.part(first, last)) for first, last in data.stretches[len(starts) :]]
        starts = np.concatenate([starts, with_states(knots_of(crane, data, begins), model.nx)])
    for x0, (first, last) in zip(starts, data.stretches, strict=False):
        X[first : last + 1] = simulate(x0, data.time[first : last + 1], model.W[first : last + 1])
        X[last + 1 :] = X[last]
    return X


def rms(parts: dict[str, tuple[np.ndarray, np.ndarray]]) -> float:
    """Return the root mean square over all samples of all channels."""
    return math.sqrt(sum(float(r @ r) for _, r in parts.values()) / sum(len(r) for _, r in parts.values()))


def timings(data: Data) -> list[Variable]:
    """Return the variables for the lateness of each recording's commands."""
    if isinstance(data, FitData):
        return [timing_of(data)]
    return [replace(timing_of(p), name=f"timing {i + 1}", recording=i) for i, p in enumerate(data.parts)]


def timing_of(data: FitData) -> Timing:
    """Return the variable for the commands' lateness: about a quarter of a sampling interval, 2 ms at most."""
    return Timing(min(max(0.25 * data.interval, 0.5e-3), 2e-3))


def _over_the_range(
    crane: Crane, data: Data, unknown: Sequence[Variable], knots: Fit | np.ndarray, stages: Sequence[Stage]
) -> Fit:
    """Return the fit of what is openly unknown, from the file's values, and where these are far off from some over the
    whole range.

    A window that a load leaves unexplained says little about which way to go; so the load is also begun elsewhere.
    """
    found = [staged(crane, data, unknown, np.zeros(len(unknown)), knots, stages)]
    if float(np.median(found[0].linear.window_error)) > CRITERIA.off:
        for share in BEGINS:
            u = [0.0 if isinstance(v, Timing) else v.lower + share * (v.upper - v.lower) for v in unknown]
            found.append(staged(crane, data, unknown, np.array(u), knots, stages))
    return min(found, key=lambda f: math.inf if f.linear.failed else f.linear.cost)


def all_parameters(crane: Crane, data: Data, stages: Sequence[Stage] = (LOOSE,), near: Fit | None = None) -> Fit:
    """Return the fit of all uncertain nominal parameters in windows: first what is unknown, then what is uncertain as
    well.

    A payload of which only a range is known may be far from the file's value; fitted at once with everything else, many
    other parameters would move a little to do its work, from where the fit comes back slowly. Windows begin as
    measured, or as those of a fit nearby.
    """
    clocks = timings(data)
    variables: list[Variable] = [*uncertain_parameters(crane, data.own, len(data.parts)), *clocks]
    unknown = [v for v in variables if isinstance(v, Timing) or not math.isfinite(v.prior)]
    knots = near or first_knots(crane, data)
    if len(unknown) == len(clocks):
        return staged(crane, data, variables, np.zeros(len(variables)), knots, stages)
    first = _over_the_range(crane, data, unknown, knots, stages)
    known = {v.name: float(x) for v, x in zip(unknown, first.u, strict=True)}
    return staged(crane, data, variables, np.array([known.get(v.name, 0.0) for v in variables]), first, stages)
