"""Positions in degrees and high speeds, seen by the limits of the joints."""

from dataclasses import replace

import numpy as np
import pytest
from faulty_logs import arm

from consistent_id import InertialParameters, Recording, RecordingError
from consistent_id.diagnosis.one_log import signal_findings
from consistent_id.diagnosis.wrong_units import (
    model_findings,
    require_lengths_of_sliding,
    speed_findings,
    travel_findings,
)
from consistent_id.robot.model import JointLimits


def _robot(limits):
    robot = arm().robot
    joints = tuple(replace(joint, limits=limits) for joint in robot.joints)
    return replace(robot, joints=joints)


def _swing(factor):
    """Return a log in which all joints travel 3 rad, times a factor."""
    time = np.linspace(0.0, 10.0, 500)
    q = 1.5 * factor * np.sin(time)[:, None] * np.ones(4)
    return Recording(arm().robot.joint_names, time, q)


@pytest.mark.parametrize(
    ("limits", "factor", "found"),
    [
        (JointLimits(-2.0, 2.0), 1.0, []),
        (JointLimits(-2.0, 2.0), 180.0 / np.pi, ["degrees"]),
        # Limits that were drawn too narrow, and none at all.
        (JointLimits(-1.0, 1.0), 1.0, []),
        (JointLimits(), 180.0 / np.pi, []),
        (JointLimits(0.0, 0.0), 1.0, []),
        # Counts of an encoder are no degrees.
        (JointLimits(-2.0, 2.0), 1e4, ["encoder scale"]),
        (JointLimits(), 1e4, []),
    ],
)
def test_travel_in_other_units_is_far_beyond_the_limits(limits, factor, found):
    findings = travel_findings(_robot(limits), _swing(factor))
    assert [f.kind for f in findings] == found


def test_degrees_are_found_beside_a_clock_in_milliseconds():
    """One answer has both units: each of them alone needs another command."""
    model = arm()
    model = replace(model, robot=_robot(JointLimits(-2.0, 2.0)))
    log = _swing(180.0 / np.pi)
    slow = replace(log, time=1000.0 * log.time)
    assert [f.kind for f in signal_findings(model, slow)] == ["clock", "degrees"]


@pytest.mark.parametrize(("scale", "units"), [(1.0, 2), (0.3, 1)])
def test_a_velocity_in_counts_has_their_unit(scale, units):
    log = _swing(651.9)
    rate = scale * np.gradient(log.position, log.time, axis=0)
    (finding,) = travel_findings(
        _robot(JointLimits(-2.0, 2.0)), replace(log, velocity=rate)
    )
    assert finding.advice.count("rev/COUNTS") == units
    assert ("velocity=rev/COUNTS/s" in finding.advice) == (units == 2)


def test_counts_of_encoders_are_named_with_the_option():
    (finding,) = travel_findings(_robot(JointLimits(-2.0, 2.0)), _swing(651.9))
    assert "489 to 489 times the range" in finding.statement
    assert "--units position=rev/COUNTS" in finding.advice
    # A joint at rest has counts, too, but no travel.
    swing = _swing(651.9)
    rests = replace(swing, position=swing.position * [1.0, 1.0, 1.0, 0.0])
    (finding,) = travel_findings(_robot(JointLimits(-2.0, 2.0)), rests)
    assert "489 to 489 times the range" in finding.statement


@pytest.mark.parametrize("factor", [180.0 / np.pi, 100.0, 1e4])
def test_one_joint_of_four_in_another_unit_is_not_all_of_them(factor):
    log = _swing(1.0)
    one = replace(log, position=log.position * [1.0, factor, 1.0, 1.0])
    (finding,) = travel_findings(_robot(JointLimits(-2.0, 2.0)), one)
    assert (finding.kind, finding.where) == ("encoder scale", log.joints[1])


def _sliding(robot, place=1):
    """Return the robot with one joint that slides by 0.2 m at most."""
    limits = JointLimits(0.0, 0.2)
    joints = list(robot.joints)
    joints[place] = replace(joints[place], kind="prismatic", limits=limits)
    return replace(robot, joints=tuple(joints))


