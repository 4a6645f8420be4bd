"""Recorded commands: a step stays a step, a ramp a ramp; spool positions do not depend on the grid they are asked
on.
"""

import numpy as np
import pytest

from crane_exudyn import Crane
from crane_exudyn.drive import spool_on, steps_in, with_steps


def test_a_step_is_held_until_the_sample_that_shows_it_and_a_ramp_is_left_alone():
    time = np.arange(0.0, 1.0, 0.1)
    step = np.where(time > 0.45, 0.5, 0.0)
    ramp = np.clip(time - 0.2, 0.0, 0.4)
    t, u = with_steps(time, np.column_stack([step, ramp]))
    assert len(t) == len(time) + 1
    k = int(np.flatnonzero(np.diff(t) < 1e-3)[0])
    assert t[k + 1] == pytest.approx(0.5)
    assert u[k, 0] == 0.0 and u[k + 1, 0] == 0.5
    # the other valve's ramp goes on through the new instant: it has no step there
    assert np.interp(0.45, t, u[:, 1]) == pytest.approx(0.25, abs=0.06)
    t, u = with_steps(time, np.column_stack([ramp, ramp]))
    assert np.array_equal(t, time)


def test_a_step_comes_before_the_sample_that_shows_it_where_that_is_known():
    time = np.arange(0.0, 1.0, 0.1)
    both = np.column_stack([np.where(time > 0.45, 0.5, 0.0), np.where(time > 0.45, -0.3, 0.1)])
    (first, valve), (second, other) = steps = steps_in(time, both)
    assert steps == {(first, 0): pytest.approx(0.1), (second, 1): pytest.approx(0.1)} and (valve, other) == (0, 1)
    t, u = with_steps(time, both, early={(first, 0): 0.07, (second, 1): 0.02})
    assert (np.diff(t) > 0.0).all()
    for k, at, old, new in ((0, 0.43, 0.0, 0.5), (1, 0.48, 0.1, -0.3)):
        assert np.interp([at - 1e-5, at + 1e-5], t, u[:, k]) == pytest.approx([old, new])


def test_commands_that_are_held_jump_at_every_sample_that_shows_a_change():
    time, ramp = np.arange(0.0, 1.0, 0.1), np.clip(np.arange(0.0, 1.0, 0.1) - 0.25, 0.0, 0.4)
    t, u = with_steps(time, np.column_stack([ramp, 0.0 * ramp]), held=True)
    for at in (0.35, 0.44, 0.55, 0.95):
        assert np.interp(at, t, u[:, 0]) == pytest.approx(ramp[int(at / 0.1 + 1e-9)])
    assert not u[:, 1].any()


def test_spool_positions_follow_the_exponential_whatever_the_grid():
    crane = Crane.load("patu655")
    time, u = with_steps(
        np.array([0.0, 0.1, 0.2, 0.3, 0.4]), np.array([[0.0, 0], [0, 0], [0.5, 0], [0.5, 0], [0.5, 0]])
    )
    for h in (0.0025, 0.0111):
        grid = np.arange(0.0, 0.4, h)
        spool = spool_on(crane, grid, time, u)[:, 0]
        expected = np.where(grid > 0.2, 0.5 * (1.0 - np.exp(-(grid - 0.2) / 0.03)), 0.0)
        assert spool == pytest.approx(expected, abs=2e-5)  # the hold ends a microsecond early
    begun = spool_on(crane, grid[grid > 0.22], time, u)[:, 0]  # what was commanded before the grid counts
    assert begun == pytest.approx(spool[grid > 0.22], abs=1e-12)
    late = spool_on(crane, grid, time, u, late=0.01)[:, 0]
    assert np.interp(0.3, grid, late) == pytest.approx(0.5 * (1 - np.exp(-0.09 / 0.03)), abs=1e-3)
