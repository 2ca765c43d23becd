"""Robots of the package example-robot-data, if it is there."""

from pathlib import Path

import pinocchio as pin

from consistent_id.robot import lint_urdf

FOLDER = Path(pin.__file__).parents[4] / "share" / "example-robot-data" / "robots"
NO_ROBOTS = ("quadrotor_base.urdf", "iris_simple.urdf", "ur3.urdf")  # nothing moves
FILES = sorted(FOLDER.rglob("*.urdf"))


def leaderless(path):
    """Names of the joints that follow what there is not, from the lint's sentences."""
    sentences = [f.sentence for f in lint_urdf(path) if "there is none" in f.sentence]
    return [s.split("'")[1] for s in sentences if "follows" in s]
