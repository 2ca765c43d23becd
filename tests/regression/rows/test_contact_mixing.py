"""Rows of which contact forces are taken out, each under its own name."""

from dataclasses import replace

import numpy as np
import pytest
from quadrupeds import quadruped_text, standing

import consistent_id as ci
from consistent_id.recordings.beside import ContactFlags
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.rows.contact_maps import (
    ContactMixing,
    _down,
    _null_spaces,
    contact_pushes,
    row_numbers,
)
from consistent_id.regression.rows.generalised_forces import (
    measured_forces,
    shifted_forces,
)
from consistent_id.robot.kinematics import frame_motion

THREE = [[i != j for j in range(4)] for i in range(4)]


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "quadruped.xml"
    path.write_text(quadruped_text())
    return ci.robot.load_mjcf(path, base="floating")


@pytest.fixture(scope="module")
def log(robot):
    """On three feet, whose forces are not measured."""
    whole = standing(robot, np.array(THREE * 30), noise=0.1)
    return replace(whole, wrenches=())


@pytest.mark.slow
def test_they_hold_what_the_fewer_rows_without_names_hold(robot, log):
    model = ci.TorqueModel(robot)
    named = ci.build_regression(model, log).stacked()
    few = ci.regression.contact_free_regression(
        ci.regression.contact_free_model(model), log
    ).stacked()
    squares = [R.T @ R for R in (named, few)]
    assert np.allclose(*squares, rtol=0, atol=1e-11 * abs(squares[1]).max())


@pytest.mark.slow
def test_a_shift_of_torque_is_mixed_as_torque_is(robot, log):
    """Its rows of the base are zero before contact forces are taken out."""
    model = ci.TorqueModel(robot)
    shift = np.random.default_rng(2).normal(size=log.torque.shape)
    shifted = replace(log, torque_shift=shift)
    found = motion_of(model, shifted, None)
    more = motion_of(model, replace(log, torque=log.torque + shift), None)
    plain = motion_of(model, log, None)
    np.testing.assert_allclose(found.shift, more.torque - plain.torque, atol=1e-9)
    assert plain.shift is None
    bare = shifted_forces(model, shifted)
    assert not bare[:, :6].any()
    np.testing.assert_array_equal(bare[:, 6:], shift)
    noise = ci.build_regression(model, shifted).noise
    assert [len(N) for N in noise.shapes] == [1] * 18
    # The delay's error is the last, below those of velocities, which are not known.
    rubs = ci.TorqueModel(robot, ci.DriveTerms(coulomb="sign", stribeck_velocity=0.1))
    shapes = ci.build_regression(rubs, shifted).noise.shapes
    assert [len(N) for N in shapes] == [13] * 18
    assert not np.array(shapes)[:, :-1].any() and np.array(shapes)[:, -1].any()


def test_contact_forces_leave_no_trace(robot, log):
    """Any forces at the feet on the ground, in all 18 rows."""
    rng, model = np.random.default_rng(1), ci.TorqueModel(robot)
    mixing = motion_of(model, log, None).mixing
    acting = np.zeros((len(log), 18))
    for flags in log.contacts:
        J = ci.regression.contact_jacobian(
            robot, log.position, frame=flags.frame, point=flags.point
        )
        push = 50.0 * rng.normal(size=(len(log), 3)) * flags.closed[:, None]
        acting += np.einsum("nij,ni->nj", J[:, :3], push)
    assert abs(acting).max() > 10.0
    assert abs(mixing.mixed(acting)).max() < 1e-10 * abs(acting).max()


def test_the_mixed_rows_of_the_true_parameters_are_the_mixed_torque(robot):
    model = ci.TorqueModel(robot)
    exact = replace(standing(robot, np.array(THREE * 2)), wrenches=())
    motion = motion_of(model, exact, None)
    kept = [np.arange(len(model.layout))] * 18
    ((part, blocks),) = motion.rows(model, kept)
    assert part == slice(0, len(exact)) and abs(motion.torque).max() > 1.0
    for row, block in enumerate(blocks):
        measured, predicted = block[:, -1], block[:, :-1] @ robot.nominal
        np.testing.assert_allclose(measured, motion.torque[:, row], atol=1e-12)
        np.testing.assert_allclose(predicted, measured, atol=1e-9)


def test_contacts_whose_wrenches_are_measured_are_no_unknowns(robot):
    whole = standing(robot, np.array(THREE * 5))
    assert motion_of(ci.TorqueModel(robot), whole, None).mixing is None


