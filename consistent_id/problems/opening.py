"""Opening a user's problem: a problem file, or a robot and its logs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from consistent_id._support.tables import Table
from consistent_id.problems.file import ProblemTable
from consistent_id.problems.kept_text import toml_text
from consistent_id.problems.loading import stated_problem
from consistent_id.problems.paths import moved
from consistent_id.problems.problem import Problem
from consistent_id.problems.statement import Statement, with_keywords_of_a_statement

# Drafts and studies are imported where they are made: a problem file needs none of them
# to be opened.
if TYPE_CHECKING:
    from consistent_id.problems.draft import Draft
    from consistent_id.problems.robot_logs import GivenLog
    from consistent_id.problems.study import Study


@dataclass(frozen=True, slots=True, eq=False)
class Opened:
    """A problem, and where it comes from.

    Parameters
    ----------
    problem : Problem
    draft : Draft, optional
        The draft, if there was no problem file.
    notes : tuple of str
        Notes on statements that replace the file's content.
    """

    problem: Problem
    draft: "Draft | None" = None
    notes: tuple[str, ...] = ()

    def tables(self) -> list[Table]:
        """Return the way in which logs were read, and the model that was chosen."""
        if self.draft is None:
            return []
        from consistent_id.problems.draft import draft_table

        chosen = self.draft.selection
        return [draft_table(self.draft), *([] if chosen is None else [chosen.table()])]

    def noted(self, tables: Sequence[Table]) -> list[Table]:
        """Return tables, the first with notes on what was stated."""
        first, *others = tables
        return [replace(first, notes=(*first.notes, *self.notes)), *others]

    def table(self, folder: Path) -> ProblemTable:
        """Return the content of a problem file for a file in a folder."""
        if self.draft is not None:
            return self.draft.table(folder)
        return moved(self.problem.table, self.problem.folder, folder)

    def text(self, folder: Path, accepted: Sequence[str] = ()) -> str:
        """Return the text of a problem file for a file in a folder.

        Parameters
        ----------
        accepted : sequence of str
            Kinds of findings that the user accepted; a comment lists them.
        """
        if self.draft is not None:
            return self.draft.text(folder, accepted=accepted)
        head = [f"# The problem {self.problem.name}, as its results were computed.", ""]
        if accepted:
            head[1:1] = [f"# Accepted in spite of the verdict: {', '.join(accepted)}."]
        head[1:1] = [f"# {note}" for note in self.notes]
        return "\n".join(head) + "\n" + toml_text(self.table(folder), {})


def open_problem(
    path: Path,
    logs: Sequence[Path] = (),
    stated: Statement | None = None,
    *,
    progress: bool = False,
    trust: bool = False,
) -> Opened:
    """Open a problem: that of a file or folder, or of a robot and its logs.

    Parameters
    ----------
    path : Path
        A problem file or its folder; with logs, a robot's URDF or MJCF file.
    logs : sequence of Path
        Training logs.
    stated : Statement, optional
        The user's statement; it replaces settings of a problem file.
    progress : bool
        Whether to show the progress of the selection.
    trust : bool
        See `load_problem`.

    Raises
    ------
    ProblemError, ModelError, RecordingError
        As `load_problem` and `draft_problem`.
    """
    stated = Statement() if stated is None else stated
    if logs:
        from consistent_id.problems.drafting import drafted

        draft = drafted(path, list(logs), stated, progress=progress)
        return Opened(draft.problem(), draft)
    problem, notes = stated_problem(path, stated, trust=trust)
    return Opened(problem, notes=notes)


@with_keywords_of_a_statement
def identify_log(
    robot: str | Path,
    log: "GivenLog | Sequence[GivenLog]",
    *,
    accepted: Sequence[str] = (),
    seed: int = 0,
    progress: bool = False,
    **stated: Any,
) -> "Study":
    """Identify a robot from one log or several, without a problem file.

    Parameters
    ----------
    robot : str or Path
        URDF or MJCF.
    log : str, Path, table or Recording, or a list of them
        Training logs: files, or data frames, Arrow tables and mappings of arrays.
    accepted, seed, progress
        See `run_study`.
    stated
        The user's statements, as in `draft_problem`: the fields of `Statement`.

    Returns
    -------
    Study
        `Study.delivered` is the final estimate, `Study.verdict` states whether to use
        it.

    Raises
    ------
    ModelError, RecordingError, ProblemError
        As `draft_problem`.
    NotExcitedError, InfeasibleError, SolverError
        As `run_study`.

    Examples
    --------
    >>> import consistent_id as ci
    >>> folder = "problems/kuka_kr300"
    >>> log = f"{folder}/FF_A.csv"
    >>> study = ci.identify_log(f"{folder}/robot.urdf", log, select=False)
    >>> study.verdict.word
    'use with care'
    """
    from consistent_id.problems.drafting import draft_problem
    from consistent_id.problems.study import run_study

    draft = draft_problem(robot, log, progress=progress, **stated)
    return run_study(
        draft.problem(), seed=seed, progress=progress, accepted=tuple(accepted)
    )
