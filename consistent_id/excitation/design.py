"""Design of exciting trajectories: from a robot and its limits to a proven path.

Many searches minimise standard errors; or they minimise the condition number, and then,
from the best results, standard errors under a bound on it. Every path that is returned
is proven to keep its limits at all times, and none is worse than the best of the random
paths.
"""

import logging
import time as clock
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.executors import Executor, cores, single_threaded
from consistent_id._support.run import noted_interrupts
from consistent_id.errors import NotExcitedError, ProblemError
from consistent_id.excitation.accuracy import (
    PredictedAccuracy,
    RelativeAccuracy,
    predicted_accuracy,
    relative_accuracy,
    with_default_noise,
)
from consistent_id.excitation.aims import Aim, PathForm, base_for, forms_to_try
from consistent_id.excitation.clear_poses import clear_poses
from consistent_id.excitation.designed import ExcitationDesign, Stage
from consistent_id.excitation.search_problem import (
    SearchProblem,
    require_playable_form,
    search_problem,
)
from consistent_id.excitation.searches import Lanes
from consistent_id.excitation.stages import COMPARED, DesignSearch, compared_paths
from consistent_id.excitation.verification import (
    FRICTION_SHARE,
    Demands,
    FileParts,
    demands,
)
from consistent_id.excitation.work import Meter
from consistent_id.motion.collisions.scene import Scene
from consistent_id.motion.limits import MotionLimits, motion_limits
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_structure import RowModel
from consistent_id.regression.rows.sensor_rows import SensorRows
from consistent_id.robot.model import RobotModel

_log = logging.getLogger(__name__)

_DRAWN = 0.2  # most of the time limit for each random path, and for all together
_ALL_DRAWN = 0.5
_STEPS = 12  # of a search, below which the time limit is short
_ENOUGH = 60  # steps for which the warning proposes a time limit


