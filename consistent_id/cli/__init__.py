"""The shell tool: a file per command, each with ``add_NAME`` and ``run_NAME``.

``add_NAME(commands)`` names the options, ``run_NAME(options)`` does it and
returns the exit code; `tool` lists the commands.
"""

from consistent_id.cli.tool import main

__all__ = ["main"]
