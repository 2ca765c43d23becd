"""The input of commands: a problem, a robot and its logs, or results in a folder.

The options are declared in `Statement` and shared by all commands.
"""

import argparse
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from consistent_id.cli.answers import Answer, answered, show, shows_progress
from consistent_id.cli.options import Group, Option
from consistent_id.problems.statement import declarations
from consistent_id.problems.statement_words import Declaration, Part

if TYPE_CHECKING:
    from consistent_id._support.tables import Table
    from consistent_id.estimation.verdict import Verdict
    from consistent_id.problems.opening import Opened
    from consistent_id.problems.statement import Statement
    from consistent_id.problems.study import Study
    from consistent_id.report.report_content import Section
    from consistent_id.report.results import Results, StudyOutcome


_TITLES: dict[Part, tuple[str, str]] = {
    "robot": ("the robot", ""),
    "log": ("logs", "found in the logs unless given"),
    "base": (
        "a base that floats (--base floating)",
        "found in the log unless given",
    ),
    "model": ("the model", "chosen by the training data unless given"),
    "selection": ("the choice of the model", ""),
}


def _option(name: str, declared: Declaration) -> Option:
    """Return the option of a field of `Statement`."""
    return Option(
        declared.usage,
        declared.text,
        choices=declared.choices or None,
        dest=name,
        const=True if declared.usage == "--no-select" else None,
    )


def _group(*parts: Part) -> tuple[Group, ...]:
    """Return the options of some parts of a statement, a group each."""
    return tuple(
        Group(
            _TITLES[part][0],
            tuple(
                _option(name, declared)
                for name, declared in declarations().items()
                if declared.part == part
            ),
            _TITLES[part][1] or None,
        )
        for part in parts
    )


ROBOT = _group("robot")
"""Options that state which part of a robot moves."""

STATED = _group("robot", "log", "base", "model", "selection")
"""Options that state facts about robot and logs."""

PROBLEM = Option(
    "problem",
    "folder with a problem.toml, the file, a folder of several or of results; or, with "
    "logs, a URDF or MJCF file",
    Path,
)
PROBLEM_OR_ROBOT = replace(
    PROBLEM,
    text="folder with a problem.toml, the file, a folder of several or of results, or "
    "a URDF or MJCF file",
)
PROBLEM_ALONE = replace(
    PROBLEM,
    text="folder with a problem.toml, the file, or a folder of several or of results",
)
LOGS = Option(
    "log [...]", "logs to learn from, if PROBLEM is a URDF or MJCF file", Path
)
SOURCE = (PROBLEM, LOGS)
"""Arguments of commands that work on a problem."""


def statement(options: argparse.Namespace, *parts: Part) -> "Statement":
    """Return the statement that the options make; by default about all parts."""
    from consistent_id.problems.statement import statement_of_words

    words = vars(options)
    if parts:
        known = (n for n, d in declarations().items() if d.part in parts)
        words = {name: words[name] for name in known}
    return statement_of_words(words)


def announce(options: argparse.Namespace) -> None:
    """Say which problem, or robot and logs, are read, before libraries are imported."""
    from consistent_id._support.progress import begun

    first = options.problem
    first = first.parent if first.name == "problem.toml" else first
    names = (
        path.resolve().name for path in (first, *(getattr(options, "log", None) or ()))
    )
    begun(f"reading {', '.join(names)}", shows_progress(options))


def opened(options: argparse.Namespace) -> "Opened":
    """Open the problem that the options name, with their statements."""
    if options.log:
        announce(options)
    from consistent_id.problems.opening import open_problem

    return open_problem(
        options.problem,
        options.log,
        statement(options),
        progress=shows_progress(options),
    )


def each(
    options: argparse.Namespace,
    answer_to: Callable[[argparse.Namespace], Answer],
    *,
    file: bool = False,
) -> int:
    """Answer for the robot and logs, or for every problem, that the options name.

    Parameters
    ----------
    file : bool
        Whether ``--output`` names a file; of several problems each has its own.
    """
    from consistent_id.problems.loading import is_results

    if options.log or is_results(options.problem):
        return show(options, answer_to(options))
    return answered(options, answer_to, opens=True, file=file)


