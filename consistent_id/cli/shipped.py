"""What the package brings with it: examples, documentation, a script for the shell.

``consistent-id demo`` copies the example problems; ``consistent-id help`` prints a page
of the documentation, the help of a command, the meaning of a reason, or a JSON schema;
``consistent-id completion`` prints a script, written by shtab, that contains all names,
so completion does not start Python.
"""

import argparse
import json
import re
import shlex
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from consistent_id.cli.answers import Answer, show
from consistent_id.cli.options import WRITES, Option, add_command
from consistent_id.errors import ProblemError

_OF_DEMO = """The simulated RX-60 and quadruped and the KUKA KR300 are complete; the
README among them says where the recordings of the other robots are."""
_DEMOS = """
consistent-id demo
consistent-id compare problems/rx60
consistent-id compare problems/kuka_kr300
"""

_OF_COMPLETION = """Print a script that completes commands, options, choices and files:

  bash   eval "$(consistent-id completion bash)"     in ~/.bashrc
  zsh    eval "$(consistent-id completion zsh)"      in ~/.zshrc, after compinit
  fish   consistent-id completion fish | source      in ~/.config/fish/config.fish"""
_SHELLS = """
consistent-id completion bash > ~/.local/share/bash-completion/completions/consistent-id
"""


def add_demo(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_demo,
        Option("--output FOLDER", "folder to write to", default=Path("problems")),
        *WRITES,
        more=_OF_DEMO,
        examples=_DEMOS,
        reads=False,
    )


def run_demo(options: argparse.Namespace) -> int:
    """Copy the problems; return the exit code.

    Existing files are kept if they are equal, and refused if not.
    """
    from consistent_id._support.files import require_replaceable, write_atomically

    source, folder = _problems(), options.output
    files = sorted(path for path in source.rglob("*") if path.is_file())
    contents = {folder / path.relative_to(source): path.read_bytes() for path in files}
    if not options.dry_run:
        for path, content in contents.items():
            require_replaceable(path, content)

    def write() -> Sequence[Path]:
        for path, content in contents.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, content)
        return list(contents)

    names = sorted(path.parent.name for path in files if path.name == "problem.toml")
    text = f"Problems in {folder}: {', '.join(names)}\n" + "\n".join(
        f"try: consistent-id compare {shlex.quote(str(folder / name))}"
        for name in _COMPLETE
    )
    record = {
        "format": "consistent_id demo 1",
        "folder": str(folder),
        "written": [str(path) for path in contents],
    }
    return show(options, Answer(0, text, record, write))


_COMPLETE = ("rx60", "kuka_kr300")


def _problems() -> Path:
    """Return the folder of problems, of a wheel or of the source tree."""
    package = Path(__file__).parents[1]
    for folder in (package / "_problems", package.parent / "problems"):
        if (folder / "rx60" / "problem.toml").is_file():
            return folder
    raise ProblemError(
        f"{package / '_problems'} is missing; install the package again, or copy "
        "problems/ of its source archive"
    )


_OF_HELP = """TOPIC is a page of the documentation, a command, a verdict, or the kind
of a reason, in quotes; or a JSON schema of what --json prints. Without a topic, all
pages are listed; `schemas` lists the schemas."""
_TOPICS = """
consistent-id help
consistent-id help bad-result
consistent-id help "mostly guessed"
consistent-id help identify
consistent-id help study-1 > study-1.json
"""
_WIDTH = 88
_REASONS = "bad-result"
_WITH_KINDS = (_REASONS, "payload", "servos", "what-verdicts-mean")
"""Pages with tables of reasons and verdicts; a later one says more of its own."""


