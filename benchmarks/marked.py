"""Parts of pages that a command writes, between two comments that name them."""

from datetime import date
from pathlib import Path


def renew(page: Path, name: str, command: str, text: str) -> None:
    """Replace the part of a page between ``<!-- name: begin -->`` and ``end``.

    The part says which command measured it, and when.
    """
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    before, found, rest = page.read_text().partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise SystemExit(f"{page}: {begin} and {end} are missing")
    said = f"Measured by `python benchmarks/{command}` on {date.today()}:"
    page.write_text(f"{before}{begin}\n{said}\n\n{text}\n{end}{after}")
