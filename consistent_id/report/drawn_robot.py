"""What is drawn of a robot: joints, and each link's ellipsoid, in the base frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.comparison.comparison import EstimateReport
from consistent_id.report.projection import InertiaEllipsoid, equimomental
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.kinematics import link_places


@dataclass(frozen=True, slots=True, eq=False)
class DrawnLink:
    """A link, its joint and that of its parent.

    Parameters
    ----------
    name : str
    joint, parent : ndarray, shape (3,), [m]
    possible : bool
        Whether the link is physically consistent.
    body : InertiaEllipsoid, optional
        None where that is not so, or without mass.
    """

    name: str
    joint: Vector
    parent: Vector
    possible: bool
    body: InertiaEllipsoid | None


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """A ball that holds what is to be seen: its middle and radius, [m]."""

    middle: Vector
    reach: float


def drawn_links(report: EstimateReport, q: Vector) -> tuple[DrawnLink, ...]:
    """Return one estimate's links at a pose.

    Parameters
    ----------
    report : EstimateReport
    q : ndarray, shape (joints,), [rad or m]
    """
    robot = report.estimate.model.robot
    places = link_places(robot, q[None])
    found = []
    for k, (link, joint) in enumerate(zip(report.links, robot.joints, strict=True)):
        R, t = places.rotation[0, k], places.translation[0, k]
        body = InertialParameters(report.estimate.links[k])
        inside = equimomental(body) if link.consistent else None
        if inside is not None:
            inside = InertiaEllipsoid(R @ inside.centre + t, R @ inside.Q @ R.T)
        start = np.zeros(3) if joint.parent < 0 else places.translation[0, joint.parent]
        found.append(DrawnLink(link.link, t, start, link.consistent, inside))
    return tuple(found)


def window_around(links: Sequence[DrawnLink]) -> Window:
    """Return a ball around all joints and ellipsoids, from their box's corners."""
    corners = [p for link in links for p in (link.joint, link.parent)]
    for link in links:
        if link.body is not None:
            # Half the extents of an ellipsoid along the axes.
            half = np.sqrt(np.maximum(np.diag(link.body.Q), 0.0))
            corners += [link.body.centre - half, link.body.centre + half]
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    middle = (low + high) / 2
    reach = max(float(np.linalg.norm(c - middle)) for c in corners)
    return Window(middle, reach or 1.0)
