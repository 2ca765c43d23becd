"""``consistent-id completion SHELL``: a script for the shell, written from the parser.

The script holds all names, so that a press of the key starts no Python.
"""

import argparse
import re
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from consistent_id.cli.answers import Answer, show
from consistent_id.cli.options import add_command

_MORE = """Print a script that completes commands, options, choices and files:

  bash   eval "$(consistent-id completion bash)"     in ~/.bashrc
  zsh    eval "$(consistent-id completion zsh)"      in ~/.zshrc, after compinit
  fish   consistent-id completion fish | source      in ~/.config/fish/config.fish"""
_EXAMPLES = """
consistent-id completion bash > ~/.local/share/bash-completion/completions/consistent-id
"""


class _Option(NamedTuple):
    flag: str
    help: str
    takes: bool  # a value
    choices: tuple[str, ...]


class _Command(NamedTuple):
    name: str
    help: str
    options: tuple[_Option, ...]
    choices: tuple[str, ...]  # of its argument, if they are not files


def add_completion(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = add_command(
        commands,
        "completion",
        "print a script for tab completion",
        run_completion,
        more=_MORE,
        examples=_EXAMPLES,
    )
    command.add_argument("shell", choices=tuple(_SCRIPTS))
    # The parser's commands; the parser itself is complete when this is run.
    command.set_defaults(commands=commands)


def run_completion(options: argparse.Namespace) -> int:
    """Print a shell's script; return the exit code."""
    script = _SCRIPTS[options.shell](list(_commands(options.commands)))
    return show(options, Answer(0, script, {"shell": options.shell, "script": script}))


def _commands(commands: Any) -> Iterator[_Command]:
    about = {entry.dest: entry.help or "" for entry in commands._get_subactions()}
    for name, parser in commands.choices.items():
        options: list[_Option] = []
        choices: tuple[str, ...] = ()
        for action in parser._actions:
            found = tuple(map(str, action.choices or ()))
            if not action.option_strings:
                choices = choices or found
                continue
            text = re.sub(r"\s+", " ", (action.help or "").replace("%%", "%"))
            flag = action.option_strings[-1]
            options.append(_Option(flag, text, action.nargs != 0, found))
        yield _Command(name, about[name], tuple(options), choices)


def _bash(commands: list[_Command]) -> str:
    cases = "\n".join(f"        {_bash_case(command)}" for command in commands)
    names = " ".join(command.name for command in commands)
    return f"""_consistent_id() {{
    local word="${{COMP_WORDS[COMP_CWORD]}}" words=""
    local before="${{COMP_WORDS[COMP_CWORD-1]}}"
    COMPREPLY=()
    if [ "$COMP_CWORD" -eq 1 ]; then
        COMPREPLY=($(compgen -W "{names} --help --version" -- "$word"))
        return
    fi
    case "${{COMP_WORDS[1]}} $before" in
{_bash_values(commands)}
    esac
    case "${{COMP_WORDS[1]}}" in
{cases}
    esac
    if [ -n "$words" ]; then
        COMPREPLY=($(compgen -W "$words" -- "$word"))
    fi
}}
complete -o default -o bashdefault -F _consistent_id consistent-id"""


def _bash_case(command: _Command) -> str:
    """Return what one command offers; where that is nothing, bash offers files."""
    flags = " ".join(option.flag for option in command.options)
    offered = f'[[ "$word" == -* ]] && words="{flags}"'
    if command.choices:
        offered += f' || words="{" ".join(command.choices)}"'
    return f"{command.name}) {offered} ;;"


def _bash_values(commands: list[_Command]) -> str:
    lines = [
        f'        "{command.name} {option.flag}") COMPREPLY=($(compgen -W '
        f'"{" ".join(option.choices)}" -- "$word")); return ;;'
        for command in commands
        for option in command.options
        if option.choices
    ]
    return "\n".join(lines)


def _zsh(commands: list[_Command]) -> str:
    about = " ".join(_quoted(f"{c.name}:{c.help}") for c in commands)
    cases = "\n".join(f"        {c.name}) {_zsh_arguments(c)} ;;" for c in commands)
    return f"""#compdef consistent-id
_consistent_id() {{
    if (( CURRENT == 2 )); then
        local -a commands=({about})
        _describe command commands
        return
    fi
    local name=$words[2]
    shift words
    (( CURRENT-- ))
    case $name in
{cases}
    esac
}}
compdef _consistent_id consistent-id"""


def _zsh_arguments(command: _Command) -> str:
    specs = []
    for option in command.options:
        text = re.sub(r"([\[\]:\\])", r"\\\1", option.help)
        value = f":value:{_zsh_value(option.choices)}" if option.takes else ""
        specs.append(_quoted(f"*{option.flag}[{text}]{value}"))
    specs.append(_quoted(f"*:argument:{_zsh_value(command.choices)}"))
    return "_arguments " + " ".join(specs)


def _zsh_value(choices: tuple[str, ...]) -> str:
    return f"({' '.join(choices)})" if choices else "_files"


def _fish(commands: list[_Command]) -> str:
    lines = ["complete -c consistent-id -n __fish_use_subcommand -f"]
    for command in commands:
        about = _quoted(command.help)
        lines.append(
            "complete -c consistent-id -n __fish_use_subcommand "
            f"-a {command.name} -d {about}"
        )
        seen = f"'__fish_seen_subcommand_from {command.name}'"
        if command.choices:
            offered = _quoted(" ".join(command.choices))
            lines.append(f"complete -c consistent-id -n {seen} -f -a {offered}")
        for option in command.options:
            line = f"complete -c consistent-id -n {seen} -l {option.flag[2:]}"
            if option.choices:
                line += f" -x -a {_quoted(' '.join(option.choices))}"
            elif option.takes:
                line += " -r"
            lines.append(f"{line} -d {_quoted(option.help)}")
    return "\n".join(lines)


def _quoted(text: str) -> str:
    """Return text as one word of a shell."""
    return "'" + text.replace("'", "'\\''") + "'"


_SCRIPTS: dict[str, Callable[[list[_Command]], str]] = {
    "bash": _bash,
    "zsh": _zsh,
    "fish": _fish,
}
