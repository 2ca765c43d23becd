"""Robots from MJCF, as MuJoCo compiles them.

Joints that follow others are given by ``<equality><joint polycoef>``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.extras import needed
from consistent_id._support.files import LARGEST_TREE, require_count
from consistent_id.errors import ModelError
from consistent_id.robot.chains import Selection, selected
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.kinematics import FixedPlace, snapped, turn
from consistent_id.robot.loaders.mjcf_spec import (
    joint_name,
    mjcf_elements,
    read_spec,
    refuse_unsupported,
)
from consistent_id.robot.model import (
    Datasheet,
    FixedFrame,
    Joint,
    JointKind,
    JointLimits,
    Link,
    Mimic,
    RobotModel,
)
from consistent_id.robot.parameters import did_you_mean


def load_mjcf(
    path: str | Path,
    *,
    gravity: ArrayLike | None = None,
    base: str | None = None,
    tip: str | None = None,
    joints: Sequence[str] | None = None,
    locked: Mapping[str, float] | None = None,
) -> RobotModel:
    """Load a robot from an MJCF file, of hinge and slide joints.

    MuJoCo resolves included files, defaults, angle units and inertias of shapes.  A
    link has its body's name and frame, the origin being moved onto the joint's axis
    where the joint has a ``pos``.  Several joints of one body become a chain of
    massless links named ``body/joint``.  Bodies without joints are merged into their
    parents (`Link.merged`).  Equality constraints of joints make followers
    (`Joint.mimic`), where their polynomial is a straight line.

    A missing mesh or texture is not an error if the body's inertial is explicit.

    Armature, damping, friction loss, springs and gravity compensation are not part of a
    `RobotModel`; they are ignored.

    Parameters
    ----------
    path : str or Path
    gravity : array_like, shape (3,), [m/s^2], optional
        In the world frame; the file's own if it is left out.
    base, tip, joints, locked
        As for `load_urdf`, with bodies for links.  With the base ``"floating"``, the
        body of the world that carries all others is free, whether it has a free joint
        or hangs on the world.  Where a joint is locked, its
        position is MuJoCo's, which counts from the joint's ``ref``.

    Raises
    ------
    ModelError
        If MuJoCo is not installed or refuses the file, if the inertia of a body comes
        from a mesh that is not there, or if something that moves has a free or ball
        joint, is tied by an equality constraint other than a straight line from joint
        to joint, or pulled by a tendon.
    """
    path, selection = Path(path), Selection(base, tip, joints, locked)
    _check(path)
    model = compiled_file(path)
    try:
        chosen = _joints_between(model, selection, path)
        moving = {j for j in chosen if selection.moves(joint_name(model, j))}
        root = -1
        if selection.floating(_body_names(model)):
            root = _floating_body(model, path)
            moving -= set(_joints_of(model, root))
            selection = replace(selection, base=None)
        refuse_unsupported(model, moving, path)
        bound = _bindings(model, path)
        gravity = _gravity(model) if gravity is None else gravity
        robot = _robot(model, path.stem, gravity, bound.mimics, root)
    except UnicodeDecodeError as cause:  # MuJoCo accepts names of any encoding
        raise ModelError(f"{path}: a name is not UTF-8: {cause}") from None
    return selected(robot, selection.with_locked(bound.still))


class _Bindings(NamedTuple):
    """The effect of equality constraints on joints, by their names.

    `mimics` of joints that follow one that moves by itself, chains of them resolved;
    `still`, the positions of joints that are bound to stand still.
    """

    mimics: dict[str, Mimic]
    still: dict[str, float]


def _bindings(model: Any, path: Path) -> _Bindings:
    try:
        return bindings(model)
    except ModelError as fault:
        raise ModelError(f"{path}: {fault}") from None


def bindings(model: Any) -> _Bindings:
    """Return the joints that active equality constraints bind in a straight line.

    MuJoCo counts from the joints' ``ref``: ``q1 - ref1 = b + k (q2 - ref2)``.

    Raises
    ------
    ModelError
        If joints follow one another, or two constraints bind the same one.
    """
    lines = _lines(model)
    mimics: dict[str, Mimic] = {}
    still: dict[str, float] = {}
    for joint in lines:
        ratio, offset, leader, seen = 1.0, 0.0, joint, {joint}
        while leader in lines:
            multiplier, shift, leader = lines[leader]
            ratio, offset = ratio * multiplier, offset + ratio * shift
            if leader in seen:
                name = joint_name(model, joint)
                raise ModelError(f"joint {name!r} follows one that follows it")
            seen.add(leader)
        if leader < 0 or ratio == 0.0:
            still[joint_name(model, joint)] = offset
        else:
            mimics[joint_name(model, joint)] = Mimic(
                joint_name(model, leader), ratio, offset
            )
    return _Bindings(mimics, still)


def _lines(model: Any) -> dict[int, tuple[float, float, int]]:
    """Return ``(k, b, leader)`` of joints with ``q = k q_leader + b``; -1 for none."""
    import mujoco

    lines: dict[int, tuple[float, float, int]] = {}
    for e in range(model.neq):
        joints = mujoco.mjtEq(int(model.eq_type[e])) == mujoco.mjtEq.mjEQ_JOINT
        if not (joints and model.eq_active0[e]) or model.eq_data[e, 2:5].any():
            continue
        follower, leader = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        if follower in lines:
            name = joint_name(model, follower)
            raise ModelError(
                f"two equality constraints bind joint {name!r}; remove one of them"
            )
        shift, ratio = model.eq_data[e, :2].tolist()
        shift += _reference(model, follower)
        if leader >= 0:
            shift -= ratio * _reference(model, leader)
        lines[follower] = (ratio if leader >= 0 else 0.0, shift, leader)
    return lines


def _reference(model: Any, j: int) -> float:
    return float(model.qpos0[model.jnt_qposadr[j]])


def _check(path: Path) -> None:
    """Refuse unsafe files; MuJoCo itself reports text that is not XML."""
    elements = mjcf_elements(path)
    copies = 1
    for element in elements:
        count = element.attributes.get("count", "")
        if element.tag == "replicate" and count.strip().isdigit():
            copies *= max(1, int(count))
    bodies = sum(element.tag in ("body", "joint") for element in elements)
    require_count(path, bodies * copies, LARGEST_TREE, "bodies and joints", ModelError)


def compiled_file(path: Path) -> Any:
    """Return the model that MuJoCo compiles of a file; refuse negative masses."""
    mujoco = needed("mujoco", "mjcf", f"{path}: reading MJCF", ModelError)
    spec = read_spec(path, mujoco)
    try:
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"{path}: MuJoCo refuses it: {cause}") from None
    for body in spec.bodies:  # MuJoCo would treat a negative mass as zero
        if body.explicitinertial and not body.mass >= 0.0:
            raise ModelError(
                f"{path}: body {body.name!r} has mass {body.mass:g} kg, expected 0 or "
                "more"
            )
    return model


def _floating_body(model: Any, path: Path) -> int:
    """Return the body of the world that moves, or carries what moves.

    Raises
    ------
    ModelError
        If there is none, if there are several, or if it has other joints than a free
        one.
    """
    import mujoco

    roots = {
        int(model.body_rootid[body])
        for body in range(1, model.nbody)
        if model.body_jntnum[body]
    }
    names = [model.body(body).name for body in sorted(roots)]
    if len(roots) != 1:
        raise ModelError(
            f"{path}: the base is stated to float, but the world carries "
            f"{', '.join(names) or 'no body with joints'}; expected one robot. Remove "
            "the others from the file"
        )
    (root,) = roots
    free = mujoco.mjtJoint.mjJNT_FREE
    first = int(model.body_jntadr[root])
    for j in range(first, first + int(model.body_jntnum[root])):
        if mujoco.mjtJoint(int(model.jnt_type[j])) != free:
            raise ModelError(
                f"{path}: the base is stated to float, but body {names[0]!r} is "
                f"connected to the world by joint {joint_name(model, j)!r}; leave "
                f"base out"
            )
    return root


def _joints_between(model: Any, selection: Selection, path: Path) -> set[int]:
    """Joints from the base to the tip, or to all that the base carries."""
    names = _body_names(model)
    if selection.floating(names):
        selection = replace(selection, base=None)
    for name in (selection.base, selection.tip):
        if name is not None and name not in names:
            near = did_you_mean(name, names)
            raise ModelError(f"{path}: no body named {name!r}; {near}")
    base, tip = selection.base, selection.tip
    start = 0 if base is None else int(model.body_weldid[names.index(base)])
    found: set[int] = set()
    for body in range(model.nbody) if tip is None else [names.index(tip)]:
        joints: set[int] = set()
        while body not in (start, 0):
            joints |= set(_joints_of(model, body))
            body = int(model.body_parentid[body])
        if body == start:
            found |= joints
    return found


def _gravity(model: Any) -> ArrayLike:
    """Return the file's gravity: none with ``<flag gravity="disable"/>``."""
    import mujoco

    disabled = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    return np.zeros(3) if disabled else np.asarray(model.opt.gravity)


