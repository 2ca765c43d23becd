"""Tables of text, for people (aligned) and for Markdown."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape


@dataclass(frozen=True, slots=True)
class Table:
    """A titled table with notes below it.

    Examples
    --------
    >>> print(Table("Masses", ("link", "kg"), (("arm", "2.1"),)).text())
    Masses
      link   kg
      arm   2.1
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def text(self) -> str:
        """Return the table for a terminal; numbers are aligned to the right."""
        lines = [self.title]
        if self.rows:
            widths = [
                max(len(row[i]) for row in (self.header, *self.rows))
                for i in range(len(self.header))
            ]
            right = [_numeric(row[i] for row in self.rows) for i in range(len(widths))]
            lines += [
                "  "
                + "  ".join(
                    cell.rjust(width) if numbers else cell.ljust(width)
                    for cell, width, numbers in zip(row, widths, right, strict=True)
                ).rstrip()
                for row in (self.header, *self.rows)
            ]
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])

    def markdown(self) -> str:
        """Return the table as GitHub-flavoured Markdown."""
        lines = [f"### {self.title}", ""]
        if self.rows:
            right = [
                _numeric(row[i] for row in self.rows) for i in range(len(self.header))
            ]
            lines.append(_row(self.header))
            lines.append(_row(["---:" if numbers else "---" for numbers in right]))
            lines += [_row(row) for row in self.rows]
            lines.append("")
        lines += [f"{note}\n" for note in self.notes]
        return "\n".join(lines)

    def html(self) -> str:
        """Return the table as HTML, for notebooks."""
        rows = "".join(_html_row(row, "td") for row in self.rows)
        head = _html_row(self.header, "th") if self.rows else ""
        notes = "".join(f"<p>{escape(note)}</p>" for note in self.notes)
        return (
            f"<table><caption>{escape(self.title)}</caption>"
            f"<thead>{head}</thead><tbody>{rows}</tbody></table>{notes}"
        )


def _html_row(cells: Sequence[str], tag: str) -> str:
    inner = "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells)
    return f"<tr>{inner}</tr>"


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _numeric(cells: Iterable[str]) -> bool:
    """Return whether a column holds numbers (or dashes) only."""
    return all(
        cell.strip().lstrip("+-").replace("e", "").replace("%", "")[:1].isdigit()
        or cell in ("", "-", "inf")
        for cell in cells
    )
