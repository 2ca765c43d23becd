"""Velocities that drives log late are not read."""

from dataclasses import replace

import numpy as np
import pytest
from logged import write_arm
from scipy.signal import butter, sosfilt, sosfiltfilt

from consistent_id import RecordingError, Study
from consistent_id.estimation.estimate import torque_errors
from consistent_id.problems.draft_reading import velocity_delay
from consistent_id.problems.drafting import draft_problem
from consistent_id.problems.loading import load_problem
from consistent_id.recordings.recording import Recording

RATE = 100.0


def velocity(time):
    """A smooth motion's velocity, whose integral is `position`."""
    return np.column_stack(
        [
            np.cos(2.0 * time + 0.1 * time**2) * (2.0 + 0.2 * time),
            1.5 * np.cos(3 * time),
        ]
    )


def position(time):
    return np.column_stack(
        [np.sin(2.0 * time + 0.1 * time**2), 0.5 * np.sin(3.0 * time)]
    )


def recording(late):
    time = np.arange(1500) / RATE
    return Recording(("a", "b"), time, position(time), velocity(time - late))


@pytest.mark.parametrize("late", [0.015, 0.05, 0.19])
def test_the_delay_of_a_late_velocity_is_found(late):
    found = velocity_delay(recording(late))
    assert found.seconds == pytest.approx(late, abs=1e-3)


@pytest.mark.parametrize("late", [-0.05, 0.0, 0.004])
def test_a_velocity_within_a_sample_of_its_position_is_on_time(late):
    assert velocity_delay(recording(late)) is None


def test_a_velocity_of_another_motion_is_not_called_late():
    log = recording(0.0)
    noise = np.random.default_rng(0).normal(size=log.position.shape)
    assert velocity_delay(Recording(log.joints, log.time, log.position, noise)) is None


@pytest.fixture(scope="module")
def arm_with_late_velocity(tmp_path_factory):
    urdf, log = write_arm(tmp_path_factory.mktemp("arm"))
    table = np.loadtxt(log, delimiter=",", skiprows=1)
    rates = np.gradient(table[:, 1:3], 1.0 / RATE, axis=0)
    late = np.roll(rates, 8, axis=0)  # it begins and ends at rest
    header = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow,dq_shoulder,dq_elbow"
    np.savetxt(
        log, np.column_stack([table, late]), "%.9g", ",", header=header, comments=""
    )
    return urdf, log


@pytest.mark.slow
def test_a_draft_differentiates_the_position_instead_and_says_so(
    arm_with_late_velocity,
):
    draft = draft_problem(*arm_with_late_velocity, select=False, cutoff=10.0)
    assert draft.columns.velocity is None
    assert any("80 ms later than the position" in note for note in draft.notes)
    assert "velocity =" not in draft.text(arm_with_late_velocity[0].parent)
    (training,) = draft.problem().training
    slope = np.gradient(training.position, training.time, axis=0)
    assert np.allclose(training.velocity, slope, atol=0.05)


def test_a_velocity_that_the_user_names_is_read(arm_with_late_velocity):
    draft = draft_problem(
        *arm_with_late_velocity, velocity="dq_{joint}", select=False, cutoff=10.0
    )
    assert draft.columns.velocity == "dq_{joint}"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise", "scale", "is_read"),
    [(0.0, 1.0, True), (0.3, 1.0, False), (0.3, 1.3, True)],
)
def test_a_velocity_that_predicts_worse_is_not_read_unless_its_scale_is_a_fault(
    tmp_path, noise, scale, is_read
):
    """A wrong clock shows in the velocity's scale: it has to stay in sight."""
    urdf, log = write_arm(tmp_path)
    table = np.loadtxt(log, delimiter=",", skiprows=1)
    rates = scale * np.gradient(table[:, 1:3], 1.0 / RATE, axis=0)
    rates += noise * np.random.default_rng(0).normal(size=rates.shape)
    header = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow,dq_shoulder,dq_elbow"
    table = np.column_stack([table, rates])
    np.savetxt(log, table, "%.9g", ",", header=header, comments="")
    draft = draft_problem(urdf, log, select=False)
    assert (draft.columns.velocity is not None) == is_read
    said = [note for note in draft.notes if note.startswith("the velocity is not read")]
    assert bool(said) != is_read


def with_rates(folder, rates):
    urdf, log = write_arm(folder)
    table = np.loadtxt(log, delimiter=",", skiprows=1)
    header = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow,dq_shoulder,dq_elbow"
    table = np.column_stack([table, np.broadcast_to(rates, (len(table), 2))])
    np.savetxt(log, table, "%.9g", ",", header=header, comments="")
    return urdf, log


