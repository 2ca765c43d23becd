"""Pages with measured figures: what they state, and how they are measured again.

    python benchmarks/pages.py                      lists pages, commands, days, commits
    python benchmarks/pages.py accuracy scarce-data runs their commands, and stamps them
    python benchmarks/pages.py --all                the same of all pages: hours

After a command, a page states the day, the commit and the machine, and a digest of each
problem file that the command used.  `tests/test_pages.py` fails where a problem file is
no longer the one of the page, and where a command has no stamp.
A few commands print figures that stand in sentences; the list says which, and the test
why.

A command that prints writes a page, too, with `add_write` and `shown_on`: on the page,
its place is between marks that have the command's name and arguments without dashes,
`<!-- servos seed 0: begin -->` and `<!-- servos seed 0: end -->`.  So a page may have
several commands, and a command several places.
"""

import argparse
import hashlib
import io
import json
import os
import platform
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, redirect_stdout
from dataclasses import dataclass
from datetime import date
from itertools import groupby
from pathlib import Path
from textwrap import indent

ROOT = Path(__file__).parent.parent
DOCS, PROBLEMS = ROOT / "docs", ROOT / "problems"
ABOUT = ("name", "description", "source", "licence")
"""Entries of a problem file that no result depends on."""

_USED, _DIGITS = "problem files", 8
_FILE = re.compile(rf"`([\w/.]+)` ([0-9a-f]{{{_DIGITS}}})")


def measured(problems: Sequence[str] = (), *, script: str | None = None) -> str:
    """Return the sentence that says how, when and with which files a page is made.

    Parameters
    ----------
    problems : sequence of str
        Problem files or their folders, within `problems/`.
    script : str, optional
        Command's arguments, within `benchmarks/`; by default the script that runs.
    """
    if script is None:
        script = str(Path(sys.argv[0]).resolve().relative_to(Path(__file__).parent))
    said = f"Measured by `python benchmarks/{script}`{stamp()}"
    if not problems:
        return said
    files = ",\n".join(f"`{name}` {digest(name)}" for name in problems)
    return f"{said} with {_USED}\n{files}"


def stamp() -> str:
    """Return the day, the commit and the machine, as a page states them."""
    command = [
        "git",
        "-C",
        str(ROOT),
        "describe",
        "--always",
        "--dirty=+",
        "--abbrev=8",
    ]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    commit = found.stdout.strip().rpartition("-g")[2] or "unknown"
    return f" on {date.today()} (commit {commit}; {machine()})"


def machine() -> str:
    """Return the processor and the number of cores."""
    info = Path("/proc/cpuinfo")
    name = processor(info.read_text() if info.exists() else "")
    return f"{name or platform.machine()}, {os.cpu_count()} cores"


def processor(info: str) -> str:
    """Return the name in a text of ``/proc/cpuinfo``, without its marks of trade.

    Their brackets would end the stamp.
    """
    named = re.search(r"^model name\s*: (.*)$", info, re.MULTILINE)
    return " ".join(re.sub(r"\(\w+\)", " ", named[1]).split()) if named else ""


@dataclass(frozen=True, slots=True)
class Measurement:
    """A command that a page names, and when it was run.

    Parameters
    ----------
    script, arguments : str
        Within `benchmarks/`.
    stamped : str
        Day, commit and machine; empty if the page does not state them.
    """

    page: Path
    script: str
    arguments: str
    stamped: str

    @property
    def writes(self) -> bool:
        """Whether the command writes the page."""
        if "add_write(" not in self._text():
            return "--write" in self._text()
        words = shlex.split(self.arguments)
        return _marks(mark_of(self.script, words))[0] in self.page.read_text()

    def _text(self) -> str:
        return (ROOT / "benchmarks" / self.script).read_text()

    def words(self) -> list[str]:
        """Return the command that measures again."""
        words = shlex.split(self.arguments)
        words += ["--write", str(self.page)] * self.writes
        if "--readme" in self._text():
            words += ["--readme", str(ROOT / "README.md")]
        return [sys.executable, str(ROOT / "benchmarks" / self.script), *words]


_COMMAND = re.compile(r"`python\s+benchmarks/(\w+\.py)([^`]*)`(\s+on \S+ \([^)]*\))?")
NO_MEASUREMENT = ("--problem FOLDER", "--robots FILE.toml")
"""Arguments of commands that pages name for another reason."""


def _own(arguments: str) -> str:
    """Return arguments without the page to write."""
    return " ".join(re.sub(r"--write( \S+)?", "", " ".join(arguments.split())).split())


def measurements(docs: Path = DOCS) -> tuple[Measurement, ...]:
    """Return the commands that measured what pages show."""
    found: dict[tuple[str, str, str], Measurement] = {}
    for page in sorted(docs.glob("*.md")):
        for script, given, stamped in _COMMAND.findall(page.read_text()):
            words = _own(given)
            if script == Path(__file__).name or words in NO_MEASUREMENT:
                continue
            one = Measurement(page, script, words, " ".join(stamped.split()))
            place = (page.stem, script, words)
            if place not in found or not found[place].stamped:
                found[place] = one
    return tuple(found.values())


def stamp_page(page: Path, script: str, arguments: str, said: str) -> None:
    """State day, commit and machine after each mention of a command."""

    def stamped(match: re.Match[str]) -> str:
        if (match[1], _own(match[2])) != (script, arguments):
            return match[0]
        return match[0].removesuffix(match[3] or "") + said

    page.write_text(_COMMAND.sub(stamped, page.read_text()))


