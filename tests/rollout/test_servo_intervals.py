"""Intervals of a servo's parameters: a jackknife over parts of the logs."""

from types import SimpleNamespace

import numpy as np
import pytest

from consistent_id.rollout import servo_bounds
from consistent_id.rollout.servo_bounds import alike_halves, half_intervals
from consistent_id.rollout.servo_log import encoded
from consistent_id.rollout.servo_motion import STEP


def test_they_are_those_of_a_mean_if_the_fit_is_one():
    """Fits without one of n values are means; the jackknife is then the t interval."""
    values = np.random.default_rng(0).normal(size=8)
    parts = np.array([[np.delete(values, k).mean()] for k in range(8)])
    (half,) = half_intervals(["stall"], np.array([values.mean()]), parts)
    # Student's 97.5 % for 7 degrees of freedom is 2.3646 in tables.
    assert half == pytest.approx(2.3646 * values.std(ddof=1) / np.sqrt(8), rel=1e-4)


def test_a_fit_beside_the_mean_of_its_parts_widens_them():
    parts = np.array([[1.0], [1.0], [1.0]])
    (half,) = half_intervals(["stall"], np.array([1.5]), parts)
    assert half == pytest.approx(0.5)


def test_a_delay_is_known_to_a_step_at_best():
    same = np.full((4, 2), 0.01)
    half = half_intervals(["stall", "delay"], np.array([0.01, 0.01]), same)
    assert half.tolist() == [0.0, STEP]


def test_errors_that_all_logs_share_widen_them():
    same = np.full((3, 1), 2.0)
    off = np.array([[0.1], [-0.1], [0.1]])
    (half,) = half_intervals(["stall"], np.array([2.0]), same, off)
    # Student's 97.5 % for 3 degrees of freedom is 3.1824 in tables.
    assert half == pytest.approx(3.1824 * 0.1, rel=1e-4)


def test_an_encoder_reads_multiples_of_its_step_from_a_random_place():
    step = 2 * np.pi / 4096
    motion = np.sin(np.linspace(0.0, 3.0, 500))
    like = step * np.round(0.3 * motion / step)
    rng = np.random.default_rng(0)
    read = encoded(motion, like, rng)
    assert abs(read - motion).max() <= 0.5001 * step
    assert np.allclose(np.diff(read) / step, np.round(np.diff(read) / step), atol=1e-3)
    assert not np.allclose(read, encoded(motion, like, rng))
    assert np.allclose(encoded(motion, np.ones(3), rng), motion)


def test_delay_damping_and_inertia_are_known_as_far_as_the_misfit_tells_them(
    monkeypatch,
):
    names = ["stall", "viscous", "armature", "delay"]
    known = dict(zip(names, np.array([[2.5], [0.5], [0.025], [0.03]]), strict=True))
    stiffness = 2.5 * 8.0

    def misfit(sets, pieces):
        # The first terms of the lag of delay and motor together are the same.
        first = sets["delay"] + sets["viscous"] / stiffness
        second = sets["armature"] - sets["viscous"] ** 2 / (2.0 * stiffness)
        assert np.allclose(first, 0.055) and np.allclose(second, 0.01875)
        assert (sets["stall"] == 2.5).all()
        rise = 1.0 + abs(sets["delay"] - 0.03) / 0.0275
        return np.array([0.5, 1.5]) * rise[:, None]

    monkeypatch.setattr(servo_bounds, "position_errors", misfit)
    half = alike_halves(names, known, SimpleNamespace(gain=np.array([7.0, 8.0, 9.0])))
    # The misfit is 15 % larger at 4.1 ms; every millisecond is tried.
    inertia = 0.5 * 0.004 + 0.5 * stiffness * 0.004**2
    assert half == pytest.approx([0.0, stiffness * 0.004, inertia, 0.004])


def test_without_a_delay_nothing_makes_up_for_damping():
    half = alike_halves(["stall", "viscous", "armature"], {}, None)
    assert half.tolist() == [0.0, 0.0, 0.0]
