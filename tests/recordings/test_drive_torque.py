"""The torque of drives from commands, in closed form, and values that cannot be."""

from dataclasses import replace

import numpy as np
import pytest

from consistent_id import Recording, RecordingError
from consistent_id.recordings.signals import (
    decimated,
    differentiated,
    low_passed,
    resampled,
)
from consistent_id.recordings.signals.drive_torque import (
    DriveCalibration,
    PDGains,
    calibrated,
    commanded,
    stiffness_of,
)

TIME = np.arange(6) / 10.0


def log(**more):
    """Positions of 1 and 2, at rest; commands that rise by one a sample from zero."""
    rising = np.column_stack([np.arange(6.0)] * 2)
    values = {"position_command": rising} | more
    position = np.tile([1.0, 2.0], (6, 1))
    return Recording(("a", "b"), TIME, position, 0.0 * position, **values)


def test_a_command_acts_half_a_step_and_its_delay_later():
    # At sample 3 the command of 2.5 steps acts, of 1.5 steps with a delay of 0.1 s.
    for delay, command in ((0.0, 2.5), (0.1, 1.5), (0.025, 2.25)):
        torque = commanded(log(), PDGains(10.0, 1.0), delay=delay).torque
        np.testing.assert_allclose(torque[3], 10.0 * (command - np.array([1.0, 2.0])))
    early = commanded(log(), PDGains(10.0, 1.0), delay=5.0).torque
    np.testing.assert_allclose(early[-1], [-10.0, -20.0])  # the first command holds


def test_the_error_of_a_delay_shifts_the_torque():
    """Commands rise by 10 a second: 50 ms more of delay take off 10 * 0.5."""
    gains = PDGains(10.0, 1.0)
    for delay in (0.0, 0.02, 0.1):
        found = commanded(log(), gains, delay=delay, delay_error=0.05)
        np.testing.assert_allclose(found.torque_shift[3], [-5.0, -5.0])
        plain = commanded(log(), gains, delay=delay)
        assert plain.torque_shift is None
        np.testing.assert_array_equal(found.torque, plain.torque)
    limited = PDGains(10.0, 1.0, [100.0, 1e-3])
    found = commanded(log(), limited, delay=0.1, delay_error=0.05)
    assert found.torque_shift[5].tolist() == pytest.approx([-5.0, 0.0])
    known = DriveCalibration(0.1, [1.0, 2.0], delay_error=0.05)
    np.testing.assert_allclose(
        calibrated(log(), gains, known.of(2)).torque_shift[3], [-5.0, -10.0]
    )


def test_a_shift_passes_what_the_torque_passes():
    time = np.arange(400) / 100.0
    wave = np.sin(np.outer(time, [3.0, 5.0]))
    raw = Recording(("a", "b"), time, wave, position_command=1.1 * wave)
    made = commanded(raw, PDGains(10.0, 1.0), delay=0.02, delay_error=0.01)
    same = replace(made, torque=made.torque_shift)  # so the torque shows it

    def prepared(log):
        log = differentiated(resampled(log, 80.0))
        return decimated(low_passed(log, motion_cutoff=8.0, torque_cutoff=8.0), 2)

    found = prepared(same)
    np.testing.assert_allclose(found.torque_shift, found.torque)
    assert len(found) < 170 and found.torque_filter is not None
    part = found.of(("b",)).samples(slice(3, 9))
    np.testing.assert_array_equal(part.torque_shift, found.torque[3:9, 1:])
    assert prepared(made).torque_shift is not None
    assert prepared(raw).torque_shift is None


def test_gains_act_on_differences_and_feed_forward_is_added():
    rate = np.tile([3.0, -1.0], (6, 1))
    told = log(velocity_command=rate, torque_command=0.5 * rate)
    moving = replace(told, velocity=np.tile([1.0, 1.0], (6, 1)))
    torque = commanded(moving, PDGains([10.0, 20.0], [2.0, 4.0])).torque[3]
    # 10 (2.5 - 1) + 2 (3 - 1) + 1.5, and 20 (2.5 - 2) + 4 (-1 - 1) - 0.5
    np.testing.assert_allclose(torque, [20.5, 1.5])
    limited = commanded(moving, PDGains([10.0, 20.0], [2.0, 4.0], [20.0, 1.0]))
    np.testing.assert_allclose(limited.torque[3], [20.0, 1.0])
    other = replace(moving, position=moving.position + 9.0)
    limited = commanded(other, PDGains([10.0, 20.0], [2.0, 4.0], [20.0, 1.0]))
    np.testing.assert_allclose(limited.torque[3], [-20.0, -1.0])


