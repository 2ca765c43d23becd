"""Widths of friction of sliding joints, whose speeds have another unit."""

import numpy as np
import pytest
from logged import URDF, moved

from consistent_id import DriveTerms, TorqueModel, draft_problem, simulate_torque
from consistent_id.problems.selection.choice import (
    joint_widths,
    scale_moves,
    stribeck_moves,
    stribeck_velocities,
    term_moves,
)
from consistent_id.problems.selection.setup import beginning
from consistent_id.robot import load_urdf

TURNS, SLIDES = 0.02, 0.002  # rad/s, m/s
SPEED = 0.1  # m/s for 1 rad/s


def written(folder, kind="prismatic", **terms):
    """Write an arm whose second joint slides a tenth as fast as the first turns."""
    urdf, log = folder / "arm.urdf", folder / "log.csv"
    before, _, after = URDF.partition('name="elbow" type="revolute"')
    urdf.write_text(f'{before}name="elbow" type="{kind}"{after}')
    robot = load_urdf(urdf)
    drive = tuple(
        DriveTerms(
            viscous=True, coulomb="tanh", velocity_scale=width, offset=True, **terms
        )
        for width in (TURNS, SLIDES)
    )
    model = TorqueModel(robot, drive)
    plain = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True)
    arm = load_urdf(_arm(folder))
    exact = moved(TorqueModel(arm, plain))
    size = np.array([1.0, SPEED])
    states = (exact.position, exact.velocity, exact.acceleration)
    motion = type(exact)(exact.joints, exact.time, *(size * part for part in states))
    friction = [3.0, 4.0, 0.5, 20.0, 8.0, -0.3]
    truth = np.append(np.ravel(robot.nominal), friction)
    made = simulate_torque(
        model, truth, motion, noise=0.1, rng=np.random.default_rng(1)
    )
    table = np.column_stack([made.time, made.position, made.torque])
    header = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow"
    np.savetxt(log, table, "%.9g", ",", header=header, comments="")
    return urdf, log


def _arm(folder):
    file = folder / "turning.urdf"
    file.write_text(URDF)
    return file


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """The search for an arm with a sliding joint, at its beginning."""
    files = written(tmp_path_factory.mktemp("arm"))
    problem = draft_problem(*files, select=False, cutoff=10.0).problem()
    return beginning(problem, problem.logs("training"), (), 10.0)


def test_widths_of_each_kind_are_those_of_its_speeds(begun):
    choice, (turning, sliding) = begun.plain.choice, begun.scope.widths
    assert (turning.joints, sliding.joints) == ((0,), (1,))
    assert np.median(sliding.scales) == pytest.approx(
        SPEED * np.median(turning.scales), rel=0.5
    )
    assert {TURNS, SLIDES} <= {*turning.scales, *sliding.scales}
    before = joint_widths(choice)
    assert before[1] == pytest.approx(SPEED * before[0])
    for j, widths in enumerate((turning, sliding)):
        for move in scale_moves(choice, widths):
            after = joint_widths(move.after)
            assert after[j] in widths.scales and after[j] != before[j]
            assert after[1 - j] == before[1 - j]
            assert move.label.endswith(("of turning joints", "of sliding joints")[j])


def test_stribeck_velocities_are_those_of_each_joints_width(begun):
    choice = begun.plain.choice
    speeds = np.array([9.0, 9.0])
    moves = [
        m
        for m in term_moves(choice, [0, 1], [], [], speeds)
        if m.kind == "stribeck_velocity"
    ]
    for j, width in enumerate(joint_widths(choice)):
        own = [m.change(choice.drive[j]) for m in moves if m.lacking == (j,)]
        found = tuple(table.stribeck_velocity for table in own)
        assert found == stribeck_velocities(width)
    assert list(stribeck_moves(choice)) == []


@pytest.mark.slow
def test_each_joint_gets_its_width(tmp_path):
    chosen = draft_problem(*written(tmp_path)).selection.choice
    assert joint_widths(chosen) == (TURNS, SLIDES)
    assert not any(d.drag or d.stribeck_velocity for d in chosen.drive)


@pytest.mark.slow
def test_joints_that_all_turn_have_one_width(tmp_path):
    files = written(tmp_path, kind="revolute")
    chosen = draft_problem(*files).selection.choice
    assert len(set(joint_widths(chosen))) == 1
