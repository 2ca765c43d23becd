"""From a robot and its logs to a study, in one call: the shell's ``identify``."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from consistent_id.problems.drafting import draft_problem
from consistent_id.problems.floating.hints import BaseHints
from consistent_id.problems.given_logs import GivenLog
from consistent_id.problems.study import Study, run_study
from consistent_id.recordings.readers.units import Units
from consistent_id.recordings.signals import PDGains
from consistent_id.robot.chains import Selection


def identify_log(
    robot: str | Path,
    log: GivenLog | Sequence[GivenLog],
    *,
    validation: GivenLog | Sequence[GivenLog] = (),
    columns: Mapping[str, str] | None = None,
    units: Units | None = None,
    torque_joints: Sequence[str] = (),
    base: str | None = None,
    base_hints: BaseHints | None = None,
    tip: str | None = None,
    locked: Mapping[str, float] | None = None,
    torque_gain: float | Sequence[float] = (),
    masses: Literal["datasheet", "free"] | None = None,
    drive: Sequence[str] | None = None,
    cutoff: float | None = None,
    band: float | None = None,
    friction_velocity: float | None = None,
    keep: Sequence[str] = (),
    select: bool = True,
    gains: PDGains | None = None,
    bodies: Literal["identified", "model"] = "identified",
    accepted: Sequence[str] = (),
    seed: int = 0,
    progress: bool = False,
) -> Study:
    """Identify a robot from one log or several, without a problem file.

    Parameters
    ----------
    robot : str or Path
        URDF or MJCF.
    log : str, Path, table or Recording, or a list of them
        To learn from: files, or data frames, Arrow tables and mappings of arrays.
    validation : str, Path, table or Recording, or a list of them
        To judge by; by default the last 30 % of each log's motion.
    columns, units, torque_joints, gains, bodies
        See `draft_problem`.
    masses, drive, cutoff, band, friction_velocity, keep, select
        What of the model is given and not chosen; see `draft_problem`.
    base, tip : str, optional
        Links between which the robot moves.
    base_hints : BaseHints, optional
        Columns of a base that floats, as far as they are known.
    locked : mapping of str to float, optional
        Joints that stand still, and where [rad or m].
    torque_gain : float or sequence of float
        From the torque columns to torque: one for all joints, or one each.
    accepted, seed, progress
        See `run_study`.

    Returns
    -------
    Study
        `Study.delivered` is the estimate to take away, `Study.verdict` says whether to
        use it.

    Raises
    ------
    ModelError, RecordingError, ProblemError
        As `draft_problem`.
    NotExcitedError, InfeasibleError, SolverError
        As `run_study`.
    """
    gain = [torque_gain] if isinstance(torque_gain, int | float) else torque_gain
    draft = draft_problem(
        robot,
        log,
        validation=validation,
        columns=columns,
        units=units,
        torque_joints=torque_joints,
        selection=Selection(base, tip, locked=locked),
        torque_gain=gain,
        masses=masses,
        drive=drive,
        cutoff=cutoff,
        band=band,
        friction_velocity=friction_velocity,
        keep=keep,
        select=select,
        progress=progress,
        gains=gains,
        bodies=bodies,
        base=base_hints,
    )
    return run_study(
        draft.problem(), seed=seed, progress=progress, accepted=tuple(accepted)
    )