def _robot(
    model: Any, name: str, gravity: ArrayLike, mimics: Mapping[str, Mimic], root: int
) -> RobotModel:
    """Return the robot; body `root`, if there is one, moves freely."""
    joints: list[Joint] = []
    links: list[str] = []
    bodies: list[list[InertialParameters]] = []
    frames: list[list[FixedFrame]] = [[FixedFrame("world", np.eye(3), np.zeros(3))]]
    places = {0: FixedPlace(-1, np.eye(3), np.zeros(3))}
    for b in range(1, model.nbody):
        parent = places[int(model.body_parentid[b])]
        place = parent.beyond(quaternion_matrix(model.body_quat[b]), model.body_pos[b])
        own = [j for j in _joints_of(model, b) if _kind(model, j) is not None]
        if b == root:
            joints.append(_free_joint(model, b))
            links.append(_body_name(model, b))
            bodies.append([])
            frames.append([])
            place = FixedPlace(0, np.eye(3), np.zeros(3))
        for j in own:
            mimic = mimics.get(joint_name(model, j))
            joints.append(replace(_joint(model, j, place), mimic=mimic))
            last = j == own[-1]
            body = _body_name(model, b)
            links.append(body if last else f"{body}/{joint_name(model, j)}")
            bodies.append([])
            frames.append([])
            place = FixedPlace(len(joints) - 1, np.eye(3), -_anchor(model, j))
        places[b] = place
        if not own and b != root:
            where = (snapped(place.rotation), place.translation)
            frames[place.link + 1].append(FixedFrame(_body_name(model, b), *where))
        if place.link >= 0:
            body_there = compiled_body(model, b).transformed(
                place.rotation, place.translation
            )
            bodies[place.link].append(body_there)
    merged = [_link(*parts) for parts in zip(links, bodies, frames[1:], strict=True)]
    return RobotModel(
        name, tuple(joints), tuple(merged), np.asarray(gravity), tuple(frames[0])
    )


