"""A problem file rewritten: what does not change stays as its author wrote it."""

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path

from consistent_id.errors import ProblemError
from consistent_id.problems.file import ProblemTable, problem_table

_MOST_LINES = 1000  # three times the longest that was written by hand; more take long


@dataclass(frozen=True, slots=True)
class Statement:
    """A header, or a key with its value.

    Parameters
    ----------
    above : tuple of str
        Blank lines and comments before it.
    lines : tuple of str
        Several where an array goes over several lines.
    content : dict
        What TOML makes of it alone.
    """

    above: tuple[str, ...]
    lines: tuple[str, ...]
    content: dict[str, object]

    @property
    def is_header(self) -> bool:
        """Whether it opens a table."""
        return self.lines[0].lstrip().startswith("[")

    @property
    def path(self) -> tuple[str, ...]:
        """Key of a header, such as ``("data", "recordings")``."""
        names, inner = [], self.content
        while inner:
            ((name, value),) = inner.items()
            names.append(name)
            value = value[0] if isinstance(value, list) else value
            inner = value if isinstance(value, dict) else {}
        return tuple(names)


@dataclass(frozen=True, slots=True)
class Section:
    """A table of the file: its header, none for the first, and its keys."""

    header: Statement | None
    body: tuple[Statement, ...] = ()

    @property
    def path(self) -> tuple[str, ...]:
        """Key of the header."""
        return () if self.header is None else self.header.path

    def lines(self) -> Iterator[str]:
        """Yield the text."""
        for statement in (*([self.header] if self.header else []), *self.body):
            yield from (*statement.above, *statement.lines)


def rewritten(
    text: str, fresh: str, changed: Sequence[str], expected: ProblemTable
) -> str:
    """Return a problem file's text with other tables, comments kept.

    A table that does not change stays as it was written; the comment above it gives
    way to one of the fresh text.  Of a table that changes, lines stay whose values do.

    Parameters
    ----------
    text : str
        As the author wrote it.
    fresh : str
        The whole file written anew.
    changed : sequence of str
        Tables that the fresh text has otherwise, such as ``"data.preparation"``.
    expected : ProblemTable
        What the file has to say.  Where tables are written in a form that cannot be
        replaced one by one, or lines are very many, the fresh text is returned.
    """
    if text.count("\n") > _MOST_LINES:
        return fresh
    written, tail = _sections(text)
    anew, _ = _sections(fresh)
    groups = [tuple(path.split(".")) for path in changed]
    sections = list(_unchanged(written, anew, groups))
    for group in groups:
        sections = _with_group(sections, written, anew, group)
    lines = [line for section in sections for line in section.lines()]
    kept = "\n".join([*lines, *tail]).strip() + "\n"
    try:
        said = problem_table(kept, Path("problem.toml"))
    except ProblemError:
        return fresh
    return kept if said == expected else fresh


def _sections(text: str) -> tuple[list[Section], tuple[str, ...]]:
    """Return the tables in their order, and what comes after the last key."""
    sections, above = [Section(None)], []
    lines = iter(text.splitlines())
    for line in lines:
        if not line.strip() or line.lstrip().startswith("#"):
            above.append(line)
            continue
        statement = _statement(line, lines, tuple(above))
        above = []
        if statement.is_header:
            sections.append(Section(statement))
        else:
            last = sections[-1]
            sections[-1] = replace(last, body=(*last.body, statement))
    return sections, tuple(above)


def _statement(line: str, more: Iterator[str], above: tuple[str, ...]) -> Statement:
    """Return the statement that a line begins; it is whole when TOML can read it."""
    lines = [line]
    while True:
        try:
            content = tomllib.loads("\n".join(lines))
        except tomllib.TOMLDecodeError:
            following = next(more, None)
            if following is None:
                raise
            lines.append(following)
        else:
            return Statement(above, tuple(lines), content)


def _unchanged(
    written: Sequence[Section],
    anew: Sequence[Section],
    groups: Sequence[tuple[str, ...]],
) -> Iterator[Section]:
    """Yield what stays, under comments of the fresh text where it has some."""
    comments = {
        s.path: above
        for s in anew
        if s.header is not None and (above := _comment(s.header))
    }
    for section in written:
        if any(_is_below(section.path, group) for group in groups):
            continue
        above = comments.get(section.path, ())
        header = section.header
        if header is not None and above:
            own = len(header.above) - len(_comment(header))
            header = replace(header, above=(*header.above[:own], *above))
        yield replace(section, header=header)


def _comment(header: Statement) -> tuple[str, ...]:
    """Return the comment lines that stand directly above a header."""
    blanks = [i for i, line in enumerate(header.above) if not line.strip()]
    return header.above[blanks[-1] + 1 :] if blanks else header.above


def _with_group(
    sections: list[Section],
    written: Sequence[Section],
    anew: Sequence[Section],
    group: tuple[str, ...],
) -> list[Section]:
    """Return sections with the fresh ones of a group, where its first one was."""
    fresh = [s for s in anew if _is_below(s.path, group)]
    if not fresh:
        return sections
    old = {s.path: s for s in written if _is_below(s.path, group)}
    merged = [_with_lines(s, old.get(s.path)) for s in fresh]
    order = written if old else anew
    first = next(i for i, s in enumerate(order) if _is_below(s.path, group))
    before = [s.path for s in order[:first]]
    place = reduce(
        lambda at, i: i + 1 if sections[i].path in before else at,
        range(len(sections)),
        0,
    )
    return [*sections[:place], *merged, *sections[place:]]


def _with_lines(fresh: Section, old: Section | None) -> Section:
    """Return a fresh section with the author's lines of keys that have not changed."""
    known = () if old is None else old.body
    body = (
        next((line for line in known if line.content == statement.content), statement)
        for statement in fresh.body
    )
    return replace(fresh, body=tuple(body))


def _is_below(path: Sequence[str], group: Sequence[str]) -> bool:
    return tuple(path[: len(group)]) == tuple(group)


def changed_tables(
    old: ProblemTable, new: ProblemTable, paths: Sequence[str]
) -> list[str]:
    """Return which tables of a problem file differ.

    Parameters
    ----------
    paths : sequence of str
        Of the tables that may.
    """
    return [p for p in paths if _at(old, p) != _at(new, p)]


def _at(table: object, path: str) -> object:
    return reduce(
        lambda inner, key: None if inner is None else getattr(inner, key),
        path.split("."),
        table,
    )
