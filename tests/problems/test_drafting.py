"""From a robot and a log to a problem: what is found, and what is called a guess."""

import re

import numpy as np
import pytest
from logged import URDF, write_arm
from some_fast import some_fast

from consistent_id import ProblemError, RecordingError, load_problem, run_study
from consistent_id.problems import preparation as preparation_module
from consistent_id.problems.draft_reading import _CUTOFFS, _LOW
from consistent_id.problems.draft_rows import Clock, _training, split_logs
from consistent_id.problems.drafting import draft_problem
from consistent_id.problems.file import ModelTable, ProblemTable, problem_table
from consistent_id.problems.kept_text import toml_text
from consistent_id.problems.parameter_tables import ConstraintsTable, RelationTable
from consistent_id.problems.statement import Statement
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.readers import recording_file
from consistent_id.recordings.readers.recording_file import column_names
from consistent_id.recordings.recording import Recording

ARM = ("shoulder", "elbow")


def guessed(folder, header, joints=ARM, **options):
    file = folder / "log.csv"
    file.write_text(header + "\n" + ",".join("0" for _ in header.split(",")) + "\n")
    return guess_columns(file, KnownColumns(tuple(joints), **options))


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    urdf, log = write_arm(folder)
    return folder, draft_problem(urdf, log)


def test_cut_offs_that_are_tried_rise_by_at_most_five_thirds():
    tried = np.array(_CUTOFFS)
    steps = tried[1:] / tried[:-1]
    assert (steps > 1.0).all() and (steps <= 5.0 / 3.0 + 1e-12).all()
    assert _LOW in tried


@pytest.mark.slow
def test_a_draft_finds_the_motion_and_keeps_its_last_part_to_judge_by(arm):
    _, draft = arm
    (first, last), (then, end) = draft.training, draft.validation
    assert 100 < first < 140
    assert 2260 < end < 2300
    assert then == last + 1
    share = (last - first) / (end - first)
    assert share == pytest.approx(0.7, abs=0.002)


@pytest.mark.slow
def test_a_draft_without_a_selection_chooses_its_cutoff_from_the_training_rows(arm):
    folder, _ = arm
    draft = draft_problem(folder / "arm.urdf", folder / "log.csv", select=False)
    assert draft.rate == pytest.approx(100.0)
    assert draft.resample is None
    assert draft.max_gap is None
    assert draft.cutoff in (5.0, 7.5, 10.0, 15.0, 20.0)
    assert "predict each other best" in draft.cutoff_reason


@pytest.mark.slow
def test_what_is_given_is_kept_and_what_is_to_be_plain_is_not_chosen(arm):
    folder, free = arm
    chosen = {step.move.kind for step in free.selection.steps}
    assert chosen  # else nothing would be kept from being chosen
    files = folder / "arm.urdf", folder / "log.csv"
    draft = draft_problem(*files, friction_velocity=0.037, keep=sorted(chosen))
    assert chosen.isdisjoint(step.move.kind for step in draft.selection.steps)
    terms = draft.problem().model.terms
    assert {
        term.velocity_scale
        for each in terms
        for term in each.terms
        if hasattr(term, "velocity_scale")
    } == {0.037}
    with pytest.raises(ProblemError, match=r"'lod_friction'.*load_friction"):
        draft_problem(*files, keep=["lod_friction"])


@pytest.mark.slow
def test_the_file_loads_as_the_problem_that_was_drafted(arm):
    folder, draft = arm
    (folder / "problem.toml").write_text(draft.text(folder))
    loaded, drafted = load_problem(folder), draft.problem()
    assert loaded.table.constraints.masses == "datasheet"
    assert loaded.model.fingerprint == drafted.model.fingerprint
    for role in ("training", "validation"):
        (a,), (b,) = getattr(loaded, role), getattr(drafted, role)
        np.testing.assert_array_equal(a.torque, b.torque)


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({}, marks=pytest.mark.slow),
        {"masses": "free", "torque_gain": (2.0, 0.5), "cutoff": 10.0, "select": False},
        {"torque_joints": ["elbow"], "cutoff": 10.0, "select": False},
    ],
)
def test_the_text_holds_exactly_what_was_drafted(arm, options):
    folder, _ = arm
    draft = draft_problem(folder / "arm.urdf", folder / "log.csv", **options)
    file = folder / "problem.toml"
    assert problem_table(draft.text(folder), file) == draft.table(folder)


