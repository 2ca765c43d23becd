"""``consistent-id help TOPIC``: a page of the documentation, a command, or a reason."""

import argparse
import re
import textwrap
from pathlib import Path
from typing import Any

from consistent_id.cli.answers import Answer, show
from consistent_id.cli.options import Option, add_command
from consistent_id.errors import ProblemError

_MORE = """TOPIC is a page of the documentation, a command, or the kind of a reason or a
finding, in quotes. Without a topic, all pages are listed."""
_EXAMPLES = """
consistent-id help
consistent-id help bad-result
consistent-id help "mostly guessed"
consistent-id help identify
"""
_WIDTH = 88
_REASONS = "bad-result"  # the page with a table of all kinds of reasons


def add_help(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_help,
        Option("[topic]", "page, command, or kind of a reason"),
        more=_MORE,
        examples=_EXAMPLES,
        reads=False,
    )


def run_help(options: argparse.Namespace) -> int:
    """Print a text; return the exit code."""
    topic, pages = options.topic, _pages()
    text = _listed(pages) if topic is None else _text(topic, pages, options.tool_parser)
    record = {"format": "consistent_id help 1", "topic": topic, "text": text}
    return show(options, Answer(0, text, record, whole=True))


def _text(topic: str, pages: dict[str, Path], tool_parser: Any) -> str:
    """Return the help text of a topic.

    Raises
    ------
    ProblemError
        If there is no such topic; with those that are alike.
    """
    from consistent_id.robot.parameters import did_you_mean

    name = topic.removeprefix("docs/").removesuffix(".md")
    if name in pages:
        return pages[name].read_text(encoding="utf-8").rstrip()
    commands = _commands(tool_parser("help"))
    if name in commands:
        return _commands(tool_parser(name))[name].format_help().rstrip()
    kinds = _kinds(pages[_REASONS].read_text(encoding="utf-8"))
    if name in kinds:
        return kinds[name]
    known = (*pages, *commands, *kinds)
    raise ProblemError(
        f"no page, command or reason {topic!r}; {did_you_mean(name, known)}"
    )


def _commands(parser: Any) -> dict[str, argparse.ArgumentParser]:
    """Return the parser of each command."""
    (commands,) = parser._subparsers._group_actions
    return dict(commands.choices)


def _kinds(page: str) -> dict[str, str]:
    """Return the entry of each kind in the table of reasons.

    Examples
    --------
    >>> print(_kinds("| `misfit`, `drift` | it is large | look |")["drift"])
    drift
      means: it is large
      to do: look
    """
    found: dict[str, str] = {}
    for cells in re.findall(r"^\| ([^|]*`[^|]*) \| ([^|]+) \| ([^|]+) \|$", page, re.M):
        for kind in re.findall(r"`([^`]+)`", cells[0]):
            parts = zip(("means", "to do"), map(_plain, cells[1:]), strict=True)
            said = [
                textwrap.fill(
                    f"{word}: {text}",
                    _WIDTH,
                    initial_indent="  ",
                    subsequent_indent="    ",
                )
                for word, text in parts
            ]
            found.setdefault(kind, "\n".join([kind, *said]))
    return found


def _plain(text: str) -> str:
    """Return a text of Markdown without links."""
    return re.sub(r"\[([^\]]+)\]\(([^)#]*?)(?:\.md)?(#[^)]*)?\)", r"\1", text)


def _listed(pages: dict[str, Path]) -> str:
    """Return the names and the titles of pages."""
    wide = max(map(len, pages))
    lines = []
    for name, path in pages.items():
        title = path.read_text(encoding="utf-8").partition("\n")[0]
        lines.append(f"  {name:{wide}}  {title.lstrip('# ')}")
    return "\n".join(
        ["Pages, as text: consistent-id help NAME", *lines, "", "Begin with: start"]
    )


def _pages() -> dict[str, Path]:
    """Return the pages of the documentation, of a wheel or of the source tree."""
    package = Path(__file__).parents[1]
    for folder in (package / "_docs", package.parent / "docs"):
        if (folder / f"{_REASONS}.md").is_file():
            return {path.stem: path for path in sorted(folder.glob("*.md"))}
    raise ProblemError(
        f"{package / '_docs'} is missing; install the package again, or read docs/ of "
        "its source archive"
    )
