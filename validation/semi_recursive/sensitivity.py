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


@njit(cache=False)
def probe(j, x, f, w, t, P_cols, E_cols, delta, own, b, A_own, scratch):
    """Write column j of b (nx, m), and A of the probe where it has a tangent of its own."""
    g = scratch[0]
    rhs(x, w, t, P_cols[j], E_cols[j], g)
    for i in range(x.size):
        b[i, j] = (g[i] - f[i]) / delta[j]
    if own[j] >= 0:
        jacobian(x, g, w, t, P_cols[j], E_cols[j], A_own[own[j]], scratch[1], scratch[2])


@njit(cache=False)
def linear_step(nx, h, A0, A1, b0, b1, A0_own, A1_own, own, S, R, L, pivot, floored):
    """Move the sensitivities S (nx, M) over one step; False if the linear system is singular."""
    right_side(S, A0, h, R)
    for i in range(nx):
        for j in range(b0.shape[1]):
            R[i, nx + j] += 0.5 * h * (b0[i, j] + b1[i, j])
    if not left_factors(A1, h, L, pivot):
        return False
    solve_columns(L, pivot, R)
    for j in range(b0.shape[1]):
        q = own[j]
        if q < 0:
            continue
        column = np.ascontiguousarray(S[:, nx + j : nx + j + 1])
        own_R = np.empty((nx, 1))
        right_side(column, A0_own[q], h, own_R)
        for i in range(nx):
            own_R[i, 0] += 0.5 * h * (b0[i, j] + b1[i, j])
        if not left_factors(A1_own[q], h, L, pivot):
            return False
        solve_columns(L, pivot, own_R)
        R[:, nx + j] = own_R[:, 0]
    for k in range(4, 8):  # a pressure that is held at the floor depends on nothing
        if floored[k]:
            R[k] = 0.0
    S[:] = R
    return True


@njit
def _sweep(x0_knots, knot_index, W_all, h_sample, t0, P, E, P_cols, E_cols, delta, W_index, own, substeps, want_phi):
    N, nx, m, K = W_all.shape[1], x0_knots.shape[1], delta.size, knot_index.size
    M = nx + m
    extra = nx if want_phi else 0
    n_own = own.max() + 1 if m > 0 else 0
    X, S_out = np.full((N, nx), math.nan), np.zeros((N, nx, M))
    X_end, S_end = np.full((K, nx), math.nan), np.zeros((K, nx, M))
    Phi = np.zeros((N if want_phi else 0, nx, nx))
    work = workspace(nx)
    S, R = np.zeros((nx, M + extra)), np.empty((nx, M + extra))
    A0, A1, L, pivot = np.empty((nx, nx)), np.empty((nx, nx)), np.empty((nx, nx)), np.empty(nx, np.int64)
    b0, b1 = np.zeros((nx, m)), np.zeros((nx, m))
    A0_own, A1_own = np.empty((n_own, nx, nx)), np.empty((n_own, nx, nx))
    scratch, w, wj = np.empty((3, nx)), np.empty(W_all.shape[2]), np.empty(W_all.shape[2])
    x, f, x1, f1, floored = np.empty(nx), np.empty(nx), np.empty(nx), np.empty(nx), np.zeros(nx, np.bool_)
    status, failed, window, alive = OK, -1, -1, False
    for k in range(N):
        if window + 1 < K and knot_index[window + 1] == k:
            if window >= 0 and alive:
                X_end[window], S_end[window] = x, S[:, :M]
            window += 1
            alive = True
            x[:] = x0_knots[window]
            S[:] = 0.0
            for i in range(nx):
                S[i, i] = 1.0
            t = t0 + k * h_sample
            rhs(x, W_all[0, k], t, P, E, f)
            jacobian(x, f, W_all[0, k], t, P, E, A0, scratch[1], scratch[2])
            for j in range(m):
                probe(j, x, f, W_all[W_index[j], k], t, P_cols, E_cols, delta, own, b0, A0_own, scratch)
            work[5][0] = 0.0  # windows do not know of each other
        if alive:
            X[k], S_out[k] = x, S[:, :M]
        if k == N - 1 or not alive:
            continue
        if want_phi:
            for i in range(nx):
                for j in range(nx):
                    S[i, M + j] = 1.0 if i == j else 0.0
        done, pieces = 0.0, 1
        while done < substeps and alive:
            until = min(float(substeps), done + 1.0 / pieces)
            share = until / substeps
            h = (until - done) / substeps * h_sample
            t = t0 + (k + share) * h_sample
            between(W_all[0, k], W_all[0, k + 1], share, w)
            if not newton(x, f, w, t, h, P, E, work, x1, f1):
                pieces *= 4
                alive = pieces <= MAX_PIECES
                continue
            x[:] = x1
            rhs(x, w, t, P, E, f)
            jacobian(x, f, w, t, P, E, A1, scratch[1], scratch[2])
            for j in range(m):
                between(W_all[W_index[j], k], W_all[W_index[j], k + 1], share, wj)
                probe(j, x, f, wj, t, P_cols, E_cols, delta, own, b1, A1_own, scratch)
            for i in range(4, 8):
                floored[i] = x[i] <= P[FLOOR] and f[i] <= 0.0
            alive = linear_step(nx, h, A0, A1, b0, b1, A0_own, A1_own, own, S, R, L, pivot, floored)
            A0, A1 = A1, A0
            b0, b1 = b1, b0
            A0_own, A1_own = A1_own, A0_own
            done = until
        if not alive and failed < 0:
            status, failed = NOT_CONVERGED, k
        if want_phi and alive:
            Phi[k + 1] = S[:, M:]
    if window >= 0 and alive:
        X_end[window], S_end[window] = x, S[:, :M]
    if want_phi:
        for i in range(nx):
            Phi[0, i, i] = 1.0
    return X, S_out, X_end, S_end, Phi, status, failed


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
    arrays = (np.ascontiguousarray(a, float) for a in (x0_knots, W_all, P, E, P_cols, E_cols, delta))
    x0, W, P, E, P_cols, E_cols, delta = arrays
    knots = np.ascontiguousarray(knot_index, np.int64)
    result = _sweep(
        x0, knots, W, float(h), float(t0), P, E, P_cols, E_cols, delta, index, owned, int(substeps), bool(want_phi)
    )
    return Sweep(*result)
