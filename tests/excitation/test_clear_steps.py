"""Among bodies: joints swing by themselves as far as they can, and steps stay clear."""

from dataclasses import replace

import numpy as np
import pytest
from excited import arm, arm_limits, arm_problem
from scipy import optimize

from consistent_id import TorqueModel
from consistent_id.excitation import clear_poses, programme
from consistent_id.excitation.aims import PathForm
from consistent_id.excitation.clear_poses import (
    PathLimits,
    clear_start,
    cleared,
    worst_excess,
)
from consistent_id.excitation.guards import ClearanceGuard
from consistent_id.excitation.path_search import FoundPath, searched_path
from consistent_id.excitation.programme import LinearRows, Local, best_step
from consistent_id.excitation.verification import demands
from consistent_id.excitation.work import Meter
from consistent_id.motion import Body, Box, Capsule, build_scene, plane
from consistent_id.motion.collisions.scene import Pair
from consistent_id.motion.collisions.separation import nearest


def scene():
    """An arm of three joints over a floor that its links reach."""
    robot = arm(3)
    return build_scene(
        robot,
        [
            Body("forearm", Capsule(0.05, 0.3), "link3", None, [0.2, 0.0, 0.0]),
            Body("post", Box((0.1, 0.1, 1.0)), None, None, [0.45, 0.3, 0.0]),
            plane(-0.25),
        ],
        clearance=0.02,
    )


def problem():
    guards = (ClearanceGuard(scene()),)
    return arm_problem(
        TorqueModel(arm(3)), arm_limits(arm(3)), form=PathForm(5.0, 3), guards=guards
    )


@pytest.mark.slow
def test_a_clear_start_lets_each_joint_swing_by_itself():
    of = problem()
    for seed in range(3):
        rng = np.random.default_rng(seed)
        free = rng.normal(size=of.shape)
        free[0] = rng.uniform(-0.3, 0.3, 3)
        free *= 0.8 / of.limits.largest(free)
        limits = PathLimits(of.basis, of.limits, of.guards, of.grid)
        start = clear_start(free, limits, rng)
        (measure,) = of.measures(start)
        assert measure.max() <= 0.0
        assert of.limits.largest(start).max() <= 1.0
        share = abs(start[1:]).max(axis=0) / abs(free[1:]).max(axis=0)
        # Joint 1 turns about the vertical: at a pose clear of the post, the floor is
        # never in its way, however little the others may swing.
        assert share.max() > 0.25
        assert np.ptp(share) > 0.0 or (share == 1.0).all()


@pytest.mark.slow
def test_a_search_among_bodies_improves_and_stays_clear():
    of = problem()
    gains = []
    for seed in range(3):
        found = searched_path(of, FoundPath(seed))
        (measure,) = of.measures(found.variables)
        assert measure.max() <= 1e-7
        assert of.limits.largest(found.variables).max() <= 1.0 + 1e-9
        gains.append(of.score(of.objective, of.random(seed)) - found.score)
    assert min(gains) > 0.1


def test_no_step_is_better_than_the_best_one():
    rng = np.random.default_rng(0)
    of = arm_problem(TorqueModel(arm(2)), arm_limits(arm(2)))
    x = of.random(0).ravel()
    A = of.limits.fine.tocsr()
    F = rng.normal(size=(len(x), len(x)))
    B, slope = F @ F.T + np.eye(len(x)), rng.normal(size=len(x))
    J, c = rng.normal(size=(3, len(x))), np.array([-0.1, 0.0, 0.02])
    step = best_step(x, Local(slope, B, A), LinearRows(c, J), 0.05)
    # A convex function is nowhere less than its tangent: the best feasible point of the
    # tangent, by another solver, bounds how much better any step is.
    gradient = slope + B @ step
    rows = np.vstack([A.toarray(), -A.toarray(), J])
    least = optimize.linprog(
        gradient,
        A_ub=rows,
        b_ub=np.concatenate([1.0 - A @ x, 1.0 + A @ x, -c]),
        bounds=(-0.05, 0.05),
    )
    value = slope @ step + 0.5 * step @ B @ step
    assert gradient @ step - least.fun <= 1e-4 * abs(value)
    assert (c + J @ step).max() <= 1e-6 and abs(step).max() <= 0.05 + 1e-9


def test_a_step_keeps_limits_that_were_not_included_first_and_its_work_is_counted():
    of = arm_problem(TorqueModel(arm(2)), arm_limits(arm(2)))
    x, A = 0.0 * of.random(0).ravel(), of.limits.fine.tocsr()
    slope = np.random.default_rng(1).normal(size=len(x))
    local = Local(100.0 * slope, np.eye(len(x)), A)
    none, meter = LinearRows(np.zeros(0), np.zeros((0, len(x)))), Meter()
    step = best_step(x, local, none, 10.0, meter)
    assert A.shape[0] > 10 * len(x)  # most limits are not included first
    assert abs(A @ step).max() == pytest.approx(1.0, abs=2e-3)
    assert meter.spent > 0.0
    assert best_step(x, local, none, 10.0, Meter(0.1 * meter.spent)) is None


