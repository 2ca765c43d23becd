"""What is known of a body before any measurement, one small value per idea.

Each lowers itself to a `ConicSet` over the parameters of a torque model; any number of
them combine.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from consistent_id._arrays import Matrix, Vector
from consistent_id.conic import ConicSet, SemidefiniteBlock, intersection
from consistent_id.errors import ProblemError
from consistent_id.inertia import PSEUDO_INERTIA_BASIS
from consistent_id.parameters import ParameterLayout, did_you_mean
from consistent_id.regressor import TorqueModel
from consistent_id.scaling import link_scales


class Constraint(Protocol):
    """Anything that restricts parameters to a convex set."""

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return the set, over the parameters of `model`."""
        ...


def lowered(constraints: Sequence[Constraint], model: TorqueModel) -> ConicSet:
    """Return the intersection of constraints over the parameters of `model`."""
    sets = (constraint.lower(model) for constraint in constraints)
    return intersection(sets, len(model.layout))


@dataclass(frozen=True, slots=True)
class PhysicalConsistency:
    """Pseudo-inertias of all links positive semidefinite [Wensing2018]_.

    Parameters
    ----------
    margin : float
        Least eigenvalue of each pseudo-inertia after division by the link's typical
        mass and length (`link_scales`); a pure number.  The default keeps bodies
        strictly inside, as simulators demand.
    """

    margin: float = 1e-6

    def __post_init__(self) -> None:
        if not 0.0 <= self.margin < 1.0:
            raise ProblemError(
                f"margin is {self.margin}, expected a number from 0 to less than 1"
            )

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return one block ``J - margin D`` per link."""
        layout = model.layout
        blocks = []
        for k, root in enumerate(link_scales(model.robot).root):
            coefficients = np.zeros((len(layout), 4, 4))
            coefficients[layout.link_slice(k)] = PSEUDO_INERTIA_BASIS
            least = -self.margin * np.diag(root**2)
            blocks.append(SemidefiniteBlock(layout.links[k], coefficients, least, root))
        return ConicSet.semidefinite(blocks, len(layout))


@dataclass(frozen=True, slots=True)
class FixedMasses:
    """Masses known exactly.

    Parameters
    ----------
    masses : mapping of str to float, optional, [kg]
        By link; by default the datasheet's, for every link that has one.
    """

    masses: Mapping[str, float] | None = None

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ``m_k = value``."""
        masses = self.masses
        if masses is None:
            sheets = {link.name: link.datasheet.mass for link in model.robot.links}
            masses = {name: mass for name, mass in sheets.items() if mass is not None}
            _something(masses, "mass", "FixedMasses")
        known_links(masses, model, "fixed mass")
        return fixed_values(
            {f"{link}.m": mass for link, mass in masses.items()}, model.layout
        )


@dataclass(frozen=True, slots=True)
class MassBounds:
    """Masses between bounds [kg]; by default those of the datasheet."""

    bounds: Mapping[str, tuple[float, float]] | None = None

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ``lower <= m_k <= upper``."""
        bounds = self.bounds
        if bounds is None:
            sheets = {
                link.name: link.datasheet.mass_bounds for link in model.robot.links
            }
            bounds = {name: pair for name, pair in sheets.items() if pair is not None}
            _something(bounds, "mass_bounds", "MassBounds")
        known_links(bounds, model, "mass bounds")
        rows, limits, labels = [], [], []
        for link, (low, high) in bounds.items():
            row = _unit_row(model.layout, f"{link}.m")
            rows += [-row, row]
            limits += [-low, high]
            labels += [f"{link}: mass >= {low:g} kg", f"{link}: mass <= {high:g} kg"]
        return ConicSet.at_most(_stack(rows, model.layout), np.array(limits), labels)


@dataclass(frozen=True, slots=True)
class FixedCentresOfMass:
    """Centres of mass known exactly: ``h = m c``.

    Parameters
    ----------
    centres : mapping of str to sequence of 3 floats, optional, [m]
        By link, in its frame; by default the datasheet's.
    """

    centres: Mapping[str, Sequence[float]] | None = None

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ``h_k - c m_k = 0``, three rows per link."""
        centres = self.centres
        if centres is None:
            sheets = {link.name: link.datasheet.com for link in model.robot.links}
            centres = {
                name: com.tolist() for name, com in sheets.items() if com is not None
            }
            _something(centres, "com", "FixedCentresOfMass")
        known_links(centres, model, "fixed centre of mass")
        rows, labels = [], []
        for link, com in centres.items():
            for axis, c in zip("xyz", com, strict=True):
                rows.append(_offset_row(model.layout, link, axis, c))
                labels.append(f"{link}: centre of mass {axis} = {c:g} m")
        return ConicSet.equal(_stack(rows, model.layout), np.zeros(len(rows)), labels)


