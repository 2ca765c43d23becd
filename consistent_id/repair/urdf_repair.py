"""A URDF whose inertials are not physically consistent, repaired in place.

For each link it returns the fault of its inertial, and the edits that repair it.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.errors import ModelError
from consistent_id.repair.causes import (
    NEAREST,
    ROUNDING,
    MeantInertial,
    ball_inertia,
    is_consistent,
    nearest_inertia,
    point_mass,
)
from consistent_id.repair.file_evidence import (
    FileEvidence,
    Remedy,
    StatedInertial,
    moments_in_words,
    stated_inertial,
)
from consistent_id.repair.link_repair import LinkRepair, Repair, RepairOptions, Status
from consistent_id.robot.inertia import second_moments
from consistent_id.robot.loaders.urdf_in_place import (
    Edit,
    XmlText,
    inertia_attributes,
    number,
)
from consistent_id.robot.loaders.urdf_lint import unexpanded
from consistent_id.robot.loaders.xml import Element
from consistent_id.robot.parameters import did_you_mean

_NOISE = 1e-14  # relative
_UNTOUCHED = 1e-9  # of the largest entry; entries that move less keep the file's digits


def repair_urdf(
    source: str | Path,
    *,
    masses: Mapping[str, float] | None = None,
    density: float | None = None,
    thickness: float = 0.0,
    choices: Mapping[str, int] | None = None,
) -> Repair:
    """Make the inertials of a URDF physically consistent, by undoing mistakes.

    The search is for the mistake that explains an inconsistent inertial: a decimal
    point, a sign, the order of the entries, units, the point or the axes that it refers
    to. Candidates are judged by the link's shapes, by links that mirror it, and by how
    common the mistake is.  If none explains it, mass, centre of mass and axes stay, and
    moments of inertia move to the nearest consistent ones (`nearest_inertia`).  If
    several do, the link is refused until one is chosen.

    A consistent inertial is changed only by choice; if a mistake is likely, its link is
    doubtful.  A link stated to have no mass gets no inertia.  Nothing else in the file
    changes by a byte, and a file without faults does not change at all.

    Values that would have to be invented are refused, unless they are stated: a mass
    that is missing, not a number or negative, by `masses`; an inertia that is missing
    or not numbers, by `density`.

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
        The number of the suggestion for a link, counted from 1; 0 is the nearest
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
    document = XmlText.read(path)
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
    if root.tag == "mujoco":
        raise ModelError(
            f"{path}: this is MJCF, expected a URDF. `consistent-id lint` names the "
            "bodies with faults and the likely mistakes; correct these by hand"
        )
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


def repaired_link(
    document: XmlText,
    link: Element,
    inertial: Element,
    options: RepairOptions,
    known: FileEvidence,
) -> tuple[LinkRepair, list[Edit]]:
    """Return one link's record, and the edits that repair it."""
    stated = stated_inertial(inertial)
    mass = options.masses.get(link.name, stated.mass)
    fault = _fault(stated, mass, options)
    record = LinkRepair(
        link.name,
        inertial.line,
        "consistent",
        fault,
        mass=mass,
        before=_moments(stated.inertia),
        after=_moments(stated.inertia),
    )
    refusal = _refusal(stated, mass, options)
    if refusal or mass is None:
        return replace(record, status="refused", remedy=refusal), []
    found = known.explained(link.name, mass, fixed=link.name in options.masses)
    record = replace(record, suggestions=found.suggestions)
    chosen = options.choices.get(link.name)
    if not fault and mass == stated.mass and not chosen:
        doubt = found.doubt if chosen is None else ""
        status: Status = "doubtful" if doubt else "consistent"
        return replace(record, status=status, remedy=doubt or _advice(stated, mass)), []
    if fault and chosen is None and found.several:
        return replace(record, status="refused", remedy=_several(link.name)), []
    done = _remedy(stated, mass, bool(fault), options, found.chosen(link.name, chosen))
    remedy = done.text
    if mass != stated.mass:
        remedy = f"mass set to {mass:g} kg" + (f"; {remedy}" if remedy else "")
    after = replace(
        record,
        status="repaired",
        remedy=remedy,
        mass=done.mass,
        after=_moments(done.inertia),
        change=done.change,
        warning=known.warning(link.name, done) if done.nearest else "",
    )
    return after, _edits(document, inertial, stated, done)


def _refusal(stated: StatedInertial, mass: float | None, options: RepairOptions) -> str:
    """Return what the user must state; empty if no value must be invented."""
    if stated.displaced:
        return "the centre of mass cannot be known; correct it"
    if mass is None or mass < 0.0:
        return "its mass cannot be known; state it: --mass LINK=KG"
    if stated.inertia is None and options.density is None and mass > 0.0:
        return (
            "its inertia cannot be known; state a density, to replace it by a ball: "
            "--density KG/M3"
        )
    return ""


