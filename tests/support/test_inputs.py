"""Files that are read: sizes that they state are compared with what they are."""

import io
import os
import struct
import zipfile
import zlib

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from consistent_id import (
    Columns,
    ModelError,
    ProblemError,
    RecordingError,
    large_files,
    load_problem,
    read_recording,
)
from consistent_id.motion import read_trajectory
from consistent_id.repair import lint_robot as lint
from consistent_id.robot import lint_urdf, load_mjcf, load_urdf

LARGE = "--large-files"


def read(path):
    return read_recording(path, ["a"], Columns("time", "q_{joint}"))


def npz_with_header(path, shape, data):
    """A file whose array states a shape and has other data."""
    header = io.BytesIO()
    stated = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(header, stated)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name in ("time", "q_a"):
            file.writestr(f"{name}.npy", header.getvalue() + data)


def test_an_npz_array_that_states_more_than_it_has_is_refused(tmp_path):
    npz_with_header(tmp_path / "log.npz", (10**12,), bytes(80))
    with pytest.raises(RecordingError, match=r"states shape \(1000000000000,\)"):
        read(tmp_path / "log.npz")


@pytest.mark.slow
def test_an_npz_file_that_unpacks_to_much_more_is_refused_unless_meant(tmp_path):
    zeros = np.zeros(20_000_000, np.int8)  # eight times as much as numbers
    np.savez_compressed(tmp_path / "log.npz", time=zeros, q_a=zeros)
    assert (tmp_path / "log.npz").stat().st_size < 10**6
    with pytest.raises(RecordingError, match=f"305 MiB of data.*{LARGE}"):
        read(tmp_path / "log.npz")
    with large_files(), pytest.raises(RecordingError, match="no column 'q_b'"):
        read_recording(tmp_path / "log.npz", ["b"])


def test_an_hdf5_dataset_without_data_for_its_shape_is_refused(tmp_path):
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for name in ("time", "q_a"):
            file.create_dataset(name, shape=(10**12,), chunks=(1000,), dtype="f8")
    with pytest.raises(RecordingError, match=LARGE):
        read(tmp_path / "log.h5")


def two_hdf5(folder):
    with h5py.File(folder / "other.h5", "w") as other:
        other["x"] = other["g/x"] = np.arange(5.0)
    return h5py.File(folder / "log.h5", "w")


@pytest.mark.parametrize("place", ["direct", "group", "soft"])
def test_links_into_other_hdf5_files_are_not_followed(tmp_path, place):
    with two_hdf5(tmp_path) as file:
        file["time"] = np.arange(5.0)
        if place == "group":
            file["there"] = h5py.ExternalLink("other.h5", "/g")
        else:
            file["out"] = h5py.ExternalLink("other.h5", "/x")
        if place == "soft":
            file["soft"] = h5py.SoftLink("/out")
    name = {"direct": "out", "group": "there/x", "soft": "soft"}[place]
    with pytest.raises(RecordingError, match=r"another file, 'other.h5'.*not opened"):
        read_recording(tmp_path / "log.h5", ["a"], Columns("time", name))


def test_links_within_a_file_are_followed_and_loops_of_them_end(tmp_path):
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["run/time"] = np.arange(5.0)
        file["run/q"] = np.arange(5.0)
        file["run/again"] = h5py.SoftLink("q")
        file["last"] = h5py.SoftLink("/run")
        file["loop"] = h5py.SoftLink("/loop")
    columns = Columns("last/time", "last/again")
    log = read_recording(tmp_path / "log.h5", ["a"], columns)
    assert log.position[:, 0].tolist() == [0, 1, 2, 3, 4]
    with pytest.raises(RecordingError, match="links"):
        read_recording(tmp_path / "log.h5", ["a"], Columns("loop", "last/again"))