def test_a_calibration_scales_drives_and_turns_encoders():
    found = DriveCalibration(0.1, [2.0, 3.0], [0.25, -0.5])
    told = log(torque_command=np.ones((6, 2)))
    true = found.log(told)
    assert true.position[0].tolist() == [0.75, 2.5]
    assert true.position_command[3].tolist() == [2.75, 3.5]
    assert true.torque_command[0].tolist() == [2.0, 3.0]
    torque = calibrated(told, PDGains(10.0, 1.0, 100.0), found).torque[3]
    # Scale times 10 (command 1.5 late steps - reading) + 1: the bias is in both.
    np.testing.assert_allclose(torque, [2.0 * 6.0, 3.0 * -4.0])
    assert found.log(log()).torque_command is None
    gains = found.gains(PDGains(10.0, 1.0, 100.0))
    assert gains.kp.tolist() == [20.0, 30.0]
    assert gains.kd.tolist() == [2.0, 3.0]
    assert gains.torque_limit.tolist() == [200.0, 300.0]


def test_springs_in_series_add_their_compliances():
    soft = DriveCalibration(compliance=[0.01, 0.0])
    gains = soft.gains(PDGains(10.0, 1.0, stiffness=[100.0, 50.0]))
    assert gains.stiffness == pytest.approx([50.0, 50.0])
    rigid = soft.gains(PDGains(10.0, 1.0))
    assert rigid.stiffness == pytest.approx([100.0, np.inf])
    assert stiffness_of(np.array([0.5, 0.0])).tolist() == [2.0, np.inf]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scale": [1.0, 0.0]}, "scale is"),
        ({"compliance": [0.0, -1e-9]}, "compliance is"),
        ({"delay": -1e-9}, "delay of commands is"),
        ({"delay": np.inf}, "delay of commands is"),
        ({"delay_error": -1e-9}, "error of the delay of commands is"),
        ({"delay_error": np.inf}, "error of the delay of commands is"),
        ({"encoder_bias": np.nan}, "encoder_bias"),
    ],
)
def test_calibrations_that_cannot_be_are_refused(changes, message):
    with pytest.raises(RecordingError, match=message):
        DriveCalibration(**changes)


def test_delays_and_numbers_of_joints_are_checked():
    commanded(log(), PDGains(1.0, 1.0), delay=0.0)
    for wrong in (-1e-9, np.inf, np.nan):
        with pytest.raises(RecordingError, match="delay of commands is"):
            commanded(log(), PDGains(1.0, 1.0), delay=wrong)
        with pytest.raises(RecordingError, match="error of the delay of commands is"):
            commanded(log(), PDGains(1.0, 1.0), delay_error=wrong)
    with pytest.raises(RecordingError, match="has 3 values for 2 joints"):
        commanded(log(), PDGains([1.0] * 3, 1.0))
    with pytest.raises(RecordingError, match="has 3 values for 2 joints"):
        DriveCalibration(scale=[1.0] * 3).of(2)
    assert DriveCalibration().of(2).scale.tolist() == [1.0, 1.0]
    with pytest.raises(RecordingError, match="no position_command"):
        commanded(log(position_command=None), PDGains(1.0, 1.0))


def test_drives_are_exact_unless_more_is_known():
    stated = PDGains(30.0, 2.0, torque_limit=50.0, stiffness=400.0)
    found, plain = DriveCalibration(), DriveCalibration(0.0, 1.0, 0.0, 0.0)
    assert found.delay == plain.delay
    for name in ("kp", "kd", "torque_limit", "stiffness"):
        assert getattr(found.gains(stated), name) == getattr(stated, name)
    for name in ("scale", "encoder_bias", "compliance"):
        assert getattr(found, name) == getattr(plain, name)
