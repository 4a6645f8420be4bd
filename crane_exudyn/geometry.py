"""Planar geometry of a machine: bodies, joints, loops and cylinders, from the independent coordinates on, and its
velocities.

Frames: x forward, y up, angles counter-clockwise. A body's frame has its own pin where its carrier's pin is; on a
prismatic joint it is parallel to its carrier's, away from the pin by the coordinate along the joint's direction. The
two dependent bodies of a loop close the triangle B-C-D of their pins, C on one side of the line from B to D. ::

                C                     B: pin of the first dependent body on its carrier
              o   o                   C: pin between both dependent bodies
       first /     \\ second          D: pin of the second one on the body that the loop ends on
            o       o
            B       D

`topology` is `Machine.topology`, P the vector of nominal parameters. A body's reference point is given by the columns
COM_X, COM_Y of a table `inertia` (bodies, 4): its centre of mass in its own frame, or zeros for its origin. Redundant
coordinates q and velocities v hold x, y of the reference point and the angle of each body.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .compiled import lean, njit
from .crane import Crane
from .errors import CraneError
from .layout import Layout
from .machine import (
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
    PIN_BODY,
    PIN_END,
    PIN_OF,
    PIN_POINT,
    ROD_BODY,
    SECOND_OF_LOOP,
    SIDE,
    SLIDES,
)

#: columns of a table of masses: mass, centre of mass in the body's frame, inertia about it
MASS, COM_X, COM_Y, INERTIA = range(4)
#: The table of arms holds vectors from a body's reference point to a point of it, in the fixed frame (from the origin,
#: on the ground).
#: A row a body: its own pin, the pin on its carrier, the direction in which it slides and how far it has slid.
#: Then a row a loop: the pin of the second dependent body where it is cut, and that on the body that the loop ends on.
#: Then a row a cylinder: base and rod end. The last row: the payload's point, and from there the pendulum's rod.
#: Behind its arms, a body's row holds its frame: origin, angle, its cosine and sine.
OWN, CARRIED, ALONG, WAY, X, Y, ANGLE, COS, SIN, N_ARM = 0, 2, 4, 6, 7, 8, 9, 10, 11, 12
FIRST_END, SECOND_END = 0, 2
#: columns of the table of cylinders as lines (cylinders, 4): length, its rate, direction from base to rod end
LENGTH, RATE, E_X, E_Y, N_LINE = range(5)


@lean
def arm_rows(topology):
    """Return how many rows a table of arms has."""
    return topology[0, BODIES] + topology[0, LOOPS] + topology[0, CYLINDERS] + 1


@lean
def joint_rows(topology):
    """Return how many joint equations there are, without a pendulum's."""
    return 2 * (topology[0, BODIES] + topology[0, LOOPS])


@lean
def _place(P, point, axis):
    return P[point + axis] if point >= 0 else 0.0


@lean
def _at(P, arms, body, point):
    """Return x, y of a point of a body (-1: the ground, where it is the point itself)."""
    x, y = _place(P, point, 0), _place(P, point, 1)
    if body < 0:
        return x, y
    c, s = arms[body, COS], arms[body, SIN]
    return arms[body, X] + c * x - s * y, arms[body, Y] + s * x + c * y


@lean
def _set_frame(P, arms, b, angle, own_pin, x, y):
    """Fill the frame of body b at an angle, whose own pin lies at x, y."""
    c, s = math.cos(angle), math.sin(angle)
    px, py = _place(P, own_pin, 0), _place(P, own_pin, 1)
    arms[b, X], arms[b, Y], arms[b, ANGLE] = x - c * px + s * py, y - s * px - c * py, angle
    arms[b, COS], arms[b, SIN] = c, s


