"""Units that a log's numbers show are proposed with all that the log needs besides."""

from dataclasses import replace

import numpy as np
import pytest
from logged import write_arm

from consistent_id import draft_problem
from consistent_id.errors import RecordingError
from consistent_id.problems.nominal_gains import NominalGains
from consistent_id.problems.robot_logs import joined_options, robot_logs, with_options
from consistent_id.problems.statement import Statement
from consistent_id.recordings.readers import Columns, read_recording, recording_from


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """Return the robot's file, and the log as it is in its CSV file."""
    urdf, log = write_arm(tmp_path_factory.mktemp("arm"))
    return urdf, robot_logs(urdf, log).read(log)


def _csv(folder, log, *, clock="time", time=None, scale=1.0):
    """Write positions and torques under the log's own names."""
    own = ("a", "b")
    names = [clock, *(f"{n} pos" for n in own), *(f"{n} torque" for n in own)]
    time = log.time if time is None else time
    table = np.column_stack([time, scale * log.position, log.torque])
    path = folder / "own.csv"
    np.savetxt(path, table, "%.17g", ",", header=",".join(names), comments="")
    return path


def _options(urdf, path):
    with pytest.raises(RecordingError) as caught:
        robot_logs(urdf, path)
    return caught.value.options


@pytest.mark.slow
def test_milliseconds_and_degrees_are_proposed_beside_names(arm, tmp_path):
    """One command has all; gains of a log in another unit would be wrong."""
    urdf, log = arm
    path = _csv(tmp_path, log, time=1000 * log.time, scale=np.degrees(1.0))
    options = _options(urdf, path)
    assert options == "--names a=shoulder b=elbow --units time=ms deg"
    assert _options(urdf, _csv(tmp_path, log)) == "--names a=shoulder b=elbow"


def test_each_option_has_all_its_values():
    options = ["--units time=ms --torque-gain 1 1", "--position 'q{1..2}'", "--units %"]
    assert joined_options(options) == (
        "--units time=ms % --torque-gain 1 1 --position 'q{1..2}'"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seconds", "unit", "word"), [(86400.0, "day", "days"), (3600.0, "h", "hours")]
)
def test_a_clock_in_hours_or_days_is_answered_with_its_unit(
    arm, tmp_path, seconds, unit, word
):
    urdf, log = arm
    path = _csv(tmp_path, log, time=log.time / seconds)
    said = f"they look like {word}: --units time={unit}"
    with pytest.raises(RecordingError, match=said):
        robot_logs(urdf, path, Statement(names=_NAMES)).read(path)
    columns = Columns("time", "{joint} pos")
    with pytest.raises(RecordingError, match=said):
        read_recording(path, ["a", "b"], columns)
    table = {"time": log.time / seconds, "q_a": log.position[:, 0]}
    with pytest.raises(RecordingError, match=said):
        recording_from(table, ["a"])
    assert len(recording_from(table, ["a"], Columns(units={"time": unit}))) == len(log)
    stated = Columns(units={"time": "us"})
    in_seconds = {**table, "time": log.time}
    with pytest.raises(RecordingError, match=r"in us, as stated.* seconds: --units t"):
        recording_from(in_seconds, ["a"], stated)


_NAMES = {"a": "shoulder", "b": "elbow"}


def test_gains_of_no_unit_are_not_proposed():
    joints, sure = ("a", "b", "c"), np.full(3, 1e-3)
    small = NominalGains(joints, np.full(3, 1e-9), sure, (True,) * 3)
    assert not small.far
    assert NominalGains(joints, np.full(3, 1e-3), sure, (True,) * 3).far


@pytest.mark.slow
def test_counts_of_encoders_are_proposed_with_their_zero(arm, tmp_path):
    urdf, log = arm
    counts = np.round(2048.0 + log.position / (2.0 * np.pi) * 4096.0)
    path = _csv(tmp_path, replace(log, position=counts))
    assert _options(urdf, path) == (
        "--names a=shoulder b=elbow --units position=rev/4096 "
        "--position-offset shoulder=-3.14159 elbow=-3.14159"
    )
    with pytest.raises(RecordingError, match="of 4096 a turn if that is the next pow"):
        robot_logs(urdf, path)


@pytest.mark.slow
def test_counts_of_joints_with_spaces_in_their_names_keep_their_zeros(arm, tmp_path):
    urdf, log = arm
    spaced = tmp_path / "arm.urdf"
    spaced.write_text(urdf.read_text().replace('"shoulder"', '"shoulder joint"'))
    counts = np.round(2048.0 + log.position / (2.0 * np.pi) * 4096.0)
    path = _csv(tmp_path, replace(log, position=counts))
    options = _options(spaced, path)
    assert options.endswith(
        "--position-offset 'shoulder joint=-3.14159' elbow=-3.14159"
    )
    read = with_options(spaced, path, Statement(), options).recording
    np.testing.assert_allclose(read.position, log.position, atol=2e-3)


@pytest.mark.slow
def test_small_whole_numbers_are_no_degrees_for_sure(arm, tmp_path):
    """Counts of a small motion travel as far as degrees would."""
    urdf, log = arm
    span = np.ptp(log.position)
    counts = np.round(2048.0 + 300.0 * log.position / span)
    options = _options(urdf, _csv(tmp_path, replace(log, position=counts)))
    assert "--units position=rev/4096" in options
    around_zero = np.round(300.0 * log.position / span)
    path = _csv(tmp_path, replace(log, position=around_zero))
    with pytest.raises(RecordingError) as caught:
        robot_logs(urdf, path)
    assert caught.value.options == "--names a=shoulder b=elbow"
    assert "degrees without decimals (--units deg), or counts" in str(caught.value)


def test_counts_with_signs_leave_those_of_a_turn_open(arm, tmp_path):
    """The next power of two is no evidence of a turn that counts from its middle."""
    urdf, log = arm
    counts = np.round(log.position / (2.0 * np.pi) * 16384.0)
    options = _options(urdf, _csv(tmp_path, replace(log, position=counts)))
    assert options == "--names a=shoulder b=elbow --units position=rev/COUNTS"


@pytest.mark.slow
def test_counts_in_two_names_are_asked_for_at_once(arm, tmp_path):
    urdf, log = arm
    names = ["time", "q1_ticks", "q2_ticks", *(f"dq{k}_counts_per_min" for k in (1, 2))]
    path = tmp_path / "log.csv"
    table = np.column_stack([log.time, log.position, log.position, log.torque])
    header = ",".join([*names, "tau1", "tau2"])
    np.savetxt(path, table, "%.9g", ",", header=header, comments="")
    with pytest.raises(RecordingError) as caught:
        draft_problem(urdf, path, select=False)
    units = "--units position=rev/COUNTS velocity=rev/COUNTS/min"
    assert caught.value.options == units


@pytest.mark.slow
def test_the_only_columns_of_own_names_without_a_word_may_be_torques(arm, tmp_path):
    urdf, log = arm
    path = _csv(tmp_path, log)
    path.write_text(path.read_text().replace("torque", "load"))
    options = _options(urdf, path)
    assert options == "--names a=shoulder b=elbow --torque '{joint} load'"
