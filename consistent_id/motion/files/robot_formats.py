"""Motions in the formats of robots: ROS 2 messages, and targets for controllers.

ROS 2 ``trajectory_msgs/JointTrajectory`` messages are YAML that is also JSON: ROS tools
read YAML 1.1, in which ``1e-05`` is a string, so numbers always have a point.

Other controllers take one target in every cycle: tables for KUKA RSI and libfranka, and
programs for Universal Robots.
"""

import json
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.extras import needed
from consistent_id.errors import ProblemError, RecordingError
from consistent_id.recordings.joint_paths import JointPath
from consistent_id.recordings.recording import Recording
from consistent_id.robot.model import RobotModel

_BILLION = 1_000_000_000
_CHANNELS = ("positions", "velocities", "accelerations")
_JOINTS = {"rsi": 6, "franka": 7, "urscript": 6}
# Decimals of rad or degrees; at 1 kHz, rounding causes a jerk 1e9 times as large
_DIGITS = 12

CYCLES: dict[str, tuple[float, ...]] = {
    "urscript": (125.0, 500.0),
    "rsi": (250.0, 1000.0 / 12.0),
    "franka": (1000.0,),
}
"""Rates of formats [Hz]: of CB and e-Series, of RSI in 4 and in 12 ms, of libfranka."""

_EQUAL = 1e-3  # relative tolerance of a rate, such as 83.3 for 1000 / 12

_TO_START = "a=0.5, v=0.25"  # rad/s^2, rad/s: slow, since this path is not checked
_TRACKING = "0.1, 300"  # lookahead time [s] and gain, the controller's own defaults


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


def require_joints(format: str, joints: int, where: str | Path) -> None:
    """Refuse a robot whose number of joints a format does not support.

    Parameters
    ----------
    format : str
        One of a controller, such as ``"rsi"``; others support any number.
    where : str or Path
        Begins the message.

    Raises
    ------
    ProblemError
        With the number of joints and the expected one.
    """
    expected = _JOINTS.get(format, joints)
    if joints != expected:
        raise ProblemError(
            f"{where}: {joints} joints, expected {expected}, as robots that read this "
            f"format ({format}) have"
        )


def require_robot(format: str, robot: RobotModel, where: str) -> None:
    """Refuse a robot whose joints a format does not support, before any work.

    Controllers read angles: joints that slide have none.

    Parameters
    ----------
    format : str
        As of `require_joints`.
    robot : RobotModel
    where : str
        Begins the message.

    Raises
    ------
    ProblemError
        With the joint that slides, or the number of joints and the expected one, and
        with options that lead to a robot of the format if there are any.
    """
    expected = _JOINTS.get(format)
    if expected is None:
        return
    ways = [f"--tip {shlex.quote(tip)}" for tip in _tips_with(robot, expected)]
    sliding = [one.name for one in robot.driven if one.kind == "prismatic"]
    if sliding and len(robot) - len(sliding) == expected:
        ways.insert(0, f"--lock {shlex.join(sliding)}")
    # Which of two arms is the user's choice.
    first = ways[0] if ways and (len(ways) == 1 or sliding) else ""
    if sliding:
        told = f"{' or '.join(ways)}, or choose" if ways else "choose"
        raise ProblemError(
            f"{where}: joint {sliding[0]!r} slides, expected {expected} joints that "
            f"turn: this format ({format}) has angles only; {told} csv, yaml, npz or "
            "parquet",
            options=first,
        )
    try:
        require_joints(format, len(robot), where)
    except ProblemError as cause:
        if not ways:
            raise
        told = f"{cause}. {expected} of them lead to one link: {' or '.join(ways)}"
        raise ProblemError(told, options=first) from None


def _tips_with(robot: RobotModel, joints: int) -> list[str]:
    """Return the last links of chains from the base with so many joints that turn.

    Joints that follow others are not counted; of a chain's links the first is named.
    """
    found = []
    counts = {-1: 0}  # of the joints that turn up to each link; no more once one slides
    for k, joint in enumerate(robot.joints):
        if joint.kind not in ("revolute", "continuous") or joint.parent not in counts:
            continue
        counts[k] = counts[joint.parent] + joint.driven
        if joint.driven and counts[k] == joints:
            found.append(robot.links[k].name)
    return found


class Targets(NamedTuple):
    """Positions, shape (targets, joints), and seconds since the start."""

    since: Vector
    position: Matrix


