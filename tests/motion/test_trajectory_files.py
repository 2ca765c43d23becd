"""What is written comes back, to the last bit where the format can hold it."""

import io
import json
import re
import zipfile
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from ruamel.yaml import YAML

from consistent_id import ConsistentIdError, MotionLimits, ProblemError, read_recording
from consistent_id.motion import (
    TRAJECTORY_COLUMNS,
    PolynomialPath,
    move_along,
    read_trajectory,
    write_trajectory,
)
from consistent_id.recordings import FourierTrajectory

REPEATABLE = settings(derandomize=True, deadline=None, max_examples=20)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
NAMES = st.text(
    st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=8
).filter(str.isprintable)


def swing(joints=6):
    rng = np.random.default_rng(joints)
    return FourierTrajectory(
        tuple(f"joint_{k}" for k in range(1, joints + 1)),
        [0.5, 1.0, 1.5],
        rng.normal(size=joints),
        0.1 * rng.normal(size=(3, joints)),
        0.1 * rng.normal(size=(3, joints)),
        duration=2.0,
        start=-4.0,
    )


@cache
def move(joints=6):
    path = swing(joints)
    bounds = [1.5 * path.derivative_bound(k) for k in range(4)]
    own = MotionLimits(
        path.joints, -bounds[0], bounds[0], *bounds[1:], np.full(joints, np.inf)
    )
    return move_along(path, own, from_pose=np.zeros(joints))


def parts(path):
    """Everything a path consists of, as plain values."""
    pieces = getattr(path, "pieces", (path,))
    names = ("frequencies", "offset", "sine", "cosine", "control", "duration", "start")
    values = [
        np.asarray(getattr(piece, name), dtype=float).tobytes()
        for piece in pieces
        for name in names
        if hasattr(piece, name)
    ]
    return [(type(piece), piece.joints) for piece in pieces], values


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["json", "npz"])
@settings(REPEATABLE)
@given(data=st.data())
def test_any_coefficients_come_back_to_the_last_bit(tmp_path_factory, ending, data):
    joints = data.draw(st.lists(NAMES, min_size=1, max_size=3, unique=True))
    n, terms = len(joints), data.draw(st.integers(0, 3))
    draw = lambda *shape: data.draw(arrays(np.float64, shape, elements=NUMBERS))  # noqa: E731
    path = FourierTrajectory(
        joints=tuple(joints),
        frequencies=np.arange(1, terms + 1) * data.draw(st.floats(1e-3, 1e3)),
        # Samples of it are finite only up to a size.
        offset=draw(n) / 1e30,
        sine=draw(terms, n) / 1e30 if ending == "npz" else draw(terms, n),
        cosine=draw(terms, n) / 1e30 if ending == "npz" else draw(terms, n),
        duration=data.draw(st.floats(1e-3, 1e3)),
        start=data.draw(st.floats(-1e6, 1e6)),
    )
    file = tmp_path_factory.mktemp("exact") / f"path.{ending}"
    again = read_trajectory(write_trajectory(path, file, rate=2.0 / path.duration))
    assert parts(again) == parts(path)


@pytest.mark.parametrize("ending", ["json", "npz"])
@pytest.mark.parametrize(
    "path", [move(), swing(2), PolynomialPath(("a",), [[0.1], [0.2], [1 / 3]], 2)]
)
def test_moves_and_polynomials_come_back_to_the_last_bit(tmp_path, path, ending):
    again = read_trajectory(write_trajectory(path, tmp_path / f"x.{ending}", rate=50))
    assert type(again) is type(path) and parts(again) == parts(path)
    # Seams too: at them a rounded time would choose another piece.
    time = [piece.start for piece in getattr(path, "pieces", (path,))]
    assert np.array_equal(again.evaluate(time, 3), path.evaluate(time, 3))


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_samples_in_tables_come_back_to_the_last_bit(tmp_path, ending):
    path = move()
    log = read_trajectory(write_trajectory(path, tmp_path / f"x.{ending}", rate=100.0))
    same(log, path.recording(100.0))


def same(log, truth):
    assert log.joints == truth.joints
    for channel in ("time", "position", "velocity", "acceleration"):
        assert np.array_equal(getattr(log, channel), getattr(truth, channel))


@pytest.mark.parametrize("ending", ["csv", "parquet", "npz"])
def test_samples_are_read_as_any_recording(tmp_path, ending):
    path = move()
    file = write_trajectory(path, tmp_path / f"x.{ending}", rate=100.0)
    log = read_recording(file, ["joint_2"], TRAJECTORY_COLUMNS)
    same(log, path.recording(100.0).of(["joint_2"]))


