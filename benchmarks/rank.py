"""Whether rounded angles of a robot's file invent base parameters.

``python benchmarks/rank.py`` takes half a minute.  Published robots' joint frames are
given as roll, pitch and yaw of 2 to 7 decimals: right angles become 1.57, 1.571, ...
The base parameters should stay those of the robot with exact angles.  Random robots,
whose weak columns are true ones, should keep them all.
"""

from collections import Counter
from dataclasses import replace

import numpy as np

import consistent_id as ci
from consistent_id.export.urdf_export import rpy_of
from consistent_id.regression.linear import (
    STRUCTURAL_TOLERANCE,
    independent_columns,
    split_at_gap,
)
from consistent_id.regression.row_structure import random_regressor

DIGITS = range(2, 8)
RIGHT = np.pi / 2
TABLES = {
    "UR10": (
        (0, 1, 0, 0, 1, -1),
        (0, 0, -0.6, -0.57, 0, 0),
        (0.1, 0, 0, 0.2, 0.1, 0.1),
    ),
    "on its head": ((2, 1, 0, 0), (0, 0, -0.6, -0.57), (0.1, 0, 0, 0.2)),
    "Panda": (
        (0, -1, 1, 1, -1, 1, 1),
        (0, 0, 0, 0.1, -0.1, 0, 0.1),
        (0.3, 0, 0.3, 0, 0.4, 0, 0),
    ),
    "SCARA": ((0, 0, 0, 2), (0, 0.3, 0.25, 0), (0.4, 0, 0, 0)),
}
RANDOM = 200


def main() -> None:
    robots = {name: arm(name) for name in TABLES}
    print("base parameters: exact; per number of decimals without and with the gap")
    for name, robot in robots.items():
        found = [pair(rounded(robot, digits)) for digits in DIGITS]
        pairs = zip(DIGITS, found, strict=True)
        told = ", ".join(f"{digits}: {a} {b}" for digits, (a, b) in pairs)
        print(f"{name}: {pair(robot)[0]}; {told}")
    lost: Counter[int] = Counter()
    rng = np.random.default_rng(0)
    for _ in range(RANDOM):
        all_of_them, kept = pair(random_arm(rng, int(rng.integers(2, 8))))
        lost[all_of_them - kept] += 1
    print(f"random robots by the number of true columns lost: {dict(lost)}")


def arm(name: str) -> ci.RobotModel:
    rows = zip(*TABLES[name], strict=True)
    return ci.from_modified_dh(name, [ci.DHRow(t * RIGHT, a, d) for t, a, d in rows])


def rounded(robot: ci.RobotModel, digits: int) -> ci.RobotModel:
    """Return the robot as a URDF with angles of so many decimals has it."""
    joints = [
        replace(joint, rotation=from_rpy(np.round(rpy_of(joint.rotation), digits)))
        for joint in robot.joints
    ]
    return replace(robot, joints=tuple(joints))


def from_rpy(angles: np.ndarray) -> np.ndarray:
    R = np.eye(3)
    for axis, angle in zip(np.eye(3)[::-1], angles[::-1], strict=True):
        K = np.cross(np.eye(3), axis)
        R = R @ (np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K)
    return R


def random_arm(rng: np.random.Generator, joints: int) -> ci.RobotModel:
    """Return a chain of any twists and lengths, of turning and sliding joints."""
    rows = [
        ci.DHRow(*rng.uniform(-1.0, 1.0, 3) * (3.0, 1.0, 1.0), kind=str(kind))
        for kind in rng.choice(["revolute", "prismatic"], joints, p=[0.8, 0.2])
    ]
    return ci.from_modified_dh("random", rows, gravity=rng.normal(size=3))


def pair(robot: ci.RobotModel) -> tuple[int, int]:
    """Return how many columns are independent, without and with the gap."""
    model = ci.TorqueModel(robot)
    W = np.concatenate(list(random_regressor(model)), axis=1).T
    plain = independent_columns(W, STRUCTURAL_TOLERANCE)
    judged = split_at_gap(W, model.layout.kinds).split
    return len(plain.independent), len(judged.independent)


if __name__ == "__main__":
    main()
