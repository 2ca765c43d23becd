"""What a problem file asks of an exciting trajectory, as values of a design."""

from dataclasses import dataclass

from consistent_id.errors import ProblemError
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.asked_scene import asked_scene
from consistent_id.motion.collisions.scene import Scene
from consistent_id.motion.collisions.separation import nearest
from consistent_id.motion.limits import MotionLimits, motion_limits
from consistent_id.problems.excitation_tables import LimitsTable
from consistent_id.problems.problem import Problem
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import did_you_mean


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """Form, aim, limits and surroundings of a path, and how it is to be played.

    Parameters
    ----------
    form : PathForm
    aim : Aim
    limits : MotionLimits
    scene : Scene, optional
    start_pose : dict from joint to position, optional
        Where the robot rests before and after, all joints of it.
    periods : int, optional
        How often a periodic path is repeated; None for one that rests at its ends.
    """

    form: PathForm
    aim: Aim
    limits: MotionLimits
    scene: Scene | None
    start_pose: dict[str, float] | None
    periods: int | None


def asked_of(problem: Problem) -> Asked:
    """Return what the ``[excitation]`` table of a problem asks for.

    Raises
    ------
    ProblemError
        If a joint is unknown, its limits leave no motion, the scene contradicts itself,
        a path that rests is to be repeated, or bodies are too near to one another in
        the start pose.
    """
    table = problem.table.excitation
    if table.rest and table.periods != 1:
        raise ProblemError(
            f"[excitation] periods is {table.periods}, but a path that rests at its "
            "ends is not repeated; give rest = false, or leave periods out and play it "
            "as often as you like"
        )
    limits = _limits(table.limits, problem.model.robot)
    bases = table.base_frequencies
    form = PathForm(
        table.duration,
        table.harmonics,
        None if bases is None else tuple(bases),
        table.rest,
    )
    aim = Aim(
        objective=table.objective,
        refine=None if table.refine == "none" else table.refine,
        growth=table.growth,
        scaling=table.scaling,
        noise=table.noise,
        rate=table.rate,
    )
    pose = None
    if table.start_pose:
        middle = dict(zip(limits.joints, limits.middle.tolist(), strict=True))
        pose = middle | table.start_pose
    scene = asked_scene(problem)
    if scene is not None and pose is not None:
        _require_clear(scene, pose)
    return Asked(form, aim, limits, scene, pose, None if table.rest else table.periods)


def _limits(given: LimitsTable, robot: RobotModel) -> MotionLimits:
    limits = motion_limits(
        robot,
        position={name: (low, high) for name, (low, high) in given.position.items()},
        velocity=given.velocity,
        acceleration=given.acceleration,
        jerk=given.jerk,
        effort=given.effort,
    )
    return limits.within(given.share)


def _require_clear(scene: Scene, pose: dict[str, float]) -> None:
    for name in pose:
        if name not in scene.robot.joint_names:
            near = did_you_mean(name, scene.robot.joint_names)
            raise ProblemError(f"[excitation] start_pose: no joint {name!r}; {near}")
    q = [[pose[name] for name in scene.robot.joint_names]]
    if not scene.pairs:
        return
    found = nearest(scene, q)
    k = int(found.slack[0].argmin())
    if found.slack[0, k] < 0.0:
        first, second = scene.names(scene.pairs[k])
        raise ProblemError(
            f"[excitation] start_pose: bodies {first!r} and {second!r} are "
            f"{found.distance[0, k] * 1e3:.1f} mm apart (negative: in one another), at "
            f"least {scene.pairs[k].wanted * 1e3:.1f} mm are wanted; give another pose"
        )
