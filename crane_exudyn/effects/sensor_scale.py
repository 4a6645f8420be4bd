"""A sensor with a wrong gain."""

from .base import SENSORS, Effect, Parameter


class SensorScale(Effect):
    """The sensor shows a * y instead of y.

    Signature: one channel is off in proportion to its own value; no other channel shows it.
    """

    name = "sensor_scale"
    places = SENSORS
    parameters = (Parameter("a", "", 1.0, 0.2, 5.0, 1.1, "gain"),)
    probes = ({"a": 1.02},)

    @staticmethod
    def measurement(a, y):
        return y * a
