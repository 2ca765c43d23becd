"""Motions checked by Pinocchio and coal on the complete robot, at 1 kHz."""

import sys
from pathlib import Path

import numpy as np
import pytest
from published_robots import FOLDER

from consistent_id._support.run import Run, running
from consistent_id.excitation.playable import playable_design
from consistent_id.excitation.sources import problem_to_excite
from consistent_id.motion import write_trajectory

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
import independent_collisions as independent

PANDA = FOLDER / "panda_description" / "urdf" / "panda.urdf"
ARM = [f"panda_joint{k}" for k in range(1, 8)]
pytestmark = pytest.mark.skipif(
    not PANDA.exists(), reason="example-robot-data is missing"
)


def _table(path, positions):
    head = ",".join(["time", *(f"q_{joint}" for joint in ARM)])
    rows = [",".join(map(str, [0.001 * k, *q])) for k, q in enumerate(positions)]
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def test_the_check_sees_fingers_in_the_base_and_a_hand_in_the_floor(tmp_path):
    robot = independent.CompleteRobot(PANDA, ARM, [independent.FLOOR])
    folded = np.array([-1.3, 0.6, -1.1, -3.0, -2.4, 3.7, 2.5])
    upright = np.array([0.0, 0.0, 0.0, -1.6, 0.0, 1.6, 0.0])
    low = np.array([0.0, 1.7, 0.0, -0.5, 0.0, 2.0, 0.0])
    found = robot.touches(_table(tmp_path / "a.csv", [upright, folded, low, upright]))
    touched = {frozenset((one.first, one.second)) for one in found}
    assert any("floor" in two for two in touched)
    assert any("panda_link0_0" in two for two in touched)
    assert not robot.touches(_table(tmp_path / "b.csv", [upright] * 3))
    # Panda's pairs by hand: 17 shapes, fingers on one hand, chain of nine links.
    assert not robot.overlapping and robot.pairs > 80


@pytest.mark.slow
@pytest.mark.parametrize(("tip", "rest"), [("panda_link8", True), (None, False)])
def test_no_body_touches_in_any_motion_of_a_panda_at_a_wall(tmp_path, tip, rest):
    file = tmp_path / "problem.toml"
    boxes = independent.around("wall", 1.0)
    file.write_text(independent.problem_text(PANDA, tip, boxes, rest=rest))
    with running(Run(trust=True)):
        problem = problem_to_excite(file, {})
        found = playable_design(problem, starts=1, workers=1, time_limit=1.0)
    # Of the periodic validation paths, the best conditioned one has no run-in.
    assert set(found.moves) == {"trajectory", "validation"}
    assert not found.design.demands.scene.unchecked
    moving = problem.moving.joint_names
    robot = independent.CompleteRobot(PANDA, moving, boxes)
    for name, move in found.moves.items():
        table = tmp_path / f"{name}.csv"
        write_trajectory(move, table, rate=1000.0)
        assert robot.touches(table) == []
