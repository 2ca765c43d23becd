"""Positions of a robot's links and frames, and their motion with the joints."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Matrix, Vector, checked
from consistent_id.errors import ModelError
from consistent_id.robot.model import RobotModel

_SNAP = 1e-10  # entries of a rotation nearer than this to -1, 0 or 1 are taken as such


@dataclass(frozen=True, slots=True, eq=False)
class FixedPlace:
    """A frame in that of a moving link, or of the ground, which is -1."""

    link: int
    rotation: Matrix
    translation: Vector

    def beyond(self, rotation: Matrix, translation: Vector) -> "FixedPlace":
        """Return a frame's place that is given in this one."""
        return FixedPlace(
            self.link,
            self.rotation @ rotation,
            self.rotation @ translation + self.translation,
        )


@dataclass(frozen=True, slots=True, eq=False)
class FramePlaces:
    """A frame in the base frame, at many poses.

    `rotation`, shape (samples, 3, 3); `translation`, shape (samples, 3), [m].
    """

    rotation: Array
    translation: Array


@dataclass(frozen=True, slots=True, eq=False)
class LinkPlaces:
    """All links' frames in the base frame, at many poses.

    Attributes
    ----------
    robot : RobotModel
    rotation : ndarray, shape (samples, links, 3, 3)
    translation : ndarray, shape (samples, links, 3), [m]
        On the axis of the link's joint, if that one turns.
    axis : ndarray, shape (samples, links, 3)
        Unit vectors of the joints' axes.
    """

    robot: RobotModel
    rotation: Array
    translation: Array
    axis: Array

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.rotation)

    def of(self, place: FixedPlace) -> FramePlaces:
        """Return a frame that is given in a link's, or in the base's, which is -1."""
        n = len(self)
        if place.link < 0:
            return FramePlaces(
                np.broadcast_to(place.rotation, (n, 3, 3)),
                np.broadcast_to(place.translation, (n, 3)),
            )
        turned = self.rotation[:, place.link]
        moved = self.translation[:, place.link] + turned @ place.translation
        return FramePlaces(turned @ place.rotation, moved)


def link_places(
    robot: RobotModel, q: ArrayLike, *, links: Collection[int] | None = None
) -> LinkPlaces:
    """Return the places of the links.

    Link ``k`` on joint ``k`` with parent ``p``, at ``(R_p, t_p)``:
    ``R_k = R_p R_joint exp([axis x] q)``, ``t_k = t_p + R_p t_joint`` if it turns,
    ``R_k = R_p R_joint``, ``t_k = t_p + R_p (t_joint + R_joint axis q)`` if it slides.

    Parameters
    ----------
    q : array_like, shape (samples, joints), [rad or m]
    links : collection of int, optional
        The required ones, with all before them, in ascending order; by default all. The
        others' places are zero.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.5)])
    >>> link_places(arm, [[np.pi / 2, 0.0]]).translation[0, 1].round(12).tolist()
    [0.0, 0.5, 0.0]
    """
    q = robot.joint_positions(checked(q, (None, len(robot)), "joint positions"))
    n, count = q.shape
    rotation, translation = np.zeros((n, count, 3, 3)), np.zeros((n, count, 3))
    for k in range(count) if links is None else links:
        joint = robot.joints[k]
        turned, moved = joint.rotation, joint.translation
        if joint.kind == "prismatic":
            moved = moved + q[:, k, None] * (joint.rotation @ joint.axis)
        else:
            turned = turned @ turns(joint.axis, q[:, k])
        if joint.parent >= 0:
            parent = rotation[:, joint.parent]
            moved = (parent @ moved[..., None])[..., 0] + translation[:, joint.parent]
            turned = parent @ turned
        rotation[:, k], translation[:, k] = turned, moved
    axes = np.array([joint.axis for joint in robot.joints])
    return LinkPlaces(
        robot, rotation, translation, np.einsum("nkij,kj->nki", rotation, axes)
    )


def frame_places(robot: RobotModel, name: str, q: ArrayLike) -> FramePlaces:
    """Return the pose of a named link, moving or fixed to another, in the base frame.

    Parameters
    ----------
    robot : RobotModel
    name : str
    q : array_like, shape (samples, joints), [rad or m]
    """
    return link_places(robot, q).of(fixed_place(robot, name))


def fixed_place(robot: RobotModel, name: str) -> FixedPlace:
    """Return the pose of a fixed link of the model's file, such as a tool.

    A moving link is at the origin of itself.

    Raises
    ------
    ModelError
        If the model has no such link.
    """
    k = robot.carrier(name)
    fixed = robot.ground if k < 0 else robot.links[k].merged
    if name in robot.link_names:
        return FixedPlace(k, np.eye(3), np.zeros(3))
    frame = next(frame for frame in fixed if frame.name == name)
    return FixedPlace(k, frame.rotation, frame.translation)


def ancestors(robot: RobotModel, link: int) -> tuple[int, ...]:
    """Return the joints that move a link, its own first; none move the base, -1."""
    found = []
    while link >= 0:
        found.append(link)
        link = robot.joints[link].parent
    return tuple(found)