def test_values_of_every_kind_are_written_as_toml_reads_them(tmp_path):
    table = ProblemTable(
        name="x",
        description='a "quoted" \\ text with tab\t and umlaut ü',
        model=ModelTable(
            urdf="arm.urdf", locked={"a.b": 0.1}, gravity=(0.0, 0.0, 1e-9)
        ),
        constraints=ConstraintsTable(
            drive_signs=False,
            relations=[RelationTable(terms={"link.m": 1.0}, upper=2.0)] * 2,
        ),
        links={},
    )
    text = toml_text(table, {"constraints": "one\ntwo", "constraints.margin": "beside"})
    assert problem_table(text, tmp_path) == table
    assert "# one\n# two\n[constraints]\n" in text
    assert "margin = 1e-06  # beside" in text
    assert "shared_motors" not in text


@pytest.mark.slow
@pytest.mark.parametrize("select", some_fast([False, True]))
def test_a_log_is_read_and_prepared_once(arm, monkeypatch, select):
    folder, _ = arm
    counts = {"read": 0, "differentiated": 0}

    def counted(name, module, function):
        work = getattr(module, function)

        def run(*args, **options):
            counts[name] += 1
            return work(*args, **options)

        monkeypatch.setattr(module, function, run)

    counted("read", recording_file, "read_recording")
    counted("differentiated", preparation_module, "differentiated")
    draft = draft_problem(folder / "arm.urdf", folder / "log.csv", select=select)
    counts.update(differentiated=0)
    problem = draft.problem()
    assert len(problem.training) == len(problem.validation) == 1
    assert len(problem.logs("training")) == len(problem.logs("validation")) == 1
    assert counts == {"read": 0, "differentiated": 1}
    (folder / "problem.toml").write_text(draft.text(folder))
    loaded = load_problem(folder)
    assert loaded.training[0].time[0] < loaded.validation[0].time[0]
    assert counts == {"read": 1, "differentiated": 2}


def test_the_file_says_what_is_a_guess(arm):
    folder, draft = arm
    text = draft.text(folder)
    assert 'urdf = "arm.urdf"' in text
    assert text.count("GUESS") >= 3
    assert "the masses of arm.urdf are those of the robot" in text


def test_a_file_in_another_folder_names_the_robot_and_the_log_from_there(arm):
    folder, draft = arm
    study = folder / "studies" / "first"
    study.mkdir(parents=True)
    (study / "problem.toml").write_text(draft.text(study))
    assert 'file = "../../log.csv"' in (study / "problem.toml").read_text()
    assert load_problem(study, trust=True).missing == ()


@pytest.mark.slow
def test_jittered_and_missing_stamps_are_seen(tmp_path):
    urdf, log = write_arm(tmp_path)
    rows = log.read_text().splitlines()
    header, rows = rows[0], [row.split(",") for row in rows[1:]]
    rng = np.random.default_rng(0)
    for row in rows:
        row[0] = f"{float(row[0]) + rng.uniform(0, 1e-3):.6f}"
    del rows[900:960]
    log.write_text("\n".join([header, *map(",".join, rows)]) + "\n")
    draft = draft_problem(urdf, log, select=False)
    assert draft.resample == pytest.approx(100.0, rel=0.01)
    assert draft.max_gap == pytest.approx(0.1, rel=0.01)
    assert len(draft.problem().training) == 2