@single_threaded
def design_trajectory(
    model: TorqueModel | RobotModel,
    form: PathForm | Sequence[PathForm] | None = None,
    aim: Aim | None = None,
    *,
    limits: MotionLimits | None = None,
    parameters: ArrayLike | None = None,
    scene: Scene | None = None,
    sensor: SensorRows | None = None,
    friction_share: float = FRICTION_SHARE,
    stated: FileParts = FileParts(),  # noqa: B008  a constant
    starts: int = 4,
    time_limit: float = 10.0,
    seed: int = 0,
    workers: int | None = None,
    executor: str | Executor | None = None,
    progress: bool = False,
) -> ExcitationDesign:
    """Design an exciting trajectory within a robot's limits.

    Parameters
    ----------
    model : TorqueModel or RobotModel
        A robot alone has rigid-body columns only.
    form : PathForm or sequence of PathForm, optional
        If several are given, each is tried for a tenth of the work, and the most
        promising one is used.  By default 10 s from rest to rest, and `forms_to_try`.
    aim : Aim, optional
        By default D-optimality, the least geometric mean of the standard errors.
    limits : MotionLimits, optional
        By default the robot file's.
    parameters : array_like, shape (parameters,) or (members, parameters), optional
        Parameters to predict torque with; the worst of them keeps the limits. By
        default the nominal robot, with a share of the limits left for its friction.
    scene : Scene, optional
        Bodies that must stay apart; without it collisions are not checked.
    sensor : SensorRows, optional
        A wrench sensor on the robot.  The motion is then for its tool and bias instead
        of the robot's own parameters, and the model is only used to predict torque.
        Noise, interest, earlier recordings and the task are those of the sensor.
    friction_share : float
        Share of the effort limits that is left for friction, if `parameters` do not
        include friction.
    stated : FileParts
        Friction and rotors that the robot's file states, and links behind the tip.
        Without `parameters`, rotors count, and friction for which the share is too
        small.
    starts : int
        Searches from random paths.
    time_limit : float, [s]
        Limit of random paths and searches, in work: seconds of an idle reference
        processor, for each of the workers.  A busy machine takes longer and finds the
        same design.  A failed proof adds a twentieth to it.  Clear poses, base
        parameters and proofs are not counted.
    seed : int
        Same seed, limit and number of workers: same design on one machine.
    workers : int, optional
        Shares of the starts, searched side by side; by default one for each processor
        of this computer, at most one for each start.
    executor : str or Executor, optional
        Where the workers run, see `stream_regression`; the design does not depend on
        it. By default as stated by ``--executor``, else each is a process of this
        computer.
    progress : bool
        Show a bar; an interrupt ends the search and keeps the best.

    Raises
    ------
    ProblemError
        If limits contradict each other, or the path is too short for them.
    NotExcitedError
        If no motion within the limits identifies all base parameters.
    InfeasibleError
        If no path was found that keeps the limits; the message names the violated
        limit.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> limits = ci.motion_limits(arm, position={"joint1": (-1, 1)}, velocity=2.0)
    >>> form = ci.PathForm(5.0, 2)
    >>> design = ci.design_trajectory(arm, form, limits=limits, starts=1, workers=1)
    >>> design.proof.holds, design.trajectory.duration
    (True, 5.0)
    """
    began = clock.monotonic()
    model = model if isinstance(model, TorqueModel) else TorqueModel(model)
    measured = _measured(model, sensor)
    limits = motion_limits(model.robot) if limits is None else limits
    shares = _require_sensible(starts, time_limit, seed, workers)
    where = Executor.chosen(executor)
    required = demands(model, limits, parameters, scene, friction_share, stated)
    aim = with_default_noise(aim or Aim(), measured, limits)
    forms = _forms(form, aim, required.limits)
    problems = _problems(measured, required, forms, aim, seed)
    problems = [replace(one, drawing=_drawing(starts, time_limit)) for one in problems]
    _warn_if_short(problems, time_limit, starts)
    with noted_interrupts(keeps_results=True) as interrupted:
        lanes = Lanes(shares, interrupted, where, progress)
        search = DesignSearch(required, aim, lanes, starts, Meter(time_limit))
        problem, stages = search.run(problems)
        unoptimised = _unoptimised(problem, aim, starts)
    return ExcitationDesign(
        model=model,
        base=problem.information.base,
        demands=required,
        form=forms[problems.index(problem)],
        aim=aim,
        stages=stages,
        unoptimised=unoptimised,
        seed=seed,
        seconds=clock.monotonic() - began,
        notes=required.notes + _notes(aim, stages, interrupted()),
        interrupted=interrupted(),
        relative=_useful(measured, stages[-1].accuracy, parameters, aim),
        tried=forms,
        sensor=sensor,
    )


def _problems(
    measured: RowModel,
    required: Demands,
    forms: Sequence[PathForm],
    aim: Aim,
    seed: int,
) -> list[SearchProblem]:
    """Return the search of each form, with the same clear poses."""
    poses = clear_poses(required, seed)
    base = base_for(measured, aim.interest, known=aim.others == "known")
    plain = [search_problem(measured, base, one, aim, required.limits) for one in forms]
    guards = required.guards
    return [replace(one.guarded(guards), seed=seed, poses=poses) for one in plain]


def _drawing(starts: int, time_limit: float) -> float:
    """Return the most work for each random path."""
    return min(_DRAWN, _ALL_DRAWN / min(starts, COMPARED)) * time_limit


def _measured(model: TorqueModel, sensor: SensorRows | None) -> RowModel:
    """Return the model whose rows a recording of the motion will have."""
    if sensor is None:
        return model
    if sensor.arm.joint_names != model.robot.joint_names:
        raise ProblemError(
            f"the sensor's arm has joints {', '.join(sensor.arm.joint_names)}, the "
            f"model's {', '.join(model.robot.joint_names)}; expected the same, in order"
        )
    return sensor


def _forms(
    form: PathForm | Sequence[PathForm] | None, aim: Aim, limits: MotionLimits
) -> tuple[PathForm, ...]:
    """Return the forms to try, each once; refuse those that are too short."""
    if form is None:
        forms = forms_to_try(limits)
    else:
        forms = (form,) if isinstance(form, PathForm) else tuple(form)
    if not forms:
        raise ProblemError("form is an empty sequence, expected one form or more")
    for one in forms:
        require_playable_form(one, aim, limits)
    return tuple(dict.fromkeys(forms))


