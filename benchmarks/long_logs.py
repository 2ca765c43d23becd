"""Logs of the 7-joint arm of any length, written a piece at a time, by format."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from speed import arm, truth

_PIECE = 2**17  # samples written at a time
_GROUPS = 2**20  # rows of a row group
_STATE = "sensor_msgs/msg/JointState"
FILES = {"Parquet": "log.parquet", "CSV": "log.csv", "HDF5": "log.h5", "MCAP": "log"}
"""The log's file, or the bag's folder, by format."""


def pieces(samples: int) -> Iterator[dict[str, np.ndarray]]:
    """Yield the columns of a noisy log at 1 kHz, some rows at a time."""
    model, rng = arm(), np.random.default_rng(0)
    parameters, rate = truth(model), np.array([1.1, 1.7, 2.3, 2.9, 3.1, 3.7, 4.3])
    for first in range(0, samples, _PIECE):
        time = np.arange(first, min(first + _PIECE, samples)) / 1000.0
        angle = np.outer(time, rate) + np.arange(7)
        q, dq, ddq = np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)
        torque = model.predict(parameters, q, dq, ddq)
        torque += rng.normal(scale=0.5, size=torque.shape)
        columns = {"time": time}
        for k, joint in enumerate(model.robot.joint_names):
            columns |= {f"q_{joint}": q[:, k], f"tau_{joint}": torque[:, k]}
        yield columns


def write(folder: Path, form: str, samples: int) -> int:
    """Write a log; return its size in bytes."""
    file = folder / FILES[form]
    writers = {"Parquet": _parquet, "CSV": _csv, "HDF5": _hdf5, "MCAP": _mcap}
    writers[form](file, pieces(samples))
    files = file.iterdir() if file.is_dir() else [file]
    return sum(one.stat().st_size for one in files)


def _parquet(file: Path, some: Iterator[dict[str, np.ndarray]]) -> None:
    first = pa.table(next(some))
    with pq.ParquetWriter(file, first.schema) as writer:
        writer.write_table(first, row_group_size=_GROUPS)
        for columns in some:
            writer.write_table(pa.table(columns), row_group_size=_GROUPS)


def _csv(file: Path, some: Iterator[dict[str, np.ndarray]]) -> None:
    with file.open("w") as written:
        for k, columns in enumerate(some):
            header = "" if k else ",".join(columns)
            rows = np.column_stack(list(columns.values()))
            how = {"fmt": "%.12g", "delimiter": ",", "header": header, "comments": ""}
            np.savetxt(written, rows, **how)


def _hdf5(file: Path, some: Iterator[dict[str, np.ndarray]]) -> None:
    import h5py

    with h5py.File(file, "w") as written:
        for columns in some:
            for name, values in columns.items():
                if name not in written:
                    written.create_dataset(name, (0,), "f8", maxshape=(None,))
                written[name].resize(len(written[name]) + len(values), axis=0)
                written[name][-len(values) :] = values


def _mcap(folder: Path, some: Iterator[dict[str, np.ndarray]]) -> None:
    from rosbags import rosbag2
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    state, header, stamp = (
        types.types[name]
        for name in (_STATE, "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    plugin = rosbag2.StoragePlugin.MCAP
    with rosbag2.Writer(folder, version=9, storage_plugin=plugin) as bag:
        to = bag.add_connection("/joint_states", _STATE, typestore=types)
        for columns in some:
            joints = [name[2:] for name in columns if name.startswith("q_")]
            q = np.column_stack([columns[f"q_{joint}"] for joint in joints])
            tau = np.column_stack([columns[f"tau_{joint}"] for joint in joints])
            ticks = np.rint(columns["time"] * 1e9).astype(np.int64) + 10**9
            for at, position, effort in zip(ticks.tolist(), q, tau, strict=True):
                time = stamp(sec=at // 10**9, nanosec=at % 10**9)
                message = state(
                    header=header(stamp=time, frame_id=""),
                    name=joints,
                    position=position,
                    velocity=np.zeros(0),
                    effort=effort,
                )
                bag.write(to, at, types.serialize_cdr(message, _STATE))
