"""The problems of a folder, a line each: what is there, and what is missing."""

from collections.abc import Sequence
from pathlib import Path

from consistent_id._support.tables import Table
from consistent_id.errors import ConsistentIdError
from consistent_id.problems.problem import Problem, load_problem


def list_problems(folder: Path, files: Sequence[Path]) -> Table:
    """Return a line on each problem of a folder; what is missing is said below."""
    rows: list[tuple[str, ...]] = []
    notes = []
    for file in files:
        place = str(file.relative_to(folder))
        try:
            problem = load_problem(file)
            missing = problem.missing
        except ConsistentIdError as error:
            rows.append((place, "-", "-", "-", "-", "cannot be loaded"))
            notes.append(f"{place}: {error}")
            continue
        if missing:
            notes.append(f"{place}: no {', '.join(missing)}")
        rows.append((place, *_told(problem, missing)))
    return Table(
        f"{folder}: {len(files)} problems",
        ("file", "name", "robot", "joints", "learns from, judged by", "state"),
        tuple(rows),
        tuple(notes),
    )


def _told(problem: Problem, missing: Sequence[str]) -> tuple[str, ...]:
    robot = problem.model.robot
    state = "ready" if problem.has_data else "nothing to learn from"
    if missing:
        state = f"{len(missing)} recordings missing"
    return problem.name, robot.name, str(len(robot)), _data_of(problem), state


def _data_of(problem: Problem) -> str:
    """Say how many recordings there are to learn from and to judge by."""
    table = problem.table
    if table.data is not None:
        roles = [entry.role for entry in table.data.recordings]
        return f"{roles.count('training')}, {roles.count('validation')} recordings"
    return "a simulated experiment" if problem.has_data else "-"
