"""Base parameters: published counts, closed forms and Pinocchio are the truth."""

import numpy as np
import pinocchio as pin
import pytest
from experiments import experiment
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import random_robot, random_states

from consistent_id import (
    Recording,
    build_regression,
    differentiated,
    least_squares,
    simulate_torque,
)
from consistent_id.errors import NotExcitedError, ProblemError
from consistent_id.regression.base import (
    BaseParameters,
    base_parameters,
    condition_number,
    excitation_of,
    linear_combination,
)
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.linear import (
    _readable,
    independent_columns,
    split_at_gap,
)
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.loaders import DHRow, from_modified_dh

RIGHT, DOWN, ALONG_Y = np.pi / 2, (0.0, 0.0, -9.81), (0.0, -9.81, 0.0)


def arm(quarter_turns, lengths, offsets):
    rows = zip(quarter_turns, lengths, offsets, strict=True)
    return [DHRow(turns * RIGHT, a, d) for turns, a, d in rows]


UR10 = arm((0, 1, 0, 0, 1, -1), (0, 0, -0.6, -0.57, 0, 0), (0.1, 0, 0, 0.2, 0.1, 0.1))
PUMA = arm((0, -1, 0, -1, 1, -1), (0, 0, 0.43, 0.02, 0, 0), (0, 0.2, -0.1, 0.4, 0, 0))
PANDA = arm(
    (0, -1, 1, 1, -1, 1, 1), (0, 0, 0, 0.1, -0.1, 0, 0.1), (0.3, 0, 0.3, 0, 0.4, 0, 0)
)
# Seeds explicit: hypothesis derives its examples from the test's own source.
REPEATABLE = settings(derandomize=True, deadline=None, max_examples=50)
SERIAL_AND_TREES = [(1, 0, 1), (4, 0, 2), (7, 0, 3), (4, 1, 4), (7, 1, 5)]


def base_of(table, gravity=DOWN, drive=None):
    robot = from_modified_dh("arm", table, gravity=gravity)
    return base_parameters(TorqueModel(robot, drive or DriveTerms()))


def pinocchio_regressor(model, q, dq, ddq):
    """Rows of all samples stacked, shape (samples x joints, 10 links)."""
    data, build = model.createData(), pin.computeJointTorqueRegressor
    states = zip(q, dq, ddq, strict=True)
    return np.vstack([build(model, data, *state).copy() for state in states])


@pytest.mark.parametrize(("table", "count"), [(UR10, 36), (PUMA, 36), (PANDA, 43)])
def test_industrial_arms_have_the_published_number_of_base_parameters(table, count):
    # Mayeda, Yoshida & Osuka 1990: 7 n - 4 b - 2 with gravity along the first axis, to
    # which the first b = 1 axes are parallel, and 7 n - 4 b otherwise.
    assert len(base_of(table)) == count
    assert len(base_of(table, gravity=(1.0, 2.0, -9.0))) == count + 2


@pytest.mark.parametrize("joints", [1, 2, 3, 5])
def test_planar_arms_have_three_base_parameters_per_link(joints):
    table = [DHRow(0, 0), *[DHRow(0, 0.3)] * (joints - 1)]
    assert len(base_of(table, ALONG_Y)) == 3 * joints
    assert len(base_of(table, DOWN)) == 3 * joints - 2  # gravity does no work


def test_a_planar_2r_arm_groups_the_second_mass_as_in_the_textbook():
    base = base_of([DHRow(0, 0), DHRow(0, 0.5)], ALONG_Y)
    assert ", ".join(base.groupings) == (
        "link1.hx + 0.5 link2.m, link1.hy, link1.Izz + 0.25 link2.m, "
        "link2.hx, link2.hy, link2.Izz"
    )
    unseen = [f"link{k}.{i}" for k in (1, 2) for i in "hz Ixx Ixy Iyy Ixz Iyz".split()]
    assert base.without_effect == ("link1.m", *unseen)


