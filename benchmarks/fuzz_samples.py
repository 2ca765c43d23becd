"""Small valid files of every format that the package reads, and what reads them."""

import io
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import consistent_id as ci

_JOINT_STATE = "sensor_msgs/msg/JointState"
URDF = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/>
  <joint name="a" type="revolute">
    <parent link="base"/> <child link="upper"/> <origin xyz="0 0 0.1" rpy="0 0.2 0"/>
    <axis xyz="0 1 0"/> <limit lower="-3" upper="3" velocity="4" effort="90"/>
  </joint>
  <link name="upper"><inertial>
    <origin xyz="0.2 0.01 0.02"/> <mass value="4"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.08" iyz="0" izz="0.08"/>
  </inertial></link>
  <joint name="b" type="continuous">
    <parent link="upper"/> <child link="fore"/> <axis xyz="0 0 1"/>
  </joint>
  <link name="fore"><inertial>
    <mass value="2"/> <inertia ixx="1" ixy="0" ixz="0" iyy="3" iyz="0" izz="0.03"/>
  </inertial></link>
</robot>
"""
MJCF = """<mujoco model="arm">
  <compiler angle="degree"/>
  <default><geom density="800"/></default>
  <worldbody><body name="upper" pos="0 0 0.1">
    <joint name="a" axis="0 1 0" range="-90 90" limited="true"/>
    <inertial pos="0.2 0 0" mass="4" diaginertia="0.02 0.08 0.08"/>
    <body name="fore" pos="0.4 0 0"><joint name="b" type="slide"/>
      <geom type="capsule" size="0.03 0.1"/></body>
  </body></worldbody>
  <actuator><motor joint="a" gear="2" forcerange="-9 9" forcelimited="true"/></actuator>
</mujoco>
"""
PROBLEM = """name = "arm"
[model]
gravity = [0, 0, -9.81]
[[model.modified_dh]]
alpha_deg = 0
a = 0.0
[[model.modified_dh]]
alpha_deg = -90.0
a = 0.1
lower = -3
upper = 3
[links.link1]
mass = 2.5
com = [0.1, 0, 0]
[drive]
viscous = true
coulomb = "tanh"
velocity_scale = 0.02
[constraints]
masses = "datasheet"
bounds = {"link1.Izz" = [0.0, 2.0]}
[prior]
slack = 0.01
[data]
[[data.recordings]]
file = "log.csv"
role = "training"
rows = [1, 20]
"""


@dataclass(frozen=True)
class Sample:
    """A valid file, and what reads it.

    Parameters
    ----------
    name : str
        The file's name.
    content : bytes
    read : callable
        From a path.
    """

    name: str
    content: bytes
    read: Callable[[Path], object]


def samples(folder: Path) -> list[Sample]:
    """Write one file of each format into a folder, and return them."""
    written = [*_logs(folder), *_trajectories(folder), *_bags(folder)]
    written.append((_estimate(folder), _load_estimate))
    for name, text, read in (
        ("robot.urdf", URDF, _urdf),
        ("robot.xml", MJCF, ci.robot.load_mjcf),
        ("problem.toml", PROBLEM, ci.load_problem),
    ):
        (folder / name).write_text(text)
        written.append((folder / name, read))
    return [Sample(path.name, path.read_bytes(), read) for path, read in written]


def _urdf(path: Path) -> None:
    ci.robot.lint_urdf(path)
    ci.repair.repair_urdf(path, density=1000.0)
    ci.robot.load_urdf(path)


def _log(path: Path) -> None:
    ci.read_recording(path, ["a", "b"], ci.Columns(torque="tau_{joint}"))


def _bag(path: Path) -> None:
    ci.read_recording(path, ["a", "b"])


def _logs(folder: Path) -> list[tuple[Path, Callable[[Path], object]]]:
    import h5py
    import pyarrow as pa
    import pyarrow.feather as feather
    import pyarrow.parquet as pq
    from scipy.io import savemat

    time = np.arange(40) * 0.01
    names = ("time", "q_a", "q_b", "tau_a", "tau_b")
    waves = np.sin(time * np.arange(1, 5)[:, None])
    table = dict(zip(names, [time, *waves], strict=True))
    path = {
        name: folder / f"log.{name}"
        for name in ("csv", "npz", "h5", "mat", "parquet", "feather")
    }
    rows = np.column_stack(list(table.values()))
    np.savetxt(path["csv"], rows, "%.6g", ",", header=",".join(names), comments="")
    np.savez_compressed(path["npz"], **table)
    with h5py.File(path["h5"], "w") as file:
        for name, column in table.items():
            file.create_dataset(name, data=column, compression="gzip")
    savemat(path["mat"], table, do_compression=True)
    pq.write_table(pa.table(table), path["parquet"])
    feather.write_feather(pa.table(table), path["feather"])
    others = folder / "plain.mat", folder / "old.mat", folder / "plain.npz"
    savemat(others[0], table)
    savemat(others[1], table, format="4")
    np.savez(others[2], **table)
    return [(file, _log) for file in (*path.values(), *others)]


def _trajectories(folder: Path) -> list[tuple[Path, Callable[[Path], object]]]:
    path = ci.recordings.FourierTrajectory(
        ("a", "b"), [0.5, 1.0], [0.1, 0.2], np.eye(2), -np.eye(2), 2.0
    )
    return [
        (
            ci.motion.write_trajectory(path, folder / f"path.{ending}", rate=20.0),
            ci.motion.read_trajectory,
        )
        for ending in ("json", "npz", "csv", "parquet")
    ] + [(_message(folder), ci.motion.read_trajectory)]


def _message(folder: Path) -> Path:
    text = (
        "joint_names: [a, b]\npoints:\n"
        "  - {positions: [0.0, 1.0], time_from_start: {sec: 0, nanosec: 0}}\n"
        "  - {positions: [0.5, 2.0], time_from_start: {sec: 1, nanosec: 500}}\n"
    )
    (folder / "path.yaml").write_text(text)
    return folder / "path.yaml"


def _bags(folder: Path) -> list[tuple[Path, Callable[[Path], object]]]:
    (folder / "log.mcap").write_bytes(_mcap())
    paths = folder / "log.mcap", _sqlite_bag(folder), _old_bag(folder / "log.bag")
    return [(path, _bag) for path in paths]


def _mcap() -> bytes:
    from mcap_ros2.writer import Writer

    definition = (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\n"
        f"float64[] velocity\nfloat64[] effort\n{'=' * 80}\nMSG: std_msgs/Header\n"
        f"builtin_interfaces/Time stamp\nstring frame_id\n{'=' * 80}\n"
        "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )
    buffer = io.BytesIO()
    writer = Writer(buffer)
    schema = writer.register_msgdef("sensor_msgs/msg/JointState", definition)
    for k in range(20):
        header = {"stamp": {"sec": 1, "nanosec": 10**7 * k}, "frame_id": ""}
        values = {name: [0.1 * k, 1.0] for name in ("position", "velocity", "effort")}
        message = {"header": header, "name": ["a", "b"], **values}
        writer.write_message("/joint_states", schema, message, log_time=10**9 + k)
    writer.finish()
    return buffer.getvalue()


def _sqlite_bag(folder: Path) -> Path:
    """Write a bag of ROS 2, and return its file of messages."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(folder / "bag", version=9) as bag:
        topic = bag.add_connection("/joints", _JOINT_STATE, typestore=types)
        for k, state in enumerate(_states(types)):
            bag.write(topic, 10**9 + k, types.serialize_cdr(state, _JOINT_STATE))
    return next((folder / "bag").glob("*.db3"))


