"""From a problem file, or its content, to the problem."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from consistent_id.constraints import lowered
from consistent_id.errors import ProblemError
from consistent_id.problems.constraints import constraints_of, prior_of
from consistent_id.problems.file import ProblemTable, read_problem_table
from consistent_id.problems.folder import problem_files
from consistent_id.problems.log_entries import gains_of_drives
from consistent_id.problems.overrides import overridden
from consistent_id.problems.paths import require_own_names
from consistent_id.problems.preparation import check_data
from consistent_id.problems.problem import Problem
from consistent_id.problems.stated_model import assumed, behind_sensor, torque_model
from consistent_id.problems.statement import (
    Statement,
    statement_of,
    with_keywords_of_a_statement,
)
from consistent_id.recordings.recording import Recording
from consistent_id.regression.regressor import TorqueModel


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