@pytest.mark.slow
def test_predictions_are_of_the_same_rows_as_torque(robot, log):
    model = ci.TorqueModel(robot)
    exact = replace(standing(robot, np.array(THREE * 20)), wrenches=())
    base = ci.regression.contact_free_base(model, exact.contacts)
    found = ci.least_squares(model, ci.build_regression(model, exact), base=base)
    rest = motion_of(model, exact, None).torque - found.predict(exact)
    assert abs(rest).max() < 1e-8
    assert found.score(exact).stacked < 1e-9
    assert found.score(log).stacked > 1e-4


@pytest.mark.slow
def test_degrees_of_freedom_are_counted_once(robot, log):
    """Of 18 rows three feet take nine; counts are what is left, rounded row by row."""
    regression = ci.build_regression(ci.TorqueModel(robot), log)
    assert sum(regression.counts) == pytest.approx(9 * len(log), abs=9)


@pytest.mark.slow
def test_torque_that_is_not_known_gets_into_no_row(robot, log):
    rng, model = np.random.default_rng(2), ci.TorqueModel(robot)
    known = rng.uniform(size=log.position.shape) > 0.2
    wrong = np.where(known, log.torque, 1e3)
    factors = [
        ci.build_regression(model, replace(x, torque_known=known)).stacked()
        for x in (log, replace(log, torque=wrong))
    ]
    squares = [R.T @ R for R in factors]
    assert np.allclose(*squares, rtol=0, atol=1e-9 * abs(squares[0]).max())
    rows = model.torque_joints
    weights = ci.signals.row_weights(log, ~known, rows, others=ci.regression.BASE_ROWS)
    R = ci.build_regression(model, log, row_weights=[weights]).stacked()
    assert np.allclose(R.T @ R, squares[0], rtol=0, atol=1e-9 * abs(squares[0]).max())


def test_rows_of_weight_zero_are_rows_of_unknown_torque(robot, log):
    rng, model = np.random.default_rng(3), ci.TorqueModel(robot)
    part = log.samples(slice(0, 40))
    known = rng.uniform(size=part.position.shape) > 0.2
    rows, others = model.torque_joints, ci.regression.BASE_ROWS
    weights = ci.signals.row_weights(part, ~known, rows, others=others)
    weighted = motion_of(model, part, weights)
    unknown = motion_of(model, replace(part, torque_known=known), None)
    assert (weighted.weights == unknown.weights).all()
    assert np.allclose(weighted.torque, unknown.torque, rtol=0, atol=1e-9)
    assert np.allclose(weighted.shares, unknown.shares, rtol=0, atol=1e-9)
    # Torque of weight zero gets into no other row.
    wrong = replace(part, torque=np.where(known, part.torque, 1e3))
    counted = weights > 0.0
    assert weighted.shares[~counted].max() < 1e-12 < weighted.shares[counted].min()
    rows = motion_of(model, wrong, weights).torque[counted]
    assert np.allclose(rows, weighted.torque[counted], rtol=0, atol=1e-9)


def test_of_a_fixed_base_such_rows_do_not_count():
    arm = ci.from_modified_dh("arm", [ci.DHRow(0, 0), ci.DHRow(-np.pi / 2, 0.3)])
    rng = np.random.default_rng(0)
    q, dq, ddq, torque = rng.normal(size=(4, 50, 2))
    known = np.ones((50, 2), dtype=bool)
    known[:10, 1] = False
    log = ci.Recording(arm.joint_names, 0.01 * np.arange(50), q, dq, ddq, torque)
    model = ci.TorqueModel(arm)
    masked = ci.build_regression(model, replace(log, torque_known=known))
    assert masked.counts == (50, 40)
    with pytest.raises(ci.RecordingError, match="torque_known has shape"):
        replace(log, torque_known=known[:5])


def test_joints_at_rest_have_no_known_torque():
    time = 0.01 * np.arange(400)
    position = np.column_stack([np.sin(3 * time), np.where(time < 2, 0.0, time - 2)])
    log = ci.Recording(("a", "b"), time, position)
    found = ci.signals.without_rests(log, 0.1, reach=0.05)
    assert not found.torque_known[:190, 1].any() and found.torque_known[220:, 1].all()
    # The first joint turns back every pi / 3 seconds.
    slow = abs(3 * np.cos(3 * time)) < 0.09
    assert not found.torque_known[slow, 0].any() and found.torque_known[:, 0].any()


@pytest.mark.slow
def test_the_fewer_rows_hold_no_unknown_torque_either(robot, log):
    rng, model = np.random.default_rng(3), ci.TorqueModel(robot)
    part = replace(log, torque_known=rng.uniform(size=log.position.shape) > 0.2)
    one = ci.regression.contact_free_regression(
        ci.regression.contact_free_model(model), part
    )
    named = ci.build_regression(model, part)
    squares = [R.T @ R for R in (one.stacked(), named.stacked())]
    assert np.allclose(*squares, rtol=0, atol=1e-9 * abs(squares[0]).max())
    assert one.counts[0] == pytest.approx(sum(named.counts), abs=9)