def test_an_elbow_with_crossing_axes_is_grouped_as_its_energy_says():
    # Link 2 turns with (s w1, c w1, w2): 2 T = Izz1 w1^2 + (s^2 Ixx2 + 2 s c Ixy2
    # + c^2 Iyy2) w1^2 + Izz2 w2^2 + 2 (s Ixz2 + c Iyz2) w1 w2, with s^2 = 1 - c^2.
    base = base_of([DHRow(0, 0), DHRow(-RIGHT, 0)])
    assert ", ".join(base.groupings) == (
        "link1.Izz + link2.Iyy, link2.hx, link2.hy, link2.Ixx - link2.Iyy, "
        "link2.Ixy, link2.Ixz, link2.Iyz, link2.Izz"
    )
    assert set(base.projection.ravel()) == {-1.0, 0.0, 1.0}  # no rounding left


def test_a_vertical_slider_cannot_tell_rotor_inertia_from_mass_and_offset():
    # f = m (ddq + g) + offset + rotor ddq, and ddq = (ddq + g) - g.
    drive = DriveTerms(viscous=True, coulomb="sign", offset=True, rotor_inertia=True)
    base = base_of([DHRow(0, 0, kind="prismatic")], DOWN, drive)
    assert ", ".join(base.groupings) == (
        "link1.m + joint1.rotor_inertia, joint1.viscous, joint1.coulomb, "
        "joint1.offset - 9.81 joint1.rotor_inertia"
    )


def test_friction_adds_its_columns_and_rotors_all_but_the_first_two():
    # Axis 2 is normal to axis 1: the energy of Izz1 is that of w1, of Izz2 that of w2.
    friction = DriveTerms(viscous=True, coulomb="sign", offset=True)
    assert len(base_of(PUMA, drive=friction)) == 36 + 3 * 6
    base = base_of(PUMA, drive=DriveTerms(rotor_inertia=True))
    assert len(base) == 40
    for k in (1, 2):
        group = base.groupings[base.names.index(f"link{k}.Izz")]
        assert group.endswith(f" + joint{k}.rotor_inertia")


@pytest.mark.slow
@pytest.mark.parametrize(("joints", "tree", "seed"), SERIAL_AND_TREES)
def test_base_columns_span_pinocchios_regressor_and_are_independent(joints, tree, seed):
    rng = np.random.default_rng(seed)
    for _ in range(5):
        model, robot = random_robot(rng, joints, tree=tree)
        base = base_parameters(TorqueModel(robot))
        W = pinocchio_regressor(model, *random_states(rng, joints, 30 * joints))
        # Dependent directions are 1e-13 of the largest, the weakest true one 1e-5.
        assert np.linalg.matrix_rank(W, rtol=1e-10) == len(base)
        assert sorted(base.independent + base.dependent) == list(range(10 * joints))
        error = W[:, base.dependent] - W[:, base.independent] @ base.regrouping
        assert abs(error).max() < 1e-10 * abs(W).max()  # rounding, times cond(W_ind)


@pytest.mark.parametrize(("joints", "tree", "seed"), SERIAL_AND_TREES)
def test_pinocchios_torque_depends_on_base_parameters_alone(joints, tree, seed):
    rng = np.random.default_rng(seed)
    model, robot = random_robot(rng, joints, tree=tree)
    base = base_parameters(TorqueModel(robot))
    x = np.concatenate([i.toDynamicParameters() for i in model.inertias[1:]])
    step = rng.normal(size=len(x))
    unseen = step - base.lift(base.projection @ step)
    moved = x + 0.1 * unseen / abs(unseen).max()  # masses stay away from zero
    other = model.copy()
    for k, ten in enumerate(moved.reshape(-1, 10), start=1):
        other.inertias[k] = pin.Inertia.FromDynamicParameters(ten)
    for state in zip(*random_states(rng, joints, 10), strict=True):
        truth, torque = (pin.rnea(m, m.createData(), *state) for m in (model, other))
        # Rounding of K and of Pinocchio's own h / m.
        assert abs(torque - truth).max() < 1e-9 * abs(truth).max()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_other_random_motions_give_the_same_base_parameters(seed):
    rng = np.random.default_rng(seed)
    robot = from_modified_dh("arm", UR10) if seed == 1 else random_robot(rng, 5)[1]
    model = TorqueModel(robot, DriveTerms(viscous=True, offset=True))
    first = base_parameters(model)
    assert (base_parameters(model).regrouping == first.regrouping).all()
    other = base_parameters(model, seed=seed)
    assert other.independent == first.independent
    # Rounding, times the condition of the independent columns, up to 1e5.
    np.testing.assert_allclose(other.regrouping, first.regrouping, atol=1e-9)


