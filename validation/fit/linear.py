"""A fit's model made linear: windows of the recording swept with sensitivities, summed up to normal equations."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import chain
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.layout import Layout

from .columns import Columns, Probes, columns_of, join, model_at
from .data import Data
from .model import Model
from .sweeps import Swept, lost, run_again, sweep
from .variables import Variable
from .windows import Group, Window, by_recording, follows, jump_of, shared_out, side_by_side

#: how far a first state may be from its guess, by unit, as one standard deviation; and those of a pendulum
_GUESS: Mapping[str, float] = {"rad": 0.1, "m": 0.1, "rad/s": 0.1, "m/s": 0.1, "Pa": 50e5}
_GUESS_OF_PENDULUM = 0.3
THREADS = 2
#: most numbers that are kept of swept windows, 200 MB
_KEPT = 25_000_000


@cache
def _guess_of(layout: Layout) -> np.ndarray:
    return np.array([*layout.sized(layout.states, _GUESS), *[_GUESS_OF_PENDULUM] * len(layout.added)])


@dataclass
class Linear:
    """Normal equations of one linearised fit: knots x (K, nx) in units of `jump` (nx,), variables u (m,).

    Hxx (K, nx, nx), Hxo (K-1, nx, nx) between knot k and k+1, Hxu (K, nx, m), Huu (m, m); gx, gu are the gradients.
    squares, counts: sum of squared residuals in noise units and number of samples, by channel. window_error (K,): RMS
    residual of each window; window_cost (K,), jump_cost (K-1,): what they add to the cost, see `robust`. weak (nx,):
    weights of a weak prior that holds the first state near its guess. swept: the windows that were summed up, where
    they are not too large to be kept. volume: what lagging sensors' unknown first values add to minus twice the log
    evidence, see `forgotten`.
    """

    Hxx: np.ndarray
    Hxo: np.ndarray
    Hxu: np.ndarray
    Huu: np.ndarray
    gx: np.ndarray
    gu: np.ndarray
    squares: dict[str, float]
    counts: dict[str, int]
    window_error: np.ndarray
    window_cost: np.ndarray
    jump_cost: np.ndarray
    jump: np.ndarray
    weak: np.ndarray
    swept: tuple[Swept, ...] = ()
    volume: float = 0.0
    failed: bool = False

    @property
    def error(self) -> float:
        """RMS residual over all channels, in noise units."""
        return float(np.sqrt(sum(self.squares.values()) / max(1, sum(self.counts.values()))))

    @property
    def cost(self) -> float:
        """Minus twice the log-likelihood of residuals and jumps, up to a constant."""
        return float(self.window_cost.sum() + self.jump_cost.sum())


def robust(squares: float, number: int) -> tuple[float, float]:
    """Return cost and weight of a group of residuals with that sum of squares (noise units).

    Up to what noise makes (squares = number) the cost is the sum of squares; beyond, it grows with the logarithm only,
    which is the likelihood of a group whose own error level is unknown. So what a model cannot explain anywhere in a
    short stretch is counted once, instead of bending all parameters.
    """
    excess = max(squares - number, 0.0)
    return min(squares, number) + number * float(np.log1p(excess / number)), 1.0 / (1.0 + excess / number)


def linearised(
    crane: Crane,
    data: Data,
    windows: Sequence[Window],
    knots: np.ndarray,
    variables: Sequence[Variable],
    u: np.ndarray,
    stiffness: float,
    probes: Probes | None = None,
) -> tuple[Linear, np.ndarray]:
    """Return the linearised fit of all recordings, and the knots with as many states as the model has.

    Args:
        probes: (model, data, number of the recording) -> columns that come behind those of the variables.
    """  # fmt: skip
    found = []
    for i, part, mine in by_recording(data, windows):
        base = model_at(crane, variables, u, part, recording=i)
        columns = columns_of(crane, variables, u, base, part, i)
        if probes is not None:
            columns = join(columns, probes(base, part, i))
        states = base.nx if probes is None else max(base.nx, knots.shape[1])
        knots = with_states(knots, states)
        found.append(
            normal_equations([windows[k] for k in mine], knots[mine], base, columns, stiffness, keep=probes is None)
        )
    return joined(found), knots


def near(
    crane: Crane,
    data: Data,
    windows: Sequence[Window],
    knots: np.ndarray,
    variables: Sequence[Variable],
    u: np.ndarray,
    stiffness: float,
    before: Linear,
) -> Linear | None:
    """Return the fit near a point at which it was linearised, with the derivatives that it had there: runs alone take a
    fraction of the time. None where the number of states is another one.

    Where windows were not kept, only its cost is told.
    """
    found, swept = list[Linear](), before.swept or (None,) * len(windows)
    for i, part, mine in by_recording(data, windows):
        base = model_at(crane, variables, u, part, recording=i)
        if base.nx != knots.shape[1] or base.nx != len(before.jump):
            return None
        own, kept = [windows[k] for k in mine], [swept[k] for k in mine]
        groups = side_by_side(own)
        parts = _each(
            partial(run_again, base=base, m=len(u)), groups, shared_out(groups, knots[mine]), shared_out(groups, kept)
        )
        found.append(_summed(own, knots[mine], parts, base, len(u), stiffness))
    return joined(found)


def with_states(knots: np.ndarray, nx: int) -> np.ndarray:
    """Return knots with as many states as a model has: a pendulum begins at rest, hanging."""
    n = min(nx, knots.shape[1])
    return knots if knots.shape[1] == nx else np.pad(knots[:, :n], ((0, 0), (0, nx - n)))


def joined(parts: Sequence[Linear]) -> Linear:
    """Return the normal equations of several recordings as one: variables in common, knots one recording after the
    other.
    """
    if len(parts) == 1:
        return parts[0]
    nx = len(parts[0].jump)
    squares, counts = Counter[str](), Counter[str]()
    for p in parts:
        squares.update(p.squares)  # type: ignore[arg-type]  # adds up floats as well
        counts.update(p.counts)
    apart = [row for p in parts for row in (p.Hxo, np.zeros((1, nx, nx)))][:-1]
    jumps = [row for p in parts for row in (p.jump_cost, np.zeros(1))][:-1]
    together = {
        n: np.concatenate([getattr(p, n) for p in parts]) for n in ("Hxx", "Hxu", "gx", "window_error", "window_cost")
    }
    return Linear(
        Hxo=np.concatenate(apart), jump_cost=np.concatenate(jumps), Huu=np.sum([p.Huu for p in parts], axis=0),
        gu=np.sum([p.gu for p in parts], axis=0),
        squares=dict(squares), counts=dict(counts), jump=parts[0].jump, weak=parts[0].weak,
        swept=tuple(s for p in parts for s in p.swept) if all(p.swept for p in parts) else (),
        volume=sum(p.volume for p in parts),
        failed=any(p.failed for p in parts), **together,
    )  # fmt: skip


def normal_equations(
    windows: Sequence[Window], knots: np.ndarray, base: Model, columns: Columns, stiffness: float, *, keep: bool = False
) -> Linear:
    """Return the linearised fit.

    Args:
        windows: K windows, held together where one follows the other.
        knots: first states (K, nx) in SI.
        base, columns: the model and its perturbed kin.
        stiffness: how many times smaller than `jump_of` says a jump between two windows is expected to be.
        keep: whether the swept windows are kept, unless they are too large.
    """
    n = knots.shape[1] + len(columns.size)
    keep = keep and n * (sum(w.data.count for w in windows) + n * len(windows)) <= _KEPT
    groups = side_by_side(windows, 1) if columns.timed(base) else side_by_side(windows)  # most act in few windows
    task = partial(_swept, base=base, columns=columns, keep=keep)
    parts = _each(task, groups, shared_out(groups, knots))
    return _summed(windows, knots, parts, base, len(columns.size), stiffness)


def _swept(group: Group, x0: np.ndarray, base: Model, columns: Columns, keep: bool) -> list[Swept]:
    found, m = [], len(columns.size)
    for window, begun, own in zip(group.windows, x0, sweep(group, x0, base, columns), strict=True):
        swept = lost(window, begun, m, np.zeros((window.data.count, len(begun) + m))) if own.failed else own
        found.append(swept if keep else replace(swept, J=None))
    return found


def _summed(
    windows: Sequence[Window], knots: np.ndarray, parts: Iterable[Swept], base: Model, m: int, stiffness: float
) -> Linear:
    """Return the normal equations of swept windows and the jumps between them; a model of which no window runs fails.

    A window whose run fails is not joined to the next; its first state goes towards the end of the one before.
    """
    K, nx = len(windows), knots.shape[1]
    scale = jump_of(base.crane.layout)[:nx]
    weak = (scale / _guess_of(base.crane.layout)[:nx]) ** 2
    linear = Linear(
        np.zeros((K, nx, nx)), np.zeros((max(K - 1, 0), nx, nx)), np.zeros((K, nx, m)), np.zeros((m, m)),
        np.zeros((K, nx)), np.zeros(m), {}, {}, np.zeros(K), np.zeros(K), np.zeros(max(K - 1, 0)), scale, weak,
    )  # fmt: skip
    swept, linear.failed = [], K > 0
    for k, part in enumerate(parts):
        linear.failed &= part.failed
        if part.J is not None:
            swept.append(part)
        linear.volume += part.volume
        _add_data(linear, k, part, windows[0].data.channels, scale)
        if not part.failed and k + 1 < K and follows(windows[k], windows[k + 1]):
            _add_jump(linear, k, part, knots[k + 1], scale, stiffness)
    linear.swept = tuple(swept) if len(swept) == K else ()
    return linear


def _each(task: Callable[..., list[Swept]], groups: Sequence[Group], *more: Sequence[Any]) -> Iterator[Swept]:
    """Yield what a task makes of each window, in order, given a group and what belongs to it; compiled code lets two
    threads work side by side.
    """
    if multiprocessing.parent_process() is not None:  # a worker process has one core to itself
        yield from chain.from_iterable(map(task, groups, *more))
        return
    yield from chain.from_iterable(_threads().map(task, groups, *more))


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(THREADS)


def _add_data(linear: Linear, k: int, part: Swept, channels: tuple[str, ...], scale: np.ndarray) -> None:
    nx = len(scale)
    for channel, own, count in zip(channels, part.squares, part.counts, strict=True):
        linear.squares[channel] = linear.squares.get(channel, 0.0) + own
        linear.counts[channel] = linear.counts.get(channel, 0) + count
    squares, number = sum(part.squares), max(1, sum(part.counts))
    linear.window_error[k] = np.sqrt(squares / number)
    linear.window_cost[k], weight = robust(squares, number)
    H, g = weight * part.JJ, -weight * part.Jr
    linear.Hxx[k] += H[:nx, :nx]
    linear.Hxu[k] += H[:nx, nx:]
    linear.Huu += H[nx:, nx:]
    linear.gx[k] += g[:nx]
    linear.gu += g[nx:]


def _add_jump(linear: Linear, k: int, part: Swept, after: np.ndarray, scale: np.ndarray, stiffness: float) -> None:
    nx = len(scale)
    jump = (part.end - after) * stiffness / scale
    linear.jump_cost[k], weight = robust(float(jump @ jump), nx)
    J = part.end_jacobian * (stiffness / scale)[:, None]
    Jx, Ju = J[:, :nx] * scale, J[:, nx:]
    linear.Hxx[k] += weight * (Jx.T @ Jx)
    linear.Hxx[k + 1] += weight * stiffness**2 * np.eye(nx)
    linear.Hxo[k] -= weight * stiffness * Jx.T
    linear.Hxu[k] += weight * (Jx.T @ Ju)
    linear.Hxu[k + 1] -= weight * stiffness * Ju
    linear.Huu += weight * (Ju.T @ Ju)
    linear.gx[k] += weight * (Jx.T @ jump)
    linear.gx[k + 1] -= weight * stiffness * jump
    linear.gu += weight * (Ju.T @ jump)
