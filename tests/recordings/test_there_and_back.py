"""Of motion there and back friction cancels, and what hangs on the robot is left."""

from dataclasses import replace

import numpy as np
import pytest

import consistent_id as ci

RIGHT, RATE, SECONDS = np.pi / 2, 100.0, 40.0
FRICTION = ci.DriveTerms(
    viscous=True, coulomb="tanh", velocity_scale=0.01, load_friction=True
)


@pytest.fixture(scope="module")
def arm():
    rows = [ci.DHRow(RIGHT, 0), ci.DHRow(0, 0.5), ci.DHRow(RIGHT, 0.4)]
    robot = ci.from_modified_dh("arm", rows)
    body = ci.InertialParameters.from_central(3.0, [0.2, 0.02, 0.05], 0.05 * np.eye(3))
    links = [replace(link, nominal=body) for link in robot.links]
    return replace(robot, links=tuple(links))


def path(arm, *, late=0.0):
    """A slow way there and back: positions, velocities and accelerations."""
    time = np.arange(0.0, SECONDS, 1.0 / RATE)
    s = np.sin(np.pi * (time - late) / SECONDS) ** 2
    ds = np.pi / SECONDS * np.sin(2 * np.pi * (time - late) / SECONDS)
    dds = 2 * (np.pi / SECONDS) ** 2 * np.cos(2 * np.pi * (time - late) / SECONDS)
    reach = np.array([1.2, -2.0, 1.5])
    ripple = 0.3 * np.sin(4 * s)
    q = np.outer(s, reach) + 0.4 + np.outer(ripple, [0.0, 1.0, -1.0])
    dq = np.outer(ds, reach) + np.outer(1.2 * np.cos(4 * s) * ds, [0.0, 1.0, -1.0])
    bent = 1.2 * np.cos(4 * s) * dds - 4.8 * np.sin(4 * s) * ds**2
    ddq = np.outer(dds, reach) + np.outer(bent, [0.0, 1.0, -1.0])
    return time, q, dq, ddq


def logged(arm, **options):
    """A log with friction as large as gravity is, and what each of them is."""
    time, q, dq, ddq = path(arm, **options)
    model = ci.TorqueModel(arm, FRICTION)
    truth = np.append(arm.nominal, np.zeros(len(model.layout) - len(arm.nominal)))
    bodies = model.predict(truth, q, dq, ddq)
    for k, name in enumerate(model.layout.names[len(arm.nominal) :]):
        truth[len(arm.nominal) + k] = 0.05 if "load" in name else 4.0
    torque = model.predict(truth, q, dq, ddq)
    log = ci.Recording(arm.joint_names, time, q, dq, ddq, torque)
    return log, bodies


def test_friction_cancels_whatever_its_law(arm):
    log, bodies = logged(arm)
    assert abs(log.torque - bodies).max() > 3.0
    mean = ci.signals.there_and_back(log)
    plain = ci.TorqueModel(arm)
    states = mean.position, mean.velocity, mean.acceleration
    expected = plain.predict(arm.nominal, *states)
    # Rounding, and nothing else: rows of bodies are even in velocity.
    assert np.allclose(mean.torque, expected, rtol=0, atol=1e-9)
    assert len(mean) == pytest.approx(len(log) / 2, abs=2)


