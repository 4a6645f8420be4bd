"""Derivatives of a run with respect to its start and to any number of parameters, effects and inputs, in one sweep.

The trapezoidal step y(x1) - y(x0) = h/2 [g(x0) + g(x1)], y positions, rates and amounts of oil, is differentiated as it
stands (implicit differentiation), with Y = dy/dx, G = dg/dx and, for a probe, c = [y(x; probe) - y(x; base)] / delta, b
likewise of g:

    (Y1 - h/2 G1) S1 = (Y0 + h/2 G0) S0 + c0 - c1 + h/2 (b0 + b1)

A column is a probe: another P, another E, other inputs, or several at once. Its b and c are one-sided differences from
the base to the probe, so an effect whose law is not smooth at its neutral value is probed at a finite size.

Many windows may be swept in one call, one after the other: each has samples and a first state of its own.

Most of the time goes into the probes' b and c. A probe that leaves the bodies as they are (an orifice, a leak) takes
the base's mechanics.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from crane_exudyn.compiled import njit
from crane_exudyn.effects.registry import slots_of
from crane_exudyn.machine import CYLINDERS
from crane_exudyn.parameters import CYLINDER, FLUID, N_CYLINDER, PAYLOAD
from crane_exudyn.step_control import MOST_HALVINGS, limit, next_level

from .equations import amounts, balance, rates, settle_pressures
from .hydraulics import read_pressures
from .kernel import (
    ALLOWED,
    ERROR,
    HALVED,
    LEVEL,
    LIMIT,
    NOT_CONVERGED,
    OK,
    PARTS,
    PATIENCE,
    PATIENT,
    TOO_COARSE,
    Point,
    begin,
    between,
    exhausted,
    factorise,
    forget,
    most_parts,
    point,
    remember,
    try_step,
    workspace,
)
from .sheet import Sheet, sheet

POSITION_EPSILON, RATE_EPSILON, PRESSURE_EPSILON = 1e-6, 1e-6, 1e2
#: hooks that `mechanics` calls
MECHANICAL = frozenset({"gravity", "payload_mass", "pendulum"})
#: amounts of oil are counted in this unit, m^3: an angle of 1 rad moves some of it
AMOUNT = 1e-3


class Sweep(NamedTuple):
    """What `sweep` returns; M = nx + m columns: the window's own start [0, nx), then the probes.

    Attributes:
        X: states (N, nx).
        S: sensitivities (N, nx, M); where a window begins identity and zeros.
        Phi: (N, nx, nx), Phi[k + 1] = dx_{k+1}/dx_k within a window; empty unless asked for. Where a window begins the
            identity.
        status: (K,) of the kernel; where a step failed, or the run had more parts than a fit's may (`most_parts`), the
            rest of that window is NaN in X and 0 in S.
        failed: (K,) sample before the first step of a window that failed, or -1.
        halved: how many steps were halved.
    """

    X: np.ndarray
    S: np.ndarray
    Phi: np.ndarray
    status: np.ndarray
    failed: np.ndarray
    halved: int


@njit
def tangents_at(here, w, t, P, E, s, Y, G, moved):
    """Write Y = dN/dx (2n, nx) in AMOUNT and G = dg/dx (nx, nx) around the Point that was filled last, by forward
    differences.
    """
    nx, n = here.x.size, here.N.size
    for k in range(nx):
        j = (n + k) % nx  # pressures first: for them the mechanics of the Point stand
        pressure = holds_oil(j, n)
        step = PRESSURE_EPSILON if pressure else (RATE_EPSILON if is_rate(j, n) else POSITION_EPSILON)
        moved.x[:] = here.x
        moved.x[j] += step
        if pressure:
            read_pressures(moved.x, P, E, s)
            balance(moved.x, w, t, P, E, s)
            amounts(s, moved.N)
            rates(moved.x, s, moved.g)
        else:
            begin(moved, w, t, P, E, s)
        for i in range(n):
            Y[i, j] = (moved.N[i] - here.N[i]) / (step * AMOUNT)
        for i in range(nx):
            G[i, j] = in_units(i, n, moved.g[i] - here.g[i]) / step


@njit(inline="always")
def holds_oil(i, n):
    """Return whether row i of a state is that of a chamber, of which there are n: behind as many coordinates and
    rates.
    """
    return n <= i < 2 * n


@njit(inline="always")
def is_rate(i, n):
    """Return whether row i of a state is that of a rate, the pendulum's being the last."""
    return n <= 2 * i < 2 * n or i == 2 * n + 1


@njit(inline="always")
def in_units(i, n, rate):
    """Return a rate in the unit of row i: amounts of oil are counted in AMOUNT."""
    return rate / AMOUNT if holds_oil(i, n) else rate


