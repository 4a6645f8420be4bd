"""A spool that covers most of a step quickly and creeps the rest."""

from .base import CYLINDERS, Effect, Parameter


class SpoolCreep(Effect):
    """A share kappa of the spool's travel follows with the time constant tau, the rest with the valve's own, equation
    (16) of the paper.

    Pilot-operated spools behave like this: friction, and the slow integral part of a position control, delay the last
    part of the travel. Behind a dead band a small share of the travel is a large share of the flow.

    Signature: after every step of the command most of the speed comes at once and the rest within seconds, whatever the
    pressures do. The model's positions run ahead of the machine after a start, and behind it after slowing down.
    """

    name = "spool_creep"
    places = CYLINDERS
    parameters = (
        Parameter("kappa", "", 0.0, 0.0, 0.5, 0.1, "share of the travel that creeps"),
        Parameter("tau", "s", 1.0, 0.2, 5.0, 1.0, "time constant of the creep", shape=True),
    )
    probes = ({"kappa": 0.02, "tau": 1.0}, {"kappa": 0.1, "tau": 1.0})

    @staticmethod
    def creep(kappa, tau):
        return kappa, tau