@pytest.mark.parametrize(
    ("rate", "said"),
    [
        (0.0, "it is zero throughout"),
        (np.nan, "has no value in any row: it is not read"),
    ],
)
def test_a_velocity_that_nobody_wrote_is_not_read(tmp_path, rate, said):
    draft = draft_problem(*with_rates(tmp_path, rate), select=False, cutoff=10.0)
    assert draft.columns.velocity is None
    assert [said in note for note in draft.notes].count(True) == 1
    (training,) = draft.problem().training
    slope = np.gradient(training.position, training.time, axis=0)
    assert np.allclose(training.velocity, slope, atol=0.05)


def with_true_rates(folder):
    folder.mkdir(exist_ok=True)
    position = np.loadtxt(write_arm(folder)[1], delimiter=",", skiprows=1)[:, 1:3]
    return with_rates(folder, np.gradient(position, 1.0 / RATE, axis=0))


def with_cell(log, row, cell):
    """Write a cell in place of the last velocity of some rows of a log."""
    lines = log.read_text().splitlines()
    for k in row:
        lines[k] = ",".join([*lines[k].split(",")[:-1], cell])
    log.write_text("\n".join(lines))


@pytest.mark.slow
def test_a_faulty_velocity_is_refused(tmp_path):
    urdf, log = with_rates(tmp_path, 1.0)
    with_cell(log, [501], "ERR")
    with pytest.raises(RecordingError, match="row 501"):
        draft_problem(urdf, log)


@pytest.mark.slow
@pytest.mark.parametrize("cell", ["nan", ""])
def test_rows_that_lack_the_velocity_alone_are_left_out(tmp_path, cell):
    urdf, log = with_true_rates(tmp_path)
    with_cell(log, range(501, 521), cell)
    draft = draft_problem(urdf, log, select=False, cutoff=10.0)
    said = "log.csv: the velocity is missing in 20 rows, which are left out"
    assert said in draft.notes
    file = tmp_path / "problem.toml"
    file.write_text(draft.text(tmp_path))
    assert 'missing = "omit"' in file.read_text()
    assert len(load_problem(file).training) == 2  # the gap is cut


@pytest.mark.slow
def test_a_velocity_that_many_rows_lack_is_not_read(tmp_path):
    urdf, log = with_rates(tmp_path, 1.0)
    with_cell(log, range(501, 1501), "")
    draft = draft_problem(urdf, log, select=False, cutoff=10.0)
    assert draft.columns.velocity is None
    assert "log.csv: the velocity is missing in 1000 rows: it is not read" in (
        note.partition(", and")[0] for note in draft.notes
    )


@pytest.mark.slow
@pytest.mark.parametrize("rows", [range(501, 541), range(1, 2401)])
def test_a_velocity_that_the_held_out_log_lacks_does_not_stop_a_draft(tmp_path, rows):
    urdf, log = with_true_rates(tmp_path)
    _, held_out = with_true_rates(tmp_path / "other")
    with_cell(held_out, rows, "nan")
    held_out = held_out.rename(tmp_path / "held_out.csv")
    draft = draft_problem(urdf, log, validation=held_out, select=False, cutoff=10.0)
    whole = len(rows) == 2400
    assert (draft.columns.velocity is None) == whole
    assert any("held_out.csv" in note and "velocity" in note for note in draft.notes)
    assert len(draft.problem().validation) == (1 if whole else 2)
    assert len(draft.problem().training) == 1


def test_a_gap_of_the_held_out_log_alone_is_cut(tmp_path):
    (tmp_path / "other").mkdir()
    urdf, log = write_arm(tmp_path)
    _, held_out = write_arm(tmp_path / "other")
    lines = held_out.read_text().splitlines()
    del lines[501:541]
    held_out.write_text("\n".join(lines))
    draft = draft_problem(urdf, log, validation=held_out, select=False, cutoff=10.0)
    problem = draft.problem()
    assert (len(problem.training), len(problem.validation)) == (1, 2)


def test_missing_values_of_a_velocity_that_the_user_names_are_refused(tmp_path):
    with pytest.raises(RecordingError, match="velocity of joint 'shoulder' is nan"):
        draft_problem(*with_rates(tmp_path, np.nan), velocity="dq_{joint}")


@pytest.mark.slow
def test_a_joint_without_torque_is_left_out_by_the_option_that_is_named(tmp_path):
    urdf, log = with_rates(tmp_path, np.nan)
    lines = log.read_text().splitlines()
    fields = [line.split(",") for line in lines[1:]]
    rows = [",".join([*row[:4], "nan", *row[5:]]) for row in fields]
    log.write_text("\n".join([lines[0], *rows]))
    with pytest.raises(RecordingError) as refused:
        draft_problem(urdf, log)
    assert refused.value.options == "--missing omit --torque-joints shoulder"
    draft = draft_problem(
        urdf, log, missing="omit", torque_joints=["shoulder"], select=False, cutoff=10.0
    )
    assert draft.columns.torque_joints == ("shoulder",)
    assert draft.columns.velocity is None


