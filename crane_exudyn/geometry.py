"""Planar geometry of a machine: bodies, joints, loops and cylinders, from the independent coordinates on, and its velocities.

Frames: x forward, y up, angles counter-clockwise. A body's frame has its own pin where its carrier's pin is; on a prismatic joint it is
parallel to its carrier's, away from the pin by the coordinate along the joint's direction. The two dependent bodies of a loop close
the triangle B-C-D of their pins, C on one side of the line from B to D. ::

                C                     B: pin of the first dependent body on its carrier
              o   o                   C: pin between both dependent bodies
       first /     \\ second          D: pin of the second one on the body that the loop ends on
            o       o
            B       D

`topology` is `Machine.topology`, P the vector of nominal parameters. A body's reference point is given by the columns COM_X, COM_Y
of a table `inertia` (bodies, 4): its centre of mass in its own frame, or zeros for its origin. Redundant coordinates q and
velocities v hold x, y of the reference point and the angle of each body.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .compiled import njit
from .crane import Crane
from .errors import CraneError
from .layout import Layout
from .machine import (
    BASE,
    BASE_BODY,
    BODIES,
    CARRIER,
    COORDINATE,
    CUT_PIN,
    CYLINDERS,
    DEPENDENT,
    DIRECTION,
    FIRST_OF_LOOP,
    KIND,
    LAST,
    LAST_PIN,
    LOOPS,
    OWN_PIN,
    PIN,
    ROD_BODY,
    ROD_END,
    SECOND_OF_LOOP,
    SIDE,
    SLIDES,
    TIP_BODY,
    TIP_POINT,
)

#: columns of the table of frames (bodies, 5): origin, angle, its cosine and sine
X, Y, ANGLE, COS, SIN, N_FRAME = range(6)
#: columns of a table of masses: mass, centre of mass in the body's frame, inertia about it
MASS, COM_X, COM_Y, INERTIA = range(4)
#: The table of arms holds vectors from a body's reference point to a point of it, in the fixed frame (from the origin, on the ground).
#: A row a body: its own pin, the pin on its carrier, the direction in which it slides and how far it has slid.
#: Then a row a loop: the pin of the second dependent body where it is cut, and that on the body that the loop ends on.
#: Then a row a cylinder: base and rod end. The last row: the payload's point, and from there the pendulum's rod.
OWN, CARRIED, ALONG, WAY, N_ARM = 0, 2, 4, 6, 7
FIRST_END, SECOND_END = 0, 2
#: columns of the table of cylinders as lines (cylinders, 4): length, its rate, direction from base to rod end
LENGTH, RATE, E_X, E_Y, N_LINE = range(5)


@njit
def arm_rows(topology):
    """Return how many rows a table of arms has."""
    return topology[0, BODIES] + topology[0, LOOPS] + topology[0, CYLINDERS] + 1


@njit
def joint_rows(topology):
    """Return how many joint equations there are, without a pendulum's."""
    return 2 * (topology[0, BODIES] + topology[0, LOOPS])


@njit
def _place(P, point, axis):
    return P[point + axis] if point >= 0 else 0.0


@njit
def _at(P, frames, body, point):
    """Return x, y of a point of a body (-1: the ground, where it is the point itself)."""
    x, y = _place(P, point, 0), _place(P, point, 1)
    if body < 0:
        return x, y
    f = frames[body]
    return f[X] + f[COS] * x - f[SIN] * y, f[Y] + f[SIN] * x + f[COS] * y


@njit
def _set_frame(P, f, angle, own_pin, x, y):
    """Fill a frame (5,) of an angle whose own pin lies at x, y."""
    c, s = math.cos(angle), math.sin(angle)
    px, py = _place(P, own_pin, 0), _place(P, own_pin, 1)
    f[X], f[Y], f[ANGLE], f[COS], f[SIN] = x - c * px + s * py, y - s * px - c * py, angle, c, s


