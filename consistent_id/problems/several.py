"""Every problem of a folder."""

from collections.abc import Sequence
from pathlib import Path

from consistent_id.errors import ProblemError
from consistent_id.problems.folder import problem_files
from consistent_id.problems.loading import load_problem
from consistent_id.problems.problem import Problem


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
