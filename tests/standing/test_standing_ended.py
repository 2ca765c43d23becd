"""A search on feet that is ended early keeps its best path."""

import os
import re
import signal

import numpy as np
import pytest
from quadrupeds import CORNERS, FEET, FOOT, quadruped_text

import consistent_id as ci
from consistent_id._support.run import Run, running, signals_raised
from consistent_id.standing.forces_and_limits import StandingLimits
from consistent_id.standing.stance import Stance, StandingFoot
from consistent_id.standing.standing_design import design_standing
from consistent_id.standing.standing_files import standing_record, standing_tables

POSE = np.tile([0.1, 0.2, -0.9], 4)


@pytest.fixture(scope="module")
def stance(tmp_path_factory):
    file = tmp_path_factory.mktemp("standing") / "robot.xml"
    file.write_text(quadruped_text(hips=CORNERS))
    robot = ci.robot.load_mjcf(file, base="floating")
    point = np.array([FOOT])
    return Stance(robot, tuple(StandingFoot(f, point, False) for f in FEET), POSE)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "stopped", "said"),
    [
        (None, "", "the time limit of 0.5 s"),
        (signal.SIGINT, "interrupted", "an interrupt"),
        (signal.SIGTERM, "terminated", "an interrupt"),
    ],
)
def test_an_ended_search_keeps_its_best_path(stance, number, stopped, said):
    drive = ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02)

    def told(done, error):
        if number is not None and np.isfinite(error):
            os.kill(os.getpid(), number)

    run = Run()
    with signals_raised(run), running(run):
        found = design_standing(
            stance,
            ci.TorqueModel(stance.robot, drive),
            StandingLimits(velocity=6.0, effort=40.0),
            duration=4.0,
            candidates=1000,
            time_limit=0.5 if number is None else np.inf,
            tell=told,
        )
    assert run.stopped == stopped and found.cut_short == said
    assert 1 <= found.candidates <= 32 and found.checked.largest <= 1.0
    text = " ".join(standing_tables(found)[0].text().split())
    assert f"{said} ended the search" in text
    moved = np.ptp(found.checked.joints.q, axis=0)  # no joint has a range
    least = stance.robot.joint_names[int(moved.argmin())]
    assert re.search(f"(hardly moves?|least moved): {least}", text)
    assert least in standing_record(found)["least_moved"]


@pytest.mark.slow
def test_without_a_path_the_message_says_that_time_ended_the_search(stance):
    drive = ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02)
    with pytest.raises(ci.InfeasibleError, match=r"0 s, twice the time limit, ended"):
        design_standing(
            stance,
            ci.TorqueModel(stance.robot, drive),
            StandingLimits(velocity=1e-3, effort=40.0),
            duration=4.0,
            candidates=1000,
            time_limit=0.0,
        )
