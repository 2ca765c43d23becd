"""Simulated experiments: mechanics by closed forms, sensors by their definitions."""

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from robots import random_robot
from scipy.special import ellipk

from consistent_id import (
    DHRow,
    DriveTerms,
    Recording,
    TorqueModel,
    build_regression,
    from_modified_dh,
    least_squares,
)
from consistent_id.errors import ModelError, ProblemError, SolverError
from consistent_id.laboratory import (
    Cameras,
    Controller,
    Encoders,
    Laboratory,
    LoadCell,
    SimulatedRobot,
    controlled,
    perform,
    synchronised,
    with_friction,
)
from consistent_id.recordings.joint_paths import Sinusoid, SinusoidalMotion
from consistent_id.robot import JointLimits

# A rod of 1 kg and 0.6 m about its end; gravity along -x of the base, so that it hangs.
ROD = [1.0, 0.3, 0, 0, 0, 0, 0.12, 0, 0, 0.12]
PENDULUM = from_modified_dh("pendulum", [DHRow(0, 0)], gravity=[9.81, 0, 0])
ARM = from_modified_dh("arm", [DHRow(0, 0, 0.3), DHRow(-np.pi / 2, 0), DHRow(0, 0.4)])
BODY = [4, 0.8, 0.1, 0, 0.1, 0, 0.3, 0, 0, 0.3]
FRICTION = {"viscous": [2.0, 1.0, 0.5], "coulomb": [3.0, 3.0, 1.0]}
TRUE = with_friction(ARM, BODY * 3, **FRICTION, velocity_scale=0.05)
MOTION = SinusoidalMotion(
    8.0,
    1000.0,
    (
        (Sinusoid(0.6, 0.6, 0.5), Sinusoid(0.2, 0.2, 1.1)),
        (Sinusoid(0.5, 0.5, 0.4), Sinusoid(0.2, 0.2, 0.9)),
        (Sinusoid(0.6, 0.6, 0.7), Sinusoid(0.3, 0.3, 0.3)),
    ),
).recording(ARM.joint_names)
SHORT = MOTION.samples(slice(0, 2000))
LABORATORY = Laboratory(
    TRUE,
    Controller(TRUE.model, 0.9 * TRUE.parameters),
    Encoders([1e-4, 2e-4, 0.5e-4]),
    LoadCell(noise=[0.1, 0.1, 0.05], offset=[0.3, -0.2, 0.1]),
    Cameras(300.0, delay=0.0372, acceleration_noise=0.05, position_noise=1e-3),
)


@cache
def _log():
    return perform(LABORATORY, MOTION, np.random.default_rng(0))


def _let_go(angle, friction=0.0, rate=1000.0, seconds=6.0):
    """A pendulum left alone: a controller that believes in nothing does nothing."""
    rod = with_friction(PENDULUM, ROD, viscous=friction)
    time = np.arange(round(seconds * rate) + 1) / rate
    still = np.full((len(time), 1), angle)
    wanted = Recording(("joint1",), time, still, 0 * still, 0 * still)
    idle = Controller(rod.model, np.zeros(len(rod.parameters)))
    return controlled(rod, idle, Encoders(), wanted, substeps=1).motion


@pytest.mark.parametrize("angle", [0.1, 1.0, 2.5])
def test_a_pendulum_swings_with_the_period_of_the_elliptic_integral(angle):
    motion = _let_go(angle)
    q, t = motion.position[:, 0], motion.time
    down = np.flatnonzero((q[:-1] > 0) & (q[1:] <= 0))
    crossings = t[down] - q[down] * (t[down + 1] - t[down]) / (q[down + 1] - q[down])
    period = 4 * np.sqrt(0.12 / (9.81 * 0.3)) * ellipk(np.sin(angle / 2) ** 2)
    # Crossings by straight lines between samples of 1 ms: some 1e-9 s.
    assert np.diff(crossings) == pytest.approx(period, abs=1e-7)


@pytest.mark.slow
def test_a_pendulum_keeps_its_energy_and_loses_it_to_friction_alone():
    for friction in (0.0, 0.05):
        motion = _let_go(1.0, friction)
        q, dq = motion.position[:, 0], motion.velocity[:, 0]
        energy = 0.12 / 2 * dq**2 - 9.81 * 0.3 * np.cos(q)
        h = 1e-3
        # Simpson's rule for the work of friction, over the samples up to the end.
        power = friction * dq**2
        work = h / 3 * (power[0] + 4 * power[1:-1:2].sum() + 2 * power[2:-1:2].sum())
        work += h / 3 * power[-1]
        assert energy[-1] + work == pytest.approx(energy[0], abs=1e-9)