@njit
def add_rows(target, factor, source):
    for c in range(target.size):
        target[c] += factor * source[c]


@njit
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


@njit
def right_side(S, Y, G, h, R):
    """Write (dy/dx + h/2 G) S to R."""
    n = Y.shape[0]
    for i in range(G.shape[0]):
        if holds_oil(i, n):
            R[i] = 0.0
            for j in range(G.shape[0]):
                add_rows(R[i], Y[i - n, j] + 0.5 * h * G[i, j], S[j])
        else:
            R[i] = S[i]
            for j in range(G.shape[0]):
                add_rows(R[i], 0.5 * h * G[i, j], S[j])


@njit
def left_factors(Y, G, h, L, pivot):
    """Write the LU factors of dy/dx - h/2 G to L; False if singular."""
    n = Y.shape[0]
    for i in range(G.shape[0]):
        for j in range(G.shape[0]):
            L[i, j] = (Y[i - n, j] if holds_oil(i, n) else (1.0 if i == j else 0.0)) - 0.5 * h * G[i, j]
    return factorise(L, pivot)


class Base(NamedTuple):
    """What is differentiated: the base's vectors and those of the probes, inputs, and the grid."""

    P: np.ndarray
    E: np.ndarray
    P_cols: np.ndarray
    E_cols: np.ndarray
    bodies: np.ndarray  # (m,) whether a probe's bodies, points or weights differ from the base's
    delta: np.ndarray
    W_all: np.ndarray
    W_index: np.ndarray
    h: float
    t0: float
    substeps: int
    allowed: float  # local error of a step, in units of step_control.*_ERROR
    most: float  # parts that a step may have on the average


class Tangents(NamedTuple):
    """Y (2n, nx), G (nx, nx), c (2n, m) and b (nx, m) at one instant."""

    Y: np.ndarray
    G: np.ndarray
    c: np.ndarray
    b: np.ndarray


class Moving(NamedTuple):
    """A Point and its sensitivities (nx, M) as they move along, tangents before and after a step, and scratch."""

    sheet: Sheet
    now: Point
    S: np.ndarray
    before: Tangents
    after: Tangents
    R: np.ndarray
    L: np.ndarray
    pivot: np.ndarray
    probed: Point
    moved: Point
    inputs: np.ndarray


@njit
def new_tangents(nx, chambers, m):
    return Tangents(np.empty((chambers, nx)), np.empty((nx, nx)), np.zeros((chambers, m)), np.zeros((nx, m)))


@njit
def new_moving(topology, nx, m, columns, n_inputs):
    """Return the arrays of a sweep with `columns` sensitivities, of which the last may be transitions."""
    n = topology[0, CYLINDERS]
    return Moving(
        sheet(topology), point(nx, n), np.zeros((nx, columns)), new_tangents(nx, 2 * n, m), new_tangents(nx, 2 * n, m),
        np.empty((nx, columns)), np.empty((nx, nx)), np.empty(nx, np.int64), point(nx, n), point(nx, n),
        np.empty((4, n_inputs)),
    )  # fmt: skip


@njit
def evaluate(base, v, k, share, t, into):
    """Fill v.now from its state, at `share` of the way from sample k to k + 1, and the tangents there with those of the
    probes.
    """
    between(base.W_all[0, k], base.W_all[0, min(k + 1, base.W_all.shape[1] - 1)], share, v.inputs[2])
    begin(v.now, v.inputs[2], t, base.P, base.E, v.sheet)
    for bodies in (False, True):  # written as two calls, each is compiled for its constant
        take_probes(base, v, k, share, t, bodies, into)  # first those for which the mechanics of the base stand
        if not bodies:
            tangents_at(v.now, v.inputs[2], t, base.P, base.E, v.sheet, into.Y, into.G, v.moved)


@njit
def take_probes(base, v, k, share, t, bodies, into):
    """Write b and c of the probes whose bodies differ from the base's, or of those whose do not: then its mechanics
    must stand in the sheet.
    """
    now, w, probed, last = v.now, v.inputs[3], v.probed, min(k + 1, base.W_all.shape[1] - 1)
    for j in range(base.delta.size):
        if base.bodies[j] != bodies:
            continue
        P, E, W = base.P_cols[j], base.E_cols[j], base.W_all[base.W_index[j]]
        between(W[k], W[last], share, w)
        probed.x[:] = now.x
        if bodies:
            begin(probed, w, t, P, E, v.sheet)
        else:
            read_pressures(probed.x, P, E, v.sheet)
            balance(probed.x, w, t, P, E, v.sheet)
            amounts(v.sheet, probed.N)
            rates(probed.x, v.sheet, probed.g)
        for i in range(now.N.size):
            into.c[i, j] = (probed.N[i] - now.N[i]) / (base.delta[j] * AMOUNT)
        for i in range(now.x.size):
            into.b[i, j] = in_units(i, now.N.size, probed.g[i] - now.g[i]) / base.delta[j]


