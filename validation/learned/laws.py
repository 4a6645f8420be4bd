"""The laws that a recording may show: every learned effect at every place over everything it may run over, with knots
where it went.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import isotonic_regression

from crane_exudyn.effects import registry
from crane_exudyn.effects.curve import KNOTS, NUMBER, Argument, Table, X, Y, value
from crane_exudyn.hydraulics import outside_pressure
from crane_exudyn.layout import Layout
from crane_exudyn.statics import vapour_pressure

from ..criteria import CRITERIA
from ..fit.model import model_of
from ..fit.solve import Fit
from ..semi_recursive.engine import SemiRecursiveEngine

#: rounds in which a curve's knots find their places
_ROUNDS = 60
#: least distance between such knots, as a share of the range
_CLOSEST = 0.002
#: time between the instants at which the trajectory is looked at, s
_EVERY = 0.01


@dataclass(frozen=True)
class Law:
    """A curve of a learned effect "name@place" over an argument.

    Attributes:
        x: (K,) knots within the visited range, SI.
        against: whether it acts against motion.
        visited: (n,) values of the argument along the recording, sorted; often: (low, high) that were met within more
            than a block of time.
        reported: (J,) knots at which the curve is reported, where its own go on beyond what is known; None for its own.
    """

    key: str
    over: Argument
    against: bool
    x: np.ndarray
    visited: np.ndarray = field(repr=False)
    often: tuple[float, float] = field(repr=False)
    reported: np.ndarray | None = field(default=None, repr=False)

    @property
    def name(self) -> str:
        """The effect with its place, over what it runs, and how it acts where it could act otherwise."""
        kinds = self.over.against
        usual = len(kinds) < 2 or self.against == kinds[0]
        how = "" if usual else " against motion" if self.against else " as a spring"
        return f"{self.key} over {self.over.name}{how}"

    @property
    def neutral(self) -> np.ndarray:
        """The neutral curve at the knots."""
        return np.array([self.over.neutral(x) for x in self.x])

    @property
    def one_sided(self) -> bool:
        """Whether physics allows the curve one sign only: friction resists, oil leaks and loses pressure the way it
        flows.
        """
        return self.against or self.over.from_zero or self.over.name == "pressure"

    @property
    def monotone(self) -> bool:
        """Whether physics lets the curve only rise."""
        return self.over.from_zero or self.over.name in ("pressure", "spool")

    def curve(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the curve through y at other knots x, at this law's knots."""
        return curve_at(x, y, self.x)

    def narrowed(self, y: np.ndarray, std: np.ndarray) -> Law:
        """Return the law over the range that was met often enough and at whose ends a curve y (K,) is known; itself
        where that is all of it, or little.
        """
        known = self.x[std <= self._unsure(y)]
        if len(known) < CRITERIA.knots // 2:
            return self
        low, high = max(known[0], self.often[0]), min(known[-1], self.often[1])
        if self.over.from_zero:
            low = 0.0
        if (low, high) == (self.x[0], self.x[-1]) or high - low < 0.5 * (known[-1] - known[0]):
            return self
        return replace(self, x=np.interp(self.x, self.x[[0, -1]], [low, high]))

    def refined(self, y: np.ndarray) -> Law:
        """Return the law with as many knots as there may be over the same range, closer where the curve through y (K,)
        bends.
        """
        fine = np.linspace(self.x[0], self.x[-1], 401)
        bend = np.abs(np.gradient(np.gradient(curve_at(self.x, y, fine))))
        spread = np.ones(len(fine)) / len(fine) + 2.0 * np.sqrt(bend) / max(float(np.sqrt(bend).sum()), 1e-300)
        spread = np.convolve(np.pad(spread, 20, mode="edge"), np.ones(41) / 41.0, mode="valid")
        passed = np.concatenate([[0.0], np.cumsum(0.5 * (spread[1:] + spread[:-1]))])
        return replace(self, x=np.interp(np.linspace(0.0, 1.0, KNOTS), passed / passed[-1], fine))

    def along(self, form: Callable[[np.ndarray], np.ndarray]) -> Law:
        """Return the law with as many knots as there may be, placed so that the curve through them is nearest to a form
        (n,) -> (n,), over half as much again to either side as is known.
        """
        low, high = self.x[0], self.x[-1]
        more = CRITERIA.onward * (high - low)
        start = low if self.over.from_zero or (self.over.magnitude and low <= 0.0) else low - more
        if self.over.magnitude:
            start = max(start, 0.0)
        end = high + more
        if self.over.slope:
            start, end = max(start, -1.0), min(end, 1.0)
        x = spread_along(form, float(start), float(end), (float(low), float(high)))
        return replace(self, x=x, reported=self.x)

    def at_reported(self) -> np.ndarray:
        """Return M (J, K): the curve at the knots where it is reported is M times its values at its own."""
        if self.reported is None:
            return np.eye(len(self.x))
        return np.column_stack([curve_at(self.x, unit, self.reported) for unit in np.eye(len(self.x))])

    def _unsure(self, y: np.ndarray) -> float:
        """Return the standard deviation up to which a value of a curve y (K,) counts as known."""
        return CRITERIA.known * float(np.abs(y - self.neutral).max())

    def physical(self, y: np.ndarray, std: np.ndarray) -> np.ndarray:
        """Return the curve nearest to y (K,), in units of std, that has the sign and the slope that physics asks of
        it.

        A form that moves with the curve may be all but certain where it is next to nothing, and its tails alone would
        decide: what is known better than `Criteria.known` asks counts as known so well.
        """
        if self.monotone:
            y = isotonic_regression(y, weights=1.0 / np.maximum(std, max(self._unsure(y), 1e-300)) ** 2).x
        return np.maximum(y, self.neutral) if self.one_sided else y

    def values(self, y: np.ndarray) -> dict[str, float]:
        """Return the effect's parameters of the curve through y (K,) at the knots."""
        curve = registry.split_key(self.key)[0].curve
        assert curve is not None
        return curve.values(self.over.name, self.x.tolist(), y.tolist(), self.against)

    def table(self, y: np.ndarray) -> Table:
        """Return the table of the curve through y (K,) at the knots."""
        return Table(self.over, tuple(self.x.tolist()), tuple(y.tolist()), self.against)