def _several(name: str) -> str:
    return (
        f"several mistakes explain it; see the suggestions, and choose: {name}=1, or "
        f"{name}=0 for the nearest consistent inertia"
    )


def _fault(stated: StatedInertial, mass: float | None, options: RepairOptions) -> str:
    """Return the fault of a link; `mass` is its new mass."""
    if stated.displaced or stated.unreadable:
        return "; ".join(filter(None, (stated.displaced, *stated.unreadable)))
    inertia = stated.inertia
    if (
        mass is None
        or inertia is None
        or (stated.mass is not None and stated.mass < 0.0)
    ):
        return f"mass is {stated.mass:g} kg"
    principal = f"principal moments are {moments_in_words(inertia)} kg m^2"
    if mass == 0.0:
        return f"mass is zero, but {principal}" if inertia.any() else ""
    if not (is_consistent(inertia) or point_mass(mass, inertia)):
        moments = np.linalg.eigvalsh(inertia)
        negative = moments[0] < -ROUNDING * abs(moments).max()
        why = "one is negative" if negative else "one exceeds the sum of the others"
        return f"{principal}: {why}"
    if options.thickness and not is_consistent(inertia, mass * options.thickness**2):
        thin = np.linalg.eigvalsh(second_moments(inertia))[0]
        extent = np.sqrt(max(thin, 0.0) / mass)
        return f"mass extends {extent:.2g} m in its thinnest direction"
    return ""


def _advice(stated: StatedInertial, mass: float) -> str:
    """Return reasons for simulators to refuse a consistent inertia."""
    if mass > 0.0 and stated.inertia is not None and point_mass(mass, stated.inertia):
        return "a point mass, which simulators refuse if it moves; state a thickness"
    return ""


def _remedy(
    stated: StatedInertial,
    mass: float,
    faulty: bool,
    options: RepairOptions,
    chosen: MeantInertial | None,
) -> Remedy:
    """Return the new inertial of a link with a mass."""
    if mass == 0.0:
        change = 1.0 if stated.inertia is not None and stated.inertia.any() else 0.0
        text = "without mass there is no inertia: set to zero"
        return Remedy(mass, np.zeros((3, 3)), change, text)
    if stated.inertia is None:
        density = float(options.density or 0.0)
        ball = ball_inertia(mass, density)
        return Remedy(mass, ball, np.inf, f"a ball of {density:g} kg/m^3")
    inertia, text = stated.inertia, ""
    if chosen is not None:
        mass, inertia, text = chosen.mass, chosen.inertia, chosen.cause
        faulty = not _keeps(inertia, mass, options)
    if not faulty or (mass != stated.mass and _keeps(inertia, mass, options)):
        return Remedy(mass, inertia, _change(stated.inertia, inertia), text)
    found = nearest_inertia(mass, inertia, thickness=options.thickness)
    text = f"{text}; {NEAREST}" if text else NEAREST
    change = found.change if chosen is None else _change(stated.inertia, found.inertia)
    return Remedy(mass, found.inertia, change, text, nearest=chosen is None)


def _change(before: Matrix, after: Matrix) -> float:
    """Return the relative change of the second moments of mass."""
    S0, S = second_moments(before), second_moments(after)
    size = float(np.linalg.norm(S0))
    return float(np.linalg.norm(S - S0)) / size if size > 0.0 else np.inf


def _keeps(inertia: Matrix, mass: float, options: RepairOptions) -> bool:
    """Return whether a mass was all that was wrong."""
    return is_consistent(inertia, mass * options.thickness**2)


def _edits(
    document: XmlText, inertial: Element, stated: StatedInertial, done: Remedy
) -> list[Edit]:
    edits, missing = [], []
    old = {} if stated.inertia is None else inertia_attributes(stated.inertia)
    size = float(abs(done.inertia).max())
    entries = {
        name: _digits(value + 0.0)
        for name, value in inertia_attributes(done.inertia).items()
        if name not in old or abs(value - old[name]) > _UNTOUCHED * size
    }
    masses = {} if done.mass == stated.mass else {"value": number(done.mass)}
    for tag, values in (("mass", masses), ("inertia", entries)):
        element = inertial.child(tag)
        if element is None:
            pairs = " ".join(f'{name}="{value}"' for name, value in values.items())
            missing.append([f"<{tag} {pairs}/>"])
        else:
            edits += document.set(element, values)
    if missing:
        edits.append(document.insert(inertial, missing))
    return edits


def _digits(value: float) -> str:
    """Return all digits, but for the noise of arithmetic behind the twelfth."""
    text = f"{value:.12g}"
    return text if abs(float(text) - value) <= _NOISE * abs(value) else number(value)


def _moments(inertia: Matrix | None) -> tuple[float, ...]:
    return () if inertia is None else tuple(np.linalg.eigvalsh(inertia).tolist())