def test_without_enough_motion_the_cutoff_is_said_to_be_a_guess(tmp_path):
    urdf, log = write_arm(tmp_path)
    lines = log.read_text().splitlines()
    log.write_text("\n".join(lines[:400]) + "\n")
    draft = draft_problem(urdf, log, select=False)
    assert "none could be chosen" in draft.cutoff_reason


def test_a_log_in_which_nothing_moves_is_refused(tmp_path):
    urdf, log = write_arm(tmp_path)
    rows = [f"{k / 100},0.3,0.1,5,1" for k in range(500)]
    log.write_text("\n".join([log.read_text().splitlines()[0], *rows]) + "\n")
    with pytest.raises(RecordingError, match="no joint ever moves"):
        draft_problem(urdf, log)


@pytest.mark.slow
def test_masses_are_free_where_asked_and_where_there_are_none(tmp_path):
    urdf, log = write_arm(tmp_path)
    draft = draft_problem(urdf, log, masses="free")
    assert 'masses = "free"' in draft.text(tmp_path)
    assert draft.problem().table.constraints.masses == "free"
    urdf.write_text(re.sub(r"<inertial>.*?</inertial>", "", URDF, flags=re.DOTALL))
    assert draft_problem(urdf, log).masses == "free"


def test_a_joint_that_the_log_does_not_have_is_held(tmp_path):
    urdf, log = write_arm(tmp_path)
    log.write_text(log.read_text().replace("q_elbow", "x").replace("tau_elbow", "y"))
    draft = draft_problem(urdf, log, select=False, cutoff=10.0)
    assert (draft.joints, draft.locked) == (("shoulder",), ("elbow",))
    assert draft.problem().model.robot.joint_names == ("shoulder",)
    assert "Locked at zero: elbow." in draft.text(tmp_path)


def test_the_part_that_moves_can_be_said(tmp_path):
    urdf, log = write_arm(tmp_path)
    draft = draft_problem(urdf, log, tip="upper", select=False, cutoff=10.0)
    assert draft.problem().model.robot.joint_names == ("shoulder",)
    assert 'tip = "upper"' in draft.text(tmp_path)


@pytest.mark.slow
def test_torque_gains_are_one_or_one_each(tmp_path):
    urdf, log = write_arm(tmp_path)
    draft = draft_problem(urdf, log, torque_gain=(2.0, 3.0), select=False, cutoff=10.0)
    assert "torque_gain = [2.0, 3.0]" in draft.text(tmp_path)
    plain = draft_problem(
        urdf, log, torque_gain=(2.0,), select=False, cutoff=10.0
    ).problem()
    assert plain.table.data.torque_gain == 2.0
    with pytest.raises(ProblemError, match="3 torque gains for 2 joints"):
        draft_problem(urdf, log, torque_gain=(1.0, 2.0, 3.0))


@pytest.mark.parametrize(
    ("header", "position", "torque"),
    [
        ("time,q_shoulder,q_elbow,tau_shoulder,tau_elbow", "q_{joint}", "tau_{joint}"),
        ("t,q1,q2,tau1,tau2", "q{number}", "tau{number}"),
        (
            "timestamp,shoulder/position,elbow/position,shoulder/effort,elbow/effort",
            "{joint}/position",
            "{joint}/effort",
        ),
        (
            "Time,Pos[1],Pos[2],Torque[1],Torque[2]",
            "Pos[{number}]",
            "Torque[{number}]",
        ),
        (
            "time,shoulder.pos,elbow.pos,joint_1.torque,joint_2.torque",
            "{joint}.pos",
            "joint_{number}.torque",
        ),
    ],
)
def test_columns_are_told_from_their_names(tmp_path, header, position, torque):
    guess = guessed(tmp_path, header)
    assert guess.columns.time == header.split(",")[0]
    assert (guess.columns.position, guess.columns.torque) == (position, torque)
    assert guess.columns.velocity is None
    assert guess.joints == ARM