def _free_joint(model: Any, body: int) -> Joint:
    """Return the free joint of a body, at which it is at rest where the world is."""
    has_own = bool(model.body_jntnum[body])
    name = joint_name(model, int(model.body_jntadr[body])) if has_own else "root_joint"
    return Joint(name, "free", -1, np.eye(3), np.zeros(3), np.array([0.0, 0.0, 1.0]))


def _link(
    name: str, bodies: Sequence[InertialParameters], frames: Sequence[FixedFrame]
) -> Link:
    total = np.sum([body.vector for body in bodies], axis=0) if bodies else np.zeros(10)
    nominal = InertialParameters(total)
    sheet = Datasheet()
    if nominal.mass > 0.0:
        sheet = Datasheet(mass=nominal.mass, com=nominal.com)
    return Link(name, nominal, sheet, tuple(frames))


def compiled_body(model: Any, b: int) -> InertialParameters:
    """Return the parameters of a compiled model's body in its own frame."""
    axes = quaternion_matrix(model.body_iquat[b])
    inertia = axes @ np.diag(model.body_inertia[b]) @ axes.T
    return InertialParameters.from_central(
        float(model.body_mass[b]), model.body_ipos[b], inertia
    )


def _joint(model: Any, j: int, place: FixedPlace) -> Joint:
    """Return a joint of a body that, at the joint's ``ref``, is in `place`."""
    kind = _kind(model, j)
    if kind is None:
        raise ModelError(
            f"joint {joint_name(model, j)!r} is neither a hinge nor a slide"
        )
    axis = model.jnt_axis[j]
    reference = float(model.qpos0[model.jnt_qposadr[j]])
    if kind == "prismatic":
        zero = place.beyond(np.eye(3), -reference * axis)
    else:
        zero = place.beyond(turn(axis, -reference), _anchor(model, j))
    return Joint(
        name=joint_name(model, j),
        kind=kind,
        parent=place.link,
        rotation=snapped(zero.rotation),
        translation=zero.translation,
        axis=snapped(axis),
        limits=_limits(model, j),
    )