@pytest.mark.slow
def test_gravity_alone_tells_masses_times_centres(arm):
    """Without velocity and acceleration: what inertia adds on slow motion is small."""
    log, _ = logged(arm, late=0.37)
    still = replace(log, velocity=None, acceleration=None)
    mean, model = ci.signals.there_and_back(still), ci.TorqueModel(arm)
    found = ci.least_squares(model, ci.build_regression(model, mean))
    held, zeros = mean.position[::50], np.zeros((len(mean.position[::50]), 3))
    right = model.predict(arm.nominal, held, zeros, zeros)
    predicted = model.predict(found.parameters, held, zeros, zeros)
    assert abs(predicted - right).max() < 0.02 * abs(right).max()
    assert all(origin == "convention" for origin in found.origins[14:20])
    naive = replace(still, velocity=0 * log.position, acceleration=0 * log.position)
    one_way = ci.least_squares(
        model, ci.build_regression(model, naive.samples(slice(0, len(naive) // 2)))
    )
    off = model.predict(one_way.parameters, held, zeros, zeros) - right
    assert abs(off).max() > 0.1 * abs(right).max()


@pytest.mark.slow
def test_hysteresis_of_a_wrench_sensor_cancels(arm):
    log, _ = logged(arm)
    tool = ci.InertialParameters.from_central(1.3, [0.02, 0, 0.08], 4e-3 * np.eye(3))
    motion = ci.regression.sensor_motion(arm, log, "link3")
    model, none = ci.regression.tool_model(), np.zeros((len(log), 0))
    bias = [3.0, -2.0, 5.0, 0.1, -0.2, 0.05]
    clean = model.predict([*tool.vector, *bias], none, none, none, base=motion)
    felt = clean + 0.5 * np.sign(log.velocity[:, :1])
    log = replace(log, wrenches=(ci.recordings.Wrench("link3", felt),))
    mean = ci.signals.there_and_back(log)
    regression = ci.regression.sensor_regression(model, arm, mean, frame="link3")
    known = [ci.PhysicalConsistency()]
    found = ci.constrained_least_squares(model, regression, constraints=known)
    assert found["tool.m"] == pytest.approx(1.3, abs=0.01)
    raw = ci.regression.sensor_regression(
        model, arm, log.samples(slice(0, 1900)), frame="link3"
    )
    one_way = ci.constrained_least_squares(model, raw, constraints=known)
    assert abs(one_way["base.fx.bias"] - 3.0) > 0.3


def test_torque_is_known_where_it_is_known_both_times(arm):
    log, _ = logged(arm)
    known = np.ones(log.torque.shape, dtype=bool)
    known[300, 1] = known[-500, 2] = False
    mean = ci.signals.there_and_back(replace(log, torque_known=known), turn=SECONDS / 2)
    at = len(log) // 2
    back = 2 * at - (len(log) - 500)  # of the way there, the sample at the same place
    first = at - len(mean)
    unknown = {(300 - first, 1), (back - first, 2)}
    assert set(zip(*np.nonzero(~mean.torque_known), strict=True)) == unknown


@pytest.mark.slow
def test_a_robot_that_waits_does_not_turn_there(arm):
    """About any sample of a rest, motion is most symmetric."""
    log, _ = logged(arm)
    rest, q = 4000, log.position
    time = np.arange(rest + len(q)) / RATE
    waiting = np.vstack([np.repeat(q[:1], rest, axis=0), q])
    mean = ci.signals.there_and_back(ci.Recording(arm.joint_names, time, waiting))
    turn = mean.time[-1] + 1 / RATE
    assert turn == pytest.approx((rest + len(q) / 2) / RATE, abs=1.5 / RATE)


def test_what_does_not_come_back_is_refused(arm):
    log, _ = logged(arm)
    with pytest.raises(ci.RecordingError, match="expected one path both ways"):
        ci.signals.there_and_back(log.samples(slice(0, 2600)), turn=5.0)
    with pytest.raises(ci.RecordingError, match="no way there or none back"):
        ci.signals.there_and_back(log, turn=0.0)
    base = ci.regression.sensor_motion(arm, log, "link3")
    with pytest.raises(ci.RecordingError, match="the base moves"):
        ci.signals.there_and_back(replace(log, base=base))


@pytest.mark.parametrize(("travel", "share"), [(0.05, 0.1), (0.05, 0.01), (5.0, 0.01)])
def test_both_ways_may_differ_by_a_fiftieth_of_the_travel(travel, share):
    time = np.arange(2001) / 200.0
    path = 0.5 * (1.0 - np.cos(2 * np.pi * time / 10.0))
    late = np.where(time > 5.0, np.sin(np.pi * time / 5.0) ** 2, 0.0)
    log = ci.Recording(("slide",), time, travel * (path + share * late)[:, None])
    log = replace(log, torque=np.ones((2001, 1)))
    if share > 0.02:
        with pytest.raises(ci.RecordingError, match="expected one path both ways"):
            ci.signals.there_and_back(log, turn=5.0)
    else:
        ci.signals.there_and_back(log, turn=5.0)


@pytest.mark.parametrize(("first", "last", "turn"), [(1, 2, 80), (2, 1, 160)])
def test_the_turn_is_where_both_ways_are_most_alike_to_their_last_samples(
    first, last, turn
):
    """There, back and there: about either turn all is alike, but for one end."""
    sample = np.arange(241)
    q = np.cos(np.pi * sample / 80.0)
    q[0] += 1e-3 * first
    q[-1] += 1e-3 * last
    log = ci.Recording(("slide",), 0.01 * sample, q[:, None])
    mean = ci.signals.there_and_back(log)
    np.testing.assert_allclose(mean.time, 0.01 * np.arange(turn - 80, turn))
    np.testing.assert_allclose(mean.position[1:, 0], q[turn - 79 : turn], atol=1e-12)
