"""The measurement function: closed forms, derivatives as difference quotients, and one reading for all who ask."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_up import made_up

from crane_exudyn import Crane, CraneError, Recording
from crane_exudyn.geometry import cylinder_lengths, pose
from crane_exudyn.measurement import Measurement, lagged
from crane_exudyn.simulation import sensed
from ukf.channels import Channels
from validation.fit.data import FitData
from validation.fit.staged import residuals

CRANE = Crane.load("patu655")
SENSORS = CRANE.layout.sensors
ALL = tuple(SENSORS)
TIME = np.arange(0.0, 2.0, 2.5e-3)
#: every kind of effect on sensors that comes with the package
TOUCHED = (
    CRANE.with_effect("sensor_bias@z4", {"b": 0.05}).with_effect("sensor_scale@p4", {"a": 1.2})
    .with_effect("sensor_lag@z1", {"tau": 0.08}).with_effect("sensor_bias@z1", {"b": -0.02})
)  # fmt: skip


def trajectory(time: np.ndarray = TIME) -> np.ndarray:
    """Return states (n, 8) that rest for a quarter of a second and move on smoothly; chamber p2 comes to hold a
    void.
    """
    t = np.maximum(time - 0.25, 0.0)
    swing, rate = 1.0 - np.cos(3.0 * t), 3.0 * np.sin(3.0 * t)
    zero = np.zeros_like(t)
    return np.column_stack(
        [
            0.2 + 0.1 * swing, -0.8 + 0.2 * swing, 0.1 * rate, 0.2 * rate,
            60e5 + 20e5 * swing, 10e5 - 20e5 * swing, 5e5 + zero, 30e5 + 5e5 * swing,
        ]
    )  # fmt: skip


def everywhere(crane: Crane, names: tuple[str, ...] = ALL) -> dict[str, np.ndarray]:
    """Return what the sensors show along the trajectory (n, m), as a simulation, the filter, and a fit and a comparison
    say.
    """
    X = trajectory()
    columns = [ALL.index(n) for n in names]
    found = {"simulate": sensed(crane, X, TIME)[:, columns]}
    channels = Channels(crane, names, X.shape[1])
    seen, held = [], channels.read(X[:1])[:, [row for row, _ in channels.lags]]
    points = np.hstack([X[:1], held])
    for k in range(len(X)):
        if k:
            now = np.hstack([X[k : k + 1], points[:, X.shape[1] :]])
            now[:, X.shape[1] :] = channels.follow(points, now, TIME[k] - TIME[k - 1])
            points = now
        seen.append(channels.observe(points)[0])
    found["filter"] = np.array(seen)
    zeros = {n: np.zeros_like(TIME) for n in ("u1", "u2", *names)}
    told = replace(crane, sensors={n: SENSORS[n].sizes.noise for n in names})
    data = FitData.of(Recording.from_arrays("r", TIME, zeros), told, rate=np.inf, step=TIME[1])
    left = residuals(crane, data, X[0], simulate=lambda x0, time, w: trajectory(time))
    noise = {s.channel: s.noise for s in data.samples}
    found["fit"] = np.column_stack([-left[n][1] * noise[n] for n in names])
    return found


def assert_all_agree(crane: Crane) -> dict[str, np.ndarray]:
    """Return what the sensors show by name, the same whoever is asked."""
    found = everywhere(crane)
    for name in ("filter", "fit"):
        np.testing.assert_allclose(found[name], found["simulate"], rtol=1e-9, atol=1e-9, err_msg=name)
    return dict(zip(ALL, found["simulate"].T, strict=True))


def test_a_perfect_sensor_shows_its_quantity() -> None:
    X = trajectory()
    shown = dict(zip(ALL, Measurement.of(CRANE).shown(X, TIME).T, strict=True))
    z1, z4, dz1, dz4, p1, p2, p3, p4 = X.T
    lengths = pose(CRANE, z1, z4).lengths
    expected = {
        "z1": z1, "z4": z4, "z4_abs": z1 + z4, "dz1": dz1, "dz4": dz4, "dz4_abs": dz1 + dz4, "p1": p1,
        "p2": np.maximum(p2, 0.0),
        "p3": p3, "p4": p4, "s1": lengths[:, 0], "s2": lengths[:, 1],
    }  # fmt: skip
    assert p2.min() < 0.0
    assert list(expected) == list(shown)
    for name, values in expected.items():
        np.testing.assert_allclose(shown[name], values, rtol=1e-14, err_msg=name)


def test_derivatives_are_difference_quotients() -> None:
    crane, X = TOUCHED, trajectory()[::50]
    measurement = Measurement.of(crane)
    Y, C = measurement.rows(X)
    assert np.array_equal(Y, measurement.read(X))
    for i in range(8):
        h = 1e-5 if i < 4 else 10.0
        quotient = (measurement.read(X + h * np.eye(8)[i]) - measurement.read(X - h * np.eye(8)[i])) / (2.0 * h)
        np.testing.assert_allclose(C[:, :, i], quotient, rtol=1e-6, atol=1e-8)


def test_a_lag_is_exact_for_lines() -> None:
    t, tau = np.arange(0.0, 2.0, 0.01), 0.07
    assert lagged(3.0 * t, t, 0.2) == pytest.approx(3.0 * (t - 0.2), abs=1e-12)
    assert lagged(t, t, tau, settled=True) == pytest.approx(t - tau * (1.0 - np.exp(-t / tau)), abs=1e-12)
    uneven = np.sort(np.r_[t, 0.0137, 0.5051])
    assert lagged(uneven, uneven, tau, settled=True)[-1] == pytest.approx(t[-1] - tau, abs=1e-9)
    step, after = np.where(t >= 1.0, 1.0, 0.0), t > 1.005
    assert lagged(step, t, 0.1)[after] == pytest.approx(1.0 - np.exp(-(t[after] - 0.995) / 0.1), abs=2e-3)
    both = lagged(np.column_stack([t, step]), t, tau)
    assert np.array_equal(both, np.column_stack([lagged(t, t, tau), lagged(step, t, tau)]))


def test_simulation_filter_and_fit_read_the_same() -> None:
    true = dict(zip(ALL, Measurement.of(CRANE).read(trajectory()).T, strict=True))
    shown = assert_all_agree(TOUCHED)
    assert shown["z4"] == pytest.approx(true["z4"] + 0.05)
    assert shown["p4"] == pytest.approx(1.2 * true["p4"])
    assert shown["z1"] == pytest.approx(lagged(true["z1"] - 0.02, TIME, 0.08, settled=True))


def test_the_outer_booms_sensor_is_one_place_whether_it_shows_z4_or_z4_abs() -> None:
    shown = assert_all_agree(CRANE.with_effect("sensor_bias@z4", {"b": 0.05}))
    assert shown["z4_abs"][0] == pytest.approx(-0.55)
    assert shown["dz4_abs"][0] == 0.0


def test_sensors_of_another_machine_show_its_quantities() -> None:
    crane = made_up().with_effect("sensor_bias@reach", {"b": 0.02}).with_effect("sensor_scale@b3", {"a": 2.0})
    lay, measurement = crane.layout, Measurement.of(crane)
    x = np.array([0.3, 0.5, -0.4, 0.1, 0.2, 0.3, 60e5, 10e5, 30e5, -5e5, 8e5, 20e5])
    Y, C = measurement.rows(x[None])
    shown = dict(zip(measurement.names, Y[0], strict=True))
    assert list(shown) == list(lay.sensors)
    assert [shown[n] for n in lay.states] == pytest.approx([*x[:1], 0.52, *x[2:9], 0.0, x[10], 40e5])
    assert [shown["bucket_abs"], shown["dbucket_abs"]] == pytest.approx([-0.1, 0.4])
    assert [shown[n] for n in lay.lengths] == pytest.approx(cylinder_lengths(crane, x[None, lay.positions])[0])
    for i in range(len(x)):
        h = 1e-5 * np.eye(len(x))[i] if i < 6 else 10.0 * np.eye(len(x))[i]
        quotient = (measurement.read((x + h)[None]) - measurement.read((x - h)[None])) / (2.0 * h[i])
        np.testing.assert_allclose(C[:, :, i], quotient, rtol=1e-6, atol=1e-8)
    with pytest.raises(CraneError, match=r"sensor 'z1' is not known"):
        Measurement.of(crane, ("z1",))


def test_places_of_effects_keep_their_order_in_old_files() -> None:
    assert CRANE.layout.places("sensors") == ("z1", "z4", "p1", "p2", "p3", "p4")
    assert all(set(s.shows) <= set(CRANE.layout.states) for s in SENSORS.values())


OWN = """
import sys
import numpy as np
from crane_exudyn.effects import registry
registry.load_effects(sys.argv[1])
sys.path.insert(0, sys.argv[2])
from test_measurement import *
from crane_exudyn.render_shapes import pendulum_length
from crane_exudyn.static_start import static_start
from validation.fit.variables import effect_variables
true = dict(zip(ALL, Measurement.of(CRANE).read(trajectory()).T))
crane = CRANE.with_effect("compressed@z1", {"k": 0.7}).with_effect("compressed@p1", {"k": 1e-7})
crane = crane.with_effect("slow_wire@p1", {"T": 0.05}).with_effect("sensor_lag@p1", {"tau": 0.03})
shown = assert_all_agree(crane)
np.testing.assert_allclose(shown["z1"], true["z1"] / (1 + 0.7 * true["z1"]))
np.testing.assert_allclose(shown["p1"], lagged(true["p1"] / (1 + 1e-7 * true["p1"]), TIME, 0.08, settled=True))
X, measurement = trajectory(), Measurement.of(crane)
for i, h in ((0, 1e-5), (4, 10.0)):
    S = np.zeros((len(X), 8, 1))
    S[:, i] = 1.0
    step = h * np.eye(8)[i]
    quotient = (measurement.shown(X + step, TIME) - measurement.shown(X - step, TIME)) / (2 * h)
    np.testing.assert_allclose(measurement.shown_rows(X, S, TIME)[1][:, :, 0], quotient, rtol=1e-6, atol=1e-9)
chain = CRANE.with_effect("chain", {"links": 12})
start = static_start(chain, 0.2, -0.8)
assert len(start) == 10 and abs(pendulum_length(chain) - 1.2) < 1e-12
"""


def own(code: str) -> subprocess.CompletedProcess[str]:
    """Run code that knows the effects of `own_sensors`, as a command with --effects would."""
    here = Path(__file__).parent
    words = [sys.executable, "-c", code, str(here / "own_sensors.py"), str(here)]
    return subprocess.run(words, capture_output=True, text=True)


def test_a_users_own_law_lag_and_pendulum_are_honoured_by_all() -> None:
    run = own(OWN)
    assert run.returncode == 0, run.stderr


def test_both_engines_swing_a_payload_by_a_users_own_effect() -> None:
    run = own(
        OWN.partition("true = ")[0]
        + 'crane = CRANE.with_effect("chain", {"links": 12})\n'
        + "from validation.semi_recursive.engine import SemiRecursiveEngine\n"
        + "assert SemiRecursiveEngine(crane).state_names[8:] == ('theta', 'dtheta')\n"
    )
    assert run.returncode == 0, run.stderr
