"""Directives of what the tool itself says: ``shell-help`` and ``stated-options``."""

import argparse
import os

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from consistent_id.cli.tool import tool_parser
from consistent_id.problems.statement import declarations


class ShellHelp(Directive):
    """The help of the command that is named."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the help as it stands in a terminal."""
        os.environ["COLUMNS"] = "80"  # the width that argparse breaks lines for
        (name,) = self.arguments
        commands = next(
            action.choices
            for action in tool_parser(name)._actions
            if isinstance(action, argparse._SubParsersAction)
        )
        text = commands[name].format_help()
        return [nodes.literal_block(text, text, language="none")]


class StatedOptions(SphinxDirective):
    """A table of what can be stated: option, keyword, key of the problem file."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        lines = ["| option | in Python | in the problem file | |", "|---|---|---|---|"]
        for name, declared in declarations().items():
            key = f"`{declared.key}`" if declared.key else "-"
            text = declared.text.replace("%%", "%").replace("|", "\\|")
            usage = declared.usage.replace("|", "\\|")
            lines.append(f"| `{usage}` | `{name}` | {key} | {text} |")
        return self.parse_text_to_nodes("\n".join(lines))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    app.add_directive("shell-help", ShellHelp)
    app.add_directive("stated-options", StatedOptions)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
