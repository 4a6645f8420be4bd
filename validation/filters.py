"""EKF, cubature filter, UKF and square-root UKF on the same crane, recording and covariances: accuracy and cost."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from ukf.estimator import Estimator
from ukf.methods import METHODS
from ukf.process import engine_of
from ukf.tuning import cut

from . import metrics, paper


class Timed:
    """An engine that notes how long its steps take, and how many states went through."""

    def __init__(self, engine: Any) -> None:
        """`engine` does the work."""
        self._engine = engine
        self.crane, self.state_names = engine.crane, engine.state_names
        self.seconds, self.rows = 0.0, 0

    def propagate(
        self, states: np.ndarray, inputs: np.ndarray, dt: float, time: float = 0.0, parameters: Any = None
    ) -> np.ndarray:
        """Return what the engine returns."""
        begin = clock.process_time()
        keywords = {"parameters": parameters} if parameters else {}
        out: np.ndarray = self._engine.propagate(states, inputs, dt, time, **keywords)
        self.seconds += clock.process_time() - begin
        self.rows += len(states)
        return out

    def static_start(self, *arguments: Any, **keywords: Any) -> np.ndarray:
        """Return the engine's static start."""
        start: np.ndarray = self._engine.static_start(*arguments, **keywords)
        return start


@dataclass(frozen=True)
class Row:
    """One filter: accuracy by state, NIS (one a sensor expected) and cost of a step in microseconds of processor
    time.
    """

    method: str
    tuning: str
    pn_rmse: dict[str, float]
    nees_mean: float
    nis_mean: float
    states_per_step: float
    engine_us: float
    algebra_us: float

    def document(self) -> dict[str, Any]:
        """Return the row as JSON."""
        return self.__dict__ | {"total_us": self.engine_us + self.algebra_us}


def compare_filters(
    engine: str = "exudyn",
    *,
    model_error: float = 0.15,
    inputs: int = 1,
    seed: int = 0,
    tunings: Sequence[str] = ("paper", "own"),
    methods: Sequence[str] = METHODS,
    crane: Crane | None = None,
    duration: float = paper.DURATION,
    progress: Callable[[float], None] | None = None,
) -> list[Row]:
    """Return a row for every filter and tuning on one case of the paper's experiment; all see the same noise."""
    crane = crane if crane is not None else Crane.load("patu655")
    experiment = paper.real_system(crane, inputs, engine, seed, duration)
    wrong = paper.wrong_crane(crane, model_error)
    model = engine_of(engine, wrong)
    rows = []
    widths = {t: paper.likeliest_width(wrong, experiment, t) for t in tunings}
    for k, (tuning, method) in enumerate((t, m) for t in tunings for m in methods):
        filter_ = paper.estimator(wrong, experiment, Timed(model), tuning, method, widths[tuning])
        rows.append(_row(filter_, experiment, tuning, method))
        if progress is not None:
            progress((k + 1) / (len(tunings) * len(methods)))
    return rows


def _row(filter_: Estimator, experiment: paper.Experiment, tuning: str, method: str) -> Row:
    engine = filter_.engine
    filter_.run(cut(experiment.signals, 0.0, 0.02))  # compiles
    engine.seconds, engine.rows = 0.0, 0
    begin = clock.process_time()
    estimate = filter_.run(experiment.signals, keep_covariance=True)
    seconds = clock.process_time() - begin
    steps = estimate.time.size - 1
    assert estimate.covariance is not None
    errors = metrics.pn_rmse(estimate.mean[:, filter_.crane.layout.basic], experiment.truth)
    return Row(
        method=method,
        tuning=tuning,
        pn_rmse=dict(zip(paper.STATES, errors.tolist(), strict=True)),
        nees_mean=float(np.mean(metrics.nees(estimate.mean, experiment.truth, estimate.covariance))),
        nis_mean=estimate.nis_mean,
        states_per_step=engine.rows / steps,
        engine_us=1e6 * engine.seconds / steps,
        algebra_us=1e6 * (seconds - engine.seconds) / steps,
    )
