"""The command ``excite``: from a problem to a motion that is ready to play."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from consistent_id._files import require_writable, write_atomically
from consistent_id.collisions.clearance import ClearanceReport, prove_clearance
from consistent_id.errors import InfeasibleError, ProblemError
from consistent_id.estimators.least_squares import joint_noise
from consistent_id.excitation.aims import Aim
from consistent_id.excitation.asked import Asked, asked_of
from consistent_id.excitation.asked_tables import asked_tables
from consistent_id.excitation.design import ExcitationDesign, design_trajectory
from consistent_id.excitation.figure import design_figure
from consistent_id.excitation.record import design_record, design_tables
from consistent_id.excitation.replay import write_replay
from consistent_id.excitation.validating import ValidationPath, validation_trajectory
from consistent_id.excitation.verification import demands
from consistent_id.figures import save_figure
from consistent_id.motion.move import Move
from consistent_id.motion.move_along import move_along
from consistent_id.parameters import did_you_mean
from consistent_id.problem import Problem
from consistent_id.regression import build_regression
from consistent_id.tables import Table
from consistent_id.trajectory import FourierTrajectory
from consistent_id.trajectory_files import write_trajectory
from consistent_id.trajectory_files.files import FORMAT_OF_ENDING
from consistent_id.trajectory_files.urscript import UR_RATES

FORMATS = ("csv", "yaml")
"""Endings of the files of samples that are written unless asked otherwise."""

REPLAY = "replay.html"


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
    clearances : tuple of ClearanceReport
        Of both moves, with run-in and run-out; none without a scene.
    """

    design: ExcitationDesign
    move: Move
    validation: ValidationPath
    validation_move: Move
    clearances: tuple[ClearanceReport, ...]


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
    ProblemError, InfeasibleError
        If run-in or run-out cannot keep the limits, or bodies do not stay apart on it;
        and as `design_trajectory`.
    """
    asked = asked_of(problem)
    aim = _with_recordings(problem, asked.aim) if sequential else asked.aim
    design = design_trajectory(
        problem.model,
        asked.form,
        aim,
        limits=asked.limits,
        scene=asked.scene,
        starts=starts,
        time_limit=time_limit,
        seed=seed,
        workers=workers,
        progress=progress,
    )
    validation = validation_trajectory(design, seed=seed)
    moves = [
        _played(design, path, asked)
        for path in (design.trajectory, validation.trajectory)
    ]
    scene = asked.scene
    apart = () if scene is None else (prove_clearance(scene, m.pieces) for m in moves)
    return Excited(design, moves[0], validation, moves[1], tuple(apart))


def write_excited(
    excited: Excited, folder: Path, formats: Sequence[str] = FORMATS
) -> list[Path]:
    """Write motions, figure and record into a folder; return the files.

    Parameters
    ----------
    excited : Excited
    folder : Path
    formats : sequence of str
        Endings of files of samples, such as ``csv``, ``yaml`` or ``script``, that
        `write_trajectory` knows; the exact motion is always written, as ``json``.
    """
    require_writable(folder)
    written = []
    for name, move in (
        ("trajectory", excited.move),
        ("validation", excited.validation_move),
    ):
        for ending in dict.fromkeys(("json", *formats)):
            file = folder / f"{name}.{ending}"
            rate = _rate_of(ending, excited.design.aim.rate)
            written.append(write_trajectory(move, file, rate=rate))
    figure = design_figure(excited.design)
    written.append(save_figure(figure, folder / "excitation.png"))
    record = excited_record(excited)
    text = json.dumps(record, indent=1, allow_nan=False)
    written.append(write_atomically(folder / "excitation.json", text + "\n"))
    return written


def checked_formats(text: str) -> tuple[str, ...]:
    """Return endings that are listed with commas.

    Raises
    ------
    ProblemError
        If one is not known; so that it is found before a search, not after.

    Examples
    --------
    >>> checked_formats("csv, script")
    ('csv', 'script')
    """
    endings = tuple(word.strip().lstrip(".") for word in text.split(","))
    for ending in endings:
        if f".{ending}" not in FORMAT_OF_ENDING:
            near = did_you_mean(ending, [e.lstrip(".") for e in FORMAT_OF_ENDING])
            raise ProblemError(f"format {ending!r} of a trajectory; {near}")
    return endings


def replay_excited(problem: Problem, excited: Excited, folder: Path) -> Path:
    """Write a page that replays the move to learn from; return the file."""
    model, scene = problem.table.model, problem.table.excitation.scene
    return write_replay(
        excited.move,
        problem.model.robot,
        folder / REPLAY,
        urdf=None if model.urdf is None else problem.file(model.urdf),
        package_dirs=[problem.file(name) for name in scene.packages] if scene else [],
        locked=model.locked,
        scene=excited.design.demands.scene,
    )


def planned_tables(problem: Problem) -> list[Table]:
    """Return what `excite` would design, for people; nothing is searched for."""
    asked = asked_of(problem)
    required = demands(problem.model, asked.limits, scene=asked.scene)
    return asked_tables(problem.model, asked, required)


def _rate_of(ending: str, rate: float) -> float:
    """Return the rate of a file's samples: a UR's controller has its own."""
    if ending not in ("script", "urscript") or rate in UR_RATES:
        return rate
    return UR_RATES[0]


def excited_record(excited: Excited) -> dict[str, Any]:
    """Return all there is to know of a design and its moves, as plain values."""
    design = excited.design
    return design_record(design, excited.validation, excited.clearances)


def excited_tables(excited: Excited) -> list[Table]:
    """Return the same for people."""
    return design_tables(excited.design, excited.clearances)


def _played(design: ExcitationDesign, path: FourierTrajectory, asked: Asked) -> Move:
    pose = asked.start_pose
    move = move_along(
        path, design.limits, from_pose=pose, to_pose=pose, periods=asked.periods
    )
    for name, pieces in (("run-in", move.run_in), ("run-out", move.run_out)):
        if not pieces:
            continue
        try:
            design.demands.proof(pieces).require()
        except InfeasibleError as cause:
            raise InfeasibleError(
                f"{name}: {cause}. {_advice(design, path, asked)}"
            ) from None
    return move


def _advice(design: ExcitationDesign, path: FourierTrajectory, asked: Asked) -> str:
    """Say what start pose to try when run-in or run-out is in the way."""
    other = "Give another start_pose in [excitation]"
    if asked.start_pose is None:
        return other
    move = move_along(path, design.limits, periods=asked.periods)
    pieces = [*move.run_in, *move.run_out]
    if pieces and not design.demands.proof(pieces).holds:
        return other
    pose, joints = move.evaluate([move.start], 0)[0, 0], move.joints
    told = ", ".join(f"{j} = {q:.3f}" for j, q in zip(joints, pose, strict=True))
    return f"{other}, or none: from {told} this path can be reached as it is"


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