@pytest.mark.slow
@settings(REPEATABLE, max_examples=8)
@given(joints=st.lists(NAMES, min_size=1, max_size=3, unique=True))
def test_names_of_joints_come_back_from_every_file(tmp_path_factory, joints):
    n = len(joints)
    path = PolynomialPath(tuple(joints), [[0.0] * n] * 3 + [[1.0] * n] * 3, 1.0)
    for ending in ("json", "npz", "csv", "parquet", "yaml"):
        file = tmp_path_factory.mktemp("names") / f"x.{ending}"
        again = read_trajectory(write_trajectory(path, file, rate=10.0))
        assert again.joints == path.joints


@pytest.mark.parametrize("ending", ["yaml", "json"])
def test_a_ros_message_comes_back_with_times_in_nanoseconds(tmp_path, ending):
    path = move()
    file = write_trajectory(path, tmp_path / f"x.{ending}", rate=300.0, format="ros")
    log, truth = read_trajectory(file), path.recording(300.0)
    assert log.joints == truth.joints
    assert abs(log.time - truth.time).max() < 0.51e-9
    for channel in ("position", "velocity", "acceleration"):
        assert np.array_equal(getattr(log, channel), getattr(truth, channel))


def test_a_ros_message_is_the_same_in_json_and_in_both_versions_of_yaml(tmp_path):
    # A joint that hardly moves has numbers with exponents.
    tiny = PolynomialPath(("a",), [[1e-5]] * 3 + [[1e-300]] * 3, 2.0)
    text = write_trajectory(tiny, tmp_path / "x.yaml", rate=5.0).read_text()
    assert "e-05" in text
    message = json.loads(text)
    for version in ((1, 1), (1, 2)):
        yaml = YAML(typ="safe", pure=True)
        yaml.version = version
        assert yaml.load(text) == message
    assert set(message) == {"header", "joint_names", "points"}
    assert message["points"][1]["time_from_start"] == {"sec": 0, "nanosec": 200000000}
    assert message["points"][-1]["time_from_start"] == {"sec": 2, "nanosec": 0}


ECHO = """\
header:
  stamp: {sec: 7, nanosec: 5}
  frame_id: ''
joint_names: [elbow, wrist]
points:
- positions:
  - 0.0
  - 1e-05
  velocities: []
  effort: []
  time_from_start: {sec: 0, nanosec: 0}
- positions: [1, 2.5]
  velocities: []
  time_from_start:
    sec: 1
    nanosec: 500000000
---
"""


def test_a_ros_message_of_others_is_read(tmp_path):
    file = tmp_path / "echo.yml"
    file.write_text(ECHO)
    log = read_trajectory(file)
    assert log.joints == ("elbow", "wrist") and log.velocity is None
    assert log.time.tolist() == [0.0, 1.5]
    assert log.position.tolist() == [[0.0, 1e-5], [1.0, 2.5]]


@pytest.mark.parametrize("rate", [125, 500])
def test_a_urscript_program_holds_the_motion(tmp_path, rate):
    path = move()
    text = write_trajectory(path, tmp_path / "x.script", rate=rate).read_text()
    lines = text.splitlines()
    assert lines[0] == "def consistent_id_motion():" and lines[-1] == "end"
    numbers = re.compile(r"servoj\(\[(.*)\], 0, 0, (.*), 0.1, 300\)  # (.*)")
    rows = [m for line in lines if (m := numbers.search(line))]
    targets = np.array([row[1].split(", ") for row in rows], dtype=float)
    since = np.minimum(np.arange(len(rows)) / rate, path.duration)
    assert 0.0 <= len(rows) - 1 - path.duration * rate < 1.0
    assert {float(row[2]) for row in rows} == {1.0 / rate}
    assert np.allclose([float(row[3]) for row in rows], since, rtol=0, atol=5.1e-4)
    exact = path.evaluate(since, derivatives=0)[0]
    np.testing.assert_allclose(targets, exact, rtol=0.0, atol=5.1e-10)
    (to_start,) = re.findall(r"^  movej\(\[(.*)\], a=", text, re.MULTILINE)
    assert to_start == rows[0][1]
    assert lines.index(next(x for x in lines if "movej" in x)) < lines.index(
        next(x for x in lines if "servoj" in x)
    )


