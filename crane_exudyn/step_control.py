"""How accurate a step has to be, and how it is halved: the same for both engines, which estimate their errors
themselves.

A step may have a local error of 1 in units of the constants below. One that has more goes on in parts of half the
length, and so on.
"""

from __future__ import annotations

import math

from .compiled import njit

#: largest local error of a step: rad, rad/s, and of an amount what this pressure (Pa) presses into the oil of its
#: chamber
POSITION_ERROR, RATE_ERROR, PRESSURE_ERROR = 1e-8, 3e-6, 300.0
#: a step that cannot be solved, or whose local error is too large, is halved this often before a run ends
MOST_HALVINGS = 14
#: parts shorter than this (s) may have this share of a step's error together: what is hard comes again, and its errors
#: add up
_SHORT, _SHARED = 1e-3, 0.25
#: parts halved so often may have all of it: the error of a jump falls only as fast as they get shorter
_JUMP = 12


@njit
def is_rough(allowed):
    """Return whether steps may err by more than usual, so that they are solved roughly. Steps without a limit, which
    nobody judges, are solved as well as those that are judged best.
    """
    return 1.0 < allowed < math.inf


@njit
def limit(level, h, allowed):
    """Return the local error that a part of a step may have.

    Args:
        level: how often the step was halved;  h: length of the part in s;  allowed: what a whole step may have.
    """
    if level == 0 or level >= _JUMP or h >= _SHORT:
        return allowed
    return allowed * _SHARED * h / _SHORT


@njit
def next_level(level, done, h, error, allowed):
    """Return how often the next part is halved, after one of length h that was good: once less where one of twice the
    length can begin.

    Its error is taken to be that of the last part times eight. done: share of the step that lies behind.
    """
    fits = (done * 2.0**level) % 2.0 == 0.0
    return level - 1 if level > 0 and fits and error <= enough_to_grow(level, h, allowed) else level


@njit
def enough_to_grow(level, h, allowed):
    """Return the local error of a part of length h with which the next may be twice as long: a smaller one tells no
    more, and an estimate that is larger must be bettered before parts can grow again. It is never more than `limit`.
    """
    if level == 0:
        return allowed
    return min(limit(level, h, allowed), limit(level - 1, 2.0 * h, allowed) / 8.0)
