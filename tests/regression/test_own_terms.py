"""Laws of one's own: fitted, designed with, proven and exported, or refused."""

import json
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from estimates import random_estimate
from paths import random_path
from robots import random_robot, random_states

from consistent_id import (
    DHRow,
    DriveTerms,
    MotionLimits,
    NonNegativeDrive,
    PathForm,
    ProblemError,
    TorqueModel,
    build_regression,
    constrained_least_squares,
    design_trajectory,
    from_modified_dh,
    simulate_torque,
    to_urdf,
)
from consistent_id.estimation import fit_shapes
from consistent_id.export import robot_record, to_casadi, to_json, to_numpy
from consistent_id.motion.proofs.torque_bounds import torque_bounds
from consistent_id.regression import (
    DriveTerm,
    ShapeParameter,
    casadi_regressor,
    with_shapes,
)
from consistent_id.regression.drive.laws import (
    AsymmetricCoulomb,
    Coulomb,
    LoadFriction,
    Offset,
    Stribeck,
    Viscous,
)
from consistent_id.regression.drive.term import term_columns

ARM = from_modified_dh("arm", [DHRow(0, 0), DHRow(-np.pi / 2, 0.3)])
MASSES = np.array([[1.0, 0.1, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1]] * 2)
ONES = np.ones(2)
LIMITS = MotionLimits(
    ARM.joint_names, -2 * ONES, 2 * ONES, 3 * ONES, 10 * ONES, 200 * ONES, 40 * ONES
)


@dataclass(frozen=True)
class Cogging(DriveTerm):
    """Two waves of the position, of one period."""

    names = ("cogging_sine", "cogging_cosine")
    unit = ("N m", "N")
    smooth = True
    friction = False
    shape_parameters = {"period": ShapeParameter(("rad", "m"), 0.2, 2.0)}  # noqa: RUF012

    period: float = 0.5

    def columns(self, joint):
        phase = joint.q * (2.0 * np.pi / self.period)
        return [np.sin(phase), np.cos(phase)]


class Dry(DriveTerm):
    """Dry friction that a joint has on one side alone: a jump in the rate."""

    names, unit, nonnegative = ("dry",), ("N m", "N"), True

    def columns(self, joint):
        return [np.sign(joint.dq) * np.maximum(joint.q, 0.0)]


class Rounded(Dry):
    """The same, with a stand-in for designs."""

    def smoothed(self, velocity):
        return Slope(velocity)


@dataclass(frozen=True)
class Slope(DriveTerm):
    """The stand-in."""

    velocity: float
    names, unit, smooth = ("dry",), ("N m", "N"), True

    def columns(self, joint):
        return [np.tanh(joint.dq / self.velocity) * np.maximum(joint.q, 0.0)]


class Gate(DriveTerm):
    """Drag in one direction, by a comparison that intervals do not know."""

    names, unit, smooth = ("gate",), ("N m s^2/rad^2", "N s^2/m^2"), True

    def columns(self, joint):
        return [np.where(joint.dq > 0.0, joint.dq**2, 0.0)]


class Branch(DriveTerm):
    """A choice in Python, which only arrays can make."""

    names, unit, smooth = ("branch",), ("N m", "N"), True

    def columns(self, joint):
        return [np.array([1.0 if rate > 0.0 else 0.0 for rate in joint.dq])]


def parameters(model):
    size = len(model.layout) - MASSES.size
    return np.append(MASSES, np.linspace(0.3, 0.9, size))


def designed(term, **options):
    model = TorqueModel(ARM, DriveTerms(viscous=True, terms=[term]))
    options = {"limits": LIMITS, "starts": 1, "workers": 1} | options
    return design_trajectory(model, PathForm(5.0, 2), **options)


@pytest.mark.parametrize("term", [Cogging(), Dry(), Gate(), Branch()])
def test_coefficients_of_own_terms_are_recovered(term):
    model = TorqueModel(ARM, DriveTerms(viscous=True, terms=[term]))
    x = parameters(model)
    motion = random_path(1, ARM.joint_names).recording(100.0)
    regression = build_regression(model, simulate_torque(model, x, motion))
    found = constrained_least_squares(
        model, regression, constraints=[NonNegativeDrive()]
    )
    for name in term.names:
        place = model.layout.index(f"joint2.{name}")
        assert found.parameters[place] == pytest.approx(x[place], rel=1e-3)
    signed = {f"joint{k}.dry >= 0" for k in (1, 2)} if type(term) is Dry else set()
    viscous = {"joint1.viscous >= 0", "joint2.viscous >= 0"}
    assert set(NonNegativeDrive().lower(model).in_labels) == viscous | signed


