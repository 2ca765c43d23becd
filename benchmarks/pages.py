"""Pages whose tables a command writes, between two marks of the table's name.

A page states the command, the day, and a digest of each problem file that it used.
`tests/test_pages.py` fails where a problem file is no longer the one of the page.
"""

import hashlib
import io
import json
import re
import sys
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from datetime import date
from pathlib import Path

PROBLEMS = Path(__file__).parent.parent / "problems"
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
    said = f"Measured by `python benchmarks/{script}` on {date.today()}"
    if not problems:
        return said
    files = ",\n".join(f"`{name}` {digest(name)}" for name in problems)
    return f"{said} with {_USED}\n{files}"


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
