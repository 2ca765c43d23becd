"""Input that is subtly wrong: refused, or read right, never wrong in silence."""

import datetime

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from logged import write_arm

from consistent_id import (
    DHRow,
    FixedMasses,
    PhysicalConsistency,
    constrained_least_squares,
    from_modified_dh,
    signals,
)
from consistent_id._support.files import write_atomically
from consistent_id.cli import main
from consistent_id.errors import (
    ConsistentIdError,
    InfeasibleError,
    NotExcitedError,
    ProblemError,
    RecordingError,
)
from consistent_id.problems import drafting
from consistent_id.recordings.readers import Columns, read_recording
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import condition_number
from consistent_id.regression.regression import build_regression
from consistent_id.regression.regressor import TorqueModel

ARM = TorqueModel(from_modified_dh("arm", [DHRow(0, 0), DHRow(-np.pi / 2, 0.1)]))
NAMES = ("joint1", "joint2")


def log(n=50, joints=NAMES):
    x = np.random.default_rng(0).normal(size=(4, n, len(joints)))
    return Recording(joints, np.arange(n) * 0.01, *x)


def written(tmp_path, text="time,q_a,q_b\n0,1,2\n1,3,4\n"):
    path = tmp_path / "log.csv"
    path.write_text(text)
    return path


def parquet(tmp_path, **columns):
    pq.write_table(pa.table(columns), tmp_path / "log.parquet")
    return tmp_path / "log.parquet"


def test_the_regressor_of_many_samples_is_that_of_each():
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 8202, 2))
    first = ARM.regressor(q[:1], dq[:1], ddq[:1])
    np.testing.assert_allclose(ARM.regressor(q, dq, ddq)[:, :, :1], first)


def test_a_damaged_parquet_file_is_a_recording_error(tmp_path):
    path = tmp_path / "log.parquet"
    path.write_bytes(b"PAR1" + bytes(100) + b"PAR1")
    with pytest.raises(RecordingError, match=r"log\.parquet"):
        read_recording(path, ["a"])


@pytest.mark.parametrize(("unit", "seconds"), [("seconds", 1.0), ("days", 86400.0)])
def test_parquet_durations_are_read_in_seconds(tmp_path, unit, seconds):
    time = [datetime.timedelta(**{unit: k}) for k in (0, 1)]
    path = parquet(tmp_path, time=time, q_a=[1.0, 2.0])
    assert read_recording(path, ["a"]).time.tolist() == [0.0, seconds]


@pytest.mark.parametrize(
    "weights",
    [
        [],
        [np.ones((50, 2))] * 2,
        [np.ones((60, 2))],
        [np.ones((40, 2))],
        [np.ones((50, 3))],
        [np.ones(50)],
    ],
)
def test_row_weights_that_do_not_fit_are_refused(weights):
    with pytest.raises(ConsistentIdError):
        build_regression(ARM, log(), row_weights=weights)


def test_recordings_may_come_from_a_generator_or_are_refused():
    regression = build_regression(ARM, (r for r in [log()]))
    assert regression.counts == (50, 50)


@pytest.mark.parametrize("gain", [[1, 2, 3], "x"])
def test_a_gain_that_does_not_fit_is_refused(tmp_path, gain):
    path = written(tmp_path)
    with pytest.raises(RecordingError, match="torque_gain"):
        read_recording(path, "ab", Columns(torque="q_{joint}"), torque_gain=gain)


def test_no_joints_are_refused(tmp_path):
    with pytest.raises(RecordingError):
        read_recording(written(tmp_path), ())


@pytest.mark.parametrize("pattern", ["{joint.x}", "{joint[x]}", "{joint[0]}"])
def test_patterns_may_not_look_inside_names(tmp_path, pattern):
    with pytest.raises(RecordingError, match="pattern"):
        read_recording(written(tmp_path), "ab", Columns(position=pattern))


@pytest.mark.parametrize("number", ["1_000", "٣"])
def test_python_spellings_of_numbers_are_refused(tmp_path, number):
    with pytest.raises(RecordingError, match=r"row 1 \(line 2\)"):
        read_recording(written(tmp_path, f"time,q_a\n0,{number}\n1,2\n"), "a")


def test_one_column_for_two_channels_is_refused_or_read_alike(tmp_path):
    path = parquet(tmp_path, time=[0.0, 1.0], q_a=[1.0, 2.0])
    read_recording(path, ["a"], Columns(velocity="q_{joint}"))


def test_times_too_far_apart_are_refused(tmp_path):
    with pytest.raises(RecordingError):
        read_recording(written(tmp_path, "time,q_a\n-1e308,0\n1e308,1\n"), "a")