def test_hdf5_data_that_are_kept_in_other_files_are_not_read(tmp_path):
    (tmp_path / "raw").write_bytes(np.arange(5.0).tobytes())
    with two_hdf5(tmp_path) as file:
        file["time"] = np.arange(5.0)
        raw = [(str(tmp_path / "raw"), 0, 40)]
        file.create_dataset("q_a", shape=(5,), dtype="f8", external=raw)
        layout = h5py.VirtualLayout((5,), "f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "x", (5,))
        file.create_virtual_dataset("q_b", layout)
    for joint in "ab":
        with pytest.raises(RecordingError, match="stored in other files"):
            read_recording(tmp_path / "log.h5", [joint], Columns())


@pytest.mark.slow
def test_a_compressed_matlab_file_that_states_much_more_is_refused(tmp_path):
    zeros = np.zeros(6_000_000, np.int8)
    savemat(tmp_path / "log.mat", {"time": zeros, "q_a": zeros}, do_compression=True)
    content = (tmp_path / "log.mat").read_bytes()
    assert len(content) < 20_000
    element = zlib.compress(struct.pack("<II", 14, 2**31))
    begin = content[:128] + struct.pack("<II", 15, len(element))
    (tmp_path / "log.mat").write_bytes(begin + element)
    with pytest.raises(RecordingError, match=LARGE):
        read(tmp_path / "log.mat")


def test_nested_cells_without_end_are_refused(tmp_path):
    matrix = b""
    for _ in range(3000):  # class, shape, name, and the cell within
        inner = struct.pack("<IIII", 6, 8, 1, 0) + struct.pack("<IIii", 5, 8, 1, 1)
        matrix = struct.pack("<II", 14, len(inner) + 8 + len(matrix)) + (
            inner + struct.pack("<II", 1, 0) + matrix
        )
    head = b" " * 124 + b"\x00\x01IM"
    (tmp_path / "log.mat").write_bytes(head + matrix)
    with pytest.raises(RecordingError, match="nested deeper than 64"):
        read(tmp_path / "log.mat")


@pytest.mark.slow
def test_a_parquet_file_of_many_equal_rows_is_refused_unless_meant(tmp_path):
    many = pa.array(np.zeros(20_000_000))
    table = pa.table({"time": many, "q_a": many})
    pq.write_table(table, tmp_path / "log.parquet", compression="zstd")
    with pytest.raises(RecordingError, match=LARGE):
        read(tmp_path / "log.parquet")


def mcap(records):
    body = b"".join(struct.pack("<BQ", k, len(data)) + data for k, data in records)
    return b"\x89MCAP0\r\n" + body


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (mcap([(6, struct.pack("<QQQ", 0, 0, 2**40) + bytes(8))]), LARGE),
        (mcap([]) + struct.pack("<BQ", 6, 2**60), "the file ends before"),
    ],
)
def test_sizes_that_an_mcap_file_has_not_are_refused(tmp_path, content, match):
    (tmp_path / "log.mcap").write_bytes(content)
    with pytest.raises(RecordingError, match=match):
        read_recording(tmp_path / "log.mcap", ["a"])


@pytest.mark.parametrize("load", [load_urdf, load_mjcf, load_problem, lint_urdf])
def test_devices_and_pipes_are_not_read(tmp_path, load):
    os.mkfifo(tmp_path / "robot.pipe")
    for path in ("/dev/zero", tmp_path / "robot.pipe"):
        with pytest.raises((ModelError, ProblemError), match="regular file"):
            load(path)


def test_a_pipe_is_no_log(tmp_path):
    os.mkfifo(tmp_path / "log.csv")
    with pytest.raises(RecordingError, match="regular file"):
        read(tmp_path / "log.csv")


def piped(folder, text, pipe):
    """Write an MJCF file, and a pipe that it names."""
    (folder / pipe).parent.mkdir(exist_ok=True)
    os.mkfifo(folder / pipe)
    (folder / "robot.xml").write_text(f"<mujoco>{text}</mujoco>")
    return folder / "robot.xml"


MESH = '<asset><mesh name="m" file="m.stl"/></asset>'


@pytest.mark.parametrize(
    ("text", "pipe"),
    [
        ('<include file="part.xml"/>', "part.xml"),
        ('<include file="parts/a.xml"/>', "parts/b.xml"),
        (MESH, "m.stl"),
        (f'<compiler meshdir="meshes"/>{MESH}', "meshes/m.stl"),
        ('<asset><texture type="cube" fileright="t.png"/></asset>', "t.png"),
    ],
)
@pytest.mark.parametrize("load", [load_mjcf, lint])
def test_pipes_that_an_mjcf_file_names_are_not_read(tmp_path, load, text, pipe):
    robot = piped(tmp_path, text, pipe)
    if pipe == "parts/b.xml":
        included = '<mujoco><include file="b.xml"/></mujoco>'
        (tmp_path / "parts" / "a.xml").write_text(included)
    with pytest.raises(ModelError, match="regular file"):
        load(robot)


def test_files_that_include_one_another_are_mujocos_to_refuse(tmp_path):
    (tmp_path / "a.xml").write_text('<mujoco><include file="a.xml"/></mujoco>')
    with pytest.raises(ModelError, match="MuJoCo refuses it"):
        load_mjcf(tmp_path / "a.xml")


def test_a_pipe_is_no_trajectory_and_no_part_of_a_bag(tmp_path):
    for name in ("x.npz", "x.json", "x.csv"):
        os.mkfifo(tmp_path / name)
        with pytest.raises((ProblemError, RecordingError), match="regular file"):
            read_trajectory(tmp_path / name)
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    os.mkfifo(tmp_path / "bag" / "bag_0.db3")
    with pytest.raises(RecordingError, match="regular file"):
        read_recording(tmp_path / "bag", ["a"])