def _old_bag(path: Path) -> Path:
    """Write a bag of ROS 1."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC)
    with Writer(path) as bag:
        topic = bag.add_connection("/joints", _JOINT_STATE, typestore=types)
        for k, state in enumerate(_states(types)):
            bag.write(topic, 10**9 + k, types.serialize_ros1(state, _JOINT_STATE))
    return path


def _states(types) -> Iterator[object]:
    """Yield joint states in the words of a version of ROS."""
    make = types.types.__getitem__
    header = make("std_msgs/msg/Header")
    numbered = ["seq"] if "seq" in header.__annotations__ else []
    for k in range(20):
        stamp = make("builtin_interfaces/msg/Time")(1, 10**7 * k)
        values = [np.array([0.1 * k, 1.0])] * 3
        head = header(stamp=stamp, frame_id="", **dict.fromkeys(numbered, k))
        yield make(_JOINT_STATE)(head, ["a", "b"], *values)


def _torque_model() -> ci.TorqueModel:
    return ci.TorqueModel(ci.from_modified_dh("arm", [ci.DHRow(0, 0), ci.DHRow(1, 0)]))


def _estimate(folder: Path) -> Path:
    model = _torque_model()
    base = ci.regression.base_parameters(model)
    size = len(model.layout)
    estimate = ci.Estimate(
        method="made up",
        model=model,
        base=base,
        parameters=np.ones(size),
        base_covariance=None,
        origins=("data",) * size,
        undetermined=(),
        sigma=np.ones(2),
        certificate=ci.estimation.Certificate("certified", "made up"),
    )
    text = json.dumps(estimate.to_dict(), indent=1)
    (folder / "estimate.json").write_text(text)
    return folder / "estimate.json"


def _load_estimate(path: Path) -> None:
    model = _torque_model()
    ci.Estimate.load(path, model, ci.regression.base_parameters(model))