def _useful(
    model: RowModel,
    accuracy: PredictedAccuracy,
    parameters: ArrayLike | None,
    aim: Aim,
) -> RelativeAccuracy | None:
    """Return predicted errors beside the parameters."""
    if aim.others == "known":  # a load's parameters are not those of the link
        return None
    reference = None
    if parameters is not None and isinstance(model, TorqueModel):
        reference = np.atleast_2d(np.asarray(parameters, dtype=float)).mean(axis=0)
    relative = relative_accuracy(model, accuracy, reference)
    if relative is not None and relative.useless and not aim.assumed_noise:
        raise NotExcitedError(
            f"the best motion found is useless: the standard errors of "
            f"{relative.unknown} of the {len(relative.matter)} base parameters that "
            "make up 1 % of the torque are above the parameters themselves. Move "
            "longer or within wider limits, or check the noise that is stated"
        )
    return relative


def _notes(aim: Aim, stages: tuple[Stage, ...], interrupted: bool) -> tuple[str, ...]:
    """Return notes on the search for the design."""
    notes: tuple[str, ...] = ()
    for stage in stages:
        if not stage.improved:
            notes += (
                f"{stage.objective}: no improvement in {stage.iterations} iterations; "
                "the path is the start of the search",
            )
    if aim.scaling == "unit columns" and aim.objectives == ("condition",):
        notes += (
            "with unit columns, the condition number alone may leave a joint almost "
            "at rest; refine with D, A or E",
        )
    if interrupted:
        notes += ("interrupted: the user ended the search; this is the best so far",)
    elif any(stage.cut_short for stage in stages):
        notes += (
            "the time limit ended the search (it does not count meshes and proofs); a "
            "longer search may find a better motion",
        )
    return notes


def _require_sensible(
    starts: int, time_limit: float, seed: int, workers: int | None
) -> int:
    """Return the number of lanes; refuse invalid arguments before any work."""
    for name, value, least in (
        ("starts", starts, 1),
        ("seed", seed, 0),
        ("workers", 1 if workers is None else workers, 1),
    ):
        if not isinstance(value, int | np.integer) or value < least:
            raise ProblemError(f"{name} is {value!r}, expected {least} or more, whole")
    if not 0.0 < time_limit < np.inf:
        raise ProblemError(f"time_limit is {time_limit} s, expected more than 0")
    return min(workers or cores(), starts)


def _unoptimised(problem: SearchProblem, aim: Aim, starts: int) -> PredictedAccuracy:
    """Return the accuracy of the best of the random paths by the aim's objective.

    Only paths that keep all limits are used, if there are any.
    """
    model, base = problem.information.model, problem.information.base
    known = compared_paths(replace(problem, objective=aim.objective), starts)[0]
    variables = known.variables
    if variables is None:
        variables = problem.random(known.number)
    return predicted_accuracy(model, base, problem.basis.trajectory(variables), aim)


def _warn_if_short(
    problems: Sequence[SearchProblem], time_limit: float, starts: int
) -> None:
    """Warn before a search whose time limit is enough for few steps only.

    Random paths are searched for first, and take their share of the limit.
    """
    problem = min(problems, key=lambda one: one.costs.step)
    step, count = problem.costs.step, min(starts, COMPARED)
    drawn = count * problem.costs.draw
    share = count * _drawing(starts, 1.0)
    first = min(drawn, share * time_limit)
    if time_limit - first >= _STEPS * step:
        return
    joints, pairs = len(problem.basis.unit), sum(one.pairs for one in problem.guards)
    of = f"{joints} joints" + (f" and {pairs} pairs of bodies" if pairs else "")
    paths = f", and its random paths {first:.2g} s" if first > 0.0 else ""
    enough = min(_ENOUGH * step + drawn, _ENOUGH * step / (1.0 - share))
    _log.warning(
        "with %s, a step of the search takes some %.2g s%s: %g s are enough for few "
        "steps, and preparing and proving the motion take as long as dozens. "
        "--time-limit %.0f finds a better motion; --tip, --lock or --no-collisions "
        "make steps shorter",
        of,
        step,
        paths,
        time_limit,
        enough,
    )
