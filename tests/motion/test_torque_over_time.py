"""Proven torque rates and root mean squares, against dense samples and closed forms."""

import numpy as np
import pytest
from paths import one_sine, random_path
from robots import random_robot
from some_fast import some_fast

from consistent_id import DriveTerms, ProblemError, TorqueModel, from_modified_dh
from consistent_id.motion.limits import MotionLimits, motion_limits
from consistent_id.motion.proofs.margins import motion_margins
from consistent_id.motion.proofs.torque_bounds import (
    torque_rate_bounds,
    torque_rms_bound,
)
from consistent_id.robot.loaders.dh import DHRow
from consistent_id.robot.model import JointLimits

WITHIN = JointLimits(-2.0, 2.0, 2.0, 40.0)


def _dense(model, x, path, samples=40_001):
    time = path.start + np.linspace(0.0, path.duration, samples)
    return time, model.predict(x, *path.evaluate(time))


@pytest.mark.slow
@pytest.mark.parametrize("seed", some_fast(range(3)))
def test_bounds_are_above_what_samples_show_and_near(seed):
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, 4, tree=True)
    model = TorqueModel(robot, DriveTerms(viscous=True, rotor_inertia=True))
    x = rng.normal(size=(2, len(model.layout)))
    path = random_path(seed, robot.joint_names)
    rates, squares = [], []
    for one in x:
        time, torque = _dense(model, one, path)
        rates.append(abs(np.gradient(torque, time, axis=0)[1:-1]).max(axis=0))
        squares.append((torque**2).mean(axis=0))
    rate, rms = np.max(rates, axis=0), np.sqrt(np.max(squares, axis=0))
    bounds = torque_rate_bounds(path, model, x, rate)
    # Differences of samples are rates to a millionth of the largest there is.
    assert (bounds.size >= rate * (1.0 - 1e-5)).all()
    assert (bounds.size <= rate * 1.011).all()
    proven = torque_rms_bound(path, model, x)
    assert (proven >= rms * (1.0 - 1e-6)).all()


def test_a_rotor_alone_has_the_rate_and_the_rms_of_its_sine():
    """2 kg m^2 and q = sin(2 pi t): torque 8 pi^2 sin, rate 16 pi^3."""
    arm = from_modified_dh("rod", [DHRow(0, 0, limits=WITHIN)])
    model = TorqueModel(arm, DriveTerms(rotor_inertia=True))
    x = np.zeros((1, len(model.layout)))
    x[0, model.layout.index("joint1.rotor_inertia")] = 2.0
    path = one_sine(("joint1",))
    peak = 2.0 * (2.0 * np.pi) ** 2
    rate = torque_rate_bounds(path, model, x, np.array([100.0]))
    assert peak * 2.0 * np.pi <= rate.size[0] <= peak * 2.0 * np.pi + 1.0
    rms = torque_rms_bound(path, model, x)[0]
    assert peak / np.sqrt(2.0) <= rms <= 1.01 * peak / np.sqrt(2.0)


def test_friction_heats_the_motor_and_makes_no_rate():
    arm = from_modified_dh("rod", [DHRow(0, 0, limits=WITHIN)])
    model = TorqueModel(arm, DriveTerms(coulomb="sign"))
    x = np.zeros((1, len(model.layout)))
    x[0, model.layout.index("joint1.coulomb")] = 3.0
    path = one_sine(("joint1",))
    assert torque_rms_bound(path, model, x)[0] == pytest.approx(3.0, rel=1e-3)
    assert torque_rate_bounds(path, model, x, np.array([1.0])).size[0] <= 1e-9


def test_margins_have_both_and_name_them():
    arm = from_modified_dh("rod", [DHRow(0, 0, limits=WITHIN)])
    model = TorqueModel(arm, DriveTerms(rotor_inertia=True))
    x = np.zeros(len(model.layout))
    x[model.layout.index("joint1.rotor_inertia")] = 0.1
    path = one_sine(("joint1",))
    given = {"velocity": 10.0, "effort": 10.0, "effort_rate": 30.0, "effort_rms": 2.0}
    margins = motion_margins(
        path, motion_limits(arm, **given), model=model, parameters=x
    )
    found = {m.quantity: m for m in margins.margins}
    # 0.4 pi^2 = 3.9, times 2 pi = 24.8; over the square root of 2: 2.8.
    assert found["torque"].holds and found["torque rate"].holds
    assert not found["torque RMS"].holds
    with pytest.raises(ProblemError, match="torque RMS limit 2"):
        margins.require()


def test_limits_over_time_are_none_by_default_and_scale_with_the_others():
    limits = MotionLimits(("a",), [-1], [1], [1], [1], [1], [5])
    assert np.isinf([limits.effort_rate, limits.effort_rms]).all()
    arm = from_modified_dh("rod", [DHRow(0, 0, limits=WITHIN)])
    half = motion_limits(arm, effort_rate=8.0, effort_rms={"joint1": 4.0}).within(0.5)
    assert (half.effort_rate[0], half.effort_rms[0], half.effort[0]) == (4.0, 2.0, 20.0)