@njit
def _close_loop(topology, P, frames, l):
    """Fill the frames of the dependent bodies of loop l; return whether it can be closed."""
    loop = topology[1 + topology[0, BODIES] + l]
    first = loop[DEPENDENT]
    one, two = topology[1 + first], topology[2 + first]
    bx, by = _at(P, frames, one[CARRIER], one[PIN])
    dx, dy = _at(P, frames, loop[LAST], loop[LAST_PIN])
    carrier = frames[one[CARRIER], ANGLE] if one[CARRIER] >= 0 else 0.0
    c, s = math.cos(carrier), math.sin(carrier)
    x, y = c * (dx - bx) + s * (dy - by), c * (dy - by) - s * (dx - bx)  # from B to D, as the carrier sees it
    x1, y1 = _place(P, two[PIN], 0) - _place(P, one[OWN_PIN], 0), _place(P, two[PIN], 1) - _place(P, one[OWN_PIN], 1)
    x2, y2 = _place(P, loop[CUT_PIN], 0) - _place(P, two[OWN_PIN], 0), _place(P, loop[CUT_PIN], 1) - _place(P, two[OWN_PIN], 1)
    r1, r2 = math.hypot(x1, y1), math.hypot(x2, y2)
    # cosine of the turn from B->C to C->D; C on the left of B->D makes it a turn to the right
    cos_turn = (x * x + y * y - r1 * r1 - r2 * r2) / (2.0 * r1 * r2)
    if not abs(cos_turn) < 1.0:
        return False
    turn = -loop[SIDE] * math.acos(cos_turn)
    at_b = math.atan2(-r2 * math.sin(turn), r1 + r2 * cos_turn)
    angle = carrier + math.atan2(y, x) + at_b - math.atan2(y1, x1)
    _set_frame(P, frames[first], angle, one[OWN_PIN], bx, by)
    cx, cy = _at(P, frames, first, two[PIN])
    _set_frame(P, frames[first + 1], angle + turn + math.atan2(y1, x1) - math.atan2(y2, x2), two[OWN_PIN], cx, cy)
    return True


@njit
def fill_frames(topology, P, z, frames):
    """Fill the frames (bodies, 5) at the independent coordinates in z; return -1, or the loop that cannot be closed."""
    l = 0
    for b in range(topology[0, BODIES]):
        body = topology[1 + b]
        if body[KIND] == SECOND_OF_LOOP:
            continue
        if body[KIND] == FIRST_OF_LOOP:
            while topology[1 + topology[0, BODIES] + l, DEPENDENT] != b:
                l = (l + 1) % topology[0, LOOPS]
            if not _close_loop(topology, P, frames, l):
                return l
            continue
        x, y = _at(P, frames, body[CARRIER], body[PIN])
        angle = frames[body[CARRIER], ANGLE] if body[CARRIER] >= 0 else 0.0
        if body[KIND] == SLIDES:
            way, direction = z[body[COORDINATE]], angle + P[body[DIRECTION]]
            x, y = x + way * math.cos(direction), y + way * math.sin(direction)
        else:
            angle += z[body[COORDINATE]]
        _set_frame(P, frames[b], angle, body[OWN_PIN], x, y)
    return -1


@njit
def _arm(P, inertia, body, point, c, s, arms, row, column):
    """Write the arm of a point of a body with cosine and sine of its angle into columns of a row of arms."""
    x, y = _place(P, point, 0), _place(P, point, 1)
    if body >= 0:
        x, y = x - inertia[body, COM_X], y - inertia[body, COM_Y]
    arms[row, column] = c * x - s * y
    arms[row, column + 1] = s * x + c * y


@njit
def fill_arms(topology, P, inertia, q, turns, arms):
    """Fill the table of arms (but for the pendulum's rod) for redundant coordinates q, which may violate the joints a little.

    turns (bodies + 1, 2) is filled with cosine and sine of the bodies' angles; the last row is the ground's.
    """
    n, n_loops, n_cylinders = topology[0, BODIES], topology[0, LOOPS], topology[0, CYLINDERS]
    turns[n, 0], turns[n, 1] = 1.0, 0.0
    for b in range(n):
        turns[b, 0], turns[b, 1] = math.cos(q[3 * b + 2]), math.sin(q[3 * b + 2])
    for b in range(n):
        body = topology[1 + b]
        k = body[CARRIER]
        ck, sk = turns[k, 0], turns[k, 1]  # of the ground: -1
        _arm(P, inertia, b, body[OWN_PIN], turns[b, 0], turns[b, 1], arms, b, OWN)
        _arm(P, inertia, k, body[PIN], ck, sk, arms, b, CARRIED)
        if body[KIND] == SLIDES:
            c, s = math.cos(P[body[DIRECTION]]), math.sin(P[body[DIRECTION]])
            ux, uy = ck * c - sk * s, sk * c + ck * s
            x, y = _point(q, k, arms, b, CARRIED)
            own_x, own_y = _point(q, b, arms, b, OWN)
            arms[b, ALONG], arms[b, ALONG + 1] = ux, uy
            arms[b, WAY] = ux * (own_x - x) + uy * (own_y - y)
    for l in range(n_loops):
        loop, row = topology[1 + n + l], n + l
        second, last = loop[DEPENDENT] + 1, loop[LAST]
        _arm(P, inertia, second, loop[CUT_PIN], turns[second, 0], turns[second, 1], arms, row, FIRST_END)
        _arm(P, inertia, last, loop[LAST_PIN], turns[last, 0], turns[last, 1], arms, row, SECOND_END)
    for c in range(n_cylinders):
        cylinder, row = topology[1 + n + n_loops + c], n + n_loops + c
        k, b = cylinder[BASE_BODY], cylinder[ROD_BODY]
        _arm(P, inertia, k, cylinder[BASE], turns[k, 0], turns[k, 1], arms, row, FIRST_END)
        _arm(P, inertia, b, cylinder[ROD_END], turns[b, 0], turns[b, 1], arms, row, SECOND_END)
    tip, row = topology[0, TIP_BODY], n + n_loops + n_cylinders
    _arm(P, inertia, tip, topology[0, TIP_POINT], turns[tip, 0], turns[tip, 1], arms, row, FIRST_END)


