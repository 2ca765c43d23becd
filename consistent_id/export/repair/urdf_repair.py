"""A URDF whose inertials are not physically consistent, repaired in place."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from consistent_id.errors import ModelError
from consistent_id.export.repair.file_evidence import FileEvidence
from consistent_id.export.repair.inertial_repair import repaired_link
from consistent_id.export.repair.link_repair import Repair, RepairOptions
from consistent_id.robot.loaders.splice import Document
from consistent_id.robot.loaders.urdf_lint import unexpanded
from consistent_id.robot.loaders.xml import Element
from consistent_id.robot.parameters import did_you_mean


def repair_urdf(
    source: str | Path,
    *,
    masses: Mapping[str, float] | None = None,
    density: float | None = None,
    thickness: float = 0.0,
    choices: Mapping[str, int] | None = None,
) -> Repair:
    """Make the inertials of a URDF physically consistent, by undoing what went wrong.

    The mistake is looked for that explains an inconsistent inertial: a decimal point, a
    sign, the order of the entries, units, the point or the axes that it refers to.
    What the link may have been meant to be is judged by its shapes, by links that
    mirror it, and by how common the mistake is.  If none explains it, mass, centre of
    mass and axes stay, and moments of inertia move to the nearest consistent ones
    (`nearest_inertia`).  If several do, the link is refused until one is chosen.

    A consistent inertial is never changed unasked; where a mistake is likely, its link
    is doubtful.  A link stated to have no mass gets no inertia.  Nothing else in the
    file changes by a byte, and a file in which nothing is wrong does not change at all.

    What would have to be made up is refused, unless it is stated: a mass that is
    missing, not a number or negative, by `masses`; an inertia that is missing or not
    numbers, by `density`.

    Parameters
    ----------
    source : str or Path
    masses : mapping of str to float, optional, [kg]
        Masses of links by name, in place of the file's.
    density : float, optional, [kg/m^3]
        A solid ball of the link's mass and this density stands for an inertia that
        cannot be read.
    thickness : float, [m]
        Least standard deviation of mass along each axis of a link with mass.  Point
        masses and plates are on the boundary of the consistency cone; a thickness makes
        them links that simulators take.
    choices : mapping of str to int, optional
        Which of a link's suggestions it gets, counted from 1; 0 is the nearest
        consistent inertia.

    Returns
    -------
    Repair

    Raises
    ------
    ModelError
        If the file cannot be read, is an unexpanded xacro, or has no link of a name in
        `masses`.
    """
    path = Path(source)
    document = Document.read(path)
    options = RepairOptions(dict(masses or {}), density, thickness, dict(choices or {}))
    _check(path, document.root, options)
    known = FileEvidence.of(path, document.root)
    found = [
        repaired_link(document, link, inertial, options, known)
        for link in document.root.all("link")
        if (inertial := link.child("inertial")) is not None
    ]
    edits = [edit for _, of_link in found for edit in of_link]
    return Repair(
        path, document.data, document.spliced(edits), tuple(r for r, _ in found)
    )


def _check(path: Path, root: Element, options: RepairOptions) -> None:
    if root.tag != "robot":
        raise ModelError(
            f"{path}, line {root.line}: root element is <{root.tag}>, expected <robot>"
        )
    for finding in unexpanded(root):
        raise ModelError(f"{path}, {finding}")
    names = [link.name for link in root.all("link") if link.child("inertial")]
    for name in (*options.masses, *options.choices):
        if name not in names:
            near = did_you_mean(name, names)
            raise ModelError(f"{path}: no link {name!r} with an <inertial>; {near}")
    for name, choice in options.choices.items():
        if choice < 0:
            raise ModelError(f"choice of {name!r} is {choice}, expected 0 or more")
    for name, mass in options.masses.items():
        if not 0.0 <= mass < np.inf:
            raise ModelError(f"mass of {name!r} is {mass} kg, expected 0 or more")
    if options.density is not None and not 0.0 < options.density < np.inf:
        raise ModelError(f"density is {options.density}, expected a positive number")
    if not 0.0 <= options.thickness < np.inf:
        raise ModelError(f"thickness is {options.thickness} m, expected 0 or more")
