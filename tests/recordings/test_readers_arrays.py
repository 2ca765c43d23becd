"""Files and tables of arrays: NPZ, HDF5, MATLAB, data frames and mappings."""

import os
import pickle
import sys
import zipfile

import h5py
import numpy as np
import pytest
import scipy.io

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers import (
    Columns,
    hdf5,
    read_recording,
)
from consistent_id.recordings.readers.recording_file import LogRows

JOINTS = ("elbow", "wrist")
SAMPLES = 5
TIME = np.arange(SAMPLES) * 0.1
VALUES = np.random.default_rng(0).normal(size=(SAMPLES, 3))
ORDER = ("base", "wrist", "elbow")  # of the columns of VALUES
EXPECTED = VALUES[:, [2, 1]]


def save_npz(path, arrays):
    np.savez(path, **arrays)


def save_hdf5(path, arrays):
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values


def nested(arrays):
    """Structures of MATLAB for names with points."""
    tree = {}
    for name, values in arrays.items():
        *groups, last = name.split(".")
        branch = tree
        for group in groups:
            branch = branch.setdefault(group, {})
        branch[last] = values
    return tree


def save_mat(path, arrays):
    scipy.io.savemat(path, nested(arrays))


def save_mat_compressed(path, arrays):
    scipy.io.savemat(path, nested(arrays), do_compression=True, oned_as="column")


def save_mat_4(path, arrays):
    scipy.io.savemat(path, arrays, format="4")


