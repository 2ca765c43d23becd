"""Answers of commands, for one problem or for several, and their printing."""

import argparse
import json
import logging
import os
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, NamedTuple, TextIO

from consistent_id.errors import ConsistentIdError, SolverError

if TYPE_CHECKING:
    from consistent_id._support.tables import Table


_CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f]")  # except tabs and ends of lines
_OF_FILES = 3  # lines that files which are written take, the empty one included


class Answer(NamedTuple):
    """The answer of a command for one problem.

    Parameters
    ----------
    code : int
        Exit code.
    record : object
        The content for ``--json``.
    write : callable, optional
        Writes files after the answer has been printed, and returns their paths.  It is
        not called with ``--dry-run``.
    whole : bool
        Whether the text is a file or a script, which is printed unshortened.
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
    """Return tables as an answer; its exit code is 1 if a result must not be used."""
    text = "\n\n".join(table.text() for table in tables)
    return Answer(0 if usable else 1, text, record, write)


AnswerTo = Callable[[argparse.Namespace], Answer]


def answered(
    options: argparse.Namespace,
    answer_to: AnswerTo,
    *,
    opens: bool = False,
    file: bool = False,
) -> int:
    """Answer for every problem that ``options.problem`` stands for.

    Parameters
    ----------
    answer_to : callable
        Function from the options, with one file as ``problem``, to an `Answer`.
    opens : bool
        Whether it opens folders of results: ``problem`` is then the folder of a file
        with results.
    file : bool
        Whether ``--output`` names a file, not a folder.

    Returns
    -------
    int
        The highest exit code.
    """
    from consistent_id.problems.loading import problem_files, results_or_file

    files = problem_files(options.problem)
    if opens and options.problem.is_dir():
        files = tuple(map(results_or_file, files))
    if len(files) > 1:
        return _each(options, files, answer_to, file=file)
    return show(options, answer_to(_of(options, files[0])))


def show(options: argparse.Namespace, answer: Answer) -> int:
    """Print an answer as the options state, write its files, and return its code.

    The code is the same if the reader, such as ``head``, has gone.
    """
    shown = True
    try:
        if options.json:
            print(json.dumps(answer.record, indent=1, allow_nan=False), flush=True)
        else:
            print_text(options, _shown(options, answer))
    except BrokenPipeError:
        shown = False
        lead_nowhere(sys.stdout)
    _write(options, answer, shown=shown)
    return answer.code


def lead_nowhere(stream: TextIO) -> None:
    """Discard all further output to a stream, including the flush at the end."""
    with suppress(OSError, ValueError):  # some streams have no file
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _write(options: argparse.Namespace, answer: Answer, *, shown: bool = True) -> None:
    """Write an answer's files and name them."""
    from consistent_id._support.files import together

    if answer.write is None or getattr(options, "dry_run", False):
        return
    with together():
        paths = answer.write()
    if paths and shown and not options.json:
        lines = files_written(paths, whole=getattr(options, "verbose", False))
        print_text(options, f"\n{lines}")


def _shown(options: argparse.Namespace, answer: Answer) -> str:
    """Return the printed part of an answer's text."""
    whole = answer.whole or getattr(options, "verbose", False)
    most = LINES - (_OF_FILES if answer.write else 0)
    return answer.text if whole else shortened(answer.text, most)


def print_text(options: argparse.Namespace, text: str) -> None:
    """Print text, unless the user wants quiet."""
    if not options.quiet:
        text = _CONTROLS.sub("?", text)  # of names in files of strangers
        print(coloured(text) if wants_colour(sys.stdout) else text, flush=True)


def print_error(error: ConsistentIdError, words: Sequence[str] = ()) -> int:
    """Print an error, and the command to try if there is one; return its exit code.

    Parameters
    ----------
    words : sequence of str
        Words of the command.
    """
    print(f"consistent-id: {error}", file=sys.stderr)
    for note in getattr(error, "__notes__", ()):
        print(f"  {note}", file=sys.stderr)
    if error.options and words and (following := next_command(words, error)):
        print(f"try: {following}", file=sys.stderr)
    return 3 if isinstance(error, SolverError) else 2


