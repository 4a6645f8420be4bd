"""The filter algebra against what nobody here chose: the exact Kalman filter, filterpy, and square roots of
matrices.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.optimize import minimize

from crane_exudyn.errors import CraneError
from ukf import filter as kf
from ukf.linear_algebra import cholesky, lower_factor, semidefinite_root
from ukf.noise import PaperNoise, ProcessNoise, measurement_noise, paper_start_covariance
from ukf.revisit import Beginning, Step
from ukf.sigma_points import Weights, centre_gain, cubature, merwe, simplex
from ukf.smoother import smooth

RNG = np.random.default_rng(655)
N, K = 4, 2


def covariance(n: int, scale: np.ndarray | float = 1.0) -> np.ndarray:
    a = RNG.normal(size=(n, n))
    s = np.broadcast_to(scale, n)
    return (a @ a.T + n * np.eye(n)) * np.outer(s, s)


F = np.eye(N) + 0.1 * RNG.normal(size=(N, N))
H = RNG.normal(size=(K, N))
Q, R = 0.01 * covariance(N), covariance(K)
START = kf.Belief(RNG.normal(size=N), covariance(N))
MEASURED = RNG.normal(size=(30, K))


def linear(points: np.ndarray) -> np.ndarray:
    return points @ F.T


def seen(points: np.ndarray) -> np.ndarray:
    return points @ H.T


def exact_kalman(mean, cov, y):
    """The textbook recursion."""
    mean, cov = F @ mean, F @ cov @ F.T + Q
    gain = cov @ H.T @ np.linalg.inv(H @ cov @ H.T + R)
    return mean + gain @ (y - H @ mean), cov - gain @ H @ cov


def pendulum(points: np.ndarray) -> np.ndarray:
    """Two damped pendulums with a coupled, curved dynamics: a stand-in for any nonlinear engine."""
    out = points.copy()
    out[:, :2] += 0.05 * points[:, 2:]
    out[:, 2:] -= 0.05 * (9.81 * np.sin(points[:, :2]) + 0.3 * points[:, 2:] * np.abs(points[:, 2:]))
    out[:, 2] += 0.1 * points[:, 0] * points[:, 1]
    return out


def curved(points: np.ndarray) -> np.ndarray:
    return np.column_stack([np.sin(points[:, 0]), points[:, 1] * points[:, 2]])


def run_covariance(weights: Weights, propagate, observe, belief=START, noise=Q):
    beliefs = []
    for k, y in enumerate(MEASURED):
        belief = kf.update(kf.predict(belief, propagate, noise, weights, step=k), observe, y, R, weights, step=k)
        beliefs.append(belief)
    return beliefs


def run_root(weights: Weights, propagate, observe):
    belief, q, r = kf.root_of(START), semidefinite_root(Q), np.linalg.cholesky(R)
    beliefs = []
    for y in MEASURED:
        belief = kf.update_root(kf.predict_root(belief, propagate, q, weights), observe, y, r, weights)
        beliefs.append(belief)
    return beliefs


def run_linearised(propagate, observe):
    belief, beliefs = START, []
    for y in MEASURED:
        step = np.full(N, 1e-5)
        belief = kf.update_linearised(kf.predict_linearised(belief, propagate, Q, step), observe, y, R, step)
        beliefs.append(belief)
    return beliefs


@pytest.mark.parametrize("weights", [merwe(N), merwe(N, 1e-1, 2.0), merwe(N, 1.0, 0.0, 1.0), cubature(N), simplex(N)])
@pytest.mark.parametrize("form", ["covariance", "root"])
def test_linear_case_is_the_kalman_filter(weights, form):
    beliefs = run_covariance(weights, linear, seen) if form == "covariance" else run_root(weights, linear, seen)
    mean, cov = START.mean, START.covariance
    for belief, y in zip(beliefs, MEASURED, strict=True):
        mean, cov = exact_kalman(mean, cov, y)
        np.testing.assert_allclose(belief.mean, mean, rtol=0, atol=2e-12)
        np.testing.assert_allclose(belief.covariance, cov, rtol=0, atol=2e-12)


def test_linearised_filter_is_the_kalman_filter_on_a_linear_model():
    mean, cov = START.mean, START.covariance
    for belief, y in zip(run_linearised(linear, seen), MEASURED, strict=True):
        mean, cov = exact_kalman(mean, cov, y)
        np.testing.assert_allclose(belief.mean, mean, atol=1e-8)  # differences of numbers near 1 over 1e-5
        np.testing.assert_allclose(belief.covariance, cov, atol=1e-8)


def filterpy_filter(n, k, weights_of, propagate, observe):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
    points = MerweScaledSigmaPoints(n, **weights_of)
    return UnscentedKalmanFilter(
        n, k, 1.0, fx=lambda x, dt: propagate(x[None])[0], hx=lambda x: observe(x[None])[0], points=points
    )


@pytest.mark.parametrize(
    "tuning", [{"alpha": 0.99, "beta": 0.0, "kappa": 0.0}, {"alpha": 0.5, "beta": 2.0, "kappa": 0.0}]
)
def test_equals_filterpy_on_a_nonlinear_model(tuning):
    theirs = filterpy_filter(N, K, tuning, pendulum, curved)
    theirs.x, theirs.P, theirs.Q, theirs.R = START.mean.copy(), START.covariance.copy(), Q, R
    ours = run_covariance(merwe(N, **tuning), pendulum, curved)
    for belief, y in zip(ours, MEASURED, strict=True):
        theirs.predict()
        theirs.update(y)
        np.testing.assert_allclose(belief.mean, theirs.x, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(belief.covariance, theirs.P, rtol=1e-11, atol=1e-12)
        assert belief.log_likelihood == pytest.approx(theirs.log_likelihood, rel=1e-10)


def test_weights_equal_filterpy_for_eight_states():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from filterpy.kalman import MerweScaledSigmaPoints
    theirs = MerweScaledSigmaPoints(n=8, alpha=0.99, beta=0, kappa=0)
    ours = merwe(8)
    np.testing.assert_allclose(ours.mean, theirs.Wm, rtol=1e-14)
    np.testing.assert_allclose(ours.covariance, theirs.Wc, rtol=0, atol=1e-16)
    belief = kf.Belief(RNG.normal(size=8), covariance(8))
    np.testing.assert_allclose(
        kf.draw(belief, ours), theirs.sigma_points(belief.mean, belief.covariance), rtol=1e-13, atol=1e-13
    )


@pytest.mark.parametrize("weights", [merwe(N), merwe(N, 0.5, 2.0), cubature(N), simplex(N)])
def test_square_root_form_equals_covariance_form(weights):
    pairs = zip(run_covariance(weights, pendulum, curved), run_root(weights, pendulum, curved), strict=True)
    for a, b in pairs:
        np.testing.assert_allclose(b.mean, a.mean, atol=1e-11)
        np.testing.assert_allclose(b.covariance, a.covariance, atol=1e-11)
        np.testing.assert_allclose(b.innovation_covariance, a.innovation_covariance, atol=1e-11)
        assert b.nis == pytest.approx(a.nis, rel=1e-9)
        assert b.log_likelihood == pytest.approx(a.log_likelihood, rel=1e-9)


def test_centre_weight_is_negative_and_never_harmful_in_the_papers_tuning():
    for n in (2, 8, 14):
        assert merwe(n).covariance[0] < 0
        assert abs(centre_gain(merwe(n))) < 1e-12


def test_weights_that_could_lose_definiteness_are_refused():
    with pytest.raises(CraneError, match="Raise beta"):
        merwe(8, 0.99, 0.0, -3.0)
    with pytest.raises(CraneError, match="spread"):
        merwe(8, 0.0)


def test_square_root_survives_what_the_covariance_form_does_not():
    """Two nearly equal, nearly perfect sensors: rounding makes P - K Py Kᵀ indefinite, the root form stays usable."""
    weights, eye = merwe(2, 1.0, 2.0), np.eye(2)
    noise = 1e-9 * eye
    rows = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-8]])
    plain, root = kf.Belief(np.zeros(2), eye), kf.RootBelief(np.zeros(2), eye)
    with pytest.raises(kf.FilterError) as error:
        for step in range(50):
            plain = kf.update(plain, lambda p: p @ rows.T, np.zeros(2), noise**2, weights, step=step)
    assert error.value.step is not None and f"step {error.value.step}" in str(error.value)
    assert error.value.eigenvalues.size == 2
    for _ in range(50):
        root = kf.update_root(root, lambda p: p @ rows.T, np.zeros(2), noise, weights)
    assert np.isfinite(root.root).all() and (np.diag(root.root) > 0).all()


def test_failed_cholesky_names_step_and_eigenvalues():
    broken = kf.Belief(np.zeros(2), np.array([[1.0, 2.0], [2.0, 1.0]]))
    with pytest.raises(kf.FilterError, match=r"at step 17 .*-1.*3") as error:
        kf.predict(broken, lambda p: p, np.eye(2), merwe(2), step=17)
    np.testing.assert_allclose(error.value.eigenvalues, [-1.0, 3.0])


def test_beliefs_are_new_and_inputs_untouched():
    mean, cov = START.mean.copy(), START.covariance.copy()
    prediction = kf.predict(START, pendulum, Q, merwe(N))
    kf.update(prediction, curved, MEASURED[0], R, merwe(N))
    np.testing.assert_array_equal(START.mean, mean)
    np.testing.assert_array_equal(START.covariance, cov)
    with pytest.raises(AttributeError):
        START.mean = mean  # type: ignore[misc]


def test_mixed_units_do_not_change_the_result():
    """Pressures in Pa or in MPa: the filter is the same to rounding, so no scaling of the state is needed."""
    scale = np.array([1.0, 1.0, 1e6, 1e6])
    plain = run_covariance(merwe(N), pendulum, curved)
    scaled = run_covariance(
        merwe(N),
        lambda p: pendulum(p / scale) * scale,
        lambda p: curved(p / scale),
        kf.Belief(START.mean * scale, START.covariance * np.outer(scale, scale)),
        Q * np.outer(scale, scale),
    )
    np.testing.assert_allclose(scaled[-1].mean / scale, plain[-1].mean, rtol=1e-10, atol=1e-12)


def test_factorisations():
    wide = RNG.normal(size=(5, 9))
    lower = lower_factor(wide)
    np.testing.assert_allclose(lower @ lower.T, wide @ wide.T, atol=1e-12)
    assert (np.triu(lower, 1) == 0).all() and (np.diag(lower) >= 0).all()
    matrix, root = covariance(6), np.empty((6, 6))
    assert cholesky(matrix, root) == -1
    np.testing.assert_allclose(root, np.linalg.cholesky(matrix), atol=1e-12)
    assert cholesky(np.diag([1.0, 1.0, -1.0]), np.empty((3, 3))) == 2


def test_paper_noise_is_van_loans_integral_and_has_a_root():
    noise = PaperNoise().covariance(1e-3)
    assert noise[0, 0] == pytest.approx(0.0175e-9 / 3) and noise[0, 2] == pytest.approx(0.0175e-6 / 2)
    assert noise[2, 2] == pytest.approx(0.0175e-3) and noise[4, 4] == 259.8e8
    root = semidefinite_root(noise)
    np.testing.assert_allclose(root @ root.T, noise, rtol=1e-12, atol=1e-16)
    with pytest.raises(ValueError, match="semidefinite"):
        semidefinite_root(np.array([[1.0, 2.0], [2.0, 1.0]]))


@pytest.mark.parametrize("creep", [(), (1e-6, 2e-6)])
def test_continuous_noise_adds_up_over_steps(creep):
    """Ten steps of 1 ms leave the covariance of one step of 10 ms: Φ Q Φᵀ + Q repeated."""
    noise, total = ProcessNoise((1e-3, 2e-3), (1e8, 2e8, 3e8, 4e8), creep), np.zeros((8, 8))
    phi = np.eye(8)
    phi[0, 2] = phi[1, 3] = 1e-3
    for _ in range(10):
        total = phi @ total @ phi.T + noise.covariance(1e-3)
    np.testing.assert_allclose(total, noise.covariance(1e-2), rtol=1e-12)


def test_a_coordinate_that_creeps_is_known_with_a_margin():
    """Of a coordinate at rest the filter believes in a variance r/τ and errs by half of it, τ = √(r/q)."""
    dt, r, q, rng = 1e-2, 1e-4, 1e-4, np.random.default_rng(1)
    added = ProcessNoise((0.0,), (), (q,)).covariance(dt)[0, 0]
    variance, estimate, errors = 1.0, 0.0, []
    for _ in range(40000):
        variance += added
        gain = variance / (variance + r / dt)
        estimate, variance = estimate + gain * (rng.normal(0.0, np.sqrt(r / dt)) - estimate), (1.0 - gain) * variance
        errors.append(estimate)
    assert variance == pytest.approx(np.sqrt(q * r), rel=0.02)
    assert np.var(errors[1000:]) == pytest.approx(0.5 * variance, rel=0.15)  # 400 time constants


def test_measurement_and_start_covariances():
    np.testing.assert_allclose(measurement_noise(np.array([0.1, 2.0])), np.diag([0.01, 4.0]))
    np.testing.assert_allclose(np.diag(paper_start_covariance())[[0, 2, 4]], [0.035, 0.087, 22.5e7])


def test_smoother_equals_the_batch_solution():
    """On a linear model RTS is the posterior given all data: compare with one big weighted least-squares problem."""
    steps, weights = 8, merwe(N)
    belief = START
    means, covs, pm, pc, cross = [belief.mean], [belief.covariance], [belief.mean], [belief.covariance], [Q]
    for y in MEASURED[:steps]:
        prior = kf.predict(belief, linear, Q, weights)
        belief = kf.update(prior, seen, y, R, weights)
        for store, value in zip(
            (means, covs, pm, pc, cross),
            (belief.mean, belief.covariance, prior.mean, prior.covariance, prior.cross),
            strict=True,
        ):
            store.append(value)
    mean, cov = smooth(*map(np.array, (means, covs, pm, pc, cross)))
    size = N * (steps + 1)
    information, right = np.zeros((size, size)), np.zeros(size)

    def add(row, target, spread):
        information[:] += row.T @ np.linalg.solve(spread, row)
        right[:] += row.T @ np.linalg.solve(spread, target)

    def block(k, matrix):
        row = np.zeros((len(matrix), size))
        row[:, k * N : (k + 1) * N] = matrix
        return row

    add(block(0, np.eye(N)), START.mean, START.covariance)
    for k in range(steps):
        add(block(k + 1, np.eye(N)) - block(k, F), np.zeros(N), Q)
        add(block(k + 1, H), MEASURED[k], R)
    joint = np.linalg.inv(information)
    np.testing.assert_allclose(mean.ravel(), joint @ right, atol=1e-9)
    for k in range(steps + 1):
        np.testing.assert_allclose(cov[k], joint[k * N : (k + 1) * N, k * N : (k + 1) * N], atol=1e-9)


def test_a_beginning_of_a_linear_model_gone_through_again_is_what_the_filter_had():
    step, beginning = np.full(N, 1e-5), Beginning(START, 9.0, [0])
    belief, times = START, []
    for k, y in enumerate(MEASURED[:9], 1):
        prior = kf.predict_linearised(belief, linear, Q, step)
        belief = kf.update_linearised(prior, seen, y, R, step)
        if beginning.add(float(k), Step(linear, Q, seen, y, R), belief):
            times.append(k)
            again = beginning.again(lambda mean, covariance: mean)
            np.testing.assert_allclose(again.mean, belief.mean, atol=1e-6)
            np.testing.assert_allclose(again.covariance, belief.covariance, atol=1e-6)
    assert times[-1] == 9 and beginning.over


def product(points: np.ndarray) -> np.ndarray:
    """Two constants of which a sensor shows the product: it tells one combination of them, and never the other."""
    return points[:, :1] * points[:, 1:]


def test_what_no_sensor_shows_is_not_believed_after_a_beginning_was_gone_through_again():
    """Against the curvature of the posterior itself; the filter alone, whose slopes wander, believes to know both."""
    rng, truth, count, noise = np.random.default_rng(3), np.array([2.0, 0.5]), 200, 0.03
    start = kf.Belief(np.array([1.0, 1.5]), np.diag([1.0, 1.0]))
    increments, still, R1 = np.full(2, 1e-6), np.zeros((2, 2)), np.array([[noise**2]])
    y = truth.prod() + noise * rng.normal(size=(count, 1))
    belief, beginning = start, Beginning(start, count, [0, 1])
    for k in range(count):
        belief = kf.update_linearised(belief, product, y[k], R1, increments)
        if beginning.add(k + 1.0, Step(lambda p: p, still, product, y[k], R1), belief):
            again = beginning.again(lambda mean, covariance: mean)
    assert beginning.over

    def cost(x):
        return 0.5 * np.sum((x - start.mean) ** 2) + 0.5 * np.sum((y - x[0] * x[1]) ** 2) / noise**2

    best = minimize(cost, again.mean, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12}).x
    assert np.linalg.norm(again.mean - best) < 0.02
    slope = best[::-1]
    exact = np.linalg.inv(np.eye(2) + count / noise**2 * np.outer(slope, slope))
    unseen = np.linalg.eigh(exact)[1][:, 1]
    assert unseen @ again.covariance @ unseen == pytest.approx(unseen @ exact @ unseen, rel=0.05)
    assert unseen @ belief.covariance @ unseen < 0.7 * (unseen @ exact @ unseen)
