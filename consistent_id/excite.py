"""The command ``excite``: from a problem to a motion that is ready to play."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

from consistent_id._files import require_writable, write_atomically
from consistent_id.errors import ProblemError
from consistent_id.estimators.least_squares import joint_noise
from consistent_id.excitation.aims import Aim
from consistent_id.excitation.asked import Asked, asked_of
from consistent_id.excitation.design import ExcitationDesign, design_trajectory
from consistent_id.excitation.figure import design_figure
from consistent_id.excitation.record import design_record
from consistent_id.excitation.validating import ValidationPath, validation_trajectory
from consistent_id.figures import save_figure
from consistent_id.motion.move import Move
from consistent_id.motion.move_along import move_along
from consistent_id.problem import Problem
from consistent_id.regression import build_regression
from consistent_id.trajectory import FourierTrajectory
from consistent_id.trajectory_files import write_trajectory


@dataclass(frozen=True, slots=True, eq=False)
class Excited:
    """A design, the motion to play, and one to judge by.

    Parameters
    ----------
    design : ExcitationDesign
    move : Move
        The design with its run-in and run-out, proven to keep all limits.
    validation : ValidationPath
    validation_move : Move
    """

    design: ExcitationDesign
    move: Move
    validation: ValidationPath
    validation_move: Move


def excite(
    problem: Problem,
    *,
    starts: int = 4,
    time_limit: float = 10.0,
    seed: int = 0,
    workers: int | None = None,
    sequential: bool = False,
    progress: bool = False,
) -> Excited:
    """Design the motion that a problem's ``[excitation]`` table asks for.

    Parameters
    ----------
    problem : Problem
    starts, time_limit, seed, workers, progress
        See `design_trajectory`.
    sequential : bool
        Count what the problem's training recordings tell already; where the table gives
        no noise, theirs is taken.

    Raises
    ------
    ProblemError
        If run-in or run-out cannot keep the limits; and as `design_trajectory`.
    """
    asked = asked_of(problem.table.excitation, problem.model.robot)
    aim = _with_recordings(problem, asked.aim) if sequential else asked.aim
    design = design_trajectory(
        problem.model,
        asked.form,
        aim,
        limits=asked.limits,
        starts=starts,
        time_limit=time_limit,
        seed=seed,
        workers=workers,
        progress=progress,
    )
    validation = validation_trajectory(design, seed=seed)
    return Excited(
        design,
        _played(design, design.trajectory, asked),
        validation,
        _played(design, validation.trajectory, asked),
    )


def write_excited(excited: Excited, folder: Path) -> list[Path]:
    """Write motions, figure and record into a folder; return the files."""
    require_writable(folder)
    design, rate = excited.design, excited.design.aim.rate
    written = []
    for name, move in (
        ("trajectory", excited.move),
        ("validation", excited.validation_move),
    ):
        written.append(write_trajectory(move, folder / f"{name}.json"))
        written.append(write_trajectory(move, folder / f"{name}.csv", rate=rate))
        written.append(write_trajectory(move, folder / f"{name}.yaml", rate=rate))
    figure = design_figure(design)
    written.append(save_figure(figure, folder / "excitation.png"))
    record = design_record(design, excited.validation)
    text = json.dumps(record, indent=1, allow_nan=False)
    written.append(write_atomically(folder / "excitation.json", text + "\n"))
    return written


def _played(design: ExcitationDesign, path: FourierTrajectory, asked: Asked) -> Move:
    pose = asked.start_pose
    if pose is not None:
        middle = dict(
            zip(design.limits.joints, design.limits.middle.tolist(), strict=True)
        )
        pose = middle | pose
    move = move_along(
        path, design.limits, from_pose=pose, to_pose=pose, periods=asked.periods
    )
    if move.run_in or move.run_out:
        design.demands.proof([*move.run_in, *move.run_out]).require()
    return move


def _with_recordings(problem: Problem, aim: Aim) -> Aim:
    if problem.table.data is None:
        raise ProblemError(
            f"problem {problem.name!r} has no recordings to go on from; leave out "
            "sequential, or add a [data] table"
        )
    regression = build_regression(problem.model, problem.training)
    noise = aim.noise
    if noise is None:
        noise = joint_noise(problem.model, regression)
    return replace(aim, noise=noise, earlier=regression)