@pytest.mark.parametrize(
    ("name", "joints", "asked", "rate", "comma", "unit"),
    [
        ("x.rsi", 6, 250, 250.0, ";", 180.0 / np.pi),
        ("x.rsi", 6, 83.33, 1000.0 / 12.0, ";", 180.0 / np.pi),
        ("x.franka", 7, 1000, 1000.0, ",", 1.0),
    ],
)
def test_a_controllers_table_has_a_row_for_every_cycle(
    tmp_path, name, joints, asked, rate, comma, unit
):
    path = move(joints)
    text = write_trajectory(path, tmp_path / name, rate=asked).read_text()
    lines = [line for line in text.splitlines() if not line.startswith(("#", "A1;"))]
    rows = np.array([line.split(comma) for line in lines], dtype=float)
    assert 0.0 <= len(rows) - 1 - path.duration * rate < 1.0
    since = np.minimum(np.arange(len(rows)) / rate, path.duration)
    exact = unit * path.evaluate(since + path.start, derivatives=0)[0]
    np.testing.assert_allclose(rows, exact, rtol=0.0, atol=6e-13 * unit)
    assert f"{1e3 / rate:g} ms" in text and ", ".join(path.joints) in text
    assert (";A6\n" in text) == name.endswith("rsi")


@pytest.mark.parametrize(
    ("path", "name", "given", "says"),
    [
        (swing(), "x.txt", {}, r"\.txt, expected one of \.json, \.npz, .*\.yaml"),
        (swing(), "x", {}, "no ending, expected one of"),
        (swing(), "x.json", {"format": "xml"}, "'xml', expected one of json, npz"),
        (swing(), "x.csv", {}, "give their rate"),
        (swing(), "x.csv", {"rate": 0.0}, "rate is 0"),
        (swing(), "x.yaml", {"rate": 9.0}, "'joint_1' moves at .* its start.*at_along"),
        (swing(), "x.script", {"rate": 125}, "move_along"),
        (move(), "x.script", {"rate": 100}, "rate is 100 Hz, expected.*125"),
        (move(7), "x.script", {"rate": 125}, "7 joints, expected 6"),
        (move(7), "x.rsi", {"rate": 250}, "7 joints, expected 6"),
        (move(6), "x.rsi", {"rate": 100}, "rate is 100 Hz, expected.*250"),
        (move(6), "x.franka", {"rate": 1000}, "6 joints, expected 7"),
        (move(7), "x.franka", {"rate": 500}, "expected the controller's cycle: 1000"),
        (swing(7), "x.franka", {"rate": 1000}, "move_along"),
        (PolynomialPath(("a\nb",), [[0.0]], 1.0), "x.csv", {"rate": 1}, "printable"),
        (PolynomialPath((" a",), [[0.0]], 1.0), "x.json", {}, "printable"),
    ],
)
def test_what_cannot_be_written_is_refused_and_the_old_file_stays(
    tmp_path, path, name, given, says
):
    file = tmp_path / name
    file.write_text("old")
    with pytest.raises(ProblemError, match=says.replace("at_along", "move_along")):
        write_trajectory(path, file, **given)
    assert file.read_text() == "old" and len(list(tmp_path.iterdir())) == 1


def fourier(**change):
    record = {
        "kind": "fourier",
        "joints": ["a"],
        "frequencies_hz": [1.0],
        "offset": [0.0],
        "sine": [[1.0]],
        "cosine": [[0.0]],
        "duration_s": 1.0,
        "start_s": 0.0,
    }
    return record | change


def document(*pieces, kind="fourier", **change):
    head = {"format": "consistent_id trajectory 1", "kind": kind}
    return json.dumps(head | {"pieces": list(pieces)} | change)


