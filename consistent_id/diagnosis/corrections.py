"""Faults as corrections: what the log would be, had the fault not happened."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id.recordings.recording import Recording
from consistent_id.robot.model import RobotModel

_QUARTERS = {90: np.pi / 2, -90: -np.pi / 2, 180: np.pi}


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """A fault that may have happened, and how to undo it.

    Parameters
    ----------
    kind, where, statement, advice : str
        As in `Finding`.
    undo : callable
        From the recording as it is to the one without the fault.
    moves : bool
        Whether it changes the motion, and not the torque alone.
    """

    kind: str
    where: str
    statement: str
    advice: str
    undo: Callable[[Recording], Recording]
    moves: bool


def torque_corrections(
    joints: tuple[str, ...], measured: tuple[str, ...]
) -> Iterator[Correction]:
    """Yield reversed and exchanged torque channels, and torque in other units.

    Parameters
    ----------
    joints : tuple of str
        Of the recording, in its order.
    measured : tuple of str
        Those whose torque is known.
    """
    places = [joints.index(name) for name in measured]
    for j in places:
        joint = joints[j]
        yield Correction(
            "torque sign",
            joint,
            f"with the torque of {joint} reversed",
            f"reverse the torque channel of {joint}, or its axis in the model",
            _on_torque(_reversed(j)),
            moves=False,
        )
    for i, j in combinations(places, 2):
        pair = f"{joints[i]}, {joints[j]}"
        yield Correction(
            "channel order",
            pair,
            f"with the torques of {pair} exchanged",
            "name the torque columns in the order of the joints they belong to",
            _on_torque(_exchanged(i, j)),
            moves=False,
        )
    for factor, unit in ((1e3, "kN m"), (1e-3, "N mm")):
        yield Correction(
            "torque unit",
            "all joints",
            f"with the torque taken as {unit}",
            f"multiply the torque by {factor:g}",
            _on_torque(lambda tau, f=factor: f * tau),  # type: ignore[misc]
            moves=False,
        )


def motion_corrections(robot: RobotModel) -> Iterator[Correction]:
    """Yield exchanged position channels, degrees, and zeros off by quarter turns."""
    joints = robot.joint_names
    for i, j in combinations(range(len(joints)), 2):
        pair = f"{joints[i]}, {joints[j]}"
        yield Correction(
            "channel order",
            pair,
            f"with the positions of {pair} exchanged",
            "name the position columns in the order of the joints they belong to",
            _on_motion(_exchanged(i, j)),
            moves=True,
        )
    turning = [j for j, joint in enumerate(robot.joints) if joint.kind != "prismatic"]
    yield Correction(
        "degrees",
        "all joints",
        "with the positions taken as degrees",
        "multiply positions and velocities by pi / 180",
        _on_motion(_scaled(turning, np.pi / 180)),
        moves=True,
    )
    for j in turning:
        for degrees, angle in _QUARTERS.items():
            yield Correction(
                "offset zero",
                joints[j],
                f"with the zero of {joints[j]} moved by {degrees} degrees",
                f"add {degrees} degrees to the position of {joints[j]}, or turn its "
                "frame in the model",
                _shifted(j, angle),
                moves=True,
            )


def _reversed(j: int) -> Callable[[Array], Array]:
    def change(values: Array) -> Array:
        values = values.copy()
        values[:, j] = -values[:, j]
        return values

    return change


def _exchanged(i: int, j: int) -> Callable[[Array], Array]:
    def change(values: Array) -> Array:
        values = values.copy()
        values[:, [i, j]] = values[:, [j, i]]
        return values

    return change


def _scaled(columns: list[int], factor: float) -> Callable[[Array], Array]:
    def change(values: Array) -> Array:
        values = values.copy()
        values[:, columns] *= factor
        return values

    return change


def _on_torque(change: Callable[[Array], Array]) -> Callable[[Recording], Recording]:
    def undo(recording: Recording) -> Recording:
        torque = recording.torque
        return (
            recording if torque is None else replace(recording, torque=change(torque))
        )

    return undo


def _on_motion(change: Callable[[Array], Array]) -> Callable[[Recording], Recording]:
    def undo(recording: Recording) -> Recording:
        return replace(
            recording,
            position=change(recording.position),
            velocity=None if recording.velocity is None else change(recording.velocity),
            acceleration=(
                None
                if recording.acceleration is None
                else change(recording.acceleration)
            ),
        )

    return undo


def _shifted(j: int, angle: float) -> Callable[[Recording], Recording]:
    def undo(recording: Recording) -> Recording:
        position = recording.position.copy()
        position[:, j] += angle
        return replace(recording, position=position)

    return undo