@lean
def _close_loop(topology, P, arms, l):
    """Fill the frames of the dependent bodies of loop l; return whether it can be closed."""
    loop = 1 + topology[0, BODIES] + l
    first = topology[loop, DEPENDENT]
    carrier, pin, own = topology[1 + first, CARRIER], topology[1 + first, PIN], topology[1 + first, OWN_PIN]
    middle, own_2, cut = topology[2 + first, PIN], topology[2 + first, OWN_PIN], topology[loop, CUT_PIN]
    bx, by = _at(P, arms, carrier, pin)
    dx, dy = _at(P, arms, topology[loop, LAST], topology[loop, LAST_PIN])
    c, s, turned = (arms[carrier, COS], arms[carrier, SIN], arms[carrier, ANGLE]) if carrier >= 0 else (1.0, 0.0, 0.0)
    x, y = c * (dx - bx) + s * (dy - by), c * (dy - by) - s * (dx - bx)  # from B to D, as the carrier sees it
    x1, y1 = _place(P, middle, 0) - _place(P, own, 0), _place(P, middle, 1) - _place(P, own, 1)
    x2, y2 = _place(P, cut, 0) - _place(P, own_2, 0), _place(P, cut, 1) - _place(P, own_2, 1)
    r1, r2 = math.hypot(x1, y1), math.hypot(x2, y2)
    # cosine of the turn from B->C to C->D; C on the left of B->D makes it a turn to the right
    cos_turn = (x * x + y * y - r1 * r1 - r2 * r2) / (2.0 * r1 * r2)
    if not abs(cos_turn) < 1.0:
        return False
    turn = -topology[loop, SIDE] * math.acos(cos_turn)
    at_b = math.atan2(-r2 * math.sin(turn), r1 + r2 * cos_turn)
    angle = turned + math.atan2(y, x) + at_b - math.atan2(y1, x1)
    _set_frame(P, arms, first, angle, own, bx, by)
    cx, cy = _at(P, arms, first, middle)
    _set_frame(P, arms, first + 1, angle + turn + math.atan2(y1, x1) - math.atan2(y2, x2), own_2, cx, cy)
    return True


@lean
def fill_frames(topology, P, z, arms):
    """Fill the frames in arms at the independent coordinates in z; return -1, or the loop that cannot be closed."""
    l = 0
    for b in range(topology[0, BODIES]):
        kind, carrier = topology[1 + b, KIND], topology[1 + b, CARRIER]
        if kind == SECOND_OF_LOOP:
            continue
        if kind == FIRST_OF_LOOP:
            while topology[1 + topology[0, BODIES] + l, DEPENDENT] != b:
                l = (l + 1) % topology[0, LOOPS]
            if not _close_loop(topology, P, arms, l):
                return l
            continue
        x, y = _at(P, arms, carrier, topology[1 + b, PIN])
        angle, way = arms[carrier, ANGLE] if carrier >= 0 else 0.0, z[topology[1 + b, COORDINATE]]
        if kind == SLIDES:
            direction = angle + P[topology[1 + b, DIRECTION]]
            x, y = x + way * math.cos(direction), y + way * math.sin(direction)
        else:
            angle += way
        _set_frame(P, arms, b, angle, topology[1 + b, OWN_PIN], x, y)
    return -1


@lean
def turn_frames(topology, q, arms):
    """Fill angle, cosine and sine of the frames in arms for redundant coordinates q."""
    for b in range(topology[0, BODIES]):
        arms[b, ANGLE] = q[3 * b + 2]
        arms[b, COS], arms[b, SIN] = math.cos(q[3 * b + 2]), math.sin(q[3 * b + 2])


@lean
def fill_arms(topology, P, inertia, q, arms):
    """Fill the table of arms (but for the pendulum's rod) for redundant coordinates q, which may violate the joints a
    little.

    Cosines and sines of the frames must be those of q.
    """
    first, last = arm_rows(topology), topology.shape[0]
    for i in range(first, last):
        body, point = topology[i, PIN_BODY], topology[i, PIN_POINT]
        x, y = (P[point], P[point + 1]) if point >= 0 else (0.0, 0.0)
        if body >= 0:
            c, s = arms[body, COS], arms[body, SIN]
            x, y = x - inertia[body, COM_X], y - inertia[body, COM_Y]
            x, y = c * x - s * y, s * x + c * y
        row, column = topology[i, PIN_OF], 2 * topology[i, PIN_END]
        arms[row, column], arms[row, column + 1] = x, y
    for b in range(topology[0, BODIES]):
        if topology[1 + b, KIND] == SLIDES:
            _fill_slide(topology, P, q, arms, b)


@lean
def _fill_slide(topology, P, q, arms, b):
    """Fill direction and way of body b, which slides, in arms."""
    k, direction = topology[1 + b, CARRIER], P[topology[1 + b, DIRECTION]]
    ck, sk = (arms[k, COS], arms[k, SIN]) if k >= 0 else (1.0, 0.0)
    c, s = math.cos(direction), math.sin(direction)
    ux, uy = ck * c - sk * s, sk * c + ck * s
    x, y = _point(q, k, arms, b, CARRIED)
    own_x, own_y = _point(q, b, arms, b, OWN)
    arms[b, ALONG], arms[b, ALONG + 1] = ux, uy
    arms[b, WAY] = ux * (own_x - x) + uy * (own_y - y)