@pytest.mark.slow
def test_lists_in_parquet_count_with_all_their_values(tmp_path):
    lists = pa.FixedSizeListArray.from_arrays(pa.array(np.zeros(40_000_000)), 400)
    table = pa.table({"time": np.arange(100_000.0), "q": lists})
    pq.write_table(table, tmp_path / "log.parquet")
    assert (tmp_path / "log.parquet").stat().st_size < 2**20
    columns = Columns(position="q[0:1]", array_joints=("a",))
    with pytest.raises(RecordingError, match=f"306 MiB of data.*{LARGE}"):
        read_recording(tmp_path / "log.parquet", ["a"], columns)


@pytest.mark.slow
def test_arrow_never_has_a_whole_log_in_memory(tmp_path):
    """Columns are filled batch by batch; those that nobody asked for are not read."""
    rows = 400_000
    table = {f"q_{k}": np.random.default_rng(k).normal(size=rows) for k in range(20)}
    pq.write_table(
        pa.table({"time": np.arange(rows)} | table), tmp_path / "log.parquet"
    )
    pool, before = (
        pa.proxy_memory_pool(pa.default_memory_pool()),
        pa.default_memory_pool(),
    )
    pa.set_memory_pool(pool)
    try:
        recording = read_recording(tmp_path / "log.parquet", ["0", "19"])
    finally:
        pa.set_memory_pool(before)
    assert pool.max_memory() < 3 * 8 * rows  # the three columns as a whole
    np.testing.assert_array_equal(recording.position[:, 1], table["q_19"])


@pytest.mark.slow
def test_a_model_of_more_than_32_mib_is_refused(tmp_path):
    (tmp_path / "robot.urdf").write_bytes(b"<robot>" + b" " * (33 * 2**20))
    with pytest.raises(ModelError, match=f"at most 32 MiB.*{LARGE}"):
        load_urdf(tmp_path / "robot.urdf")


@pytest.mark.parametrize("load", [load_urdf, load_mjcf])
def test_elements_nested_without_end_are_refused(tmp_path, load):
    deep = "<a>" * 2000 + "</a>" * 2000
    (tmp_path / "robot.xml").write_text(f"<robot>{deep}</robot>")
    with pytest.raises(ModelError, match="nested deeper than 256"):
        load(tmp_path / "robot.xml")


def chain(joints):
    parts = ['<link name="l0"/>']
    for k in range(joints):
        parts.append(
            f'<link name="l{k + 1}"/><joint name="j{k}" type="fixed">'
            f'<parent link="l{k}"/><child link="l{k + 1}"/></joint>'
        )
    return f"<robot name='chain'>{''.join(parts)}</robot>"


def test_a_chain_of_thousands_of_joints_is_refused(tmp_path):
    (tmp_path / "robot.urdf").write_text(chain(3000))
    with pytest.raises(ModelError, match="3000 joints, expected at most 1000"):
        load_urdf(tmp_path / "robot.urdf")


def test_links_that_are_fixed_to_one_another_in_a_ring_are_refused(tmp_path):
    ring = "".join(
        f'<link name="{a}"/><joint name="{a}{b}" type="fixed"><parent link="{a}"/>'
        f'<child link="{b}"/></joint>'
        for a, b in ("ab", "ba")
    )
    (tmp_path / "robot.urdf").write_text(f"<robot name='ring'>{ring}</robot>")
    with pytest.raises(ModelError, match="carry one another: a < b < a"):
        load_urdf(tmp_path / "robot.urdf", base="a")


def test_copies_of_bodies_without_end_are_refused(tmp_path):
    body = "<body><joint/><geom size='1'/></body>"
    inner = f"<replicate count='100000'>{body}</replicate>"
    text = f"<mujoco><worldbody>{inner}</worldbody></mujoco>"
    (tmp_path / "robot.xml").write_text(text)
    with pytest.raises(ModelError, match="bodies and joints"):
        load_mjcf(tmp_path / "robot.xml")


def test_a_document_type_in_mjcf_is_refused(tmp_path):
    text = "<!DOCTYPE a [<!ENTITY e 'x'>]><mujoco>&e;</mujoco>"
    (tmp_path / "robot.xml").write_text(text)
    with pytest.raises(ModelError, match="document type"):
        load_mjcf(tmp_path / "robot.xml")


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("#" * 2**20 + "\n", "at most 1 MiB"),
        ("".join(f"k{i} = 1\n" for i in range(10_001)), "10001 keys"),
        (".".join(["a"] * 10_000) + " = 1", "dots in a key"),
        (f"[{'.'.join(['a'] * 10_000)}]", "dots in a key"),
        ("a = " + "[" * 100_000 + "]" * 100_000, "nested too deeply"),
    ],
)
def test_a_problem_file_beyond_reason_is_refused(tmp_path, text, match):
    (tmp_path / "problem.toml").write_text(text)
    with pytest.raises(ProblemError, match=match):
        load_problem(tmp_path)
