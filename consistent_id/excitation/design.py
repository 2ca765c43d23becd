"""Design of exciting trajectories: from a robot and its limits to a proven path.

First many searches for the least condition number, then from the best of them for the
least standard errors under a bound on it.  Every path that is returned is proven to
keep its limits at all times.
"""

import os
import time as clock

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.interrupts import noted_interrupts
from consistent_id._support.threads import single_threaded
from consistent_id.errors import ProblemError
from consistent_id.excitation.accuracy import PredictedAccuracy, predicted_accuracy
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.designed import ExcitationDesign, Stage
from consistent_id.excitation.search_problem import SearchProblem, search_problem
from consistent_id.excitation.stages import design_stages
from consistent_id.excitation.verification import demands
from consistent_id.motion.collisions.scene import Scene
from consistent_id.motion.limits import MotionLimits, motion_limits
from consistent_id.regression.base import base_parameters
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import RobotModel

_COMPARED = 8  # random paths at most that the design is compared with
_LEAST = 0.01  # rad or m; a joint that can move less is not excited


@single_threaded
def design_trajectory(
    model: TorqueModel | RobotModel,
    form: PathForm | None = None,
    aim: Aim | None = None,
    *,
    limits: MotionLimits | None = None,
    parameters: ArrayLike | None = None,
    scene: Scene | None = None,
    starts: int = 4,
    time_limit: float = 10.0,
    seed: int = 0,
    workers: int | None = None,
    progress: bool = False,
) -> ExcitationDesign:
    """Design an exciting trajectory within a robot's limits.

    Parameters
    ----------
    model : TorqueModel or RobotModel
        A robot alone has rigid-body columns only.
    form : PathForm, optional
        By default 10 s, five harmonics, from rest to rest.
    aim : Aim, optional
        By default the least condition number, then D-optimality.
    limits : MotionLimits, optional
        By default the robot file's.
    parameters : array_like, shape (parameters,) or (members, parameters), optional
        With which torque is predicted; the worst of them keeps its limits.  By default
        the nominal robot without friction.
    scene : Scene, optional
        Bodies that must stay apart; without it collisions are not checked.
    starts : int
        Searches from random paths.
    time_limit : float, [s]
        For the searches; a proof that fails adds to it.
    seed : int
        Same seed, same design, unless time ran out (a note says so).
    workers : int, optional
        Processes; by default one for each processor, at most one for each start.
    progress : bool
        Show a bar; an interrupt ends the search and keeps the best.

    Raises
    ------
    ProblemError
        If limits contradict each other, or the path is too short for them.
    NotExcitedError
        If no motion within the limits identifies all base parameters.
    InfeasibleError
        If no path was found that keeps the limits; it names the one in the way.
    """
    began = clock.monotonic()
    model = TorqueModel(model) if isinstance(model, RobotModel) else model
    form, aim = form or PathForm(), aim or Aim()
    limits = motion_limits(model.robot) if limits is None else limits
    workers = _require_sensible(starts, time_limit, seed, workers)
    required = demands(model, limits, parameters, scene)
    _require_long_enough(form, aim, required.limits)
    base = base_parameters(model)
    guards = required.guards
    problem = search_problem(model, base, form, aim, required.limits, guards, seed=seed)
    with noted_interrupts() as interrupted:
        stages = design_stages(
            problem,
            required,
            aim,
            starts=starts,
            workers=workers,
            time_limit=time_limit,
            interrupted=interrupted,
            progress=progress,
        )
        unoptimised = _unoptimised(problem, aim, starts)
    return ExcitationDesign(
        model=model,
        base=base,
        demands=required,
        form=form,
        aim=aim,
        stages=stages,
        unoptimised=unoptimised,
        seed=seed,
        seconds=clock.monotonic() - began,
        notes=required.notes + _notes(aim, stages, interrupted()),
        interrupted=interrupted(),
    )


def _notes(aim: Aim, stages: tuple[Stage, ...], interrupted: bool) -> tuple[str, ...]:
    """Return what a user should know of how the design was found."""
    notes: tuple[str, ...] = ()
    if aim.refine not in (None, aim.objective) and len(stages) == 1:
        notes += (f"no path better by {aim.refine} was found within the limits",)
    if aim.scaling == "unit columns" and aim.refine is None:
        notes += (
            "with unit columns a condition number alone may leave a joint almost "
            "still; refine with D, A or E",
        )
    if interrupted:
        notes += ("interrupted: the user ended the search; this is the best so far",)
    elif any(stage.cut_short for stage in stages):
        notes += ("time ended the search; another run may differ",)
    return notes


def _require_sensible(
    starts: int, time_limit: float, seed: int, workers: int | None
) -> int:
    """Return the number of processes; refuse what makes no sense before any work."""
    for name, value, least in (
        ("starts", starts, 1),
        ("seed", seed, 0),
        ("workers", 1 if workers is None else workers, 1),
    ):
        if not isinstance(value, int | np.integer) or value < least:
            raise ProblemError(f"{name} is {value!r}, expected {least} or more, whole")
    if not 0.0 < time_limit < np.inf:
        raise ProblemError(f"time_limit is {time_limit} s, expected more than 0")
    return min(workers or _processors(), starts)


def _require_long_enough(form: PathForm, aim: Aim, limits: MotionLimits) -> None:
    highest = form.frequencies[-1]
    if highest > 0.5 * aim.rate:
        raise ProblemError(
            f"a path of {form.duration:g} s with frequencies up to {highest:.4g} Hz "
            f"cannot be seen at {aim.rate:g} Hz; make it longer, or take fewer "
            "harmonics"
        )
    # From rest to rest at full speed, or accelerating for half of the time.
    reach = np.minimum(
        limits.velocity * form.duration / 2.0,
        limits.acceleration * form.duration**2 / 8.0,
    )
    j = int(np.argmin(reach))
    if reach[j] < _LEAST:
        raise ProblemError(
            f"in {form.duration:g} s joint {limits.joints[j]!r} can move "
            f"{reach[j]:.2g} rad (or m) within velocity {limits.velocity[j]:g} and "
            f"acceleration {limits.acceleration[j]:g}; make the path longer, or raise "
            "these limits"
        )


def _unoptimised(problem: SearchProblem, aim: Aim, starts: int) -> PredictedAccuracy:
    """Return the accuracy of the best conditioned of the random paths."""
    model, base = problem.information.model, problem.information.base
    paths = [
        problem.basis.trajectory(problem.random(number))
        for number in range(min(starts, _COMPARED))
    ]
    found = [predicted_accuracy(model, base, path, aim) for path in paths]
    return min(found, key=lambda accuracy: accuracy.condition.value)


def _processors() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