def test_the_shape_of_an_own_term_is_found():
    model = TorqueModel(ARM, DriveTerms(viscous=True, terms=[Cogging(0.7)]))
    motion = random_path(1, ARM.joint_names).recording(50.0)
    rng = np.random.default_rng(0)
    log = simulate_torque(model, parameters(model), motion, noise=0.01, rng=rng)
    names = ("joint1.period", "joint2.period")
    guess = with_shapes(model, dict.fromkeys(names, 0.6))
    found = fit_shapes(guess, log, starts=1)
    assert found["period"].value == pytest.approx(0.7, rel=1e-3)
    assert found["period"].unit == "rad"
    assert found.misfits == (1.0,)
    assert found.model.terms[0].terms[-1].period == found["period"].value


@pytest.mark.slow
def test_exports_write_an_own_term_or_name_it():
    rng = np.random.default_rng(2)
    _, robot = random_robot(rng, 3)
    drive = DriveTerms(viscous=True, terms=[Cogging(), Dry(), Gate()])
    estimate = random_estimate(rng, robot, DriveTerms(terms=drive.terms[:-1]))
    states = random_states(rng, 3, 5)
    expected = estimate.model.predict(estimate.parameters, *states)
    names: dict = {}
    exec(compile(str(to_numpy(estimate)), "robot.py", "exec"), names)
    assert np.allclose(names["inverse_dynamics"](*states), expected, rtol=1e-12)
    function = to_casadi(estimate).inverse_dynamics
    for tau, *state in zip(expected, *states, strict=True):
        assert np.allclose(function(*state).full().ravel(), tau, rtol=1e-12)
    notes = " ".join(to_urdf(estimate).notes)
    assert all(f"URDF has no {name}: " in notes for name in ("dry", *Cogging.names))
    record = robot_record(estimate)["drives"]["j0"]
    assert record == json.loads(str(to_json(estimate)))["drives"]["j0"]
    assert record["shapes"] == {"period": 0.5}
    assert record["terms"]["dry"]["unit"] in ("N", "N m")
    with pytest.raises(ProblemError, match=r"Gate \(gate\).*source text"):
        to_numpy(random_estimate(rng, robot, drive))


@pytest.mark.parametrize("term", [Cogging(), Dry(), Rounded()])
def test_the_proven_torque_of_an_own_term_holds_and_is_tight(term):
    model = TorqueModel(ARM, DriveTerms(viscous=True, terms=[term]))
    x = parameters(model)
    path = random_path(4, ARM.joint_names, amplitude=0.1)
    torque = model.predict(x, *path.evaluate(np.linspace(0.0, 10.0, 8001)))
    effort = abs(torque).max(axis=0)
    bounds = torque_bounds(path, model, x, effort=effort)
    assert (torque.max(axis=0) <= bounds.highest).all()
    assert (torque.min(axis=0) >= bounds.lowest).all()
    assert (bounds.highest <= bounds.most + 1e-3 * effort).all()


@pytest.mark.slow
@pytest.mark.parametrize("term", [Cogging(), Rounded()])
def test_a_smooth_term_or_one_with_a_stand_in_is_designed_with(term):
    model = TorqueModel(ARM, DriveTerms(viscous=True, terms=[term]))
    design = designed(term, parameters=parameters(model))
    design.proof.require()


def test_a_term_that_jumps_is_refused_by_a_design_with_the_reason():
    with pytest.raises(ProblemError, match=r"Dry \(dry\) is not smooth.*smoothed"):
        designed(Dry())


def test_a_term_without_casadi_columns_is_refused_by_a_design_with_the_reason():
    with pytest.raises(ProblemError, match=r"Branch \(branch\).*CasADi expressions"):
        designed(Branch())
    with pytest.raises(ProblemError, match=r"Branch \(branch\)"):
        casadi_regressor(TorqueModel(ARM, DriveTerms(terms=[Branch()])))


@pytest.mark.slow
def test_what_cannot_be_enclosed_is_refused_where_its_torque_is_to_be_proven():
    model = TorqueModel(ARM, DriveTerms(viscous=True, terms=[Gate()]))
    x = parameters(model)
    path = random_path(4, ARM.joint_names, amplitude=0.1)
    with pytest.raises(ProblemError, match=r"Gate \(gate\).*intervals, which proofs"):
        torque_bounds(path, model, x)
    with pytest.raises(ProblemError, match=r"intervals, which proofs"):
        designed(Gate(), parameters=x)
    without = designed(Gate(), limits=replace(LIMITS, effort=np.inf * ONES))
    without.proof.require()
    frictionless = np.append(MASSES, np.zeros(4))  # such as the nominal robot has
    assert torque_bounds(path, model, frictionless).size.min() > 0.0


