"""Robot descriptions looked through for what simulators refuse, or should."""

from consistent_id.export.lint.described import LintFinding
from consistent_id.export.lint.lint_robot import lint_robot

__all__ = ["LintFinding", "lint_robot"]
