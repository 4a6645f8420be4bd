"""A load-holding valve in the line of the loaded chamber."""

from .base import CYLINDERS, Effect, Parameter


class CounterbalanceValve(Effect):
    """A load-holding valve: the loaded chamber drains only as far as p_load + ratio * p_pilot opens the valve beyond
    its setting.

    Opening = (p_load + ratio * p_pilot - setting) / range, limited to 0 ... 1. It multiplies the flow of that
    chamber's edge to tank; flow into the chamber is free, through a check valve. The crane file says which chamber is
    loaded (p1 and p4 of the log crane). The pilot is the opposite chamber.

    Signature: lowering a load needs pressure in the opposite chamber, which builds up before anything moves. Both
    pressures are high while lowering; lifting is as before.
    """

    name = "counterbalance_valve"
    places = CYLINDERS
    parameters = (
        Parameter(
            "setting",
            "Pa",
            0.0,
            0.0,
            400e5,
            120e5,
            "p_load + ratio * p_pilot at which it begins to open; 0: no valve",
            threshold=True,
        ),
        Parameter("ratio", "", 3.0, 0.0, 12.0, 3.0, "pilot ratio", shape=True),
        # 20 bar: typical of cartridge valves (no source)
        Parameter("range", "Pa", 20e5, 2e5, 200e5, 20e5, "rise of that sum over which it opens fully", shape=True),
    )
    # from a valve that holds too much a search finds back; one that is open all the time has no slope
    probes = (
        {"setting": 60e5, "ratio": 1.0},
        {"setting": 110e5, "ratio": 1.0},
        {"setting": 160e5, "ratio": 1.0},
        {"setting": 170e5, "ratio": 2.0},
        {"setting": 240e5, "ratio": 2.0},
        {"setting": 350e5, "ratio": 4.0},
    )

    @staticmethod
    def return_gain(setting, ratio, range, p_own, p_other, load_side, drop):
        if setting <= 0.0 or load_side == 0.0 or drop < 0.0:
            return 1.0
        opening = (p_own + ratio * p_other - setting) / range
        return min(max(opening, 0.0), 1.0)
