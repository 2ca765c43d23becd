"""Torques for controllers: NumPy, CasADi and C agree with Pinocchio and each other."""

import ctypes
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from estimates import EVERY_TERM, coupling, estimate_of, random_estimate
from robots import random_robot, random_states

from consistent_id import DriveTerms, ProblemError, TorqueModel
from consistent_id.estimation.verdict import Reason, Verdict
from consistent_id.regression import DriveTerm
from consistent_id.regression.drive.laws import AsymmetricCoulomb
from consistent_id.service import ControlModel, control_model

JOINTS = len(EVERY_TERM)
COMPILER = shutil.which("cc")
NEEDS_CC = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler cc")
# Sums of some hundred products of 64-bit floats, relative to the largest torque.
CLOSE = 1e-12


def bare(seed, joints=7):
    """A random tree without drives, and Pinocchio's model of it."""
    reference, robot = random_robot(np.random.default_rng(seed), joints, tree=True)
    bodies = [link.nominal for link in robot.links]
    return reference, estimate_of(TorqueModel(robot), bodies)


def driven(seed=0):
    """A random tree with every drive term that there is, and coupled gears."""
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, JOINTS, tree=True)
    return random_estimate(rng, robot, EVERY_TERM, (coupling(robot),))


def assert_near(found, expected, share=CLOSE):
    expected = np.asarray(expected)
    size = max(abs(expected).max(), 1.0)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=share * size)


def pinocchio_torques(reference, q, dq, ddq):
    """Gravity, bias, torque and mass matrix of one state, by Pinocchio."""
    data, weightless = reference.createData(), reference.copy()
    weightless.gravity.setZero()
    still, units = np.zeros(len(q)), np.eye(len(q))
    columns = [pin.rnea(weightless, data, q, still, unit).copy() for unit in units]
    return (
        pin.computeGeneralizedGravity(reference, data, q).copy(),
        pin.nonLinearEffects(reference, data, q, dq).copy(),
        pin.rnea(reference, data, q, dq, ddq).copy(),
        np.column_stack(columns),
    )


@pytest.mark.parametrize("seed", range(3))
def test_numpy_agrees_with_pinocchio(seed):
    reference, estimate = bare(seed)
    control = control_model(estimate)
    states = random_states(np.random.default_rng(seed), 7, 5)
    expected = [pinocchio_torques(reference, *s) for s in zip(*states, strict=True)]
    gravity, bias, torque, mass = map(np.array, zip(*expected, strict=True))
    assert_near(control.gravity(states[0]), gravity)
    assert_near(control.bias(*states[:2]), bias)
    assert_near(control.torque(*states), torque)
    assert_near(control.mass_matrix(states[0]), mass)


def test_pinocchio_gets_the_same_bodies_and_friction():
    _, estimate = bare(0, 2)
    terms = DriveTerms(viscous=True, coulomb="sign", rotor_inertia=True)
    model = TorqueModel(estimate.model.robot, terms)
    bodies = [link.nominal for link in model.robot.links]
    levels = np.array([[1.0, 0.5, 0.1], [2.0, 0.7, 0.2]])  # viscous, Coulomb, rotor
    control = control_model(estimate_of(model, bodies, levels.ravel()))
    found = control.pinocchio()
    q, dq, ddq = (state[0] for state in random_states(np.random.default_rng(1), 2, 1))
    dq = dq + 9.0 * np.sign(dq)  # dry friction has its level there
    tau = pin.rnea(found, found.createData(), q, dq, ddq)
    tau += found.damping * dq + found.upperDryFrictionLimit * np.sign(dq)
    assert_near(control.torque(q, dq, ddq), tau)