POINT = '{"positions": [%s], "time_from_start": {"sec": %s, "nanosec": 0}}'
FAULTY = {
    "an array": ("x.json", "[1, 2]", "Expected `object`"),
    "cut off": ("x.json", document(fourier())[:-9], "not JSON"),
    "bytes": ("x.json", b"\xff\xfe\x00", "not JSON"),
    "deep": ("x.json", "[" * 100_000, "x.json"),
    "NaN": ("x.json", document(fourier(offset=[np.nan])), "not JSON"),
    "huge": (
        "x.json",
        document(fourier()).replace("0.0", "1e999"),
        "out of range|not JSON",
    ),
    "text": ("x.json", document(fourier(sine=[["1"]])), r"sine\[0\]\[0\]"),
    "missing": ("x.json", '{"format": "consistent_id trajectory 1"}', "kind"),
    "unknown key": ("x.json", document(fourier(sin=1)), "`sin`"),
    "other version": ("x.json", document(format="consistent_id trajectory 2"), "ry 2'"),
    "ragged": ("x.json", document(fourier(sine=[[1.0], [1.0, 2.0]])), "x.json.*sine"),
    "no duration": ("x.json", document(fourier(duration_s=-1)), "duration is -1"),
    "no pieces": ("x.json", document(), "with pieces"),
    "two pieces": ("x.json", document(fourier(), fourier()), "with pieces"),
    "two in a move": ("x.json", document(fourier(), fourier(), kind="move"), "piec"),
    "jump": ("x.json", document(fourier(), kind="move"), "x.json: move: velocity"),
    "no zip": ("x.npz", "text", "not readable as NPZ"),
    "csv": ("x.csv", "time,q_a\n0,0\n1,1\n", "expected time and, of each joint"),
    "empty csv": ("x.csv", "", "no column or array of numbers"),
    "csv value": (
        "x.csv",
        "time,q_a,dq_a,ddq_a\n0,1,x,1\n",
        r"row 1 \(line 2\), column 'dq_a'",
    ),
    "no parquet": ("x.parquet", "text", "not readable as Parquet"),
    "width": (
        "x.yaml",
        f'{{"joint_names": ["a"], "points": [{POINT % ("1, 2", 0)}]}}',
        r"points\[0\].positions has 2 values, expected 1",
    ),
    "seconds": (
        "x.yaml",
        f'{{"joint_names": ["a"], "points": [{POINT % (1, -1)}]}}',
        r"points\[0\].time_from_start.sec",
    ),
    "back in time": (
        "x.yaml",
        f'{{"joint_names": ["a"], "points": [{POINT % (1, 1)}, {POINT % (1, 0)}]}}',
        "time goes from 1 s",
    ),
    "no points": ("x.yaml", "joint_names: [a]\npoints: []\n", "no points"),
    "alias": ("x.yaml", "a: &x [1]\njoint_names: *x\npoints: []\n", "alias"),
    "tag": ("x.yaml", "!!python/object/apply:os.system ['ls']\n", "not readable|Expec"),
    "no yaml": ("x.yaml", "a: [1\nb: }", "not readable as YAML"),
    "two messages": ("x.yaml", ECHO + ECHO, "2 messages"),
    "a program": ("x.script", "def f():\nend\n", "of a controller is not read back"),
    "unknown": ("x.bin", "", r"\.bin, expected one of"),
}


@pytest.mark.parametrize("case", FAULTY)
def test_a_faulty_file_is_refused_with_its_fault(tmp_path, case):
    name, data, says = FAULTY[case]
    file = tmp_path / name
    file.write_bytes(data.encode() if isinstance(data, str) else data)
    with pytest.raises(ConsistentIdError, match=says) as refusal:
        read_trajectory(file)
    assert name in str(refusal.value)


@pytest.mark.parametrize("ending", ["json", "npz", "csv", "parquet", "yaml"])
def test_a_file_that_is_not_there_is_named(tmp_path, ending):
    with pytest.raises(ConsistentIdError, match=rf"none\.{ending}"):
        read_trajectory(tmp_path / f"none.{ending}")


def npz(**arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


HEAD = {"format": "consistent_id trajectory 1", "kind": "polynomial"}


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (npz(**HEAD, piece0_control=np.array([{}])), "pickled"),
        (npz(format="other", kind="fourier"), "format is 'other'"),
        (npz(kind="fourier"), "no column 'format'"),
        (npz(**HEAD, piece_control=[[0.0]]), "expected pieceN_"),
        (npz(**HEAD, piece0_kind="polynomial", piece0_control="x"), "control"),
        (npz(**HEAD), "with pieces"),
    ],
)
def test_faulty_arrays_are_refused_and_never_unpickled(tmp_path, data, says):
    file = tmp_path / "x.npz"
    file.write_bytes(data)
    with pytest.raises(ConsistentIdError, match=says):
        read_trajectory(file)


@pytest.mark.parametrize("name", ["x.npz", "x.json"])
def test_what_swells_beyond_all_sizes_is_refused(tmp_path, monkeypatch, name):
    file = tmp_path / name
    monkeypatch.setattr("consistent_id.motion.files.document._LARGEST", 2**20)
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as members:
        members.writestr("piece0_sine.npy", bytes(3 * 2**20))
    assert file.stat().st_size < 2**20
    if name == "x.json":
        file.write_bytes(bytes(3 * 2**20))
    with pytest.raises(ProblemError, match="3 MiB, expected a trajectory of at most 1"):
        read_trajectory(file)
