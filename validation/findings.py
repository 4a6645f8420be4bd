"""Where a model fails, in sentences: which channel is badly predicted or which balance violated, when, and during what
work.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from crane_exudyn import channels
from crane_exudyn.display import engineering, rounded
from crane_exudyn.layout import Layout
from ukf.estimate import Estimate

from .balances import Balances
from .phases import Phase, kinds

#: a phase counts as badly predicted when the innovations' RMS is so many times what the filter expects
PREDICTED_BADLY = 1.5
#: a balance counts as violated when its mean residual is so many standard deviations from zero
VIOLATED = 4.0
#: a joint counts as moving from this mean rate on, rad/s or m/s
_TURNING = 5e-3


@dataclass(frozen=True)
class Finding:
    """One place where the model fails: a channel or an equation, from, to (s), phase of work, score, and a sentence.

    The score is in standard deviations: for a channel of what the filter expects (RMS), for an equation of the mean
    residual. `value` is in SI: the RMS innovation of a channel, the mean residual of an equation.
    """

    kind: Literal["channel", "equation"]
    name: str
    start: float
    end: float
    phase: str
    score: float
    text: str
    value: float = math.nan

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as the JSON of compare and diagnose has it."""
        place = {self.kind: self.name, "from": self.start, "to": self.end}
        return place | {"phase": self.phase, "score": self.score, "text": self.text}


@dataclass(frozen=True)
class Scores:
    """How well each phase is explained; F phases, k channels, b equations.

    Attributes:
        channels (F, k): RMS innovation over what the filter expects, NaN with fewer than five samples; errors (F, k):
            in SI.
        samples (F, k): number of samples.
        means, stds (F, b): mean residual of each balance and its standard deviation, SI; infinite where it cannot be
            known.
        turning (F, n): mean rates of the joints, rad/s or m/s.
        layout: of the machine, for names and words.
    """

    phases: Sequence[Phase]
    channel_names: tuple[str, ...]
    channels: np.ndarray
    errors: np.ndarray
    samples: np.ndarray
    means: np.ndarray
    stds: np.ndarray
    turning: np.ndarray
    layout: Layout

    @property
    def equations(self) -> np.ndarray:
        """Mean residual of each balance in its standard deviations (F, b), signed."""
        return self.means / self.stds

    @property
    def badly_predicted(self) -> np.ndarray:
        """Whether the filter predicts a channel worse than noise explains, (F, k) bool."""
        limit = np.maximum(PREDICTED_BADLY, 1.0 + 4.0 / np.sqrt(2.0 * np.maximum(self.samples, 1)))
        return np.asarray(self.channels > limit)

    def findings(self) -> list[Finding]:
        """Return all places where the model fails, worst first."""
        return sorted([*self._predictions(), *self._violations()], key=lambda f: f.score, reverse=True)

    def _predictions(self) -> list[Finding]:
        found = []
        for i, j in np.argwhere(self.badly_predicted):
            phase, name, score = self.phases[i], self.channel_names[j], float(self.channels[i, j])
            text = (
                f"{phase.words}, {name} is {value_text(name, self.errors[i, j], self.layout)} (RMS) off the filter's "
                "prediction"
            )
            text += f", {score:.1f} times what noise explains"
            found.append(
                Finding("channel", name, phase.start, phase.end, phase.kind, score, text, float(self.errors[i, j]))
            )
        return found

    def _violations(self) -> list[Finding]:
        found = []
        for i, j in np.argwhere(np.abs(self.equations) > VIOLATED):
            phase, name, mean = self.phases[i], self.layout.equations[j], float(self.means[i, j])
            rate = float(self.turning[i, j]) if name in self.layout.torques else 0.0
            text = f"{phase.words}, {violation(name, mean, float(self.stds[i, j]), self.layout, rate)}"
            score = float(abs(self.equations[i, j]))
            found.append(Finding("equation", name, phase.start, phase.end, phase.kind, score, text, mean))
        return found

    def by_kind(self) -> list[tuple[str, np.ndarray, np.ndarray]]:
        """Return (kind of work, mean residuals (b,), standard deviations (b,)) over all phases of each kind, in the
        order of `kinds`.

        NaN where no phase of a kind tells anything about a balance.
        """
        found = []
        for kind in kinds(self.layout):
            chosen = [i for i, phase in enumerate(self.phases) if phase.kind == kind]
            if chosen:
                known = np.isfinite(self.stds[chosen])
                weight = known * np.array([[self.phases[i].end - self.phases[i].start] for i in chosen])
                total = np.where(known.any(axis=0), weight.sum(axis=0), np.nan)
                std = np.sqrt(((weight * np.where(known, self.stds[chosen], 0.0)) ** 2).sum(axis=0))
                found.append((kind, (weight * self.means[chosen]).sum(axis=0) / total, std / total))
        return found


