"""Oil lost from one chamber to the outside."""

from .base import CHAMBERS, Effect, Parameter


class ExternalLeakage(Effect):
    """Leakage flow k p out of one chamber to the outside, p being the pressure above that of the air; no oil comes
    back.

    Signature: at rest the chamber loses pressure, and the cylinder yields on that side only; the opposite chamber
    follows.
    """

    name = "external_leakage"
    places = CHAMBERS
    parameters = (Parameter("k", "m^3/s/Pa", 0.0, 0.0, 1e-9, 5e-12, "leakage conductance"),)
    probes = ({"k": 2e-12}, {"k": 3e-11})

    @staticmethod
    def leakage(k, p):
        return -k * max(p, 0.0)