@dataclass(frozen=True)
class Computed:
    """A study that is computed in this run, part by part; a `StudyOutcome`.

    Parameters
    ----------
    opened : Opened
    study : Study
    command : str
        The command that computes it again.
    """

    opened: "Opened"
    study: "Study"
    command: str = ""

    @property
    def name(self) -> str:
        """The problem's name."""
        return self.study.problem.name

    @property
    def verdict(self) -> "Verdict":
        """Whether the recommended estimate may be used, and why."""
        return self.study.verdict

    def tables(self, name: str) -> list["Table"]:
        """Return the tables of a command: ``identify``, ``compare``, ..."""
        from consistent_id.report.results_writing import tables_of

        if name not in self._printed:
            self._printed[name] = tables_of(name, self.opened, self.study)
        return list(self._printed[name])

    @property
    def answer(self) -> dict[str, Any]:
        """Verdict, reasons, recommended estimate."""
        return self.study.answer()

    @cached_property
    def record(self) -> dict[str, Any]:
        """The study as plain numbers and text."""
        from consistent_id.report.results_writing import study_record

        return study_record(self.study)

    @cached_property
    def page(self) -> str:
        """The report."""
        from consistent_id.report.page import report_html

        return report_html(
            self.study,
            uncertainty=self.study.uncertainty,
            further=self._rollouts,
            command=self.command,
        )

    @property
    def _rollouts(self) -> "tuple[Section, ...]":
        """The section on rollouts, whose modules are needed only with gains."""
        if self.study.problem.gains is None:
            return ()
        from consistent_id.report.page import kept_sections
        from consistent_id.rollout.rollout_page import rollout_section

        return kept_sections("rollouts", rollout_section, self.study)

    def write(self, folder: Path) -> list[Path]:
        """Write the study to a folder."""
        from consistent_id.report.results import PRINTED
        from consistent_id.report.results_writing import write_results

        tables = {name: self.tables(name) for name in PRINTED}
        return write_results(
            self.opened, self.study, folder, page=self.page, tables=tables
        )

    @cached_property
    def _printed(self) -> dict[str, list["Table"]]:
        """Tables that were computed already."""
        return {}


def studied(
    options: argparse.Namespace,
    folder: Path | None = None,
    before: Callable[[str], None] | None = None,
    *,
    costs: bool = False,
) -> "StudyOutcome":
    """Return the study that the options name; written results are opened instead.

    Parameters
    ----------
    folder : Path, optional
        Folder to which it will be written.
    before : callable, optional
        Called with the problem's name before anything is computed, such as to test
        whether files can be written.
    costs : bool
        Whether the costs of constraints are computed, too, because they are printed.
    """
    found = stored(options, folder)
    if found is not None:
        return found
    stated = any(getattr(options, name, None) for name in ("output", "report"))
    if options.log and stated and before is not None:
        before("")  # a stated place needs no name, which comes with the chosen model
    source = opened(options)
    if before is not None:
        before(source.problem.name)
    return Computed(
        source, study_of(options, source).run(costs=costs), command_of(options)
    )


def study_of(options: argparse.Namespace, source: "Opened") -> "Study":
    """Return the study of an opened problem; nothing is computed yet."""
    from consistent_id.problems.study import Study

    return Study(
        source.problem,
        seed=getattr(options, "seed", 0),
        progress=shows_progress(options),
        accepted=tuple(options.accept),
    )


def stored(options: argparse.Namespace, folder: Path | None = None) -> "Results | None":
    """Return the results in a folder, if they were computed with the same options."""
    from consistent_id.problems.loading import is_results

    if options.log or not is_results(options.problem):
        return None
    from consistent_id._support.run import note_input
    from consistent_id.report.results import INDEX, REPORT, open_results

    results = open_results(options.problem)
    index = results.index
    why = results.changes()
    if given := statement(options).given:
        why.append(f"{declarations()[given[0]].option} is stated beside it")
    if sorted(index.accepted) != sorted(getattr(options, "accept", index.accepted)):
        stated = " ".join(f"--accept {shlex.quote(kind)}" for kind in index.accepted)
        why.append(f"its results have {stated or 'no --accept'}")
    if index.seed != getattr(options, "seed", index.seed):
        why.append(f"its results have --seed {index.seed}")
    if folder is not None and folder.resolve() != options.problem.resolve():
        why.append(f"results are to be written to {folder}, too")
    if not why:
        for name in {INDEX, *index.files} - {REPORT}:  # no other file of it is replaced
            note_input((results.folder / name).stat())
        return results
    if not options.quiet:
        print(f"{options.problem}: computed again: {'; '.join(why)}", file=sys.stderr)
    return None


def command_of(options: argparse.Namespace) -> str:
    """Return the command that writes the report of the same study again."""
    words = [options.problem, *options.log]
    text = "consistent-id report " + " ".join(shlex.quote(str(word)) for word in words)
    for kind in options.accept:
        text += f" --accept {shlex.quote(kind)}"
    text += f" --seed {getattr(options, 'seed', 0)}"
    for name, declared in declarations().items():
        given: Any = getattr(options, name, None)
        if given not in (None, (), []):
            values = given if isinstance(given, list) else [given] * (given is not True)
            text += " " + shlex.join([declared.option, *map(str, values)])
    return text
