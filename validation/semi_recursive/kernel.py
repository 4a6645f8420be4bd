"""Implicit trapezoidal rule (21)-(26) on the equations of a machine, compiled: one step, a run, a batch.

The primary variables of a step are positions and amounts of oil; rates and accelerations follow from them by (22),
pressures by the equation of state. So what flows into a chamber is what is in it more at the end, whatever the pressure
does between:

    z1 = z0 + h/2 (z0' + z1')     z1' = z0' + h/2 (z0'' + z1'')     N1 = N0 + h/2 (k0 Q0 + k1 Q1)

Newton's method uses the numerical tangent (25), (26) and keeps it from step to step as long as it converges.

Every step is compared with the fourth-order rule (Simpson's, with Hermite's midpoint): the defect h/3 (f0 + f1 - 2 fm)
of the trapezoidal rule is the local error. A step whose error is beyond what it may be, or that does not converge, is
halved. Compiled code raises nothing: it returns a status and the index of the step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from crane_exudyn.compiled import lean, njit
from crane_exudyn.machine import CYLINDERS
from crane_exudyn.step_control import (
    MOST_HALVINGS,
    POSITION_ERROR,
    PRESSURE_ERROR,
    RATE_ERROR,
    enough_to_grow,
    is_rough,
    limit,
    next_level,
)

from .equations import amounts, at_amounts, at_pressures, balance, rates, settle_pressures
from .hydraulics import read_amounts
from .sheet import OIL, Sheet, inline, sheet

__all__ = ["NOT_CONVERGED", "OK", "TOO_COARSE", "propagate_batch", "simulate", "simulate_each"]

#: status of a run
OK, NOT_CONVERGED, TOO_COARSE = 0, 1, 2
MAX_ITERATIONS = 16
#: parts that a fit's run may have on the average in a step, and in a second where its local error is at least so large,
#: and as many as there may be beside: a machine that runs away (a boom that spins) would have thousands in every step,
#: and no sample is like it
MOST_PARTS, IN_A_SECOND, LOOSELY, PARTS_BESIDE = 16.0, 13e3, 20.0, 1000.0
#: amounts of oil are counted in this unit, m^3: about what 1 Pa more presses into a chamber
AMOUNT = 1e-12
#: Newton stops when no position moves by more than the step times this (rad/s), or by what it is rounded to (rad), and
#: no amount by more than that (AMOUNT); in a batch of which a step may be off by more than an engine's, as a filter's
#: by bars, as many times more, and ROUGHLY
RATE_TOLERANCE, ROUNDING, AMOUNT_TOLERANCE, ROUGHLY = 1e-10, 1e-15, 1e-4, 10.0
#: forward differences (25): large against rounding, small against the 2 bar and 2 mrad/s over which laws bend
POSITION_EPSILON, AMOUNT_EPSILON = 1e-7, 1e2


class Point(NamedTuple):
    """A machine at one instant: state x (nx,), amounts of oil N (2n,), and g (nx,) the rates of positions, rates and
    amounts.
    """

    x: np.ndarray
    N: np.ndarray
    g: np.ndarray


class Work(NamedTuple):
    """What stepping needs: the machine's sheet, where positions and their rates stand in x (n or n + 1, 2), tangents,
    scratch, and what it says.

    Every length of step has a tangent of its own, by how often it was halved: factors A (levels, n, n), `pivot`, the
    step size `made` for which it was made (0: there is none), and the contraction `rate` that Newton's method had with
    it. `said` holds how many steps were halved, the error of the last step in units of `step_control.*_ERROR`, how many
    of these are allowed, and the PATIENCE: after a step of more iterations the next one has a new tangent; how often
    the next step is halved at once; how many parts steps had in all; and how many times its usual tolerances Newton's
    method may leave.
    """

    sheet: Sheet
    places: np.ndarray
    A: np.ndarray
    pivot: np.ndarray
    made: np.ndarray
    rate: np.ndarray
    rows: np.ndarray
    end: Point
    moved: Point
    w: np.ndarray
    said: np.ndarray
    past: np.ndarray


HALVED, ERROR, ALLOWED, PATIENCE, LEVEL, LIMIT, BEFORE, PARTS, LOOSE = range(9)
#: the patience of a run: a tangent costs as much as seven iterations, and serves for hundreds of steps
PATIENT = 3.0


@njit
def places_of(nx, n):
    """Return where positions (the coordinates, the pendulum's angle) and their rates stand in x; the other primary
    variables are amounts.
    """
    places = np.empty((n + (nx - 4 * n) // 2, 2), np.int64)
    for i in range(places.shape[0]):
        places[i, 0], places[i, 1] = (i, n + i) if i < n else (4 * n, 4 * n + 1)
    return places


@njit
def point(nx, n):
    """Return an empty Point."""
    return Point(np.empty(nx), np.empty(2 * n), np.empty(nx))


@njit
def workspace(topology, nx, n_inputs):
    """Return the Work of a machine with nx states and n_inputs inputs."""
    n, levels = topology[0, CYLINDERS], MOST_HALVINGS + 1
    places = places_of(nx, n)
    m = places.shape[0] + 2 * n
    return Work(
        sheet(topology), places, np.empty((levels, m, m)), np.empty((levels, m), np.int64), np.zeros(levels),
        np.ones(levels),
        np.empty((3, m)), point(nx, n), point(nx, n), np.empty((3, n_inputs)),
        np.array([0.0, 0.0, 1.0, MAX_ITERATIONS, 0.0, 1.0, 0.0, 0.0, 1.0]),
        np.zeros(nx),
    )  # fmt: skip


@inline
def copy(source, target):
    for i in range(target.size):
        target[i] = source[i]


@lean
def factorise(A, pivot):
    """Replace A by its LU factors with row exchanges `pivot`; False if A is singular or not finite."""
    n = A.shape[0]
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[best, k]):
                best = i
        pivot[k] = best
        if not abs(A[best, k]) > 0.0 or math.isinf(A[best, k]):
            return False
        if best != k:
            for j in range(n):
                A[k, j], A[best, j] = A[best, j], A[k, j]
        for i in range(k + 1, n):
            A[i, k] /= A[k, k]
            for j in range(k + 1, n):
                A[i, j] -= A[i, k] * A[k, j]
    return True


@lean
def solve_factorised(A, pivot, b):
    """Replace b by the solution of the system whose factors `factorise` left in A."""
    n = A.shape[0]
    for k in range(n):
        if pivot[k] != k:
            b[k], b[pivot[k]] = b[pivot[k]], b[k]
    for k in range(n):
        for i in range(k + 1, n):
            b[i] -= A[i, k] * b[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            b[k] -= A[k, j] * b[j]
        b[k] /= A[k, k]


@lean
def begin(p, w, t, P, E, s):
    """Fill amounts and rates of a Point from its state."""
    at_pressures(p.x, w, t, P, E, s)
    amounts(s, p.N)
    rates(p.x, s, p.g)


@lean
def settle(p, w, t, P, E, s):
    """Fill pressures and rates of a Point from its positions, rates and amounts; then the amounts as the pressures have
    them.
    """
    at_amounts(p.x, p.N, w, t, P, E, s)
    amounts(s, p.N)
    rates(p.x, s, p.g)


@lean
def end_rates(start, end, h, places):
    """Write the rates at the end of a step that its positions ask for (22)."""
    for i in range(places.shape[0]):
        k, r = places[i, 0], places[i, 1]
        end.x[r] = 2.0 / h * (end.x[k] - start.x[k]) - start.x[r]


@lean
def residual(start, end, w1, t1, h, P, E, work, r):
    """Write the residual (23) of the step to r, completing the end from its positions and amounts.

    Positions: h/2 times the defect of the rates, which is (23) multiplied by the inverse mass matrix. Amounts in
    AMOUNT.
    """
    end_rates(start, end, h, work.places)
    at_amounts(end.x, end.N, w1, t1, P, E, work.sheet)
    defects(start, end, h, work, r)


@lean
def residual_of_amounts(start, end, w1, t1, h, P, E, work, r):
    """Write the residual (23) to r where only amounts differ from what was evaluated last: positions and mass matrix
    stand.
    """
    read_amounts(end.x, end.N, P, E, work.sheet)
    balance(end.x, w1, t1, P, E, work.sheet)
    defects(start, end, h, work, r)


@lean
def defects(start, end, h, work, r):
    """Write what the sheet's rates leave of the residual (23) to r."""
    places = work.places
    n, first = places.shape[0], 2 * work.sheet.topology[0, CYLINDERS]
    rates(end.x, work.sheet, end.g)
    for i in range(n):
        k = places[i, 1]
        r[i] = 0.5 * h * (end.x[k] - start.x[k] - 0.5 * h * (start.g[k] + end.g[k]))
    for i in range(end.N.size):
        r[n + i] = (end.N[i] - start.N[i] - 0.5 * h * (start.g[first + i] + end.g[first + i])) / AMOUNT


@lean
def tangent(start, base, w1, t1, h, P, E, work, level):
    """Renew the factorised tangent matrix by forward differences (25), (26) around the end of the step, whose residual,
    the last evaluated, is `base`; False if it is singular.
    """
    moved, to, A = work.rows[1], work.moved, work.A[level]
    m, n = base.size, work.places.shape[0]
    copy(work.end.x, to.x)
    for j in range(m - 1, -1, -1):  # amounts first: for them the mechanics of the base stand
        copy(work.end.N, to.N)
        if j >= n:
            to.N[j - n] += AMOUNT_EPSILON * AMOUNT
            residual_of_amounts(start, to, w1, t1, h, P, E, work, moved)
        else:
            copy(work.end.x, to.x)
            to.x[work.places[j, 0]] += POSITION_EPSILON
            residual(start, to, w1, t1, h, P, E, work, moved)
        step = AMOUNT_EPSILON if j >= n else POSITION_EPSILON
        for i in range(m):
            A[i, j] = (moved[i] - base[i]) / step
    good = factorise(A, work.pivot[level])
    work.made[level], work.rate[level] = (h if good else 0.0), 1.0
    return good


@lean
def predict(start, h, work):
    """Write a first guess of the primary variables to the end of the step: rates go on as they changed in the part
    before.
    """
    end, bend, first = work.end, 0.0, 2 * work.sheet.topology[0, CYLINDERS]
    if 0.0 < h <= 2.0 * work.said[BEFORE]:
        bend = h / work.said[BEFORE]
    copy(start.x, end.x)
    for i in range(work.places.shape[0]):
        k, r = work.places[i, 0], work.places[i, 1]
        end.x[k] = start.x[k] + h * (start.x[r] + 0.5 * h * (start.g[r] + bend / 3.0 * (start.g[r] - work.past[r])))
    for i in range(end.N.size):
        k = first + i
        end.N[i] = start.N[i] + h * (start.g[k] + 0.5 * bend * (start.g[k] - work.past[k]))


@lean
def change_size(n, r, h, loosely):
    """Return the largest change, n of positions and then of amounts, in units of its tolerance in a step h, which is so
    many times the usual one; NaN if any is not a number.
    """
    largest, tolerance = 0.0, max(loosely * RATE_TOLERANCE * h, ROUNDING)
    for i in range(r.size):
        size = abs(r[i]) / (tolerance if i < n else loosely * AMOUNT_TOLERANCE)
        if not size <= largest:
            largest = size
        if math.isnan(size):
            return math.nan
    return largest


@lean
def newton(start, w1, t1, h, P, E, work, level):
    """Solve one trapezoidal step from the Point `start` for `work.end` (24), pressures left out; False if it does not
    converge.
    """
    r, end, made, rate, n = work.rows[0], work.end, work.made, work.rate, work.places.shape[0]
    predict(start, h, work)
    before = math.inf
    for iteration in range(MAX_ITERATIONS):
        residual(start, end, w1, t1, h, P, E, work, r)
        if not abs(made[level] - h) <= 1e-6 * h and not tangent(start, r, w1, t1, h, P, E, work, level):
            return False
        solve_factorised(work.A[level], work.pivot[level], r)
        size = change_size(n, r, h, work.said[LOOSE])
        if not size < 1e15:  # a pose that cannot be reached, or far out: smaller steps
            made[level] = 0.0
            return False
        if before < math.inf:
            rate[level] = max(0.3 * rate[level], size / before)
            if size > 0.3 * before and size > 1.0:
                made[level] = 0.0  # too slow: a new tangent for the next iteration
        for i in range(n):
            end.x[work.places[i, 0]] -= r[i]
        for i in range(end.N.size):
            end.N[i] -= r[n + i] * AMOUNT
        if size * min(rate[level], 1.0) <= 1.0:  # what is left is the size of the last change times the contraction
            end_rates(start, end, h, work.places)
            if iteration >= work.said[PATIENCE]:
                made[level] = 0.0
            return True
        before = size
    made[level] = 0.0
    return False


@lean
def local_error(start, w0, w1, t0, h, P, E, work, level):
    """Return the local error of the step from `start` to `work.end` in units of `step_control.*_ERROR`.

    It is the defect of the trapezoidal rule against Simpson's. Ever better estimates, each only where the one before is
    not enough: by the change of the rates over the step, which bounds the defect of rates that change one way, but
    falls with the square of h only (so where a step was halved, it must also tell that parts may grow again); by how
    the rates bend; by those in the middle; and after what the system's own stiffness makes of the defect, by one
    iteration of Newton's method.
    """
    places, end, middle, r, defect = work.places, work.end, work.moved, work.rows[1], work.rows[2]
    n, m = places.shape[0], r.size
    for i in range(m):
        k = place_of_rate(i, work)
        defect[i] = h / 3.0 * abs(start.g[k] - end.g[k])
    worst = defect_size(defect, h, start, end, P, work)
    if worst <= enough_to_grow(level, h, work.said[ALLOWED]):
        return worst
    bound, back = worst, work.said[BEFORE]
    if 0.5 * h <= back <= 2.0 * h:
        for i in range(m):
            k = place_of_rate(i, work)
            bend = ((end.g[k] - start.g[k]) / h - (start.g[k] - work.past[k]) / back) / (h + back)
            defect[i] = h**3 / 6.0 * abs(bend)
        worst = defect_size(defect, h, start, end, P, work)
        if worst <= work.said[LIMIT]:
            return min(worst, bound)
    if bound <= work.said[LIMIT]:
        return bound
    middle_rates(start, w0, w1, t0, h, P, E, work)
    for i in range(m):
        k = place_of_rate(i, work)
        r[i] = h / 3.0 * (start.g[k] + end.g[k] - 2.0 * middle.g[k])
        defect[i] = abs(r[i])
    worst = defect_size(defect, h, start, end, P, work)
    if not worst > work.said[LIMIT]:
        return worst if worst == worst else math.inf
    for i in range(m):
        r[i] = of_position(start, end, places[i, 1], h) + 0.5 * h * r[i] if i < n else r[i] / AMOUNT
    solve_factorised(work.A[level], work.pivot[level], r)
    for i in range(m):
        defect[i] = 2.0 / h * abs(r[i] - of_position(start, end, places[i, 1], h)) if i < n else abs(r[i]) * AMOUNT
    worst = defect_size(defect, h, start, end, P, work)
    for i in range(n):
        worst = max(worst, abs(r[i]) / POSITION_ERROR)
    return worst if worst == worst else math.inf


@inline
def place_of_rate(i, work):
    """Return where what residual i is about stands in g: the acceleration of a position, or the rate of an amount."""
    n = work.places.shape[0]
    return work.places[i, 1] if i < n else 2 * work.sheet.topology[0, CYLINDERS] + i - n


@inline
def of_position(start, end, rate, h):
    """Return the defect h/3 (z0' + z1' - 2 zm') of a position, the rate in the middle being Hermite's."""
    return -h * h / 12.0 * (start.g[rate] - end.g[rate])


@lean
def middle_rates(start, w0, w1, t0, h, P, E, work):
    """Fill `work.moved` with the state in the middle of the step, by Hermite's interpolation, and its rates."""
    end, middle, w, first = work.end, work.moved, work.w[2], 2 * work.sheet.topology[0, CYLINDERS]
    for i in range(w.size):
        w[i] = 0.5 * (w0[i] + w1[i])
    for i in range(middle.x.size):
        middle.x[i] = 0.5 * (start.x[i] + end.x[i])
    for i in range(middle.N.size):
        middle.N[i] = 0.5 * (start.N[i] + end.N[i]) + 0.125 * h * (start.g[first + i] - end.g[first + i])
    for i in range(work.places.shape[0]):
        k, rate = work.places[i, 0], work.places[i, 1]
        middle.x[k] += 0.125 * h * (start.x[rate] - end.x[rate])
        middle.x[rate] += 0.125 * h * (start.g[rate] - end.g[rate])
    at_amounts(middle.x, middle.N, w, t0 + 0.5 * h, P, E, work.sheet)
    rates(middle.x, work.sheet, middle.g)


@lean
def defect_size(defect, h, start, end, P, work):
    """Return the largest of the defects of rates and amounts, and of those of the positions, in units of
    `step_control.*_ERROR`.

    An amount may be wrong by what PRESSURE_ERROR presses into the oil of its chamber.
    """
    worst, n = 0.0, work.places.shape[0]
    for i in range(defect.size):
        if i < n:
            size = max(defect[i] / RATE_ERROR, abs(of_position(start, end, work.places[i, 1], h)) / POSITION_ERROR)
        else:
            size = defect[i] * P[OIL] / (start.N[i - n] * PRESSURE_ERROR)
        if not size <= worst:
            worst = size
        if math.isnan(size):
            return math.nan
    return worst


@lean
def between(w0, w1, share, w):
    for k in range(w.size):
        w[k] = w0[k] if share == 0.0 else (w1[k] if share == 1.0 else w0[k] + share * (w1[k] - w0[k]))


@lean
def try_step(now, wa, wb, t, h, P, E, work, level):
    """Take one step from `now` to `work.end`, pressures left out; return OK or why it has to be halved."""
    if not newton(now, wb, t + h, h, P, E, work, level):
        work.said[ERROR] = math.inf
        return NOT_CONVERGED
    work.said[ERROR] = local_error(now, wa, wb, t, h, P, E, work, level)
    return OK if work.said[ERROR] <= work.said[LIMIT] else TOO_COARSE


@inline
def remember(start, h, work):
    """Keep the rates at the start of a part of length h that was good, for the first guess and the error of the
    next.
    """
    copy(start.g, work.past)
    work.said[BEFORE] = h


@inline
def exhausted(steps, most, work):
    """Whether so many steps had more parts than they may, `most` on the average."""
    return work.said[PARTS] > most * steps + PARTS_BESIDE


@inline
def forget(work):
    """Begin anew: no part lies before the next."""
    work.said[LEVEL], work.said[BEFORE] = 0.0, 0.0


@lean
def advance(now, w0, w1, t0, h, P, E, work, last):
    """Move the Point `now` by h in place; a step that fails is halved, and its halves again. Return a status.

    It begins with parts as long as the last one. With `last` nobody asks for the rates at the end any more.
    """
    done, level = 0.0, int(work.said[LEVEL])
    while done < 1.0:
        part = 0.5**level
        wa, wb = work.w[0], work.w[1]
        between(w0, w1, done, wa)
        between(w0, w1, done + part, wb)
        work.said[LIMIT] = limit(level, part * h, work.said[ALLOWED])
        work.said[PARTS] += 1.0
        status = try_step(now, wa, wb, t0 + done * h, part * h, P, E, work, level)
        if status == OK:
            done += part
            remember(now, part * h, work)
            copy(work.end.x, now.x)
            copy(work.end.N, now.N)
            if done < 1.0 or not last:
                settle(now, wb, t0 + done * h, P, E, work.sheet)
            else:
                settle_pressures(now.x, now.N, P, E, work.sheet)
            level = next_level(level, done, part * h, work.said[ERROR], work.said[ALLOWED])
        elif level < MOST_HALVINGS:
            level += 1
            work.said[HALVED] += 1.0
        else:
            return status
    work.said[LEVEL] = level
    return OK


@njit
def run(x0, first, end, W, time, step, P, E, topology, allowed, most, X):
    """Write states from sample `first` to the last one before `end` to X (N, nx), as `simulate_each` does; return a
    status, the sample before the step that failed, and halved steps.
    """
    nx = x0.size
    work, now = workspace(topology, nx, W.shape[1]), point(nx, topology[0, CYLINDERS])
    work.said[ALLOWED], work.said[PATIENCE] = allowed, PATIENT
    wa, wb, steps = np.empty(W.shape[1]), np.empty(W.shape[1]), 0
    now.x[:] = x0
    begin(now, W[first], time[first], P, E, work.sheet)
    X[first] = x0
    for k in range(first, end - 1):
        n = max(1, math.ceil((time[k + 1] - time[k]) / step - 1e-6))
        h = (time[k + 1] - time[k]) / n
        for i in range(n):
            between(W[k], W[k + 1], i / n, wa)
            between(W[k], W[k + 1], (i + 1) / n, wb)
            last = k + 2 == end and i == n - 1
            status = advance(now, wa, wb, time[k] + i * h, h, P, E, work, last)
            steps += 1
            if status == OK and exhausted(steps, most, work):
                status = TOO_COARSE
            if status != OK:
                X[k + 1] = now.x
                return status, k, int(work.said[HALVED])
        X[k + 1] = now.x
    return OK, -1, int(work.said[HALVED])


def simulate(x0, W, time, step, P, E, topology, allowed=1.0, most=math.inf):
    """Return states X (N, nx) from x0 (nx,), the status, the sample before the step that failed, and halved steps; as
    `simulate_each` with one window.
    """
    one = np.zeros(1, np.int64)
    X, status, failed, halved = simulate_each(x0[None], one, W, time, step, P, E, topology, allowed, most)
    return X, status[0], failed[0], halved[0]


def most_parts(allowed: float, step: float) -> float:
    """Return how many parts a step (s) of a fit's run may have on the average, with a local error of at most `allowed`:
    twice what a load-holding valve takes that swings, 6000 a second with 20 and 30 000 with one.
    """
    return max(MOST_PARTS, IN_A_SECOND * step * math.sqrt(max(1.0, LOOSELY / allowed)))


@njit
def simulate_each(x0, first, W, time, step, P, E, topology, allowed, most):
    """Return states X (N, nx) at increasing times (N,) of K windows, one after the other, and by window (K,) the
    status, the sample before the step that failed, and halved steps.

    Args:
        x0: states (K, nx) at the first sample of each window; with n coordinates nx is 4n, or 4n + 2 with a pendulum.
        first: (K,) these samples, from 0; a window ends before the next one begins.
        W: inputs [U pp pt] (N, n + 2) at the times, linear between; NaN in pp or pt: the machine's own.
        time, step: s; each interval is cut into equal steps of at most `step`.
        P, E: parameter and effect vectors.
        topology: of the machine.
        allowed: local error of a step in units of `step_control.*_ERROR`; a step beyond it is halved.
        most: parts that a step may have on the average; a run that needs more ends as one whose steps are too coarse.
    """
    K = first.size
    X = np.full((W.shape[0], x0.shape[1]), math.nan)
    status, failed, halved = np.empty(K, np.int64), np.empty(K, np.int64), np.empty(K, np.int64)
    for w in range(K):
        end = first[w + 1] if w + 1 < K else W.shape[0]
        status[w], failed[w], halved[w] = run(x0[w], first[w], end, W, time, step, P, E, topology, allowed, most, X)
    return X, status, failed, halved


@njit
def propagate_batch(states, W0, W1, t0, dt, n, P, E, topology, allowed=1.0):
    """Return states (rows, nx) one dt later, in n equal steps, the status and the row that failed, and how many steps
    were halved.

    W0, W1 (rows or 1, .): inputs at the start and the end, without or with the disturbances of the layout behind them.
    P, E (rows or 1, .): parameter and effect vectors. The tangent is shared by the rows: they are neighbours.
    """
    rows, nx = states.shape
    out = np.empty_like(states)
    work, now = workspace(topology, nx, W0.shape[1]), point(nx, topology[0, CYLINDERS])
    work.said[ALLOWED] = allowed
    if is_rough(allowed):
        work.said[LOOSE] = ROUGHLY * allowed
    wa, wb = np.empty(W0.shape[1]), np.empty(W0.shape[1])
    h = dt / n
    for row in range(rows):
        a, b = W0[row % W0.shape[0]], W1[row % W1.shape[0]]
        p, e = P[row % P.shape[0]], E[row % E.shape[0]]
        now.x[:] = states[row]
        forget(work)
        begin(now, a, t0, p, e, work.sheet)
        for i in range(n):
            between(a, b, i / n, wa)
            between(a, b, (i + 1) / n, wb)
            status = advance(now, wa, wb, t0 + i * h, h, p, e, work, i == n - 1)
            if status != OK:
                out[row] = now.x
                return out, status, row, int(work.said[HALVED])
        out[row] = now.x
    return out, OK, -1, int(work.said[HALVED])