def digests_on(page: str) -> dict[str, list[str]]:
    """Return the digests that a page states, by problem file."""
    found: dict[str, list[str]] = {}
    for part in re.split(rf"with {_USED}", page)[1:]:
        for name, seen in _FILE.findall(part.partition("\n\n")[0]):
            found.setdefault(name, []).append(seen)
    return found


def digest(problem: str, folder: Path = PROBLEMS) -> str:
    """Return a digest of a problem's settings and of the files beside it.

    Comments and the texts of `ABOUT` do not count.
    """
    path = folder / problem
    path = path if path.suffix == ".toml" else path / "problem.toml"
    settings = tomllib.loads(path.read_text())
    for word in ABOUT:
        settings.pop(word, None)
    whole = hashlib.sha256(json.dumps(settings, sort_keys=True, default=str).encode())
    for file in sorted(path.parent.iterdir()):
        if file.suffix not in (".toml", "") and file.is_file():
            whole.update(file.name.encode() + file.read_bytes())
    return whole.hexdigest()[:_DIGITS]


@contextmanager
def written_to(
    page: Path | None,
    name: str,
    problems: Sequence[str] = (),
    *,
    script: str | None = None,
    form: Callable[[str], str] = str.strip,
) -> Iterator[None]:
    """Put what is printed inside also between the marks of a page, if there is one.

    The page says which command measured it, when, and with which problem files.

    Parameters
    ----------
    script : str, optional
        See `measured`.
    form : callable
        From what was printed to what the page shows.

    Raises
    ------
    ValueError
        If the page has no such marks.
    """
    if page is None:
        yield
        return
    _between(page.read_text(), name, page)
    printed = _Both()
    with redirect_stdout(printed):
        yield
    before, after = _between(page.read_text(), name, page)
    said = f"{measured(problems, script=script)}:"
    *_, above = before.removesuffix("\n").rpartition("\n")
    text = f"{said}\n\n{form(printed.getvalue())}\n"
    shown = indent(text, " " * (len(above) - len(above.lstrip())))
    page.write_text(f"{before}{shown}{after}")


def add_write(parser: argparse.ArgumentParser) -> None:
    """Give a command the option `--write`, for `shown_on`."""
    text = "put what is printed between this command's marks of a page"
    parser.add_argument("--write", type=Path, metavar="PAGE", help=text)


def shown_on(
    page: Path | None, problems: Sequence[str] = ()
) -> AbstractContextManager[None]:
    """Put what the running command prints on a page, see `written_to` and `mark_of`.

    Tables stay tables; other lines are shown as they are printed.
    """
    script, words = Path(sys.argv[0]).name, _given(sys.argv[1:])
    named = mark_of(script, words)
    said = " ".join([script, *map(_quoted, words)])
    return written_to(page, named, problems, script=said, form=_as_markdown)


def mark_of(script: str, words: Sequence[str]) -> str:
    """Return the name of the marks of a command.

    Examples
    --------
    >>> mark_of("servos.py", ["--seed", "0", "--held-out", "kp100"])
    'servos seed 0 held-out kp100'
    """
    bare = (word.lstrip("-") for word in words)
    return " ".join([script.removesuffix(".py"), *bare])


def _given(words: Sequence[str]) -> list[str]:
    """Return arguments without the page to write."""
    found = list(words)
    if "--write" in found:
        place = found.index("--write")
        del found[place : place + 2]
    return found


def _quoted(word: str) -> str:
    """Return an argument as a page shows it."""
    return f'"{word}"' if " " in word else word


def _as_markdown(printed: str) -> str:
    """Return printed lines as Markdown: tables as tables, the others as text."""
    parts = []
    lines = [line.rstrip() for line in printed.strip("\n").splitlines()]
    for table, some in groupby(lines, lambda line: line.startswith("|")):
        text = "\n".join(some).strip("\n")
        if text:
            parts.append(text if table else f"```none\n{text}\n```")
    return "\n\n".join(parts)


class _Both(io.StringIO):
    """Keeps what is written, and shows it."""

    def write(self, text: str) -> int:
        sys.__stdout__.write(text)
        sys.__stdout__.flush()
        return super().write(text)


def _marks(name: str) -> tuple[str, str]:
    """Return what stands before and after what a command writes."""
    return f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->"


def _between(text: str, name: str, page: Path) -> tuple[str, str]:
    """Return what stands before and after a table, marks and indents included."""
    begin, end = _marks(name)
    before, found, rest = text.partition(begin)
    inside, closed, after = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"{page}: no marks {begin.strip()} and {end}")
    *_, left = inside.rpartition("\n")
    return before + begin, left + end + after


def main() -> None:
    """List pages, or measure some again."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("pages", nargs="*", help="such as accuracy; by default a list")
    parser.add_argument("--all", action="store_true", help="measure all pages again")
    options = parser.parse_args()
    every = measurements()
    known = {one.page.stem for one in every}
    if unknown := set(options.pages) - known:
        parser.error(
            f"no measured page {', '.join(unknown)}; there are {sorted(known)}"
        )
    chosen = [one for one in every if options.all or one.page.stem in options.pages]
    for one in every if not chosen else ():
        how = "" if one.writes else " (prints)"
        print(f"{one.page.stem}: {one.script} {one.arguments}{how} {one.stamped}")
    for one in chosen:
        said = stamp()
        print(shlex.join(one.words()), flush=True)
        subprocess.run(one.words(), check=True)
        if one.writes:
            stamp_page(one.page, one.script, one.arguments, said)


if __name__ == "__main__":
    main()