@pytest.mark.slow
def test_missing_positions_are_refused_beside_missing_velocities(tmp_path):
    urdf, log = with_rates(tmp_path, np.nan)
    lines = log.read_text().splitlines()
    time, _, *others = lines[5].split(",")
    lines[5] = ",".join([time, "nan", *others])
    log.write_text("\n".join(lines))
    with pytest.raises(RecordingError, match="position of joint 'shoulder' is nan"):
        draft_problem(urdf, log)


@pytest.mark.slow
@pytest.mark.parametrize("cutoff", [1.0, 1.5, 3.0, 5.0, 20.0])
@pytest.mark.parametrize("delayed", [False, True])
def test_a_smoothed_velocity_never_makes_the_draft_worse(tmp_path, cutoff, delayed):
    """The truth is the torque of the motion, which has parts up to 1.3 Hz."""
    urdf, log = write_arm(tmp_path)
    table = np.loadtxt(log, delimiter=",", skiprows=1)
    rates = np.gradient(table[:, 1:3], 1.0 / RATE, axis=0)
    filters = butter(1, cutoff, fs=RATE, output="sos")
    rates = (sosfilt if delayed else sosfiltfilt)(filters, rates, axis=0)
    header = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow,dq_shoulder,dq_elbow"
    full = np.column_stack([table, rates])
    np.savetxt(log, full, "%.9g", ",", header=header, comments="")
    draft = draft_problem(urdf, log, select=False, cutoff=10.0)
    bare = replace(draft, columns=replace(draft.columns, velocity=None))
    errors = [_error(d) for d in (draft, bare)]
    assert errors[0] <= 1.05 * errors[1]
    if cutoff <= 3.0:
        assert draft.columns.velocity is None
        late = "later than the position" if delayed else "is smoothed, and lacks"
        assert any(late in note for note in draft.notes)


@pytest.mark.slow
def test_a_velocity_beside_wrapped_positions_is_not_called_smoothed(tmp_path):
    """Jumps by whole turns are a fault of their own, and no acceleration."""
    urdf, log = write_arm(tmp_path)
    table = np.loadtxt(log, delimiter=",", skiprows=1)
    rates = np.gradient(table[:, 1:3], 1.0 / RATE, axis=0)
    zero = table[:, 1:3].mean(axis=0) - np.pi  # the ends of the turn are in the motion
    table[:, 1:3] = (table[:, 1:3] - zero) % (2.0 * np.pi)
    table[:, 1:3] = (table[:, 1:3] + np.pi) % (2.0 * np.pi)
    assert abs(np.diff(table[:, 1:3], axis=0)).max() > 6.0
    header = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow,dq_shoulder,dq_elbow"
    full = np.column_stack([table, rates])
    np.savetxt(log, full, "%.9g", ",", header=header, comments="")
    draft = draft_problem(urdf, log, select=False, cutoff=10.0)
    assert draft.columns.velocity == "dq_{joint}"
    undone = draft_problem(urdf, log, select=False, cutoff=10.0, wraps="undo")
    assert undone.columns.velocity == "dq_{joint}"


def _error(draft):
    """The error of a draft's estimate on the true motion: differentiated positions."""
    problem = draft.problem()
    estimate = Study(problem).constrained
    unread = replace(draft, columns=replace(draft.columns, velocity=None))
    (motion,) = unread.problem().validation
    return torque_errors([estimate], motion)[0].stacked


@pytest.fixture(scope="module")
def arm_with_early_position(tmp_path_factory):
    urdf, log = write_arm(tmp_path_factory.mktemp("early"))
    table = np.loadtxt(log, delimiter=",", skiprows=1)
    rates = np.gradient(table[:, 1:3], 1.0 / RATE, axis=0)
    table[:, 1:3] = np.roll(table[:, 1:3], -8, axis=0)  # it begins and ends at rest
    header = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow,dq_shoulder,dq_elbow"
    columns = np.column_stack([table, rates])
    np.savetxt(log, columns, "%.9g", ",", header=header, comments="")
    return urdf, log


@pytest.mark.slow
def test_one_delay_of_velocity_and_torque_is_the_positions(arm_with_early_position):
    draft = draft_problem(*arm_with_early_position)
    assert draft.early == pytest.approx(0.08, abs=2e-3)
    assert draft.columns.velocity == "dq_{joint}"
    assert draft.selection.choice.delay == pytest.approx(0.0, abs=4e-3)
    assert any("the position is moved" in note for note in draft.notes)
    (training,) = draft.problem().training
    slope = np.gradient(training.position, training.time, axis=0)
    assert np.allclose(training.velocity, slope, atol=0.05)


@pytest.mark.slow
def test_the_file_of_an_early_position_prepares_the_same(arm_with_early_position):
    urdf, log = arm_with_early_position
    draft = draft_problem(urdf, log)
    file = log.parent / "problem.toml"
    file.write_text(draft.text(log.parent))
    assert "delays = {position = -0.08}" in file.read_text()
    (first,), (again,) = draft.problem().training, load_problem(file).training
    assert np.array_equal(first.velocity, again.velocity)
    assert np.array_equal(first.torque, again.torque)