def test_numbers_may_begin_with_zero(tmp_path):
    header = "time,actual_q_0,actual_q_1,target_q_0,target_q_1,torque_0,torque_1"
    columns = guessed(tmp_path, header).columns
    assert columns.position == "actual_q_{joint}"
    assert columns.names == {"0": "shoulder", "1": "elbow"}


def test_commands_and_currents_are_not_taken_for_what_was_measured(tmp_path):
    header = "time,q_cmd_1,q_cmd_2,q1,q2,tau_desired1,tau_desired2,current1,current2"
    with pytest.raises(RecordingError, match=r"torque.*--torque-gain"):
        guessed(tmp_path, header)
    guess = guessed(tmp_path, header, channels={"torque": "current{number}"})
    assert guess.columns.position == "q{number}"


def test_what_was_chosen_between_is_said(tmp_path):
    guess = guessed(tmp_path, "time,q1,q2,motor_q1,motor_q2,tau1,tau2")
    assert guess.columns.position == "q{number}"
    assert guess.notes == ("position is read from q{number}, not from motor_q{number}",)


def test_of_joints_whose_names_begin_alike_the_longer_is_meant(tmp_path):
    joints = tuple(f"joint_{k}" for k in range(1, 12))
    names = [f"{c}_{j}" for c in ("pos", "effort") for j in joints]
    guess = guessed(tmp_path, ",".join(["time", *names]), joints)
    assert guess.columns.position == "pos_{joint}"
    assert guess.joints == joints


def test_a_channel_that_there_is_not_is_refused(tmp_path):
    with pytest.raises(ProblemError, match="no channel 'torqe'"):
        guessed(tmp_path, "time,q1,q2", channels={"torqe": "tau{number}"})


def test_some_joints_may_have_no_torque(tmp_path):
    columns = guessed(tmp_path, "time,q_shoulder,q_elbow,tau_shoulder").columns
    assert columns.torque_joints == ("shoulder",)


def test_what_cannot_be_told_is_asked_for_with_what_there_is(tmp_path):
    with pytest.raises(RecordingError, match=r"no column .*a, b.*--position"):
        guessed(tmp_path, "time,a,b")
    with pytest.raises(RecordingError, match=r"--time"):
        guessed(tmp_path, "clock,q1,q2,tau1,tau2")


@pytest.mark.parametrize("kind", ["csv", "comment", "npz", "parquet"])
def test_names_of_columns_are_found(tmp_path, kind):
    names = ("time", "q 1", "tau_1")
    if kind == "npz":
        file = tmp_path / "log.npz"
        np.savez(file, **{name: np.zeros(3) for name in names})
    elif kind == "parquet":
        pa = pytest.importorskip("pyarrow")
        import pyarrow.parquet as pq

        file = tmp_path / "log.parquet"
        pq.write_table(pa.table({name: [0.0] for name in names}), file)
    else:
        file = tmp_path / "log.csv"
        mark = "# " if kind == "comment" else ""
        file.write_text(f"# made by hand\n{mark}{'; '.join(names)}\n0;1;2\n")
    assert column_names(file) == names


def test_of_other_files_the_columns_are_asked_for(tmp_path):
    with pytest.raises(RecordingError, match="--position"):
        column_names(tmp_path / "log.bag")
    with pytest.raises(RecordingError, match="no such file"):
        column_names(tmp_path / "nowhere.csv")


@pytest.mark.parametrize(
    "pattern", ["current{number}", "i_{joint}", "motor.amps.{joint}"]
)
def test_currents_without_a_gain_are_refused(pattern):
    from consistent_id.recordings.mixed_columns import require_torque

    with pytest.raises(RecordingError, match="--torque-gain"):
        require_torque(pattern, ())
    require_torque(pattern, (12.0,))
    require_torque("current_torque_{joint}", ())
    require_torque(None, ())