@dataclass(frozen=True, slots=True)
class CentreOfMassBoxes:
    """Centres of mass inside boxes: ``lower m <= h <= upper m``.

    Parameters
    ----------
    boxes : mapping of str to (lower, upper), optional, [m]
        By link, corners of three numbers each; by default the datasheet's.
    """

    boxes: Mapping[str, tuple[Sequence[float], Sequence[float]]] | None = None

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return six rows per link, linear because masses are not negative."""
        boxes = self.boxes
        if boxes is None:
            sheets = {link.name: link.datasheet.com_box for link in model.robot.links}
            boxes = {
                name: (box[0].tolist(), box[1].tolist())
                for name, box in sheets.items()
                if box is not None
            }
            _something(boxes, "com_box", "CentreOfMassBoxes")
        known_links(boxes, model, "centre-of-mass box")
        rows, labels = [], []
        for link, (low, high) in boxes.items():
            for axis, a, b in zip("xyz", low, high, strict=True):
                rows.append(-_offset_row(model.layout, link, axis, a))
                rows.append(_offset_row(model.layout, link, axis, b))
                labels.append(f"{link}: centre of mass {axis} >= {a:g} m")
                labels.append(f"{link}: centre of mass {axis} <= {b:g} m")
        return ConicSet.at_most(_stack(rows, model.layout), np.zeros(len(rows)), labels)


@dataclass(frozen=True, slots=True)
class NonNegativeDrive:
    """Friction and rotor inertia that dissipate and store, never the reverse."""

    terms: tuple[str, ...] = ("viscous", "coulomb", "rotor_inertia")

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ``x_i >= 0`` for the named terms of all joints."""
        layout = model.layout
        indices = [i for term in self.terms for i in layout.drive_indices(term)]
        rows = [-_unit_row(layout, layout.names[i]) for i in indices]
        labels = [f"{layout.names[i]} >= 0" for i in indices]
        return ConicSet.at_most(_stack(rows, layout), np.zeros(len(rows)), labels)


@dataclass(frozen=True, slots=True)
class FixedParameters:
    """Parameters known exactly, by name, such as ``{"link2.hx": 1.48}``."""

    values: Mapping[str, float]

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ``x_i = value``."""
        return fixed_values(self.values, model.layout)


def fixed_values(values: Mapping[str, float], layout: ParameterLayout) -> ConicSet:
    """Return the set in which the named parameters have the given values."""
    rows = [_unit_row(layout, name) for name in values]
    labels = [
        f"{name} = {value:g} {layout.units[layout.index(name)]}"
        for name, value in values.items()
    ]
    return ConicSet.equal(
        _stack(rows, layout), np.array(list(values.values()), dtype=float), labels
    )


def known_links(named: Mapping[str, object], model: TorqueModel, what: str) -> None:
    """Refuse names that are not those of links."""
    for name in named:
        if name not in model.layout.links:
            near = did_you_mean(name, model.layout.links)
            raise ProblemError(f"{what}: no link named {name!r}; {near}")


def _something(values: Mapping[str, object], key: str, constraint: str) -> None:
    """Refuse a constraint that would hold nothing and so pass for one that does."""
    if not values:
        raise ProblemError(
            f"{constraint}: no link's datasheet has a {key}; give values, or leave "
            "this constraint out"
        )


def _unit_row(layout: ParameterLayout, name: str) -> Vector:
    row = np.zeros(len(layout))
    row[layout.index(name)] = 1.0
    return row


def _offset_row(layout: ParameterLayout, link: str, axis: str, c: float) -> Vector:
    """Row of ``h_axis - c m``."""
    return _unit_row(layout, f"{link}.h{axis}") - c * _unit_row(layout, f"{link}.m")


def _stack(rows: Sequence[Vector], layout: ParameterLayout) -> Matrix:
    return np.array(rows) if rows else np.zeros((0, len(layout)))