def curve_at(x: np.ndarray, y: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the curve through knots x, y (K,) at `at` (n,), as the engines have it."""
    E = np.zeros(Y + KNOTS)
    E[NUMBER], E[X : X + len(x)], E[Y : Y + len(x)] = len(x), x, y
    return np.array([value(E, 0, float(v)) for v in at])


def spread_along(
    form: Callable[[np.ndarray], np.ndarray], start: float, end: float, known: tuple[float, float]
) -> np.ndarray:
    """Return KNOTS places between two ends such that the curve through a form there is off by about as much in every
    stretch, and by a third of that where the form is known.
    """
    fine = np.linspace(start, end, 401)
    weight = np.where((fine >= known[0]) & (fine <= known[1]), 3.0, 1.0)
    x, best, least = np.linspace(start, end, KNOTS), np.empty(0), np.inf
    for _ in range(_ROUNDS):
        off = weight * np.abs(curve_at(x, form(x), fine) - form(fine))
        if off.max() < least:
            best, least = x, float(off.max())
        each = np.array([off[(fine >= a) & (fine <= b)].max(initial=0.0) for a, b in pairwise(x)])
        length = (
            np.diff(x) / (each / max(float(off.max()), 1e-300) + 0.02) ** 0.15
        )  # where it is off, knots move together
        length = np.maximum(length, _CLOSEST * length.sum())
        x = start + (end - start) * np.concatenate([[0.0], np.cumsum(length)]) / length.sum()
    return best


def possible_laws(fit: Fit) -> list[Law]:
    """Return every law that could act along a fitted run and that its crane does not have; those over a range that was
    hardly visited are left out, and curves of one's own, of which nobody knows what they run over.
    """
    found, lay = [], fit.crane.layout
    visits = visited(fit)
    for effect in registry.known():
        for key, place in zip(effect.keys(lay), effect.on(lay), strict=True):
            if effect.curve is None or fit.crane.effect(key) is not None:
                continue
            for over in effect.curve.over:
                x, often = visits.get((effect.name, place, over.name), (np.zeros(0), (0.0, 0.0)))
                if often[1] - often[0] > CRITERIA.ranging * (over.high - over.low):
                    found += [Law(key, over, against, knots(x, over), x, often) for against in over.against]
    return found


def knots(visited: np.ndarray, over: Argument) -> np.ndarray:
    """Return knots over the visited values: half by their range, half by how often they were met; closer at 0 where a
    curve begins there.
    """
    low, high = np.quantile(visited, [CRITERIA.seldom, 1.0 - CRITERIA.seldom])
    low = 0.0 if over.from_zero else max(low, 0.0) if over.magnitude else low
    shares = np.linspace(0.0, 1.0, CRITERIA.knots)
    if over.from_zero:
        return high * shares**1.5  # where nothing flows a curve may be steep
    if over.slope and low < 0.0 < high:
        each = np.linspace(0.0, 1.0, CRITERIA.knots // 2 + 2)[1:] ** 1.5
        return np.concatenate([low * each[::-1], [0.0], high * each])
    inside = visited[(visited >= low) & (visited <= high)]
    by_range, by_number = low + (high - low) * shares, np.quantile(inside, shares)
    return 0.6 * by_range + 0.4 * by_number


def visited(fit: Fit) -> Mapping[tuple[str, str, str], tuple[np.ndarray, tuple[float, float]]]:
    """Return the values (n,) of each argument of each learned effect at each place along a fitted run, where the effect
    can act, sorted, and between which ends they were met often.
    """
    X, W, time = trajectory(fit)
    lay = fit.crane.layout
    t = SemiRecursiveEngine(fit.crane).terms_along(X, W, time)
    clock = _EVERY * np.arange(len(X))
    found: dict[tuple[str, str, str], tuple[np.ndarray, tuple[float, float]]] = {}
    P, vacuum = fit.crane.parameter_vector(), vapour_pressure(fit.crane)

    def met(effect: str, place: str, over: str, values: np.ndarray, where: np.ndarray | None = None) -> None:
        where = np.ones(len(values), dtype=bool) if where is None else where
        values, when = values[where], np.resize(clock, len(values))[where]
        found[effect, place, over] = np.sort(values), often_met(values, when)

    drawn, returned = np.zeros(len(X)), np.zeros(len(X))
    for c, place in enumerate(lay.cylinders):
        a, b, U = 2 * c, 2 * c + 1, W[:, c]
        p, v = np.maximum(X[:, lay.pressures_of(c)], vacuum), t[f"v_h{c + 1}"]
        Qa, Qb = t[f"Q{a + 1}"], t[f"Q{b + 1}"]
        out, into = np.where(U > 0.0, Qa, -Qb), np.where(U > 0.0, Qb, -Qa)
        drawn, returned = drawn + out, returned + into
        opened, moves = np.abs(U) > 2e-3, np.abs(v) > 2e-3
        drops = np.concatenate(
            [t["pp"] - np.where(U > 0.0, p[:, 0], p[:, 1]), np.where(U > 0.0, p[:, 1], p[:, 0]) - t["pt"]]
        )
        met("learned_opening", place, "spool", U, opened)
        met("learned_opening", place, "pressure_drop", drops, np.tile(opened, 2) & (drops > 0.0))
        met("learned_force", place, "speed", np.abs(v), moves)
        met("learned_force", place, "stroke", t[lay.lengths[c]])
        met("learned_force", place, "pressure_drop", np.abs(p[:, 0] - p[:, 1]), moves)
        met("learned_leakage", place, "pressure_drop", np.abs(p[:, 0] - p[:, 1]))
        for side, chamber in enumerate(lay.sides[c]):
            met("learned_flow", chamber, "pressure", p[:, side] - outside_pressure(P))
    for i, place in enumerate(lay.joints):
        rate = np.abs(X[:, lay.velocities][:, i])
        met("learned_torque", place, "angle", X[:, lay.positions][:, i])
        met("learned_torque", place, "rate", rate, rate > 2e-3)
    met("learned_supply", "", "flow", drawn, drawn > 1e-6)
    met("learned_return", "", "flow", returned, returned > 1e-6)
    return found


def often_met(values: np.ndarray, time: np.ndarray) -> tuple[float, float]:
    """Return the ends beyond which values (n,) went within less than a block of time only; (0, 0) where they are all
    of one block.
    """
    if not len(values) or np.ptp(time) < CRITERIA.block:
        return 0.0, 0.0
    order, ends = np.argsort(values), []
    for out in (order, order[::-1]):
        span = np.maximum.accumulate(time[out]) - np.minimum.accumulate(time[out])
        ends.append(float(values[out[np.searchsorted(span, CRITERIA.block)]]))
    return ends[0], ends[1]


def trajectory(fit: Fit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return states (n, nx), inputs (n, valves + 2) and times (n,) along a fitted run, window by window."""
    parts = []
    for i, data in enumerate(fit.data.parts):
        own, stride = fit.of(i), max(1, round(_EVERY / data.step))
        model = model_of(own.crane, data, own.late)
        for window, x0 in zip(own.windows, own.knots, strict=True):
            W = model.W[window.start : window.start + len(window.data.time)]
            time = window.data.time
            X = model.run(x0, W, time, data.step)[0]
            parts.append((X[:-1:stride], W[:-1:stride], time[:-1:stride]))
    X, W, time = (np.concatenate(p) for p in zip(*parts, strict=True))
    whole = np.isfinite(X).all(axis=1)
    return X[whole], W[whole], time[whole]


def unit_over(law: Law, layout: Layout) -> str:
    """Return the unit of what a law runs over; on a sliding joint an angle is a way."""
    place = law.key.partition("@")[2]
    slides = dict(zip(layout.joints, layout.slides or (False,) * len(layout.joints), strict=True))
    return law.over.unit.replace("rad", "m") if slides.get(place) else law.over.unit
