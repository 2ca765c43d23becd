"""The observer follows torque from outside; a force is found where it acts."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from estimates import estimate_of
from robots import random_robot, with_followers

from consistent_id import ProblemError, Recording, TorqueModel
from consistent_id.robot import Mimic
from consistent_id.service import MomentumObserver, control_model
from consistent_id.service.contact_place import contact_place

GAIN = 20.0
PUSH = np.array([3.0, -2.0, 1.0, 0.5, 0.2, 0.1])


def arm(seed=0, joints=6):
    """A random chain, Pinocchio's model of it, and its control model."""
    reference, robot = random_robot(np.random.default_rng(seed), joints)
    bodies = [link.nominal for link in robot.links]
    return reference, control_model(estimate_of(TorqueModel(robot), bodies))


def pushed(rate=500.0, push=PUSH, seed=0):
    """A motion in closed form; Pinocchio's torques, less a push from 0.5 s on."""
    reference, control = arm(seed)
    data, time = reference.createData(), np.arange(0.0, 1.0, 1.0 / rate)
    phase = np.linspace(0.0, 2.0, 6)
    q = 0.4 * np.sin(2.0 * time[:, None] + phase)
    dq = 0.8 * np.cos(2.0 * time[:, None] + phase)
    ddq = -1.6 * np.sin(2.0 * time[:, None] + phase)
    torque = np.array(
        [pin.rnea(reference, data, *x).copy() for x in zip(q, dq, ddq, strict=True)]
    )
    torque[time >= 0.5] -= push
    return control, Recording(control.joints, time, q, velocity=dq, torque=torque)


def test_external_torque_follows_a_step_like_a_filter_of_first_order():
    control, log = pushed()
    found = MomentumObserver(control, GAIN).along(log).torque
    # The sample in whose middle the push begins has half of it.
    after = log.time[:, None] - 0.5
    half = 0.5 * (1.0 + np.exp(-GAIN / 500.0))
    expected = np.where(after > -1e-9, 1.0 - half * np.exp(-GAIN * after), 0.0) * PUSH
    # Midpoints of steps of 2 ms leave an error of the order dt^2.
    np.testing.assert_allclose(found, expected, atol=2e-3)


@pytest.mark.slow
def test_sample_by_sample_is_the_same():
    control, log = pushed(100.0)
    observer = MomentumObserver(control, np.linspace(10.0, 40.0, 6))
    track = observer.along(log)
    state = observer.start(log.time[0], log.position[0], log.velocity[0], log.torque[0])
    for k in range(1, 40):
        state = observer.step(
            state, log.time[k], log.position[k], log.velocity[k], log.torque[k]
        )
    np.testing.assert_allclose(state.external, track.torque[39], rtol=0, atol=1e-12)
    np.testing.assert_allclose(state.expected, track.torque_command[39], atol=1e-12)
    np.testing.assert_allclose(state.acceleration, track.acceleration[39], atol=1e-12)


def test_acceleration_is_behind_the_same_filter():
    control, log = pushed()
    track = MomentumObserver(control, 200.0).along(log)
    phase = np.linspace(0.0, 2.0, 6)
    late = log.time[250:, None] - 1.0 / 200.0  # the filter's delay
    true = -1.6 * np.sin(2.0 * late + phase)
    np.testing.assert_allclose(track.acceleration[250:], true, atol=2e-3)


def test_wrong_input_is_refused():
    control, log = pushed(100.0)
    observer = MomentumObserver(control)
    for wrong in (0.0, -1.0, [1.0, 2.0]):
        with pytest.raises(ProblemError, match="gains of the observer"):
            MomentumObserver(control, wrong)
    state = observer.start(0.0, *np.zeros((3, 6)))
    for time in (0.0, np.inf, np.nan):
        with pytest.raises(ProblemError, match="expected more than 0 s"):
            observer.step(state, time, *np.zeros((3, 6)))
    with pytest.raises(ProblemError, match="first sample's time is nan"):
        observer.start(np.nan, *np.zeros((3, 6)))
    still = Recording(log.joints, log.time, log.position)
    with pytest.raises(ProblemError, match="needs velocity and torque"):
        observer.along(still)
    with pytest.raises(ProblemError, match=r"recording: a str.*read_recording\('free"):
        observer.along("free.csv")
    with pytest.raises(ProblemError, match="eigenvalue"):
        observer.place(np.zeros(6), np.zeros(6), np.zeros((6, 6)))