def _kind(model: Any, j: int) -> JointKind | None:
    import mujoco

    kind = mujoco.mjtJoint(int(model.jnt_type[j]))
    if kind == mujoco.mjtJoint.mjJNT_SLIDE:
        return "prismatic"
    if kind == mujoco.mjtJoint.mjJNT_HINGE:
        return "revolute" if model.jnt_limited[j] else "continuous"
    return None


def _anchor(model: Any, j: int) -> np.ndarray:
    """Return a point of the axis in the body's frame; a slide has none of its own."""
    return np.zeros(3) if _kind(model, j) == "prismatic" else model.jnt_pos[j].copy()


def _limits(model: Any, j: int) -> JointLimits:
    import mujoco

    lower, upper = model.jnt_range[j] if model.jnt_limited[j] else (-np.inf, np.inf)
    ranges = [
        actuator_range(model, a)
        for a in range(len(model.actuator_trntype))
        if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT
        and model.actuator_trnid[a, 0] == j
    ]
    effort = _either_way(np.sum(ranges, axis=0)) if ranges else np.inf
    if model.jnt_actfrclimited[j]:
        effort = min(effort, _either_way(model.jnt_actfrcrange[j]))
    return JointLimits(float(lower), float(upper), effort=effort)


def actuator_range(model: Any, a: int) -> tuple[float, float]:
    """Return the least and the largest force of an actuator, at its joint.

    Those of its stated range, and of the range of controls of a motor, whose force is
    its control times a gain; infinite where neither is limited.
    """
    import mujoco

    ranges = [(-np.inf, np.inf)]
    if model.actuator_forcelimited[a]:
        ranges.append(tuple(model.actuator_forcerange[a]))
    is_motor = (
        model.actuator_dyntype[a] == mujoco.mjtDyn.mjDYN_NONE
        and model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE
    )
    if is_motor and model.actuator_ctrllimited[a]:
        forces = model.actuator_gainprm[a][0] * model.actuator_ctrlrange[a]
        ranges.append((forces.min(), forces.max()))
    lows, highs = zip(*ranges, strict=True)
    low, high = sorted(model.actuator_gear[a][0] * np.array([max(lows), min(highs)]))
    return float(low), float(high)


def _either_way(span: Sequence[float]) -> float:
    """Return what a range allows in both directions; in its own, if it has but one."""
    low, high = (float(end) for end in span)
    return min(-low, high) if low < 0.0 < high else max(abs(low), abs(high))


def _joints_of(model: Any, b: int) -> range:
    first = int(model.body_jntadr[b])
    return range(first, first + int(model.body_jntnum[b]))


def _body_names(model: Any) -> list[str]:
    return [_body_name(model, b) for b in range(model.nbody)]


def _body_name(model: Any, b: int) -> str:
    return model.body(b).name or f"body{b}"


def quaternion_matrix(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a unit quaternion (w, x, y, z)."""
    w, *xyz = quaternion
    length = float(np.linalg.norm(xyz))
    if length == 0.0:
        return np.eye(3)
    return turn(np.array(xyz) / length, 2.0 * np.arctan2(length, w))
