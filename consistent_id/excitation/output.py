"""Files, record and tables of a playable design."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from consistent_id._support.files import (
    require_writable,
    together,
    write_atomically,
    write_json,
)
from consistent_id._support.tables import Table
from consistent_id.errors import InfeasibleError, ProblemError
from consistent_id.excitation.carried_tool import what_moves
from consistent_id.excitation.design_record import design_record, design_tables
from consistent_id.excitation.figure import design_figure
from consistent_id.excitation.interest import parameters_named
from consistent_id.excitation.playable import TRAINING, VALIDATION, PlayableDesign
from consistent_id.excitation.replay import write_replay
from consistent_id.excitation.request import design_request
from consistent_id.excitation.request_tables import request_tables
from consistent_id.excitation.verification import demands
from consistent_id.motion.files import follow, write_trajectory
from consistent_id.motion.files.controller_tables import CYCLES, cycle_of
from consistent_id.motion.files.trajectory_file import FORMAT_OF_ENDING
from consistent_id.problems.problem import Problem
from consistent_id.report.figures import save_figure
from consistent_id.robot.parameters import did_you_mean

FORMATS = ("csv", "yaml")
"""Endings of the files of samples that are written by default."""

REPLAY = "replay.html"
CLIENT = "follow.py"
"""Script that plays ``yaml`` files on ROS 2, written beside them."""


def write_design(
    playable: PlayableDesign,
    folder: Path,
    formats: Sequence[str] = FORMATS,
    tolerance: float | None = None,
) -> list[Path]:
    """Write motions, figure and record into a folder; return the files.

    Parameters
    ----------
    playable : PlayableDesign
    folder : Path
    formats : sequence of str
        Endings of files of samples, such as ``csv``, ``yaml`` or ``script``, that
        `write_trajectory` knows; the exact motion is always written, as ``json``.
    tolerance : float, optional, [rad or m]
        Of ROS messages with few points, see `write_trajectory`.
    """
    require_writable(folder)
    written = []
    with together():
        for name, move in playable.moves.items():
            for ending in dict.fromkeys(("json", *formats)):
                file = folder / f"{name}.{ending}"
                rate = _rate_of(ending, playable.design.aim.rate)
                few = tolerance if FORMAT_OF_ENDING[f".{ending}"] == "ros" else None
                written.append(write_trajectory(move, file, rate=rate, tolerance=few))
        if "yaml" in formats:
            script = Path(follow.__file__).read_text(encoding="utf-8")
            written.append(write_atomically(folder / CLIENT, script))
        figure = design_figure(playable.design)
        written.append(save_figure(figure, folder / "excitation.png"))
        record = playable_record(playable)
        written.append(write_json(folder / "excitation.json", record))
    return written


def require_places(folder: Path, formats: Sequence[str]) -> None:
    """Refuse a folder in which `write_design` could not write in the end."""
    motions = (TRAINING, VALIDATION)
    names = [f"{name}.{end}" for name in motions for end in ("json", *formats)]
    names += [CLIENT] * ("yaml" in formats)
    require_writable(folder, ["excitation.png", "excitation.json", *names])


def _rate_of(ending: str, rate: float) -> float:
    """Return the rate of a file's samples: controllers have their own."""
    form = FORMAT_OF_ENDING[f".{ending}"]
    if form not in CYCLES:
        return rate
    return cycle_of(form, rate) or CYCLES[form][0]


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


def replay_design(problem: Problem, playable: PlayableDesign, folder: Path) -> Path:
    """Write a page that replays the training motion; return the file."""
    if TRAINING not in playable.moves:
        raise InfeasibleError(f"nothing to replay: {playable.refusals[0]}")
    model, scene = problem.table.model, problem.table.excitation.scene
    return write_replay(
        playable.moves[TRAINING],
        problem.moving,
        folder / REPLAY,
        urdf=None if model.urdf is None else problem.file(model.urdf),
        package_dirs=[problem.file(name) for name in scene.packages] if scene else [],
        locked=model.locked,
        scene=playable.design.demands.scene,
    )


def planned_tables(
    problem: Problem, parameters: ArrayLike | None = None
) -> list[Table]:
    """Return what `playable_design` would design, for people, without a search."""
    request = design_request(problem)
    parameters_named(problem.model.layout, request.aim.interest)
    moved = what_moves(problem, parameters)
    required = demands(
        moved.torque,
        request.limits,
        moved.parameters,
        request.scene,
        request.friction_share,
    )
    return request_tables(moved, request, required)


def playable_record(playable: PlayableDesign) -> dict[str, Any]:
    """Return all there is to know of a design and its moves, as plain values."""
    record = design_record(playable.design, playable.validation, playable.proofs)
    record["played"] = {
        name: {
            "duration_s": move.duration,
            "proven": playable.proofs[name].holds,
            "least_margin": asdict(playable.proofs[name].margins.least),
        }
        for name, move in playable.moves.items()
    }
    record["notes_on_playing"] = list(playable.notes)
    record["refusals"] = list(playable.refusals)
    return record


def playable_tables(playable: PlayableDesign) -> list[Table]:
    """Return the same for people."""
    rows = tuple(_rows(playable))
    header = ("motion", "lasts", "least margin", "joint", "limit of")
    what = "run-in and run-out included; proven for all times"
    notes = (what, *playable.notes, *playable.refusals)
    found, *others = design_tables(playable.design, playable.proofs)
    return [found, Table("What is played", header, rows, notes), *others]


def _rows(playable: PlayableDesign) -> Iterator[tuple[str, ...]]:
    for name, move in playable.moves.items():
        least = playable.proofs[name].margins.least
        share = f"{100.0 * least.relative:.2f} %"
        yield name, f"{move.duration:.2f} s", share, least.joint, least.quantity
