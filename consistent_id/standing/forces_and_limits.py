"""Forces of the ground and torques of a motion on feet, as shares of its limits.

Feet press, they do not pull, and slip beyond the friction cone.  Many forces balance
the base's six rows; here those nearest to equal shares of the weight are used, with
deviations along the ground weighted by the friction coefficient. If they keep all
limits, feasible forces exist.

A ball keeps its cone of friction, ``|f_xy| <= mu f_z``.  A sole is pressed at its
corners ``(+-X, +-Y)``, each with friction of at most ``mu`` along either side.  The
exact set of wrenches that they can transmit together is [Caron2015]_

    |f_x|, |f_y| <= mu f_z,
    |t_x| <= Y f_z,  |t_y| <= X f_z,
    s t_z + |Y f_x + s mu t_x| + |X f_y + s mu t_y| <= mu (X + Y) f_z,  s = +-1,

of force ``f`` and moment ``t`` about the sole's middle: it does not slip, its centre of
pressure is in it, it does not turn.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.recordings.beside import BaseMotion
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.generalised_forces import contact_jacobian
from consistent_id.robot.model import RobotModel
from consistent_id.standing.stance import (
    LegMotion,
    Stance,
    StandingFoot,
    joint_motion,
)
from consistent_id.standing.trunk_path import TrunkMotion, TrunkPath

_NO_PRESS = 1e-9  # N; a foot without weight slips at any force
_CORNER = 2.0**-0.5  # of a cone of friction, along two sides at once

_REACHED = 1e-6  # m, rad; feet that are further off are out of reach


@brief
class GroundForces(NamedTuple):
    """The forces that support a motion.

    Parameters
    ----------
    forces : ndarray, shape (samples, points, 3), [N]
        On the robot, in the world's axes, z upwards, at each point of each foot.
    torque : ndarray, shape (samples, joints), [N m or N]
    share : float, [N]
        Share of the robot's weight, for each point.
    """

    forces: Array
    torque: Matrix
    share: float


def ground_forces(
    stance: Stance,
    model: TorqueModel,
    parameters: Vector,
    moved: LegMotion,
    base: BaseMotion,
    friction: float,
) -> GroundForces:
    """Return forces and torques of a motion.

    Parameters
    ----------
    model : TorqueModel
        Model of all rows.
    parameters : ndarray, shape (parameters,)
    base : BaseMotion
        With its rotation.
    friction : float
        Coefficient of friction between feet and ground.
    """
    robot, n = stance.robot, len(moved.q)
    needed = model.predict(parameters, moved.q, moved.dq, moved.ddq, base=base)
    upright = np.asarray(base.rotation)
    pushes = np.concatenate(
        [
            np.swapaxes(
                contact_jacobian(robot, moved.q, frame=foot.frame, point=point)[:, :3],
                1,
                2,
            )
            @ np.swapaxes(upright, 1, 2)
            for foot in stance.feet
            for point in foot.points
        ],
        axis=2,
    )
    points = pushes.shape[2] // 3
    share = _weight(stance, parameters) / points
    usual = np.tile([0.0, 0.0, share], points)
    freedom = np.tile([friction**2, friction**2, 1.0], points)
    G = pushes[:, :6]
    square = (G * freedom) @ np.swapaxes(G, 1, 2)
    lacking = needed[:, :6] - G @ usual
    more = np.linalg.solve(square, lacking[..., None])
    forces = usual + freedom * (np.swapaxes(G, 1, 2) @ more)[..., 0]
    torque = needed[:, 6:] - (pushes[:, 6:] @ forces[..., None])[..., 0]
    return GroundForces(forces.reshape(n, points, 3), torque, share)


def _weight(stance: Stance, parameters: Vector) -> float:
    """Return the robot's weight [N]."""
    masses = parameters[: 10 * len(stance.robot.links) : 10]
    return float(masses.sum() * np.linalg.norm(stance.robot.gravity))


class GroundShare(NamedTuple):
    """A limit, and the share of it that a foot uses at each time."""

    what: str
    foot: str
    share: Vector