def contact(reference, q, link, point, force):
    """Torque of a force at a point of a link's line, by Pinocchio's Jacobian."""
    data = reference.createData()
    pin.computeJointJacobians(reference, data, q)
    pin.updateFramePlacements(reference, data)
    jacobian = pin.getJointJacobian(
        reference, data, link + 1, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    )
    arm = point - data.oMi[link + 1].translation
    moved = jacobian[:3] - pin.skew(arm) @ jacobian[3:]
    return moved.T @ force


@pytest.mark.slow
def test_a_known_force_is_found_where_it_acts():
    reference, control = arm(3)
    observer, robot = MomentumObserver(control), control.model.robot
    rng, noise, off = np.random.default_rng(3), 1e-6 * np.eye(6), []
    for _ in range(9):
        q, force = rng.uniform(-1, 1, 6), rng.normal(size=3) * 10.0
        data = reference.createData()
        pin.forwardKinematics(reference, data, q)
        start, end = data.oMi[4].translation, data.oMi[5].translation
        point = start + 0.4 * (end - start)
        torque = contact(reference, q, 3, point, force)
        found = observer.place(q, torque, noise, radius=0.0)
        assert found.link == robot.link_names[3]
        # Points are a tenth of the line apart; their neighbours explain it, too.
        step = 0.1 * np.linalg.norm(end - start)
        assert np.linalg.norm(found.point - point) < 2.5 * step
        error = found.force - force
        assert error @ np.linalg.solve(found.covariance, error) < 11.3  # 99 %
        assert (found.misfit < 11.3, found.freedom) == (True, 3)
        off.append(np.linalg.norm(error) / np.linalg.norm(force))
    assert np.median(off) < 0.2  # near singular poses it may be more


@pytest.mark.slow
def test_intervals_of_the_force_contain_it():
    reference, control = arm(3)
    observer, rng = MomentumObserver(control), np.random.default_rng(4)
    noise = np.diag([0.2, 0.2, 0.1, 0.05, 0.05, 0.05]) ** 2
    z, inside = [], 0
    for _ in range(60):
        q, force = rng.uniform(-1, 1, 6), rng.normal(size=3) * 10.0
        data = reference.createData()
        pin.forwardKinematics(reference, data, q)
        start, end = data.oMi[5].translation, data.oMi[6].translation
        point = start + rng.uniform(0.2, 0.9) * (end - start)
        torque = contact(reference, q, 4, point, force)
        seen = torque + rng.multivariate_normal(np.zeros(6), noise)
        found = observer.place(q, seen, noise, radius=0.0)
        error = found.force - force
        z.append(error @ np.linalg.pinv(found.covariance) @ error)
        low, high = found.strengths
        inside += low < np.linalg.norm(force) < high
    # 95 % of chi-squared with three degrees of freedom are below 7.8; of 60, 50 or more
    # with probability .9996.  Not all: intervals are no wider than they have to be.
    assert 50 <= np.sum(np.array(z) < 7.81) <= 60
    assert np.median(z) > 0.5
    assert inside >= 52  # of 60 with 95 %, .997
    # Twice the torque and its errors is twice the force.
    double = observer.place(q, 2.0 * seen, 4.0 * noise, radius=0.0)
    np.testing.assert_allclose(double.strengths, (2.0 * low, 2.0 * high), rtol=1e-6)
    assert high - low < 4.0 * found.strength


def test_a_force_that_the_torque_does_not_show_is_open():
    reference, control = arm(5)
    q = np.full(6, 0.2)
    data = reference.createData()
    pin.forwardKinematics(reference, data, q)
    start, end = data.oMi[1].translation, data.oMi[2].translation
    torque = contact(reference, q, 0, 0.5 * (start + end), np.array([9.0, 5.0, 3.0]))
    found = MomentumObserver(control).place(q, torque, 1e-6 * np.eye(6), radius=0.0)
    assert found.link == control.model.robot.link_names[0]
    assert found.open_directions.shape == (2, 3)  # one joint shows one direction
    np.testing.assert_allclose(found.open_directions @ found.force, 0.0, atol=1e-6)
    still = contact_place(control.model.robot, q, np.zeros(6), np.eye(6), radius=0.0)
    assert still.strengths[0] < 0.5 * still.strengths[1]  # nothing pushes, or little
    unknown = replace(found, open_directions=np.eye(3), force=np.zeros(3))
    assert unknown.strength_error == np.inf


def test_robots_whose_joints_follow_others_are_refused():
    _, robot = random_robot(np.random.default_rng(5), 4)
    names = [joint.name for joint in robot.joints]
    robot = with_followers(robot, {names[2]: Mimic(names[0], 0.5)})
    with pytest.raises(ProblemError, match="follow others"):
        contact_place(robot, np.zeros(3), np.ones(3), np.eye(3))
