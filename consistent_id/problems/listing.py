"""Problems of a folder: all with one line each, or one in detail."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from consistent_id._support.tables import Table
from consistent_id.errors import ConsistentIdError, ProblemError
from consistent_id.problems.folder import problem_files, toml_files
from consistent_id.problems.loading import load_problem
from consistent_id.problems.problem import Problem
from consistent_id.regression.base import base_parameters
from consistent_id.robot.chains import base_question

_LONG = 20  # characters of drive terms, from which they are not in each row
_ALIKE = "as below"


def load_problems(folder: str | Path, *, trust: bool = False) -> tuple[Problem, ...]:
    """Load every problem of a folder: several robots, or several problems of one.

    Parameters
    ----------
    folder : str or Path
        See `problem_files`.
    trust : bool
        See `load_problem`.

    Raises
    ------
    ProblemError, ModelError
        See `load_problem`; or if two problems have one name.

    Examples
    --------
    >>> [problem.model.robot.name for problem in load_problems("problems/rx60")]
    ['rx60']
    """
    problems = tuple(load_problem(file, trust=trust) for file in problem_files(folder))
    require_distinct([problem.name for problem in problems])
    return problems


def require_distinct(names: Sequence[str]) -> None:
    """Refuse problems of one name: their results would overwrite each other."""
    for name in names:
        if names.count(name) > 1:
            raise ProblemError(
                f"two problems of the folder are named {name!r}; results are "
                "filed under their names"
            )


def list_problems(folder: Path, files: Sequence[Path]) -> Table:
    """Return a line for each problem of a folder; notes name missing files."""
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
        rows.append((place, *_row(problem, missing)))
    return Table(
        f"{folder}: {len(files)} problems",
        ("file", "name", "robot", "joints", "training, validation", "state"),
        tuple(rows),
        tuple(notes),
    )


def _row(problem: Problem, missing: Sequence[str]) -> tuple[str, ...]:
    robot = problem.model.robot
    state = "ready" if problem.has_data else "no training data"
    if missing:
        state = f"{len(missing)} recordings missing"
    return problem.name, robot.name, str(len(robot)), _data_of(problem), state


def _data_of(problem: Problem) -> str:
    """Return the numbers of training and validation recordings."""
    table = problem.table
    if table.data is not None:
        roles = [entry.role for entry in table.data.recordings]
        return f"{roles.count('training')}, {roles.count('validation')} recordings"
    return "a simulated experiment" if problem.has_data else "-"


def _said_once(drives: dict[str, str]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return a note on the drive terms that most joints have, and shorter cells.

    Terms of all joints in each row would make it wider than a screen.
    """
    words, count = Counter(drives.values()).most_common(1)[0] if drives else ("", 0)
    if count < 2 or len(words) < _LONG:
        return (), drives
    short = {name: _ALIKE if its == words else its for name, its in drives.items()}
    return (f"drive terms of {count} joints ({_ALIKE}): {words}",), short


def problem_tables(problem: Problem) -> list[Table]:
    """Return a problem as tables: robot, datasheet, base parameters."""
    robot, model = problem.model.robot, problem.model
    base = base_parameters(model)
    drives = {
        name: ", ".join(terms.names) or "none"
        for name, terms in zip(robot.joint_names, model.terms, strict=True)
    }
    alike, drives = _said_once(drives)
    links = Table(
        f"Robot {robot.name}: {len(robot)} joints, "
        f"{'floating' if robot.floating else 'fixed'} base, "
        f"gravity {robot.gravity} m/s^2",
        ("joint", "kind", "moves", "datasheet mass [kg]", "drive terms"),
        tuple(
            (
                joint.name,
                joint.kind,
                link.name,
                "-" if link.datasheet.mass is None else f"{link.datasheet.mass:g}",
                drives.get(joint.name)
                or ("none" if joint.kind == "free" else f"follows {joint.mimic}"),
            )
            for joint, link in zip(robot.joints, robot.links, strict=True)
        ),
        alike
        + base.near
        + base_question(robot)
        + tuple(
            f"coupled gears: {coupling.label}, {', '.join(coupling.names)}"
            for coupling in model.couplings
        ),
    )
    here = [file.name for file in toml_files(problem.folder)]
    if len(here) > 1:
        note = f"problem files of this folder: {', '.join(here)}"
        links = replace(links, notes=(*links.notes, note))
    groups = Table(
        f"Base parameters: {len(base)} of {len(model.layout)} (structural rank)",
        ("leading parameter", "grouping"),
        tuple(zip(base.names, base.groupings, strict=True)),
        (f"without effect on torque: {', '.join(base.without_effect) or 'none'}",),
    )
    return [links, groups]
