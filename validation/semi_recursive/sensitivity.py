"""Derivatives of a run with respect to its start and to any number of parameters, effects and inputs, in one sweep.

The trapezoidal step x1 = x0 + h/2 [f(x0) + f(x1)] is differentiated as it stands (implicit differentiation):

    (I - h/2 A1) S1 = (I + h/2 A0) S0 + h/2 (b0 + b1),     A = df/dx,     b = [f(x; probe) - f(x; base)] / delta

A column is a probe: another P, another E, other inputs, or several at once. Its b is the one-sided difference from the base to
the probe, so an effect whose law is not smooth at its neutral value is probed at a finite size. A column with `own` tangent
uses A of the probe instead of the base: the linear answer of the changed machine, for probes that alter its dynamics (a
pendulum, a soft spring).

A run may be cut into windows (multiple shooting): at each knot the state is set anew and the sensitivities begin again.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from crane_exudyn.compiled import njit

from .equations import FLOOR, rhs
from .kernel import MAX_PIECES, NOT_CONVERGED, OK, between, factorise, newton, workspace

POSITION_EPSILON, RATE_EPSILON, PRESSURE_EPSILON = 1e-7, 1e-6, 1e2


class Sweep(NamedTuple):
    """What `sweep` returns; M = nx + m columns: the window's own start [0, nx), then the probes.

    Attributes:
        X: states (N, nx); at a knot the window's start.
        S: sensitivities (N, nx, M); at a knot identity and zeros.
        X_end, S_end: (K, nx), (K, nx, M): where each window arrives at the next knot (the last one: at the last sample).
        Phi: (N, nx, nx), Phi[k + 1] = dx_{k+1}/dx_k; empty unless asked for. Phi[0] is the identity.
        status: 0, or 1 if some step did not converge; the rest of that window is NaN in X and 0 in S.
        failed: sample before the first step that failed, or -1.
    """

    X: np.ndarray
    S: np.ndarray
    X_end: np.ndarray
    S_end: np.ndarray
    Phi: np.ndarray
    status: int
    failed: int


@njit(cache=False)
def jacobian(x, f, w, t, P, E, A, moved, g):
    """Write A = df/dx (nx, nx) at x, where f = rhs(x), by forward differences; `moved` and `g` (nx,) are scratch."""
    for j in range(x.size):
        step = PRESSURE_EPSILON if 4 <= j < 8 else (RATE_EPSILON if j in (2, 3, 9) else POSITION_EPSILON)
        moved[:] = x
        moved[j] += step
        rhs(moved, w, t, P, E, g)
        for i in range(x.size):
            A[i, j] = (g[i] - f[i]) / step


@njit(cache=False)
def add_rows(target, factor, source):
    for c in range(target.size):
        target[c] += factor * source[c]


@njit(cache=False)
def solve_columns(A, pivot, R):
    """Replace R (n, M) by the solution of the system whose LU factors are in A."""
    n = A.shape[0]
    for k in range(n):
        if pivot[k] != k:
            for c in range(R.shape[1]):
                R[k, c], R[pivot[k], c] = R[pivot[k], c], R[k, c]
    for k in range(n):
        for i in range(k + 1, n):
            add_rows(R[i], -A[i, k], R[k])
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            add_rows(R[k], -A[k, j], R[j])
        factor = 1.0 / A[k, k]
        for c in range(R.shape[1]):
            R[k, c] *= factor


@njit(cache=False)
def right_side(S, A, h, R):
    """Write (I + h/2 A) S to R."""
    R[:] = S
    for i in range(A.shape[0]):
        for j in range(A.shape[0]):
            add_rows(R[i], 0.5 * h * A[i, j], S[j])


@njit(cache=False)
def left_factors(A, h, L, pivot):
    """Write the LU factors of I - h/2 A to L; False if singular."""
    for i in range(A.shape[0]):
        for j in range(A.shape[0]):
            L[i, j] = -0.5 * h * A[i, j]
        L[i, i] += 1.0
    return factorise(L, pivot)


class Base(NamedTuple):
    """What is differentiated: the base's vectors and those of the probes, inputs, and the grid."""

    P: np.ndarray
    E: np.ndarray
    P_cols: np.ndarray
    E_cols: np.ndarray
    delta: np.ndarray
    own: np.ndarray  # number of the probe's own tangent, or -1
    W_all: np.ndarray
    W_index: np.ndarray
    h: float
    t0: float
    substeps: int


class Tangents(NamedTuple):
    """A (nx, nx), b (nx, m) and the probes' own A (n_own, nx, nx) at one instant."""

    A: np.ndarray
    b: np.ndarray
    own: np.ndarray