@lean
def _point(q, body, arms, row, column):
    """Return x, y of the point at the end of an arm of a body (-1: the ground)."""
    x, y = arms[row, column], arms[row, column + 1]
    return (x, y) if body < 0 else (q[3 * body] + x, q[3 * body + 1] + y)


@lean
def point_velocity(v, body, arms, row, column):
    """Return the velocity of the point at the end of an arm of a body (-1: the ground, at rest)."""
    if body < 0:
        return 0.0, 0.0
    rate = v[3 * body + 2]
    return v[3 * body] - rate * arms[row, column + 1], v[3 * body + 1] + rate * arms[row, column]


@lean
def close_position(topology, P, inertia, z, arms, q):
    """Fill arms and the bodies' part of q for the independent coordinates in z; return -1 or the loop that cannot be
    closed.
    """
    failed = fill_frames(topology, P, z, arms)
    if failed >= 0:
        return failed
    for b in range(topology[0, BODIES]):
        c, s, x, y = arms[b, COS], arms[b, SIN], inertia[b, COM_X], inertia[b, COM_Y]
        q[3 * b], q[3 * b + 1] = arms[b, X] + c * x - s * y, arms[b, Y] + s * x + c * y
        q[3 * b + 2] = arms[b, ANGLE]
    fill_arms(topology, P, inertia, q, arms)
    return -1


@lean
def fill_lines(topology, arms, q, v, lines):
    """Fill the table of lines (cylinders, 4) with the cylinders' lengths, rates and directions."""
    first = topology[0, BODIES] + topology[0, LOOPS]
    for c in range(lines.shape[0]):
        x0, y0 = _point(q, topology[1 + first + c, BASE_BODY], arms, first + c, FIRST_END)
        x1, y1 = _point(q, topology[1 + first + c, ROD_BODY], arms, first + c, SECOND_END)
        length = math.hypot(x1 - x0, y1 - y0)
        lines[c, LENGTH], lines[c, E_X], lines[c, E_Y] = length, (x1 - x0) / length, (y1 - y0) / length
        lines[c, RATE] = line_rate(topology, arms, v, lines, c)


@lean
def line_rate(topology, arms, v, lines, c):
    """Return the rate of the length of cylinder c at velocities v."""
    first = topology[0, BODIES] + topology[0, LOOPS]
    vx, vy = point_velocity(v, topology[1 + first + c, ROD_BODY], arms, first + c, SECOND_END)
    ux, uy = point_velocity(v, topology[1 + first + c, BASE_BODY], arms, first + c, FIRST_END)
    return lines[c, E_X] * (vx - ux) + lines[c, E_Y] * (vy - uy)


@lean
def chain(topology, arms, unit, v, g, x):
    """Fill the bodies' part of x with the solution of G x = g for given independent parts.

    G is the Jacobian of the joint equations: two rows a body (its pin against its carrier's; sliding: across the
    direction, and the carrier's angle against its own), then two rows a loop. With a unit rate x is a column of the
    null space, with g the correction of violated joints, with velocities the part of the accelerations that comes from
    them.

    Args:
        unit: number of the independent coordinate whose rate is 1, the others' being 0; -1 for none.
        v: (nq,) velocities, or (0,) for none;  g: (joint equations,) right-hand side, or (0,) for zeros.
    """
    for b in range(topology[0, BODIES]):
        k, kind = topology[1 + b, CARRIER], topology[1 + b, KIND]
        if kind == SECOND_OF_LOOP:
            continue
        px, py = carried(x, v, k, arms, b, CARRIED)
        gx, gy = (g[2 * b], g[2 * b + 1]) if g.size else (0.0, 0.0)
        if kind == FIRST_OF_LOOP:
            _chain_loop(topology, arms, v, b, g, x, px + gx, py + gy)
            continue
        rate, own = x[3 * k + 2] if k >= 0 else 0.0, 1.0 if topology[1 + b, COORDINATE] == unit else 0.0
        if kind == SLIDES:
            ux, uy, way = arms[b, ALONG], arms[b, ALONG + 1], arms[b, WAY]
            rate -= gy
            across = gx + way * rate + (2.0 * v[3 * b + 2] * sliding_rate(topology, arms, v, b) if v.size else 0.0)
            along = own - (square(v, k) * way if k >= 0 else 0.0)
            px, py = px + ux * along - uy * across, py + uy * along + ux * across
        else:
            rate, px, py = rate + own, px + gx, py + gy
        _hang(arms, v, b, rate, px, py, x)


@lean
def square(v, b):
    """Return the square of the angular rate of body b; 0 without velocities."""
    return v[3 * b + 2] * v[3 * b + 2] if v.size else 0.0


