"""ROS 2 ``trajectory_msgs/JointTrajectory`` messages, as YAML that is also JSON.

One text is both: ROS tools read YAML 1.1, in which ``1e-05`` is a string, so numbers
always have a point.
"""

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from consistent_id._support.arrays import Matrix
from consistent_id._support.extras import needed
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording

_BILLION = 1_000_000_000
_CHANNELS = ("positions", "velocities", "accelerations")


class _Duration(msgspec.Struct):
    sec: Annotated[int, Meta(ge=0, lt=2**31)]
    nanosec: Annotated[int, Meta(ge=0, lt=_BILLION)]


class _Point(msgspec.Struct):
    positions: list[float]
    time_from_start: _Duration
    velocities: list[float] = []
    accelerations: list[float] = []


class _JointTrajectory(msgspec.Struct):
    joint_names: list[str]
    points: list[_Point]


def message_of(samples: Recording) -> str:
    """Return samples as a message; times are rounded to nanoseconds.

    The stamp is zero: a controller begins at once.
    """
    nanoseconds = np.round((samples.time - samples.time[0]) * _BILLION).astype(int)
    names = json.dumps(list(samples.joints), ensure_ascii=False)
    channels = [samples.position, samples.velocity, samples.acceleration]
    rows = zip(*(c for c in channels if c is not None), nanoseconds, strict=True)
    points = ",\n".join(_point(values, int(when)) for *values, when in rows)
    return (
        '{"header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},\n'
        f'"joint_names": {names},\n"points": [\n{points}\n]}}\n'
    )


def samples_of_message(content: bytes, where: Path) -> Recording:
    """Return the samples of a message in JSON or, with the extra ``ros``, any YAML.

    Raises
    ------
    RecordingError
        With the key of the first fault.
    """
    try:
        message = _decoded(content, where)
    except msgspec.ValidationError as cause:
        raise RecordingError(f"{where}: {cause} ($ is the file)") from None
    time = [
        (p.time_from_start.sec * _BILLION + p.time_from_start.nanosec) / _BILLION
        for p in message.points
    ]
    q, dq, ddq = (_channel(message, name, where) for name in _CHANNELS)
    if q is None:
        raise RecordingError(f"{where}: no points with positions")
    joints = tuple(message.joint_names)
    return Recording(joints, np.array(time), q, dq, ddq, name=where.name)


def _point(values: Sequence[Matrix], when: int) -> str:
    channels = ", ".join(
        f'"{name}": [{", ".join(map(_number, row.tolist()))}]'
        for name, row in zip(_CHANNELS, values, strict=False)
    )
    sec, nanosec = divmod(when, _BILLION)
    return f'{{{channels}, "time_from_start": {{"sec": {sec}, "nanosec": {nanosec}}}}}'


def _number(value: float) -> str:
    text = repr(value)
    return text if "." in text else text.replace("e", ".0e")


def _channel(message: _JointTrajectory, name: str, where: Path) -> Matrix | None:
    """Return a channel, shape (points, joints), or None if no point has it."""
    rows: list[list[float]] = [getattr(point, name) for point in message.points]
    if not any(rows):
        return None
    for number, row in enumerate(rows):
        if len(row) != len(message.joint_names):
            raise RecordingError(
                f"{where}: $.points[{number}].{name} has {len(row)} values, expected "
                f"{len(message.joint_names)}, one for each of joint_names"
            )
    return np.array(rows)


def _decoded(content: bytes, where: Path) -> _JointTrajectory:
    try:
        return msgspec.json.decode(content, type=_JointTrajectory)
    except msgspec.ValidationError:
        raise
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as cause:
        if where.suffix.lower() == ".json":
            raise RecordingError(f"{where}: not JSON: {cause}") from None
    return msgspec.convert(plain_yaml(content, where), type=_JointTrajectory)


def plain_yaml(content: bytes, where: Path) -> Any:
    """Return the only document of a YAML file, built of plain values."""
    needed("ruamel.yaml", "ros", f"{where}: reading YAML", RecordingError)
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError
    from ruamel.yaml.events import AliasEvent

    try:
        text = content.decode("utf-8")
        # References within a file can make it grow without limit.
        if re.search(r"[&*]\w", text) and any(
            isinstance(event, AliasEvent)
            for event in YAML(typ="safe", pure=True).parse(text)
        ):
            raise RecordingError(f"{where}: a YAML alias, expected plain values")
        documents = list(YAML(typ="safe", pure=True).load_all(text))
    except (YAMLError, UnicodeDecodeError, ValueError, RecursionError) as cause:
        raise RecordingError(f"{where}: not readable as YAML: {cause}") from None
    found = [document for document in documents if document is not None]
    if len(found) != 1:
        raise RecordingError(f"{where}: {len(found)} messages, expected one")
    return found[0]
