"""Implicit trapezoidal rule (21)-(26) on the equations of the crane, compiled: one step, a run, a batch.

The primary variables of a step are positions and pressures; rates, accelerations and pressure rates follow from them by (22).
Newton's method uses the numerical tangent (25), (26) and keeps it from step to step as long as it converges. A step that does not
converge is cut into smaller ones. Compiled code raises nothing: it returns a status and the index of the step.

The vapour-pressure floor stands inside the step as a projection, p = max(floor, trapezoidal rule), so that Newton meets a
continuous function.
"""

from __future__ import annotations

import math

import numpy as np

from crane_exudyn.compiled import njit

from .equations import FLOOR, free_rhs, pin_to_pin, rhs

__all__ = ["NOT_CONVERGED", "OK", "cylinder_lengths", "propagate_batch", "rhs", "simulate", "simulate_substeps"]

#: status of a run
OK, NOT_CONVERGED = 0, 1
#: a step may be cut into at most this many pieces
MAX_PIECES = 256
MAX_ITERATIONS = 16
#: Newton stops when no position moves by more than this (rad) and no pressure by more than that (Pa): the oil's stiffness
#: turns the one into about the other
POSITION_TOLERANCE, PRESSURE_TOLERANCE = 1e-12, 1e-3
#: forward differences (25): large against rounding, small against the 2 bar and 2 mrad/s over which laws bend
POSITION_EPSILON, PRESSURE_EPSILON = 1e-7, 1e2


@njit(cache=False)
def primary_indices(nx):
    """Return the places of the primary variables in x: positions (z1, z4, the pendulum's angle), then pressures."""
    if nx == 8:
        return np.array([0, 1, 4, 5, 6, 7])
    return np.array([0, 1, 8, 4, 5, 6, 7])


@njit(cache=False)
def workspace(nx):
    """Return the arrays that stepping needs: primary indices, tangent with its inverse permutation, vectors, notes.

    `notes` holds the step size for which the tangent was made; 0 means there is none.
    """
    index = primary_indices(nx)
    n = index.size
    return index, np.empty((n, n)), np.empty(n, np.int64), np.empty((4, n)), np.empty((5, nx)), np.zeros(1)


@njit(cache=False)
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


@njit(cache=False)
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


@njit(cache=False)
def residual(x0, f0, x1, f1, w1, t1, h, P, E, index, r):
    """Write the residual (23) of the step to r, completing x1 and f1 from the primary variables in x1.

    Positions: h/2 times the defect of the rates, which is (23) multiplied by the inverse mass matrix; pressures likewise.
    Both are in the units of their variable.
    """
    for i in range(index.size - 4):  # (22)
        k = index[i]
        rate = k + 2 if k < 2 else k + 1
        x1[rate] = 2.0 / h * (x1[k] - x0[k]) - x0[rate]
    free_rhs(x1, w1, t1, P, E, f1)
    for i in range(index.size):
        k = index[i]
        if 4 <= k < 8:
            r[i] = x1[k] - max(P[FLOOR], x0[k] + 0.5 * h * (f0[k] + f1[k]))
        else:
            rate = k + 2 if k < 2 else k + 1
            r[i] = 0.5 * h * (x1[rate] - x0[rate] - 0.5 * h * (f0[rate] + f1[rate]))


@njit(cache=False)
def tangent(x0, f0, x1, w1, t1, h, P, E, work):
    """Renew the factorised tangent matrix by forward differences (25), (26) around x1; False if it is singular."""
    index, A, pivot, rows, states, notes = work
    base, moved, x, f = rows[1], rows[2], states[2], states[3]
    x[:] = x1
    residual(x0, f0, x, f, w1, t1, h, P, E, index, base)
    for j in range(index.size):
        k = index[j]
        step = PRESSURE_EPSILON if 4 <= k < 8 else POSITION_EPSILON
        x[:] = x1
        x[k] += step
        residual(x0, f0, x, f, w1, t1, h, P, E, index, moved)
        for i in range(index.size):
            A[i, j] = (moved[i] - base[i]) / step
    good = factorise(A, pivot)
    notes[0] = h if good else 0.0
    return good


@njit(cache=False)
def predict(x0, f0, h, index, floor, x1):
    """Write an explicit first guess of the primary variables to x1."""
    x1[:] = x0
    for i in range(index.size):
        k = index[i]
        if 4 <= k < 8:
            x1[k] = max(floor, x0[k] + h * f0[k])
        else:
            rate = k + 2 if k < 2 else k + 1
            x1[k] = x0[k] + h * (x0[rate] + 0.5 * h * f0[rate])


@njit(cache=False)
def change_size(index, r):
    """Return the largest change in units of its tolerance; NaN if any is not a number."""
    largest = 0.0
    for i in range(index.size):
        size = abs(r[i]) / (PRESSURE_TOLERANCE if 4 <= index[i] < 8 else POSITION_TOLERANCE)
        if not size <= largest:
            largest = size
        if math.isnan(size):
            return math.nan
    return largest


