"""Rotations, and frames in those of links."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.robot.model import RobotModel

_SNAP = 1e-10  # entries of a rotation nearer than this to -1, 0 or 1 are taken as such


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A frame in that of a moving link, or of the ground, which is -1."""

    link: int
    rotation: Matrix
    translation: Vector

    def beyond(self, rotation: Matrix, translation: Vector) -> "Place":
        """Return a frame's place that is given in this one."""
        return Place(
            self.link,
            self.rotation @ rotation,
            self.rotation @ translation + self.translation,
        )


def snapped(values: Array) -> Array:
    """Restore exact zeros and ones, which speed up the regressor, after 1.5707963."""
    nearest = np.round(values)
    return np.where(abs(values - nearest) < _SNAP, nearest, values)


def turn(axis: Vector, angle: float) -> Matrix:
    """Return the rotation about a unit vector (Rodrigues' formula)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K)


def turns(axis: Vector, angles: Array) -> Array:
    """Return rotations by many angles, as `turn`, shape (samples, 3, 3)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, rest = np.sin(angles), 1.0 - np.cos(angles)
    return np.asarray(
        np.eye(3) + sine[:, None, None] * K + rest[:, None, None] * (K @ K)
    )


def fixed_place(robot: RobotModel, name: str) -> Place:
    """Return where a link of the model's file, such as a tool, is fixed.

    A moving link is at the origin of itself.

    Raises
    ------
    ModelError
        If the model knows no such link.
    """
    k = robot.carrier(name)
    fixed = robot.ground if k < 0 else robot.links[k].merged
    if name in robot.link_names:
        return Place(k, np.eye(3), np.zeros(3))
    frame = next(frame for frame in fixed if frame.name == name)
    return Place(k, frame.rotation, frame.translation)
