"""Effects of a user's own on sensors and payload, for `test_measurement`: they act by their hooks, whatever they are
called.
"""

from crane_exudyn.effects.base import SENSORS, Effect, Parameter


class Compressed(Effect):
    """The sensor shows y / (1 + k |y|).

    Signature: one channel shows less than there is, the more so the further it is from zero.
    """

    name = "compressed"
    places = SENSORS
    parameters = (Parameter("k", "", 0.0, 0.0, 10.0, 0.5, "compression"),)

    @staticmethod
    def measurement(k, y):
        return y / (1.0 + k * abs(y))


class SlowWire(Effect):
    """The sensor follows with a first-order lag, and so late beside the built-in one.

    Signature: one channel is late.
    """

    name = "slow_wire"
    places = SENSORS
    parameters = (Parameter("T", "s", 0.0, 0.0, 2.0, 0.1, "time constant"),)

    @staticmethod
    def lag(T):
        return T


class Chain(Effect):
    """The payload hangs on a chain.

    Signature: it swings.
    """

    name = "chain"
    parameters = (Parameter("links", "", 0.0, 0.0, 100.0, 10.0, "number of links of 0.1 m"),)

    @staticmethod
    def pendulum(links):
        return 0.1 * links, 5.0
