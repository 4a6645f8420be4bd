"""Oil that passes the piston seal."""

from .base import CYLINDERS, Effect, Parameter


class InternalLeakage(Effect):
    """Leakage flow k (pa - pb) from the piston side (pressure pa) to the rod side (pb) of one cylinder.

    Signature: with its valve closed, a loaded cylinder creeps, the more the higher the load, and its two pressures
    drift towards each other; the speed of driven motions changes little.
    """

    name = "internal_leakage"
    places = CYLINDERS
    parameters = (Parameter("k", "m^3/s/Pa", 0.0, 0.0, 1e-9, 5e-12, "leakage conductance"),)
    probes = ({"k": 2e-12}, {"k": 3e-11})

    @staticmethod
    def leakage(k, pa, pb):
        return -k * (pa - pb), k * (pa - pb)