@pytest.mark.parametrize("axes", ["frame", "base", "world"])
def test_a_wrench_pushes_alike_in_whatever_axes_it_is_given(robot, axes):
    """Its virtual power is that of the contact's Jacobian, in axes of the base."""
    rng = np.random.default_rng(3)
    whole = replace(standing(robot, np.array(THREE)), contacts=())
    n = len(whole)
    turned = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
    turned *= np.linalg.det(turned)[:, None, None]
    force = rng.normal(size=(n, 6))
    foot, point = "a_calf", (0.0, 0.0, -0.2)
    J = ci.regression.contact_jacobian(robot, whole.position, frame=foot, point=point)
    if axes == "frame":
        turn = frame_motion(robot, whole.position, frame=foot).rotation
    else:
        turn = (
            np.swapaxes(turned, 1, 2)
            if axes == "world"
            else np.tile(np.eye(3), (n, 1, 1))
        )
    halves = np.einsum("nij,nkj->nki", turn, force.reshape(n, 2, 3)).reshape(n, 6)
    expected = np.einsum("nir,ni->nr", J, halves)
    expected[:, 6:] += whole.torque
    wrench = ci.recordings.Wrench(foot, force, point, axes=axes)
    log = replace(whole, wrenches=(wrench,), base=replace(whole.base, rotation=turned))
    model = ci.TorqueModel(robot)
    np.testing.assert_allclose(measured_forces(model, log), expected, atol=1e-10)
    if axes == "world":
        with pytest.raises(ci.RecordingError, match="in world axes"):
            measured_forces(model, replace(log, base=whole.base))
    base_alone = replace(model, torque_joints=ci.regression.BASE_ROWS)
    bare = replace(log, torque=None)
    np.testing.assert_allclose(
        measured_forces(base_alone, bare), expected[:, :6], atol=1e-10
    )
    assert measured_forces(model, bare) is None
    with pytest.raises(ci.RecordingError, match="has no base motion"):
        measured_forces(model, replace(log, base=None))


def maps_of(robot, q, contacts, sigma):
    """Row maps of all rows of samples with these contacts."""
    mixing = ContactMixing(robot, row_numbers(robot), q, tuple(contacts), None)
    return mixing.row_maps(sigma)


def test_in_the_air_rows_are_divided_by_their_noise_alone(robot):
    q = standing(robot, np.array(THREE)).position
    closed = np.zeros(4, dtype=bool)
    flags = [ci.recordings.ContactFlags("a_calf", closed)]
    sigma = np.arange(1.0, 19.0)
    (group,) = maps_of(robot, q, flags, sigma)
    assert group.samples.tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(group.maps, np.tile(np.diag(1.0 / sigma), (4, 1, 1)))
    uncertain = replace(flags[0], certain=np.arange(4) > 1)
    (group,) = maps_of(robot, q, [uncertain], sigma)
    assert group.samples.tolist() == [2, 3]


def test_levels_of_noise_are_positive_and_of_three_classes(robot):
    levels = ci.regression.row_levels(robot, force=2.0, moment=3.0, joints=4.0)
    assert levels.tolist() == [2.0] * 3 + [3.0] * 3 + [4.0] * 12
    assert ci.regression.row_levels(robot).tolist() == [1.0] * 18
    for wrong in ("force", "moment", "joints"):
        with pytest.raises(ci.ProblemError, match="expected positive numbers"):
            ci.regression.row_levels(robot, **{wrong: 0.0})


def test_a_contact_along_another_is_counted_once(robot):
    """The same point twice takes three rows, not six."""
    q = standing(robot, np.array(THREE)).position
    foot = ci.recordings.ContactFlags("a_calf", np.ones(4, dtype=bool), (0, 0, -0.2))
    sigma = np.ones(18)
    for contacts, left in (([foot], 15), ([foot, foot], 15)):
        (group,) = maps_of(robot, q, contacts, sigma)
        assert group.maps.shape == (4, left, 18)
        products = group.maps @ np.swapaxes(group.maps, 1, 2)
        np.testing.assert_allclose(
            products, np.tile(np.eye(left), (4, 1, 1)), atol=1e-10
        )
    surface = replace(foot, surface=True)
    (group,) = maps_of(robot, q, [surface], sigma)
    assert group.maps.shape == (4, 12, 18)