def next_command(words: Sequence[str], error: ConsistentIdError) -> str:
    """Return a command with the options that an error proposes.

    The result is empty if the command has one of these options already, because the
    second one would replace the user's.

    Examples
    --------
    >>> cause = ConsistentIdError("no torque", options="--lock a 'b c'")
    >>> next_command(["check", "robot.urdf", "log.csv"], cause)
    "consistent-id check robot.urdf log.csv --lock a 'b c'"
    """
    if error.option_names & {word.partition("=")[0] for word in words}:
        return ""
    replaced = [str(Path(word)) in error.replaces for word in words]  # ./a.csv: a.csv
    places = [k for k, gone in enumerate(replaced) if gone]
    kept = [word for word, gone in zip(words, replaced, strict=True) if not gone]
    if not places:
        return f"consistent-id {shlex.join(kept)} {error.options}"
    before, after = kept[: places[0]], kept[places[0] :]
    return " ".join(
        filter(
            None,
            ["consistent-id", shlex.join(before), error.options, shlex.join(after)],
        )
    )


@contextmanager
def warnings_unless(quiet: bool) -> Iterator[None]:
    """Print each of the package's warnings once, unless the user wants quiet."""
    logger = logging.getLogger("consistent_id")
    before, said = logger.level, set[str]()
    handler = logging.StreamHandler()
    handler.addFilter(lambda record: _is_new(_without_folders(record), said))
    logger.addHandler(handler)
    if quiet:
        logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)
        logger.removeHandler(handler)


def _without_folders(record: logging.LogRecord) -> str:
    """Return a warning with the names of files in place of their paths.

    Many problems of one robot have copies of its file, or spell its path differently.
    """
    if not isinstance(record.args, tuple):
        return record.getMessage()
    called = tuple(
        Path(value).name
        if isinstance(value, Path) or (isinstance(value, str) and os.sep in value)
        else value
        for value in record.args
    )
    return str(record.msg) % called


def _is_new(sentence: str, said: set[str]) -> bool:
    """Return whether a sentence is new, and remember it."""
    new = sentence not in said
    said.add(sentence)
    return new


def shows_progress(options: argparse.Namespace) -> bool:
    """Return whether to show the progress of long work on the standard error."""
    return not options.quiet


def _each(
    options: argparse.Namespace,
    files: Sequence[Path],
    answer_to: AnswerTo,
    *,
    file: bool,
) -> int:
    """Work through several problems; one that fails does not stop the others."""
    from consistent_id.problems.file import read_problem_table
    from consistent_id.problems.loading import require_distinct

    codes, records, names = [], {}, []
    for source in files:
        try:
            # Several results may be of one problem; their folders distinguish them.
            own = source.name if source.is_dir() else read_problem_table(source).name
            names.append(own)
            require_distinct(names)
            answer = answer_to(_of(options, source, names[-1], file=file))
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
    options: argparse.Namespace,
    problem: Path,
    name: str | None = None,
    *,
    file: bool = False,
) -> argparse.Namespace:
    """Return the options for one problem; each of several has files of its own."""
    chosen = argparse.Namespace(**{**vars(options), "problem": problem})
    for option in ("output", "report") if name is not None else ():
        path: Path | None = getattr(options, option, None)
        if path is None:
            continue
        if option == "report" or file:
            path = path.with_name(f"{path.stem}-{name}{path.suffix}")
        else:
            path /= str(name)
        setattr(chosen, option, path)
    return chosen


LINES = 25
"""Lines of an answer by default."""

COLUMNS = 100
"""Columns of an answer by default."""


_KEPT = ("written: ", "next: ", "my result is bad")  # lines that are never left out


