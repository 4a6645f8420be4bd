"""Backlash between the command and the spool."""

from .base import CYLINDERS, Effect, Parameter


class SpoolHysteresis(Effect):
    """Backlash of width b between the command U_ref and what the spool follows (a play operator).

    Signature: the spool stays b/2 away from its command, on the side from which it came. So a valve does not quite
    close after a motion, and the same command gives different speeds when it rises and when it falls.
    """

    name = "spool_hysteresis"
    places = CYLINDERS
    parameters = (Parameter("b", "", 0.0, 0.0, 0.8, 0.08, "width of the backlash"),)
    probes = ({"b": 0.02}, {"b": 0.1})

    @staticmethod
    def backlash(b):
        return b
