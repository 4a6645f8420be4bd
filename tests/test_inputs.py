"""Commands to spool positions: exactness, delay, backlash, creep, live use, and the paper's cycle."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.inputs import SpoolPath, paper_cycle, play

CRANE = Crane.load("patu655")
RNG = np.random.default_rng(3)
TIME = np.cumsum(RNG.uniform(0.002, 0.03, 80))
COMMANDS = np.clip(np.cumsum(RNG.normal(0.0, 0.2, (80, 2)), axis=0), -1.0, 1.0)


def test_exact_for_commands_that_are_linear_between_samples():
    spool = SpoolPath(CRANE).run(TIME, COMMANDS)
    for c in range(2):
        solution = solve_ivp(
            lambda t, u, c=c: (np.interp(t, TIME, COMMANDS[:, c]) - u) / 0.03,
            (TIME[0], TIME[-1]), [COMMANDS[0, c]], t_eval=TIME, rtol=1e-9, atol=1e-11, max_step=2e-3,
        )  # fmt: skip
        assert spool[:, c] == pytest.approx(solution.y[0], abs=1e-6)


def test_the_grid_does_not_matter():
    fine = np.sort(np.concatenate([TIME, 0.5 * (TIME[1:] + TIME[:-1])]))
    on_fine = np.column_stack([np.interp(fine, TIME, COMMANDS[:, c]) for c in range(2)])
    delayed = CRANE.with_effect("command_delay@tilt", {"T": 0.0173}).with_effect("spool_hysteresis@lift", {"b": 0.1})
    coarse = SpoolPath(delayed).run(TIME, COMMANDS)
    again = SpoolPath(delayed).run(fine, on_fine)[np.searchsorted(fine, TIME)]
    # linear segments are cut in two, each solved exactly: only rounding is left
    assert again == pytest.approx(coarse, abs=1e-12)


def test_delay_shifts_the_answer():
    shift = 0.05
    time = np.arange(0.0, 2.0, 0.01)
    commands = paper_cycle(time + 1.5)
    plain = SpoolPath(CRANE).run(time, commands)[:, 0]
    late = SpoolPath(CRANE.with_effect("command_delay@lift", {"T": shift})).run(time, commands)
    assert late[5:, 0] == pytest.approx(plain[:-5], abs=1e-12)
    assert np.array_equal(late[:, 1], SpoolPath(CRANE).run(time, commands)[:, 1])


def test_backlash_holds_and_trails_by_half_its_width():
    crane = CRANE.with_effect("spool_hysteresis@lift", {"b": 0.1})
    time = np.arange(0.0, 8.0, 0.01)
    up_and_down = np.interp(time, [0, 1, 3, 4, 6], [0.0, 0.5, 0.5, 0.0, 0.0])
    spool = SpoolPath(crane).run(time, np.column_stack([up_and_down, 0 * time]))[:, 0]
    assert spool[290] == pytest.approx(0.45, abs=1e-9)  # came from below
    assert spool[-1] == pytest.approx(0.05, abs=1e-9)  # came from above: does not close
    assert play(0.2, 0.23, 0.1) == 0.2
    assert play(0.2, 0.4, 0.1) == pytest.approx(0.35)


def test_creep_takes_the_last_share_of_a_step_with_its_own_time_constant():
    share, creep, tau = 0.2, 0.8, 0.03
    crane = CRANE.with_effect("spool_creep@tilt", {"kappa": share, "tau": creep})
    time = np.arange(0.0, 4.0, 0.01)
    ramp = np.interp(time, [0.5, 0.6], [0.0, 0.3])
    spool = SpoolPath(crane).run(time, np.column_stack([0 * time, ramp]))[:, 1]
    after = time[time >= 0.6] - 0.6

    def left(lag):  # of a step that was a ramp of 0.1 s, when it has come to its end
        return lag / 0.1 * (1.0 - math.exp(-0.1 / lag)) * np.exp(-after / lag)

    closed = 0.3 * (1.0 - (1.0 - share) * left(tau) - share * left(creep))
    assert spool[time >= 0.6] == pytest.approx(closed, abs=1e-9)


def test_neutral_effects_change_nothing():
    neutral = CRANE.with_effect("command_delay@lift", {"T": 0.0}).with_effect("spool_hysteresis@lift", {"b": 0.0})
    neutral = neutral.with_effect("spool_creep@lift", {"kappa": 0.0, "tau": 1.0})
    assert np.array_equal(SpoolPath(neutral).run(TIME, COMMANDS), SpoolPath(CRANE).run(TIME, COMMANDS))


@pytest.mark.parametrize("delay", [0.0, 0.0173, 0.2])
def test_live_use_gives_the_same_bits(delay):
    crane = CRANE.with_effect("command_delay@lift", {"T": delay}).with_effect("spool_hysteresis@tilt", {"b": 0.05})
    crane = crane.with_effect("spool_creep@tilt", {"kappa": 0.2, "tau": 0.5})
    path = SpoolPath(crane)
    live = np.array([path.step(t, u) for t, u in zip(TIME, COMMANDS, strict=True)])
    assert np.array_equal(live, path.run(TIME, COMMANDS))


def test_bad_commands_are_refused():
    path = SpoolPath(CRANE)
    with pytest.raises(CraneError, match=r"lift command at t = 1 s is 5,.*from -1 to 1"):
        path.run(np.array([0.0, 1.0]), np.array([[0.0, 0.0], [5.0, 0.0]]))
    with pytest.raises(CraneError, match="tilt command"):
        path.run(np.array([0.0, 1.0]), np.array([[0.0, 0.0], [0.0, math.nan]]))
    with pytest.raises(CraneError, match="do not increase"):
        path.run(np.array([0.0, 0.0]), np.zeros((2, 2)))
    path.step(0.0, np.zeros(2))
    with pytest.raises(CraneError, match="do not increase"):
        path.step(0.0, np.zeros(2))


def test_paper_cycle():
    u = paper_cycle(np.array([1.9, 2.0, 4.9, 5.0, 8.0, 13.0, 19.0, 25.0]))
    assert u[:, 0].tolist() == [0, 0.5, 0.5, 0, 0, 0, -0.5, 0]
    assert u[:, 1].tolist() == [0, 0, 0, 0, 0.35, -0.35, 0, 0]