def scores_of(estimate: Estimate, balances: Balances, phases: Sequence[Phase]) -> Scores:
    """Return how well each phase is explained by filter and balances."""
    relative = estimate.innovation / estimate.innovation_std
    edges = np.searchsorted(estimate.time, [(p.start, p.end) for p in phases])
    shape = (len(phases), len(estimate.channel_names))
    channels, errors, samples = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=int)
    for i, (a, b) in enumerate(edges):
        for j in range(shape[1]):
            known = np.isfinite(relative[a:b, j])
            samples[i, j] = known.sum()
            if samples[i, j] >= 5:
                channels[i, j] = np.sqrt(np.mean(relative[a:b, j][known] ** 2))
                errors[i, j] = np.sqrt(np.mean(estimate.innovation[a:b, j][known] ** 2))
    lay = balances.layout
    pairs = [balances.mean(p.first, p.last) for p in phases]
    turning = np.array([balances.states[p.first : p.last, lay.velocities].mean(axis=0) for p in phases])
    means, stds = np.array([m for m, _ in pairs]), np.array([s for _, s in pairs])
    for i, p in enumerate(phases):  # at the pressure floor a balance says nothing about the flow into the chamber
        stds[i, len(lay.torques) :][balances.at_floor[p.first : p.last].any(axis=0)] = math.inf
    scores = Scores(phases, estimate.channel_names, channels, errors, samples, means, stds, turning, lay)
    if scores.badly_predicted.any():
        return scores
    # what the smoother did not find the end of accuses nobody by itself
    moving = [any(p.start < end and begin < p.end for begin, end in balances.unsettled) for p in phases]
    return replace(scores, stds=np.where(np.array(moving)[:, None], math.inf, stds))


# -- words -----------------------------------------------------------------------------------------------------------


def people_unit(name: str, layout: Layout) -> tuple[str, float]:
    """Return the unit in which people read a channel or a balance of a machine, and what one of it is in SI."""
    units = channels.of(layout)
    return engineering(units[name] if name in units else layout.unit_of(name))


def balance_words(equation: str) -> str:
    """Return a balance in words, such as "flow into p1"."""
    return equation.replace("torque.", "moment at ").replace("flow.", "flow into ")


def value_text(name: str, value: float, layout: Layout) -> str:
    """Return a value in SI as people read it, such as "1.2 bar"."""
    unit, factor = people_unit(name, layout)
    return f"{value / factor:.2g} {unit}"


def violation(equation: str, mean: float, std: float, layout: Layout, rate: float = 0.0) -> str:
    """Return what a mean residual says, ± half its 95 % interval; `rate` is that of the joint, for moments."""
    unit, factor = people_unit(equation, layout)
    amount = f"{rounded(abs(mean) / factor, 1.96 * std / factor)} {unit}"
    place = equation.rpartition(".")[2]
    if equation.startswith("flow."):
        return (
            f"chamber {place} ({layout.side_of(place)}) receives {amount} {'more' if mean > 0 else 'less'} than the "
            "model predicts"
        )
    motion = ""
    if abs(rate) > _TURNING:
        motion = ", against its motion" if rate * mean < 0 else ", in the direction of its motion"
    body = layout.bodies[layout.joints.index(place)].replace("_", " ")
    if unit == "N":
        way = "out" if mean > 0 else "in"
        return f"joint {place} pushes the {body} {way} with {amount} more than the model predicts{motion}"
    way = "upwards" if mean > 0 else "downwards"
    return f"joint {place} turns the {body} {way} with {amount} more than the model predicts{motion}"