def test_the_lift_is_the_smallest_vector_with_these_base_parameters():
    base, rng = base_of(PANDA), np.random.default_rng(7)
    wanted = rng.normal(size=len(base))
    lifted = base.lift(wanted)
    smallest = np.linalg.pinv(base.projection) @ wanted
    # cond(P P^T) is near 10; 1e-12 is rounding.
    np.testing.assert_allclose(lifted, smallest, atol=1e-12)
    np.testing.assert_allclose(base.projection @ lifted, wanted, atol=1e-12)


def test_base_parameters_check_and_freeze_their_map():
    base = base_of([DHRow(0, 0)], ALONG_Y)
    assert base.names == ("link1.hx", "link1.hy", "link1.Izz") and len(base) == 3
    with pytest.raises(ValueError, match="read-only"):
        base.regrouping[0] = 1.0
    with pytest.raises(ProblemError, match=r"regrouping: expected shape \(3, 7\)"):
        BaseParameters(base.layout, base.independent, base.dependent, np.eye(3))


@pytest.mark.slow
@REPEATABLE
@given(st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 6))
def test_columns_are_split_from_left_to_right_whatever_their_scale(seed, rows, columns):
    rng = np.random.default_rng(seed)
    C = rng.integers(-1, 2, (rows, columns))
    ranks = [0, *(np.linalg.matrix_rank(C[:, : k + 1]) for k in range(columns))]
    rising = np.diff(ranks) > 0
    s = 10.0 ** rng.integers(-3, 4, columns)
    Q = np.linalg.qr(rng.normal(size=(9, rows))).Q
    independent, dependent, K = independent_columns(Q @ C * s)
    assert independent == tuple(np.flatnonzero(rising))
    assert dependent == tuple(np.flatnonzero(~rising))
    truth = np.linalg.pinv(C[:, rising]) @ C[:, ~rising]
    # Rounding: four columns of -1, 0 and 1 have a condition number below 20.
    K = K * s[rising, None] / s[~rising]
    np.testing.assert_allclose(K, truth, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("distance", "counts"), [(2e-9, True), (0.5e-9, False)])
def test_a_column_within_the_tolerance_of_the_others_is_dependent(distance, counts):
    W = np.array([[1.0, 5.0], [0.0, 5.0 * distance]])
    assert len(independent_columns(W)[0]) == 1 + counts
    assert len(independent_columns(W, tolerance=1e-8)[0]) == 1


@pytest.mark.parametrize("shape", [(3, 2), (0, 2), (3, 0), (0, 0)])
def test_zero_and_missing_columns_are_never_independent(shape):
    independent, dependent, K = independent_columns(np.zeros(shape))
    assert (independent, dependent) == ((), tuple(range(shape[1])))
    assert K.shape == (0, shape[1])


def test_the_condition_number_is_that_of_the_regressor_and_not_of_its_square():
    rng = np.random.default_rng(3)
    U, V = (np.linalg.qr(rng.normal(size=(n, 4))).Q for n in (20, 4))
    W = U @ np.diag([300.0, 20.0, 5.0, 0.1]) @ V.T
    for matrix in (W, np.linalg.qr(W).R):
        found = condition_number(matrix, basis="4 columns")
        assert found.value == pytest.approx(3000.0, rel=1e-10)  # cond times rounding
        assert str(found) == "3000 (4 columns; column scaling: none)"


