"""Values with their errors, as people read them, and the limits of what is shown."""

from dataclasses import replace

import numpy as np
import pytest

from consistent_id import ProblemError, Recording
from consistent_id.estimation.delayed_commands import CommandDelay
from consistent_id.estimation.drive_calibration import CalibrationFit
from consistent_id.estimation.expected_error import ExpectedError, expected_error
from consistent_id.estimation.influence import Influence
from consistent_id.estimation.left_out import LeftOutErrors
from consistent_id.estimation.radius_and_delay import (
    ContactRadius,
    RadiusAndDelay,
    TorqueDelay,
    with_radii,
    without_torque_delay,
)
from consistent_id.estimation.transmission_springs import JointSprings
from consistent_id.recordings import ContactFlags


def calibration(**changes):
    """Delay 2 ms, scales 1.1 and 1.2, biases of 3 and -4 mrad."""
    values = {
        "joints": ("a", "b"),
        "found": ("delay", "scale", "encoder_bias"),
        "values": [0.002, 1.1, 1.2, 0.003, -0.004],
        "standard_errors": [1e-4, 0.01, 0.02, 1e-3, 2e-3],
        "unknown": np.zeros((0, 5)),
    }
    return CalibrationFit(**values | changes)


def test_a_calibration_is_shown_joint_by_joint_with_its_errors():
    table = calibration().table()
    assert table.title == "Drives and encoders; commands are late by 2.000 +- 0.100 ms"
    assert table.header == ("joint", "torque scale", "encoder bias [mrad, mm]")
    assert table.rows == (
        ("a", "1.100 +- 0.010", "3.000 +- 1.000"),
        ("b", "1.200 +- 0.020", "-4.000 +- 2.000"),
    )
    assert len(table.notes) == 2
    bias = calibration(found=("encoder_bias",)).table()
    assert bias.title == "Drives and encoders"
    assert bias.rows[1] == ("b", "-4.000 +- 2.000")
    scale = calibration(found=("scale",)).table()
    assert scale.rows[1] == ("b", "1.200 +- 0.020")
    assert len(scale.notes) == 1
    assert calibration(found=("delay",)).table().rows == ()


def test_values_with_a_large_part_in_what_is_unknown_are_not_shown():
    """Beyond 0.3 of the largest entry."""
    hidden = calibration(unknown=[[0.0, 1.0, -0.31, 0.29, 0.0]])
    assert hidden.known.tolist() == [True, False, False, True, True]
    table = hidden.table()
    assert table.rows[1] == ("b", "not known", "-4.000 +- 2.000")
    assert any("not known:" in note for note in table.notes)
    small = calibration(unknown=[[0.0, 0.01, -0.0029, 0.0, 0.0]])
    assert small.known.tolist() == [True, False, True, True, True]
    own = calibration().calibration
    assert (own.delay, own.scale.tolist()) == (0.002, [1.1, 1.2])
    assert own.encoder_bias.tolist() == [0.003, -0.004]


def test_delays_of_commands_are_shown_in_order():
    found = CommandDelay(0.0064, 2e-4, [0.01, 0.0, 0.005], [1.5, 2.0, 1.0])
    assert found.table().title == "Commands are late by 6.40 +- 0.20 ms"
    assert found.table().rows == (("0", "2.0000"), ("5", "1.0000"), ("10", "1.5000"))


def test_a_compliance_is_shown_as_a_stiffness_and_no_spring_as_rigid():
    springs = JointSprings(("a", "b"), [0.01, 0.0], [1e-3, 0.0], 0.8)
    assert springs.stiffness.tolist() == [100.0, np.inf]
    # The error of 1 / c is that of c over its square.
    assert springs.table().rows == (("a", "100 +- 10"), ("b", "rigid"))
    assert "misfit 0.800 of a rigid" in springs.table().title


@pytest.mark.parametrize(
    ("largest", "elsewhere", "small"),
    [
        ((0.99, 0.5), 0.99, True),
        ((1.0, 0.5), 0.5, False),
        ((0.5, 1.0), 0.5, False),
        ((0.5, 0.5), 1.0, False),
        ((0.5, 0.5), np.nan, False),
    ],
)
def test_a_part_is_small_that_changes_less_than_chance_and_misfit(
    largest, elsewhere, small
):
    found = Influence(*largest, elsewhere)
    assert found.small is small
    assert found.largest == max(largest)


def test_an_error_of_all_the_torque_predicts_nothing():
    assert ExpectedError(0.999, 0.5, 0.999).predicts
    assert not ExpectedError(1.0, 0.5, 1.0).predicts
    assert ExpectedError(0.5, 0.25, 1.0).range == "25 % to over 100 %"
    assert ExpectedError(0.5, 0.25, 0.999).range == "25 % to 100 %"
    assert ExpectedError(0.5, 0.5, 0.5).range == "50 %"
    one = ExpectedError(0.5, 0.25, 1.0)
    assert [one.contains(e) for e in (0.24, 0.25, 1.0, 1.01)] == [
        False,
        True,
        True,
        False,
    ]
    for wrong in (
        (0.5, 0.6, 0.7),
        (0.5, 0.4, 0.49),
        (0.5, -0.1, 0.7),
        (0.5, 0.4, np.inf),
    ):
        with pytest.raises(ProblemError, match="finite values in order"):
            ExpectedError(*wrong)