def add_help(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_help,
        Option("[topic]", "page, command, verdict, kind of a reason, or schema"),
        more=_OF_HELP,
        examples=_TOPICS,
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
    schemas = _schemas()
    if name == "schemas":
        return _listed_schemas(schemas)
    if (schema := _schema_name(name)) in schemas:
        return json.dumps(_whole(schemas[schema], schemas), indent=2)
    commands = _commands(tool_parser("help"))
    if name in commands:
        return _commands(tool_parser(name))[name].format_help().rstrip()
    texts = [pages[page].read_text(encoding="utf-8") for page in _WITH_KINDS]
    kinds = {kind: entry for text in texts for kind, entry in _kinds(text).items()}
    if name in kinds:
        return kinds[name]
    known = dict.fromkeys((*pages, *commands, *kinds, *schemas))
    raise ProblemError(
        f"no page, command, reason or schema {topic!r}; {did_you_mean(name, known)}"
    )


def _commands(parser: Any) -> dict[str, argparse.ArgumentParser]:
    """Return the parser of each command."""
    (commands,) = parser._subparsers._group_actions
    return dict(commands.choices)


def _kinds(page: str) -> dict[str, str]:
    r"""Return the entry of each kind in a page's tables and in its list of notes.

    Examples
    --------
    >>> table = "| kind | means | do |\n|---|---|---|\n"
    >>> print(_kinds(f"{table}| `misfit`, `drift` | it is large | look |\n")["drift"])
    drift
      means: it is large
      to do: look
    """
    tables = re.findall(r"^\| \w+ \| [^|]+ \| do \|\n((?:\|.*\n)+)", page, re.M)
    row = re.compile(r"^\| (`[^|]+) \| ([^|]+) \| ([^|]+) \|$", re.M)
    rows = [cells for table in tables for cells in row.findall(table)]
    notes = re.findall(r"^- (`[^:]+): (.+?)(?=^- |^$|\Z)", page, re.M | re.S)
    found: dict[str, str] = {}
    for named, means, *to_do in (*rows, *notes):
        said = [f"means: {_plain(means)}", *(f"to do: {_plain(do)}" for do in to_do)]
        lines = [
            textwrap.fill(
                " ".join(text.split()),
                _WIDTH,
                initial_indent="  ",
                subsequent_indent="    ",
            )
            for text in said
        ]
        for kind in re.findall(r"`([^`]+)`", named):
            found.setdefault(kind, "\n".join([kind, *lines]))
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


def _schema_name(topic: str) -> str:
    """Return a schema's name, from it, its file or the ``format`` of a JSON object.

    Examples
    --------
    >>> _schema_name("consistent_id model gains 1"), _schema_name("schemas/lint-1.json")
    ('model-gains-1', 'lint-1')
    """
    name = topic.removeprefix("schemas/").removesuffix(".json")
    return name.removeprefix("consistent_id ").replace(" ", "-")


def _schemas() -> dict[str, dict[str, Any]]:
    """Return the JSON schemas of what commands print with ``--json``, by name."""
    files = sorted((_docs() / "schemas").glob("*.json"))
    return {file.stem: json.loads(file.read_text(encoding="utf-8")) for file in files}


def _listed_schemas(schemas: dict[str, dict[str, Any]]) -> str:
    """Return the names and the titles of schemas, and where their files are."""
    wide = max(map(len, schemas))
    lines = [f"  {name:{wide}}  {schema['title']}" for name, schema in schemas.items()]
    head = "JSON schemas of what --json prints: consistent-id help NAME"
    return "\n".join([head, *lines, "", f"Files: {_docs() / 'schemas'}"])


def _whole(schema: dict[str, Any], schemas: dict[str, dict[str, Any]]) -> Any:
    """Return a schema with all that it refers to, so that it needs no other file."""
    parts: dict[str, dict[str, Any]] = {}
    left = [schema]
    while left:
        for name in re.findall(r'"\$ref": "([\w-]+)\.json"', json.dumps(left.pop())):
            if name not in parts:
                parts[name] = schemas[name]
                left.append(schemas[name])
    return {**schema, "$defs": dict(sorted(parts.items()))} if parts else schema


def _pages() -> dict[str, Path]:
    """Return the pages of the documentation, and its list for agents, by name."""
    folder = _docs()
    pages = {path.stem: path for path in sorted(folder.glob("*.md"))}
    return {**pages, "llms.txt": folder / "llms.txt"}


def _docs() -> Path:
    """Return the folder of the documentation, of a wheel or of the source tree."""
    package = Path(__file__).parents[1]
    for folder in (package / "_docs", package.parent / "docs"):
        if (folder / f"{_REASONS}.md").is_file():
            return folder
    raise ProblemError(
        f"{package / '_docs'} is missing; install the package again, or read docs/ of "
        "its source archive"
    )


def add_completion(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_completion,
        Option(
            "shell",
            "shell for which the script is printed",
            choices=("bash", "zsh", "fish"),
        ),
        more=_OF_COMPLETION,
        examples=_SHELLS,
        reads=False,
    )


def run_completion(options: argparse.Namespace) -> int:
    """Print a shell's script; return the exit code."""
    import shtab

    parser: Any = options.tool_parser()
    (commands,) = parser._subparsers._group_actions
    for command in commands.choices.values():
        for action in command._actions:
            if action.nargs != 0 and not action.choices:
                action.complete = shtab.FILE
    script = shtab.complete(parser, options.shell).rstrip()
    name = "consistent_id completion 1"
    record = {"format": name, "shell": options.shell, "script": script}
    return show(options, Answer(0, script, record, whole=True))
