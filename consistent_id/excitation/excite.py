"""The command ``excite``: from a problem to a motion that is ready to play."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.files import require_writable, write_atomically
from consistent_id._support.tables import Table
from consistent_id.errors import InfeasibleError, ProblemError
from consistent_id.excitation.aims import Aim
from consistent_id.excitation.asked import Asked, asked_of
from consistent_id.excitation.asked_tables import asked_tables
from consistent_id.excitation.design import design_trajectory
from consistent_id.excitation.designed import ExcitationDesign
from consistent_id.excitation.figure import design_figure
from consistent_id.excitation.record import design_record, design_tables
from consistent_id.excitation.replay import write_replay
from consistent_id.excitation.validating import ValidationPath, validation_trajectory
from consistent_id.excitation.verification import Proof, demands
from consistent_id.motion.collisions.clearance import ClearanceReport
from consistent_id.motion.files import write_trajectory
from consistent_id.motion.files.files import FORMAT_OF_ENDING
from consistent_id.motion.files.urscript import UR_RATES
from consistent_id.motion.move import Move
from consistent_id.motion.move_along import move_along
from consistent_id.problems.problem import Problem
from consistent_id.recordings.trajectory import FourierTrajectory
from consistent_id.regression.noise import joint_noise
from consistent_id.regression.regression import build_regression
from consistent_id.report.figures import save_figure
from consistent_id.robot.parameters import did_you_mean

FORMATS = ("csv", "yaml")
"""Endings of the files of samples that are written unless asked otherwise."""

REPLAY = "replay.html"


@dataclass(frozen=True, slots=True, eq=False)
class Played:
    """A path as it is played: from rest, through it, to rest.

    Parameters
    ----------
    move : Move
    proof : Proof
        Of every piece, from the first moment to the last.
    """

    move: Move
    proof: Proof


@dataclass(frozen=True, slots=True, eq=False)
class Excited:
    """A design, the motion to play, and one to judge by.

    Parameters
    ----------
    design : ExcitationDesign
    played : Played, optional
        None if the design cannot be reached within the limits; `refusals` say why.
    validation : ValidationPath, optional
    validation_played : Played, optional
    refusals : tuple of str
    """

    design: ExcitationDesign
    played: Played | None
    validation: ValidationPath | None
    validation_played: Played | None
    refusals: tuple[str, ...]

    @property
    def clearances(self) -> tuple[ClearanceReport, ...]:
        """How far apart bodies stay along both moves; none without a scene."""
        proofs = [p.proof for p in (self.played, self.validation_played) if p]
        return tuple(p.clearance for p in proofs if p.clearance is not None)


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
        As `design_trajectory`.  What fails after the search, such as a run-in that
        cannot keep the limits, costs no design: it is among the refusals.
    """
    asked = asked_of(problem)
    _require_pose(asked)
    periods = _periods(asked)
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
    refusals: list[str] = []
    played = validation = validation_played = None
    try:
        played = _played(design, design.trajectory, asked, periods)
    except (InfeasibleError, ProblemError) as cause:
        refusals.append(f"the trajectory cannot be played: {cause}")
    try:
        validation = validation_trajectory(design, seed=seed)
        validation_played = _played(design, validation.trajectory, asked, None)
    except (InfeasibleError, ProblemError) as cause:
        refusals.append(f"there is no motion to judge by: {cause}")
    return Excited(design, played, validation, validation_played, tuple(refusals))


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
    for name, played in (
        ("trajectory", excited.played),
        ("validation", excited.validation_played),
    ):
        if played is None:
            continue
        for ending in dict.fromkeys(("json", *formats)):
            file = folder / f"{name}.{ending}"
            rate = _rate_of(ending, excited.design.aim.rate)
            written.append(write_trajectory(played.move, file, rate=rate))
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
    if excited.played is None:
        raise InfeasibleError(f"nothing to replay: {excited.refusals[0]}")
    model, scene = problem.table.model, problem.table.excitation.scene
    return write_replay(
        excited.played.move,
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
    record = design_record(excited.design, excited.validation, excited.clearances)
    moves = {"trajectory": excited.played, "validation": excited.validation_played}
    record["played"] = {
        name: {
            "duration_s": played.move.duration,
            "proven": played.proof.holds,
            "least_margin": asdict(played.proof.margins.least),
        }
        for name, played in moves.items()
        if played is not None
    }
    record["refusals"] = list(excited.refusals)
    return record


def excited_tables(excited: Excited) -> list[Table]:
    """Return the same for people."""
    tables = design_tables(excited.design, excited.clearances)
    moves = {"trajectory": excited.played, "validation": excited.validation_played}
    rows = tuple(
        (
            name,
            f"{played.move.duration:.2f} s",
            f"{100.0 * played.proof.margins.least.relative:.2f} %",
            played.proof.margins.least.joint,
            played.proof.margins.least.quantity,
        )
        for name, played in moves.items()
        if played is not None
    )
    header = ("motion", "lasts", "least margin", "joint", "limit of")
    notes = ("run-in and run-out included; proven for all times", *excited.refusals)
    return [*tables, Table("What is played", header, rows, notes)]


def _played(
    design: ExcitationDesign,
    path: FourierTrajectory,
    asked: Asked,
    periods: int | None,
) -> Played:
    """Return the move along a path, with the proof of all that is played."""
    pose = asked.start_pose
    move = move_along(
        path, design.limits, from_pose=pose, to_pose=pose, periods=periods
    )
    for name, pieces in (
        ("run-in", move.run_in),
        ("the path", (move.trajectory,)),
        ("run-out", move.run_out),
    ):
        proof = design.demands.proof(pieces) if pieces else None
        if proof is not None and not proof.holds:
            try:
                proof.require()
            except InfeasibleError as cause:
                advice = _advice(design, path, asked, periods)
                raise InfeasibleError(f"{name}: {cause}. {advice}") from None
    return Played(move, design.demands.proof(move.pieces))


def _advice(
    design: ExcitationDesign,
    path: FourierTrajectory,
    asked: Asked,
    periods: int | None,
) -> str:
    """Say what start pose to try when run-in or run-out is in the way."""
    other = "Give another start_pose in [excitation]"
    if asked.start_pose is None:
        return other
    move = move_along(path, design.limits, periods=periods)
    pieces = [*move.run_in, *move.run_out]
    if pieces and not design.demands.proof(pieces).holds:
        return other
    pose, joints = move.evaluate([move.start], 0)[0, 0], move.joints
    told = ", ".join(f"{j} = {q:.3f}" for j, q in zip(joints, pose, strict=True))
    return f"{other}, or none: from {told} this path can be reached as it is"


def _require_pose(asked: Asked) -> None:
    """Refuse a start pose that no path can come from, before any search."""
    pose, limits = asked.start_pose or {}, asked.limits
    for joint, value in pose.items():
        if joint not in limits.joints:
            near = did_you_mean(joint, limits.joints)
            raise ProblemError(f"[excitation] start_pose: no joint {joint!r}; {near}")
        j = limits.joints.index(joint)
        if not limits.lower[j] <= value <= limits.upper[j]:
            raise ProblemError(
                f"[excitation] start_pose: {joint} = {value:g}, expected between "
                f"{limits.lower[j]:.6g} and {limits.upper[j]:.6g}, its range (times "
                "the share that is used)"
            )


def _periods(asked: Asked) -> int | None:
    """Return how often to repeat a path; None to play its duration once.

    Raises
    ------
    ProblemError
        If it is to be repeated, but what is designed and proven is no whole period.
    """
    if asked.periods in (None, 1):
        return None
    form = asked.form
    still = np.zeros((len(form.frequencies), 1))
    one = FourierTrajectory(
        ("any",), form.frequencies, np.zeros(1), still, still, form.duration
    )
    if one.period is None or not np.isclose(one.period, form.duration):
        raise ProblemError(
            f"[excitation] periods = {asked.periods}: the path repeats after "
            f"{one.period} s, not after its duration of {form.duration:g} s; play it "
            "once, or leave out base_frequencies"
        )
    return asked.periods


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