@pytest.mark.parametrize("tree", [False, True])
def test_forward_dynamics_are_pinocchios(tree):
    rng = np.random.default_rng(3)
    reference, robot = random_robot(rng, 5, tree=tree)
    rotor = DriveTerms(rotor_inertia=True)
    x = np.concatenate([robot.nominal, np.full(5, 0.3)])
    simulated = SimulatedRobot(TorqueModel(robot, rotor), x)
    dynamics = simulated.forward_dynamics()
    reference.armature = np.full(5, 0.3)
    data = reference.createData()
    for _ in range(5):
        q, dq, tau = rng.uniform(-2.0, 2.0, (3, 5))
        expected = pin.aba(reference, data, q, dq, tau)
        found = np.array(dynamics(q, dq, tau)).ravel()
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.slow
def test_what_the_sensors_would_read_without_error_satisfies_the_torque_model():
    truth = _log().truth
    torque = TRUE.model.predict(
        TRUE.parameters, truth.position, truth.velocity, truth.acceleration
    )
    assert torque == pytest.approx(truth.torque, abs=1e-9)


@pytest.mark.slow
def test_the_robot_follows_and_the_better_the_belief_the_closer():
    rng = np.random.default_rng(0)
    rough = _log().tracking_error
    belief = Controller(TRUE.model, TRUE.parameters)
    exact = replace(LABORATORY, controller=belief, encoders=Encoders())
    error = perform(exact, MOTION, rng).tracking_error
    # Rad; a torque wrong by a tenth over a stiffness of (2 pi 5 Hz)^2 m.
    assert (rough < 5e-3).all()
    # What is left comes of the torque that is held for 1 ms.
    assert (error < 2e-4).all()
    assert (error < rough / 10).all()


@pytest.mark.slow
def test_encoders_read_whole_steps_nearest_to_the_truth():
    log = _log()
    step = LABORATORY.encoders.step
    counts = np.round(log.encoders.position / step)
    assert (counts * step == log.encoders.position).all()
    error = abs(log.encoders.position - log.truth.position)
    assert (error <= step / 2 * (1 + 1e-9)).all()
    assert (error.max(axis=0) > 0.49 * step).all()
    plain = replace(LABORATORY, encoders=Encoders())
    log = perform(plain, MOTION, np.random.default_rng(0))
    assert (log.encoders.position == log.truth.position).all()


@pytest.mark.slow
def test_the_load_cell_adds_its_offset_and_white_noise():
    log = _log()
    error = log.encoders.torque - log.truth.torque
    cell = LABORATORY.load_cell
    # 8001 samples: standard errors of 0.011 of the noise for mean and deviation.
    assert error.mean(axis=0) == pytest.approx(cell.offset, abs=0.05 * cell.noise.max())
    assert error.std(axis=0) == pytest.approx(cell.noise, rel=0.04)


@pytest.mark.slow
def test_the_cameras_have_their_own_clock_delay_and_noise():
    log = _log()
    seen, cameras = log.cameras, LABORATORY.cameras
    assert seen.rate == pytest.approx(300.0)
    assert seen.time[0] == pytest.approx(0.0372)
    there = [
        np.interp(seen.time - 0.0372, log.truth.time, c) for c in log.truth.position.T
    ]
    error = seen.position - np.transpose(there)
    assert error.std(axis=0) == pytest.approx(1e-3, rel=0.05)
    exact = replace(LABORATORY, cameras=replace(cameras, acceleration_noise=0.0))
    clean = perform(exact, MOTION, np.random.default_rng(0)).cameras
    error = seen.acceleration - clean.acceleration
    assert error.std(axis=0) == pytest.approx(0.05, rel=0.05)
    drifting = replace(cameras, drift=1e-3, delay=0.0)
    times, stamps = drifting.stamps(2.0, 10.0)
    assert stamps == pytest.approx(times * 1.001, abs=1e-12)
    assert np.diff(stamps) == pytest.approx(1 / 300.0)
    assert (times[0], times[-1] <= 10.0) == (2.0, True)


@pytest.mark.slow
def test_one_seed_is_one_experiment_and_sensors_do_not_share_their_noise():
    first = perform(LABORATORY, SHORT, np.random.default_rng(7))
    again = perform(LABORATORY, SHORT, np.random.default_rng(7))
    assert (first.encoders.torque == again.encoders.torque).all()
    assert (first.cameras.acceleration == again.cameras.acceleration).all()
    other = perform(LABORATORY, SHORT, np.random.default_rng(8))
    assert (first.encoders.torque != other.encoders.torque).any()
    slower = replace(LABORATORY.cameras, rate=200.0)
    changed = perform(
        replace(LABORATORY, cameras=slower), SHORT, np.random.default_rng(7)
    )
    assert (first.encoders.torque == changed.encoders.torque).all()


