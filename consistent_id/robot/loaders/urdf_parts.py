"""What can be wrong with one link or one joint of a URDF."""

from collections.abc import Iterator

import numpy as np

from consistent_id.robot.loaders.urdf_finding import Finding
from consistent_id.robot.loaders.xml import Element

INERTIA_ENTRIES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_JOINTS = ("revolute", "continuous", "prismatic", "fixed")
_UNIT = 1e-3  # a direction's length may be off by this much: three printed digits
_ROUNDED = 1e-6  # relative; by so much may printed moments break their inequalities
_POINT = 1e-6  # [m]; what is smaller has no extent, and its moments are rounding


def link_findings(link: Element) -> Iterator[Finding]:
    """Find what is wrong with a link's inertial, whose numbers are readable."""
    where = f"link {link.name!r}"
    inertial = link.child("inertial")
    if inertial is None:
        return
    mass, inertia = inertial.child("mass"), inertial.child("inertia")
    if mass is None or "value" not in mass.attributes:
        sentence = f"{where}: <inertial> has no <mass value=...>"
        yield Finding(inertial.line, "error", sentence)
        return
    if inertia is None:
        yield Finding(inertial.line, "error", f"{where}: <inertial> has no <inertia>")
        return
    missing = [entry for entry in INERTIA_ENTRIES if entry not in inertia.attributes]
    if missing:
        yield Finding(
            inertia.line,
            "error",
            f"{where}: <inertia> lacks {', '.join(missing)}; without all six entries "
            "the link would be taken for massless",
        )
        return
    value = float(mass.attributes["value"])
    if value < 0.0:
        sentence = f"{where}: mass is {value:g} kg, expected 0 or more"
        yield Finding(mass.line, "error", sentence)
        return
    fault = _inertia_fault(
        value, [float(inertia.attributes[e]) for e in INERTIA_ENTRIES]
    )
    if fault:
        yield Finding(
            inertia.line,
            "warning",
            f"{where}: {fault}; this inertia is not physically consistent. It is only "
            "a nominal value: estimates do not depend on it, priors take a consistent "
            "inertia near it",
        )


def _inertia_fault(mass: float, entries: list[float]) -> str:
    xx, xy, xz, yy, yz, zz = entries
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    largest = float(abs(moments).max())
    stated = ", ".join(f"{moment:.4g}" for moment in moments)
    if mass == 0.0 and largest > 0.0:
        return f"mass is zero, but the principal moments are {stated} kg m^2"
    if largest <= mass * _POINT**2:
        return ""
    if moments[0] < -_ROUNDED * largest:
        return f"the principal moments are {stated} kg m^2, one of them negative"
    if moments[0] + moments[1] < moments[2] - _ROUNDED * largest:
        return (
            f"the principal moments are {stated} kg m^2, one of them more than the sum "
            "of the others"
        )
    return ""


def joint_findings(joint: Element, moves: bool) -> Iterator[Finding]:
    """Find what is wrong with a joint, or keeps it from moving if it is to."""
    where, kind = f"joint {joint.name!r}", joint.attributes.get("type", "")
    for end in ("parent", "child"):
        element = joint.child(end)
        if element is None or not element.attributes.get("link"):
            sentence = f"{where}: <{end} link=...> is missing"
            yield Finding(joint.line, "error", sentence)
    loose = kind in ("floating", "planar")
    if kind not in _JOINTS and (moves or not loose):
        advice = "; make it fixed, or choose a base beyond it" if loose else ""
        yield Finding(
            joint.line,
            "error",
            f"{where}: type is {kind!r}, expected one of {', '.join(_JOINTS)}{advice}",
        )
    elif kind in ("revolute", "continuous", "prismatic"):
        yield from _axis(joint)
        yield from _limit(joint, kind, moves)


def _axis(joint: Element) -> Iterator[Finding]:
    axis = joint.child("axis")
    if axis is None:
        return
    numbers = axis.attributes.get("xyz", "1 0 0")
    length = float(np.linalg.norm([float(x) for x in numbers.split()]))
    if length == 0.0:
        sentence = f"joint {joint.name!r}: axis is zero, expected a direction"
        yield Finding(axis.line, "error", sentence)
    elif abs(length - 1.0) > _UNIT:
        yield Finding(
            axis.line,
            "warning",
            f"joint {joint.name!r}: axis {numbers!r} has length {length:.6g}; it is "
            "taken as a direction of length 1",
        )


def _limit(joint: Element, kind: str, moves: bool) -> Iterator[Finding]:
    where, limit = f"joint {joint.name!r}", joint.child("limit")
    if limit is None:
        if kind != "continuous":
            yield Finding(
                joint.line,
                "error",
                f"{where}: a {kind} joint needs <limit>; without limits it is "
                "continuous",
            )
        return
    missing = [key for key in ("effort", "velocity") if key not in limit.attributes]
    if missing:
        yield Finding(
            limit.line,
            "warning",
            f"{where}: <limit> lacks {' and '.join(missing)}; taken for unlimited; "
            "other readers of URDF refuse it",
        )
    for key in ("effort", "velocity"):
        if float(limit.attributes.get(key, 0.0)) < 0.0:
            sentence = f"{where}: limit {key} is {limit.attributes[key]} < 0"
            yield Finding(limit.line, "error", sentence)
    if kind == "continuous":
        return
    lower, upper = (float(limit.attributes.get(k, 0.0)) for k in ("lower", "upper"))
    if lower > upper and moves:
        sentence = f"{where}: limits are reversed, lower {lower:g} > upper {upper:g}"
        yield Finding(limit.line, "error", sentence)
    elif lower == upper and moves:
        yield Finding(
            limit.line,
            "warning",
            f"{where}: lower and upper limit are both {lower:g}, so it could not move",
        )