@pytest.mark.parametrize("known", [None, [[1, 1, 0], [1, 0, 0], [0, 1, 0]]])
def test_noise_that_mixing_takes_is_that_of_the_mean_share_left(robot, log, known):
    shares = np.array([[0.2, 0.0, 0.0], [0.4, 0.0, 0.0], [0.6, 1.0, 0.2]])
    motion = motion_of(ci.TorqueModel(robot), log, None)._replace(shares=shares)
    # Of three samples, or of those that are known, and at least of one in three.
    left = [0.4, 1.0 / 3.0, 1.0 / 3.0] if known is None else [0.6, 0.5, 1.0 / 3.0]
    if known is not None:
        motion = motion._replace(known=np.array(known, dtype=float))
    np.testing.assert_allclose(motion.noise_lost(), 1.0 / np.sqrt(left), rtol=1e-12)
    alone = motion._replace(shares=None)
    np.testing.assert_array_equal(alone.noise_lost(), np.ones(motion.torque.shape[1]))


@pytest.mark.parametrize("columns", [0, 2, 4, 5])
def test_maps_are_orthonormal_beside_what_contacts_push_whatever_their_rank(columns):
    rng = np.random.default_rng(columns)
    sigma = np.array([1.0, 0.5, 2.0, 10.0])
    pushes = rng.normal(size=(6, 4, columns)) * np.logspace(-7, 3, 6)[:, None, None]
    pushes[1:3, :, 1:] = (
        pushes[1:3, :, :1] * [1.0, -2.0, 3.0, 0.5][: max(columns - 1, 0)]
    )
    pushes[3] = 0.0
    samples = 10 * np.arange(6)
    # NumPy 2.0 has no rank of a matrix without columns.
    ranks = dict.fromkeys(samples.tolist(), 0)
    if columns:
        ranks = {10 * k: np.linalg.matrix_rank(each) for k, each in enumerate(pushes)}
    seen = []
    for group in _null_spaces(samples, pushes, sigma):
        for sample, each in zip(group.samples.tolist(), group.maps, strict=True):
            seen.append(sample)
            unit = each * sigma
            assert len(unit) == 4 - ranks[sample]
            np.testing.assert_allclose(unit @ unit.T, np.eye(len(unit)), atol=1e-12)
            push = pushes[sample // 10]
            assert abs(unit @ push).max(initial=0) <= 1e-12 * abs(push).max(
                initial=1e-9
            )
    assert sorted(seen) == [k for k, rank in ranks.items() if rank < 4]


def test_rows_of_unlike_noise_are_mixed_so_that_forces_leave_no_trace(robot, log):
    sigma = np.linspace(0.1, 3.0, 18)
    mixing = motion_of(ci.TorqueModel(robot), log, None).mixing
    pushes = contact_pushes(robot, log.position, log.contacts, log.base.rotation)
    count = 0
    for group in mixing.row_maps(sigma):
        unit = group.maps * sigma
        one = np.eye(unit.shape[1])
        np.testing.assert_allclose(
            unit @ np.swapaxes(unit, 1, 2), [one] * len(unit), atol=1e-9
        )
        for flags, push in zip(log.contacts, pushes, strict=True):
            touching = flags.closed[group.samples]
            left = group.maps[touching] @ push[group.samples][touching]
            assert abs(left).max(initial=0.0) < 1e-10
            count += touching.sum()
    assert count == sum(flags.closed.sum() for flags in log.contacts)


def test_forces_that_contacts_do_not_explain_are_left_by_their_share(robot):
    rng = np.random.default_rng(6)
    whole = standing(robot, np.array(THREE * 3), noise=0.1)
    wrong = tuple(
        replace(
            wrench, values=wrench.values + 20.0 * rng.normal(size=wrench.values.shape)
        )
        for wrench in whole.wrenches
    )
    log = replace(whole, wrenches=wrong)
    model = ci.TorqueModel(robot)
    still = replace(log, torque=np.zeros_like(log.torque))
    acting = measured_forces(model, still)
    mixing = ContactMixing(
        robot, row_numbers(robot), log.position, log.contacts, log.base.rotation
    )
    passed = np.einsum("nij,nj->ni", mixing.maps, acting)
    expected = np.linalg.norm(passed) / np.linalg.norm(acting)
    found = ci.regression.contact_force_left(model, log)
    assert 0.01 < expected < 0.9 and found == pytest.approx(expected)
    none = tuple(replace(w, values=np.zeros_like(w.values)) for w in wrong)
    assert ci.regression.contact_force_left(model, replace(log, wrenches=none)) == 0.0


def test_gravity_is_turned_into_the_axes_of_the_base(robot):
    angle, flags = 0.3, (ContactFlags("foot", np.ones(1, dtype=bool), radius=0.02),)
    c, s = np.cos(angle), np.sin(angle)
    about_x = np.array([[[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]])
    np.testing.assert_allclose(_down(robot, flags, about_x), [[0.0, -s, -c]])
