"""Pages whose tables a command writes, between two marks of the table's name."""

import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from datetime import date
from pathlib import Path


@contextmanager
def written_to(page: Path | None, name: str) -> Iterator[None]:
    """Put what is printed inside also between the marks of a page, if there is one.

    The page says which command measured it, and when.

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
    script = Path(sys.argv[0]).resolve().relative_to(Path(__file__).parent)
    said = f"Measured by `python benchmarks/{script}` on {date.today()}:"
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