@njit
def _point(q, body, arms, row, column):
    """Return x, y of the point at the end of an arm of a body (-1: the ground)."""
    x, y = arms[row, column], arms[row, column + 1]
    return (x, y) if body < 0 else (q[3 * body] + x, q[3 * body + 1] + y)


@njit
def point_velocity(v, body, arms, row, column):
    """Return the velocity of the point at the end of an arm of a body (-1: the ground, at rest)."""
    if body < 0:
        return 0.0, 0.0
    rate = v[3 * body + 2]
    return v[3 * body] - rate * arms[row, column + 1], v[3 * body + 1] + rate * arms[row, column]


@njit
def close_position(topology, P, inertia, z, frames, turns, arms, q):
    """Fill frames, arms and the bodies' part of q for the independent coordinates in z; return -1 or the loop that cannot be closed."""
    failed = fill_frames(topology, P, z, frames)
    if failed >= 0:
        return failed
    for b in range(topology[0, BODIES]):
        f, x, y = frames[b], inertia[b, COM_X], inertia[b, COM_Y]
        q[3 * b], q[3 * b + 1] = f[X] + f[COS] * x - f[SIN] * y, f[Y] + f[SIN] * x + f[COS] * y
        q[3 * b + 2] = f[ANGLE]
    fill_arms(topology, P, inertia, q, turns, arms)
    return -1


@njit
def fill_lines(topology, arms, q, v, lines):
    """Fill the table of lines (cylinders, 4) with the cylinders' lengths, rates and directions."""
    first = topology[0, BODIES] + topology[0, LOOPS]
    for c in range(lines.shape[0]):
        cylinder = topology[1 + first + c]
        x0, y0 = _point(q, cylinder[BASE_BODY], arms, first + c, FIRST_END)
        x1, y1 = _point(q, cylinder[ROD_BODY], arms, first + c, SECOND_END)
        length = math.hypot(x1 - x0, y1 - y0)
        lines[c, LENGTH], lines[c, E_X], lines[c, E_Y] = length, (x1 - x0) / length, (y1 - y0) / length
        lines[c, RATE] = line_rate(topology, arms, v, lines, c)


@njit
def line_rate(topology, arms, v, lines, c):
    """Return the rate of the length of cylinder c at velocities v."""
    first = topology[0, BODIES] + topology[0, LOOPS]
    cylinder = topology[1 + first + c]
    vx, vy = point_velocity(v, cylinder[ROD_BODY], arms, first + c, SECOND_END)
    ux, uy = point_velocity(v, cylinder[BASE_BODY], arms, first + c, FIRST_END)
    return lines[c, E_X] * (vx - ux) + lines[c, E_Y] * (vy - uy)


