"""Backlash between the command and the spool."""

from .base import CYLINDERS, Effect, Parameter


class SpoolHysteresis(Effect):
    """Backlash of width b between U_ref and what the spool follows (a play operator).

    Signature: the spool stands off by b/2 on the side it came from, so that after a motion a valve does not quite
    close, and the same command gives another speed on the way up than on the way down.
    """

    name = "spool_hysteresis"
    places = CYLINDERS
    parameters = (Parameter("b", "", 0.0, 0.0, 0.8, 0.08, "width of the backlash"),)
    probes = ({"b": 0.02}, {"b": 0.1})

    @staticmethod
    def backlash(b):
        return b
