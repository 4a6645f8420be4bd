"""How accurate a step has to be, and how it is halved: the same for both engines, which estimate their errors themselves.

A step of length h may have a local error of 1 in units of the constants below. One that has more goes on in parts of half the length,
and so on; its parts share what it may have.
"""

from __future__ import annotations

from .compiled import njit

#: largest local error of a step: rad, rad/s, and of an amount what this pressure (Pa) presses into the oil of its chamber
POSITION_ERROR, RATE_ERROR, PRESSURE_ERROR = 1e-8, 3e-6, 300.0
#: a step that cannot be solved, or whose local error is too large, is halved this often before a run ends
MOST_HALVINGS = 14
#: what parts may have of a step's error together: what is hard comes again, and its errors add up (a valve that chatters)
_SHARED = 0.25
#: parts halved so often may have half of the error that is left: that of a jump falls only as fast as their length
_SHORT = 8


@njit
def limit(level, done, left):
    """Return the local error that the next part of a step may have.

    Args:
        level: how often the part is halved;  done: share of the step that lies behind it;  left: error that is left for the rest.
    """
    if level == 0:
        return left
    share = _SHARED * 0.5**level / (1.0 - done)
    return left * (max(share, 0.5) if level >= _SHORT else share)


@njit
def next_level(level, done, error, left):
    """Return how often the next part is halved, after one that was good: once less where a part of twice the length can begin.

    Its error is taken to be that of the last part times eight.
    """
    fits = (done * 2.0**level) % 2.0 == 0.0
    return level - 1 if level > 0 and fits and 8.0 * error <= limit(level - 1, done, left) else level