@njit
def chain(topology, arms, rates, squares, bends, g, x):
    """Fill the bodies' part of x with the solution of G x = g for given independent parts.

    G is the Jacobian of the joint equations: two rows a body (its pin against its carrier's; sliding: across the direction, and the
    carrier's angle against its own), then two rows a loop. With unit rates x is a column of the null space, with g the correction of
    violated joints, with the squares of the angular rates the part of the accelerations that comes from the velocities.

    Args:
        rates: (n,) of the independent coordinates (or their accelerations).
        squares: (bodies,) of the bodies' angular rates, and bends: (bodies,) twice the angular rate times the rate of sliding, for
            accelerations; zeros for velocities.
        g: (joint rows,) right-hand side.
    """
    n = topology[0, BODIES]
    for b in range(n):
        body = topology[1 + b]
        k = body[CARRIER]
        if body[KIND] == SECOND_OF_LOOP:
            continue
        px, py = carried(x, squares, k, arms, b, CARRIED)
        rate = x[3 * k + 2] if k >= 0 else 0.0
        if body[KIND] == FIRST_OF_LOOP:
            _chain_loop(topology, arms, squares, b, g, x, px + g[2 * b], py + g[2 * b + 1])
            continue
        if body[KIND] == SLIDES:
            rate -= g[2 * b + 1]
            ux, uy, way = arms[b, ALONG], arms[b, ALONG + 1], arms[b, WAY]
            across = g[2 * b] + way * rate + bends[b]
            along = rates[body[COORDINATE]] - (squares[k] * way if k >= 0 else 0.0)
            px, py = px + ux * along - uy * across, py + uy * along + ux * across
        else:
            rate += rates[body[COORDINATE]]
            px, py = px + g[2 * b], py + g[2 * b + 1]
        _hang(arms, squares, b, rate, px, py, x)


@njit
def carried(x, squares, body, arms, row, column):
    """Return velocity (or acceleration) of the point at the end of an arm of a body (-1: the ground)."""
    if body < 0:
        return 0.0, 0.0
    rate, square, rx, ry = x[3 * body + 2], squares[body], arms[row, column], arms[row, column + 1]
    return x[3 * body] - rate * ry - square * rx, x[3 * body + 1] + rate * rx - square * ry


@njit
def _hang(arms, squares, b, rate, px, py, x):
    """Fill the part of body b of x from its angular rate and the velocity of its own pin."""
    rx, ry = arms[b, OWN], arms[b, OWN + 1]
    x[3 * b + 2] = rate
    x[3 * b], x[3 * b + 1] = px + rate * ry + squares[b] * rx, py - rate * rx + squares[b] * ry


@njit
def _chain_loop(topology, arms, squares, first, g, x, bx, by):
    """Fill the parts of both dependent bodies of a loop of x; bx, by: what their first pin B does."""
    n, l, second = topology[0, BODIES], 0, first + 1
    while topology[1 + n + l, DEPENDENT] != first:
        l += 1
    row = n + l
    dx, dy = carried(x, squares, topology[1 + row, LAST], arms, row, SECOND_END)
    x1, y1 = arms[second, CARRIED] - arms[first, OWN], arms[second, CARRIED + 1] - arms[first, OWN + 1]
    x2, y2 = arms[row, FIRST_END] - arms[second, OWN], arms[row, FIRST_END + 1] - arms[second, OWN + 1]
    w1, w2 = squares[first], squares[second]
    # what the turning of both has to give: D as seen from B
    rx = dx - g[2 * row] - bx - g[2 * second] + w1 * x1 + w2 * x2
    ry = dy - g[2 * row + 1] - by - g[2 * second + 1] + w1 * y1 + w2 * y2
    det = x1 * y2 - y1 * x2
    a1, a2 = (rx * x2 + ry * y2) / det, -(rx * x1 + ry * y1) / det
    _hang(arms, squares, first, a1, bx, by, x)
    _hang(
        arms, squares, second, a2, bx - a1 * y1 - w1 * x1 + g[2 * second], by + a1 * x1 - w1 * y1 + g[2 * second + 1], x
    )


@njit
def cylinder_length(topology, P, z, c, row):
    """Return the pin-to-pin length (m) of cylinder c at the independent coordinates z (n, …), and fill row[:n] with its derivative.

    NaN where a loop cannot be closed.
    """
    n, n_bodies = topology[0, CYLINDERS], topology[0, BODIES]
    q, v, arms = np.zeros(3 * n_bodies), np.zeros(3 * n_bodies), np.zeros((arm_rows(topology), N_ARM))
    frames, turns, lines = np.empty((n_bodies, N_FRAME)), np.empty((n_bodies + 1, 2)), np.empty((n, N_LINE))
    if close_position(topology, P, np.zeros((n_bodies, 4)), z, frames, turns, arms, q) >= 0:
        row[:n] = math.nan
        return math.nan
    fill_lines(topology, arms, q, v, lines)
    rates, zeros, g = np.zeros(n), np.zeros(n_bodies), np.zeros(joint_rows(topology))
    for i in range(n):
        rates[:] = 0.0
        rates[i] = 1.0
        chain(topology, arms, rates, zeros, zeros, g, v)
        row[i] = line_rate(topology, arms, v, lines, c)
    return lines[c, LENGTH]