def shortened(text: str, most: int = LINES) -> str:
    r"""Return up to `most` lines of a text, and a note on how to see all of it.

    Wide lines are wrapped.  Lines that name files, the next step or the page of help
    are kept as they are.

    Examples
    --------
    >>> print(shortened("\n".join(str(i) for i in range(30))).splitlines()[-1])
    (6 more lines: --verbose prints them, --json has all figures)
    """
    lines = [short for line in text.splitlines() for short in wrapped(line)]
    kept = [line for line in lines if line.startswith(_KEPT)]
    others = [line for line in lines if line not in kept]
    while others and not others[-1]:
        others.pop()
    room = most - len(kept)
    if len(others) > room:
        shown = _without_bare_heading(others, room - 1)
        left = len(others) - len(shown)
        rest = f"({left} more lines: --verbose prints them, --json has all figures)"
        others = [*shown, rest]
    return "\n".join([*others, *kept])


def _without_bare_heading(lines: Sequence[str], most: int) -> Sequence[str]:
    """Return the first lines, without a heading whose first line would be cut off."""
    first = max(most - 1, 0)
    starts = 1 < most < len(lines) and not lines[first - 1] and lines[first]
    if starts and lines[most]:
        most = first
    while most > 1 and not lines[most - 1]:
        most -= 1
    return lines[:most]


def files_written(paths: Sequence[Path], *, whole: bool = True) -> str:
    """Return the line that names written files, grouped by folder.

    Parameters
    ----------
    whole : bool
        Whether all are named; else only as many of a folder as fit into two lines.
    """
    folders = {path.parent for path in paths}
    if len(paths) == 1 or len(folders) > 1:
        return "written: " + ", ".join(map(str, paths))
    head, names = f"written in {folders.pop()}: ", [path.name for path in paths]
    lines = wrapped(head + ", ".join(names))
    for left in range(1, len(names)) if not whole else ():
        if len(lines) < _OF_FILES:
            break
        # Those in the middle are left out: the last ones are the report and the index.
        shown = [*names[: -2 - left], f"{left} more", *names[-2:]]
        lines = wrapped(head + ", ".join(shown))
    return "\n".join(lines)


def wrapped(line: str) -> list[str]:
    """Return a line as several of the width of a screen, indented after the first."""
    if len(line) <= COLUMNS or line.startswith(_KEPT):
        return [line]
    indent = " " * (len(line) - len(line.lstrip()) + 2)
    return wrap(
        line,
        COLUMNS,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
        drop_whitespace=True,
    )


_GREEN, _YELLOW, _RED, _BOLD, _PLAIN = (f"\x1b[{n}m" for n in (32, 33, 31, 1, 0))
_COLOURS = {
    "do not use": _RED,
    "use with care": _YELLOW,
    "use": _GREEN,
    "certified": _GREEN,
    "uncertified": _YELLOW,
    "warning": _YELLOW,
    "refused": _RED,
    "impossible": _RED,
    "fault": _RED,
}
# The word "use" is a verdict where it begins a line or stands alone in a cell.
_WORDS = "|".join(word for word in _COLOURS if word != "use")
_WORD = re.compile(rf"\b(?:{_WORDS})\b|(?m:^use(?=:))|(?<=  )use(?=  )")
_TITLE = re.compile(r"^(?=\S)(.+)$", re.MULTILINE)


def wants_colour(stream: TextIO) -> bool:
    """Return whether a stream is a terminal whose user did not request plain text."""
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    return stream.isatty() and not plain


def coloured(text: str) -> str:
    r"""Return text with its verdicts in colour and its titles, not indented, bold.

    Examples
    --------
    >>> coloured("  certified")
    '  \x1b[32mcertified\x1b[0m'
    """

    def bold(title: re.Match[str]) -> str:
        return _BOLD + title[0].replace(_PLAIN, _PLAIN + _BOLD) + _PLAIN

    shown = _WORD.sub(lambda word: _COLOURS[word[0]] + word[0] + _PLAIN, text)
    return _TITLE.sub(bold, shown)
