"""Problems of a path: their files, loading them, and listing them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from consistent_id._support.tables import Table
from consistent_id.constraints import lowered
from consistent_id.errors import ConsistentIdError, ProblemError
from consistent_id.problems.constraints import constraints_of, prior_of
from consistent_id.problems.file import ProblemTable, read_problem_table
from consistent_id.problems.log_entries import gains_of_drives
from consistent_id.problems.overrides import overridden
from consistent_id.problems.paths import require_own_names
from consistent_id.problems.preparation import check_data
from consistent_id.problems.problem import Problem
from consistent_id.problems.stated_model import (
    assumed,
    base_question,
    behind_sensor,
    torque_model,
)
from consistent_id.problems.statement import (
    Statement,
    statement_of,
    with_keywords_of_a_statement,
)
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import base_parameters
from consistent_id.regression.regressor import TorqueModel

RESULTS = "results.json"
"""The file that marks a folder of results."""

_OWN = "problem.toml"
_OTHERS = ("pyproject.toml",)  # TOML files that are not problem files
_LONG = 20  # characters of drive terms, from which they are not in each row
_ALIKE = "as below"


def problem_files(path: str | Path) -> tuple[Path, ...]:
    """Return the problem files of a path.

    A file stands for itself, a folder for its ``problem.toml``.  A folder without one
    stands for all TOML files in it and in its subfolders: a robot's folder for the
    problems of this robot, a folder of such folders for all robots.

    Raises
    ------
    ProblemError
        If there is none.
    """
    path = Path(path)
    if not path.is_dir():
        return (path,)
    if (path / _OWN).exists():
        return (path / _OWN,)
    folders = [path, *sorted(p for p in path.iterdir() if _is_visible_folder(p))]
    files = tuple(file for folder in folders for file in toml_files(folder))
    if not files:
        raise ProblemError(
            f"{path}: no {_OWN} in this folder, and no problem file (*.toml) in it or "
            "its subfolders. Name a folder with one, or the file itself"
        )
    return files


def is_results(path: Path) -> bool:
    """Return whether a path is a folder of results, which opens without computing."""
    return (path / RESULTS).is_file()


def results_or_file(file: Path) -> Path:
    """Return a problem file's folder of results if it is in one, else the file."""
    is_theirs = file.name == _OWN and is_results(file.parent)
    return file.parent if is_theirs else file


def toml_files(folder: Path) -> list[Path]:
    """Return a folder's problem files, ``problem.toml`` first."""
    files = [file for file in folder.glob("*.toml") if file.name not in _OTHERS]
    return sorted(files, key=lambda file: (file.name != _OWN, file.name))


def _is_visible_folder(path: Path) -> bool:
    return path.is_dir() and not path.name.startswith(".")


class StatedProblem(NamedTuple):
    """A problem, and notes on statements that replace its file's content."""

    problem: Problem
    notes: tuple[str, ...] = ()


@with_keywords_of_a_statement
def load_problem(path: str | Path, *, trust: bool = False, **stated: Any) -> Problem:
    """Load a problem from its folder, or from the file itself.

    Parameters
    ----------
    path : str or Path
    trust : bool
        Whether the file may name other environment variables, and files that are
        neither in its folder nor in that of the data (``CONSISTENT_ID_DATASETS``).
    stated
        Statements that replace the file's content: the fields of `Statement`, such as
        ``cutoff=8.0``.

    Raises
    ------
    ProblemError
        If the file does not fit; with the path of the faulty key.  If it names files or
        variables that only a trusted file may name.  If the folder has no
        ``problem.toml`` and holds several problems; with their files.
    ModelError
        If the robot cannot be built.

    Examples
    --------
    >>> import consistent_id as ci
    >>> problem = ci.load_problem("problems/rx60")
    >>> problem.name, problem.model.robot.link_names
    ('rx60', ('link1', 'link2', 'link3'))
    """
    return stated_problem(Path(path), statement_of(stated), trust=trust).problem


def stated_problem(
    path: Path, stated: Statement, *, trust: bool = False
) -> StatedProblem:
    """Load a problem with statements that replace its file's content.

    Raises
    ------
    ProblemError, ModelError
        As `load_problem`, and as `overridden`.
    """
    file = one_problem_file(path)
    table = read_problem_table(file)
    if not trust:
        require_own_names(table, file)
    table, notes = overridden(table, stated, file)
    return StatedProblem(replace(problem_of(table, file), source=file), notes)


def one_problem_file(path: Path) -> Path:
    """Return the only problem file of a path.

    Raises
    ------
    ProblemError
        If there are several; with their names.
    """
    files = problem_files(path)
    if len(files) > 1:
        found = ", ".join(str(file.relative_to(path)) for file in files)
        raise ProblemError(
            f"{path} holds {len(files)} problems: {found}. Name one of them, or load "
            "them all with load_problems"
        )
    return files[0]


def problem_of(
    table: ProblemTable,
    file: Path,
    *,
    read: Mapping[str, Recording] | None = None,
    model: TorqueModel | None = None,
) -> Problem:
    """Return the problem that a problem file's content states.

    Parameters
    ----------
    table : ProblemTable
    file : Path
        Files are named relative to its folder; it need not exist.
    read : mapping of str to Recording, optional
        Logs that have been read already, by their names in the file.
    model : TorqueModel, optional
        The table's robot with its drive terms, if it has been built already.

    Raises
    ------
    ProblemError, ModelError
        See `load_problem`.
    """
    model = torque_model(table, file) if model is None else model
    arm = None if table.wrist_sensor is None else model.robot
    model = behind_sensor(table, model)
    if table.data is not None:
        gains_of_drives(table.data)
        check_data(table.data, floating=model.robot.floating and arm is None)
    constraints = constraints_of(assumed(table, model), file.parent, table.joints)
    lowered(constraints, model)  # check names here, not after hours
    problem = Problem(
        folder=file.parent,
        table=table,
        model=model,
        constraints=constraints,
        prior=prior_of(table.prior, file),
        arm=arm,
    )
    problem.keep(read or {})
    return problem


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
                f"{names.count(name)} problems are named {name!r}, under which results "
                "are filed; give each a name of its own: name = ... in its file"
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
