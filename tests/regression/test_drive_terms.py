"""Friction beyond viscous and Coulomb, and motors behind gears."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from robots import random_robot, random_states

from consistent_id import (
    DHRow,
    DriveTerms,
    InertialParameters,
    NonNegativeDrive,
    ProblemError,
    RotorInertias,
    TorqueModel,
    build_regression,
    constrained_least_squares,
    from_modified_dh,
    load_problem,
)
from consistent_id.constraints import Motor
from consistent_id.recordings.joint_paths import Sinusoid, SinusoidalMotion
from consistent_id.regression import base_parameters, casadi_regressor
from consistent_id.regression.torque_along import simulate_torque

FULL = DriveTerms(
    viscous=True,
    coulomb="tanh",
    velocity_scale=0.3,
    asymmetric=True,
    stribeck_velocity=0.5,
    stribeck_exponent=1.4,
    load_friction=True,
    rotor_inertia=True,
)


def _columns(terms, states, robot_seed=3):
    pin_model, robot = random_robot(np.random.default_rng(robot_seed), 3)
    model = TorqueModel(robot, terms)
    return pin_model, model, model.regressor(*states)


def test_asymmetric_coulomb_friction_has_a_level_for_each_direction():
    states = random_states(np.random.default_rng(0), 3, 30)
    _, model, Y = _columns(DriveTerms(coulomb="sign", asymmetric=True), states)
    x = np.zeros(len(model.layout))
    x[model.layout.index("j1.coulomb_positive")] = 3.0
    x[model.layout.index("j1.coulomb_negative")] = 2.0
    dq = states[1][:, 1]
    assert np.array_equal(Y[1].T @ x, np.where(dq > 0, 3.0, -2.0))
    units = [
        model.layout.units[i] for i in model.layout.drive_indices("coulomb_negative")
    ]
    assert len(units) == 3


def test_equal_levels_are_symmetric_friction():
    states = random_states(np.random.default_rng(1), 3, 30)
    smooth = DriveTerms(coulomb="tanh", velocity_scale=0.4)
    _, model, Y = _columns(smooth, states)
    _, _, both = _columns(replace(smooth, asymmetric=True), states)
    (c,) = [i for i in model.layout.drive_indices("coulomb") if Y[0, i].any()]
    assert np.allclose(both[0, 30] + both[0, 31], Y[0, c], rtol=0, atol=1e-15)


def test_stribeck_friction_falls_from_the_static_to_the_coulomb_level():
    terms = DriveTerms(coulomb="sign", stribeck_velocity=0.1, stribeck_exponent=2.0)
    dq = np.array([1e-9, 0.1, -0.1, 5.0])
    coulomb, stribeck = terms.columns(0 * dq, dq, 0 * dq)
    friction = 4.0 * coulomb + 1.5 * stribeck
    bell = np.exp(-1.0)
    expected = [5.5, 4.0 + 1.5 * bell, -(4.0 + 1.5 * bell), 4.0]
    assert np.allclose(friction, expected, rtol=0, atol=1e-12)


def test_load_friction_grows_with_pinocchios_torque():
    states = random_states(np.random.default_rng(2), 3, 10)
    terms = DriveTerms(coulomb="sign", load_friction=True)
    pin_model, model, Y = _columns(terms, states)
    data = pin_model.createData()
    torque = np.array(
        [pin.rnea(pin_model, data, *s) for s in zip(*states, strict=True)]
    )
    for j, column in enumerate(model.layout.drive_indices("load_friction")):
        expected = np.sign(states[1][:, j]) * abs(torque[:, j])
        assert np.allclose(Y[j, column], expected, rtol=1e-10)
        assert model.layout.units[column] == "1"


def test_a_joint_that_carries_nothing_is_refused_friction_of_the_load():
    # A point mass on the axis puts no load on a joint but for rounding.
    robot = from_modified_dh("arm", [DHRow(0, 0), DHRow(0.3, 0.1)])
    links = tuple(
        replace(link, nominal=InertialParameters.from_central(1.0, c, np.zeros((3, 3))))
        for link, c in zip(robot.links, ([0.1, 0.2, 0.0], [0.0, 0.0, 0.5]), strict=True)
    )
    loaded = DriveTerms(coulomb="sign", load_friction=True)
    with pytest.raises(ProblemError, match="no load on joint2"):
        TorqueModel(replace(robot, links=links), loaded)
    TorqueModel(replace(robot, links=links), (loaded, DriveTerms(coulomb="sign")))


def test_a_joint_is_loaded_even_if_it_undoes_the_motion_of_the_one_before():
    # At equal accelerations the flywheel does not turn, and needs no torque.
    rows = [DHRow(0.0, 0.0), DHRow(np.pi, 0.0)]
    wheel = InertialParameters.from_central(1.0, np.zeros(3), np.diag([0.1, 0.1, 0.2]))
    arm = from_modified_dh("arm", rows)
    arm = replace(arm, links=tuple(replace(x, nominal=wheel) for x in arm.links))
    still = TorqueModel(arm, DriveTerms()).regressor(*np.full((3, 1, 2), 2.0))
    assert abs(still.reshape(2, 20) @ arm.nominal)[1] < 1e-12
    model = TorqueModel(arm, DriveTerms(coulomb="sign", load_friction=True))
    assert model.layout.index("joint2.load_friction") > 0


def test_the_load_may_be_that_of_an_estimate():
    rng = np.random.default_rng(4)
    states = random_states(rng, 3, 5)
    _, robot = random_robot(rng, 3)
    terms = DriveTerms(coulomb="sign", load_friction=True)
    nominal = TorqueModel(robot, terms)
    twice = TorqueModel(robot, terms, load_reference=2.0 * robot.nominal)
    columns = list(nominal.layout.drive_indices("load_friction"))
    one, two = (m.regressor(*states)[:, columns] for m in (nominal, twice))
    assert np.allclose(two, 2.0 * one)
    assert nominal.fingerprint != twice.fingerprint
    nobody = replace(robot, links=tuple(replace(x, nominal=None) for x in robot.links))
    with pytest.raises(ProblemError, match="load_reference"):
        TorqueModel(nobody, terms)


@pytest.mark.parametrize("coulomb", ["sign", "tanh"])
def test_the_casadi_form_has_the_same_columns(coulomb):
    scale = None if coulomb == "sign" else 0.3
    terms = replace(FULL, coulomb=coulomb, velocity_scale=scale)
    states = random_states(np.random.default_rng(5), 3, 6)
    _, model, Y = _columns(terms, states)
    function = casadi_regressor(model)
    for s, state in enumerate(zip(*states, strict=True)):
        found = function(*state).full()
        assert np.allclose(found, Y[:, :, s], rtol=0, atol=1e-12 * abs(Y).max())


def test_the_casadi_forms_derivative_is_that_of_finite_differences():
    import casadi as ca

    _, model, _ = _columns(FULL, random_states(np.random.default_rng(5), 3, 2))
    q, dq, ddq = (x[0] for x in random_states(np.random.default_rng(6), 3, 1))
    Y = casadi_regressor(model)
    rate = ca.SX.sym("dq", 3)
    slope = ca.Function("slope", [rate], [ca.jacobian(ca.vec(Y(q, rate, ddq)), rate)])
    exact, h = slope(dq).full(), 1e-6
    for j, step in enumerate(h * np.eye(3)):
        ahead, back = (Y(q, dq + s, ddq).full().ravel("F") for s in (step, -step))
        # Central differences err by h^2 times third derivatives, some 100 here.
        assert np.allclose(exact[:, j], (ahead - back) / (2 * h), rtol=1e-6, atol=1e-5)


def test_friction_terms_are_named_in_order_and_not_negative():
    _, model, _ = _columns(FULL, random_states(np.random.default_rng(0), 3, 2))
    names = [name for name in model.layout.names if name.startswith("j0.")]
    assert names == [f"j0.{name}" for name in FULL.names]
    labels = NonNegativeDrive().lower(model).in_labels
    assert {f"{name} >= 0" for name in names} <= set(labels)


def test_every_friction_coefficient_is_recovered():
    rng = np.random.default_rng(8)
    table = [DHRow(0, 0), DHRow(-np.pi / 2, 0.1), DHRow(0, 0.4)]
    robot = from_modified_dh("arm", table)
    joints = tuple(
        tuple(Sinusoid(*[rng.uniform(0.2, 0.6)] * 2, f, p) for f, p in terms)
        for terms in rng.uniform(0.1, 1.0, (3, 5, 2))
    )
    motion = SinusoidalMotion(20.0, 200.0, joints).recording(robot.joint_names)
    x = np.concatenate([_bodies(robot), *rng.uniform(0.2, 2.0, (3, len(FULL.names)))])
    model = TorqueModel(robot, FULL, load_reference=_bodies(robot))
    regression = build_regression(model, simulate_torque(model, x, motion))
    found = constrained_least_squares(
        model, regression, constraints=[NonNegativeDrive()]
    )
    exact = ("coulomb_positive", "coulomb_negative", "stribeck", "load_friction")
    for i in (i for term in exact for i in model.layout.drive_indices(term)):
        assert found.parameters[i] == pytest.approx(x[i], rel=1e-3)


def _bodies(robot):
    from consistent_id.robot.scaling import reference_bodies

    return reference_bodies(robot).ravel()


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ({"asymmetric": True}, "asymmetric is True"),
        ({"stribeck_velocity": 0.1}, "stribeck_velocity is 0.1"),
        ({"load_friction": True}, "choose coulomb"),
        ({"coulomb": "sign", "asymmetric": True, "offset": True}, "standstill"),
        ({"coulomb": "sign", "stribeck_velocity": -1.0}, "positive"),
        (
            {"coulomb": "sign", "stribeck_velocity": 1.0, "stribeck_exponent": 0.0},
            "stribeck_exponent is 0",
        ),
    ],
)
def test_friction_that_makes_no_sense_is_refused(terms, message):
    with pytest.raises(ProblemError, match=message):
        DriveTerms(**terms)


def test_a_motor_turns_fast_behind_its_gear():
    # Energy: I_motor (n dq)^2 / 2 = I dq^2 / 2.
    assert Motor(0.00923, -250.0).reflected == pytest.approx(0.00923 * 62500)


@pytest.mark.parametrize("tolerance", [0.0, 0.2])
def test_rotor_inertias_are_held_near_their_datasheets(tolerance):
    model = TorqueModel(
        from_modified_dh("arm", [DHRow(0, 0), DHRow(1, 0)]),
        DriveTerms(rotor_inertia=True),
    )
    held = RotorInertias({"joint2": Motor(1e-4, 100.0)}, tolerance).lower(model)
    x = np.zeros(len(model.layout))
    for value, inside in ((1.0, True), (1.19, tolerance > 0), (0.5, False)):
        x[model.layout.index("joint2.rotor_inertia")] = value
        assert (held.violation(x) < 1e-12) is inside
    with pytest.raises(ProblemError, match="no joint of that name"):
        RotorInertias({"joint9": Motor(1e-4, 100.0)}).lower(model)


FILE = """
name = "arm"
[model]
modified_dh = [{ alpha_deg = 0, a = 0 }, { alpha_deg = 90, a = 0 }]
[constraints]
masses = "free"
rotor_inertia_tolerance = 0.1
[joints.joint2]
viscous = true
coulomb = "tanh"
velocity_scale = 0.05
asymmetric = true
stribeck_velocity = 0.2
rotor_inertia = true
motor_inertia = 1e-4
"""


def test_a_problem_file_chooses_friction_and_motor_joint_by_joint(tmp_path):
    (tmp_path / "problem.toml").write_text(FILE + "gear_ratio = 50\n")
    problem = load_problem(tmp_path)
    assert problem.model.terms[0].names == ()
    assert problem.model.layout.names[20:] == (
        "joint2.viscous",
        "joint2.coulomb_positive",
        "joint2.coulomb_negative",
        "joint2.stribeck",
        "joint2.rotor_inertia",
    )
    (motors,) = [c for c in problem.constraints if isinstance(c, RotorInertias)]
    assert motors == RotorInertias({"joint2": Motor(1e-4, 50.0)}, 0.1)
    (tmp_path / "problem.toml").write_text(FILE)
    with pytest.raises(ProblemError, match="without gear_ratio"):
        load_problem(tmp_path)


def test_friction_that_fades_fast_is_not_overlooked():
    robot = from_modified_dh("arm", [DHRow(0, 0), DHRow(1, 0)])
    drive = DriveTerms(coulomb="sign", stribeck_velocity=1e-5)
    base = base_parameters(TorqueModel(robot, drive))
    assert {"joint1.stribeck", "joint2.stribeck"} <= set(base.names)
