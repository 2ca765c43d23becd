"""Checks of delivered bodies: their physical consistency, extent and inertia.

`link_conditions` returns which links are consistent, and which are on the boundary of
the consistency cone.

`robot_size` compares the bodies' extent and inertia with the robot's geometry.  No
residual shows a wrong clock or a gain of all torques: with ``t -> 2 t`` a robot with
four times the inertia explains the log exactly.  Geometry shows it.  A body of mass
``m`` that lies within a distance ``s`` of its joint has a centre of mass and a radius
of gyration of at most ``s``, and at most ``m (d + s)^2`` about an axis at the distance
``d`` of its joint.

Sizes come from the robot's file, never from the estimate: a centre of mass far outside
must not make a link long.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Vector, freeze_arrays
from consistent_id._support.tables import brief
from consistent_id.regression.mass_matrix import mass_matrices, random_poses
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.inertia import InertialParameters, second_moments
from consistent_id.robot.kinematics import ancestors, link_places
from consistent_id.robot.model import RobotModel
from consistent_id.robot.scaling import link_scales

_CONSISTENT = 1e-9  # eigenvalues of J, per typical link, above -this are >= 0
_NO_MASS = "no mass"
_EDGE = 1e-5  # shares of a typical link's mass or second moment that count as zero

# Share of the largest inertia about a joint that geometry allows, below which the joint
# is not judged: a clean log of a UR10e makes the third wrist's link ten times too long.
_MINOR = 0.05
_POSES = 200  # random ones: a median needs few
_THIN = 100.0  # kg/m^3; axes may cross, but few links are as thin as this


@brief
@dataclass(frozen=True, slots=True)
class LinkCondition:
    """One link's consistency margin.

    Parameters
    ----------
    link : str
    least_eigenvalue : float
        Smallest eigenvalue of the pseudo-inertia, rows and columns divided by the
        roots of the link's typical mass and second moment.
    edge : str
        Where on the boundary of the consistency cone the link is, in words, such as
        ``"flat: ..."``; empty inside.
    """

    link: str
    least_eigenvalue: float
    edge: str

    @property
    def consistent(self) -> bool:
        """Whether the link is physically consistent, up to rounding."""
        return self.least_eigenvalue >= -_CONSISTENT

    @property
    def massless(self) -> bool:
        """Whether the link has practically no mass."""
        return self.edge == _NO_MASS


def link_conditions(model: TorqueModel, x: Vector) -> tuple[LinkCondition, ...]:
    """Examine each link of standard parameters.

    Parameters
    ----------
    model : TorqueModel
    x : ndarray, shape (parameters,)
    """
    scales = link_scales(model.robot)
    links = x[: model.layout.inertial_size].reshape(-1, 10)
    found = []
    for name, vector, root in zip(model.layout.links, links, scales.root, strict=True):
        body = InertialParameters(vector)
        least = np.linalg.eigvalsh(body.pseudo_inertia / np.outer(root, root))[0]
        typical = root**2
        edge = _edge(body, typical[3], typical[0]) if least >= -_CONSISTENT else ""
        found.append(LinkCondition(name, float(least), edge))
    return tuple(found)


def _edge(body: InertialParameters, mass: float, moment: float) -> str:
    """Name the boundary: second moments along principal axes that vanish.

    If one vanishes, a triangle inequality of the principal moments of inertia is
    active.
    """
    if body.mass <= _EDGE * mass:
        return _NO_MASS
    moments, axes = np.linalg.eigh(second_moments(body.central_inertia))
    gone = int((moments <= _EDGE * moment).sum())
    if gone == 0:
        return ""
    if gone == 1:
        return f"flat: no extent along {_axis(axes[:, 0])} (triangle inequality active)"
    if gone == 2:
        return f"a rod along {_axis(axes[:, 2])} (two triangle inequalities active)"
    return "a point mass"


def _axis(axis: Array) -> str:
    axis = axis * np.sign(axis[np.argmax(abs(axis))])
    rounded = np.round(axis, 2) + 0.0  # and no minus zero
    return "[" + " ".join(f"{value:.2f}" for value in rounded) + "]"


@dataclass(frozen=True, slots=True, eq=False)
class RobotSize:
    """Extents of delivered bodies relative to those that the geometry allows.

    Parameters
    ----------
    links : tuple of str
    carried_by : tuple of str
        The joint of each link.
    joints : tuple of str
        Those that turn.
    size : array_like, shape (links,), [m]
        Distance from a link's joint within which its mass is expected; infinite where
        nothing is known of the link's body.
    centre : array_like, shape (links,), [m]
        Distance of the estimated centre of mass from the joint; NaN without mass, and
        at joints that move little.
    radius : array_like, shape (links,), [m]
        Estimated radius of gyration; NaN without mass, and where the model has no
        rotor inertia of the link's joint: the link's inertia then includes it.
    inertia : array_like, shape (joints,)
        Inertia of the moving bodies about each joint, over the most that bodies with
        these masses have within their sizes; median of random poses.  NaN as above.
    """

    links: tuple[str, ...]
    carried_by: tuple[str, ...]
    joints: tuple[str, ...]
    size: Vector
    centre: Vector
    radius: Vector
    inertia: Vector

    def __post_init__(self) -> None:
        links, joints = (len(self.links),), (len(self.joints),)
        shapes = {"size": links, "centre": links, "radius": links, "inertia": joints}
        freeze_arrays(self, shapes, "robot size", finite=False)


def robot_size(
    model: TorqueModel, parameters: Vector, reach: Mapping[str, float] | None = None
) -> RobotSize:
    """Compare the bodies of a parameter vector with the robot's geometry.

    Parameters
    ----------
    model : TorqueModel
    parameters : ndarray, shape (parameters,)
    reach : mapping of str to float, optional, [m]
        Reach of links whose shapes are known; see `DrawnParts`.
    """
    robot = model.robot
    bodies = parameters[: model.layout.inertial_size].reshape(-1, 10)
    size = _sizes(robot, bodies[:, 0], reach or {})
    known = _rotor_known(model)
    centre, radius = np.full((2, len(bodies)), np.nan)
    for k, body in enumerate(bodies):
        if body[0] > 0.0:
            centre[k] = float(np.linalg.norm(body[1:4]) / body[0])
            trace = np.trace(InertialParameters(body).central_inertia)
            if known[k]:
                radius[k] = float(np.sqrt(max(trace, 0.0) / (2.0 * body[0])))
    # Joints that follow others add up in their leader's inertia: none is judged.
    followed = any(joint.mimic is not None for joint in robot.joints)
    shares = np.full(len(bodies), np.nan)
    if len(robot) and not followed:
        poses = random_poses(model, _POSES, 0)
        most = _most_inertia(robot, poses, bodies[:, 0], size)
        minor = np.median(most, axis=0) < _MINOR * float(np.median(most, axis=0).max())
        found = _shares(model, parameters, poses, most)
        shares = np.where(known & ~minor, found, np.nan)
        turns = np.array([joint.kind != "prismatic" for joint in robot.joints])
        radius[minor & turns] = centre[minor & turns] = np.nan
    turning = [
        k
        for k, joint in enumerate(robot.joints)
        if joint.driven and joint.kind != "prismatic"
    ]
    inertia, names = shares[turning], tuple(robot.joints[k].name for k in turning)
    carried_by = tuple(joint.name for joint in robot.joints)
    return RobotSize(robot.link_names, carried_by, names, size, centre, radius, inertia)


def _sizes(robot: RobotModel, masses: Vector, reach: Mapping[str, float]) -> Vector:
    """Return the largest distance of each link's mass from its joint, (links,), [m].

    The farthest of the joints at the link, of the joint before, where a motor may be,
    of the link's shapes, of the nominal body, and of a ball of the link's mass.  Shapes
    may leave out a tool or a payload, so they never shorten the nominal body.  Infinite
    where neither is known: the link may be long beyond its last joint.
    """
    sizes = (3.0 * np.maximum(masses, 0.0) / (4.0 * np.pi * _THIN)) ** (1.0 / 3.0)
    for k, joint in enumerate(robot.joints):
        before = float(np.linalg.norm(joint.translation))
        sizes[k] = max(sizes[k], before)
        if joint.parent >= 0:
            sizes[joint.parent] = max(sizes[joint.parent], before)
    for k, link in enumerate(robot.links):
        body = link.nominal
        sizes[k] = max(sizes[k], reach.get(link.name, np.inf if body is None else 0.0))
        if body is not None and body.mass > 0.0:
            spread = max(float(np.trace(body.central_inertia)), 0.0) / (2.0 * body.mass)
            centre = float(np.linalg.norm(body.vector[1:4])) / body.mass
            sizes[k] = max(sizes[k], centre + np.sqrt(spread))
    return np.asarray(sizes)


def _rotor_known(model: TorqueModel) -> BoolArray:
    """Return whether the model has a rotor inertia of each link's joint."""
    names = set(model.layout.names)
    return np.array(
        [f"{joint.name}.rotor_inertia" in names for joint in model.robot.joints],
        dtype=np.bool_,
    )


def _most_inertia(robot: RobotModel, q: Array, masses: Vector, size: Vector) -> Array:
    """Return the most inertia about each joint, shape (poses, links), [kg m^2]."""
    places = link_places(robot, q)
    most = np.zeros((len(q), len(robot.joints)))
    for i in np.flatnonzero(masses > 0.0).tolist():
        for j in ancestors(robot, i):
            arm = places.translation[:, i] - places.translation[:, j]
            away = np.linalg.norm(np.cross(places.axis[:, j], arm), axis=1)
            most[:, j] += float(masses[i]) * (away + size[i]) ** 2
    return most


def _shares(model: TorqueModel, parameters: Vector, q: Array, most: Array) -> Vector:
    """Return the bodies' inertia over the most, median of the poses, shape (links,)."""
    bodies = parameters.copy()
    bodies[model.layout.inertial_size :] = 0.0
    matrices = mass_matrices(model, bodies, q)
    shares = np.full(most.shape[1], np.nan)
    driven = [k for k, joint in enumerate(model.robot.joints) if joint.driven]
    for column, k in enumerate(driven):
        if most[:, k].min() > 0.0:
            shares[k] = float(np.median(matrices[:, column, column] / most[:, k]))
    return shares
