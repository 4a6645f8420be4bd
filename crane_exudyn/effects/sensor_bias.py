"""A sensor that reads off by a constant."""

from .base import SENSORS, Effect, Parameter


class SensorBias(Effect):
    """The sensor shows y + b instead of y.

    Signature: one channel is always off by the same amount; no other channel shows it.
    """

    name = "sensor_bias"
    places = SENSORS
    parameters = (Parameter("b", "channel", 0.0, -1e8, 1e8, 1.0, "offset"),)

    @staticmethod
    def measurement(b, y):
        return y + b
