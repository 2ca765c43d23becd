"""Where a robot touches the ground, and the pose in which it stands there."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import InfeasibleError, ProblemError
from consistent_id.excitation.standing.stance import Stance, StandingFoot, joint_motion
from consistent_id.excitation.standing.trunk_path import TrunkMotion
from consistent_id.motion.collisions.urdf_bodies import link_bodies
from consistent_id.problems.floating.feet import Foot, feet_of
from consistent_id.recordings.base_motion import BaseMotion
from consistent_id.robot.frame_motion import reach
from consistent_id.robot.loaders.mjcf_assets import read_spec
from consistent_id.robot.loaders.robot_file import is_mjcf
from consistent_id.robot.loaders.urdf_lint import read_bytes
from consistent_id.robot.loaders.xml import parse
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import did_you_mean, require_known

_SOLE = 0.8  # share of a sole's sides on which it may be pressed: edges are round
_BENT = 0.15  # of a leg's length, by which the trunk is lowered to bend the knees
_NUDGE = 0.4  # rad, with which knees begin to bend, to their wider side
_WIDER = 1.5  # ratio of a joint's two ranges from which on it has a wider side


def standing_feet(
    robot: RobotModel,
    path: Path,
    frames: Sequence[str] = (),
    sole: tuple[float, float] | None = None,
) -> tuple[StandingFoot, ...]:
    """Return feet to stand on: those of the names, or all that the robot has.

    Parameters
    ----------
    path : Path
        Of its file, with the feet's shapes.
    sole : (float, float), optional, [m]
        Length and width of a sole; by default those of its collision shapes.

    Raises
    ------
    ProblemError
        If there is no such foot, or a sole has no shape.
    """
    known = {foot.frame: foot for foot in feet_of(robot, path)}
    names = {name: foot for foot in known.values() for name in foot.names}
    for frame in frames:
        if frame not in names:
            raise ProblemError(f"no foot {frame!r}; {did_you_mean(frame, list(known))}")
    chosen = [names[frame] for frame in frames] or list(known.values())
    if not chosen:
        raise ProblemError(
            f"{path}: no link is named as a foot (foot, sole, toe, ankle, calf); a "
            "robot without feet does not stand"
        )
    return tuple(_standing(path, foot, sole) for foot in chosen)


def _standing(path: Path, foot: Foot, sole: tuple[float, float] | None) -> StandingFoot:
    if not foot.surface:
        return StandingFoot(foot.frame, foot.point[None], False)
    if sole is not None:
        half = 0.5 * _SOLE * np.array(sole)
        low, high = np.array([*-half, 0.0]), np.array([*half, 0.0])
    else:
        corners = _corners(path, foot)
        if not len(corners):
            raise ProblemError(
                f"{path}: foot {foot.frame!r} has no collision shape; say how large "
                "its sole is: --sole LENGTH,WIDTH"
            )
        low, high = corners.min(axis=0), corners.max(axis=0)
        middle, half = 0.5 * (low + high), 0.5 * _SOLE * (high - low)
        low, high = middle - half, middle + half
        high[2] = low[2] = corners[:, 2].min()
    x, y = [low[0], high[0]], [low[1], high[1]]
    points = np.array([[a, b, low[2]] for a in x for b in y])
    return StandingFoot(foot.frame, points, True)


def _corners(path: Path, foot: Foot) -> Matrix:
    """Return the outermost points of a foot's shapes in the axes of its frame."""
    found: list[Matrix] = [np.zeros((0, 3))]
    axes = np.vstack([np.eye(3), -np.eye(3)])
    if is_mjcf(path):
        found += _mjcf_corners(path, foot.frame)
        return np.vstack(found)
    for link in parse(read_bytes(path)).all("link"):
        if link.name == foot.frame:
            for body in link_bodies(path, link):
                turned = np.asarray(body.rotation)
                points = body.shape.farthest(axes @ turned)
                found.append(points @ turned.T + np.asarray(body.translation))
    return np.vstack(found)


def _mjcf_corners(path: Path, frame: str) -> list[Matrix]:
    import mujoco

    model = read_spec(path, mujoco).compile()
    found = []
    for geom in range(model.ngeom):
        touches = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if model.body(int(model.geom_bodyid[geom])).name != frame or not touches:
            continue
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, model.geom_quat[geom])
        middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
        corners = middle + signs * half
        found.append(corners @ R.reshape(3, 3).T + model.geom_pos[geom])
    return found


def standing_pose(
    robot: RobotModel,
    path: Path,
    feet: tuple[StandingFoot, ...],
    given: Mapping[str, float] | None = None,
) -> Vector:
    """Return the pose in which a robot stands.

    Joints that are not given are as in the keyframe of an MJCF file that is named home
    or stand, or its first; without one, at zero, the knees bent with the feet below
    where they are then.

    Raises
    ------
    ProblemError
        If there is no such joint.
    InfeasibleError
        If the knees cannot be bent.
    """
    stated = dict(given or {})
    require_known(stated, robot.joint_names, "--stance: no joint")
    keyed = _keyframe(path)
    if keyed or stated:
        known = {**keyed, **stated}
        return np.array([known.get(name, 0.0) for name in robot.joint_names])
    return _bent(robot, feet)


def _keyframe(path: Path) -> dict[str, float]:
    if not is_mjcf(path):
        return {}
    import mujoco

    model = read_spec(path, mujoco).compile()
    keys = [model.key(k).name for k in range(model.nkey)]
    if not keys:
        return {}
    named = [k for k, name in enumerate(keys) if "home" in name or "stand" in name]
    qpos = model.key((*named, 0)[0]).qpos
    return {
        model.joint(j).name: float(qpos[model.jnt_qposadr[j]])
        for j in range(model.njnt)
        if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE
    }


def _bent(robot: RobotModel, feet: tuple[StandingFoot, ...]) -> Vector:
    """Return the pose at zero, lowered until the knees are bent."""
    limits = [joint.limits for joint in robot.joints if joint.driven]
    low, high = (np.array([getattr(x, s) for x in limits]) for s in ("lower", "upper"))
    zero = np.clip(np.zeros(len(robot)), low, high)
    ahead, back = high - zero, zero - low
    side = np.where(
        ahead > _WIDER * back, 1.0, np.where(back > _WIDER * ahead, -1.0, 0)
    )
    upright = Stance(robot, feet, zero)
    legs = np.isin(robot.joint_names, upright.joints)
    longest = max(
        reach(leg, foot.frame, foot.points[0])
        for leg, foot in zip(upright.legs, feet, strict=True)
    )
    down = np.array([[0.0, 0.0, -_BENT * longest]])
    still = np.zeros((1, 3))
    lowered = TrunkMotion(
        down, still, still, BaseMotion.at_rest(1, gravity=robot.gravity)
    )
    moved = joint_motion(upright, lowered, begin=zero + _NUDGE * side * legs)
    pose = moved.q[0]
    inside = bool(((pose >= low) & (pose <= high)).all())
    if moved.off > 1e-6 or moved.singular or not inside:
        raise InfeasibleError(
            "no pose with bent knees is found from all joints at zero; say in which it "
            "stands: --stance JOINT=POSITION ..."
        )
    return np.asarray(pose)
