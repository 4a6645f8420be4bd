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

from .estimate import Estimate
from .estimator import Estimator
from .filter import Belief
from .monitor import ABSENT
from .recorder import Outcome, Recorder
from .samples import positive
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
        CraneError: fewer than two models, two that share an estimator, one that repeats its beginning, other states or
            sensors in one, or a time that is not positive.
    """

    def __init__(self, estimators: Mapping[str, Estimator], stays: float = STAYS) -> None:
        if not isinstance(estimators, Mapping) or not all(isinstance(e, Estimator) for e in estimators.values()):
            raise CraneError('SideBySide: found no estimators by name. Give {"sound": Estimator(…), "leaky": …}.')
        if len(estimators) < 2:
            raise CraneError(f"Only one model ({', '.join(estimators)}). Give two or more to run side by side.")
        self.stays = positive(stays, "stays", "the seconds for which a machine stays with a model", endless=True)
        self.names, self.estimators = tuple(estimators), list(estimators.values())
        if len({id(e) for e in self.estimators}) < len(self.names):
            raise CraneError(f"{', '.join(self.names)}: two names share one estimator. Give each its own.")
        if again := [n for n, e in estimators.items() if e.options.revisit is not None]:
            raise CraneError(f"{again[0]}: models side by side cannot repeat the beginning. Leave revisit out.")
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
        plans = [e.set_out(recording) for e in self.estimators]
        lead, common = plans[0], len(self.states)
        probability = np.full((lead.time.size, len(plans)), 1.0 / len(plans))
        recorder = Recorder(self.states, self.estimators[0].channel_names, lead.time, False, False)
        recorder.start(mixture(probability[0], self._beliefs(common)))
        for k in range(1, lead.time.size):
            before = self._interact(probability[k - 1], float(lead.time[k] - lead.time[k - 1]), common)
            outcomes = [e.on_plan(plan, k) for e, plan in zip(self.estimators, plans, strict=True)]
            probability[k], likelihood = _weighed(before, outcomes)
            best = outcomes[int(probability[k].argmax())]
            recorder.note(k, mixture(probability[k], self._beliefs(common)), best._replace(log_likelihood=likelihood))
            if progress is not None and k % 500 == 0:
                progress(k / lead.time.size)
        return self._mixed(recorder, plans, probability)

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

    def _mixed(self, recorder: Recorder, plans: Sequence[Plan], probability: np.ndarray) -> Estimate:
        events = list(plans[0].events)
        for name, estimator, plan in zip(self.names, self.estimators, plans, strict=True):
            own = estimator.events[len(plan.events) :]
            events += [(time, f"{where} of {name}", text) for time, where, text in own]
        mixed = self.estimators[0].estimate_of(recorder, plans[0], events)
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


def _weighed(before: np.ndarray, outcomes: Sequence[Outcome]) -> tuple[np.ndarray, float]:
    """Return the probabilities (m,) of the models after a sample, and its log-likelihood under all of them.

    A filter that failed is worth the least of the others.
    """
    logs = np.array([o.log_likelihood for o in outcomes])
    lost = np.array([bool((o.flags == ABSENT).all()) for o in outcomes])
    if lost.any():
        logs[lost] = 0.0 if lost.all() else logs[~lost].min()
    weights = before * np.exp(logs - logs.max())
    after = np.maximum(weights, _LEAST)
    return np.asarray(after / after.sum()), float(logs.max() + np.log(weights.sum()))