@njit(cache=False)
def newton(x0, f0, w1, t1, h, P, E, work, x1, f1):
    """Solve one trapezoidal step from x0 (with f0 = rhs there) for x1 (24); False if it does not converge."""
    index, A, pivot, rows, _, notes = work
    r = rows[0]
    predict(x0, f0, h, index, P[FLOOR], x1)
    fresh, before = False, math.inf
    for _ in range(MAX_ITERATIONS):
        if not abs(notes[0] - h) <= 1e-6 * h:
            fresh = tangent(x0, f0, x1, w1, t1, h, P, E, work)
            if not fresh:
                return False
        residual(x0, f0, x1, f1, w1, t1, h, P, E, index, r)
        solve_factorised(A, pivot, r)
        size = change_size(index, r)
        if not size < 1e15:  # a pose that cannot be reached, or far out: smaller steps
            notes[0] = 0.0
            return False
        if size > 0.3 * before and size > 1.0:
            notes[0] = 0.0  # too slow: a new tangent for the next iteration
        for i in range(index.size):
            x1[index[i]] -= r[i]
        if size <= 1.0:
            for i in range(index.size - 4):
                k = index[i]
                rate = k + 2 if k < 2 else k + 1
                x1[rate] = 2.0 / h * (x1[k] - x0[k]) - x0[rate]
            for k in range(4, 8):
                x1[k] = max(x1[k], P[FLOOR])
            return True
        before = size
    notes[0] = 0.0
    return False


@njit(cache=False)
def between(w0, w1, share, w):
    for k in range(w.size):
        w[k] = w0[k] if share == 0.0 else (w1[k] if share == 1.0 else w0[k] + share * (w1[k] - w0[k]))


@njit(cache=False)
def advance(x, f, w0, w1, t0, h, P, E, work, last):
    """Move x by h in place, and f = rhs(x) with it; in pieces where one step does not converge. False if nothing helps.

    With `last` nobody asks for f at the end any more, and it is not computed: a seventh of the cost of a single step.
    """
    states = work[4]
    x1, f1, w = states[0], states[1], np.empty(w0.size)
    done, pieces = 0.0, 1
    while done < 1.0:
        share = min(1.0, done + 1.0 / pieces)
        between(w0, w1, share, w)
        if newton(x, f, w, t0 + share * h, (share - done) * h, P, E, work, x1, f1):
            x[:] = x1
            done = share
            if done < 1.0 or not last:
                rhs(x, w, t0 + share * h, P, E, f)
        elif pieces < MAX_PIECES:
            pieces *= 4
        else:
            return False
    return True


@njit
def simulate(x0, W, h, t0, P, E):
    """Return states X (N, nx) on the grid t0 + k h, the status and the index of the step that failed (-1 if none).

    Args:
        x0: state (nx,) at t0; nx is 8, or 10 with a pendulum.
        W: inputs [U1 U2 pp pt] (N, 4) on the grid, linear between; NaN in pp or pt: the crane's own.
        h, t0: step and first time, s.
        P, E: parameter and effect vectors.
    """
    N, nx = W.shape[0], x0.size
    X = np.full((N, nx), math.nan)
    work = workspace(nx)
    x, f = x0.copy(), np.empty(nx)
    rhs(x, W[0], t0, P, E, f)
    X[0] = x
    for k in range(N - 1):
        if not advance(x, f, W[k], W[k + 1], t0 + k * h, h, P, E, work, k == N - 2):
            return X, NOT_CONVERGED, k
        X[k + 1] = x
    return X, OK, -1


@njit
def simulate_substeps(x0, W, time, step, P, E):
    """Like `simulate` on any increasing `time` (N,): each interval is cut into equal steps of at most `step`."""
    N, nx = W.shape[0], x0.size
    X = np.full((N, nx), math.nan)
    work = workspace(nx)
    x, f, wa, wb = x0.copy(), np.empty(nx), np.empty(4), np.empty(4)
    rhs(x, W[0], time[0], P, E, f)
    X[0] = x
    for k in range(N - 1):
        n = max(1, math.ceil((time[k + 1] - time[k]) / step - 1e-6))
        h = (time[k + 1] - time[k]) / n
        for i in range(n):
            between(W[k], W[k + 1], i / n, wa)
            between(W[k], W[k + 1], (i + 1) / n, wb)
            if not advance(x, f, wa, wb, time[k] + i * h, h, P, E, work, False):
                return X, NOT_CONVERGED, k
        X[k + 1] = x
    return X, OK, -1


@njit
def propagate_batch(states, W0, W1, t0, dt, n, P, E):
    """Return states (rows, nx) one dt later, in n equal steps, the status and the row that failed.

    W0, W1 (rows or 1, 4 or 12): inputs at the start and the end; the last eight are disturbances, see `equations`.
    P, E (rows or 1, .): parameter and effect vectors. The tangent is shared by the rows: they are neighbours.
    """
    rows, nx = states.shape
    out = np.empty_like(states)
    work = workspace(nx)
    f, wa, wb = np.empty(nx), np.empty(W0.shape[1]), np.empty(W0.shape[1])
    h = dt / n
    for row in range(rows):
        a, b = W0[row % W0.shape[0]], W1[row % W1.shape[0]]
        p, e = P[row % P.shape[0]], E[row % E.shape[0]]
        x = out[row]
        x[:] = states[row]
        rhs(x, a, t0, p, e, f)
        for i in range(n):
            between(a, b, i / n, wa)
            between(a, b, (i + 1) / n, wb)
            if not advance(x, f, wa, wb, t0 + i * h, h, p, e, work, i == n - 1):
                x[:] = math.nan
                return out, NOT_CONVERGED, row
    return out, OK, -1


@njit
def cylinder_lengths(cylinder, angles, P):
    """Return pin-to-pin lengths (n,) m of the lift cylinder (0) at angles z1 (n,) or of the tilt cylinder (1) at angles z4 (n,)."""
    out = np.empty(angles.size)
    for i in range(angles.size):
        out[i] = pin_to_pin(cylinder, angles[i], P)
    return out
