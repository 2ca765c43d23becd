"""What commands answer, for one problem or for several, and how it is printed."""

import argparse
import json
import logging
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from consistent_id.cli.colour import coloured, wants_colour
from consistent_id.cli.shortened import shortened
from consistent_id.errors import ConsistentIdError, SolverError

if TYPE_CHECKING:
    from consistent_id._support.tables import Table


class Answer(NamedTuple):
    """What a command answers for one problem.

    Parameters
    ----------
    code : int
        Exit code.
    record : object
        The same for ``--json``.
    write : callable, optional
        Writes files when the answer has been printed, unless none are to be written,
        and returns their paths.
    whole : bool
        Whether the text is printed as it is, being a file or a script itself.
    """

    code: int
    text: str
    record: object
    write: Callable[[], Sequence[Path]] | None = None
    whole: bool = False


def tables_answer(
    tables: Iterable["Table"],
    record: object,
    *,
    usable: bool = True,
    write: Callable[[], Sequence[Path]] | None = None,
) -> Answer:
    """Return tables as an answer; its exit code is 1 if a result is not to be used."""
    text = "\n\n".join(table.text() for table in tables)
    return Answer(0 if usable else 1, text, record, write)


AnswerTo = Callable[[argparse.Namespace], Answer]


def answered(options: argparse.Namespace, answer_to: AnswerTo) -> int:
    """Answer for every problem that ``options.problem`` stands for.

    Parameters
    ----------
    answer_to : callable
        From the options, ``problem`` being one file, to an `Answer`.

    Returns
    -------
    int
        The highest exit code.
    """
    from consistent_id.problems.folder import problem_files

    files = problem_files(options.problem)
    if len(files) > 1:
        return _each(options, files, answer_to)
    return show(options, answer_to(_of(options, files[0])))


def show(options: argparse.Namespace, answer: Answer) -> int:
    """Print an answer as the options ask, then write its files; return its code."""
    try:
        if options.json:
            print(json.dumps(answer.record, indent=1, allow_nan=False), flush=True)
        else:
            print_text(options, _shown(options, answer))
    except BrokenPipeError:
        _write(options, answer, shown=False)
        raise
    _write(options, answer)
    return answer.code


def _write(options: argparse.Namespace, answer: Answer, *, shown: bool = True) -> None:
    """Write an answer's files and name them."""
    from consistent_id._support.files import together

    if answer.write is None or getattr(options, "dry_run", False):
        return
    with together():
        paths = answer.write()
    if paths and shown and not options.json:
        print_text(options, "\nwritten: " + ", ".join(str(path) for path in paths))


def _shown(options: argparse.Namespace, answer: Answer) -> str:
    """Return what is printed of an answer's text."""
    whole = answer.whole or getattr(options, "verbose", False)
    return answer.text if whole else shortened(answer.text)


def print_text(options: argparse.Namespace, text: str) -> None:
    """Print text, unless the user wants quiet."""
    if not options.quiet:
        print(coloured(text) if wants_colour(sys.stdout) else text, flush=True)


def print_error(error: ConsistentIdError) -> int:
    """Print an error; return its exit code."""
    print(f"consistent-id: {error}", file=sys.stderr)
    return 3 if isinstance(error, SolverError) else 2


@contextmanager
def warnings_unless(quiet: bool) -> Iterator[None]:
    """Let the package's warnings pass, each once, unless the user wants quiet."""
    logger = logging.getLogger("consistent_id")
    before, said = logger.level, set[str]()
    handler = logging.StreamHandler()
    handler.addFilter(lambda record: _is_new(record.getMessage(), said))
    logger.addHandler(handler)
    if quiet:
        logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)
        logger.removeHandler(handler)


def _is_new(sentence: str, said: set[str]) -> bool:
    """Return whether a sentence has not been said, and note that it is now."""
    new = sentence not in said
    said.add(sentence)
    return new


def shows_progress(options: argparse.Namespace) -> bool:
    """Return whether to say how far long work is, on the standard error."""
    return not options.quiet


def _each(
    options: argparse.Namespace, files: Sequence[Path], answer_to: AnswerTo
) -> int:
    """Work through several problems; one that fails does not stop the others."""
    from consistent_id.problems.file import read_problem_table
    from consistent_id.problems.several import require_distinct

    codes, records, names = [], {}, []
    for file in files:
        try:
            names.append(read_problem_table(file).name)
            require_distinct(names)
            answer = answer_to(_of(options, file, names[-1]))
            if not options.json:
                print_text(options, f"=== {names[-1]}\n\n{_shown(options, answer)}")
            _write(options, answer)
        except ConsistentIdError as error:
            codes.append(print_error(error))
            continue
        codes.append(answer.code)
        records[names[-1]] = answer.record
        if not options.json:
            print_text(options, "")
    if options.json:
        print(json.dumps(records, indent=1, allow_nan=False))
    return max(codes)


def _of(
    options: argparse.Namespace, file: Path, name: str | None = None
) -> argparse.Namespace:
    """Return the options for one problem; of several, each has its own files."""
    chosen = argparse.Namespace(**{**vars(options), "problem": file})
    if name is not None and getattr(options, "output", None) is not None:
        chosen.output = options.output / name
    if name is not None and getattr(options, "report", None) is not None:
        file = options.report
        chosen.report = file.with_name(f"{file.stem}-{name}{file.suffix}")
    return chosen
