"""One link of a URDF: what is wrong with its inertial, and the edits that repair it."""

from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.export.repair.cause_search import NEAREST
from consistent_id.export.repair.consistent_inertia import (
    ROUNDING,
    ball_inertia,
    is_consistent,
    nearest_inertia,
    point_mass,
)
from consistent_id.export.repair.fault_causes import Candidate
from consistent_id.export.repair.file_evidence import FileEvidence, Remedy
from consistent_id.export.repair.link_repair import LinkRepair, RepairOptions, Status
from consistent_id.export.repair.stated_inertial import (
    StatedInertial,
    moments_in_words,
    stated_inertial,
)
from consistent_id.robot.inertia import second_moments
from consistent_id.robot.loaders.splice import Document, Edit
from consistent_id.robot.loaders.urdf_inertial import inertia_attributes, number
from consistent_id.robot.loaders.xml import Element

_NOISE = 1e-14  # relative
_UNTOUCHED = 1e-9  # of the largest entry; what moves less keeps the file's digits


def repaired_link(
    document: Document,
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
    """Say what the user has to state; empty if nothing would have to be made up."""
    if stated.displaced:
        return "where the centre of mass is cannot be known; correct it"
    if mass is None or mass < 0.0:
        return "which mass it has cannot be known; state it"
    if stated.inertia is None and options.density is None and mass > 0.0:
        return "its inertia cannot be known; state a density, to make it a ball"
    return ""


def _several(name: str) -> str:
    return (
        f"several mistakes explain it; see the suggestions, and choose: {name}=1, or "
        f"{name}=0 for the nearest consistent inertia"
    )


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
    stated: StatedInertial,
    mass: float,
    faulty: bool,
    options: RepairOptions,
    chosen: Candidate | None,
) -> Remedy:
    """Return what a link with a mass gets."""
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
    document: Document, inertial: Element, stated: StatedInertial, done: Remedy
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