@lean
def sliding_rate(topology, arms, v, b):
    """Return the rate in m/s at which body b slides along its carrier."""
    px, py = point_velocity(v, b, arms, b, OWN)
    kx, ky = point_velocity(v, topology[1 + b, CARRIER], arms, b, CARRIED)
    return arms[b, ALONG] * (px - kx) + arms[b, ALONG + 1] * (py - ky)


@lean
def carried(x, v, body, arms, row, column):
    """Return velocity (or, with velocities v, acceleration) of the point at the end of an arm of a body (-1: the
    ground).
    """
    if body < 0:
        return 0.0, 0.0
    rate, squared, rx, ry = x[3 * body + 2], square(v, body), arms[row, column], arms[row, column + 1]
    return x[3 * body] - rate * ry - squared * rx, x[3 * body + 1] + rate * rx - squared * ry


@lean
def _hang(arms, v, b, rate, px, py, x):
    """Fill the part of body b of x from its angular rate and the velocity of its own pin."""
    rx, ry, squared = arms[b, OWN], arms[b, OWN + 1], square(v, b)
    x[3 * b + 2] = rate
    x[3 * b], x[3 * b + 1] = px + rate * ry + squared * rx, py - rate * rx + squared * ry


@lean
def _chain_loop(topology, arms, v, first, g, x, bx, by):
    """Fill the parts of both dependent bodies of a loop of x; bx, by: what their first pin B does."""
    row, second = topology[0, BODIES], first + 1
    while topology[1 + row, DEPENDENT] != first:
        row += 1
    dx, dy = carried(x, v, topology[1 + row, LAST], arms, row, SECOND_END)
    x1, y1 = arms[second, CARRIED] - arms[first, OWN], arms[second, CARRIED + 1] - arms[first, OWN + 1]
    x2, y2 = arms[row, FIRST_END] - arms[second, OWN], arms[row, FIRST_END + 1] - arms[second, OWN + 1]
    cx, cy, ex, ey = (g[2 * second], g[2 * second + 1], g[2 * row], g[2 * row + 1]) if g.size else (0.0, 0.0, 0.0, 0.0)
    w1, w2 = square(v, first), square(v, second)
    # what the turning of both has to give: D as seen from B
    rx = dx - ex - bx - cx + w1 * x1 + w2 * x2
    ry = dy - ey - by - cy + w1 * y1 + w2 * y2
    det = x1 * y2 - y1 * x2
    a1, a2 = (rx * x2 + ry * y2) / det, -(rx * x1 + ry * y1) / det
    _hang(arms, v, first, a1, bx, by, x)
    _hang(arms, v, second, a2, bx - a1 * y1 - w1 * x1 + cx, by + a1 * x1 - w1 * y1 + cy, x)


@lean
def _stand(topology, P, z, origins, arms, q, v, lines):
    """Fill arms and lines for the machine at rest at the independent coordinates z (n, …); return -1 or the loop that
    cannot be closed.
    """
    failed = close_position(topology, P, origins, z, arms, q)
    if failed < 0:
        v[:] = 0.0
        fill_lines(topology, arms, q, v, lines)
    return failed


@njit
def _tables(topology):
    """Return empty tables for `_stand`: origins (bodies, 4), arms, q, v, lines."""
    bodies, lines = topology[0, BODIES], np.empty((topology[0, CYLINDERS], N_LINE))
    arms = np.zeros((arm_rows(topology), N_ARM))
    return np.zeros((bodies, 4)), arms, np.zeros(3 * bodies), np.zeros(3 * bodies), lines


@njit
def _poses(topology, P, places, Z, points, angles, lengths, length_rates):
    """Fill the arrays of a Pose for every row of Z; return (row, loop) of the first loop that cannot be closed, or (-1,
    -1).
    """
    origins, arms, q, v, lines = _tables(topology)
    none = np.empty(0)
    for k in range(Z.shape[0]):
        failed = _stand(topology, P, Z[k], origins, arms, q, v, lines)
        if failed >= 0:
            return k, failed
        angles[k] = arms[: topology[0, BODIES], ANGLE]
        for i in range(places.shape[0]):
            points[k, i, 0], points[k, i, 1] = _at(P, arms, places[i, 0], places[i, 1])
        lengths[k] = lines[:, LENGTH]
        _line_rates(topology, arms, v, lines, none, length_rates[k])
    return -1, -1