def test_joints_are_kept_as_a_tuple_of_names_and_position_is_needed():
    assert Recording(["a"], [0, 1], [[0], [1]]).joints == ("a",)
    with pytest.raises(RecordingError):
        Recording(("a",), [0, 1], None)


@pytest.mark.parametrize("factor", [np.nan, np.inf, "2", 2.0])
def test_a_decimation_factor_that_is_no_number_is_refused(factor):
    with pytest.raises(RecordingError):
        signals.decimated(log(), factor)


@pytest.mark.parametrize("order", [-1, 0, 2.5])
def test_an_impossible_filter_order_is_refused(order):
    with pytest.raises(ConsistentIdError):
        signals.low_passed(log(), motion_cutoff=5.0, order=order)


def test_nan_bounds_are_refused():
    with pytest.raises(RecordingError):
        signals.trimmed(log(), 0.0, np.nan)
    with pytest.raises(RecordingError):
        signals.resampled(log(), 100.0, max_gap=np.nan)


def test_a_reversed_interval_does_not_hold_a_negative_number_of_samples():
    with pytest.raises(RecordingError, match=r"^recording: 0 samples"):
        signals.trimmed(log(), 0.4, 0.1)


def test_a_resampled_clock_is_uniform_next_to_epoch_time():
    time = 1.7e9 + np.arange(100) / 5000.0
    fast = Recording(("a",), time, np.sin(time)[:, None])
    signals.uniform_rate(signals.resampled(fast, 5000.0))


def test_a_deficient_rank_is_an_infinite_condition_number():
    A = np.array([[1.0, 2, 3], [2, 4, 6], [1, 1, 1], [0, 1, 7]])
    W = A @ np.array([[1.0, 2, 3], [4, 5, 6], [7, 8, 9]])  # rank 2
    assert condition_number(W, basis="").value == np.inf


def test_parameters_of_another_length_are_refused():
    with pytest.raises(ProblemError):
        build_regression(ARM, log()).residual_rms(np.ones(3))


def test_no_noise_levels_are_not_ones():
    with pytest.raises(ProblemError):
        build_regression(ARM, log()).weighted([])


def test_the_stacked_factor_is_triangular():
    R = build_regression(ARM, log()).stacked()
    few = build_regression(
        TorqueModel(from_modified_dh("arm", [DHRow(1, 0)] * 6)),
        log(joints=tuple(f"joint{k}" for k in range(1, 7)), n=5),
    ).stacked()
    np.testing.assert_array_equal(R, np.triu(R))
    np.testing.assert_array_equal(few, np.triu(few))


def test_an_unbelievably_low_cutoff_is_refused():
    with pytest.raises(ConsistentIdError):
        signals.low_passed(log(2000), motion_cutoff=1e-7)


def test_a_torque_of_zero_is_refused_by_the_constrained_estimate():
    from dataclasses import replace

    silent = replace(log(), torque=np.zeros((50, 2)))
    regression = build_regression(ARM, silent)
    with pytest.raises(NotExcitedError, match="torque is zero"):
        constrained_least_squares(ARM, regression, constraints=[PhysicalConsistency()])


@pytest.mark.slow
def test_a_massless_link_of_the_datasheet_is_to_blame_by_name():
    masses = FixedMasses({"link2": 0.0})
    with pytest.raises(InfeasibleError, match=r"link2\.m = 0 kg"):
        constrained_least_squares(
            ARM,
            build_regression(ARM, log()),
            constraints=[PhysicalConsistency(), masses],
        )


def test_a_place_that_cannot_be_written_to_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ProblemError, match="cannot be written"):
        write_atomically(tmp_path / "file" / "x.json", "{}")


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("identify", "--output", "x"),
        ("identify", "--report", "x.html"),
        ("compare", "--output", "x"),
        ("report", "--output", "x.html"),
    ],
)
def test_a_place_that_cannot_be_written_to_is_refused_before_a_model_is_chosen(
    words, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(drafting, "drafted", None)
    command, option, name = words
    files = map(str, write_arm(tmp_path))
    place = str(tmp_path / "arm.urdf" / name)
    assert main([command, *files, option, place]) == 2
    assert "cannot be written" in capsys.readouterr().err


@pytest.mark.slow
def test_a_dry_run_needs_no_place(tmp_path):
    files = map(str, write_arm(tmp_path))
    out = ("--output", str(tmp_path / "arm.urdf" / "x"), "--dry-run")
    assert main(["identify", *files, *out, "--cutoff", "10", "--no-select"]) < 2


def test_what_stood_in_a_file_stays_when_writing_fails(tmp_path, monkeypatch):
    target = tmp_path / "x.json"
    write_atomically(target, "old")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(ProblemError, match="No space left"):
        write_atomically(target, "new")
    assert target.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["x.json"]
