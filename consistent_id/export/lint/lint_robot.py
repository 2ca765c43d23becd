"""Everything that is found in a robot description, URDF or MJCF."""

import re
from pathlib import Path

from consistent_id.errors import ModelError
from consistent_id.export.lint.described import LintFinding
from consistent_id.export.lint.mjcf_description import described_mjcf
from consistent_id.export.lint.rules import all_findings, probable_mistakes
from consistent_id.export.lint.urdf_description import described_urdf, urdf_only
from consistent_id.robot.loaders.urdf_lint import read_bytes
from consistent_id.robot.loaders.xml import XmlFault, parse

_LINE = re.compile(r"[Ll]ine (\d+)")


def lint_robot(path: str | Path) -> tuple[LintFinding, ...]:
    """Find what simulators refuse in a robot description, or take and should not.

    Parameters
    ----------
    path : str or Path
        URDF or MJCF; the root element decides.

    Returns
    -------
    tuple of LintFinding
        In the order of the file's lines.

    Raises
    ------
    ModelError
        If the file cannot be read at all, or is MJCF and MuJoCo is not installed.

    See Also
    --------
    lint_urdf : What keeps a URDF from being loaded, alone.
    """
    file = Path(path)
    try:
        root = parse(read_bytes(file))
    except XmlFault as fault:
        return (LintFinding(fault.line, "structure", "error", fault.sentence),)
    if root.tag == "mujoco":
        try:
            described, known = described_mjcf(file, root)
        except ModelError as refused:
            if "MuJoCo refuses it" not in str(refused):
                raise
            place = _LINE.search(str(refused))
            line = int(place[1]) if place else root.line
            sentence = " ".join(str(refused).partition(": ")[2].split())
            return (LintFinding(line, "structure", "error", sentence),)
        lines = {link.name: link.line for link in described.links}
        return tuple(
            sorted((*probable_mistakes(known, lines), *all_findings(described)))
        )
    if root.tag != "robot":
        sentence = f"root element is <{root.tag}>, expected <robot> or <mujoco>"
        return (LintFinding(root.line, "structure", "error", sentence),)
    described, known = described_urdf(file, root)
    return tuple(sorted((*urdf_only(root, known), *all_findings(described))))
