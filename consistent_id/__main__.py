"""``python -m consistent_id`` is the shell tool."""

import sys

from consistent_id.cli import run

sys.exit(run())
