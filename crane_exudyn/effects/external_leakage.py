"""Oil lost from one chamber to the outside."""

from .base import CHAMBERS, Effect, Parameter


class ExternalLeakage(Effect):
    """Flow k p out of one chamber, p over the air outside; no oil comes back from there.

    Signature: the chamber loses pressure at rest and the cylinder gives way on that side only; the opposite chamber
    follows.
    """

    name = "external_leakage"
    places = CHAMBERS
    parameters = (Parameter("k", "m^3/s/Pa", 0.0, 0.0, 1e-9, 5e-12, "leakage conductance"),)
    probes = ({"k": 2e-12}, {"k": 3e-11})

    @staticmethod
    def leakage(k, p):
        return -k * max(p, 0.0)
