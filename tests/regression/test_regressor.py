"""The regressor: Pinocchio, CasADi, energy, closed forms of the drive terms."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from robots import random_robot, random_states

from consistent_id import DHRow, DriveTerms, ProblemError, TorqueModel, from_modified_dh
from consistent_id.regression import GearCoupling
from consistent_id.regression.casadi_rows import casadi_regressor
from consistent_id.regression.newton_euler import minus, mul, plus
from consistent_id.regression.regressor import joint_torque_regressor

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
    from consistent_id.robot.loaders.urdf import from_pinocchio

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
    full = DriveTerms(
        viscous=True, coulomb="sign", offset=True, rotor_inertia=True, spring=True
    )
    model = TorqueModel(robot, (smooth, full))
    q, dq, ddq = states = random_states(rng, 2, 8)
    Y = model.regressor(*states)
    assert model.layout.names[20:] == (
        "j0.coulomb",
        "j1.viscous",
        "j1.coulomb",
        "j1.offset",
        "j1.rotor_inertia",
        "j1.spring",
    )
    assert np.allclose(Y[0, 20], np.tanh(dq[:, 0] / 0.5))
    assert np.array_equal(Y[1, 21], dq[:, 1])
    assert np.array_equal(Y[1, 22], np.sign(dq[:, 1]))
    assert np.array_equal(Y[1, 23], np.ones(8))
    assert np.array_equal(Y[1, 24], ddq[:, 1])
    assert np.array_equal(Y[1, 25], q[:, 1])
    assert not Y[1, 20].any()
    assert not Y[0, 21:].any()


def _coupled(rng, coulomb="tanh", velocity_scale=0.3):
    """A robot of four turning joints, the last two coupled, and its torque model."""
    table = [DHRow(angle, 0.1) for angle in (0.0, -np.pi / 2, 0.4, np.pi / 2)]
    drive = DriveTerms(viscous=True, offset=True, spring=True)
    coupling = GearCoupling(
        "joint4",
        "joint3",
        viscous=True,
        coulomb=coulomb,
        velocity_scale=velocity_scale,
        rotor_inertia=True,
    )
    model = TorqueModel(from_modified_dh("arm", table), drive, (coupling,))
    return model, rng.normal(size=len(model.layout))


def test_coupled_gears_give_the_torque_of_their_formula():
    rng = np.random.default_rng(21)
    model, x = _coupled(rng)
    assert model.layout.names[-3:] == (
        "joint4+joint3.coupling_viscous",
        "joint4+joint3.coupling_coulomb",
        "joint4+joint3.coupling_rotor_inertia",
    )
    assert model.layout.units[-3:] == ("N m s/rad", "N m", "kg m^2")
    viscous, coulomb, inertia = x[-3:]
    q, dq, ddq = random_states(rng, 4, 20)
    bare = TorqueModel(model.robot, model.drive)
    shared = model.predict(x, q, dq, ddq) - bare.predict(x[:-3], q, dq, ddq)
    friction = coulomb * np.tanh((dq[:, 2] + dq[:, 3]) / 0.3)
    expected = np.zeros((20, 4))
    expected[:, 3] = viscous * dq[:, 2] + inertia * ddq[:, 2] + friction
    expected[:, 2] = viscous * dq[:, 3] + inertia * ddq[:, 3] + friction
    assert np.allclose(shared, expected, rtol=0, atol=1e-12)


def test_a_motor_that_turns_with_the_sum_of_rates_is_a_coupling():
    # Its kinetic energy is I (dq3 + dq4)^2 / 2, its friction v (dq3 + dq4).
    model, x = _coupled(np.random.default_rng(22))
    model = TorqueModel(
        model.robot, DriveTerms(viscous=True, rotor_inertia=True), model.couplings
    )
    x = np.zeros(len(model.layout))
    for joints in ("joint3", "joint4"):
        x[model.layout.index(f"{joints}.viscous")] = 0.7
        x[model.layout.index(f"{joints}.rotor_inertia")] = 0.2
    x[model.layout.index("joint4+joint3.coupling_viscous")] = 0.7
    x[model.layout.index("joint4+joint3.coupling_rotor_inertia")] = 0.2
    q, dq, ddq = random_states(np.random.default_rng(23), 4, 9)
    motor = 0.7 * dq[:, 2:].sum(axis=1) + 0.2 * ddq[:, 2:].sum(axis=1)
    torque = model.predict(x, q, dq, ddq)
    assert np.allclose(torque[:, 2:], motor[:, None], rtol=0, atol=1e-13)
    assert not torque[:, :2].any()


@pytest.mark.parametrize(("coulomb", "scale"), [("sign", None), ("tanh", 0.3)])
def test_the_casadi_form_has_the_drive_terms_and_couplings_too(coulomb, scale):
    rng = np.random.default_rng(24)
    model, _ = _coupled(rng, coulomb, scale)
    every = DriveTerms(True, coulomb, scale, True, True, True)
    model = TorqueModel(model.robot, every, model.couplings)
    states = random_states(rng, 4, 5)
    Y, function = model.regressor(*states), casadi_regressor(model)
    for s, state in enumerate(zip(*states, strict=True)):
        found = function(*state).full()
        assert np.allclose(found, Y[:, :, s], rtol=0, atol=1e-12 * abs(Y).max())


def test_what_is_coupled_belongs_to_the_fingerprint():
    model, _ = _coupled(np.random.default_rng(0))
    other, _ = _coupled(np.random.default_rng(0), velocity_scale=0.4)
    assert other.layout == model.layout
    assert other.fingerprint != model.fingerprint


@pytest.mark.parametrize(
    ("coupling", "message"),
    [
        (("joint3", "joint9"), "no joint 'joint9'"),
        (("joint3", "slide"), "one joint turns, the other slides"),
    ],
)
def test_couplings_of_joints_that_cannot_be_coupled_are_refused(coupling, message):
    table = [DHRow(0.0, 0.1), DHRow(1.0, 0.1), DHRow(1.0, 0.1)]
    robot = from_modified_dh("arm", [*table, DHRow(0.0, 0.2, kind="prismatic")])
    joints = (*robot.joints[:3], replace(robot.joints[3], name="slide"))
    robot = replace(robot, joints=joints)
    with pytest.raises(ProblemError, match=message):
        TorqueModel(robot, couplings=(GearCoupling(*coupling, viscous=True),))


@pytest.mark.parametrize(
    "terms",
    [
        ("a", "a", True),
        ("a", "b"),
        ("a", "b", True, "tanh"),
        ("a", "b", True, "sign", 0.1),
    ],
)
def test_couplings_that_make_no_sense_are_refused(terms):
    with pytest.raises(ProblemError):
        GearCoupling(*terms)


def test_a_path_in_place_of_a_robot_is_refused_with_the_call_that_reads_it():
    with pytest.raises(ProblemError, match=r"a str, expected a RobotModel; load_robot"):
        TorqueModel("robot.urdf")


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


@pytest.mark.parametrize("x", [0.0, 1.0, 2.0, "samples"])
@pytest.mark.parametrize("y", [0.0, 1.0, 2.0, "others"])
def test_zeros_and_ones_stay_out_of_the_arithmetic(x, y):
    arrays = {"samples": np.array([3.0, -0.5]), "others": np.array([7.0, 0.25])}
    x, y = arrays.get(x, x), arrays.get(y, y)
    for found, expected in (
        (mul(x, y), np.multiply(x, y)),
        (plus(x, y), np.add(x, y)),
        (minus(x, y), np.subtract(x, y)),
    ):
        np.testing.assert_array_equal(np.broadcast_to(found, expected.shape), expected)
    # A factor of one leaves the other as it is; of zero, none.
    if isinstance(x, float) and x < 2.0:
        product = mul(x, arrays["others"])
        assert product is arrays["others"] if x == 1.0 else product == 0.0