def ground_shares(
    stance: Stance, ground: GroundForces, friction: float, least_press: float
) -> list[GroundShare]:
    """Return the used share of each foot's limits: at most 1, if they are kept.

    Parameters
    ----------
    stance : Stance
    ground : GroundForces
    friction : float
        Coefficient that may be used.
    least_press : float
        Of its share of the weight, with how much each foot is pressed at least.
    """
    found: list[GroundShare] = []
    first = 0
    for foot, rotation in zip(stance.feet, _turns(stance), strict=True):
        forces = ground.forces[:, first : first + len(foot.points)]
        first += len(foot.points)
        usual = ground.share * len(foot.points)
        press = forces[..., 2].sum(axis=1)
        lift = (usual - press) / (usual * (1.0 - least_press))
        if foot.flat:
            wrench = _sole_wrench(foot, forces @ rotation)
            shares = sole_shares(wrench, _half_sides(foot), friction * _CORNER)
        else:
            along = np.linalg.norm(forces[..., :2].sum(axis=1), axis=1)
            shares = {"friction cone": along / (friction * _pressed(press))}
        shares = {"pressing": lift, **shares}
        found += [GroundShare(what, foot.frame, s) for what, s in shares.items()]
    return found


def sole_shares(wrench: Matrix, half: Vector, friction: float) -> dict[str, Vector]:
    """Return which shares of its limits a sole uses.

    Parameters
    ----------
    wrench : ndarray, shape (samples, 6), [N, N m]
        On the sole, force first, about its middle, z away from the ground.
    half : ndarray, shape (2,), [m]
        Half of its length, along x, and of its width.
    friction : float
        Coefficient along each side.
    """
    fx, fy, _, tx, ty, tz = wrench.T
    press, mu = _pressed(wrench[:, 2]), friction
    X, Y = half
    slip = np.maximum(abs(fx), abs(fy)) / (mu * press)
    tilt = np.maximum(abs(tx) / Y, abs(ty) / X) / press
    turns = [
        s * tz + abs(Y * fx + s * mu * tx) + abs(X * fy + s * mu * ty)
        for s in (-1.0, 1.0)
    ]
    turn = np.max(turns, axis=0) / (mu * (X + Y) * press)
    return {"friction cone": slip, "centre of pressure": tilt, "turning": turn}


def _pressed(press: Vector) -> Vector:
    return np.maximum(press, _NO_PRESS)


def _turns(stance: Stance) -> list[Array]:
    """Return how feet are turned in the world, each shape (3, 3)."""
    return [seen.rotation[0] for seen in stance.seen(stance.pose[None])]


def _half_sides(foot: StandingFoot) -> Vector:
    """Return half of a sole's length and width."""
    return np.asarray(0.5 * np.ptp(foot.points, axis=0)[:2])


def _sole_wrench(foot: StandingFoot, forces: Array) -> Matrix:
    """Return force and moment of corners about their middle, in the foot's axes."""
    low, high = foot.points.min(axis=0), foot.points.max(axis=0)
    arms = foot.points - 0.5 * (low + high)
    moment = np.cross(arms, forces).sum(axis=1)
    return np.hstack([forces.sum(axis=1), moment])


@brief
@dataclass(frozen=True, slots=True)
class StandingLimits:
    """Limits of a motion on feet, over those of the robot's file.

    Parameters
    ----------
    friction : float
        Coefficient between feet and ground.
    friction_share : float
        Share of it that may be used.
    least_press : float
        Of its share of the weight, with how much each foot is pressed at least.
    effort_share : float
        Share of the effort limits: the rest is for friction in the joints and for the
        controller.
    velocity, effort : float or mapping of str to float, optional
        Limits of all joints or by name [rad/s or m/s], [N m or N], in place of the
        file's.
    """

    friction: float = 0.6
    friction_share: float = 0.7
    least_press: float = 0.2
    effort_share: float = 0.6
    velocity: float | Mapping[str, float] | None = field(default=None, hash=False)
    effort: float | Mapping[str, float] | None = field(default=None, hash=False)

    def __post_init__(self) -> None:
        for name in ("friction", "friction_share", "least_press", "effort_share"):
            value = getattr(self, name)
            top = np.inf if name == "friction" else 1.0
            if not 0.0 < value <= top:
                raise ProblemError(
                    f"{name} is {value}, expected a positive number"
                    + (", at most 1" if top == 1.0 else "")
                )

    def of(self, robot: RobotModel, what: str) -> Vector:
        """Return the limit of each joint: ``velocity`` or ``effort``."""
        given = getattr(self, what)
        driven = [joint for joint in robot.joints if joint.driven]
        own = {joint.name: getattr(joint.limits, what) for joint in driven}
        if given is None:
            return np.array([v if v > 0.0 else np.inf for v in own.values()])
        if isinstance(given, Mapping):
            return np.array([given.get(name, v) for name, v in own.items()])
        return np.array([min(given, v) if v > 0.0 else given for v in own.values()])


