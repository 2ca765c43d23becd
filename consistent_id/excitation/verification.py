"""The demands on a path, and their proof over its whole duration."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import BoolArray, Matrix, Vector, checked, freeze
from consistent_id._support.tables import some_of
from consistent_id.errors import InfeasibleError, ProblemError
from consistent_id.excitation.guards import ClearanceGuard, Guard, TorqueGuard
from consistent_id.excitation.kernels import ParameterTorque, slow_speeds
from consistent_id.motion.collisions.clearance import (
    ClearanceReport,
    prove_clearance,
    worst_clearance,
)
from consistent_id.motion.collisions.scene import Scene, place_of
from consistent_id.motion.limits import MotionLimits
from consistent_id.motion.proofs.margins import MotionMargins, motion_margins
from consistent_id.motion.proofs.torque_bounds import require_enclosable
from consistent_id.motion.transfers import limits_of
from consistent_id.recordings.joint_paths import JointPath
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import RobotModel
from consistent_id.robot.solids import DrawnDrive

FRICTION_SHARE = 0.3
"""Share of the effort limits left for unknown friction.

At full speed friction takes 19 to 40 % of the effort limits of a UR10e's joints, 21 to
36 % of a TX40's, 50 % and more of TIAGo's; the median of all 16 joints is 31 %
(`benchmarks/friction_shares.py`).
"""

_NAMED = 4  # of bodies in a note
_DRY, _DRAG = 0.9, 10.0
"""Dry friction, and drag at the largest speed, over the torque limit: placeholders."""

_POSES = 2000  # in which weight is compared with limits
_REACH = 0.99  # share of a torque limit that may be used at samples


class FileParts(NamedTuple):
    """What a robot's file says of its torque, beside the bodies of the model.

    Parameters
    ----------
    drives : mapping of str to DrawnDrive
        Friction and rotors, of joints by name.
    behind : tuple of str
        Links with weight that moving links carry, and that the model does not have.
    massless : tuple of str
        Moving links that have shapes, but no mass.
    notes : tuple of str
        Notes on limits that the file states, and that are not used.
    """

    drives: Mapping[str, DrawnDrive] = {}
    behind: tuple[str, ...] = ()
    massless: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Demands:
    """All demands on a path.

    Parameters
    ----------
    model : TorqueModel
        Model that predicts torque.
    parameters : ndarray, shape (members, parameters), optional
        Parameters of that model; without them torque is not checked.
    scene : Scene, optional
        Bodies that must stay apart; without it collisions are not checked.
    notes : tuple of str
        Notes on limits that are not checked, with reasons.
    torque_of : str
        Model whose torque is compared with the limits.
    unweighed : tuple of str
        Links whose weight is not in that torque.

    Attributes
    ----------
    predicted : ParameterTorque, optional
        The torque of all joints: one whose torque is not measured has a motor, too.
    """

    limits: MotionLimits
    model: TorqueModel
    parameters: Matrix | None
    scene: Scene | None
    notes: tuple[str, ...]
    torque_of: str = "of the given parameters"
    unweighed: tuple[str, ...] = ()
    predicted: ParameterTorque | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        predicted = None
        if self.parameters is not None:
            every = replace(self.model, torque_joints=())
            slow = slow_speeds(self.limits)
            predicted = ParameterTorque(every, self.parameters, slow)
        freeze(self, predicted=predicted)

    @property
    def guards(self) -> tuple[Guard, ...]:
        """The limits that are not linear in a search's variables."""
        guards: list[Guard] = []
        if self.predicted is not None:
            # a joint with only a limit over time begins with twice this limit
            peak = np.isinf(self.limits.effort)
            effort = np.where(peak, 2.0 * self.limits.effort_rms, self.limits.effort)
            guards.append(TorqueGuard(self.predicted, effort, _REACH))
        if self.scene is not None and self.scene.pairs:
            guards.append(ClearanceGuard(self.scene))
        return tuple(guards)

    @property
    def of_short_motion(self) -> "Demands":
        """The same without limits of root mean squares: run-ins do not heat motors."""
        none = np.full_like(self.limits.effort_rms, np.inf)
        unlimited = replace(self.limits, effort_rms=none)
        return replace(self, limits=unlimited)

    def require_holdable(self) -> None:
        """Refuse limits that a joint's own weight exceeds in all poses.

        Raises
        ------
        InfeasibleError
            With the joint, the least torque that holds it, and its limit.
        """
        if self.parameters is None:
            return
        limits, rng = self.limits, np.random.default_rng(0)
        low = np.maximum(limits.lower, limits.middle - np.pi)
        high = np.minimum(limits.upper, limits.middle + np.pi)
        q = rng.uniform(low, high, (_POSES, len(limits.joints)))
        every, still = replace(self.model, torque_joints=()), np.zeros_like(q)
        for x in self.parameters:
            held = every.predict(x, q, still, still)
            one_way = (held > 0.0).all(axis=0) | (held < 0.0).all(axis=0)
            least = np.where(one_way, abs(held).min(axis=0), 0.0)
            for kind, limit in (
                ("", limits.effort),
                (" root mean square", limits.effort_rms),
            ):
                over = np.flatnonzero(least > limit)
                if len(over):
                    _refuse_to_hold(
                        limits.joints[over[0]], least[over[0]], limit[over[0]], kind
                    )

    def proof(self, paths: JointPath | Sequence[JointPath]) -> "PathProof":
        """Prove all limits of a path, or of several played one by one."""
        every = list(paths) if isinstance(paths, Sequence) else [paths]
        return combined([self._proof(path) for path in every])

    def _proof(self, path: JointPath) -> "PathProof":
        margins = motion_margins(
            path,
            self.limits,
            model=None if self.parameters is None else self.model,
            parameters=self.parameters,
        )
        scene = self.scene
        return PathProof(
            margins, None if scene is None else prove_clearance(scene, path)
        )