def test_shapes_are_those_of_the_state():
    control = control_model(driven())
    q, dq, ddq = random_states(np.random.default_rng(0), JOINTS, 6)
    one = control.torque(q[0], dq[0], ddq[0])
    assert one.shape == (JOINTS,)
    assert control.mass_matrix(q[0]).shape == (JOINTS, JOINTS)
    three = control.torque(*(x.reshape(2, 3, JOINTS) for x in (q, dq, ddq)))
    assert three.shape == (2, 3, JOINTS)
    assert_near(three[0, 0], one)
    assert_near(control.torque(q[0], dq, ddq)[0], one)  # one pose, many rates


def test_torque_is_the_sum_of_its_parts():
    estimate = driven()
    control = control_model(estimate)
    q, dq, ddq = random_states(np.random.default_rng(1), JOINTS, 6)
    parts = np.einsum("sij,sj->si", control.mass_matrix(q), ddq)
    parts += control.bias(q, dq) + control.springs(q) + control.friction(dq, q)
    assert_near(control.torque(q, dq, ddq), parts)
    # Without friction by load, and where friction is not widened, the identified one.
    wide = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.1, offset=True)
    model = TorqueModel(estimate.model.robot, wide)
    bodies = [link.nominal for link in model.robot.links]
    plain = estimate_of(model, bodies, 0.7)
    narrow = control_model(plain, friction_velocity=0.05)
    assert_near(narrow.torque(q, dq, ddq), model.predict(plain.parameters, q, dq, ddq))


@pytest.mark.parametrize("velocity", [0.05, 0.5])
def test_friction_is_smooth_at_rest_and_at_most_what_was_identified(velocity):
    estimate = driven(2)
    control = control_model(estimate, friction_velocity=velocity)
    x = estimate.parameters
    # Friction that differs by direction is dry: it has its level as soon as it moves.
    drive = [
        DriveTerms(terms=[AsymmetricCoulomb(None)]) if terms.asymmetric else terms
        for terms in estimate.model.terms
    ]
    model = replace(estimate.model, drive=tuple(drive))
    q = np.tile(random_states(np.random.default_rng(0), JOINTS, 1)[0], (401, 1))
    for j in range(JOINTS):  # one joint moves: friction of coupled gears is apart
        dq = np.zeros_like(q)
        dq[:, j] = np.linspace(-2.0, 2.0, 401)
        found = control.friction(dq, q)[:, j]
        # Springs and offsets are in both: they have the middle of two levels.
        identified = model.predict(x, q, dq, np.zeros_like(q))[:, j]
        sent = (control.bias(q, dq) + control.springs(q))[:, j] + found
        if not model.terms[j].needs_load:  # its load is that at rest
            sign = np.sign(dq[:, j])
            assert (sent * sign <= identified * sign + 1e-9).all()
        assert (found * dq[:, j] >= -1e-12).all()
        assert found[200] == 0.0
        # Per step of 0.01 rad/s: the slope of tanh at most, and viscous coefficients
        # of up to 2. Stribeck friction may have a level at rest that no rate shows.
        slope = 1.5 * abs(found).max() / velocity + 4.0
        assert abs(np.diff(found)).max() < 0.01 * slope


def test_friction_that_differs_by_direction_has_its_middle_at_rest():
    _, estimate = bare(0, 2)
    terms = DriveTerms(coulomb="sign", asymmetric=True)
    model = TorqueModel(estimate.model.robot, terms)
    bodies = [link.nominal for link in model.robot.links]
    found = estimate_of(model, bodies, [3.0, 1.0, 2.0, 2.0])  # positive, negative
    control = control_model(found, friction_velocity=0.1)
    q, dq = np.zeros((3, 2)), np.array([[-9.0, -9.0], [0.0, 0.0], [9.0, 9.0]])
    sent = control.springs(q) + control.friction(dq)
    np.testing.assert_allclose(sent[:, 0], [-1.0, 1.0, 3.0], atol=1e-12)
    np.testing.assert_allclose(sent[:, 1], [-2.0, 0.0, 2.0], atol=1e-12)


