"""The pendulum of tests of servos, in a file."""

import pytest
from servo_pendulum import PENDULUM

from consistent_id.robot.loaders.robot_file import load_robot


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("servo") / "pendulum.urdf"
    path.write_text(PENDULUM)
    return path


@pytest.fixture(scope="module")
def pendulum(file):
    return load_robot(file)