@dataclass(frozen=True, slots=True, eq=False)
class PathProof:
    """The proof of a path.

    Parameters
    ----------
    margins : MotionMargins
        Margins from limits of motion and torque; of several paths, the least.
    clearance : ClearanceReport, optional
        Proven distances of bodies, if there is a scene.
    """

    margins: MotionMargins
    clearance: ClearanceReport | None

    def retimed(self, clock: Callable[[float], float]) -> "PathProof":
        """Return the proof of the same motion on another clock."""
        margins = [replace(m, time=clock(m.time)) for m in self.margins.margins]
        apart = self.clearance
        if apart is not None:
            apart = replace(apart, time=clock(apart.time))
        return PathProof(MotionMargins(tuple(margins)), apart)

    @property
    def holds(self) -> bool:
        """Whether all demands are proven."""
        apart = self.clearance is None or self.clearance.holds
        return self.margins.holds and apart

    def require(self) -> None:
        """Raise unless all demands are proven.

        Raises
        ------
        InfeasibleError
            Naming joint and limit, or the two bodies, with time and value.
        """
        try:
            self.margins.require()
        except ProblemError as cause:
            raise InfeasibleError(str(cause)) from None
        if self.clearance is not None:
            self.clearance.require()


def _refuse_to_hold(joint: str, least: float, limit: float, kind: str) -> None:
    raise InfeasibleError(
        f"{joint} needs {least:.3g} N m (N) or more to hold its weight, in each of "
        f"{_POSES} poses of its range, and may use {limit:.3g}{kind}: no motion keeps "
        "this. Raise the limit (--effort, --friction-share), or check the file's masses"
    )


def combined(proofs: Sequence[PathProof]) -> PathProof:
    """Return one proof from those of several paths, played one by one."""
    margins = min((p.margins for p in proofs), key=lambda found: found.least.relative)
    apart = [p.clearance for p in proofs if p.clearance is not None]
    return PathProof(margins, worst_clearance(apart) if apart else None)


