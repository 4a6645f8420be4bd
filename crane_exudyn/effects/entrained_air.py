"""Undissolved air in the oil."""

from .base import Effect, Parameter


class EntrainedAir(Effect):
    """Free air in the oil: the compressibility 1/Bo is replaced by 1/Bo + alpha * 1 bar / p^2, with p not below 0.2 bar
    (Bo: bulk modulus of the oil).

    Signature: chambers at low pressure are soft: their pressure builds up late, and the machine rings more slowly.
    Where the pressure is high, the machine is as stiff as expected.
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
