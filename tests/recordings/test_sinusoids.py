"""Motions by formula and recordings of known robots."""

import numpy as np
import pytest
from robots import random_robot, random_states

from consistent_id import (
    DHRow,
    ProblemError,
    Recording,
    RecordingError,
    TorqueModel,
    from_modified_dh,
)
from consistent_id.problems.published import Combination, Parametrisation
from consistent_id.recordings.joint_paths import Sinusoid, SinusoidalMotion
from consistent_id.regression.torque_along import simulate_torque


def test_derivatives_are_those_of_finite_differences():
    term = Sinusoid(start=0.4, end=-0.9, frequency=0.7, phase=0.3)
    t, step = np.linspace(0.0, 3.0, 50), 1e-4
    before, here, after = (term.evaluate(t + d, 3.0) for d in (-step, 0.0, step))
    # Central differences err by step^2 / 6 times the next derivatives, below 1e-6.
    assert np.allclose((after[0] - before[0]) / (2 * step), here[1], atol=1e-6)
    assert np.allclose((after[1] - before[1]) / (2 * step), here[2], atol=1e-6)


def test_the_amplitude_runs_from_start_to_end():
    t = np.array([0.0, 2.0])
    q = Sinusoid(0.5, 0.8, frequency=0.0, phase=np.pi / 2).evaluate(t, 2.0)[0]
    assert q == pytest.approx([0.5, 0.8])


def test_both_ends_are_sampled_and_joints_must_match():
    motion = SinusoidalMotion(2.0, 50.0, ((Sinusoid(1, 1, 0.5),), ()))
    recording = motion.recording(("a", "b"))
    assert (len(recording), recording.time[-1]) == (101, 2.0)
    assert not recording.position[:, 1].any()
    with pytest.raises(ProblemError, match="sinusoids for 2 joints"):
        motion.recording(("a",))
    with pytest.raises(ProblemError, match="duration is 0"):
        SinusoidalMotion(0.0, 50.0, ())


def _setup():
    rng = np.random.default_rng(0)
    _, robot = random_robot(rng, 2)
    states = random_states(rng, 2, 4000)
    motion = Recording(robot.joint_names, np.arange(4000) / 100, *states)
    return TorqueModel(robot), robot.nominal, motion


def test_noise_has_the_stated_deviation_and_comes_from_the_seed():
    model, x, motion = _setup()
    exact = simulate_torque(model, x, motion).torque
    noisy = [
        simulate_torque(
            model, x, motion, noise=[0.5, 2.0], rng=np.random.default_rng(3)
        )
        for _ in range(2)
    ]
    assert np.array_equal(noisy[0].torque, noisy[1].torque)
    # A standard deviation from 4000 samples is good to 1.1 %; four of them.
    assert np.std(noisy[0].torque - exact, axis=0) == pytest.approx(
        [0.5, 2.0], rel=0.045
    )


def test_noise_without_a_generator_and_motion_without_rates_are_refused():
    model, x, motion = _setup()
    with pytest.raises(ProblemError, match="random generator"):
        simulate_torque(model, x, motion, noise=1.0)
    bare = Recording(motion.joints, motion.time, motion.position)
    with pytest.raises(RecordingError, match="differentiated"):
        simulate_torque(model, x, bare)


def test_combinations_that_leave_a_parameter_out_are_refused_by_its_name():
    arm = from_modified_dh("arm", [DHRow(0.0, 0.0), DHRow(-np.pi / 2, 0.3)])
    model = TorqueModel(arm)
    names = model.layout.names
    missing = "link2.Ixy"
    kept = [n for n in names if n != missing]
    combinations = tuple(
        Combination(f"{effect} {n}", n, "", {n: 1.0}, effect)
        for effect in ("inertia", "gravity")
        for n in kept
    )
    with pytest.raises(ProblemError, match=missing):
        Parametrisation(model, combinations)
    full = (
        *combinations,
        *(
            Combination(f"{e} rest", missing, "", {missing: 1.0}, e)
            for e in ("inertia", "gravity")
        ),
    )
    assert len(Parametrisation(model, full)) == 2 * len(names)
