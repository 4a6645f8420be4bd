"""A spool that covers most of a step quickly and creeps the rest."""

from .base import CYLINDERS, Effect, Parameter


class SpoolCreep(Effect):
    """The share kappa of the spool's travel follows with the time constant tau, the rest with the valve's own (16).

    Pilot-operated spools do so: friction and the slow integral part of a position control take the last of the way.
    Behind a dead band a small share of the travel is a large share of the flow.

    Signature: after every step of the command the speed comes most of the way at once and the rest within seconds,
    whatever the pressures do; positions run ahead of the machine after a start, and behind it after a slowing down.
    """

    name = "spool_creep"
    places = CYLINDERS
    parameters = (
        Parameter("kappa", "", 0.0, 0.0, 0.5, 0.1, "share of the travel that creeps"),
        Parameter("tau", "s", 1.0, 0.2, 5.0, 1.0, "time constant of the creeping", shape=True),
    )
    probes = ({"kappa": 0.02, "tau": 1.0}, {"kappa": 0.1, "tau": 1.0})

    @staticmethod
    def creep(kappa, tau):
        return kappa, tau