class FrameMotion(NamedTuple):
    """A point of a frame, seen from the base, and how joints move it.

    ``(v, w) = jacobian dq`` and ``(a, dw) = jacobian ddq + bias``.

    Attributes
    ----------
    position : ndarray, shape (samples, 3), [m]
    rotation : ndarray, shape (samples, 3, 3)
    jacobian : ndarray, shape (samples, 6, joints)
        Rows of the point's velocity, then of the angular one.
    bias : ndarray, shape (samples, 6)
        ``dJ dq``: acceleration at ``ddq = 0``.
    """

    position: Array
    rotation: Array
    jacobian: Array
    bias: Array


def frame_motion(
    robot: RobotModel,
    q: ArrayLike,
    dq: ArrayLike | None = None,
    *,
    frame: str,
    point: ArrayLike = (0.0, 0.0, 0.0),
) -> FrameMotion:
    """Return the position of a point of a frame, its Jacobian and bias acceleration.

    Parameters
    ----------
    q : array_like, shape (samples, joints), [rad or m]
    dq : array_like, shape (samples, joints), optional, [rad/s or m/s]
        By default zero, and with it the bias.
    frame : str
        A moving link, or a link that is fixed to one.
    point : array_like, shape (3,), [m]
        In that frame; the wrist's centre in the last link before the wrist, say.

    Raises
    ------
    ModelError
        If there is no such frame, or it does not move.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.4)])
    >>> motion = frame_motion(arm, [[0, 0]], [[2, 0]], frame="link2", point=[0.1, 0, 0])
    >>> motion.position[0].round(3).tolist(), motion.bias[0, :3].round(3).tolist()
    ([0.5, 0.0, 0.0], [-2.0, 0.0, 0.0])
    """
    k, rotation, point = frame_in_link(robot, frame, point)
    path = ancestors(robot, k)[::-1]
    places = link_places(robot, q, links=path)
    rotations, origins = places.rotation, places.translation
    position = origins[:, k] + rotations[:, k] @ point
    jacobian = np.zeros((len(rotations), 6, len(robot.joints)))
    for j in path:
        axis = places.axis[:, j]
        if robot.joints[j].kind == "prismatic":
            jacobian[:, :3, j] = axis
        else:
            jacobian[:, :3, j] = _cross(axis, position - origins[:, j])
            jacobian[:, 3:, j] = axis
    bias = np.zeros((len(rotations), 6))
    if dq is not None:
        rates = checked(dq, (len(rotations), len(robot)), "dq") @ robot.joint_rates.T
        bias = _bias(places, path, position, rates)
    jacobian = jacobian @ robot.joint_rates
    return FrameMotion(position, rotations[:, k] @ rotation, jacobian, bias)


def _bias(
    places: LinkPlaces, path: tuple[int, ...], position: Array, dq: Array
) -> Array:
    """Carry the acceleration of steady rates from the base to the point."""
    origins = places.translation
    w, dw, a, at = (np.zeros((len(dq), 3)) for _ in range(4))
    for j in path:
        a = a + _carried(w, dw, origins[:, j] - at)
        at = origins[:, j]
        rate = places.axis[:, j] * dq[:, j, None]
        if places.robot.joints[j].kind == "prismatic":
            a = a + 2.0 * _cross(w, rate)
        else:
            dw = dw + _cross(w, rate)
            w = w + rate
    a = a + _carried(w, dw, position - at)
    return np.hstack([a, dw])


def frame_in_link(
    robot: RobotModel, frame: str, point: ArrayLike
) -> tuple[int, Matrix, Vector]:
    """Return the link that carries a frame, its rotation there, and the point there."""
    k = robot.carrier(frame)
    if k < 0:
        raise ModelError(
            f"robot {robot.name!r}: {frame!r} does not move; choose a frame on one of "
            f"{', '.join(robot.link_names)}"
        )
    place = checked(point, (3,), "point")
    for merged in robot.links[k].merged:
        if merged.name == frame:
            return k, merged.rotation, merged.translation + merged.rotation @ place
    return k, np.eye(3), place


def carrying_joints(robot: RobotModel, frame: str) -> tuple[str, ...]:
    """Return the joints that move a frame, from the base on."""
    k = robot.carrier(frame)
    moved = robot.transmissions
    chosen = {moved[j].coordinate for j in ancestors(robot, k)}
    return tuple(robot.joint_names[j] for j in sorted(chosen))


def reach(robot: RobotModel, frame: str, point: ArrayLike) -> float:
    """Return a length that a point of a frame stays within, from the first joint [m].

    Sliding joints contribute their range; a robot without any length has 1.
    """
    k, _, place = frame_in_link(robot, frame, point)
    total = float(np.linalg.norm(place))
    for number, j in enumerate(ancestors(robot, k)[::-1]):
        joint = robot.joints[j]
        total += float(np.linalg.norm(joint.translation)) if number else 0.0
        if joint.kind == "prismatic":
            ends = np.array([joint.limits.lower, joint.limits.upper])
            total += float(abs(ends[np.isfinite(ends)]).max(initial=0.0))
    return total or 1.0


def _carried(w: Array, dw: Array, arm: Array) -> Array:
    """Acceleration at the end of an arm that turns, less that of its start."""
    return _cross(dw, arm) + _cross(w, _cross(w, arm))


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


def _cross(a: Array, b: Array) -> Array:
    """Cross products of rows; `numpy.cross` takes three times as long for a few."""
    x, y, z = a[:, 0], a[:, 1], a[:, 2]
    u, v, w = b[:, 0], b[:, 1], b[:, 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
