"""Proven torques along a path, against Pinocchio, closed forms and dense samples."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import RestToRest, one_sine, random_path
from robots import random_robot
from some_fast import some_fast

from consistent_id import DHRow, DriveTerms, ProblemError, TorqueModel, from_modified_dh
from consistent_id.motion.limits import MotionLimits
from consistent_id.motion.moves import move_along
from consistent_id.motion.proofs.extremes import Interval
from consistent_id.motion.proofs.margins import motion_margins
from consistent_id.motion.proofs.torque_bounds import (
    PathTorque,
    directed_friction,
    torque_bounds,
)
from consistent_id.motion.proofs.torque_motion import (
    Jet,
    jet,
    sine_and_cosine,
    smooth_torque,
)
from consistent_id.regression.drive.gear_coupling import GearCoupling
from consistent_id.regression.newton_euler import (
    JointMotion,
    floats,
    joint_geometry,
    regressor_entries,
    torque_parts,
)

DENSE = np.linspace(0.0, 10.0, 8001)


def rod(gravity=(0.0, -9.81, 0.0)):
    """A joint about the vertical of its frame, with gravity in its plane."""
    arm = from_modified_dh("rod", [DHRow(0, 0)])
    return replace(arm, gravity=gravity)


def point_mass(mass=2.0, distance=0.5):
    x = np.zeros(10)
    x[[0, 1]] = mass, mass * distance
    x[[6, 9]] = mass * distance**2
    return x


def test_torque_with_known_parameters_is_the_regressor_times_them():
    rng = np.random.default_rng(0)
    _, robot = random_robot(rng, 5, tree=True)
    x = rng.normal(size=(5, 10))
    q, dq, ddq = rng.normal(size=(3, 5))
    motion = [
        JointMotion(*map(float, m), j)
        for j, m in enumerate(zip(q, np.sin(q), np.cos(q), dq, ddq, strict=True))
    ]
    geometry, gravity = joint_geometry(robot), floats(robot.gravity)
    entries = regressor_entries(geometry, gravity, motion)
    parts = torque_parts(geometry, gravity, motion, x.tolist())
    for (j, k, row), (i, link, torque) in zip(entries, parts, strict=True):
        assert (j, k) == (i, link)
        assert np.isclose(np.dot(row, x[k]), torque, rtol=1e-10, atol=1e-12)


def test_a_rod_without_gravity_feels_its_inertia_alone():
    path = one_sine(("joint1",))
    bounds = torque_bounds(path, TorqueModel(rod((0, 0, 0))), point_mass())
    most = 2.0 * 0.25 * (2.0 * np.pi) ** 2
    assert most <= bounds.size[0] <= most * 1.001


def test_a_rod_at_rest_feels_its_weight():
    path = one_sine(("joint1",), sine=[[0.0]], offset=[0.3])
    bounds = torque_bounds(path, TorqueModel(rod()), point_mass())
    weight = 2.0 * 9.81 * 0.5 * np.cos(0.3)
    assert np.allclose([bounds.lowest, bounds.highest], weight, rtol=1e-9)


def test_a_swinging_rod_is_bounded_by_its_equation_of_motion():
    path = one_sine(("joint1",), frequencies=[0.1], duration=10.0)
    bounds = torque_bounds(path, TorqueModel(rod()), point_mass(), tolerance=1e-5)
    q, _, ddq = path.evaluate(DENSE)
    torque = 2.0 * 0.25 * ddq + 2.0 * 9.81 * 0.5 * np.cos(q)
    assert torque.max() <= bounds.highest[0] <= torque.max() * (1.0 + 2e-5)
    assert abs(bounds.lowest[0] - torque.min()) <= 2e-5 * torque.max()


@pytest.mark.slow
@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10**6), st.booleans())
def test_no_torque_of_pinocchio_exceeds_the_bounds(seed, tree):
    rng = np.random.default_rng(seed)
    reference, robot = random_robot(rng, 4, tree=tree)
    path = random_path(seed, robot.joint_names, amplitude=0.2)
    effort = np.full(4, 500.0)
    bounds = torque_bounds(path, TorqueModel(robot), robot.nominal, effort=effort)
    data = reference.createData()
    torque = np.array(
        [
            pin.rnea(reference, data, *state)
            for state in path.evaluate(DENSE[::4]).transpose(1, 0, 2)
        ]
    )
    assert (torque <= bounds.highest + 1e-9).all()
    assert (torque >= bounds.lowest - 1e-9).all()
    assert (bounds.highest - bounds.most <= 0.5).all()
    assert (bounds.least - bounds.lowest <= 0.5).all()


SIGN = DriveTerms(coulomb="sign", viscous=True, rotor_inertia=True)
TANH = DriveTerms(coulomb="tanh", velocity_scale=0.02, offset=True, spring=True)
FRICTION = {
    "sign": SIGN,
    "tanh": TANH,
    "asymmetric": replace(SIGN, asymmetric=True),
    "asymmetric tanh": replace(TANH, offset=False, asymmetric=True),
    "stribeck": replace(SIGN, stribeck_velocity=0.1),
    "stribeck tanh": replace(TANH, stribeck_velocity=0.1, stribeck_exponent=0.7),
    "load": replace(SIGN, load_friction=True),
    "load tanh": replace(TANH, load_friction=True, stribeck_velocity=0.05),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", FRICTION)
@pytest.mark.parametrize("negative", some_fast([True, False]))
def test_friction_of_any_kind_stays_within_bounds_that_are_tight(kind, negative):
    rng = np.random.default_rng(4)
    _, robot = random_robot(rng, 3)
    coupling = GearCoupling("j0", "j2", True, "sign", None, True)
    same = robot.joints[0].kind == robot.joints[2].kind
    model = TorqueModel(robot, FRICTION[kind], (coupling,) if same else ())
    x = np.concatenate([robot.nominal, rng.uniform(0.2, 2.0, len(model.layout) - 30)])
    if negative:  # such as an estimate may have; parts of one sign cancel then
        x[30:] *= rng.choice([-1.0, 1.0], len(x) - 30)
    path = random_path(4, robot.joint_names, amplitude=0.1)
    torque = model.predict(x, *path.evaluate(DENSE))
    effort = abs(torque).max(axis=0)
    bounds = torque_bounds(path, model, x, effort=effort)
    assert (torque.max(axis=0) <= bounds.highest).all()
    assert (torque.min(axis=0) >= bounds.lowest).all()
    assert (bounds.highest <= bounds.most + 1e-3 * effort).all()
    assert (bounds.lowest >= bounds.least - 1e-3 * effort).all()


def test_the_chosen_robot_has_a_coupling():
    _, robot = random_robot(np.random.default_rng(4), 3)
    assert robot.joints[0].kind == robot.joints[2].kind


def test_at_rest_friction_with_a_sign_counts_either_way():
    model = TorqueModel(rod((0, 0, 0)), DriveTerms(coulomb="sign"))
    x = np.append(point_mass(), 3.0)
    path = RestToRest(("joint1",), 0.0, 2.0)
    bounds = torque_bounds(path, model, x)
    # the rod slows down most by 0.5 * 10 / sqrt(3) / 4 against 3 of friction
    assert np.isclose(bounds.lowest[0], -3.0, atol=0.02)
    assert np.isclose(bounds.highest[0], 3.0 + 0.5 * 10.0 / np.sqrt(3) / 4.0, rtol=2e-3)


def test_a_joint_that_never_moves_has_friction_either_way():
    model = TorqueModel(rod((0, 0, 0)), DriveTerms(coulomb="sign"))
    path = one_sine(("joint1",), sine=[[0.0]], offset=[0.3])
    bounds = torque_bounds(path, model, np.append(point_mass(), 3.0))
    assert np.allclose([bounds.highest, -bounds.lowest], 3.0, rtol=1e-9)
    assert np.allclose([bounds.most, -bounds.least], 3.0, rtol=1e-9)


@pytest.mark.slow
def test_of_several_robots_the_worst_counts_and_mixtures_are_no_worse():
    rng = np.random.default_rng(3)
    _, robot = random_robot(rng, 3)
    model = TorqueModel(robot, DriveTerms(viscous=True, coulomb="sign"))
    x = np.concatenate([robot.nominal, np.ones(6)])
    several = x * rng.uniform(0.8, 1.2, (6, len(x)))
    path = random_path(3, robot.joint_names)
    effort = np.full(3, 300.0)
    together = torque_bounds(path, model, several, effort=effort)
    alone = [torque_bounds(path, model, y, effort=effort) for y in several]
    worst = np.max([b.highest for b in alone], axis=0)
    assert np.allclose(together.highest, worst, atol=0.3)
    mixture = rng.dirichlet(np.ones(6)) @ several
    torque = model.predict(mixture, *path.evaluate(DENSE))
    assert (torque <= together.highest).all() and (torque >= together.lowest).all()


@pytest.mark.slow
def test_joints_without_a_torque_have_no_bound():
    _, robot = random_robot(np.random.default_rng(5), 3)
    path = random_path(5, robot.joint_names)
    every = torque_bounds(path, TorqueModel(robot), robot.nominal)
    some = TorqueModel(robot, torque_joints=("j2", "j0"))
    bounds = torque_bounds(path, some, robot.nominal)
    assert bounds.joints == ("j0", "j2")
    assert np.allclose(bounds.highest, every.highest[[0, 2]], rtol=2e-3)


def test_a_torque_that_samples_do_not_show_violates_its_limit():
    path = one_sine(("joint1",))
    model, x = TorqueModel(rod((0, 0, 0))), point_mass()
    limit = 0.99 * 0.5 * (2.0 * np.pi) ** 2
    coarse = path.evaluate(np.arange(6) / 6.0)
    assert abs(model.predict(x, *coarse)).max() < 0.9 * limit
    one = np.ones(1)
    limits = MotionLimits(
        ("joint1",), -9 * one, 9 * one, 99 * one, 999 * one, 9999 * one, limit * one
    )
    margins = motion_margins(path, limits, model=model, parameters=x)
    assert margins.least.quantity == "torque" and margins.least.violated
    assert [m.quantity for m in margins.margins if not m.holds] == ["torque"]
    with pytest.raises(ProblemError, match=r"'joint1': torque limit 19.5.*not kept"):
        margins.require()


def test_the_second_derivative_of_the_torque_never_exceeds_its_bound():
    _, robot = random_robot(np.random.default_rng(6), 5, tree=True)
    path = random_path(6, robot.joint_names)
    torque = smooth_torque(TorqueModel(robot), robot.nominal[None])
    radius, h = 0.01, 1e-4
    middle = np.arange(0.01, 10.0, 0.02)
    bound = torque.curvature(path, middle, radius)
    for s in np.linspace(-0.99, 0.99, 5) * radius:
        before, after = (torque.derivatives(path, middle + s + d)[1] for d in (-h, h))
        second = abs(after - before) / (2.0 * h)
        # central differences of such torques are exact to some 1e-6 of their size
        assert (second <= bound * (1.0 + 1e-4) + 1e-4 * bound.max()).all()


@pytest.mark.slow
def test_each_stretch_holds_all_torques_in_it():
    _, robot = random_robot(np.random.default_rng(8), 4)
    path = random_path(8, robot.joint_names)
    model = TorqueModel(robot, replace(TANH, load_friction=True))
    x = np.concatenate([robot.nominal, np.ones(len(model.layout) - 40)])
    torque = PathTorque(
        path,
        smooth_torque(model, x[None]),
        directed_friction(model, x[None]),
        [*range(4)],
    )
    cells = 150
    radius = 10.0 / (2 * cells)
    middle = radius * np.arange(1, 2 * cells, 2)
    above = torque.enclosure(cells)(middle, radius, np.arange(cells)).above
    inside = [
        model.predict(x, *path.evaluate(middle + s))
        for s in np.linspace(-radius, radius, 21)
    ]
    both = np.hstack([np.max(inside, axis=0), -np.min(inside, axis=0)])
    assert (both <= above).all()
    # and what is left of doubt shrinks with the square of their length
    doubt = np.median(above - both, axis=0)
    radius /= 10.0
    middle = radius * np.arange(1, 20 * cells, 2)
    above = torque.enclosure(10 * cells)(middle, radius, np.arange(10 * cells)).above
    ends = [model.predict(x, *path.evaluate(middle + s)) for s in (-radius, radius)]
    both = np.hstack([np.max(ends, axis=0), -np.min(ends, axis=0)])
    assert (np.median(above - both, axis=0) <= doubt / 30.0).all()


def test_rounding_is_far_below_what_is_told_of_it():
    _, robot = random_robot(np.random.default_rng(7), 5)
    path = random_path(7, robot.joint_names)
    model = TorqueModel(robot)
    torque = smooth_torque(model, robot.nominal[None])
    ours = torque.derivatives(path, DENSE)[0][:, 0]
    other = model.predict(robot.nominal, *path.evaluate(DENSE))
    assert (abs(ours - other) <= torque.rounding(path)).all()
    assert (torque.rounding(path) <= 1e-6 * abs(other).max()).all()


@settings(max_examples=40)
@given(st.lists(st.floats(-3, 3), min_size=4, max_size=4), st.floats(0, 1))
def test_intervals_hold_the_results_for_all_numbers_in_them(ends, share):
    a, b = np.sort(ends[:2]), np.sort(ends[2:])
    x, y = Interval(a[:1], a[1:]), Interval(b[:1], b[1:])
    u, v = (  # rounding may take a sum beyond the end it is to reach
        np.clip(z.low + share * (z.high - z.low), z.low, z.high) for z in (x, y)
    )
    for over, value in (
        (x + y, u + v),
        (2.0 - x, 2.0 - u),
        (x - y, u - v),
        (x * y, u * v),
        (np.full(1, -2.0) * x, -2.0 * u),
        (x / 2.0, u / 2.0),
        (abs(x) ** 0.7, abs(u) ** 0.7),
        (x.sin(), np.sin(u)),
        (x.cos(), np.cos(u)),
        (np.tanh(x), np.tanh(u)),
        (np.exp(x), np.exp(u)),
        (np.sign(x), np.sign(u)),
        (np.arctan(x), np.arctan(u)),
        (np.maximum(x, 0.5), np.maximum(u, 0.5)),
        (x**2, u**2),
        (x**3, u**3),
        (u * x, u * u),
        (1.0 / (1.0 + x**2), 1.0 / (1.0 + u**2)),
        (x.union(y), v),
    ):
        assert (over.low <= value + 1e-12).all()
        assert (value <= over.high + 1e-12).all()


def test_what_intervals_cannot_enclose_is_refused():
    x = Interval(np.array([-1.0]), np.array([2.0]))
    with pytest.raises(ValueError, match="may contain zero"):
        1.0 / x
    with pytest.raises(ValueError, match="negative"):
        x**1.5
    with pytest.raises(TypeError):
        np.sqrt(x)


def test_jets_are_derivatives():
    # x = t^2 - t and sin x, at t = 0.7
    t, h = np.array([0.7]), 1e-4

    def value(t):
        return np.sin(t * t - t) * (t * t - t) - 2.0 * np.cos(t * t - t)

    time = Jet((t, np.ones(1), np.zeros(1)))
    x = time * time - time
    sine, cosine = sine_and_cosine(x)
    found = sine * x - 2.0 * cosine
    first = (value(t + h) - value(t - h)) / (2 * h)
    second = (value(t + h) - 2.0 * value(t) + value(t - h)) / h**2
    expected = [value(t), first, second / 2.0]
    assert np.allclose(found.coefficients, expected, atol=1e-6)
    assert np.allclose(jet([1.0, 2.0, 3.0]).coefficients, [1.0, 2.0, 1.5])


def test_paths_and_parameters_of_other_robots_are_refused():
    model = TorqueModel(rod())
    with pytest.raises(ProblemError, match="expected the same, in order"):
        torque_bounds(one_sine(("elbow",)), model, point_mass())
    with pytest.raises(ProblemError, match="parameters: expected shape"):
        torque_bounds(one_sine(("joint1",)), model, np.ones(9))
    with pytest.raises(ProblemError, match="tolerance is 0"):
        torque_bounds(one_sine(("joint1",)), model, point_mass(), tolerance=0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", some_fast(range(3)))
def test_torques_of_a_move_are_bounded_on_both_sides_of_its_junctions(seed):
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, 2)
    model = TorqueModel(robot, DriveTerms(viscous=True, coulomb="sign"))
    names = robot.joint_names
    path = random_path(seed, names, base=0.2, harmonics=2, amplitude=0.3, duration=5.0)
    wide = np.full(2, 8.0)
    rates = [3.0 * path.derivative_bound(k) for k in range(1, 4)]
    limits = MotionLimits(names, -wide, wide, *rates, np.full(2, np.inf))
    move = move_along(path, limits, from_pose=wide / 4.0, to_pose=-wide / 4.0)
    x = rng.normal(size=len(model.layout))
    x[-4:] = abs(x[-4:])
    found = torque_bounds(move, model, x)
    every = [
        piece.evaluate(piece.start + piece.duration * np.linspace(0.0, 1.0, 1001))
        for piece in move.pieces
    ]
    torque = np.hstack(
        [model.regressor(*values).transpose(0, 2, 1) @ x for values in every]
    )
    slack = 1e-9 * abs(torque).max()
    assert (torque.max(axis=1) <= found.highest + slack).all()
    assert (torque.min(axis=1) >= found.lowest - slack).all()
    assert (found.size <= abs(torque).max(axis=1) * 1.01).all()