def test_the_range_of_errors_is_students_for_their_logarithms():
    """Tables have 1.886 for 80 % and two degrees of freedom."""
    errors = 0.1 * np.exp([[-0.3, 0.0, 0.3]])
    shares = np.full(3, 1.0 / 3.0)
    left = LeftOutErrors(errors, shares, np.ones(1), np.ones(1))
    found = expected_error(left)
    factor = np.exp(1.8856 * 0.3 * np.sqrt(4.0 / 3.0))
    assert found.error == left.pooled[0] == pytest.approx(np.sqrt(np.mean(errors**2)))
    assert found.high == pytest.approx(found.error * factor, rel=1e-4)
    assert found.low == pytest.approx(found.error / factor, rel=1e-4)
    never = LeftOutErrors([[0.1, np.inf, 0.1]], shares, np.ones(1), np.ones(1))
    assert expected_error(never) is None
    # An error of nothing counts as a millionth of all errors.
    exact = LeftOutErrors([[0.1, 0.0]], [0.5, 0.5], np.ones(1), np.ones(1))
    logs = np.log([0.1, 1e-6 * exact.pooled[0]])
    wide = np.exp(3.0777 * np.std(logs, ddof=1) * np.sqrt(1.5))
    assert expected_error(exact).high == pytest.approx(exact.pooled[0] * wide, rel=1e-2)


def both(offset=0.01, seconds=0.002, shared=0.5):
    sizes = np.array([0.001, 0.0004])
    covariance = np.array([[1.0, shared], [shared, 1.0]]) * np.outer(sizes, sizes)
    return RadiusAndDelay(
        ContactRadius(offset, sizes[0], 5.0), TorqueDelay(seconds, sizes[1]), covariance
    )


def test_a_delay_is_significant_beyond_its_interval():
    """Student's 97.5 % are 2.571 for five degrees of freedom, 1.960 for many."""
    assert ContactRadius(0.01, 0.001, 5.0).half_width == pytest.approx(
        0.002571, rel=1e-3
    )
    for seconds, significant in ((1.95e-3, False), (1.97e-3, True), (-1.97e-3, True)):
        assert TorqueDelay(seconds, 1e-3).significant is significant


@pytest.mark.parametrize("shared", [0.0, 0.5, -1.0])
def test_independent_changes_add_up_to_the_covariance(shared):
    found = both(shared=shared)
    total = np.sum([np.outer(each, each) for each in found.changes()], axis=0)
    np.testing.assert_allclose(total, found.covariance, atol=1e-18)
    assert len(found.changes()) == (1 if abs(shared) == 1.0 else 2)
    alone = replace(found, feet=None, covariance=np.diag([0.0, 4e-6]))
    assert np.abs(alone.changes()).tolist() == [[0.0, 0.002]]


def test_widened_errors_are_half_intervals_over_a_quantile():
    wide = both().widened(2.0)
    sizes = np.array([2.5706 * 0.001, 1.95996 * 0.0004]) / 2.0
    expected = np.array([[1.0, 0.5], [0.5, 1.0]]) * np.outer(sizes, sizes)
    np.testing.assert_allclose(wide.covariance, expected, rtol=1e-4)
    alone = replace(both(), feet=None, covariance=np.diag([0.0, 1.6e-7])).widened(2.0)
    np.testing.assert_allclose(
        alone.covariance, np.diag([0.0, sizes[1] ** 2]), rtol=1e-4
    )


def test_corrections_move_torque_and_change_round_feet():
    time = np.arange(50) / 100.0
    flags = [
        ContactFlags("round", np.ones(50, dtype=bool), radius=0.02),
        ContactFlags("point", np.ones(50, dtype=bool)),
    ]
    torque = np.sin(3.0 * time)[:, None]
    log = Recording(("j",), time, 0.0 * torque, torque=torque, contacts=flags)
    found = both(seconds=0.0025).applied(log)
    assert [each.radius for each in found.contacts] == [pytest.approx(0.03), 0.0]
    expected = np.sin(3.0 * (time + 0.0025))
    np.testing.assert_allclose(found.torque[:-1, 0], expected[:-1], atol=1e-6)
    assert found.torque[-1] == torque[-1]  # at the end, the last value stays
    assert without_torque_delay(log, 0.0) is log
    assert with_radii(log, 0.0) is log
    nothing = RadiusAndDelay(None, None, np.zeros((2, 2)))
    assert nothing.applied(log) is log
    assert nothing.changes() == []