def test_compensated_friction_has_no_jump_where_the_identified_one_has():
    _, estimate = bare(0, 2)
    model = TorqueModel(estimate.model.robot, DriveTerms(coulomb="sign"))
    bodies = [link.nominal for link in model.robot.links]
    control = control_model(estimate_of(model, bodies, 3.0), friction_velocity=0.1)
    dq = np.array([-1.0, -0.1, -1e-6, 0.0, 1e-6, 0.1, 1.0])
    found = control.friction(np.column_stack([dq, 0.0 * dq]))
    np.testing.assert_allclose(found[:, 0], 3.0 * np.tanh(dq / 0.1), rtol=1e-12)
    assert not found[:, 1].any()


@pytest.mark.slow
def test_casadi_is_the_same():
    control = control_model(driven(1), friction_velocity=0.3)
    functions = control.casadi()
    q, dq, ddq = random_states(np.random.default_rng(1), JOINTS, 3)
    for k in range(3):
        at = q[k], dq[k], ddq[k]
        for found, expected in (
            (functions.gravity(at[0]), control.gravity(at[0])),
            (functions.bias(*at[:2]), control.bias(*at[:2])),
            (functions.springs(at[0]), control.springs(at[0])),
            (functions.friction(*at[:2]), control.friction(at[1], at[0])),
            (functions.torque(*at), control.torque(*at)),
        ):
            assert_near(np.array(found).ravel(), expected)
        assert_near(np.array(functions.mass_matrix(at[0])), control.mass_matrix(at[0]))


def compiled(control, folder, name):
    """Compile source and header together, and load the library."""
    source = control.c(name=name).save(folder / f"{name}.c")
    user = folder / "user.c"
    # A declaration that does not fit its definition is an error.
    user.write_text(f'#include "{name}.h"\n#include "{name}.c"\n#include "{name}.h"\n')
    library = folder / f"{name}.so"
    strict = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-Wno-unused-parameter"]
    subprocess.run(
        [COMPILER, *strict, "-shared", "-fPIC", "-o", library, user, "-lm"], check=True
    )
    assert source.with_suffix(".h").exists()
    return ctypes.CDLL(str(library))


def call(library, name, size, *arguments):
    out = (ctypes.c_double * size)()
    vectors = [(ctypes.c_double * len(x))(*x) for x in arguments]
    getattr(library, name)(*vectors, out)
    return np.array(out)


@pytest.mark.slow
@NEEDS_CC
def test_compiled_c_agrees_with_pinocchio(tmp_path):
    reference, estimate = bare(3)
    library = compiled(control_model(estimate), tmp_path, "arm")
    for state in zip(*random_states(np.random.default_rng(3), 7, 5), strict=True):
        gravity, bias, torque, mass = pinocchio_torques(reference, *state)
        assert_near(call(library, "arm_gravity", 7, state[0]), gravity)
        assert_near(call(library, "arm_bias", 7, *state[:2]), bias)
        assert_near(call(library, "arm_torque", 7, *state), torque)
        assert_near(call(library, "arm_inverse_dynamics", 7, *state), torque)
        found = call(library, "arm_mass_matrix", 49, state[0]).reshape(7, 7)
        assert_near(found, mass)
        assert not call(library, "arm_friction", 7, *state[:2]).any()
        assert not call(library, "arm_springs", 7, state[0]).any()


@pytest.mark.slow
@NEEDS_CC
def test_compiled_c_has_every_drive_term(tmp_path):
    control = control_model(driven(2), friction_velocity=0.2)
    library = compiled(control, tmp_path, "tree")
    for q, dq, ddq in zip(
        *random_states(np.random.default_rng(2), JOINTS, 4), strict=True
    ):
        found = call(library, "tree_friction", JOINTS, q, dq)
        assert_near(found, control.friction(dq, q))
        assert_near(call(library, "tree_springs", JOINTS, q), control.springs(q))
        found = call(library, "tree_torque", JOINTS, q, dq, ddq)
        assert_near(found, control.torque(q, dq, ddq))