def test_the_work_of_a_step_grows_with_the_iterations_of_its_solver(monkeypatch):
    of = arm_problem(TorqueModel(arm(2)), arm_limits(arm(2)))
    x, A = 0.0 * of.random(0).ravel(), of.limits.fine.tocsr()
    local = Local(np.ones(len(x)), np.eye(len(x)), A)
    none = LinearRows(np.zeros(0), np.zeros((0, len(x))))
    usual, slow, least = Meter(), Meter(), programme._least
    step = best_step(x, local, none, 0.1, usual)

    def slower(*of):
        found = least(*of)
        return found._replace(iterations=10 * found.iterations)

    monkeypatch.setattr(programme, "_least", slower)
    assert np.array_equal(best_step(x, local, none, 0.1, slow), step)
    assert slow.spent == pytest.approx(10.0 * usual.spent)


@pytest.mark.slow
def test_the_limits_that_a_joint_affects_are_all_that_its_motion_can_violate():
    upper = Body("upper arm", Capsule(0.05, 0.2), "link1", None, [0.2, 0.0, 0.0])
    of = scene()
    bodies, pairs = (*of.bodies, upper), (*of.pairs, Pair(len(of.bodies), 1))
    guard = ClearanceGuard(replace(of, bodies=bodies, pairs=pairs), {1: 0.01, 2: 0.02})
    names = [guard.scene.names(pair) for pair in guard.scene.pairs]
    for joint, count in ((0, 3), (2, 2)):
        some = guard.moved_by(joint)
        kept = [some.scene.names(pair) for pair in some.scene.pairs]
        rng, moved = np.random.default_rng(joint), set()
        for _ in range(40):
            q = np.repeat(rng.uniform(-1.5, 1.5, (1, 3)), 2, axis=0)
            q[1, joint] += 0.4
            before, after = nearest(guard.scene, q).distance
            moved |= {names[k] for k in np.flatnonzero(abs(after - before) > 1e-6)}
        assert moved <= set(kept) and len(kept) == count
        spare = {names[k]: more for k, more in guard.spare.items() if names[k] in kept}
        assert {kept[k]: more for k, more in some.spare.items()} == spare


@pytest.mark.slow
def test_a_random_path_is_enlarged_until_its_work_is_done():
    of = problem()
    for number in range(8):  # one that is in the way of something
        whole = of.drawn(number)
        part = replace(of, drawing=0.1 * whole.work).drawn(number)
        if part.work < whole.work:
            break
    # Random poses, and the path at the end, are measured in any case.
    assert 0.1 * whole.work <= part.work < 0.7 * whole.work
    assert abs(part.path[1:]).sum() < abs(whole.path[1:]).sum()
    (measure,) = of.measures(part.path)
    assert measure.max() <= 0.0
    # The work is counted as the search's, so that its limit holds for both.
    drawn = searched_path(of, FoundPath(number), work=0.0).work
    known = searched_path(of, FoundPath(number, drawn=whole.path), work=0.0).work
    assert drawn - known == pytest.approx(whole.work)


@pytest.mark.slow
def test_random_paths_swing_about_known_poses_where_none_is_clear(monkeypatch):
    """In a narrow gap, clear poses are looked for once, not for each path."""
    of = problem()
    known = np.array([[0.0, 0.0, 0.0]])
    seen = []

    def all_bad(poses, guards, meter=None):
        seen.append(poses)
        clear = [any(np.array_equal(pose, one) for one in known) for pose in poses]
        return np.where(clear, -1.0, 1.0)

    monkeypatch.setattr(clear_poses, "worst_excess", all_bad)
    monkeypatch.setattr(clear_poses, "cleared", None)  # not called
    path = replace(of, poses=known).drawn(0).path
    offset = of.basis.trajectory(path).offset
    assert len(seen) == 2
    assert np.allclose(offset, 0.0)


@pytest.mark.slow
def test_random_paths_are_remembered_by_their_poses_and_cannot_be_changed():
    of = problem()
    poses = (np.zeros((1, 3)), np.full((1, 3), 0.1))
    one, same, other = (replace(of, poses=poses[k]).drawn(0) for k in (0, 0, 1))
    assert one is same
    assert one is not other
    with pytest.raises(ValueError, match="read-only"):
        one.path[0] = 1.0


@pytest.mark.slow
def test_clear_poses_have_room_to_swing():
    required = demands(TorqueModel(arm(3)), arm_limits(arm(3)), scene=scene())
    guards = required.guards
    rng = np.random.default_rng(1)
    low, high = required.limits.lower, required.limits.upper
    poses = rng.uniform(low, high, (400, 3))
    worst = worst_excess(poses, guards)
    bad = poses[worst > 0.05][:12]
    found = cleared(bad, worst_excess(bad, guards), guards, low, high)
    excess = worst_excess(found, guards)
    # 5 mm, and a twentieth of the torque limits, not just none
    assert (excess <= -0.05).any()
    assert np.count_nonzero(excess <= 0.0) == 4 < 12  # no more are looked for
