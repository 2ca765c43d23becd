"""Where links and frames are, and how fast their points move, pose by pose."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, checked
from consistent_id.robot.model import RobotModel
from consistent_id.robot.places import Place, fixed_place, turns


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

    def of(self, place: Place) -> FramePlaces:
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
    """Return where the links are.

    Link ``k`` on joint ``k`` with parent ``p``, at ``(R_p, t_p)``:
    ``R_k = R_p R_joint exp([axis x] q)``, ``t_k = t_p + R_p t_joint`` if it turns,
    ``R_k = R_p R_joint``, ``t_k = t_p + R_p (t_joint + R_joint axis q)`` if it slides.

    Parameters
    ----------
    q : array_like, shape (samples, joints), [rad or m]
    links : collection of int, optional
        Those that are wanted, with all before them, in ascending order; by default all.
        The others' places are zero.

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
    """Return where a named link, moving or fixed to another, is in the base frame.

    Parameters
    ----------
    robot : RobotModel
    name : str
    q : array_like, shape (samples, joints), [rad or m]
    """
    return link_places(robot, q).of(fixed_place(robot, name))


def ancestors(robot: RobotModel, link: int) -> tuple[int, ...]:
    """Return the joints that move a link, its own first; none move the base, -1."""
    found = []
    while link >= 0:
        found.append(link)
        link = robot.joints[link].parent
    return tuple(found)