@dataclass(frozen=True, slots=True)
class Use:
    """The largest share of a limit that is used, of which, and when [s]."""

    what: str
    of: str
    share: float
    time: float


def uses(
    stance: Stance,
    limits: StandingLimits,
    time: Vector,
    moved: LegMotion,
    ground: GroundForces,
) -> tuple[Use, ...]:
    """Return the used share of each limit: at most 1, if it is kept.

    Shares of position are relative to the pose of the stance, of forces to equal shares
    of the weight, of torque to zero.
    """
    robot, names = stance.robot, stance.robot.joint_names
    driven = [joint for joint in robot.joints if joint.driven]
    upper = np.array([joint.limits.upper for joint in driven]) - stance.pose
    lower = np.array([joint.limits.lower for joint in driven]) - stance.pose
    away = moved.q - stance.pose
    room = np.where(away > 0, upper, -lower)
    position = abs(away) / np.where(away == 0.0, 1.0, np.maximum(room, 1e-9))
    speed = abs(moved.dq) / limits.of(robot, "velocity")
    torque = abs(ground.torque) / (limits.effort_share * limits.of(robot, "effort"))
    used = limits.friction_share * limits.friction
    of_feet = ground_shares(stance, ground, used, limits.least_press)
    kinds = dict.fromkeys(one.what for one in of_feet)
    feet = {what: [one for one in of_feet if one.what == what] for what in kinds}
    asked: list[tuple[str, Sequence[str], Matrix]] = [
        ("position", names, position),
        ("velocity", names, speed),
        ("torque", names, torque),
        *(
            (what, [one.foot for one in every], np.array([x.share for x in every]).T)
            for what, every in feet.items()
        ),
    ]
    return tuple(
        _largest(what, of, np.nan_to_num(shares, posinf=1e6), time)
        for what, of, shares in asked
    )


def _largest(what: str, of: Sequence[str], shares: Matrix, time: Vector) -> Use:
    k, j = np.unravel_index(int(np.argmax(shares)), shares.shape)
    return Use(what, of[int(j)], float(shares[k, j]), float(time[k]))


@brief
@dataclass(frozen=True, slots=True, eq=False)
class StandingMotion:
    """A motion on feet, all of it, at some times."""

    time: Vector
    trunk: TrunkMotion
    joints: LegMotion
    ground: GroundForces
    uses: tuple[Use, ...]

    @property
    def largest(self) -> float:
        """The largest share of a limit; infinite where feet are out of reach."""
        if self.joints.off > _REACHED or self.joints.singular:
            return np.inf
        return max(use.share for use in self.uses)


def standing_motion(
    stance: Stance,
    limits: StandingLimits,
    path: TrunkPath,
    time: Vector,
) -> StandingMotion:
    """Return the demands of a trunk's path on joints and ground.

    Parameters
    ----------
    stance : Stance
    limits : StandingLimits
    path : TrunkPath
    time : ndarray, shape (samples,), [s]
    """
    robot = stance.robot
    trunk = path.motion(time, np.asarray(robot.gravity))
    moved = joint_motion(stance, trunk)
    bodies = TorqueModel(robot)
    ground = ground_forces(
        stance, bodies, nominal_of(robot), moved, trunk.base, limits.friction
    )
    asked = uses(stance, limits, time, moved, ground)
    return StandingMotion(time, trunk, moved, ground, asked)


def nominal_of(robot: RobotModel) -> Vector:
    """Return the inertial parameters of all links; refuse a robot that lacks some."""
    if robot.nominal is None:
        raise ProblemError(
            f"robot {robot.name!r} has links without inertial parameters, so its "
            f"joint torques cannot be computed; complete its file"
        )
    return robot.nominal
