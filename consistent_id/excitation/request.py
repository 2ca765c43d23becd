"""The request of a problem's ``[excitation]`` table, as values of a design."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import ProblemError
from consistent_id.excitation.aims import Aim, PathForm, forms_to_try
from consistent_id.excitation.criteria import Objective
from consistent_id.excitation.interest import interest_names
from consistent_id.excitation.request_scene import default_scene, requested_scene
from consistent_id.excitation.verification import FRICTION_SHARE
from consistent_id.motion.collisions.scene import Scene
from consistent_id.motion.collisions.separation import nearest
from consistent_id.motion.limits import MotionLimits, motion_limits
from consistent_id.problems.excitation_tables import (
    ExcitationTable,
    LimitsTable,
    PerJoint,
)
from consistent_id.problems.problem import Problem
from consistent_id.recordings.joint_paths import FourierTrajectory
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import did_you_mean, require_known

_TABLE = "[excitation]"

_WHERE = "[excitation.limits]"
_HARMONICS = 5  # of base frequencies that are requested without a number


@dataclass(frozen=True, slots=True, eq=False)
class DesignRequest:
    """Forms, aim, limits and scene of a path, and options for playing it.

    Parameters
    ----------
    forms : tuple of PathForm
        Forms to choose from: one, if the number of harmonics is requested.
    aim : Aim
    limits : MotionLimits
    scene : Scene, optional
    start_pose : dict from joint to position, optional
        Where the robot rests before and after, all joints of it.
    periods : int, optional
        How often a periodic path is repeated; None to play its duration once.
    notes : tuple of str
        Notes on the default scene.
    friction_share : float
        Share of the effort limits that is left for unknown friction.
    """

    forms: tuple[PathForm, ...]
    aim: Aim
    limits: MotionLimits
    scene: Scene | None
    start_pose: dict[str, float] | None
    periods: int | None
    notes: tuple[str, ...] = ()
    friction_share: float = FRICTION_SHARE

    @property
    def form(self) -> PathForm:
        """The first of the forms."""
        return self.forms[0]


def design_request(problem: Problem) -> DesignRequest:
    """Return what the ``[excitation]`` table of a problem requests.

    Raises
    ------
    ProblemError
        If a joint is unknown, its limits leave no motion, the scene contradicts itself,
        a path is to be repeated that rests or is no whole period, or the start pose is
        outside the limits or has bodies too near to one another.
    """
    table = problem.table.excitation
    if table.rest and table.periods != 1:
        raise ProblemError(
            f"{_TABLE} periods is {table.periods}, but a path that rests at its ends "
            f"is not repeated; give rest = false, or leave periods out and play it "
            f"several times"
        )
    limits = _limits(table.limits, problem.moving)
    forms = _forms(table, limits)
    refine: Objective | Literal["default"] | None = "default"
    if table.refine is not None:
        refine = None if table.refine == "none" else table.refine
    aim = Aim(
        objective=table.objective,
        refine=refine,
        growth=table.growth,
        condition_at_most=table.condition_at_most,
        scaling=table.scaling,
        noise=table.noise,
        rate=table.rate,
        correlation_time=table.correlation_time,
        interest=_interest(problem, refine),
    )
    pose = _pose(table.start_pose, limits) if table.start_pose else None
    scene = requested_scene(problem)
    notes: tuple[str, ...] = ()
    if table.scene is None:
        scene, notes = default_scene(problem, pose)
    elif scene is not None and pose is not None:
        _require_clear(scene, pose)
    periods = None if table.periods == 1 else table.periods
    if periods is not None:
        for form in forms:
            _require_whole_period(form, periods)
    left = table.limits.friction_share
    left = FRICTION_SHARE if left is None else left
    return DesignRequest(forms, aim, limits, scene, pose, periods, notes, left)


def _interest(
    problem: Problem, refine: Objective | Literal["default"] | None
) -> tuple[str, ...]:
    """Return the parameters of interest: for a wrench sensor those of the tool."""
    table, robot = problem.table.excitation, problem.model.robot
    if table.interest or problem.arm is None:
        return interest_names(robot, table.interest)
    no_errors = table.objective == "condition" and refine is None
    return () if no_errors else robot.link_names


def _forms(table: ExcitationTable, limits: MotionLimits) -> tuple[PathForm, ...]:
    """Return the form that is requested, or those to try."""
    bases = table.base_frequencies
    if table.harmonics is None and bases is None:
        return forms_to_try(
            limits, table.duration, rest=table.rest, smooth=table.smooth
        )
    return (
        PathForm(
            table.duration,
            _HARMONICS if table.harmonics is None else table.harmonics,
            None if bases is None else tuple(bases),
            table.rest,
            smooth=table.smooth,
        ),
    )


def _limits(given: LimitsTable, robot: RobotModel) -> MotionLimits:
    try:
        limits = motion_limits(
            robot,
            position={
                name: (low, high) for name, (low, high) in given.position.items()
            },
            velocity=given.velocity,
            acceleration=given.acceleration,
            jerk=given.jerk,
            effort=given.effort,
            effort_rate=given.effort_rate,
            effort_rms=given.effort_rms,
        )
        limits = with_current_limits(limits, given)
    except ProblemError as cause:
        raise ProblemError(
            f"[excitation.limits] {cause}. Its keys: position = {{ "
            f"{robot.joint_names[0]} = [-1.0, 1.0] }}, velocity = 1.0, acceleration = "
            "5.0, jerk, effort, effort_rate, effort_rms, one for all joints or by "
            "name; in the shell --velocity, --acceleration"
        ) from None
    return limits.within(given.share)


def _pose(given: dict[str, float], limits: MotionLimits) -> dict[str, float]:
    """Return the pose of all joints: those that are not given in their middle."""
    for joint, value in given.items():
        if joint not in limits.joints:
            near = did_you_mean(joint, limits.joints)
            raise ProblemError(f"{_TABLE} start_pose: no joint {joint!r}; {near}")
        j = limits.joints.index(joint)
        if not limits.lower[j] <= value <= limits.upper[j]:
            raise ProblemError(
                f"{_TABLE} start_pose: {joint} = {value:g}, expected between "
                f"{limits.lower[j]:.6g} and {limits.upper[j]:.6g}, its range (times "
                "the share that is used)"
            )
    return dict(zip(limits.joints, limits.middle.tolist(), strict=True)) | given


def _require_whole_period(form: PathForm, periods: int) -> None:
    """Refuse to repeat a path whose duration is not a whole period."""
    still = np.zeros((len(form.frequencies), 1))
    path = FourierTrajectory(
        ("any",), form.frequencies, np.zeros(1), still, still, form.duration
    )
    if path.period is None or not np.isclose(path.period, form.duration):
        raise ProblemError(
            f"{_TABLE} periods = {periods}: the path repeats after {path.period} s, "
            f"not after its duration of {form.duration:g} s; play it once, or leave "
            "out base_frequencies"
        )


def _require_clear(scene: Scene, pose: dict[str, float]) -> None:
    if not scene.pairs:
        return
    found = nearest(scene, [[pose[name] for name in scene.robot.joint_names]])
    k = int(found.slack[0].argmin())
    if found.slack[0, k] < 0.0:
        first, second = scene.names(scene.pairs[k])
        raise ProblemError(
            f"{_TABLE} start_pose: bodies {first!r} and {second!r} are "
            f"{found.distance[0, k] * 1e3:.1f} mm apart (negative: penetration), at "
            f"least {scene.pairs[k].wanted * 1e3:.1f} mm are required; give another "
            f"pose"
        )


def with_current_limits(limits: MotionLimits, given: LimitsTable) -> MotionLimits:
    """Return limits with efforts within current limits: ``torque_constant * current``.

    Raises
    ------
    ProblemError
        If one of `current` and `torque_constant` is missing, or a name is no joint's.
    """
    if given.current is None and given.torque_constant is None:
        return limits
    if given.current is None or given.torque_constant is None:
        missing = "current" if given.current is None else "torque_constant"
        raise ProblemError(
            f"{_WHERE} {missing} is missing: a current [A] limits torque with the "
            "torque constant of the joint, gears included [N m/A]; give both"
        )
    current = _by_joint(given.current, limits.joints, "current")
    constant = _by_joint(given.torque_constant, limits.joints, "torque_constant")
    known = np.isfinite(current) & np.isfinite(constant)
    torque = np.where(known, current * constant, np.inf)
    return replace(limits, effort=np.minimum(limits.effort, torque))


def _by_joint(given: PerJoint, joints: tuple[str, ...], key: str) -> Vector:
    """Return a number for each joint, infinite where none is given."""
    if isinstance(given, Mapping):
        require_known(given, joints, f"{_WHERE} {key}: no joint")
        return np.array([given.get(name, np.inf) for name in joints])
    values = np.asarray(given, dtype=np.float64)
    if values.shape not in ((), (len(joints),)):
        raise ProblemError(
            f"{_WHERE} {key} has {len(values)} numbers, expected one or {len(joints)}"
        )
    return np.broadcast_to(values, (len(joints),))