@pytest.mark.slow
@NEEDS_CC
@pytest.mark.skipif(shutil.which("nm") is None, reason="there is no nm")
def test_c_calls_functions_of_mathematics_alone(tmp_path):
    source = control_model(driven()).c(name="tree").save(tmp_path / "tree.c")
    binary = tmp_path / "tree.o"
    subprocess.run([COMPILER, "-std=c99", "-c", "-o", binary, source], check=True)
    listed = subprocess.run(
        ["nm", "-u", binary], check=True, capture_output=True, text=True
    ).stdout
    called = {line.split()[-1] for line in listed.splitlines() if line.strip()}
    called -= {"_GLOBAL_OFFSET_TABLE_"}
    assert "sin" in called
    assert called <= {"sin", "cos", "tanh", "exp", "pow", "fabs", "sqrt"}


class Rough(DriveTerm):
    """Dry friction that is not smooth and has no stand-in."""

    names, unit = ("rough",), ("N m", "N")

    def columns(self, joint):
        """Return the sign."""
        return [np.sign(joint.dq)]


def test_a_law_that_is_not_smooth_is_left_out_and_named():
    _, estimate = bare(0, 2)
    terms = DriveTerms(viscous=True, terms=[Rough()])
    model = TorqueModel(estimate.model.robot, terms)
    bodies = [link.nominal for link in model.robot.links]
    control = control_model(estimate_of(model, bodies, 2.0))
    names = [f"{joint}.rough" for joint in model.robot.joint_names]
    assert list(control.left_out) == names
    rates = np.array([0.3, -0.2])
    np.testing.assert_allclose(control.friction(rates, 0.0 * rates), 2.0 * rates)
    assert names[0] in control.c().notes[0]


@pytest.mark.slow
def test_what_cannot_be_computed_is_refused():
    control = control_model(driven())
    with pytest.raises(ProblemError, match=r"load_friction.*give q"):
        control.friction(np.zeros(JOINTS))
    with pytest.raises(ProblemError, match=rf"shape \(3,\), expected .*{JOINTS}"):
        control.gravity(np.zeros(3))
    with pytest.raises(ProblemError, match="expected finite numbers"):
        control.gravity(np.full(JOINTS, np.nan))
    for wrong in (0.0, [0.1, 0.2], -1.0, np.inf):
        with pytest.raises(ProblemError, match="expected one positive number"):
            control_model(driven(), friction_velocity=wrong)


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        (["a"] * JOINTS, "could not convert string"),
        ([[1.0], [2.0, 3.0]], "inhomogeneous"),
        (np.full(JOINTS, 1j), "complex numbers"),
        (None, r"shape \(\)"),
        ([[0.0] * JOINTS, [np.nan] * JOINTS], "the state of .* is nan"),
        ([-np.inf] * JOINTS, "the state of .* is -inf"),
    ],
)
def test_a_state_that_is_no_array_of_numbers_is_refused(wrong, why):
    with pytest.raises(ProblemError, match=rf"{why}.*expected finite numbers"):
        control_model(driven()).gravity(wrong)


@pytest.mark.slow
def test_states_of_other_numbers_of_samples_and_words_as_widths_are_refused():
    control = control_model(driven())
    with pytest.raises(ProblemError, match="the same number of samples"):
        control.bias(np.zeros((3, JOINTS)), np.zeros((2, JOINTS)))
    with pytest.raises(ProblemError, match="expected one positive number"):
        control_model(driven(), friction_velocity="slow")


def test_no_door_leads_around_the_verdict():
    reason = Reason("misfit", "do not use", "it does not fit", "check units")
    verdict = Verdict("do not use", "constrained", (reason,))
    refused = replace(driven(), judged=verdict)
    for door in (control_model, ControlModel):
        with pytest.raises(ProblemError, match="it does not fit"):
            door(refused)
    assert control_model(refused, allow_refused=True).c().content
