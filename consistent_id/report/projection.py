"""A robot seen from a side: points and ellipsoids in parallel projection.

With azimuth ``a`` and elevation ``e`` of the viewer, a point ``p`` is seen at
``(right . p, up . p)``, ``right = (-sin a, cos a, 0)``,
``up = (-sin e cos a, -sin e sin a, cos e)``.  The outline of the ellipsoid
``(x - c)^T Q^-1 (x - c) = 1`` is the ellipse of ``P Q P^T``, ``P = [right; up]``.
The page's script does the same when the view is turned.
"""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.recordings.recording import Recording
from consistent_id.robot.inertia import InertialParameters, second_moments
from consistent_id.robot.kinematics import link_places
from consistent_id.robot.model import RobotModel

AZIMUTH, ELEVATION = -60.0, 20.0  # degrees

_CANDIDATES = 200


@dataclass(frozen=True, slots=True)
class Ellipse:
    """An ellipse in the picture: centre, semi-axes [m], angle of the first [deg]."""

    x: float
    y: float
    rx: float
    ry: float
    angle: float


@dataclass(frozen=True, slots=True, eq=False)
class InertiaEllipsoid:
    """A link's equimomental ellipsoid: of even density, with the same moments.

    `centre`, shape (3,), [m]; `Q`, shape (3, 3), [m^2], whose eigenvalues are the
    squares of its semi-axes.
    """

    centre: Vector
    Q: Matrix


def equimomental(body: InertialParameters) -> InertiaEllipsoid | None:
    """Return a link's ellipsoid in its frame; None if it is not consistent.

    ``Q = 5 Sigma_c / m``, ``Sigma_c`` the second moment about the centre of mass.
    """
    if body.mass <= 0.0:
        return None
    Q = 5.0 / body.mass * second_moments(body.central_inertia)
    least, *_, largest = np.linalg.eigvalsh(Q)
    if least < -1e-6 * abs(largest):
        return None
    return InertiaEllipsoid(body.com, Q)


def view(azimuth: float = AZIMUTH, elevation: float = ELEVATION) -> Matrix:
    """Return ``P``, shape (2, 3), of a viewer; angles in degrees."""
    a, e = np.radians([azimuth, elevation])
    right = (-np.sin(a), np.cos(a), 0.0)
    up = (-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e))
    return np.array([right, up])


def outline(ellipsoid: InertiaEllipsoid, P: Matrix) -> Ellipse:
    """Return an ellipsoid's outline in a view."""
    squares, axes = np.linalg.eigh(P @ ellipsoid.Q @ P.T)
    (minor, major), along = np.sqrt(np.maximum(squares, 0.0)), axes[:, 1]
    x, y = P @ ellipsoid.centre
    angle = np.degrees(np.arctan2(along[1], along[0]))
    return Ellipse(float(x), float(y), float(major), float(minor), float(angle))


def spread_pose(robot: RobotModel, recordings: tuple[Recording, ...]) -> Vector:
    """Return the recorded pose in which the joints are farthest from each other.

    That is, with the largest product of distances; zeros without any recording.
    """
    if not recordings or not len(robot):
        return np.zeros(len(robot))
    q = np.concatenate([r.of(robot.joint_names).position for r in recordings])
    q = q[:: max(1, len(q) // _CANDIDATES)]
    places: Array = link_places(robot, q).translation
    apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)
    pairs = np.triu_indices(len(robot.links), 1)
    spread = np.log(apart[:, pairs[0], pairs[1]] + 1e-3).sum(axis=1)
    return np.asarray(q[int(np.argmax(spread))])
