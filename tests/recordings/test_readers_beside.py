"""Columns of a base, of contacts and of wrenches, in tables and in arrays."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pyarrow import feather

import consistent_id as ci

TIME = 0.01 * np.arange(300)
JOINTS = ("hip", "knee")


@pytest.fixture
def simulated(tmp_path):
    """A log as MuJoCo's arrays have it: a free joint's seven positions, then joints."""
    rng = np.random.default_rng(0)
    angle = 0.3 * np.sin(2 * TIME)
    qpos = np.zeros((300, 9))
    qpos[:, 2] = 0.4 + 0.1 * np.sin(3 * TIME)
    qpos[:, 3], qpos[:, 6] = np.cos(angle / 2), np.sin(angle / 2)
    qpos[:, 7:] = rng.normal(size=(300, 2))
    arrays = {
        "time": TIME,
        "qpos": qpos,
        "qfrc_actuator": rng.normal(size=(300, 8)),
        "sensordata": np.column_stack(
            [np.zeros((300, 2)), 0.6 * np.cos(2 * TIME), rng.normal(size=(300, 6))]
        ),
    }
    path = tmp_path / "log.npz"
    np.savez(path, **arrays)
    return path, arrays


def columns(**beside):
    return ci.Columns(
        position="qpos[7:9]",
        torque="qfrc_actuator[6:8]",
        array_joints=JOINTS,
        beside=ci.recordings.BesideColumns(**beside),
    )


def test_parts_of_arrays_are_read(simulated):
    path, arrays = simulated
    log = ci.read_recording(path, JOINTS, columns())
    assert np.array_equal(log.position, arrays["qpos"][:, 7:])
    assert np.array_equal(log.torque, arrays["qfrc_actuator"][:, 6:])
    assert log.base is None


def test_a_bases_pose_gives_its_motion(simulated):
    path, _ = simulated
    base = ci.recordings.BaseColumns(
        position="qpos[0:3]", orientation="qpos[3:7]", order="wxyz"
    )
    moved = ci.read_recording(path, JOINTS, columns(base=base)).base
    inside = slice(5, -5)
    # Central differences of waves of 3 rad/s at 100 Hz err by 1.5e-4.
    assert np.allclose(
        moved.angular_velocity[inside, 2], 0.6 * np.cos(2 * TIME[inside]), atol=1e-3
    )
    up = 9.81 - 0.9 * np.sin(3 * TIME[inside])
    assert np.allclose(moved.specific_force[inside, 2], up, atol=1e-3)


def test_an_imu_contacts_and_wrenches_are_read(simulated):
    path, arrays = simulated
    sensors = arrays["sensordata"]
    log = ci.read_recording(
        path,
        JOINTS,
        columns(
            base=ci.recordings.BaseColumns("sensordata[0:3]", "sensordata[3:6]"),
            contacts=[
                ci.recordings.ContactColumns(
                    "foot", "sensordata[6:7]", 0.0, guard=0.015
                )
            ],
            wrenches=[
                ci.recordings.WrenchColumns("hand", "sensordata[6:9]", on_robot=False)
            ],
        ),
    )
    assert np.array_equal(log.base.angular_velocity, sensors[:, :3])
    assert np.array_equal(log.base.specific_force, sensors[:, 3:6])
    assert np.array_equal(log.contacts[0].closed, sensors[:, 6] > 0.0)
    changes = np.flatnonzero(np.diff(log.contacts[0].closed))
    assert not log.contacts[0].certain[changes].any()
    assert np.array_equal(log.wrenches[0].values[:, :3], -sensors[:, 6:9])
    assert not log.wrenches[0].values[:, 3:].any()


def test_rows_left_out_are_left_out_everywhere(simulated):
    path, arrays = simulated
    wrench = ci.recordings.WrenchColumns("hand", "sensordata[6:9]")
    log = ci.read_recording(path, JOINTS, columns(wrenches=[wrench]), omit=[1, 5])
    kept = np.delete(arrays["sensordata"][:, 6:9], [0, 4], axis=0)
    assert np.array_equal(log.wrenches[0].values[:, :3], kept)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ("sensordata[6:20]", "has 9 columns, counted from 0"),
        ("sensordata[6:8]", "2 columns, expected 3 or 6"),
        ("time[0:1]", r"has shape \(300,\), expected rows and columns"),
        ("sensors", "sensors"),
    ],
)
def test_faulty_columns_are_named(simulated, values, message):
    wrenches = [ci.recordings.WrenchColumns("hand", values)]
    with pytest.raises(ci.RecordingError, match=message):
        ci.read_recording(simulated[0], JOINTS, columns(wrenches=wrenches))


def test_filters_treat_a_base_and_wrenches_as_motion_and_torque():
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(300, 9))
    log = ci.Recording(
        ("a", "b", "c"),
        TIME,
        noise[:, :3],
        torque=noise[:, :3],
        base=ci.recordings.BaseMotion(*np.split(noise, 3, axis=1)),
        wrenches=[ci.recordings.Wrench("a", noise[:, :6])],
    )
    slow = ci.low_passed(log, motion_cutoff=5.0, torque_cutoff=8.0)
    assert np.allclose(slow.base.angular_velocity, slow.position)
    assert np.allclose(slow.wrenches[0].values[:, :3], slow.torque)
    assert not np.allclose(slow.position, slow.torque)
    half = ci.signals.decimated(log, 2)
    assert len(half.base) == len(half.wrenches[0]) == 150


def test_a_new_clock_takes_all_with_it():
    rng = np.random.default_rng(0)
    time = TIME + 0.002 * rng.uniform(size=300)
    angle = np.sin(2 * time)
    turn = np.column_stack([np.cos(angle / 2), np.zeros((300, 2)), np.sin(angle / 2)])
    still = np.zeros((300, 3))
    wave = np.column_stack([np.sin(3 * time), 0 * time, 0 * time])
    log = ci.Recording(
        ("a",),
        time,
        angle[:, None],
        base=ci.recordings.BaseMotion(
            wave, still, still, ci.signals.rotations(turn, "wxyz")
        ),
        contacts=[ci.recordings.ContactFlags("a", time > 1.0)],
    )
    new = ci.resampled(log, 120.0)
    assert np.allclose(new.base.angular_velocity[:, 0], np.sin(3 * new.time), atol=1e-5)
    R = new.base.rotation
    assert np.allclose(R @ np.swapaxes(R, 1, 2), np.eye(3), atol=1e-12)
    assert np.allclose(
        np.arctan2(R[:, 1, 0], R[:, 0, 0]), np.sin(2 * new.time), atol=1e-5
    )
    flags = new.contacts[0]
    assert np.array_equal(flags.closed[flags.certain], new.time[flags.certain] > 1.0)
    assert 0 < (~flags.certain).sum() < 3


def _csv(path, arrays):
    wide = {name: values.reshape(len(TIME), -1) for name, values in arrays.items()}
    names = [
        f"{k}_{i}" if v.shape[1] > 1 else k for k, v in wide.items() for i in _places(v)
    ]
    header = ",".join(names)
    table = np.hstack(list(wide.values()))
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.17g")


def _places(values):
    return range(values.shape[1])


def _hdf5(path, arrays):
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values


def _mat(path, arrays):
    import scipy.io

    tree = {}
    for name, values in arrays.items():
        *folders, last = name.split("/")
        place = tree
        for folder in folders:
            place = place.setdefault(folder, {})
        place[last] = values
    scipy.io.savemat(path, tree)


FORMATS = {"log.csv": _csv, "log.h5": _hdf5, "log.mat": _mat}
"""Writers; a table has a column for each number, the others arrays in groups."""


@pytest.mark.parametrize("order", ["xyzw", "wxyz"])
@pytest.mark.parametrize("name", FORMATS)
def test_base_contact_and_wrench_are_read_in_every_format(tmp_path, name, order):
    rng = np.random.default_rng(0)
    angle = 0.3 * np.sin(2 * TIME)
    quaternion = np.zeros((300, 4))
    quaternion[:, "xyzw".index("z")] = np.sin(angle / 2)
    quaternion[:, 3] = np.cos(angle / 2)
    if order == "wxyz":
        quaternion = quaternion[:, [3, 0, 1, 2]]
    arrays = {
        "t": TIME,
        "q": rng.normal(size=(300, 2)),
        "imu/gyro": rng.normal(size=(300, 3)),
        "imu/acc": rng.normal(size=(300, 3)),
        "imu/quat": quaternion,
        "ft/force": rng.normal(size=(300, 3)),
        "ft/torque": rng.normal(size=(300, 3)),
        "foot": (TIME > 1.0).astype(float),
    }
    FORMATS[name](tmp_path / name, arrays)
    flat = name.endswith(".csv")

    def named(key):
        return [f"{key}_{i}" for i in _places(arrays[key])] if flat else key

    wrench = [*named("ft/force"), *named("ft/torque")]
    found = ci.read_recording(
        tmp_path / name,
        JOINTS,
        ci.Columns(
            time="t",
            position="q_{index}" if flat else "q",
            array_joints=() if flat else JOINTS,
            beside=ci.recordings.BesideColumns(
                base=ci.recordings.BaseColumns(
                    named("imu/gyro"),
                    named("imu/acc"),
                    orientation=named("imu/quat"),
                    order=order,
                ),
                contacts=[ci.recordings.ContactColumns("foot", "foot")],
                wrenches=[
                    ci.recordings.WrenchColumns(
                        "hand", wrench if flat else ["ft/force", "ft/torque"]
                    )
                ],
            ),
        ),
    )
    measured = np.hstack([arrays["ft/force"], arrays["ft/torque"]])
    assert np.array_equal(found.wrenches[0].values, measured)
    assert np.array_equal(found.base.angular_velocity, arrays["imu/gyro"])
    assert np.array_equal(found.base.specific_force, arrays["imu/acc"])
    assert np.allclose(found.base.rotation[:, 1, 0], np.sin(angle))
    assert np.array_equal(found.contacts[0].closed, TIME > 1.0)


@pytest.mark.parametrize("ending", ["parquet", "feather"])
def test_a_contact_that_is_true_or_false_is_read(tmp_path, ending):
    closed = TIME > 1.0
    table = pa.table({"time": TIME, "q_hip": np.sin(TIME), "touch": closed})
    path = tmp_path / f"log.{ending}"
    (pq.write_table if ending == "parquet" else feather.write_feather)(table, path)
    contact = ci.recordings.ContactColumns("foot", "touch")
    beside = ci.recordings.BesideColumns(contacts=[contact])
    log = ci.read_recording(path, ["hip"], ci.Columns(beside=beside))
    np.testing.assert_array_equal(log.contacts[0].closed, closed)
    missing = pa.array([None, *closed[1:].tolist()])
    table = table.set_column(2, "touch", missing)
    (pq.write_table if ending == "parquet" else feather.write_feather)(table, path)
    with pytest.raises(ci.RecordingError, match=r"touch.* at sample 0.*--omit 1 "):
        ci.read_recording(path, ["hip"], ci.Columns(beside=beside))
