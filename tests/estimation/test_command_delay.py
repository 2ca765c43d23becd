"""The delay of commands, found again where it is known."""

import numpy as np
import pytest
from robots import random_robot
from some_fast import some_fast

from consistent_id import DriveTerms, Recording, TorqueModel
from consistent_id.constraints import FixedParameters
from consistent_id.estimation import command_delay
from consistent_id.signals import PDGains, commanded

TIME = np.arange(3000) / 200.0
GAINS = PDGains(30.0, 1.0)
DRIVE = DriveTerms(viscous=True, rotor_inertia=True)


def motion(time, joints):
    """Chirps, and their derivatives in closed form."""
    q, dq, ddq = (np.empty((len(time), joints)) for _ in range(3))
    for j in range(joints):
        phase, rate = (1.5 + j) * time + 0.3 * time**2, 1.5 + j + 0.6 * time
        q[:, j] = 0.4 * np.sin(phase)
        dq[:, j] = 0.4 * rate * np.cos(phase)
        ddq[:, j] = 0.4 * (0.6 * np.cos(phase) - rate**2 * np.sin(phase))
    return q, dq, ddq


def told_early(model, x, delay, noise=0.0):
    """A log whose commands, held and that much later, make the torque of the motion."""
    delay = delay + 0.5 * (TIME[1] - TIME[0])
    q, dq, ddq = motion(TIME, len(model.robot))
    qe, dqe, ddqe = motion(TIME + delay, len(model.robot))
    torque = model.predict(x, qe, dqe, ddqe)
    torque += noise * np.random.default_rng(1).standard_normal(torque.shape)
    told = qe + (torque + GAINS.kd * dqe) / GAINS.kp
    return Recording(model.robot.joint_names, TIME, q, dq, ddq, position_command=told)


@pytest.mark.slow
@pytest.mark.parametrize("delay", some_fast([0.0032, 0.0121, 0.0]))
def test_the_delay_is_found_again(delay):
    rng = np.random.default_rng(5)
    _, robot = random_robot(rng, 2)
    model = TorqueModel(robot, DRIVE)
    x = np.append(robot.nominal, [0.3, 0.02, 0.5, 0.01])
    log = told_early(model, x, delay, noise=0.02)
    known = FixedParameters(
        dict(zip(model.layout.names[:20], robot.nominal.tolist(), strict=True))
    )
    for constraints in ((), (known,)):
        found = command_delay(
            model,
            lambda d: [commanded(log, GAINS, delay=d)],
            constraints=constraints,
        )
        # Linear interpolation of 200 Hz commands of some 2 Hz: 0.05 ms.
        assert abs(found.seconds - delay) < 4.0 * found.standard_error + 5e-5
        assert 0.0 < found.standard_error < 1e-3


def test_the_misfit_is_least_at_the_delay():
    _, robot = random_robot(np.random.default_rng(6), 1)
    model = TorqueModel(robot, DRIVE)
    x = np.append(robot.nominal, [0.3, 0.02])
    log = told_early(model, x, 0.008, noise=0.05)
    found = command_delay(model, lambda d: [commanded(log, GAINS, delay=d)])
    nearest = found.tried[found.misfits.argmin()]
    # The lowest point of the parabola through the least misfit and its neighbours.
    near = np.argsort(abs(found.tried - nearest))[:3]
    bend, slope, _ = np.polyfit(found.tried[near] - nearest, found.misfits[near], 2)
    assert found.seconds == pytest.approx(nearest - slope / (2.0 * bend), abs=1e-7)
    assert abs(nearest - 0.008) < 1e-3
    assert found.misfits.min() == 1.0
    # Six steps of 5 ms, then three times half a step either way of the least.
    tried = {round(1e3 * float(delay), 6) for delay in found.tried}
    halved = {7.5, 12.5, 6.25, 8.75, 6.875, 8.125}
    assert tried == {0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, *halved}


def test_a_torque_that_is_the_same_at_any_delay_tells_none():
    _, robot = random_robot(np.random.default_rng(6), 1)
    model = TorqueModel(robot, DRIVE)
    states = motion(TIME[:100], 1)
    torque = model.predict(np.append(robot.nominal, [0.3, 0.02]), *states)
    torque += 0.1 * np.random.default_rng(0).normal(size=torque.shape)
    log = Recording(robot.joint_names, TIME[:100], *states, torque)
    found = command_delay(model, lambda _: [log])
    assert np.isinf(found.standard_error)