def test_a_sliding_joint_in_millimetres_is_named_with_its_unit():
    robot, log = _sliding(_robot(JointLimits(-2.0, 2.0))), _swing(1.0)
    metres = replace(log, position=log.position * [1.0, 0.05, 1.0, 1.0])
    assert not travel_findings(robot, metres)
    one = replace(log, position=log.position * [1.0, 50.0, 1.0, 1.0])
    (finding,) = travel_findings(robot, one)
    assert (finding.kind, finding.where) == ("encoder scale", log.joints[1])
    assert "750 times the range" in finding.statement
    assert "0.75 times if its position is in mm" in finding.statement
    assert f"--position-scale {log.joints[1]}=0.001" in finding.advice


def test_one_unit_of_length_of_joints_that_turn_is_refused():
    robot = _sliding(_robot(JointLimits(-2.0, 2.0)))
    with pytest.raises(RecordingError, match="in mm, but joint1, joint3") as refused:
        require_lengths_of_sliding(robot, {"position": "mm"})
    assert "--position-scale joint2=0.001" in str(refused.value)
    for units in ({}, {"position": "deg"}, {"position": ("rad", "mm", "rad", "rad")}):
        require_lengths_of_sliding(robot, units)


@pytest.mark.parametrize(
    ("rated", "severity"),
    [
        ([1.3, 2.0, 3.0, 4.0], "warning"),  # the joints reach 1.5 rad/s
        ([1.3] * 4, "note"),  # equal limits may be placeholders
        ([1.5, 2.0, 3.0, 4.0], None),
        ([0.0, np.inf, 3.0, 4.0], None),  # not known
    ],
)
def test_joints_beyond_their_speed_limits_are_reported(rated, severity):
    log = _swing(1.0)
    speed = 1.5 * np.cos(log.time)[:, None] * np.ones(4)
    limits = [JointLimits(-2.0, 2.0, velocity=v) for v in rated]
    robot = arm().robot
    joints = zip(robot.joints, limits, strict=True)
    robot = replace(robot, joints=tuple(replace(j, limits=one) for j, one in joints))
    found = speed_findings(robot, replace(log, velocity=speed))
    assert [f.severity for f in found] == ([severity] if severity else [])
    if severity == "warning":
        assert found[0].where == log.joints[0]
        # |cos t| > 1.365 / 1.5 for 30 % of the time.
        assert "up to 1.15 times, in 30%" in found[0].statement
        fast = abs(speed) > 1.3
        left_out = replace(log, velocity=speed, torque_known=~fast)
        assert not speed_findings(robot, left_out)
        late = log.time > 0.5 * log.time[-1]
        half = ~fast | late[:, None]
        (rest,) = speed_findings(robot, replace(left_out, torque_known=half))
        share = np.mean(late & (abs(speed[:, 0]) > 1.05 * 1.3))
        assert f"up to 1.15 times, in {share:.0%} of" in rest.statement


def test_equal_inertials_are_placeholders_or_accepted():
    robot = arm().robot
    body = InertialParameters.from_central(1.0, (0, 0, 0.1), 0.01 * np.eye(3))
    links = tuple(replace(link, nominal=body) for link in robot.links)
    (found,) = model_findings(replace(robot, links=links))
    assert found.kind == "placeholder inertials"
    assert '--accept "placeholder inertials"' in found.advice


def test_counts_from_zero_on_say_the_counts_of_a_turn_and_where_the_zero_is():
    """As of hobby servos: half a turn of 4096 is the middle of their range."""
    swing = _swing(651.9)
    counts = replace(swing, position=np.round(swing.position + 2048.0))
    (finding,) = travel_findings(_robot(JointLimits(-2.0, 2.0)), counts)
    assert "(--units position=rev/4096)" in finding.advice
    zeros = " ".join(f"{joint}=-3.14159" for joint in counts.joints)
    assert f"--position-offset {zeros}" in finding.advice
    odd = replace(counts, position=counts.position + 0.25)
    (finding,) = travel_findings(_robot(JointLimits(-2.0, 2.0)), odd)
    assert "rev/COUNTS" in finding.advice