@lean
def _line_rates(topology, arms, v, lines, none, by_z):
    """Fill by_z (cylinders, n) with the derivatives of all lengths by the independent coordinates."""
    for i in range(by_z.shape[1]):
        chain(topology, arms, i, none, none, v)
        for c in range(by_z.shape[0]):
            by_z[c, i] = line_rate(topology, arms, v, lines, c)


@njit
def fill_lengths(topology, P, Z, out, by_z):
    """Fill out (k, cylinders) with the pin-to-pin lengths (m) at the independent coordinates Z (k, n, …), and the first
    rows of by_z (…, cylinders, n) with their derivatives there.

    NaN where a loop cannot be closed.
    """
    origins, arms, q, v, lines = _tables(topology)
    none = np.empty(0)
    for k in range(Z.shape[0]):
        out[k] = math.nan
        by_z[k : k + 1] = math.nan
        if _stand(topology, P, Z[k], origins, arms, q, v, lines) >= 0:
            continue
        out[k] = lines[:, LENGTH]
        if k < by_z.shape[0]:
            _line_rates(topology, arms, v, lines, none, by_z[k])


def cylinder_lengths(crane: Crane, z: np.ndarray) -> np.ndarray:
    """Return pin-to-pin lengths in m (m, cylinders) at independent coordinates z (m, n), NaN where a loop cannot be
    closed.
    """
    out = np.empty((len(z), len(crane.layout.cylinders)))
    z = np.ascontiguousarray(z, float)
    fill_lengths(crane.machine.topology, crane.parameter_vector(), z, out, np.empty((0, *out.shape[1:], z.shape[1])))
    return out


def chamber_lengths(crane: Crane, z: np.ndarray) -> np.ndarray:
    """Return lengths of the piston-side chambers in m (m, cylinders), as `cylinder_lengths`."""
    return cylinder_lengths(crane, z) - [crane.stroke(c)[0] for c in crane.layout.cylinders]


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
        CraneError: not as many coordinates as the machine has, or a loop cannot be closed at one of the states.
    """
    machine, names = crane.machine, crane.layout.coordinates
    if len(z) != len(names) or max(map(np.ndim, z)) > 1:
        found = ", ".join(str(np.shape(a)) for a in z)
        raise CraneError(
            f"{crane.name}: a pose has {len(names)} coordinates ({', '.join(names)}), each a number or (m,); found "
            f"{len(z)} of shape {found or 'none'}."
        )
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


def loop_bends(crane: Crane, z: np.ndarray) -> np.ndarray:
    """Return the angles in rad (m, loops) between the two dependent bodies of each loop at independent coordinates z
    (m, n): 0 where they are stretched in one line, pi where one is folded back on the other.

    Raises:
        CraneError: a loop cannot be closed.
    """
    machine, points = crane.machine, pose(crane, *np.transpose(z)).points
    bends = np.empty((len(z), len(machine.loops)))
    for i, closing in enumerate(machine.loops):
        a, b, c = (points[joint.pin.removeprefix("joints.")] for joint in (*machine.pair(closing), closing))
        along, beyond = (b - a).T, (c - b).T
        bends[:, i] = np.abs(np.arctan2(along[0] * beyond[1] - along[1] * beyond[0], (along * beyond).sum(axis=0)))
    return bends


def unclosed(crane: Crane, z: np.ndarray) -> int:
    """Return the loop that cannot be closed at independent coordinates z (n, …), or -1."""
    arms = np.zeros((arm_rows(crane.machine.topology), N_ARM))
    return int(fill_frames(crane.machine.topology, crane.parameter_vector(), np.asarray(z, float), arms))


def pose_text(layout: Layout, z: np.ndarray) -> str:
    """Return coordinates as people say them, such as "z1 = 10.00 deg"."""
    return ", ".join(
        f"{n} = {v:.4f} m" if layout.unit_of(n) == "m" else f"{n} = {math.degrees(v):.2f} deg"
        for n, v in zip(layout.coordinates, z, strict=False)
    )


def unreachable(crane: Crane, z: np.ndarray, where: str = "") -> CraneError:
    """Return the error that says which loop cannot be closed at independent coordinates z."""
    machine = crane.machine
    closing = machine.loops[max(unclosed(crane, z), 0)]
    first, second = machine.pair(closing)
    pins = "-".join((first.name, second.name, closing.name))
    return CraneError(
        f"{crane.name}{where}: the pose {pose_text(crane.layout, z)} cannot be reached: {first.body} and {second.body} "
        "are too short or too long "
        f"to close the loop over the joints {pins}. Choose a pose nearer to the middle of its range, or correct the "
        "points of these joints in the crane file."
    )
