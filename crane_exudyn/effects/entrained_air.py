"""Undissolved air in the oil."""

from .base import Effect, Parameter


class EntrainedAir(Effect):
    """1/Bo is replaced by 1/Bo + alpha * 1 bar / p^2, with p not below 0.2 bar.

    Signature: chambers at low pressure are soft: pressure builds up late, the machine rings slower there, and is as
    stiff as expected where pressure is high.
    """

    name = "entrained_air"
    parameters = (Parameter("alpha", "", 0.0, 0.0, 0.3, 0.01, "volume share of air at 1 bar"),)
    probes = ({"alpha": 0.002}, {"alpha": 0.02})

    @staticmethod
    def free_gas(alpha, p):
        if alpha == 0.0:
            return 0.0, 0.0
        p_air = max(p, 0.2e5)
        compliance = alpha * 1e5 / (p_air * p_air)
        return alpha * 1e5 / p_air + compliance * (p_air - p), compliance