class Short(Dry):
    """Two names, one column."""

    names = ("one", "two")


class Infinite(Dry):
    """No number at rest."""

    def columns(self, joint):
        return [1.0 / joint.dq]


class Long(Dry):
    """A column that does not go with the samples."""

    def columns(self, joint):
        return [np.zeros(7)]


class Nameless(DriveTerm):
    """No names."""

    unit = ("N m", "N")

    def columns(self, joint):
        return []


class OneUnit(Dry):
    """One unit for both kinds of joints."""

    unit = ("N m",)


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ([Short()], "Short has 1 columns, but names 2"),
        ([Infinite()], "column dry of Infinite"),
        ([Long()], "three finite numbers"),
        ([Nameless()], r"Nameless\.names is None"),
        ([OneUnit()], "expected two units"),
        ([Cogging(-1.0)], "period is -1.0, expected a positive number"),
        ([Cogging(), Cogging(0.3)], "named 'cogging_sine'"),
        (["viscous"], "'viscous' is no drive term"),
        ([Dry], "is no drive term"),
    ],
)
def test_terms_that_are_none_are_refused_at_once(terms, message):
    with pytest.raises(ProblemError, match=message):
        DriveTerms(terms=terms)


def test_keywords_change_the_terms_they_know_and_keep_the_others():
    drive = DriveTerms(viscous=True, terms=[Cogging()])
    assert drive.names == ("viscous", *Cogging.names)
    assert replace(drive, offset=True).names == ("viscous", "offset", *Cogging.names)
    assert replace(drive, viscous=False) == DriveTerms(terms=[Cogging()])
    assert drive.viscous is True and drive.offset is False
    assert repr(drive) == "DriveTerms(terms=(Viscous(), Cogging(period=0.5)))"
    with pytest.raises(ProblemError, match="no drive term 'viscuous'; known: viscous"):
        DriveTerms(viscuous=True)
    with pytest.raises(AttributeError, match="viscuous"):
        _ = drive.viscuous


def test_known_laws_may_be_given_as_terms_too():
    assert DriveTerms(terms=[Viscous(), Coulomb(0.1)]) == DriveTerms(
        viscous=True, coulomb="tanh", velocity_scale=0.1
    )
    assert DriveTerms(terms=[Offset()], spring=True).names == ("offset", "spring")
    alone = DriveTerms(terms=[Stribeck(0.1), Viscous()])  # as no keywords choose
    assert alone.names == ("stribeck", "viscous")
    assert repr(alone).startswith("DriveTerms(terms=(Stribeck(")
    mixed = DriveTerms(terms=[Coulomb(0.3), LoadFriction()])
    assert "LoadFriction(velocity_scale=None)" in repr(mixed)
    for terms in (alone.terms, mixed.terms):
        with pytest.raises(ProblemError, match="give all of them in terms"):
            DriveTerms(terms=terms, offset=True)
    with pytest.raises(ProblemError, match="standstill"):
        DriveTerms(terms=[AsymmetricCoulomb(), Offset()])
    with pytest.raises(ProblemError, match=r"velocity_scale is 0\.3 in one"):
        DriveTerms(terms=[Coulomb(0.3), LoadFriction(0.2)])


@pytest.mark.parametrize(
    ("values", "options"), [((True,), {"viscous": False}), ((False,) * 13, {})]
)
def test_options_given_twice_or_without_a_place_are_refused(values, options):
    with pytest.raises(ProblemError, match="once at most"):
        DriveTerms(*values, **options)


def test_what_the_keywords_choose_is_written_as_before():
    """Fingerprints, and what was named by them, stay the same."""
    assert repr(DriveTerms(True, "tanh", 0.02)) == (
        "DriveTerms(viscous=True, coulomb='tanh', velocity_scale=0.02, offset=False, "
        "rotor_inertia=False, spring=False, asymmetric=False, stribeck_velocity=None, "
        "stribeck_exponent=2.0, load_friction=False)"
    )
    drive = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True)
    arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(-np.pi / 2, 0)])
    assert TorqueModel(arm, drive).fingerprint == "328f7b2037995261"


def test_a_term_that_fails_is_refused_with_the_first_line_of_its_reason():
    class Broken(Viscous):
        def columns(self, joint):
            raise ValueError("no speed here\nand more")

    with pytest.raises(ProblemError, match=r"\(ValueError: no speed here\)"):
        term_columns(Broken(), SimpleNamespace(dq=1.0))
