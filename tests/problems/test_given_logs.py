"""Logs need not be files: data frames, tables of arrays and recordings do as well."""

from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from logged import DRIVE, moved, write_arm

from consistent_id import (
    ProblemError,
    Recording,
    RecordingError,
    TorqueModel,
    draft_problem,
    identify_log,
    load_robot,
)
from consistent_id.problems import drafting, select_model
from consistent_id.problems.robot_logs import given_logs


def arrays_of(log):
    """Return the columns of a log file by name."""
    names = log.read_text().partition("\n")[0].split(",")
    table = np.loadtxt(log, delimiter=",", skiprows=1)
    return dict(zip(names, table.T, strict=True))


def as_pandas(arrays):
    return pytest.importorskip("pandas").DataFrame(arrays)


def as_arrow(arrays):
    return pytest.importorskip("pyarrow").table(arrays)


def as_polars(arrays):
    return pytest.importorskip("polars").DataFrame(arrays)


def as_structured(arrays):
    """A table of an unknown library: names in `columns`, and columns by name."""

    class Frame:
        columns = tuple(arrays)

        def __getitem__(self, name):
            return list(arrays[name])

    return Frame()


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return write_arm(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def read_from_file(arm):
    (log,) = draft_problem(*arm, select=False, cutoff=10.0).problem().training
    return log


@pytest.mark.parametrize(
    "form",
    [
        pytest.param(dict, marks=pytest.mark.slow),
        MappingProxyType,
        as_pandas,
        as_arrow,
        as_polars,
        as_structured,
    ],
)
def test_a_table_in_memory_is_read_as_its_file_is(arm, read_from_file, form):
    (urdf, log), its = arm, read_from_file
    ours = draft_problem(
        urdf, form(arrays_of(log)), select=False, cutoff=10.0
    ).problem()
    (mine,) = ours.training
    np.testing.assert_allclose(mine.time, its.time, rtol=0, atol=1e-12)
    np.testing.assert_allclose(mine.position, its.position, rtol=0, atol=1e-12)
    np.testing.assert_allclose(mine.torque, its.torque, rtol=0, atol=1e-12)


@pytest.mark.parametrize("form", [dict, as_pandas, as_arrow, as_polars, as_structured])
def test_a_table_in_memory_may_be_long(arm, read_from_file, form):
    (urdf, log), its = arm, read_from_file
    wide, joints = arrays_of(log), its.joints
    shape = (len(wide["time"]), len(joints))
    long = {"time": np.repeat(wide["time"], len(joints))}
    long["joint"] = np.tile(np.array(joints, dtype=object), shape[0])
    for word, column in (("q", "position"), ("tau", "torque")):
        each = np.column_stack([wide[f"{word}_{joint}"] for joint in joints])
        long[column] = each.ravel()
    draft = draft_problem(urdf, form(long), select=False, cutoff=10.0)
    assert any("log-1 has a row for each instant" in note for note in draft.notes)
    (mine,) = draft.problem().training
    np.testing.assert_allclose(mine.position, its.position, rtol=0, atol=1e-12)
    np.testing.assert_allclose(mine.torque, its.torque, rtol=0, atol=1e-12)


def test_a_recording_is_a_log_too(arm):
    urdf, _ = arm
    model = TorqueModel(load_robot(urdf), DRIVE)
    log = moved(model, 16.0, tempo=1.13)
    assert log.acceleration is not None  # is not of a log, and is differentiated anew
    problem = draft_problem(urdf, log, select=False, cutoff=10.0).problem()
    rows = problem.logs("training")[0]
    first = int(np.searchsorted(log.time, rows.time[0]))
    np.testing.assert_array_equal(rows.torque, log.torque[first : first + len(rows)])
    np.testing.assert_array_equal(
        rows.velocity, log.velocity[first : first + len(rows)]
    )


def test_files_tables_and_recordings_go_together(arm):
    urdf, log = arm
    other = moved(TorqueModel(load_robot(urdf), DRIVE), 12.0, tempo=0.89)
    draft = draft_problem(
        urdf,
        [log, as_pandas(arrays_of(log))],
        validation=other,
        select=False,
        cutoff=10.0,
    )
    assert [(e.log.name, e.role) for e in draft.recordings] == [
        ("log.csv", "training"),
        ("log-2", "training"),
        ("log-3", "validation"),
    ]
    lengths = [len(r) for r in draft.problem().training]
    assert lengths[0] == lengths[1]
    assert "log-2 stands for a table in memory" in draft.text(log.parent)


@pytest.mark.slow
def test_the_estimate_is_that_of_the_file(arm):
    urdf, log = arm
    of_file = identify_log(urdf, log, select=False)
    of_table = identify_log(urdf, as_pandas(arrays_of(log)), select=False)
    assert of_table.verdict.word == of_file.verdict.word
    mine, its = (s.delivered for s in (of_table, of_file))
    np.testing.assert_allclose(mine.parameters, its.parameters, rtol=1e-4, atol=1e-5)


def test_what_is_no_log_is_refused_with_what_is_expected(arm):
    urdf, log = arm
    table = arrays_of(log)
    with pytest.raises(ProblemError, match="log-2 is given twice"):
        draft_problem(urdf, table, validation=table)
    with pytest.raises(RecordingError, match="neither columns nor keys, expected a"):
        draft_problem(urdf, 5)
    with pytest.raises(RecordingError, match="'time' is the index, expected a col"):
        draft_problem(urdf, as_pandas(table).set_index("time"))
    del table["tau_elbow"], table["tau_shoulder"]
    with pytest.raises(RecordingError, match="no column that is the torque"):
        draft_problem(urdf, table)
    known = np.ones((3, 2), dtype=bool)
    cut = Recording(("shoulder", "elbow"), [0, 1, 2], known * 0.1, torque_known=known)
    with pytest.raises(RecordingError, match="has torque_known, which a call without"):
        draft_problem(urdf, cut)


@pytest.mark.slow
def test_what_judges_has_no_say_in_the_model(arm, tmp_path, monkeypatch):
    """Of held-out logs, only clocks, gaps and missing values are used before."""
    urdf, log = arm
    seen = []

    def chosen(problem, **options):
        seen.append(len(problem.validation))
        return select_model(problem, **options)

    monkeypatch.setattr(drafting, "select_model", chosen)
    judges = [arrays_of(log), arrays_of(log)]
    rng = np.random.default_rng(0)
    for name, values in judges[1].items():
        if name.startswith("tau"):
            judges[1][name] = 3.0 * values + rng.normal(size=len(values))
        elif name != "time":
            judges[1][name] = 0.5 * values
    texts = [
        draft_problem(urdf, arrays_of(log), validation=judge).text(tmp_path)
        for judge in judges
    ]
    assert texts[0] == texts[1]
    assert seen == [0, 0]  # the selection has no log for validation


def test_a_log_at_a_url_is_fetched_into_the_cache(tmp_path, monkeypatch):
    memory = pytest.importorskip("fsspec").filesystem("memory")
    memory.pipe("/runs/log.csv", b"time,q\n0,1\n")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for word in ("memory://runs/log.csv", Path("memory://runs/log.csv")):
        (path,) = given_logs(word, ()).training
        assert path.read_text() == "time,q\n0,1\n"
        assert path.name == "log.csv" and tmp_path in path.parents
    with pytest.raises(RecordingError, match=r"runs/no\.csv: cannot be fetched"):
        given_logs("memory://runs/no.csv", ())
    assert given_logs("C:/log.csv", ()).training == (Path("C:/log.csv"),)