def urscript_of(path: JointPath, rate: float, where: Path) -> str:
    """Return a program that moves to the start, and then follows a path by ``servoj``.

    Each target holds for one cycle; the last one is the end of the path, at most a
    cycle after the one before.  Targets are rounded to 1e-9 rad.

    Raises
    ------
    ProblemError
        If the robot has not six joints, or the rate is not 125 or 500 Hz.
    """
    require_joints("urscript", len(path.joints), where)
    cycle = cycle_of("urscript", rate)
    if cycle is None:
        raise ProblemError(
            f"{where}: rate is {rate:g} Hz, expected the controller's cycle: 125 "
            "(CB series) or 500 (e-Series)"
        )
    rate = cycle
    since, targets = targets_of(path, rate)
    lines = [
        "def consistent_id_motion():",
        "  # consistent-id: motion",
        f"  # joints {', '.join(path.joints)}",
        f"  # {len(since)} targets, one every {1.0 / rate:g} s; time in seconds behind",
        f"  movej({_list(targets[0])}, {_TO_START})",
    ]
    for time, target in zip(since, targets, strict=True):
        command = f"servoj({_list(target)}, 0, 0, {1.0 / rate:g}, {_TRACKING})"
        lines.append(f"  {command}  # {time:.3f}")
    return "\n".join([*lines, "  stopj(1.0)", "end", ""])


def rsi_of(path: JointPath, rate: float, where: Path) -> str:
    """Return axis angles [degrees] for KUKA's Robot Sensor Interface, ``A1;...;A6``.

    Raises
    ------
    ProblemError
        If the robot has not six joints, or the rate is not 250 or 83.3 Hz.
    """
    rate = _required(path, rate, where, "rsi", "250 (4 ms) or 83.3 (12 ms)")
    targets = np.degrees(targets_of(path, rate).position)
    head = ";".join(f"A{k}" for k in range(1, len(path.joints) + 1))
    what = "axis angles in degrees for KUKA RSI, in the signs of the robot's file"
    return "\n".join([*_comments(path, rate, what), head, *_rows(targets, ";"), ""])


def franka_of(path: JointPath, rate: float, where: Path) -> str:
    """Return joint positions [rad] for libfranka's ``JointPositions``, by commas.

    Raises
    ------
    ProblemError
        If the robot has not seven joints, or the rate is not 1000 Hz.
    """
    rate = _required(path, rate, where, "franka", "1000")
    what = "joint positions in rad for libfranka"
    targets = targets_of(path, rate).position
    return "\n".join([*_comments(path, rate, what), *_rows(targets, ","), ""])


def _required(
    path: JointPath, rate: float, where: Path, format: str, known: str
) -> float:
    require_joints(format, len(path.joints), where)
    cycle = cycle_of(format, rate)
    if cycle is None:
        raise ProblemError(
            f"{where}: rate is {rate:g} Hz, expected the controller's cycle: {known}"
        )
    return cycle


def _comments(path: JointPath, rate: float, what: str) -> list[str]:
    return [
        f"# consistent-id: motion; {what}",
        f"# joints {', '.join(path.joints)}; one row every {1e3 / rate:g} ms",
    ]


def _rows(targets: Matrix, comma: str) -> list[str]:
    # Adding zero turns -0.0 into 0.0.
    return [
        comma.join(f"{value:.{_DIGITS}f}" for value in row)
        for row in np.round(targets, _DIGITS) + 0.0
    ]


def cycle_of(format: str, rate: float) -> float | None:
    """Return the controller's nearest rate, or None if there is none."""
    near = (own for own in CYCLES[format] if abs(rate - own) <= _EQUAL * own)
    return next(near, None)


def targets_of(path: JointPath, rate: float) -> Targets:
    """Return one target for each cycle.

    The last one is the end of the path, at most a cycle after the one before.
    """
    cycles = int(np.ceil(path.duration * rate * (1.0 - 1e-12)))
    since = np.minimum(np.arange(cycles + 1) / rate, path.duration)
    (position,) = path.evaluate(path.start + since, derivatives=0)
    return Targets(since, position)


def _list(target: Matrix) -> str:
    # Adding zero turns -0.0 into 0.0.
    return f"[{', '.join(f'{value:.9f}' for value in np.round(target, 9) + 0.0)}]"
