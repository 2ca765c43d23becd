"""The regressor: Pinocchio, CasADi, energy, closed forms of the drive terms."""

import numpy as np
import pinocchio as pin
import pytest
from robots import random_robot, random_states

from consistent_id import DriveTerms, ProblemError, TorqueModel
from consistent_id.regressor import casadi_regressor, joint_torque_regressor

CASES = [(n, tree) for n in range(1, 10) for tree in (False, True)]

# Rounding in two different recursions: a few units in the last place per joint.
RELATIVE = 1e-12


@pytest.mark.parametrize(("joints", "tree"), CASES)
def test_it_equals_pinocchio_on_random_serial_and_tree_robots(joints, tree):
    rng = np.random.default_rng(100 * joints + tree)
    for _ in range(3):
        reference, robot = random_robot(rng, joints, tree)
        data = reference.createData()
        states = random_states(rng, joints, 4)
        Y = joint_torque_regressor(robot, *states)
        for s, state in enumerate(zip(*states, strict=True)):
            expected = pin.computeJointTorqueRegressor(reference, data, *state)
            assert abs(Y[:, :, s] - expected).max() <= RELATIVE * abs(expected).max()


@pytest.mark.parametrize(("joints", "tree"), [(1, False), (4, True), (7, False)])
def test_the_casadi_form_equals_the_numpy_form(joints, tree):
    rng = np.random.default_rng(joints)
    _, robot = random_robot(rng, joints, tree)
    states = random_states(rng, joints, 5)
    Y = joint_torque_regressor(robot, *states)
    function = casadi_regressor(robot)
    for s, state in enumerate(zip(*states, strict=True)):
        assert np.allclose(
            function(*state).full(), Y[:, :, s], rtol=0, atol=1e-12 * abs(Y).max()
        )


@pytest.mark.parametrize(("joints", "tree"), [(3, False), (6, True)])
def test_regressor_times_parameters_is_the_torque_of_rnea(joints, tree):
    rng = np.random.default_rng(7 + joints)
    reference, robot = random_robot(rng, joints, tree)
    data = reference.createData()
    states = random_states(rng, joints, 6)
    torque = TorqueModel(robot).predict(robot.nominal, *states)
    for s, state in enumerate(zip(*states, strict=True)):
        expected = pin.rnea(reference, data, *state)
        assert np.allclose(torque[s], expected, rtol=0, atol=1e-12 * abs(torque).max())


def test_torque_is_linear_in_the_parameters():
    rng = np.random.default_rng(3)
    _, robot = random_robot(rng, 4)
    model = TorqueModel(robot, DriveTerms(viscous=True, coulomb="sign", offset=True))
    states = random_states(rng, 4, 10)
    x, y = rng.normal(size=(2, len(model.layout)))
    together = model.predict(2.0 * x - 3.0 * y, *states)
    apart = 2.0 * model.predict(x, *states) - 3.0 * model.predict(y, *states)
    assert np.allclose(together, apart, rtol=0, atol=1e-11 * abs(together).max())


def test_power_without_gravity_is_the_rate_of_kinetic_energy():
    rng = np.random.default_rng(11)
    reference, robot = random_robot(rng, 5, tree=True)
    reference.gravity = pin.Motion.Zero()
    from consistent_id.loaders.urdf import from_pinocchio

    robot = from_pinocchio(reference)
    data = reference.createData()
    step, t = 1e-4, np.arange(400) * 1e-4
    phase = np.arange(5)
    q = np.sin(3.0 * t[:, None] + phase)
    dq, ddq = 3.0 * np.cos(3.0 * t[:, None] + phase), -9.0 * q
    power = np.sum(TorqueModel(robot).predict(robot.nominal, q, dq, ddq) * dq, axis=1)
    energy = [
        pin.computeKineticEnergy(reference, data, *s) for s in zip(q, dq, strict=True)
    ]
    rate = np.gradient(energy, step)[1:-1]
    # Central differences err by step^2 / 6 times a third derivative, some 27 energies.
    assert np.allclose(power[1:-1], rate, rtol=0, atol=1e-5 * abs(power).max())


@pytest.mark.parametrize("size", [1, 3, 7, 64])
def test_chunks_of_any_size_give_the_same_regressor(size):
    rng = np.random.default_rng(5)
    _, robot = random_robot(rng, 3)
    model = TorqueModel(robot, DriveTerms(viscous=True))
    states = random_states(rng, 3, 20)
    pieces = [Y.copy() for _, Y in model.chunks(*states, size=size)]
    # Sines of arrays and of their pieces may differ in the last place.
    assert np.allclose(
        np.concatenate(pieces, axis=2), model.regressor(*states), atol=1e-12
    )


def test_drive_terms_have_the_columns_they_are_named_after():
    rng = np.random.default_rng(9)
    _, robot = random_robot(rng, 2)
    smooth = DriveTerms(coulomb="tanh", velocity_scale=0.5)
    full = DriveTerms(viscous=True, coulomb="sign", offset=True, rotor_inertia=True)
    model = TorqueModel(robot, (smooth, full))
    _, dq, ddq = states = random_states(rng, 2, 8)
    Y = model.regressor(*states)
    assert model.layout.names[20:] == (
        "j0.coulomb",
        "j1.viscous",
        "j1.coulomb",
        "j1.offset",
        "j1.rotor_inertia",
    )
    assert np.allclose(Y[0, 20], np.tanh(dq[:, 0] / 0.5))
    assert np.array_equal(Y[1, 21], dq[:, 1])
    assert np.array_equal(Y[1, 22], np.sign(dq[:, 1]))
    assert np.array_equal(Y[1, 23], np.ones(8))
    assert np.array_equal(Y[1, 24], ddq[:, 1])
    assert not Y[1, 20].any()
    assert not Y[0, 21:].any()


def test_no_sample_gives_an_empty_regressor():
    _, robot = random_robot(np.random.default_rng(1), 2)
    nothing = np.zeros((0, 2))
    assert joint_torque_regressor(robot, nothing, nothing, nothing).shape == (2, 20, 0)


@pytest.mark.parametrize(
    ("q", "dq", "message"),
    [
        (np.zeros((4, 3)), np.zeros((4, 2)), "q: expected shape"),
        (np.zeros((4, 2)), np.zeros((5, 2)), "dq has 5 samples, q has 4"),
        (np.full((4, 2), np.nan), np.zeros((4, 2)), "entry \\(0, 0\\) is nan"),
    ],
)
def test_motion_of_the_wrong_shape_or_content_is_refused(q, dq, message):
    _, robot = random_robot(np.random.default_rng(2), 2)
    with pytest.raises(ProblemError, match=message):
        joint_torque_regressor(robot, q, dq, np.zeros((4, 2)))


@pytest.mark.parametrize(
    "terms",
    [
        {"coulomb": "tanh"},
        {"coulomb": "tanh", "velocity_scale": 0.0},
        {"coulomb": "sign", "velocity_scale": 0.1},
        {"coulomb": "stribeck"},
    ],
)
def test_drive_terms_that_make_no_sense_are_refused(terms):
    with pytest.raises(ProblemError):
        DriveTerms(**terms)