@njit
def add_probe(j, h, n, first, second, column):
    """Add c0 - c1 + h/2 (b0 + b1) of probe j to a column (nx,); n chambers."""
    for i in range(column.size):
        column[i] += 0.5 * h * (first.b[i, j] + second.b[i, j])
        if holds_oil(i, n):
            column[i] += first.c[i - n, j] - second.c[i - n, j]


@njit
def linear_step(base, h, first, second, v):
    """Move the sensitivities over one step between two tangents; False if a system is singular."""
    nx, m, n, R = v.now.x.size, base.delta.size, v.now.N.size, v.R
    right_side(v.S, first.Y, first.G, h, R)
    for j in range(m):
        add_probe(j, h, n, first, second, R[:, nx + j])
    if not left_factors(second.Y, second.G, h, v.L, v.pivot):
        return False
    solve_columns(v.L, v.pivot, R)
    v.S[:] = R
    return True


@njit
def copy_tangents(source, target):
    target.Y[:], target.G[:], target.c[:], target.b[:] = source.Y, source.G, source.c, source.b


@njit
def step_part(base, k, done, level, v, work):
    """Move the state by a part of the step that begins at `done` (in steps) of sample k; return a status and the length
    of the part, s. A part that is not OK leaves it where it is.
    """
    wa, wb, part = v.inputs[0], v.inputs[1], 0.5**level
    start, end = done / base.substeps, (done + part) / base.substeps
    h, t = part * base.h / base.substeps, base.t0 + (k + start) * base.h
    between(base.W_all[0, k], base.W_all[0, k + 1], start, wa)
    between(base.W_all[0, k], base.W_all[0, k + 1], end, wb)
    work.said[LIMIT] = limit(level, h, work.said[ALLOWED])
    work.said[PARTS] += 1.0
    status = try_step(v.now, wa, wb, t, h, base.P, base.E, work, level)
    if status == OK:
        remember(v.now, h, work)
        v.now.x[:] = work.end.x
        settle_pressures(v.now.x, work.end.N, base.P, base.E, v.sheet)
    return status, h


@njit
def advance_sample(base, k, v, work):
    """Move state and sensitivities from sample k to k + 1; a step that fails is halved, and its halves again. Return a
    status.
    """
    done, level = 0.0, int(work.said[LEVEL])  # in steps
    while done < base.substeps:
        status, h = step_part(base, k, done, level, v, work)
        if status == OK:
            done += 0.5**level
            end = done / base.substeps
            evaluate(base, v, k, end, base.t0 + (k + end) * base.h, v.after)
            if not linear_step(base, h, v.before, v.after, v):
                return NOT_CONVERGED
            copy_tangents(v.after, v.before)
            level = next_level(level, done, h, work.said[ERROR], work.said[ALLOWED])
        elif level < MOST_HALVINGS:
            level += 1
            work.said[HALVED] += 1.0
        else:
            return status
    work.said[LEVEL] = level
    return OK


@njit
def begin_window(base, k, start, v, work):
    """Set the state anew at sample k, sensitivities to identity and zeros, and forget the tangent of earlier
    windows.
    """
    v.now.x[:] = start
    v.S[:] = 0.0
    set_identity(v.S, 0)
    evaluate(base, v, k, 0.0, base.t0 + k * base.h, v.before)
    work.made[:] = 0.0
    work.said[PARTS] = 0.0
    forget(work)


@njit
def set_identity(S, first):
    """Set the nx columns of S from `first` on to the identity."""
    for i in range(S.shape[0]):
        for j in range(S.shape[0]):
            S[i, first + j] = 1.0 if i == j else 0.0


@njit
def run_window(first, end, v, base, work, X, S, Phi):
    """Move states and sensitivities from sample `first`, at which v stands, to the last one before `end`; return a
    status, and the sample before the step that failed.
    """
    k, want_phi, M = first, Phi.shape[0] > 0, S.shape[2]
    while True:
        X[k], S[k] = v.now.x, v.S[:, :M]
        if k == end - 1:
            return OK, -1
        if want_phi:
            set_identity(v.S, M)
        status = advance_sample(base, k, v, work)
        if status == OK and exhausted((k + 1 - first) * base.substeps, base.most, work):
            status = TOO_COARSE
        if status != OK:
            return status, k
        k += 1
        if want_phi:
            Phi[k] = v.S[:, M:]


