"""One link of a URDF: what is wrong with its inertial, and the edits that repair it."""

from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.export.repair.consistent_inertia import (
    ROUNDING,
    ball_inertia,
    is_consistent,
    nearest_inertia,
    point_mass,
    second_moments,
)
from consistent_id.export.repair.link_repair import LinkRepair, RepairOptions
from consistent_id.export.repair.stated_inertial import (
    StatedInertial,
    moments_in_words,
    stated_inertial,
)
from consistent_id.robot.loaders.splice import Document, Edit
from consistent_id.robot.loaders.urdf_inertial import inertia_attributes, number
from consistent_id.robot.loaders.xml import Element

_UNTOUCHED = 1e-9  # of the largest entry; what moves less keeps the file's digits


def repaired_link(
    document: Document, link: Element, inertial: Element, options: RepairOptions
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
    if stated.displaced:
        remedy = "where the centre of mass is cannot be known; correct it"
        return replace(record, status="refused", remedy=remedy), []
    if mass is None or mass < 0.0:
        remedy = "which mass it has cannot be known; state it"
        return replace(record, status="refused", remedy=remedy), []
    if stated.inertia is None and options.density is None and mass > 0.0:
        remedy = "its inertia cannot be known; state a density, to make it a ball"
        return replace(record, status="refused", remedy=remedy), []
    if not fault and mass == stated.mass:
        return replace(record, remedy=_advice(stated, mass)), []
    inertia, change, remedy = _remedy(stated, mass, bool(fault), options)
    if mass != stated.mass:
        remedy = f"mass set to {mass:g} kg" + (f"; {remedy}" if remedy else "")
    after = replace(
        record,
        status="repaired",
        remedy=remedy,
        after=_moments(inertia),
        change=change,
    )
    return after, _edits(document, inertial, stated, mass, inertia)


def _fault(stated: StatedInertial, mass: float | None, options: RepairOptions) -> str:
    """Say what is wrong with a link; `mass` is the one that it is to have."""
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
    """Say what simulators may refuse of a consistent inertia."""
    if mass > 0.0 and stated.inertia is not None and point_mass(mass, stated.inertia):
        return "a point mass, which simulators refuse if it moves; state a thickness"
    return ""


def _remedy(
    stated: StatedInertial, mass: float, faulty: bool, options: RepairOptions
) -> tuple[Matrix, float, str]:
    """Return inertia, relative change and what was done, of a link with a mass."""
    if mass == 0.0:
        change = 1.0 if stated.inertia is not None and stated.inertia.any() else 0.0
        return np.zeros((3, 3)), change, "without mass there is no inertia: set to zero"
    if stated.inertia is None:
        density = float(options.density or 0.0)
        ball = ball_inertia(mass, density)
        return ball, np.inf, f"a ball of {density:g} kg/m^3"
    if not faulty or (mass != stated.mass and _keeps(stated.inertia, mass, options)):
        return stated.inertia, 0.0, ""
    found = nearest_inertia(mass, stated.inertia, thickness=options.thickness)
    return found.inertia, found.change, "the nearest physically consistent inertia"


def _keeps(inertia: Matrix, mass: float, options: RepairOptions) -> bool:
    """Return whether a mass was all that was wrong."""
    return is_consistent(inertia, mass * options.thickness**2)


def _edits(
    document: Document,
    inertial: Element,
    stated: StatedInertial,
    mass: float,
    inertia: Matrix,
) -> list[Edit]:
    edits, missing = [], []
    old = {} if stated.inertia is None else inertia_attributes(stated.inertia)
    size = float(abs(inertia).max())
    entries = {
        name: f"{value + 0.0:.12g}"
        for name, value in inertia_attributes(inertia).items()
        if name not in old or abs(value - old[name]) > _UNTOUCHED * size
    }
    masses = {} if mass == stated.mass else {"value": number(mass)}
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


def _moments(inertia: Matrix | None) -> tuple[float, ...]:
    return () if inertia is None else tuple(np.linalg.eigvalsh(inertia).tolist())
