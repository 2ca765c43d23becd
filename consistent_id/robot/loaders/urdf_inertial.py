"""The inertial of a URDF's link: read, and written back in place."""

from collections.abc import Sequence

import numpy as np

from consistent_id._support.arrays import Array, Matrix
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders.splice import Edit, XmlText
from consistent_id.robot.loaders.urdf_lint import INERTIA_ENTRIES
from consistent_id.robot.loaders.xml import Element

_PLACES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of `INERTIA_ENTRIES`

_LARGE = 1e15  # integers from here on are not all numbers
_ROUNDED = 1e-14  # relative; a sum and a product later, that is the same number


def number(value: float) -> str:
    """Return the shortest text that reads back as the same number."""
    value = float(value) + 0.0  # no negative zero
    whole = value.is_integer() and abs(value) < _LARGE
    return repr(int(value)) if whole else repr(value)


def numbers(text: str) -> Array:
    """Return the numbers of an attribute."""
    return np.array([float(word) for word in text.split()])


def rotation_of(rpy: Sequence[float]) -> Matrix:
    """Return ``Rz(yaw) Ry(pitch) Rx(roll)``, of angles about fixed axes [rad]."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def inertia_matrix(entries: Sequence[float]) -> Matrix:
    """Return the symmetric matrix of ``ixx, ixy, ixz, iyy, iyz, izz``."""
    matrix = np.zeros((3, 3))
    for value, (i, j) in zip(entries, _PLACES, strict=True):
        matrix[i, j] = matrix[j, i] = value
    return matrix


def inertia_attributes(matrix: Matrix) -> dict[str, float]:
    """Return the six attributes of an inertia matrix."""
    return {
        entry: float(matrix[place])
        for entry, place in zip(INERTIA_ENTRIES, _PLACES, strict=True)
    }


def body_of(link: Element) -> InertialParameters:
    """Return a link's parameters in its frame, zero if it has no inertial.

    The numbers must have been found readable.
    """
    inertial = link.child("inertial")
    if inertial is None:
        return InertialParameters(np.zeros(10))
    origin, mass = inertial.child("origin"), inertial.child("mass")
    inertia = inertial.child("inertia")
    where = {} if origin is None else origin.attributes
    turned = rotation_of(numbers(where.get("rpy", "0 0 0")).tolist())
    moments = {} if inertia is None else inertia.attributes
    entries = [float(moments.get(entry, 0.0)) for entry in INERTIA_ENTRIES]
    return InertialParameters.from_central(
        0.0 if mass is None else float(mass.attributes.get("value", 0.0)),
        numbers(where.get("xyz", "0 0 0")),
        turned @ inertia_matrix(entries) @ turned.T,
    )


def set_numbers(
    document: XmlText, element: Element, values: dict[str, Sequence[float]]
) -> list[Edit]:
    """Return edits of attributes that hold numbers; equal ones keep their text."""
    changed = {}
    for name, wanted in values.items():
        stated = element.attributes.get(name)
        if stated is None or not _same(numbers(stated), np.array(wanted)):
            changed[name] = " ".join(number(value) for value in wanted)
    return document.set(element, changed)


def _same(stated: Array, wanted: Array) -> bool:
    """Return whether numbers differ by no more than what arithmetic rounds off."""
    if stated.shape != wanted.shape:
        return False
    return bool(np.allclose(stated, wanted, rtol=_ROUNDED, atol=0.0))


def set_body(document: XmlText, link: Element, body: InertialParameters) -> list[Edit]:
    """Return edits that set a link's inertial: centre of mass in the link's axes.

    There are none if the link has these parameters already, in whatever axes.
    """
    stated = body_of(link).vector
    if np.allclose(stated, body.vector, rtol=0.0, atol=_ROUNDED * abs(stated).max()):
        return []
    parts = _parts(body, link)
    inertial = link.child("inertial")
    if inertial is None:
        lines = [_element(tag, values) for tag, values in parts.items()]
        child = ["<inertial>", *lines, "</inertial>"]
        return [document.insert(link, [child])]
    edits, missing = [], []
    for tag, values in parts.items():
        element = inertial.child(tag)
        if element is None:
            missing.append([_element(tag, values)])
            continue
        if tag == "origin" and "rpy" not in element.attributes:
            del values["rpy"]
        edits += set_numbers(document, element, values)
    if missing:
        edits.append(document.insert(inertial, missing))
    return edits


def _parts(
    body: InertialParameters, link: Element
) -> dict[str, dict[str, Sequence[float]]]:
    """Return elements of an inertial and their numbers; what is massless stays put."""
    if body.mass == 0.0:
        com, inertia = body_com(link), body.inertia
    else:
        com, inertia = body.com, body.central_inertia
    entries = inertia_attributes(inertia)
    return {
        "origin": {"xyz": com.tolist(), "rpy": (0.0, 0.0, 0.0)},
        "mass": {"value": (body.mass,)},
        "inertia": {entry: (value,) for entry, value in entries.items()},
    }


def body_com(link: Element) -> Array:
    """Return where the file puts a link's centre of mass, its origin by default."""
    inertial = link.child("inertial")
    origin = None if inertial is None else inertial.child("origin")
    return numbers("0 0 0" if origin is None else origin.attributes.get("xyz", "0 0 0"))


def _element(tag: str, values: dict[str, Sequence[float]]) -> str:
    pairs = [
        f'{name}="{" ".join(number(v) for v in value)}"'
        for name, value in values.items()
    ]
    return f"<{tag} {' '.join(pairs)}/>"