@pytest.mark.slow
def test_friction_switched_off_is_the_torque_that_is_missing():
    smooth = replace(
        LABORATORY, load_cell=LoadCell(), encoders=Encoders(), cameras=Cameras()
    )
    assert TRUE.friction and not smooth.without_friction().robot.friction
    with_it = perform(smooth, SHORT, np.random.default_rng(0)).truth
    without = perform(smooth.without_friction(), SHORT, np.random.default_rng(0)).truth
    inertial = replace(TRUE.model, drive=DriveTerms())
    for truth, rest in ((with_it, True), (without, False)):
        rigid = inertial.predict(
            TRUE.parameters[:30], truth.position, truth.velocity, truth.acceleration
        )
        friction = truth.torque - rigid
        v = truth.velocity
        viscous, coulomb = np.array(FRICTION["viscous"]), np.array(FRICTION["coulomb"])
        expected = viscous * v + coulomb * np.tanh(v / 0.05)
        assert friction == pytest.approx(rest * expected, abs=1e-9)


@pytest.mark.slow
def test_the_delay_is_recovered_far_within_a_sample():
    found = synchronised(_log(), cutoff=60.0, trim=0.2)
    assert found.delay.seconds == pytest.approx(0.0372, abs=2e-4)
    assert found.recording.rate == pytest.approx(300.0, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noisy", "tolerance"),
    # Filters round off the tanh near standstill, by some 0.002 N m; noise costs more.
    [(False, 0.004), (True, 0.1)],
)
def test_friction_and_offsets_are_recovered_from_two_clocks(noisy, tolerance):
    exact = replace(
        LABORATORY,
        encoders=Encoders(),
        load_cell=replace(LABORATORY.load_cell, noise=0.0),
        cameras=Cameras(delay=0.0372),
    )
    log = _log() if noisy else perform(exact, MOTION, np.random.default_rng(0))
    drive = replace(TRUE.model.terms[0], offset=True)
    model = TorqueModel(ARM, drive)
    recording = synchronised(log, cutoff=60.0, trim=0.2).recording
    estimate = least_squares(model, build_regression(model, recording))
    truth = {"viscous": [2.0, 1.0, 0.5], "coulomb": [3.0, 3.0, 1.0]}
    truth["offset"] = [0.3, -0.2, 0.1]
    for term, values in truth.items():
        for number, value in enumerate(values, start=1):
            found = estimate[f"joint{number}.{term}"]
            assert found == pytest.approx(value, abs=tolerance), (number, term)


def test_efforts_stay_within_the_joints_limits():
    rows = [DHRow(0, 0, limits=JointLimits(effort=2.0))]
    rod = with_friction(from_modified_dh("rod", rows, gravity=[9.81, 0, 0]), ROD)
    wanted = SinusoidalMotion(1.0, 1000.0, ((Sinusoid(1.5, 1.5, 1.0),),))
    loop = controlled(
        rod,
        Controller(rod.model, rod.parameters),
        Encoders(),
        wanted.recording(("joint1",)),
    )
    assert abs(loop.torque).max() == 2.0


@pytest.mark.slow
def test_laboratories_that_make_no_sense_are_refused():
    sign = TorqueModel(ARM, DriveTerms(coulomb="sign"))
    load = TorqueModel(
        ARM,
        DriveTerms(coulomb="tanh", velocity_scale=0.1, load_friction=True),
        load_reference=np.array(BODY * 3),
    )
    steep = with_friction(ARM, BODY * 3, coulomb=5.0, velocity_scale=1e-3)
    eager = Controller(TRUE.model, TRUE.parameters, bandwidth=500.0)
    still = replace(MOTION, velocity=None)
    rng = np.random.default_rng(0)
    refusals = [
        (ProblemError, "has a sign", lambda: SimulatedRobot(sign, np.zeros(33))),
        (ProblemError, "on the load", lambda: SimulatedRobot(load, np.zeros(36))),
        (ModelError, "an eigenvalue of", lambda: with_friction(ARM, np.zeros(30))),
        (ProblemError, "0 or more", lambda: with_friction(ARM, BODY * 3, viscous=-1.0)),
        (ProblemError, "step is -1", lambda: Encoders(-1.0)),
        (ProblemError, "rate is 0", lambda: Cameras(0.0)),
        (ProblemError, "drift is 1", lambda: Cameras(drift=1.0)),
        (ProblemError, "delay is inf", lambda: Cameras(delay=np.inf)),
        (ProblemError, "bandwidth is 0", lambda: replace(eager, bandwidth=0.0)),
        (
            ProblemError,
            "has shape",
            lambda: replace(LABORATORY, load_cell=LoadCell([1.0, 2.0])),
        ),
        (
            ProblemError,
            "use .* substeps",
            lambda: perform(replace(LABORATORY, robot=steep), MOTION, rng),
        ),
        (
            SolverError,
            "out of control",
            lambda: perform(replace(LABORATORY, controller=eager), MOTION, rng),
        ),
        (Exception, "no velocity", lambda: perform(LABORATORY, still, rng)),
    ]
    for error, message, call in refusals:
        with pytest.raises(error, match=message):
            call()
