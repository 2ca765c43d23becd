"""Faults that a change of the channels corrects, as one table.

Each correction is an affine map of the torque channels, or of the motion channels.
Preparation (resampling, filters, differences) treats all channels alike and keeps
constants, so that the map can be applied afterwards: a log is prepared once.  Only near
its ends, a sum of channels is prepared a little differently than they are.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.recordings.recording import Recording
from consistent_id.robot.model import Joint, RobotModel


class Change(NamedTuple):
    """A map of channels: ``values @ matrix``, and `shift` added to positions.

    `joints` are the indices of the joints it changes; empty means all joints.  `size`
    and `unit` appear in sentences.  `of_torque` is the torque's matrix, if it is
    another one.
    """

    joints: tuple[int, ...]
    matrix: Matrix
    shift: Vector
    size: float = 1.0
    unit: str = ""
    of_torque: Matrix | None = None


@dataclass(frozen=True, slots=True)
class Cause:
    """A possible cause, and the threshold of reporting it.

    Parameters
    ----------
    kind, where, statement, advice : str
        As in `LogFinding`; the statement is the condition for the misfit that follows.
    threshold : float
        Ratio of the log's misfit to the corrected log's above which it is reported.
    excuse : int
        Whether it can stand in for other causes.  0: it cannot.  1: it is named only if
        nothing else explains the log (other masses).  2: it is only mentioned as a
        candidate (a spring, which can stand in for wrong geometry).  `LOOKS_ALIKE`: it
        is only mentioned too, because another cause has the same effect.
    of_residual : bool
        Whether it was chosen by a residual.  Part of any residual can be explained this
        way, so that the misfit has to fall to that of clean logs.
    size : str
        As in `LogFinding`.
    """

    kind: str
    where: str
    statement: str
    advice: str
    threshold: float
    excuse: int = 0
    of_residual: bool = False
    size: str = ""


LOOKS_ALIKE = 3
"""Excuse of a position scale near one: a wrong link length has the same effect."""


@dataclass(frozen=True, slots=True)
class FaultKind:
    """A kind of fault, and the threshold of reporting it.

    Parameters
    ----------
    kind : str
        As in `LogFinding`.
    channels : {"torque", "motion", "both"}
        The channels that it changes.
    threshold : float
        Ratio of the log's misfit to the corrected log's above which it is reported.
    statement, advice : str
        With the fields ``{joints}``, ``{size}``, ``{radians}`` of a size in degrees,
        and ``{unit}``; and ``{first}`` and ``{second}`` for two joints.
    changes : callable
        Function from the joints, and the indices of those whose channels may be wrong,
        to the changes that correct the fault.
    option : str
        With the same fields, the option that corrects it if one joint is wrong.
    """

    kind: str
    channels: Literal["torque", "motion", "both"]
    threshold: float
    statement: str
    advice: str
    changes: Callable[[Sequence[Joint], Sequence[int]], Iterator[Change]]
    option: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """A possible fault, and the change that corrects it."""

    fault: FaultKind
    change: Change
    where: str

    @property
    def statement(self) -> str:
        """The fault in words."""
        return self._filled(self.fault.statement)

    @property
    def advice(self) -> str:
        """The advice in words."""
        option = self.fault.option if len(self.change.joints) == 1 else ""
        return self._filled(self.fault.advice + (option and f" ({option})"))

    @property
    def cause(self) -> "Cause":
        """The cause that it corrects."""
        fault = self.fault
        near = fault.kind == "encoder scale" and self.change.size in _NEAR
        return Cause(
            fault.kind,
            self.where,
            self.statement,
            self.advice,
            fault.threshold,
            excuse=LOOKS_ALIKE if near else 0,
        )

    def _filled(self, text: str) -> str:
        size, unit = self.change.size, self.change.unit
        first, *others = self.where.split(", ")
        second = others[0] if others else first
        return text.format(
            joints=self.where,
            size=size,
            radians=np.radians(size),
            unit=unit,
            first=first,
            second=second,
        )

    def applied(self, prepared: Recording) -> Recording:
        """Return a prepared recording without the fault."""
        matrix, shift = self.change.matrix, self.change.shift
        of_torque = matrix if self.change.of_torque is None else self.change.of_torque

        def mapped(values: Matrix | None) -> Matrix | None:
            return None if values is None else values @ matrix

        if self.fault.channels != "motion" and prepared.torque is not None:
            prepared = replace(prepared, torque=prepared.torque @ of_torque)
        if self.fault.channels == "torque":
            return prepared
        return replace(
            prepared,
            position=prepared.position @ matrix + shift,
            velocity=mapped(prepared.velocity),
            acceleration=mapped(prepared.acceleration),
        )


def corrections(robot: RobotModel, torque_joints: Sequence[str]) -> list[Correction]:
    """Return all corrections of the table that apply to a robot's log.

    Parameters
    ----------
    torque_joints : sequence of str
        Joints whose torque is known; torque faults are sought in these.
    """
    names = robot.joint_names
    known = [names.index(name) for name in torque_joints]
    places = {"torque": known, "motion": range(len(names)), "both": known}
    joints = _numbered(robot)
    return [
        Correction(fault, change, ", ".join(names[j] for j in change.joints) or _ALL)
        for fault in FAULT_KINDS
        for change in fault.changes(joints, places[fault.channels])
    ]


def _numbered(robot: RobotModel) -> list[Joint]:
    """Return the joints that move by themselves, each with its parent among these.

    The parent of a joint on the base, or on a link that follows another joint, is -1.
    """
    links = [k for k, joint in enumerate(robot.joints) if joint.driven]
    places = {link: place for place, link in enumerate(links)}
    return [replace(j, parent=places.get(j.parent, -1)) for j in robot.driven]


_ALL = "all joints"
_QUARTERS = (90.0, -90.0, 180.0)  # degrees
_NEAR = (0.8, 0.9, 1.1, 1.25)  # wrong gear ratios
_SCALES = (0.01, 0.02, *_NEAR)  # or gear ratios that were left out
_SIGNS = {1.0: "added to", -1.0: "subtracted from"}
_UNITS = ((1e3, "kN m"), (1e-3, "N mm"))
# Ratio of misfits: reversing a correct torque makes an error of twice the torque.  A
# torque that fits about equally well both ways, such as one without its fast part, is
# not reversed.
_SIGN = 2.0
# The same: without the torque of a joint that its motor turns against, the error is as
# large as that torque.  Chance reaches 1.4 in a log of 3.6 s.
_OF_DRIVES = 2.0


def _scaling(joints: Sequence[Joint], places: Sequence[int], factor: float) -> Matrix:
    scale = np.ones(len(joints))
    scale[list(places)] = factor
    return np.diag(scale)


def _reversed(joints: Sequence[Joint], places: Sequence[int]) -> Iterator[Change]:
    for j in places:
        yield Change((j,), _scaling(joints, [j], -1.0), np.zeros(len(joints)))


def _all_reversed(joints: Sequence[Joint], places: Sequence[int]) -> Iterator[Change]:
    if len(places) > 1:
        yield Change((), _scaling(joints, places, -1.0), np.zeros(len(joints)))


def _other_scales(joints: Sequence[Joint], places: Sequence[int]) -> Iterator[Change]:
    for j in places:
        for factor in _SCALES:
            matrix = _scaling(joints, [j], factor)
            yield Change((j,), matrix, np.zeros(len(joints)), factor)
    for factor in _SCALES[:1]:
        matrix = _scaling(joints, places, factor)
        yield Change((), matrix, np.zeros(len(joints)), factor)


def _degrees_of_one(joints: Sequence[Joint], places: Sequence[int]) -> Iterator[Change]:
    for j in _turning(joints, places):
        yield Change((j,), _scaling(joints, [j], np.pi / 180), np.zeros(len(joints)))


def _exchanged(joints: Sequence[Joint], places: Sequence[int]) -> Iterator[Change]:
    for i, j in combinations(places, 2):
        order = np.arange(len(joints))
        order[[i, j]] = j, i
        yield Change((i, j), np.eye(len(joints))[order], np.zeros(len(joints)))


def _torques_of_coupled_drives(
    joints: Sequence[Joint], places: Sequence[int]
) -> Iterator[Change]:
    for i, j in _in_sequence(joints, places):
        for sign in (1.0, -1.0):
            matrix = np.eye(len(joints))
            matrix[j, i] = sign
            yield Change((i, j), matrix, np.zeros(len(joints)), sign, _SIGNS[sign])


def _coupled_drives(joints: Sequence[Joint], places: Sequence[int]) -> Iterator[Change]:
    """Yield changes from motors to joints, of which power stays the same.

    If the motor of joint j is in front of joint i, it turns by ``q_j + s q_i``, and the
    motor of joint i has the torque ``tau_i - s tau_j``.
    """
    for change in _torques_of_coupled_drives(joints, places):
        motion = (2.0 * np.eye(len(joints)) - change.matrix).T  # its inverse, turned
        turns = "sum" if change.size > 0.0 else "difference"
        yield change._replace(matrix=motion, unit=turns, of_torque=change.matrix)


def _in_sequence(
    joints: Sequence[Joint], places: Sequence[int]
) -> Iterator[tuple[int, int]]:
    """Yield joints of which one carries the other, if both turn, or both slide."""
    turning = _turning(joints, places)
    for j in places:
        i = joints[j].parent
        if i in places and (i in turning) == (j in turning):
            yield i, j


def _other_units(joints: Sequence[Joint], places: Sequence[int]) -> Iterator[Change]:
    for factor, unit in _UNITS:
        matrix = _scaling(joints, places, factor)
        yield Change((), matrix, np.zeros(len(joints)), factor, unit)


def _degrees(joints: Sequence[Joint], places: Sequence[int]) -> Iterator[Change]:
    matrix = _scaling(joints, _turning(joints, places), np.pi / 180)
    yield Change((), matrix, np.zeros(len(joints)))


def _quarter_turns(joints: Sequence[Joint], places: Sequence[int]) -> Iterator[Change]:
    for j in _turning(joints, places):
        for degrees in _QUARTERS:
            shift = np.zeros(len(joints))
            shift[j] = np.radians(degrees)
            yield Change((j,), np.eye(len(joints)), shift, degrees)


def _turning(joints: Sequence[Joint], places: Sequence[int]) -> list[int]:
    return [j for j in places if joints[j].kind != "prismatic"]


FAULT_KINDS = (
    FaultKind(
        "torque sign",
        "torque",
        _SIGN,
        "with the torque of {joints} reversed",
        "reverse the torque of {joints} by a negative gain (--torque-gain, one number "
        "for each joint); or, instead, its position and velocity, or the axis in the "
        "model",
        _reversed,
    ),
    FaultKind(
        "torque sign",
        "torque",
        _SIGN,
        "with the torque of {joints} reversed",
        "reverse the torque of {joints} by a negative gain (--torque-gain -1)",
        _all_reversed,
    ),
    FaultKind(
        "position sign",
        "motion",
        _SIGN,
        "with the position of {joints} reversed",
        "reverse position and velocity of {joints}, or its axis in the model",
        _reversed,
        "--position-scale {joints}=-1",
    ),
    FaultKind(
        "channel order",
        "both",
        1.3,
        "with {joints} exchanged altogether",
        "name the columns in the order of the joints they belong to",
        _exchanged,
    ),
    FaultKind(
        "encoder scale",
        "motion",
        1.3,
        "with the position of {joints} times {size:.4g}",
        "multiply position and velocity of {joints} by {size:.4g}: check gear and unit",
        _other_scales,
        "--position-scale {joints}={size:.4g}",
    ),
    FaultKind(
        "degrees",
        "motion",
        1.5,
        "with the position of {joints} taken as degrees",
        "multiply position and velocity of {joints} by pi / 180",
        _degrees_of_one,
        "--position-scale {joints}=0.0174533",
    ),
    FaultKind(
        "channel order",
        "torque",
        1.3,
        "with the torques of {joints} exchanged",
        "name the torque columns in the order of the joints they belong to",
        _exchanged,
    ),
    FaultKind(
        "coupled drives",
        "torque",
        _OF_DRIVES,
        "with the torque of {second} {unit} that of {first}, as its motor is in front "
        "of {first} (a belt or a rod)",
        "compute the torque of {first} from the torques of both motors",
        _torques_of_coupled_drives,
    ),
    FaultKind(
        "coupled drives",
        "both",
        _OF_DRIVES,
        "with positions and torques computed from those of the motors, as that of "
        "{second} is in front of {first} (a belt or a rod) and turns by the {unit} of "
        "both angles",
        "compute positions and torques of both joints from those of the motors",
        _coupled_drives,
    ),
    FaultKind(
        "torque unit",
        "torque",
        2.0,
        "with the torque taken as {unit}",
        "multiply the torque by {size:g}",
        _other_units,
    ),
    FaultKind(
        "channel order",
        "motion",
        1.3,
        "with the positions of {joints} exchanged",
        "name the position columns in the order of the joints they belong to",
        _exchanged,
    ),
    FaultKind(
        "degrees",
        "motion",
        1.5,
        "with the positions taken as degrees",
        "multiply positions and velocities by pi / 180",
        _degrees,
    ),
    FaultKind(
        "offset zero",
        "motion",
        1.3,
        "with the zero of {joints} moved by {size:g} degrees",
        "add {size:g} degrees to the position of {joints}, or turn its frame in the "
        "model",
        _quarter_turns,
        "--position-offset {joints}={radians:.6g}",
    ),
)
"""Faults that are sought; a new fault is one entry and one function of changes."""