def demands(
    model: TorqueModel,
    limits: MotionLimits,
    parameters: ArrayLike | None = None,
    scene: Scene | None = None,
    friction_share: float = FRICTION_SHARE,
    stated: FileParts = FileParts(),  # noqa: B008  a constant
) -> Demands:
    """Return the demands on a path.

    Parameters
    ----------
    limits : MotionLimits
        Limits of the robot's joints, in any order; the demands have them in the
        robot's.
    parameters : array_like, shape (parameters,) or (members, parameters), optional
        By default the nominal robot and what is `stated`, if torque has limits.
    scene : Scene, optional
        Scene of the model's robot.
    friction_share : float
        Share of the torque limits that is left for friction, if no parameters include
        it.
    stated : FileParts
        What the robot's file says beside its bodies.

    Raises
    ------
    ProblemError
        If limits of a joint are missing, or parameters or scene are of another robot;
        or if no proof is possible for a drive term.
    InfeasibleError
        If a joint's weight exceeds its limit in all poses.
    """
    limits = robot_limits(limits, model.robot)
    _require_same_robot(scene, model.robot)
    notes = stated.notes
    if scene is None:
        notes += ("collisions are not checked: no scene",)
    bare = Demands(limits, model, None, scene, notes)
    if parameters is not None:
        found = _of_estimates(bare, parameters)
    elif not np.isfinite([limits.effort, limits.effort_rate, limits.effort_rms]).any():
        found = replace(bare, notes=(*notes, "torque has no limit"))
    else:
        found = _of_file(bare, friction_share, stated)
    found.require_holdable()
    return found


def _of_estimates(bare: Demands, parameters: ArrayLike) -> Demands:
    """Return demands with the torque of one estimate, or of several."""
    size, model = len(bare.model.layout), bare.model
    members = np.atleast_2d(checked(parameters, np.shape(parameters), "parameters"))
    if members.ndim != 2 or members.shape[1] != size or not len(members):
        raise ProblemError(
            f"parameters have shape {np.shape(parameters)}, expected ({size},) or "
            f"(members, {size}), one member or more, for this torque model"
        )
    require_enclosable(model)
    count = len(members)
    known = "an estimate" if count == 1 else f"each of {count} estimates"
    note = f"torque limits: kept for {known}, not the robot's file"
    return replace(bare, parameters=members, notes=(*bare.notes, note))


def _of_file(bare: Demands, friction_share: float, stated: FileParts) -> Demands:
    """Return demands with the torque that the robot's file states."""
    nominal, limits, notes = bare.model.robot.nominal, bare.limits, bare.notes
    lacking = None
    if nominal is None:
        lacking = "some links have no nominal inertia"
    elif not nominal.reshape(-1, 10)[:, 0].any():
        lacking = "no link has a mass in the robot's file"
    if nominal is None or lacking is not None:
        return replace(bare, notes=(*notes, f"torque is not checked: {lacking}"))
    if not 0.0 <= friction_share < 1.0:
        raise ProblemError(
            f"friction_share is {friction_share}, expected 0 or more, below 1"
        )
    counted, rubs, odd = _counted(stated.drives, limits, friction_share)
    if odd:
        notes += (
            f"friction of {some_of(odd, _NAMED)} in the file is as large as the torque "
            "limit, and does not count",
        )
    whose = _whose(friction_share, counted, limits.joints, rubs)
    notes += (f"torque limits: {whose}; --parameters uses an estimate instead",)
    carried = _carried(bare.scene, stated.behind)
    moved = _with_drives(bare.model.robot, counted)
    values = [getattr(counted[joint], term) for joint, term in moved.layout.drive]
    return replace(
        bare,
        limits=_reserved(limits, np.where(rubs, 0.0, friction_share)),
        model=moved,
        parameters=np.atleast_2d([*nominal.ravel(), *values]),
        notes=(*notes, *_unweighed_notes(carried, stated.massless)),
        torque_of=whose,
        unweighed=(*carried, *stated.massless),
    )


def _counted(
    drives: Mapping[str, DrawnDrive], limits: MotionLimits, share: float
) -> tuple[dict[str, DrawnDrive], BoolArray, tuple[str, ...]]:
    """Return what counts of stated drives, the joints whose friction does, and others.

    Files state friction that is zero, or too small, so the share is left.  Friction
    counts instead if it needs more at the joint's largest speed.  Friction that no
    motor with this limit overcomes is a placeholder, and the last are its joints.
    """
    limit = np.minimum(limits.effort, limits.effort_rms)
    own = [drives.get(name, DrawnDrive()) for name in limits.joints]
    known = np.isfinite(limits.velocity)
    drag = np.array([drive.viscous for drive in own]) * np.where(
        known, limits.velocity, 0.0
    )
    dry = np.array([drive.coulomb for drive in own])
    stated = np.isfinite(limit)
    odd = stated & ((dry >= _DRY * limit) | (drag >= _DRAG * limit))
    left = np.where(stated, share * np.where(stated, limit, 0.0), np.inf)
    rubs = ~odd & (dry + drag > left)
    counted = {
        name: drive if more else DrawnDrive(rotor_inertia=drive.rotor_inertia)
        for name, drive, more in zip(limits.joints, own, rubs, strict=True)
    }
    return counted, rubs, tuple(compress(limits.joints, odd))


