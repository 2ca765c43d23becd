"""What a problem file asks of an exciting trajectory, as values of a design."""

from dataclasses import dataclass

from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation_file import ExcitationTable
from consistent_id.model import RobotModel
from consistent_id.motion.limits import MotionLimits, motion_limits


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """Form, aim and limits of a path, and how it is to be played.

    Parameters
    ----------
    form : PathForm
    aim : Aim
    limits : MotionLimits
    start_pose : dict from joint to position, optional
        Where the robot rests before and after.
    periods : int, optional
        How often a periodic path is repeated; None for one that rests at its ends.
    """

    form: PathForm
    aim: Aim
    limits: MotionLimits
    start_pose: dict[str, float] | None
    periods: int | None


def asked_of(table: ExcitationTable, robot: RobotModel) -> Asked:
    """Return what an ``[excitation]`` table asks for.

    Raises
    ------
    ProblemError
        If a joint is unknown, or its limits leave no motion.
    """
    given = table.limits
    limits = motion_limits(
        robot,
        position={name: (low, high) for name, (low, high) in given.position.items()},
        velocity=given.velocity,
        acceleration=given.acceleration,
        jerk=given.jerk,
        effort=given.effort,
    )
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
    return Asked(
        form,
        aim,
        limits.within(given.share),
        dict(table.start_pose) or None,
        None if table.rest else table.periods,
    )
