"""The directive ``shell-help``: what the tool itself says of its commands."""

import argparse
import os

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx

from consistent_id.cli.tool import tool_parser


class ShellHelp(Directive):
    """A section for each command, with its help."""

    def run(self) -> list[nodes.Node]:
        """Return the sections."""
        os.environ["COLUMNS"] = "80"  # the width that argparse breaks lines for
        parser = tool_parser()
        commands = next(
            action.choices
            for action in parser._actions
            if isinstance(action, argparse._SubParsersAction)
        )
        return [_section(name, command) for name, command in commands.items()]


def _section(name: str, command: argparse.ArgumentParser) -> nodes.section:
    section = nodes.section(ids=[f"command-{name}"], names=[f"command-{name}"])
    text = command.format_help()
    section += nodes.title(text=name)
    section += nodes.literal_block(text, text, language="none")
    return section


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("shell-help", ShellHelp)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