def _whose(
    share: float,
    counted: Mapping[str, DrawnDrive],
    joints: Sequence[str],
    rubs: BoolArray,
) -> str:
    """Say whose torque is compared with the limits."""
    rotors = any(drive.rotor_inertia > 0.0 for drive in counted.values())
    whose = "of the robot's file" + ", its rotors included" * rotors
    left = f"{100.0 * share:.3g} % of the limits is left for its unknown friction"
    if not rubs.any():
        return f"{whose}; {left}"
    named = some_of(tuple(compress(joints, rubs)), _NAMED)
    stated = f"friction of {named} as the file states it"
    return f"{whose}, {stated}" if rubs.all() else f"{whose}, {stated}; else {left}"


def _with_drives(robot: RobotModel, counted: Mapping[str, DrawnDrive]) -> TorqueModel:
    """Return the torque model of a robot with the drive terms that count."""
    return TorqueModel(
        robot,
        tuple(
            DriveTerms(
                viscous=drive.viscous > 0.0,
                coulomb="sign" if drive.coulomb > 0.0 else "none",
                rotor_inertia=drive.rotor_inertia > 0.0,
            )
            for drive in map(counted.__getitem__, robot.joint_names)
        ),
    )


def _carried(scene: Scene | None, behind: Sequence[str]) -> tuple[str, ...]:
    """Return bodies that moving links carry, and whose weight the model lacks.

    They hang on joints behind the robot's tip, such as the fingers of a hand.
    """
    swept = [
        body.name
        for body in (() if scene is None else scene.bodies)
        if scene is not None
        and body.name in scene.swept
        and place_of(scene.robot, body).link >= 0
    ]
    return tuple(dict.fromkeys((*behind, *swept)))


def _unweighed_notes(
    carried: Sequence[str], massless: Sequence[str]
) -> tuple[str, ...]:
    """Say whose weight is not in the torque, and what to do."""
    notes = []
    if carried:
        notes.append(
            f"torque limits: without the weight of {some_of(carried, _NAMED)}, "
            "which the robot carries behind its tip; it counts if their joints are "
            "locked instead (--lock, without --tip)"
        )
    if massless:
        have = "has" if len(massless) == 1 else "have"
        listed = some_of(massless, _NAMED)
        notes.append(f"torque limits: {listed} {have} no mass in the robot's file")
    return tuple(notes)


def _reserved(limits: MotionLimits, shares: Vector) -> MotionLimits:
    """Return limits with a reserved share of each joint's torque limits."""
    return replace(
        limits,
        effort=(1.0 - shares) * limits.effort,
        effort_rms=(1.0 - shares) * limits.effort_rms,
    )


def robot_limits(limits: MotionLimits, robot: RobotModel) -> MotionLimits:
    """Return limits in the order of a robot's joints.

    Raises
    ------
    ProblemError
        If limits of a joint are missing, or the argument is of another type.
    """
    if not isinstance(limits, MotionLimits):
        raise ProblemError(
            f"limits are {type(limits).__name__}, expected MotionLimits; call "
            "motion_limits(robot)"
        )
    if limits.joints == robot.joint_names:
        return limits
    return limits_of(limits, robot.joint_names)


def _require_same_robot(scene: Scene | None, robot: RobotModel) -> None:
    if scene is not None and scene.robot.joint_names != robot.joint_names:
        raise ProblemError(
            f"the scene's robot has joints {', '.join(scene.robot.joint_names)}, the "
            f"model's {', '.join(robot.joint_names)}; expected the same, in order: "
            "build the scene with the model's robot"
        )