@REPEATABLE
@given(st.lists(st.floats(1e-6, 1e6), min_size=4, max_size=4), st.integers(0, 99))
def test_with_unit_columns_the_scale_of_columns_does_not_matter(scales, seed):
    W = np.random.default_rng(seed).normal(size=(12, 4))
    found = condition_number(W * scales, basis="", unit_columns=True)
    truth = np.linalg.cond(W / np.linalg.norm(W, axis=0))
    # Rounding, times a condition number below 10.
    assert found.value == pytest.approx(truth, rel=1e-12)
    assert found.scaling == "unit columns"


@pytest.mark.parametrize("unit_columns", [False, True])
@pytest.mark.parametrize("W", [np.diag([1.0, 0.0]), np.eye(3)[:2], [[1, 0], [1, 0]]])
def test_a_rank_below_the_number_of_columns_is_an_infinite_condition(W, unit_columns):
    W = np.array(W)
    assert condition_number(W, basis="", unit_columns=unit_columns).value == np.inf


@pytest.mark.parametrize("shape", [(4, 3), (0, 3), (3, 0)])
def test_a_zero_regressor_has_no_condition_number(shape):
    with pytest.raises(NotExcitedError, match="regressor is zero"):
        condition_number(np.zeros(shape), basis="")


@pytest.mark.parametrize(
    ("coefficients", "text"),
    [
        ([1, 0, -1], "a - c"),
        ([-1, 2, 1], "-a + 2 b + c"),
        ([-0.25, 0, 1e-12], "-0.25 a"),
        ([0, 123456.0, -1e-7], "1.235e+05 b - 1e-07 c"),
        ([0, 0, 0], "0"),
    ],
)
def test_a_linear_combination_reads_as_people_write_it(coefficients, text):
    assert linear_combination(np.array(coefficients, float), ("a", "b", "c")) == text


def rounded_scara(digits):
    """An arm of parallel axes, the last one upside down by a rounded half turn."""
    turns = np.array([0.0, 0.0, 0.0, round(np.pi, digits)])
    lengths, offsets = (0, 0.3, 0.25, 0), (0.4, 0, 0, 0)
    rows = [DHRow(*row) for row in zip(turns, lengths, offsets, strict=True)]
    return from_modified_dh("scara", rows)


@pytest.mark.parametrize("digits", [3, 4, 5, 6, 7])
def test_a_rounded_angle_invents_no_base_parameters(digits):
    exact = base_of(arm((0, 0, 0, 2), (0, 0.3, 0.25, 0), (0.4, 0, 0, 0)))
    model = TorqueModel(rounded_scara(digits))
    base = base_parameters(model)
    assert base.names == exact.names
    assert np.allclose(base.projection, exact.projection, rtol=0, atol=2e-3)
    assert base.near
    for sentence in base.near:
        assert "rounded number" in sentence
    W = np.concatenate(list(model.regressor(*_states(model))), axis=1).T
    left = W - W[:, base.independent] @ base.projection
    angle = abs(np.pi - round(np.pi, digits))
    # What is dropped is what the angle's error does, and no more.
    assert abs(left).max() < 3.0 * angle * abs(W).max()


def _states(model):
    return np.random.default_rng(3).uniform(-2.0, 2.0, (3, 40, len(model.robot)))


def test_rotor_inertias_stay_of_their_size_where_an_angle_is_rounded():
    rng = np.random.default_rng(0)
    drive = DriveTerms(rotor_inertia=True, viscous=True)
    model = TorqueModel(rounded_scara(5), drive)
    body = [3.0, 0.3, 0.1, 0.2, 0.1, 0, 0.1, 0, 0, 0.1]
    x = np.concatenate([np.tile(body, 4), np.tile([1.0, 0.5], 4)])
    time = np.arange(3000) / 100.0
    shape = 0.8 * np.sin(np.outer(time, [1.0, 1.7, 2.3, 3.1]))
    log = differentiated(Recording(model.robot.joint_names, time, shape))
    log = simulate_torque(model, x, log, noise=0.1, rng=rng)
    estimate = least_squares(model, build_regression(model, log))
    assert any("rounded number" in note for note in estimate.notes)
    assert abs(estimate.base_values - base_parameters(model).projection @ x).max() < 1.0


