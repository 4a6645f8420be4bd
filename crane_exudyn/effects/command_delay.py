"""Time that passes between the command and its arrival at the valve."""

from .base import CYLINDERS, Effect, Parameter


class CommandDelay(Effect):
    """The valve receives the command with a delay T, U_ref(t - T).

    Signature: every motion starts and stops late by the same time, whatever its size; errors are pulses where the
    command changes.
    """

    name = "command_delay"
    places = CYLINDERS
    parameters = (Parameter("T", "s", 0.0, 0.0, 1.0, 0.1, "delay"),)
    probes = ({"T": 0.02}, {"T": 0.1}, {"T": 0.25})

    @staticmethod
    def delay(T):
        return T
