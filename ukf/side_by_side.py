"""Several models side by side: which of them the machine follows now, and an estimate that mixes them by how likely
they are.

The interacting multiple model filter (Blom and Bar-Shalom 1988). Every model has an estimator of its own. Between two
samples the machine may go over from one model to another: it stays with one for `stays` seconds on the average. Every
sample is one round:

1. *Interaction.* Each filter begins from the mixture of all beliefs, weighed by how probable it is that the machine was
   with their model and goes over to its own.
2. *Prediction and correction*, each with its own model.
3. *Probabilities* go up and down with the likelihood of each filter's innovations.
4. *The estimate* is the mixture: its covariance holds what the models differ by.

What a model estimates beyond the states that all have in common (a pendulum, a lagged sensor, an unknown) follows these
states as its own filter believes that it does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError

from .consistency import log_likelihood
from .estimate import Estimate
from .estimator import Estimator
from .filter import Belief
from .monitor import ABSENT, USED
from .recorder import Recorder
from .signals import Plan

#: s that the machine stays with a model on the average
STAYS = 20.0
#: least probability of a model, so that it can come back
_LEAST = 1e-9


def check_same_machine(models: Mapping[str, Crane]) -> None:
    """Raise CraneError, which tells the states of both, where one of the models, by name, has other states than the
    first.
    """
    names = tuple(models)
    first = models[names[0]].layout.states
    for name, model in models.items():
        if model.layout.states != first:
            raise CraneError(
                f"{name} is not a model of the same machine as {names[0]}: its states are "
                f"{' '.join(model.layout.states)} instead of {' '.join(first)}. Give crane files of one machine."
            )


class SideBySide:
    """Estimators of one machine by several models.

    Args:
        estimators: by the model's name; with the same sensors and engine states of the same machine.
        stays: seconds that the machine stays with a model on the average.

    Raises:
        CraneError: fewer than two models, other states or sensors in one, or a time that is not positive.
    """

    def __init__(self, estimators: Mapping[str, Estimator], stays: float = STAYS) -> None:
        if len(estimators) < 2:
            raise CraneError(f"Only one model ({', '.join(estimators)}). Give two or more to run side by side.")
        if not stays > 0.0:
            raise CraneError(f"A machine cannot stay {stays:g} s with a model. Give a positive time.")
        self.names, self.estimators, self.stays = tuple(estimators), list(estimators.values()), float(stays)
        check_same_machine({name: e.crane for name, e in estimators.items()})
        first = self.estimators[0]
        self.states = first.crane.layout.states
        for name, other in zip(self.names, self.estimators, strict=True):
            if other.channel_names != first.channel_names:
                raise CraneError(
                    f"{name} has the sensors {' '.join(other.channel_names)}, and {self.names[0]} "
                    f"{' '.join(first.channel_names)}. Give both the same ones, in the same order."
                )

    def __repr__(self) -> str:
        sensors = ", ".join(self.estimators[0].channel_names)
        return f"<SideBySide of {', '.join(self.names)}: {' '.join(self.states)} from sensors {sensors}>"

    def run(self, recording: Any, *, progress: Callable[[float], None] | None = None) -> Estimate:
        """Return the mixed estimate, over a recording, of the states that all models have; its `models` say how
        probable each was.
        """
        plans = [e.opened(recording) for e in self.estimators]
        lead, common = plans[0], len(self.states)
        probability = np.full((lead.time.size, len(plans)), 1.0 / len(plans))
        recorder = Recorder(self.states, self.estimators[0].channel_names, lead.time, False, False)
        recorder.start(mixture(probability[0], self._beliefs(common)))
        for k in range(1, lead.time.size):
            before = self._interact(probability[k - 1], float(lead.time[k] - lead.time[k - 1]), common)
            results = [e.on_plan(plan, k) for e, plan in zip(self.estimators, plans, strict=True)]
            probability[k], likelihood = _weighed(before, *_logs(results, [e.gate for e in self.estimators]))
            best = results[int(probability[k].argmax())]
            recorder.note(k, mixture(probability[k], self._beliefs(common)), *best[:4], likelihood)
            if progress is not None and k % 500 == 0:
                progress(k / lead.time.size)
        return self._told(recorder, plans, probability)

    def _beliefs(self, count: int) -> list[Belief]:
        """Return each filter's belief in the states that all have."""
        return [Belief(e.belief.mean[:count], e.belief.covariance[:count, :count]) for e in self.estimators]

    def _interact(self, probability: np.ndarray, dt: float, count: int) -> np.ndarray:
        """Let each filter begin from the mixture that leads to its model; return the probabilities (models,) before the
        sample.
        """
        leaves = -np.expm1(-dt / self.stays) / (len(probability) - 1)
        over = np.full((len(probability), len(probability)), leaves)
        np.fill_diagonal(over, 1.0 - leaves * (len(probability) - 1))
        joint = probability[:, None] * over
        after = joint.sum(axis=0)
        beliefs = self._beliefs(count)
        for j, estimator in enumerate(self.estimators):
            mixed = mixture(joint[:, j] / after[j], beliefs)
            estimator.believe(followed(estimator.belief, mixed))
        return np.asarray(after)

    def _told(self, recorder: Recorder, plans: Sequence[Plan], probability: np.ndarray) -> Estimate:
        events = list(plans[0].events)
        for name, estimator, plan in zip(self.names, self.estimators, plans, strict=True):
            own = estimator.events[len(plan.events) :]
            events += [(time, where, f"{text} (as {name} sees it)") for time, where, text in own]
        mixed = self.estimators[0].told(recorder, plans[0], events)
        models = dict(zip(self.names, probability.T, strict=True))
        return replace(
            mixed, crane=" | ".join(self.names), method=f"{mixed.method}, models side by side", models=models
        )