@njit
def _poses(topology, P, places, Z, points, angles, lengths, length_rates):
    """Fill the arrays of a Pose for every row of Z; return (row, loop) of the first loop that cannot be closed, or (-1, -1)."""
    frames, row = np.empty((topology[0, BODIES], N_FRAME)), np.empty(Z.shape[1])
    for k in range(Z.shape[0]):
        failed = fill_frames(topology, P, Z[k], frames)
        if failed >= 0:
            return k, failed
        angles[k] = frames[:, ANGLE]
        for i in range(places.shape[0]):
            points[k, i, 0], points[k, i, 1] = _at(P, frames, places[i, 0], places[i, 1])
        for c in range(lengths.shape[1]):
            lengths[k, c] = cylinder_length(topology, P, Z[k], c, row)
            length_rates[k, c] = row
    return -1, -1


@njit
def _lengths(topology, P, Z, out):
    row = np.empty(Z.shape[1])
    for k in range(Z.shape[0]):
        for c in range(out.shape[1]):
            out[k, c] = cylinder_length(topology, P, Z[k], c, row)


def cylinder_lengths(crane: Crane, z: np.ndarray) -> np.ndarray:
    """Return pin-to-pin lengths in m (m, cylinders) at independent coordinates z (m, n), NaN where a loop cannot be closed."""
    out = np.empty((len(z), len(crane.layout.cylinders)))
    _lengths(crane.machine.topology, crane.parameter_vector(), np.ascontiguousarray(z, float), out)
    return out


@dataclass(frozen=True)
class Pose:
    """Everything that follows from the independent coordinates of m states; lengths in m, angles in rad.

    Attributes:
        points: {name: (m, 2)} positions by the names of `Machine.point_names`.
        angles: {body: (m,)} of the bodies against the ground.
        lengths: (m, cylinders) pin-to-pin.
        length_rates: (m, cylinders, n) their derivatives by the independent coordinates.
    """

    points: dict[str, np.ndarray]
    angles: dict[str, np.ndarray]
    lengths: np.ndarray
    length_rates: np.ndarray


def pose(crane: Crane, *z: np.ndarray | float) -> Pose:
    """Return the closed geometry of m states.

    Args:
        z: independent coordinates, rad or m, each a scalar or (m,).

    Raises:
        CraneError: a loop cannot be closed at one of the states.
    """
    machine = crane.machine
    Z = np.ascontiguousarray(np.column_stack(np.broadcast_arrays(*(np.atleast_1d(np.asarray(a, float)) for a in z))))
    number = {name: i for i, name in enumerate(machine.bodies)}
    places = np.array([(number.get(body, -1), machine.index[f"{p}.x"]) for p, body in machine.points.items()])
    m, n = Z.shape
    points, angles = np.empty((m, len(places), 2)), np.empty((m, len(number)))
    lengths, rates = np.empty((m, n)), np.empty((m, n, n))
    bad, _ = _poses(machine.topology, crane.parameter_vector(), places, Z, points, angles, lengths, rates)
    if bad >= 0:
        raise unreachable(crane, Z[bad])
    named = dict(zip(machine.point_names, points.transpose(1, 0, 2), strict=True))
    return Pose(named, dict(zip(machine.bodies, angles.T, strict=True)), lengths, rates)


def unclosed(crane: Crane, z: np.ndarray) -> int:
    """Return the loop that cannot be closed at independent coordinates z (n, …), or -1."""
    frames = np.empty((len(crane.machine.bodies), N_FRAME))
    return int(fill_frames(crane.machine.topology, crane.parameter_vector(), np.asarray(z, float), frames))


def told(layout: Layout, z: np.ndarray) -> str:
    """Return coordinates as people say them, such as "z1 = 10.00 deg"."""
    return ", ".join(
        f"{n} = {v:.4f} m" if layout.unit_of(n) == "m" else f"{n} = {math.degrees(v):.2f} deg"
        for n, v in zip(layout.coordinates, z, strict=False)
    )


def unreachable(crane: Crane, z: np.ndarray, where: str = "") -> CraneError:
    """Return the error that says which loop cannot be closed at independent coordinates z."""
    machine = crane.machine
    closing = machine.loops[max(unclosed(crane, z), 0)]
    first, second = machine.carriers[machine.carriers[closing.carrier].carrier], machine.carriers[closing.carrier]
    pins = "-".join((first.name, second.name, closing.name))
    return CraneError(
        f"{crane.name}{where}: the pose {told(crane.layout, z)} cannot be reached: {first.body} and {second.body} are too short or too long "
        f"to close the loop over the joints {pins}. Choose a pose nearer to the middle of its range, or correct the points of these joints in the crane file."
    )
