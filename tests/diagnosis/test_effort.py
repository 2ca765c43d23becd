"""One torque in another unit, seen by the effort limits of the joints."""

from dataclasses import replace

import numpy as np
import pytest
from faulty_logs import arm, clean_log

from consistent_id.diagnosis.wrong_units import effort_findings
from consistent_id.robot.model import JointLimits


def _robot(efforts):
    robot = arm().robot
    joints = tuple(
        replace(joint, limits=JointLimits(-2.0, 2.0, effort=effort))
        for joint, effort in zip(robot.joints, efforts, strict=True)
    )
    return replace(robot, joints=joints)


@pytest.mark.parametrize(
    ("efforts", "factor", "found"),
    [
        ([300.0] * 4, 1.0, False),
        ([300.0] * 4, 1e3, True),
        ([1e5] * 4, 1e6, True),
        # Placeholders: too low for all, for one, and none.
        ([1.0] * 4, 1.0, False),
        ([300.0, 20.0, 300.0, 300.0], 1.0, False),
        ([np.inf] * 4, 1e3, False),
        # Nor is a gain of five a unit.
        ([300.0] * 4, 5.0, False),
    ],
)
def test_one_torque_far_beyond_its_limit_as_no_other_is_in_another_unit(
    efforts, factor, found
):
    log = clean_log(0)
    spoilt = replace(log, torque=log.torque * [1.0, factor, 1.0, 1.0])
    said = effort_findings(_robot(efforts), spoilt)
    assert [(f.kind, f.where) for f in said] == (
        [("torque unit", log.joints[1])] if found else []
    )


@pytest.mark.parametrize(
    ("limits", "shares", "found"),
    [
        # One alone: above ten times its limit, a hundred times another's share.
        ([80.0] * 4, [11.0, 0.1, 0.1, 0.1], "joint1"),
        ([80.0] * 4, [9.0, 0.05, 0.05, 0.05], None),
        ([80.0] * 4, [2000.0, 30.0, 0.1, 0.1], None),
        ([80.0, 0.0, 80.0, 80.0], [11.0, 9.9, 0.1, 0.1], "joint1"),  # one not known
        # All: limits that differ, above three times all and ten times most.
        ([80.0, 60.0, 40.0, 20.0], [4.0, 12.0, 12.0, 12.0], "all joints"),
        ([80.0] * 4, [4.0, 12.0, 12.0, 12.0], None),
        ([80.0, 60.0, 40.0, 20.0], [2.0, 12.0, 12.0, 12.0], None),
        ([80.0, 60.0, 40.0, 20.0], [4.0, 8.0, 8.0, 12.0], None),
    ],
)
def test_what_is_beyond_limits_is_so_by_the_factors_that_are_stated(
    limits, shares, found
):
    torque = np.array(shares) * np.where(np.array(limits) > 0.0, limits, 1.0)
    log = clean_log(0).samples(slice(0, 10))
    said = effort_findings(
        _robot(limits), replace(log, torque=np.tile(torque, (10, 1)))
    )
    assert [f.where for f in said] == ([] if found is None else [found])


def test_torques_that_no_joint_could_give_are_in_another_unit():
    log = clean_log(0)
    strong = replace(log, torque=100.0 * log.torque)
    usual = np.quantile(abs(log.torque), 0.95, axis=0)
    (finding,) = effort_findings(_robot(2.0 * usual), strong)
    assert (finding.kind, finding.where) == ("torque unit", "all joints")
    assert "50 to 50 times" in finding.statement
    for factor, option in ((100.0, "Ncm"), (1000.0, "mNm"), (3000.0, None)):
        several = replace(log, torque=factor * log.torque)
        (finding,) = effort_findings(_robot(2.0 * usual), several)
        proposed = f"--units torque={option}?" if option else "times 0.0007?"
        assert proposed in finding.advice
    # Limits that are all alike say nothing, and so do those of weak drives.
    assert effort_findings(_robot([0.5] * 4), log) == []
    assert effort_findings(_robot(usual / 2.0), log) == []