def test_short_lengths_are_kept_where_angles_are_rounded():
    """Lengths of 5 to 8 cm of a published arm: their squares are a few thousandths."""
    turn = round(np.pi / 2, 4)
    turns = (0.0, -turn, turn, turn, turn, turn, -turn)
    lengths = (0.0, 0.0, 0.0, 0.0525, 0.0775, 0.0, 0.076)
    offsets = (0.267, 0.0, 0.293, 0.0, 0.3425, 0.0, 0.097)
    rows = [DHRow(*row) for row in zip(turns, lengths, offsets, strict=True)]
    drive = DriveTerms(rotor_inertia=True, viscous=True)
    model = TorqueModel(from_modified_dh("arm", rows), drive)
    base = base_parameters(model)
    assert base.near
    W = np.concatenate(list(model.regressor(*_states(model))), axis=1).T
    left = W - W[:, base.independent] @ base.projection
    angle = abs(np.pi / 2 - turn)
    assert abs(left).max() < 10.0 * angle * abs(W).max()


def test_exact_angles_leave_nothing_to_say():
    assert base_of(UR10).near == base_of(PANDA).near == ()


def test_columns_with_a_gap_are_split_there():
    rng = np.random.default_rng(0)
    W = rng.normal(size=(60, 4))
    W = np.column_stack([W, W[:, 0] + 2.0 * W[:, 1] + 1e-6 * rng.normal(size=60)])
    split, near = split_at_gap(W, ["a"] * 5)
    assert split.independent == (0, 1, 2, 3)
    assert np.array_equal(split.regrouping.ravel(), [1.0, 2.0, 0.0, 0.0])
    assert 1e-7 < near[4] < 1e-5


def test_columns_that_fade_without_a_gap_are_all_kept():
    rng = np.random.default_rng(0)
    W = np.linalg.qr(rng.normal(size=(60, 6)))[0]
    chain = [W[:, 0]]
    for k in range(1, 6):  # each is nearer to the one before by another tenth
        chain.append(chain[-1] + 0.1**k * W[:, k])
    split, near = split_at_gap(np.column_stack(chain), ["a"] * 6)
    assert (split.independent, near) == (tuple(range(6)), {})


def test_a_small_column_of_another_unit_is_no_small_effect():
    rng = np.random.default_rng(0)
    W = rng.normal(size=(60, 3)) * [1.0, 1.0, 1e-6]
    assert split_at_gap(W, ["kg", "kg", "kg m^2"]).split.independent == (0, 1, 2)
    assert split_at_gap(W, ["kg", "kg", "kg"]).split.independent == (0, 1)


def test_a_single_number_has_the_condition_of_one():
    assert condition_number(np.array([[-2.0]]), basis="a number").value == 1.0


def test_the_first_entry_of_a_readable_direction_is_one():
    null = np.array([[0.0], [-1.0], [2.0]]) / np.sqrt(5.0)
    np.testing.assert_allclose(_readable(null), [[0.0], [1.0], [-2.0]], atol=1e-15)


@pytest.mark.parametrize("unit", [1.0, 1e-13])
def test_a_column_below_a_billionth_of_the_largest_is_zero_beside_small_ones(unit):
    W = np.zeros((3, 3))
    W[0, 0], W[1, 1], W[1, 2] = 1.0, 1e-8, 5e-10
    split = independent_columns(unit * W)
    assert split.independent == (0, 1) and split.dependent == (2,)
    assert split.regrouping.tolist() == [[0.0], [0.0]]


def test_excitation_states_the_condition_with_and_without_units():
    model, _, log = experiment(2, joints=2, noise=0.1, samples=90)
    regression, base = build_regression(model, log, noise=False), base_parameters(model)
    R = regression.stacked()[:, list(base.independent)]
    plain, unit = excitation_of(regression, base).condition
    assert plain.value == pytest.approx(np.linalg.cond(R))
    assert unit.value == pytest.approx(np.linalg.cond(R / np.linalg.norm(R, axis=0)))
    assert (plain.scaling, unit.scaling) == ("none", "unit columns")
    assert plain.value > 2.0 * unit.value
