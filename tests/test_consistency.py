"""The consistency statistics against scipy's distributions and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from ukf import consistency
from ukf import filter as kf
from ukf.sigma_points import merwe

RNG = np.random.default_rng(41)


def test_nis_and_nees_are_chi_square():
    n, count = 3, 4000
    a = RNG.normal(size=(n, n)) * np.array([1.0, 1e3, 1e6])[:, None]  # units as different as rad and Pa
    errors = RNG.normal(size=(count, n)) @ a.T
    covariances = np.broadcast_to(a @ a.T, (count, n, n))
    for values in (consistency.nis(errors, covariances), consistency.nees(errors, covariances)):
        assert stats.kstest(values, stats.chi2(n).cdf).pvalue > 0.01
        low, high = consistency.mean_bounds(n, count, 0.99)
        assert low < values.mean() < high


def test_bounds_against_the_tables():
    low, high = consistency.mean_bounds(4, 1)
    assert (low, high) == pytest.approx((0.4844, 11.1433), abs=1e-4)
    assert consistency.mean_bounds(4, 10**6) == pytest.approx((4.0, 4.0), abs=0.02)


def test_coverage_counts_what_is_inside():
    std = np.full((4, 2), 1.0)
    errors = np.array([[0.0, 3.0], [1.9, 3.0], [2.0, np.nan], [-1.0, 0.0]])
    np.testing.assert_allclose(consistency.coverage(errors, std), [0.75, 1 / 3])
    many = RNG.normal(size=(20000, 1))
    assert consistency.coverage(many, np.ones_like(many))[0] == pytest.approx(0.95, abs=0.005)  # 3 standard errors


def test_whiteness():
    white = RNG.normal(size=3000)
    assert consistency.ljung_box(white) > 1e-3  # uniform p-values are the next test
    assert consistency.ljung_box(white[1:] + 0.3 * white[:-1]) < 1e-6
    assert consistency.ljung_box(white + 0.3) < 1e-6  # a bias is not white: the mean is taken as zero
    assert np.isnan(consistency.ljung_box(white[:30]))


def test_whiteness_p_values_are_uniform():
    p = [consistency.ljung_box(RNG.normal(size=400)) for _ in range(300)]
    assert stats.kstest(p, "uniform").pvalue > 0.01


def linear_run(seed: int, steps: int, q_scale: float) -> tuple[np.ndarray, np.ndarray]:
    """One linear truth and its filter, whose process noise is `q_scale` times the true one: NEES, NIS by step."""
    rng = np.random.default_rng(seed)
    f, h = np.array([[1.0, 0.1], [-0.1, 0.95]]), np.array([[1.0, 0.0]])
    q, r, weights = np.diag([0.01, 0.04]), np.array([[0.25]]), merwe(2)
    x, belief, nees, nis = rng.normal(size=2), kf.Belief(np.zeros(2), np.eye(2)), [], []
    for _ in range(steps):
        x = f @ x + rng.multivariate_normal(np.zeros(2), q)
        y = h @ x + rng.normal(size=1) * 0.5
        belief = kf.update(
            kf.predict(belief, lambda p: p @ f.T, q_scale * q, weights), lambda p: p @ h.T, y, r, weights
        )
        error = (x - belief.mean)[None]
        nees.append(consistency.nees(error, belief.covariance[None])[0])
        nis.append(belief.nis)
    return np.array(nees), np.array(nis)


def test_right_filter_is_consistent_and_a_wrong_one_is_not():
    runs, steps = 40, 60
    right = [linear_run(seed, steps, 1.0) for seed in range(runs)]
    wrong = [linear_run(seed, steps, 0.05) for seed in range(runs)]
    low, high = consistency.mean_bounds(1, runs * steps, 0.99)
    assert low < np.mean([nis for _, nis in right]) < high
    assert np.mean([nis for _, nis in wrong]) > high
    low, high = consistency.mean_bounds(2, runs, 0.99)  # runs are independent, steps of one run are not
    assert low < np.mean([nees[-1] for nees, _ in right]) < high
    assert np.mean([nees[-1] for nees, _ in wrong]) > high
