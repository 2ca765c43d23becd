"""Where a link's material can be: centre of mass and density within a shape.

A density on a convex shape moves the pseudo-inertia into a smaller cone: for every
quadratic ``q`` that is not negative on the shape, ``integral q rho >= 0`` is linear in
``J`` [Wensing2018]_.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.constraints.cones.sets import ConicSet, SemidefiniteBlock
from consistent_id.constraints.rows import inequalities, known_links
from consistent_id.errors import ProblemError
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.inertia import PSEUDO_INERTIA_BASIS
from consistent_id.robot.scaling import link_scales
from consistent_id.robot.solids import Ellipsoid, Polytope

_FACETS = 40  # of a polytope whose pairs of facets become constraints


@dataclass(frozen=True, slots=True, eq=False)
class CentreOfMassIn:
    """A link's centre of mass lies in an ellipsoid or a polytope."""

    link: str
    shape: Ellipsoid | Polytope

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return a second-order cone as a block, or a row per facet."""
        known_links({self.link: None}, model, "centre of mass in a shape")
        k = model.layout.links.index(self.link)
        size = len(model.layout)
        if isinstance(self.shape, Polytope):
            rows = np.zeros((len(self.shape.normals), size))
            start = model.layout.link_slice(k).start
            rows[:, start + 1 : start + 4] = self.shape.normals
            rows[:, start] = -self.shape.offsets
            labels = [
                f"{self.link}: centre of mass, facet {i}" for i in range(len(rows))
            ]
            return ConicSet.at_most(rows, np.zeros(len(rows)), labels)
        # ||U (h - m c)|| <= m  as  [[m 1, U (h - m c)], [., m]] >= 0.
        U, c = self.shape.unit_map, self.shape.centre
        coefficients = np.zeros((size, 4, 4))
        m, *h = range(model.layout.link_slice(k).start, model.layout.link_slice(k).stop)
        coefficients[m] = np.eye(4)
        coefficients[m, :3, 3] = coefficients[m, 3, :3] = -U @ c
        for axis in range(3):
            coefficients[h[axis], :3, 3] = coefficients[h[axis], 3, :3] = U[:, axis]
        scale = np.full(4, np.sqrt(link_scales(model.robot).mass[k]))
        label = f"{self.link}: centre of mass in the ellipsoid"
        block = SemidefiniteBlock(label, coefficients, np.zeros((4, 4)), scale)
        return ConicSet.semidefinite([block], size)


@dataclass(frozen=True, slots=True, eq=False)
class DensityOn:
    """A link's material lies in an ellipsoid or a polytope.

    For an ellipsoid ``tr(J Q) >= 0``, which with ``J >= 0`` is exact: a density exists
    iff it holds.  For a polytope ``l_i J l_j >= 0`` for all pairs of facets, which is
    necessary.
    """

    link: str
    shape: Ellipsoid | Polytope

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return one row, or a row per pair of facets."""
        known_links({self.link: None}, model, "density on a shape")
        layout = model.layout
        if isinstance(self.shape, Ellipsoid):
            forms = [self.shape.quadratic]
            labels = [f"{self.link}: material in the ellipsoid"]
        else:
            if len(self.shape.normals) > _FACETS:
                raise ProblemError(
                    f"density of {self.link!r}: the polytope has "
                    f"{len(self.shape.normals)} facets, each pair of which makes a "
                    f"constraint; at most {_FACETS} are allowed. Take a box, "
                    "Ellipsoid.around its vertices, or CentreOfMassIn"
                )
            lines, pairs = self.shape.rows, _pairs(len(self.shape.rows))
            forms = [_symmetric(lines[i], lines[j]) for i, j in pairs]
            labels = [f"{self.link}: material within facets {i}, {j}" for i, j in pairs]
        rows = []
        for form in forms:
            row = np.zeros(len(layout))
            inertial = np.tensordot(PSEUDO_INERTIA_BASIS, form, axes=2)
            row[layout.link_slice(layout.links.index(self.link))] = -inertial
            rows.append(row)
        return inequalities(rows, [0.0] * len(rows), labels, model)


def _pairs(count: int) -> Sequence[tuple[int, int]]:
    return [(i, j) for i in range(count) for j in range(i, count)]


def _symmetric(a: Vector, b: Vector) -> Array:
    return (np.outer(a, b) + np.outer(b, a)) / 2
