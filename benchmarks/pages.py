"""Pages with measured figures: what they state, and how they are measured again.

    python benchmarks/pages.py                      lists pages, commands, days, commits
    python benchmarks/pages.py accuracy scarce-data runs their commands, and stamps them
    python benchmarks/pages.py --all                the same of all pages: hours

After a command, a page states the day, the commit and the machine, and a digest of each
problem file that the command used.  `tests/test_pages.py` fails where a problem file is
no longer the one of the page, and where a command has no stamp.  Stamps without a
machine are older than this rule: their commit is the one that brought the figures.
Some commands print what is put into the page by hand; the list says which.
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
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from datetime import date
from pathlib import Path

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
    text = info.read_text() if info.exists() else ""
    named = re.search(r"^model name\s*: (.*)$", text, re.MULTILINE)
    name = named[1].strip() if named else platform.machine()
    return f"{name}, {os.cpu_count()} cores"


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
        return "--write" in self._text()

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


def stamp_page(page: Path, script: str, said: str) -> None:
    """State day, commit and machine after each mention of a script's command."""

    def stamped(match: re.Match[str]) -> str:
        if match[1] != script or _own(match[2]) in NO_MEASUREMENT:
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
    page: Path | None, name: str, problems: Sequence[str] = ()
) -> Iterator[None]:
    """Put what is printed inside also between the marks of a page, if there is one.

    The page says which command measured it, when, and with which problem files.

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
    said = f"{measured(problems)}:"
    page.write_text(f"{before}{said}\n\n{printed.getvalue().strip()}\n{after}")


class _Both(io.StringIO):
    """Keeps what is written, and shows it."""

    def write(self, text: str) -> int:
        sys.__stdout__.write(text)
        sys.__stdout__.flush()
        return super().write(text)


def _between(text: str, name: str, page: Path) -> tuple[str, str]:
    """Return what stands before and after a table, marks included."""
    begin, end = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->"
    before, found, rest = text.partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"{page}: no marks {begin.strip()} and {end}")
    return before + begin, end + after


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
            stamp_page(one.page, one.script, said)


if __name__ == "__main__":
    main()