def mixture(weights: np.ndarray, beliefs: Sequence[Belief]) -> Belief:
    """Return mean and covariance of a mixture of beliefs with weights (m,) that sum to one."""
    mean = np.asarray(sum(w * b.mean for w, b in zip(weights, beliefs, strict=True)))
    covariance = np.zeros((mean.size, mean.size))
    for w, b in zip(weights, beliefs, strict=True):
        away = b.mean - mean
        covariance += w * (b.covariance + np.outer(away, away))
    return Belief(mean, covariance)


def followed(own: Any, mixed: Belief) -> Belief:
    """Return a belief whose first states are as in `mixed`; the others follow them by the regression of the `own`
    belief.
    """
    m, P = mixed.mean.size, own.covariance
    if own.mean.size == m:
        return mixed
    scale = np.sqrt(np.diag(P)[:m])
    slope = np.linalg.solve(P[:m, :m] / np.outer(scale, scale), P[:m, m:] / scale[:, None]).T / scale
    rest = P[m:, m:] - slope @ P[:m, m:]
    mean = np.concatenate([mixed.mean, own.mean[m:] + slope @ (mixed.mean - own.mean[:m])])
    across = mixed.covariance @ slope.T
    return Belief(mean, np.block([[mixed.covariance, across], [across.T, rest + slope @ across]]))


Result = tuple[np.ndarray, np.ndarray, np.ndarray, float, float]


def _logs(results: Sequence[Result], gates: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return log-likelihoods of a sample by model (m,): of the same sensors for all, by which they are compared, and of
    those that each believes.

    A sensor that a filter does not believe counts against it as a reading at its gate does; a filter that failed is
    worth the least of the others.
    """
    alike, own = np.empty(len(results)), np.array([r[4] for r in results])
    for k, (innovation, variance, flags, _, log) in enumerate(results):
        left = ~np.isnan(innovation) & (flags != USED) & (flags != ABSENT)
        reach = gates[k] * np.sqrt(variance[left])
        alike[k] = log + log_likelihood(np.clip(innovation[left], -reach, reach), variance[left])
    lost = np.array([bool((r[2] == ABSENT).all()) for r in results])
    if lost.any():
        alike[lost] = 0.0 if lost.all() else alike[~lost].min()
    return alike, own


def _weighed(before: np.ndarray, alike: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the probabilities (m,) after a sample, and its log-likelihood under all models; see `_logs`."""
    after = np.maximum(before * np.exp(alike - alike.max()), _LEAST)
    return np.asarray(after / after.sum()), float(own.max() + np.log(before @ np.exp(own - own.max())))