def save_mat_73(path, arrays):
    """Write as MATLAB does: transposed, classes by attribute, 512 bytes before."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in arrays.items():
            data = file.create_dataset(
                name.replace(".", "/"), data=np.atleast_2d(np.transpose(values))
            )
            data.attrs["MATLAB_class"] = np.bytes_("double")
    with open(path, "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


FORMATS = {
    "npz": (save_npz, "log.npz"),
    "h5": (save_hdf5, "log.h5"),
    "hdf5": (save_hdf5, "log.hdf5"),
    "mat 5": (save_mat, "log.mat"),
    "mat 5 compressed": (save_mat_compressed, "log.MAT"),
    "mat 4": (save_mat_4, "log.mat"),
    "mat 7.3": (save_mat_73, "log.mat"),
}
STRUCTURED = ("mat 5", "mat 5 compressed", "mat 7.3")


@pytest.fixture(params=FORMATS)
def save(request, tmp_path):
    """Write arrays in one of the formats; return the file."""
    write, name = FORMATS[request.param]

    def saved(arrays):
        write(tmp_path / name, arrays)
        return tmp_path / name

    saved.structured = request.param in STRUCTURED
    return saved


@pytest.fixture(params=[save_npz, save_hdf5, save_mat, save_mat_73])
def save_any(request, tmp_path):
    """Write arrays in each of the four formats; return the file."""
    endings = {save_npz: "npz", save_hdf5: "h5"}

    def saved(arrays):
        path = tmp_path / f"log.{endings.get(request.param, 'mat')}"
        request.param(path, arrays)
        return path

    return saved


def test_single_columns_are_read_by_name(save):
    columns = {f"q_{j}": v for j, v in zip(ORDER, VALUES.T, strict=True)}
    log = read_recording(save({"time": TIME} | columns), JOINTS)
    np.testing.assert_array_equal(log.time, TIME)
    np.testing.assert_array_equal(log.position, EXPECTED)


@pytest.mark.parametrize("transposed", [False, True])
def test_arrays_are_read_by_the_names_of_their_columns(save, transposed):
    array = np.ascontiguousarray(VALUES.T) if transposed else VALUES
    path = save({"t": TIME, "q": array, "tau": -array})
    columns = Columns("t", "q", torque="tau", array_joints=ORDER)
    log = read_recording(path, JOINTS, columns, torque_gain=[2.0, 3.0])
    np.testing.assert_array_equal(log.position, EXPECTED)
    np.testing.assert_array_equal(log.torque, -EXPECTED * [2.0, 3.0])
    assert log.velocity is None and log.joints == JOINTS


def test_columns_and_arrays_may_stand_side_by_side(save):
    path = save({"t": TIME, "q": VALUES, "i_A": TIME, "i_B": -TIME})
    names = {"A": "elbow", "B": "wrist"}
    columns = Columns("t", "q", torque="i_{joint}", names=names, array_joints=ORDER)
    log = read_recording(path, JOINTS, columns)
    np.testing.assert_array_equal(log.position, EXPECTED)
    np.testing.assert_array_equal(log.torque, np.c_[TIME, -TIME])


@pytest.mark.parametrize("kind", ["float32", "int16", "uint64"])
def test_every_numeric_type_is_read(save_any, kind):
    path = save_any({"time": TIME, "q_elbow": np.arange(5).astype(kind)})
    np.testing.assert_array_equal(
        read_recording(path, ["elbow"]).position[:, 0], range(5)
    )


@pytest.mark.parametrize("shape", [(5,), (5, 1), (1, 5)])
def test_vectors_may_be_rows_or_columns(save_any, shape):
    path = save_any({"time": TIME.reshape(shape), "q_elbow": TIME.reshape(shape)})
    log = read_recording(path, ["elbow"])
    np.testing.assert_array_equal(log.position, TIME[:, None])


@pytest.mark.parametrize("save", STRUCTURED, indirect=True)
@pytest.mark.parametrize("slash", [".", "/"])
def test_fields_of_structures_are_found_by_their_path(save, slash):
    path = save({"log.t": TIME, "log.arm.q": VALUES, "other": np.zeros(3)})
    columns = Columns(f"log{slash}t", f"log{slash}arm{slash}q", array_joints=ORDER)
    np.testing.assert_array_equal(
        read_recording(path, JOINTS, columns).position, EXPECTED
    )


def test_groups_of_hdf5_are_found_by_their_path(tmp_path):
    path = tmp_path / "log.h5"
    save_hdf5(path, {"run/t": TIME, "run/elbow/q": TIME, "run/wrist/q": -TIME})
    log = read_recording(path, JOINTS, Columns("/run/t", "run/{joint}/q"))
    np.testing.assert_array_equal(log.position, np.c_[TIME, -TIME])


def test_records_of_hdf5_are_read_by_their_fields(tmp_path):
    path = tmp_path / "log.h5"
    records = np.zeros(5, dtype=[("t", "f8"), ("q", "f4", (3,)), ("on", "i1")])
    records["t"], records["q"] = TIME, VALUES
    save_hdf5(path, {"run/log": records})
    columns = Columns("run/log/t", "run/log/q", array_joints=ORDER)
    log = read_recording(path, ORDER, columns)
    np.testing.assert_array_equal(log.time, TIME)
    np.testing.assert_array_equal(log.position, VALUES.astype(np.float32))


def test_frames_in_hdf5_are_read_by_the_names_of_their_columns(tmp_path):
    """As pandas writes them with ``to_hdf``."""
    path = tmp_path / "log.h5"
    names = np.array(["time", *(f"q_{joint}" for joint in ORDER)], dtype="S")
    frame = np.column_stack([TIME, VALUES])
    parts = {"axis0": names, "axis1": np.arange(5), "block0_items": names}
    save_hdf5(
        path, {f"df/{k}": v for k, v in (parts | {"block0_values": frame}).items()}
    )
    listed = hdf5.array_names(path)
    assert {"df/time", "df/q_elbow"} <= set(listed)
    log = read_recording(path, JOINTS, Columns("df/time", "df/q_{joint}"))
    places = [ORDER.index(joint) for joint in JOINTS]
    np.testing.assert_array_equal(log.position, VALUES[:, places])
    batches = list(hdf5.read_batches(path, ["df/time", "df/q_elbow"], 2))
    elbow = np.concatenate([batch["df/q_elbow"] for batch in batches])
    np.testing.assert_array_equal(elbow, VALUES[2:, ORDER.index("elbow")])


def test_groups_that_are_called_like_frames_are_none(tmp_path):
    path = tmp_path / "log.h5"
    names = np.array(["time"], dtype="S")
    save_hdf5(path, {"df/a_items": names, "df/a_values/q": VALUES, "t": TIME})
    assert set(hdf5.array_names(path)) == {"df/a_items", "df/a_values/q", "t"}


ARRAY = Columns("t", "q", array_joints=ORDER)
BAD_ARRAYS = {
    "missing": ({"t": TIME, "q2": VALUES}, ARRAY, "no (column|variable) 'q'; .*q2"),
    "as many samples as joints": (
        {"t": TIME[:3], "q": VALUES[:3]},
        ARRAY,
        r"array 'q' has shape \(3, 3\) .*axis of time is ambiguous",
    ),
    "too few joints": (
        {"t": TIME, "q": VALUES[:, :2]},
        ARRAY,
        r"array 'q' has shape \(.*expected \(5, 3\) or \(3, 5\).*3 joints",
    ),
    "too few samples": ({"t": TIME, "q": VALUES[:4]}, ARRAY, r"shape .*5 samples"),
    "no order": (
        {"t": TIME, "q": VALUES},
        Columns("t", "q"),
        "'q' has shape .*list the joints .* array_joints",
    ),
    "short column": (
        {"t": TIME, "q": TIME[:4]},
        Columns("t", "q"),
        "column 'q' has 4 values, time 't' has 5",
    ),
    "time twice": (
        {"t": TIME * 0, "q": TIME},
        Columns("t", "q"),
        r"time goes from 0 s \(sample 0\) to 0 s",
    ),
    "nan": (
        {"t": TIME, "q": TIME * np.nan},
        Columns("t", "q"),
        "position of joint 'elbow' is nan at sample 0",
    ),
    "complex": ({"t": TIME, "q": TIME * 1j}, Columns("t", "q"), "'q'.* holds complex"),
    "text": ({"t": TIME, "q": np.array(["a"] * 5, "S1")}, Columns("t", "q"), "'q'"),
}


@pytest.mark.parametrize(
    ("arrays", "columns", "message"), BAD_ARRAYS.values(), ids=BAD_ARRAYS
)
def test_arrays_that_do_not_fit_are_refused(save_any, arrays, columns, message):
    if columns is ARRAY:
        joints = JOINTS
    else:
        joints = JOINTS[:1]
    with pytest.raises(RecordingError, match=rf"log\.(npz|h5|mat).*{message}"):
        read_recording(save_any(arrays), joints, columns)


def test_a_joint_that_the_arrays_do_not_have_is_refused(tmp_path):
    columns = Columns("t", "q", array_joints=("elbow", "wirst"))
    with pytest.raises(RecordingError, match="no joint 'wrist'; known: wirst"):
        read_recording(tmp_path / "log.h5", JOINTS, columns)


@pytest.mark.parametrize("order", [("a", "a"), "ab"])
def test_joints_of_arrays_are_distinct_names(order):
    with pytest.raises(RecordingError, match=r"array_joints are .* distinct"):
        Columns(position="q", array_joints=order)


def test_one_array_for_several_joints_needs_their_order(tmp_path):
    with pytest.raises(RecordingError, match=r"'q' gives one name .* array_joints"):
        read_recording(tmp_path / "log.h5", JOINTS, Columns("t", "q"))


class Bomb:
    def __reduce__(self):
        return os.abort, ()


def test_pickled_objects_are_never_loaded(tmp_path):
    objects = np.array([Bomb()] * 2, dtype=object)
    np.savez(tmp_path / "log.npz", time=TIME[:2], q_elbow=objects)
    with pytest.raises(RecordingError, match=r"'q_elbow' cannot be read .*any code"):
        read_recording(tmp_path / "log.npz", ["elbow"])
    with zipfile.ZipFile(tmp_path / "log.npz", "w") as file:
        file.writestr("time.npy", pickle.dumps(Bomb()))
        file.writestr("q_elbow.npy", pickle.dumps(Bomb()))
    with pytest.raises(RecordingError, match="'time' "):
        read_recording(tmp_path / "log.npz", ["elbow"])


def test_an_array_that_stands_twice_in_npz_is_refused(tmp_path):
    save_npz(tmp_path / "log.npz", {"time": TIME, "q_elbow": TIME})
    with (
        zipfile.ZipFile(tmp_path / "log.npz", "a") as file,
        pytest.warns(UserWarning, match="Duplicate name"),
    ):
        file.writestr("time.npy", file.read("q_elbow.npy"))
    with pytest.raises(RecordingError, match=r"log\.npz: column 'time' occurs tw"):
        read_recording(tmp_path / "log.npz", ["elbow"])


def _stating(path, units):
    """Write a log whose datasets state units."""
    save_hdf5(path, {"time": TIME, "q_elbow": TIME})
    with h5py.File(path, "a") as file:
        for name, unit in units.items():
            file[name].attrs["units"] = unit


@pytest.mark.parametrize("unit", ["ms", "rpm", "deg/s"])
def test_a_position_that_is_none_by_its_unit_is_refused(tmp_path, unit):
    _stating(tmp_path / "log.h5", {"q_elbow": unit, "time": "s"})
    with pytest.raises(RecordingError, match=r"'q_elbow': no unit .* of position"):
        read_recording(tmp_path / "log.h5", ["elbow"])


@pytest.mark.parametrize(
    ("unit", "factor"), [("deg", np.pi / 180), (b"degrees", np.pi / 180), ("AU", 1.0)]
)
def test_a_unit_that_a_dataset_states_is_converted(tmp_path, unit, factor):
    file = tmp_path / "log.h5"
    _stating(file, {"q_elbow": unit, "time": "ms"})
    log = read_recording(file, ["elbow"])
    np.testing.assert_allclose(log.position[:, 0], factor * TIME, rtol=1e-15)
    np.testing.assert_allclose(log.time, 1e-3 * np.asarray(TIME), rtol=1e-15)
    rows = LogRows(file, ("elbow",), Columns())
    (part,) = rows.windows([(0, len(TIME))])
    np.testing.assert_array_equal(part.position, log.position)
    np.testing.assert_array_equal(np.concatenate(list(rows.times())), log.time)


def test_a_unit_is_not_converted_twice_and_not_contradicted(tmp_path):
    file = tmp_path / "log.h5"
    _stating(file, {"q_elbow": "deg"})
    log = read_recording(file, ["elbow"], Columns(units={"position": "deg"}))
    np.testing.assert_allclose(log.position[:, 0], np.radians(TIME), rtol=1e-15)
    with pytest.raises(
        RecordingError, match=r"'deg' according to the file, and in 'rev'"
    ):
        read_recording(file, ["elbow"], Columns(units={"position": "rev"}))


def test_a_group_is_no_dataset(tmp_path):
    save_hdf5(tmp_path / "log.h5", {"time": TIME, "q_elbow/data": TIME})
    with pytest.raises(RecordingError, match=r"is a group.*q_elbow/data"):
        read_recording(tmp_path / "log.h5", ["elbow"])


@pytest.mark.parametrize(
    "attributes",
    [
        {"MATLAB_class": np.bytes_("table"), "MATLAB_object_decode": 3},
        {"MATLAB_class": np.bytes_("char")},
        {"MATLAB_class": np.bytes_("logical")},
        {"MATLAB_class": np.bytes_("double"), "MATLAB_empty": 1},
    ],
)
def test_what_is_no_number_in_matlab_is_refused(tmp_path, attributes):
    save_mat_73(tmp_path / "log.mat", {"time": TIME, "q_elbow": TIME})
    with h5py.File(tmp_path / "log.mat", "a") as file:
        file["q_elbow"].attrs.update(attributes)
    with pytest.raises(RecordingError, match=r"'q_elbow' is .* of MATLAB"):
        read_recording(tmp_path / "log.mat", ["elbow"])


BAD_STRUCTURES = {
    "no field": ({"log": {"t": TIME}}, "'log' has no field 'q'; known: t"),
    "no structure": (
        {"log": {"t": TIME, "q": {"x": 1}}},
        "'log.q' is not an array of num",
    ),
    "cell": (
        {"log": {"t": TIME, "q": np.array([1, "a"], object)}},
        "'log.q' is not an a",
    ),
    "structures": (
        {"log": np.array([(1.0, 2.0)] * 2, dtype=[("t", "f8"), ("q", "f8")])},
        "'log' is an array of 2 structures",
    ),
    "nothing": ({"x": 1.0}, "no variable 'log'; known: x"),
}


@pytest.mark.parametrize(
    ("variables", "message"), BAD_STRUCTURES.values(), ids=BAD_STRUCTURES
)
def test_structures_that_do_not_fit_are_refused(tmp_path, variables, message):
    scipy.io.savemat(tmp_path / "log.mat", variables)
    with pytest.raises(RecordingError, match=rf"log\.mat: {message}"):
        read_recording(tmp_path / "log.mat", ["elbow"], Columns("log.t", "log.q"))


@pytest.mark.parametrize("cut", [0, 3, 60, 200, -20])
def test_cut_files_are_refused(save_any, cut):
    path = save_any({"time": TIME, "q_elbow": TIME})
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(RecordingError, match=r"log\.\w+: "):
        read_recording(path, ["elbow"])


# Without a look at their elements, SciPy crashes on some MATLAB 5 files.
@pytest.mark.slow
def test_damaged_files_are_refused_or_read(save_any):
    path = save_any({"time": TIME, "q_elbow": TIME})
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    for _ in range(60):
        damaged = bytearray(whole)
        for place in rng.integers(0, len(whole), 3):
            damaged[place] = rng.integers(256)
        path.write_bytes(damaged)
        try:
            read_recording(path, ["elbow"])
        except RecordingError as refusal:
            assert path.name in str(refusal)


@pytest.mark.parametrize("name", ["log.h5", "log.npz", "log.mat"])
def test_text_is_refused(tmp_path, name):
    (tmp_path / name).write_text("time,q_elbow\n0,1\n1,2\n" * 50)
    with pytest.raises(RecordingError, match=rf"{name}: not readable as"):
        read_recording(tmp_path / name, ["elbow"])


@pytest.mark.parametrize("write", [save_hdf5, save_mat_73])
def test_without_h5py_the_message_says_how_to_install_it(tmp_path, monkeypatch, write):
    path = tmp_path / ("log.h5" if write is save_hdf5 else "log.mat")
    write(path, {"time": TIME, "q_elbow": TIME})
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(RecordingError, match=r"pip install 'consistent-id\[hdf5\]'"):
        read_recording(path, ["elbow"])


@pytest.mark.parametrize("lying", [False, True])
def test_columns_of_one_array_are_numbered(tmp_path, lying):
    t = np.arange(30) * 0.1
    table = np.column_stack([t, np.sin(t), np.cos(t)])
    np.save(tmp_path / "log.npy", table.T if lying else table)
    log = read_recording(tmp_path / "log.npy", ["a"], Columns("column1", "column3"))
    np.testing.assert_array_equal(log.position[:, 0], np.cos(t))