@njit
def _sweep(x0, first, steps, begins, base, topology, want_phi):
    N, (K, nx), m = base.W_all.shape[1], x0.shape, base.delta.size
    M = nx + m
    X, S = np.full((N, nx), math.nan), np.zeros((N, nx, M))
    Phi = np.zeros((N if want_phi else 0, nx, nx))
    status, failed = np.zeros(K, np.int64), np.full(K, -1, np.int64)
    v = new_moving(topology, nx, m, M + (nx if want_phi else 0), base.W_all.shape[2])
    work = workspace(topology, nx, base.W_all.shape[2])
    work.said[ALLOWED], work.said[PATIENCE] = base.allowed, PATIENT
    for w in range(K):
        k, end = first[w], first[w + 1] if w + 1 < K else N
        own = Base(
            base.P, base.E, base.P_cols, base.E_cols, base.bodies, base.delta, base.W_all, base.W_index, steps[w],
            begins[w] - k * steps[w], base.substeps, base.allowed, base.most,
        )  # fmt: skip
        begin_window(own, k, x0[w], v, work)
        if want_phi:
            set_identity(Phi[k], 0)
        status[w], failed[w] = run_window(k, end, v, own, work, X, S, Phi)
    return X, S, Phi, status, failed, int(work.said[HALVED])


def moves_bodies(P: np.ndarray, E: np.ndarray, P_cols: np.ndarray, E_cols: np.ndarray, cylinders: int) -> np.ndarray:
    """Return (m,) whether probes differ from the base in what `mechanics` reads: bodies, points, payload, gravity."""
    moved = P_cols != P
    moved[:, FLUID:PAYLOAD] = moved[:, CYLINDER : CYLINDER + N_CYLINDER * cylinders] = False
    laws = slots_of(MECHANICAL)
    return np.asarray(moved.any(axis=1) | (E_cols[:, laws] != E[laws]).any(axis=1))


def sweep(
    x0: np.ndarray,
    first: np.ndarray,
    W_all: np.ndarray,
    h: float | np.ndarray,
    t0: float | np.ndarray,
    P: np.ndarray,
    E: np.ndarray,
    P_cols: np.ndarray,
    E_cols: np.ndarray,
    delta: np.ndarray,
    W_index: np.ndarray | None = None,
    *,
    topology: np.ndarray,
    substeps: int = 1,
    allowed: float = 1.0,
    want_phi: bool = False,
) -> Sweep:
    """Return states and sensitivities along the runs of K windows; see `Sweep` for the shapes. Releases the global
    lock.

    Args:
        x0: (K, nx) state at the start of each window; with n coordinates nx is 4n, or 4n + 2 with a pendulum in the
            base or a probe.
        first: (K,) first sample of each window, increasing from 0; it ends before that of the next one.
        W_all: (n_W, N, n + 2) input signals [U pp pt] at the samples, linear between; the first is the base's. With
            (n_W, N, 4n + 4) the disturbances of the layout follow, so that unknown inputs can be probed.
        h, t0: sample interval and time of the first sample, s, of all windows or (K,) of each.
        P, E: the base's parameters and effects.
        P_cols, E_cols: (m, len P), (m, len E): those of each probe.
        delta: (m,) what each column is divided by: the change in its parameter, or 1.
        W_index: (m,) which input signal a probe has; the base's by default.
        topology: of the machine.
        substeps: steps of the trapezoidal rule per sample interval.
        allowed: local error of a step in units of `step_control.*_ERROR`; a step beyond it is halved.
        want_phi: whether to return the one-sample transition matrices.
    """
    m, K = len(delta), len(x0)
    index = np.zeros(m, np.int64) if W_index is None else np.ascontiguousarray(W_index, np.int64)
    x0, W, P, E, P_cols, E_cols, delta = (
        np.ascontiguousarray(a, float) for a in (x0, W_all, P, E, P_cols, E_cols, delta)
    )
    steps, begins = (np.broadcast_to(a, K).astype(float) for a in (h, t0))  # what is read only is compiled anew
    bodies = moves_bodies(P, E, P_cols, E_cols, topology[0, CYLINDERS])
    base = Base(
        P, E, P_cols, E_cols, bodies, delta, W, index, 0.0, 0.0, int(substeps), float(allowed),
        most_parts(allowed, float(steps.max()) / substeps),
    )  # fmt: skip
    return Sweep(*_sweep(x0, np.ascontiguousarray(first, np.int64), steps, begins, base, topology, bool(want_phi)))