class Moving(NamedTuple):
    """State, its rate and sensitivities (nx, M) as they move along, tangents before and after a step, and scratch."""

    x: np.ndarray
    f: np.ndarray
    S: np.ndarray
    before: Tangents
    after: Tangents
    R: np.ndarray
    L: np.ndarray
    pivot: np.ndarray
    vectors: np.ndarray
    inputs: np.ndarray


@njit(cache=False)
def new_tangents(nx, m, n_own):
    return Tangents(np.empty((nx, nx)), np.zeros((nx, m)), np.empty((n_own, nx, nx)))


@njit(cache=False)
def new_moving(nx, m, n_own, columns, n_inputs):
    """Return the arrays of a sweep with `columns` sensitivities, of which the last may be transitions."""
    return Moving(
        np.empty(nx), np.empty(nx), np.zeros((nx, columns)), new_tangents(nx, m, n_own), new_tangents(nx, m, n_own),
        np.empty((nx, columns)), np.empty((nx, nx)), np.empty(nx, np.int64), np.empty((5, nx)), np.empty((2, n_inputs)),
    )  # fmt: skip


@njit(cache=False)
def evaluate(base, v, k, share, t, into):
    """Write f = rhs, A, b and the probes' own A at the state v.x and at `share` of the way from sample k to k + 1."""
    x, f, w, g = v.x, v.f, v.inputs[1], v.vectors[0]
    last = min(k + 1, base.W_all.shape[1] - 1)
    between(base.W_all[0, k], base.W_all[0, last], share, w)
    rhs(x, w, t, base.P, base.E, f)
    jacobian(x, f, w, t, base.P, base.E, into.A, v.vectors[1], v.vectors[2])
    for j in range(base.delta.size):
        P, E, W = base.P_cols[j], base.E_cols[j], base.W_all[base.W_index[j]]
        between(W[k], W[last], share, w)
        rhs(x, w, t, P, E, g)
        for i in range(x.size):
            into.b[i, j] = (g[i] - f[i]) / base.delta[j]
        if base.own[j] >= 0:
            jacobian(x, g, w, t, P, E, into.own[base.own[j]], v.vectors[1], v.vectors[2])


@njit(cache=False)
def own_column(j, q, h, v):
    """Write column nx + j of R with the tangent of the probe itself; False if its system is singular."""
    nx = v.x.size
    column = v.S[:, nx + j : nx + j + 1].copy()
    moved = np.empty((nx, 1))
    right_side(column, v.before.own[q], h, moved)
    for i in range(nx):
        moved[i, 0] += 0.5 * h * (v.before.b[i, j] + v.after.b[i, j])
    if not left_factors(v.after.own[q], h, v.L, v.pivot):
        return False
    solve_columns(v.L, v.pivot, moved)
    v.R[:, nx + j] = moved[:, 0]
    return True


@njit(cache=False)
def linear_step(base, h, v):
    """Move the sensitivities over one step between the tangents before and after; False if a system is singular."""
    nx, m, R = v.x.size, base.delta.size, v.R
    right_side(v.S, v.before.A, h, R)
    for i in range(nx):
        for j in range(m):
            R[i, nx + j] += 0.5 * h * (v.before.b[i, j] + v.after.b[i, j])
    if not left_factors(v.after.A, h, v.L, v.pivot):
        return False
    solve_columns(v.L, v.pivot, R)
    for j in range(m):
        if base.own[j] >= 0 and not own_column(j, base.own[j], h, v):
            return False
    for k in range(4, 8):  # a pressure that is held at the floor depends on nothing
        if v.x[k] <= base.P[FLOOR] and v.f[k] <= 0.0:
            R[k] = 0.0
    v.S[:] = R
    return True


@njit(cache=False)
def advance_sample(base, k, v, work):
    """Move state and sensitivities from sample k to k + 1, in smaller pieces where needed; False if nothing helps."""
    x1, f1, w = v.vectors[3], v.vectors[4], v.inputs[0]
    done, pieces = 0.0, 1
    while done < base.substeps:
        until = min(float(base.substeps), done + 1.0 / pieces)
        share, h = until / base.substeps, (until - done) / base.substeps * base.h
        t = base.t0 + (k + share) * base.h
        between(base.W_all[0, k], base.W_all[0, k + 1], share, w)
        if newton(v.x, v.f, w, t, h, base.P, base.E, work, x1, f1):
            v.x[:] = x1
            evaluate(base, v, k, share, t, v.after)
            if not linear_step(base, h, v):
                return False
            v.before.A[:], v.before.b[:], v.before.own[:] = v.after.A, v.after.b, v.after.own
            done = until
        elif pieces < MAX_PIECES:
            pieces *= 4
        else:
            return False
    return True


