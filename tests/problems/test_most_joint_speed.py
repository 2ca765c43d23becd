"""Rows of joints beyond a speed are left out: of that joint alone, near it as well."""

import numpy as np
import pytest
from logged import write_arm

import consistent_id as ci
from consistent_id.cli import main


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return write_arm(tmp_path_factory.mktemp("arm"))


def training(arm, **stated):
    draft = ci.draft_problem(*arm, select=False, cutoff=10.0, **stated)
    return draft.problem(arm[0].parent).training


def slow(arm, limit):
    """The arm with another speed limit of the elbow."""
    urdf = arm[0].with_name(f"slow{limit:g}.urdf")
    first, second = arm[0].read_text().split('velocity="4"', 1)
    urdf.write_text(
        f'{first}velocity="4"{second}'.replace(
            'velocity="4" effort="60"', f'velocity="{limit}" effort="60"'
        )
    )
    return urdf, arm[1]


def unknown(logs):
    return [
        np.zeros_like(log.position, bool)
        if log.torque_known is None
        else ~log.torque_known
        for log in logs
    ]


def test_without_a_limit_all_rows_count(arm):
    assert not any(mask.any() for mask in unknown(training(arm)))


@pytest.mark.parametrize("limit", [0.8, 1.2])
def test_rows_of_a_joint_beyond_a_speed_are_left_out(arm, limit):
    for log, mask in zip(
        logs := training(arm, most_joint_speed=limit), unknown(logs), strict=True
    ):
        fast = abs(log.velocity) > limit
        assert fast.any() and mask[fast].all()
        # One and a half periods of 10 Hz before and after, and no further.
        for j in range(2):
            times = log.time[fast[:, j]]
            apart = abs(log.time[:, None] - times).min(axis=1)
            assert not mask[apart > 0.15 + 0.011, j].any()
            assert mask[apart < 0.15 - 0.011, j].all()


def test_the_models_limit_is_that_of_each_joint_with_room_for_rounding(arm):
    robot = slow(arm, 1.0)
    whole = unknown(training(robot, most_joint_speed="model"))
    number = unknown(training(robot, most_joint_speed=1.05))
    for one, other in zip(whole, number, strict=True):
        assert one[:, 1].any() and not one[:, 0].any()
        np.testing.assert_array_equal(one[:, 1], other[:, 1])


@pytest.mark.slow
def test_torque_that_lacks_at_speed_no_longer_spoils_the_estimate(arm, tmp_path):
    """Above its rated speed the elbow gives half the commanded torque."""
    logs = training(arm)
    joint, rated = 1, 0.8
    assert (abs(logs[0].velocity[:, joint]) > rated).mean() > 0.05
    table = np.genfromtxt(arm[1], delimiter=",", names=True)
    speed = np.gradient(table["q_elbow"], table["time"])
    table["tau_elbow"] = np.where(abs(speed) > rated, 2.0, 1.0) * table["tau_elbow"]
    log = tmp_path / "log.csv"
    np.savetxt(log, table, "%.9g", ",", header=",".join(table.dtype.names), comments="")

    def misfit(**stated):
        draft = ci.draft_problem(
            arm[0], log, select=False, cutoff=10.0, **stated
        ).problem(tmp_path)
        regression = ci.build_regression(draft.model, draft.training)
        found = ci.estimation.weighted_least_squares(draft.model, regression)
        return regression.residual_rms(found.parameters)[joint]

    assert misfit(most_joint_speed=rated) < 0.25 * misfit()


@pytest.mark.slow
def test_the_finding_names_the_option(arm, capsys):
    urdf, log = slow(arm, 0.5)
    main(["check", str(urdf), str(log), "--verbose"])
    said = " ".join(capsys.readouterr().out.split())
    assert "speed limit" in said and "--most-joint-speed model" in said


@pytest.mark.parametrize("word", ["-1", "fast"])
def test_a_speed_is_a_positive_number_or_the_models(arm, capsys, word):
    assert main(["check", *map(str, arm), f"--most-joint-speed={word}"]) == 2
    assert "expected a positive number" in capsys.readouterr().err