@pytest.mark.parametrize(("period", "expected"), [(6.0, 18.0), (9.0, 18.0)])
def test_a_motion_that_repeats_is_split_by_whole_periods(period, expected):
    log = periodic_log(period, 2701, 100.0)
    # 70 % of 27 s are 18.9 s: three of four whole periods of 6 s, two of three of 9 s.
    assert _training(log, 27.0) == pytest.approx(expected, abs=0.01)
    once = Recording(("a",), log.time, log.time[:, None] ** 2)
    assert _training(once, 27.0) == pytest.approx(0.7 * 27.0)


@pytest.mark.slow
@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("rate", [50.0, 100.0, 125.0, 250.0])
@pytest.mark.parametrize(("whole", "training"), [(2, 1), (3, 2), (4, 3), (5, 4)])
def test_logs_of_whole_periods_are_split_between_two_periods(
    tmp_path, whole, training, rate, closed
):
    for period in (2.0, 3.1, 6.0):
        # A closed log ends with the first sample of the period that would follow.
        log = periodic_log(period, round(whole * period * rate) + closed, rate)
        file = tmp_path / "log.csv"
        first, last = split_logs(
            {file: log}, Clock(None, None), Statement(), whole=False
        ).entries
        # Whether the sample between two periods is before it or after is rounding.
        assert first.rows[1] / rate == pytest.approx(training * period, abs=1.5 / rate)
        assert last.rows == (first.rows[1] + 1, len(log))


@pytest.mark.parametrize(("cut", "training"), [(0.01, 2), (0.05, 1)])
def test_a_period_may_lack_a_small_part(cut, training):
    log = periodic_log(4.0, round((3 - cut) * 400), 100.0)
    assert _training(log, log.duration) == pytest.approx(training * 4.0, abs=0.01)


@pytest.mark.parametrize(
    ("begin", "end"),
    [
        (10.0, 2100),  # 70 % of the motion: the second joint has moved
        (24.0, 2820),  # 70 % of its way
        (29.0, None),  # next to nothing would be left for validation
    ],
)
def test_training_lasts_until_each_joint_has_moved(tmp_path, begin, end):
    time = np.arange(3001) / 100.0
    moves = np.column_stack([time / 10.0, (time - begin) / (30.0 - begin)])
    q = np.clip(moves, 0.0, 1.0) + 0.01 * np.sin(time)[:, None]
    log, file = Recording(("a", "b"), time, q), tmp_path / "log.csv"
    drafted = split_logs({file: log}, Clock(None, None), Statement(), whole=False)
    first, *others = drafted.entries
    if end is None:
        assert not others
        assert first.rows == (1, len(log))
        return
    (last,) = others
    assert first.rows[1] == pytest.approx(end, abs=30)
    assert last.rows == (first.rows[1] + 1, len(log))


def periodic_log(period, samples, rate):
    time = np.arange(samples) / rate
    angle = 2 * np.pi * time / period
    q = np.column_stack([np.sin(angle) + 0.3 * np.cos(3 * angle), np.cos(2 * angle)])
    return Recording(("a", "b"), time, q)


@pytest.mark.slow
def test_a_model_without_any_mass_is_identified_from_the_log_alone(tmp_path):
    """Many a URDF is written for kinematics only; 1 kg is then the typical mass."""
    urdf, log = write_arm(tmp_path)
    bare = re.sub(r"<inertial>.*?</inertial>", "", urdf.read_text(), flags=re.DOTALL)
    urdf.write_text(bare)
    draft = draft_problem(urdf, log)
    assert draft.masses == "free"
    assert draft.selection.plain < 0.1
    study = run_study(draft.problem(str(tmp_path)))
    assert study.verdict.held_out < 0.05
    (found,) = [f for f in study.findings if f.kind == "placeholder inertials"]
    assert "no mass and no inertia" in found.statement
