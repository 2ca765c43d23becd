"""Robots from URDF: our own lint first, then Pinocchio as the loader."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from consistent_id.errors import ModelError
from consistent_id.inertia import InertialParameters
from consistent_id.loaders._urdf_lint import lint
from consistent_id.model import (
    STANDARD_GRAVITY,
    Datasheet,
    Joint,
    JointKind,
    JointLimits,
    Link,
    RobotModel,
)
from consistent_id.parameters import did_you_mean

_SNAP = 1e-10  # entries of a rotation nearer than this to -1, 0 or 1 are taken as such


def load_urdf(
    path: str | Path,
    *,
    gravity: ArrayLike = STANDARD_GRAVITY,
    tip: str | None = None,
    joints: Sequence[str] | None = None,
    locked: Mapping[str, float] | None = None,
) -> RobotModel:
    """Load a robot from a URDF file; fixed joints are merged into their parents.

    Masses and centres of mass of the file become nominal values and datasheet values.

    Parameters
    ----------
    path : str or Path
    gravity : array_like, shape (3,), [m/s^2]
        In the base frame.
    tip : str, optional
        Keep only the chain from the base to this moving link.
    joints : sequence of str, optional
        Keep only these joints; all others are locked, at zero unless `locked` says
        otherwise.
    locked : mapping of str to float, optional, [rad or m]
        Positions of joints that do not move.  What a locked joint carries is merged
        into the link that carries the joint.

    Returns
    -------
    RobotModel

    Raises
    ------
    ModelError
        If the file cannot be read or describes no robot; with file and line.
    """
    import pinocchio as pin

    path, locked = Path(path), dict(locked or {})

    def moves(joint: str) -> bool:
        return joint not in locked and (joints is None or joint in joints)

    try:
        text = path.read_bytes()
    except OSError as cause:
        raise ModelError(f"{path}: cannot be read ({cause.strerror})") from None
    lint(text, path, moves)
    try:
        model = pin.buildModelFromXML(text.decode())
    except (ValueError, RuntimeError) as cause:
        raise ModelError(f"{path}: Pinocchio refuses it: {cause}") from None
    known = list(model.names)[1:]
    for name in (*locked, *(joints or ())):
        if name not in known:
            near = did_you_mean(name, known)
            raise ModelError(f"{path}: no joint {name!r} to keep or lock; {near}")
    for name in joints or ():
        if name in locked:
            raise ModelError(f"{path}: joint {name!r} is to be kept and to be locked")
    still = {name: locked.get(name, 0.0) for name in known if not moves(name)}
    robot = from_pinocchio(_reduced(model, still, path), gravity=gravity)
    return robot if tip is None else robot.up_to(tip)


def _reduced(model: Any, locked: Mapping[str, float], path: Path) -> Any:
    """Return a ``pinocchio.Model`` in which the named joints stand still."""
    import pinocchio as pin

    if not locked:
        return model
    if len(locked) == model.njoints - 1:
        raise ModelError(f"{path}: every joint is locked, so nothing moves")
    q = pin.neutral(model)
    places = [model.getJointId(name) for name in locked]
    for k, (name, position) in zip(places, locked.items(), strict=True):
        if not np.isfinite(position):
            raise ModelError(f"{path}: joint {name!r} is locked at {position}")
        joint = model.joints[k]
        turned = [np.cos(position), np.sin(position)]
        q[joint.idx_q : joint.idx_q + joint.nq] = turned if joint.nq == 2 else position
    return pin.buildReducedModel(model, places, q)


def from_pinocchio(model: Any, *, gravity: ArrayLike | None = None) -> RobotModel:
    """Convert a ``pinocchio.Model`` of one-axis joints into a `RobotModel`.

    Raises
    ------
    ModelError
        If a joint has more than one degree of freedom.
    """
    import pinocchio as pin

    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    joints, links = [], []
    for k in range(1, model.njoints):
        kind = _kind(model, k)
        column = model.joints[k].idx_v
        jacobian = pin.getJointJacobian(model, data, k, pin.LOCAL)
        twist = jacobian.reshape(6, -1)[:, column]
        placement = model.jointPlacements[k]
        joints.append(
            Joint(
                name=model.names[k],
                kind=kind,
                parent=model.parents[k] - 1,
                rotation=_snapped(placement.rotation),
                translation=placement.translation,
                axis=_snapped(twist[:3] if kind == "prismatic" else twist[3:]),
                limits=_limits(model, k, kind),
            )
        )
        links.append(_link(model, k))
    if gravity is None:
        gravity = model.gravity.linear
    return RobotModel(model.name, tuple(joints), tuple(links), np.asarray(gravity))


def _kind(model: Any, k: int) -> JointKind:
    joint = model.joints[k]
    short = joint.shortname()
    if joint.nv != 1 or "Helical" in short or "Mimic" in short:
        raise ModelError(
            f"joint {model.names[k]!r} is a {short}; only revolute, continuous, "
            "prismatic and fixed joints are supported"
        )
    if "Prismatic" in short or short.startswith("JointModelP"):
        return "prismatic"
    return "continuous" if joint.nq == 2 else "revolute"


def _limits(model: Any, k: int, kind: JointKind) -> JointLimits:
    """Limits as the file states them; what it leaves out is infinite, not zero."""
    position, rate = model.joints[k].idx_q, model.joints[k].idx_v
    lower, upper = -np.inf, np.inf
    if kind != "continuous":
        lower = _stated(model.lowerPositionLimit[position])
        upper = _stated(model.upperPositionLimit[position])
    return JointLimits(
        lower,
        upper,
        abs(_stated(model.upperVelocityLimit[rate])) or np.inf,
        abs(_stated(model.upperEffortLimit[rate])) or np.inf,
    )


def _stated(limit: float) -> float:
    """Return a limit, infinite where Pinocchio has put the largest double for none."""
    largest = np.finfo(np.float64).max
    return float(limit) if abs(limit) < largest else float(np.copysign(np.inf, limit))


def _link(model: Any, k: int) -> Link:
    import pinocchio as pin

    bodies = [
        frame.name
        for frame in model.frames
        if frame.parentJoint == k and frame.type == pin.FrameType.BODY
    ]
    body = model.inertias[k]
    nominal = InertialParameters.from_central(body.mass, body.lever, body.inertia)
    name = cast(str, bodies[0]) if bodies else f"link_of_{model.names[k]}"
    com = body.lever if body.mass > 0.0 else None
    sheet = Datasheet(mass=body.mass if body.mass > 0.0 else None, com=com)
    return Link(name, nominal, sheet)


def _snapped(values: np.ndarray) -> np.ndarray:
    """Restore exact zeros and ones, which speed up the regressor, after 1.5707963."""
    nearest = np.round(values)
    return np.where(abs(values - nearest) < _SNAP, nearest, values)
