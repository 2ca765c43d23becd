"""What a user states: declared once, for Python, the shell and the problem file."""

import inspect

import msgspec
import numpy as np
import pytest
from logged import write_arm

import consistent_id as ci
from consistent_id import Recording
from consistent_id.problems.draft import draft_table
from consistent_id.problems.file import (
    ColumnsTable,
    JointTable,
    ProblemTable,
    RecordingTable,
    problem_table,
)
from consistent_id.problems.kept_text import toml_text
from consistent_id.problems.log_entries import motion_of_joints
from consistent_id.problems.overrides import overridden
from consistent_id.problems.robot_logs import robot_logs
from consistent_id.problems.statement import (
    Statement,
    declarations,
    statement_of,
    statement_of_words,
)
from consistent_id.recordings.signals import PDGains

WORDS = {
    "base": "upper",
    "tip": "fore",
    "locked": ["elbow=0.5"],
    "gravity": "0,0,-1.62",
    "package_dirs": ["problems"],
    "validation": ["other.csv"],
    "time": "t",
    "position": "pos_{joint}",
    "velocity": "vel_{joint}",
    "torque": "effort_{joint}",
    "names": ["A1=shoulder"],
    "topic": "/arm/joint_states",
    "units": ["deg"],
    "torque_joints": ["elbow"],
    "torque_gain": ["2", "3"],
    "gain_source": "model",
    "gains": ["60,1.5"],
    "position_command": "q_des_{joint}",
    "rows": ["120,2000"],
    "omit": ["3,7"],
    "max_gap": "0.5",
    "most_joint_speed": "model",
    "duplicates": "first",
    "missing": "omit",
    "wraps": "undo",
    "position_scale": ["elbow=-1"],
    "position_offset": ["elbow=0.5"],
    "coupled": ["elbow=-shoulder"],
    "angular_velocity": "gx,gy,gz",
    "acceleration": "ax,ay,az",
    "base_position": "x,y,z",
    "orientation": "quat",
    "quaternion": "wxyz",
    "imu": "trunk",
    "contacts": ["FL_foot=contact_FL"],
    "bodies": "model",
    "masses": "free",
    "drive": ["viscous"],
    "cutoff": "7.5",
    "friction_velocity": "0.3",
    "band": "9",
    "keep": ["coupling"],
    "select": True,
}
"""An option's words for each field, as the shell hands them on."""


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return write_arm(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def problem(arm):
    """A problem file's content, and its place."""
    folder = arm[0].parent
    text = ci.draft_problem(*arm, select=False, cutoff=10.0).text(folder)
    return problem_table(text, folder / "problem.toml"), folder / "problem.toml"


def test_there_are_words_for_every_field():
    assert list(WORDS) == list(declarations())


@pytest.mark.parametrize("name", WORDS)
def test_a_key_is_one_of_the_problem_file(name):
    kind = msgspec.inspect.type_info(ProblemTable)
    for part in filter(None, declarations()[name].key.split(".")):
        fields = {}
        for each in getattr(kind, "types", [kind]):
            each = getattr(each, "item_type", each)
            fields |= {f.encode_name: f.type for f in getattr(each, "fields", ())}
        assert part in fields, f"{name}: no key {part}"
        kind = fields[part]


def at(table, key):
    for part in key.split("."):
        table = getattr(table, part, None)
    return table


@pytest.mark.parametrize("name", WORDS)
def test_what_is_stated_beside_a_file_takes_its_place_or_is_refused(name, problem):
    table, file = problem
    stated = statement_of_words({name: WORDS[name]})
    assert stated.given == (name,)
    key = declarations()[name].key
    if not key:
        with pytest.raises(ci.ProblemError, match=declarations()[name].option):
            overridden(table, stated, file)
        return
    new, (note,) = overridden(table, stated, file)
    assert note.startswith(f"stated: {key} = ")
    if name in ("rows", "omit"):
        was, now = ([getattr(e, name) for e in t.data.recordings] for t in (table, new))
    else:
        was, now = at(table, key), at(new, key)
    assert now != was
    # It can be written and read again.
    assert problem_table(toml_text(new, {}), file) == new


def test_columns_that_are_not_stated_keep_the_names_of_their_format(problem):
    table, file = problem
    bag = RecordingTable(file="log.mcap", role="training")
    data = msgspec.structs.replace(table.data, recordings=[bag], columns=None)
    table = msgspec.structs.replace(table, data=data)
    new = overridden(table, Statement(torque="current"), file).table
    # Of sensor_msgs/JointState, but for the torque.
    assert new.data.columns == ColumnsTable(
        time="header.stamp", position="position", velocity="velocity", torque="current"
    )
    again = overridden(new, Statement(time="stamp"), file).table
    assert (again.data.columns.time, again.data.columns.torque) == ("stamp", "current")


def test_other_joints_keep_their_motors_where_drive_terms_are_stated(problem):
    table, file = problem
    table = msgspec.structs.replace(
        table, joints={"elbow": JointTable(gear_ratio=50.0, viscous=False)}
    )
    stated = Statement(drive=["viscous", "coulomb"])
    new = overridden(table, stated, file).table
    assert new.drive.viscous and new.drive.coulomb == "tanh" and not new.drive.offset
    assert new.joints["elbow"] == JointTable(gear_ratio=50.0)


def test_a_width_needs_friction_that_has_one(problem):
    table, file = problem
    plain = overridden(table, Statement(drive=["viscous"]), file).table
    with pytest.raises(ci.ProblemError, match="does not have"):
        overridden(plain, Statement(friction_velocity=0.3), file)


def test_of_a_problem_without_logs_nothing_of_logs_can_be_stated():
    with pytest.raises(ci.ProblemError, match=r"--torque-gain is for logs.*names none"):
        ci.load_problem("problems/rx60", torque_gain=[2.0])


def test_python_takes_what_the_shell_takes(arm, problem):
    names = [p.name for p in inspect.signature(ci.identify_log).parameters.values()]
    assert set(WORDS) < set(names)
    _, file = problem
    file.write_text(ci.draft_problem(*arm, select=False, cutoff=10.0).text(file.parent))
    loaded = ci.load_problem(file, cutoff=7.5, tip="upper")
    assert loaded.table.data.preparation.motion_cutoff == 7.5
    assert loaded.model.robot.joint_names == ("shoulder",)
    for call in (ci.load_problem, lambda _, **k: ci.draft_problem(*arm, **k)):
        with pytest.raises(ci.ProblemError, match="nothing 'cutof' can be stated"):
            call(file, cutof=7.5)


def test_contradictions_are_refused():
    with pytest.raises(ci.ProblemError, match="masses are free and bodies are"):
        Statement(masses="free", bodies="model")
    with pytest.raises(ci.ProblemError, match="--max-gap -1: expected a positive"):
        statement_of_words({"max_gap": "-1"})
    with pytest.raises(ci.ProblemError, match="--rows 3-9: expected --rows FIRST,LAST"):
        statement_of_words({"rows": ["3-9"]})
    with pytest.raises(ci.ProblemError, match=r"--gravity 9.81: expected X,Y,Z"):
        statement_of_words({"gravity": "9.81"})


def test_rows_are_of_all_logs_or_of_one(tmp_path):
    stated = statement_of_words({"rows": ["5,90", "b.csv=2,20"], "omit": ["b.csv=3"]})
    assert stated.rows_of(tmp_path / "a.csv") == (5, 90)
    assert stated.rows_of(tmp_path / "b.csv") == (2, 20)
    assert stated.omitted_of(tmp_path / "a.csv") == ()
    assert stated.omitted_of(tmp_path / "b.csv") == (3,)
    with pytest.raises(ci.ProblemError, match="expected the first and the last"):
        Statement(rows=(9, 5)).rows_of(tmp_path / "a.csv")
    assert statement_of({"gains": PDGains(1.0, 0.1)}).given == ("gains",)


def test_rows_of_a_log_that_is_not_given_are_refused(arm, problem):
    for field in ("rows", "omit"):
        stated = {field: {"other.csv": (1, 300)}}
        said = rf"--{field} other.csv=...: no log 'other.csv'; known: log.csv"
        with pytest.raises(ci.ProblemError, match=said):
            ci.draft_problem(*arm, select=False, cutoff=10.0, **stated)
        with pytest.raises(ci.ProblemError, match=said):
            overridden(problem[0], Statement(**stated), problem[1])


def test_rows_of_a_log_in_two_parts_bound_each_part(problem):
    table, file = problem
    (one, two) = (entry.rows for entry in table.data.recordings)
    bounds = [one[0] + 50, two[1] - 50]
    new, (note,) = overridden(table, Statement(rows=bounds), file)
    assert f"= [{bounds[0]}, {one[1]}]; [{two[0]}, {bounds[1]}] in place of" in note
    kept = [entry.rows for entry in new.data.recordings]
    assert kept == [[bounds[0], one[1]], [two[0], bounds[1]]]
    with pytest.raises(ci.ProblemError, match="which are for validation"):
        overridden(table, Statement(rows=(one[0], one[1])), file)


def renamed(arm, folder, header=lambda line: line, rows=lambda lines: lines):
    """Write the arm's log with another header and other rows."""
    first, *lines = arm[1].read_text().splitlines()
    log = folder / "renamed.csv"
    log.write_text("\n".join([header(first), *rows(lines)]) + "\n")
    return arm[0], log


@pytest.mark.slow
def test_a_log_with_other_names_of_joints_is_read(arm, tmp_path):
    def header(line):
        return line.replace("shoulder", "Base").replace("elbow", "Upper")

    log = renamed(arm, tmp_path, header)
    # Named against their order, by which they would be taken otherwise.
    stated = Statement(names={"Base": "elbow", "Upper": "shoulder"})
    found = robot_logs(*log, stated)
    assert found.columns.position == "q_{joint}"
    mine, whole = found.read(log[1]), robot_logs(*arm).read(arm[1])
    assert mine.joints == whole.joints == ("shoulder", "elbow")
    assert np.array_equal(mine.position, whole.position[:, ::-1])
    assert np.array_equal(mine.torque, whole.torque[:, ::-1])
    draft = ci.draft_problem(*log, names=stated.names, select=False, cutoff=10.0)
    assert dict(draft.problem().table.data.columns.names) == dict(stated.names)
    with pytest.raises(ci.ProblemError, match="names: no joint 'elbo'"):
        robot_logs(*log, Statement(names={"Upper": "elbo"}))
    # A joint whose name the log lacks would be locked, and the rest fit badly.
    with pytest.raises(ci.RecordingError, match=r"--names foo=shoulder: .* 'foo'"):
        robot_logs(*arm, Statement(names={"foo": "shoulder"}))


@pytest.mark.slow
def test_of_a_csv_file_one_column_is_no_array_of_joints(arm, tmp_path):
    def header(line):
        return "time,s_q,e_q,s_tau,e_tau"

    log = renamed(arm, tmp_path, header)
    with pytest.raises(ci.RecordingError, match=r"--names s=shoulder e=elbow$"):
        robot_logs(*log)
    found = robot_logs(*log, Statement(names={"s": "shoulder", "e": "elbow"}))
    assert found.columns.position == "{joint}_q"


@pytest.mark.slow
def test_a_clock_that_is_not_in_seconds_is_refused_with_the_option(arm, tmp_path):
    def dates(lines):
        rows = (line.split(",", 1) for line in lines)
        return [f"{1.7e15 + 1e6 * float(time):.0f},{rest}" for time, rest in rows]

    urdf, log = renamed(arm, tmp_path, rows=dates)
    with pytest.raises(ci.RecordingError, match="--units time=us"):
        robot_logs(urdf, log).read(log)
    found = robot_logs(urdf, log, Statement(units={"time": "us"})).read(log)
    assert found.duration == pytest.approx(robot_logs(*arm).read(arm[1]).duration)


def test_what_a_file_states_already_is_not_in_place_of_itself(problem):
    _, (note,) = overridden(problem[0], Statement(masses="datasheet"), problem[1])
    assert note == "stated: constraints.masses = datasheet, as the file has it"


@pytest.mark.slow
@pytest.mark.parametrize("kept", ["first", "last"])
def test_of_rows_with_one_stamp_one_counts(arm, tmp_path, kept):
    def twice(lines):
        time, *values = lines[40].split(",")
        other = ",".join([time, *("0" for _ in values)])
        pair = [lines[40], other] if kept == "first" else [other, lines[40]]
        return [*lines[:40], *pair, *lines[41:]]

    files = renamed(arm, tmp_path, rows=twice)
    with pytest.raises(ci.RecordingError, match="--duplicates first"):
        robot_logs(*files).read(files[1])
    found = robot_logs(*files, Statement(duplicates=kept)).read(files[1])
    assert np.array_equal(found.position, robot_logs(*arm).read(arm[1]).position)
    draft = ci.draft_problem(*files, duplicates=kept, select=False, cutoff=10.0)
    assert draft.problem().table.data.duplicates == kept


@pytest.mark.slow
@pytest.mark.parametrize("sign", ["", "-"])
def test_a_forearm_against_the_horizontal_is_given_by_an_option(arm, tmp_path, sign):
    def summed(lines):
        cells = [line.split(",") for line in lines]
        factor = -1.0 if sign else 1.0
        rows = [
            [t, q, repr(float(p) + factor * float(q)), *more]
            for t, q, p, *more in cells
        ]
        return [",".join(row) for row in rows]

    files = renamed(arm, tmp_path, rows=summed)
    coupled = {"elbow": f"{sign}shoulder"}
    true, found = (
        robot_logs(*arm).read(arm[1]),
        robot_logs(*files, Statement(coupled=coupled)).read(files[1]),
    )
    np.testing.assert_allclose(found.position, true.position, atol=1e-12)
    np.testing.assert_array_equal(found.torque, true.torque)
    draft = ci.draft_problem(*files, coupled=coupled, select=False, cutoff=10.0)
    file = tmp_path / "problem.toml"
    file.write_text(draft.text(tmp_path))
    problem = ci.load_problem(file, trust=True)
    assert problem.table.data.coupled == coupled
    read = problem.read(problem.table.data.recordings[0].file).position
    np.testing.assert_array_equal(read, found.position)
    with pytest.raises(ci.ProblemError, match="coupled wrist = 'elbow': no joint"):
        robot_logs(*files, Statement(coupled={"wrist": "elbow"})).read(files[1])


@pytest.mark.slow
def test_a_reversed_axis_and_another_zero_are_corrected_by_options(arm, tmp_path):
    def moved(lines):
        cells = [line.split(",") for line in lines]
        rows = [
            [t, repr(-2.0 * float(q)), repr(float(p) - 0.5), *more]
            for t, q, p, *more in cells
        ]
        return [",".join(row) for row in rows]

    files = renamed(arm, tmp_path, rows=moved)
    corrected = {
        "position_scale": {"shoulder": -0.5},
        "position_offset": {"elbow": 0.5},
    }
    true, found = (
        robot_logs(*arm).read(arm[1]),
        robot_logs(*files, Statement(**corrected)).read(files[1]),
    )
    np.testing.assert_allclose(found.position, true.position, atol=1e-12)
    np.testing.assert_array_equal(found.torque, true.torque)
    draft = ci.draft_problem(*files, **corrected, select=False, cutoff=10.0)
    file = tmp_path / "problem.toml"
    file.write_text(draft.text(tmp_path))
    problem = ci.load_problem(file, trust=True)
    read = problem.read(problem.table.data.recordings[0].file)
    np.testing.assert_array_equal(read.position, found.position)
    for name in corrected:
        with pytest.raises(ci.ProblemError, match=f"{name}: no joint 'wrist'"):
            robot_logs(*files, Statement(**{name: {"wrist": 1.0}})).read(files[1])
    with pytest.raises(ci.ProblemError, match="expected none zero"):
        robot_logs(*files, Statement(position_scale={"elbow": 0.0})).read(files[1])
    with pytest.raises(ci.ProblemError, match="expected finite numbers"):
        robot_logs(*files, Statement(position_offset={"elbow": np.nan})).read(files[1])


@pytest.mark.parametrize(
    ("scale", "offset", "values"),
    [({"b": -1.0}, None, [[1, -2], [3, -4]]), (None, {"a": 0.5}, [[1.5, 2], [3.5, 4]])],
)
def test_velocities_and_commands_are_scaled_and_not_shifted(scale, offset, values):
    steps = np.array([[1.0, 2.0], [3.0, 4.0]])
    log = Recording(
        ("a", "b"),
        [0.0, 1.0],
        steps,
        velocity=steps,
        torque=steps,
        position_command=steps,
    )
    moved = motion_of_joints(
        log, wraps="keep", scale=scale, offset=offset, coupled=None
    )
    np.testing.assert_array_equal(moved.position, values)
    np.testing.assert_array_equal(moved.position_command, values)
    speeds = steps * [1.0, -1.0] if scale else steps
    np.testing.assert_array_equal(moved.velocity, speeds)
    np.testing.assert_array_equal(moved.torque, steps)


def test_a_scale_acts_before_coupled_joints_are_taken_apart():
    log = Recording(("a", "b"), [0.0, 1.0], [[2.0, 3.0], [4.0, 6.0]])
    moved = motion_of_joints(
        log, wraps="keep", scale={"a": 0.5}, offset=None, coupled={"b": "a"}
    )
    np.testing.assert_allclose(moved.position, [[1.0, 2.0], [2.0, 4.0]])


def test_a_joints_value_that_is_no_number_is_refused():
    with pytest.raises(ci.ProblemError, match="elbow=x: 'x' is no number"):
        statement_of_words({"position_offset": ["elbow=x"]})


@pytest.mark.slow
def test_whole_turns_are_undone_in_drafts_and_in_problem_files(arm, tmp_path):
    turn = 2.0 * np.pi

    def wrapped(lines):
        cells = [line.split(",") for line in lines]
        rows = [[t, str((float(q) - 0.4) % turn), *more] for t, q, *more in cells]
        return [",".join(row) for row in rows]

    files = renamed(arm, tmp_path, rows=wrapped)
    true = robot_logs(*arm).read(arm[1]).position
    kept, undone = (
        robot_logs(*files, Statement(wraps=w)).read(files[1]).position
        for w in ("keep", "undo")
    )
    assert abs(np.diff(kept[:, 0])).max() > 6.0
    np.testing.assert_allclose(undone - undone[0], true - true[0], atol=1e-9)
    draft = ci.draft_problem(*files, wraps="undo", select=False, cutoff=10.0)
    file = tmp_path / "problem.toml"
    file.write_text(draft.text(tmp_path))
    problem = ci.load_problem(file, trust=True)
    assert problem.table.data.wraps == "undo"
    read = problem.read(problem.table.data.recordings[0].file).position
    np.testing.assert_array_equal(read, undone)


def test_rows_and_broken_rows_of_a_log_count_as_the_file_has_them(arm, tmp_path):
    def broken(lines):
        return [*lines[:3], "1e9" + lines[3][lines[3].index(",") :], *lines[4:]]

    files = renamed(arm, tmp_path, rows=broken)
    draft = ci.draft_problem(
        *files, omit=(4,), rows=(201, 1500), select=False, cutoff=10.0
    )
    first, last = draft.recordings[0].rows[0], draft.recordings[-1].rows[1]
    assert first >= 201 and last <= 1500
    (entry, _) = draft.problem().table.data.recordings
    assert entry.omit == [4]
    # Row 201 of the file is the sample 200 of the whole log.
    whole = robot_logs(*arm).read(arm[1])
    start = draft.problem().logs("training")[0].time[0]
    assert start == whole.time[first - 1]


def test_gravity_and_gaps_are_what_is_stated(arm):
    moon = (0.0, 0.0, -1.62)
    draft = ci.draft_problem(*arm, gravity=moon, max_gap=0.7, select=False, cutoff=10.0)
    problem = draft.problem()
    assert problem.model.robot.gravity.tolist() == list(moon)
    assert problem.table.data.preparation.max_gap == 0.7


def test_tables_in_memory_take_the_same(arm):
    whole = robot_logs(*arm).read(arm[1])
    table = {"time": whole.time}
    for k, name in enumerate(("Base", "Upper")):
        table |= {f"q_{name}": whole.position[:, k], f"tau_{name}": whole.torque[:, k]}
    draft = ci.draft_problem(
        arm[0],
        table,
        names={"Base": "shoulder", "Upper": "elbow"},
        omit=(1,),
        select=False,
        cutoff=10.0,
    )
    assert draft.raw[draft.log].time[0] == whole.time[1]


def test_a_folder_of_packages_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ci.ProblemError, match=r"--package-dirs .*nowhere is no folder"):
        Statement(package_dirs=[tmp_path, tmp_path / "nowhere"])


def test_units_of_each_joint_are_shown_as_words(tmp_path):
    given = {"units": {"position": ("rad", "deg")}, "select": False, "cutoff": 10.0}
    draft = ci.draft_problem(*write_arm(tmp_path), **given)
    assert ("units", "position: rad, deg") in draft_table(draft).rows


def test_commands_without_gains_say_what_makes_torque_of_them(tmp_path):
    urdf, log = write_arm(tmp_path)
    command = {"position_command": "q_{joint}", "select": False, "cutoff": 10.0}
    draft = ci.draft_problem(urdf, log, **command)
    assert "q_{joint} are not used: " in "; ".join(draft_table(draft).notes)
    text = log.read_text().replace("tau_", "note_")
    log.write_text(text)
    with pytest.raises(ci.RecordingError, match=r"commands in q_\{joint\}.*--gains KP"):
        ci.draft_problem(urdf, log, **command)