@njit(cache=False)
def begin_window(base, k, start, v, work):
    """Set the state anew at sample k, sensitivities to identity and zeros, and forget the tangent of earlier windows."""
    v.x[:] = start
    v.S[:] = 0.0
    set_identity(v.S, 0)
    evaluate(base, v, k, 0.0, base.t0 + k * base.h, v.before)
    work[5][0] = 0.0


@njit(cache=False)
def set_identity(S, first):
    """Set the nx columns of S from `first` on to the identity."""
    for i in range(S.shape[0]):
        for j in range(S.shape[0]):
            S[i, first + j] = 1.0 if i == j else 0.0


@njit
def _sweep(x0_knots, knot_index, base, want_phi):
    N, (K, nx), m = base.W_all.shape[1], x0_knots.shape, base.delta.size
    M = nx + m
    n_own = base.own.max() + 1 if m > 0 else 0
    X, S = np.full((N, nx), math.nan), np.zeros((N, nx, M))
    X_end, S_end = np.full((K, nx), math.nan), np.zeros((K, nx, M))
    Phi = np.zeros((N if want_phi else 0, nx, nx))
    v, work = new_moving(nx, m, n_own, M + (nx if want_phi else 0), base.W_all.shape[2]), workspace(nx)
    status, failed, window, alive = OK, -1, -1, False
    for k in range(N):
        if window + 1 < K and knot_index[window + 1] == k:
            if alive:
                X_end[window], S_end[window] = v.x, v.S[:, :M]
            window += 1
            begin_window(base, k, x0_knots[window], v, work)
            alive = True
        if not alive:
            continue
        X[k], S[k] = v.x, v.S[:, :M]
        if k == N - 1:
            X_end[window], S_end[window] = v.x, v.S[:, :M]
            continue
        if want_phi:
            set_identity(v.S, M)
        alive = advance_sample(base, k, v, work)
        if want_phi and alive:
            Phi[k + 1] = v.S[:, M:]
        if not alive and failed < 0:
            status, failed = NOT_CONVERGED, k
    if want_phi:
        set_identity(Phi[0], 0)
    return X, S, X_end, S_end, Phi, status, failed


def sweep(
    x0_knots: np.ndarray,
    knot_index: np.ndarray,
    W_all: np.ndarray,
    h: float,
    t0: float,
    P: np.ndarray,
    E: np.ndarray,
    P_cols: np.ndarray,
    E_cols: np.ndarray,
    delta: np.ndarray,
    W_index: np.ndarray | None = None,
    *,
    own: np.ndarray | None = None,
    substeps: int = 1,
    want_phi: bool = False,
) -> Sweep:
    """Return states and sensitivities along a run in windows; see `Sweep` for the shapes. Releases the global lock.

    Args:
        x0_knots: (K, nx) state at the start of each window; nx is 8, or 10 with a pendulum in the base or a probe.
        knot_index: (K,) sample at which each window starts, increasing; usually begins with 0.
        W_all: (n_W, N, 4) input signals [U1 U2 pp pt] on the sample grid, linear between; the first is the base's. With
            (n_W, N, 12) the eight disturbances of `engine.DISTURBANCES` follow, so that unknown inputs can be probed.
        h, t0: sample interval and time of the first sample, s.
        P, E: the base's parameters and effects.
        P_cols, E_cols: (m, len P), (m, len E): those of each probe.
        delta: (m,) what each column is divided by: the change in its parameter, or 1.
        W_index: (m,) which input signal a probe has; the base's by default.
        own: (m,) bool, which probes use the tangent of their own.
        substeps: steps of the trapezoidal rule per sample interval.
        want_phi: whether to return the one-sample transition matrices.
    """
    m = len(delta)
    index = np.zeros(m, np.int64) if W_index is None else np.ascontiguousarray(W_index, np.int64)
    owned = np.full(m, -1, np.int64)
    if own is not None:
        owned[np.asarray(own, bool)] = np.arange(np.count_nonzero(own))
    x0, W, P, E, P_cols, E_cols, delta = (
        np.ascontiguousarray(a, float) for a in (x0_knots, W_all, P, E, P_cols, E_cols, delta)
    )
    base = Base(P, E, P_cols, E_cols, delta, owned, W, index, float(h), float(t0), int(substeps))
    return Sweep(*_sweep(x0, np.ascontiguousarray(knot_index, np.int64), base, bool(want_phi)))
