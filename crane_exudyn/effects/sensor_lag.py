"""A sensor that follows slowly."""

from .base import SENSORS, Effect, Parameter


class SensorLag(Effect):
    """The sensor follows the true value with a first-order lag of time constant tau.

    Signature: one channel is late wherever it changes quickly, and right at rest.
    """

    name = "sensor_lag"
    places = SENSORS
    parameters = (Parameter("tau", "s", 0.0, 0.0, 2.0, 0.1, "time constant"),)
    probes = ({"tau": 0.02}, {"tau": 0.15})

    @staticmethod
    def lag(tau):
        return tau
