"""A paper's table of inertias about the centres of mass, with what it lacks: errors."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, BoolArray
from consistent_id.comparison.base_feasibility import in_words
from consistent_id.constraints import FixedCentresOfMass, FixedMasses, lowered
from consistent_id.laboratory.reproduction.experiments import Reproduction
from consistent_id.problems.problem import Problem
from consistent_id.problems.published import central_inertia_of
from consistent_id.regression.base import base_parameters
from consistent_id.regression.linear import null_space

_SILENT = 1e-9  # part of a unit vector in a null space that is rounding alone
ENTRIES = ("A", "B", "C", "D", "E", "F")


@dataclass(frozen=True, slots=True, eq=False)
class InertiaTable:
    """Entries of the links' inertia about their centres of mass, over experiments.

    Parameters
    ----------
    entries : ndarray, shape (experiments, links, 6), [kg m^2]
        A, B, C and the products D, E, F.  A link without a known mass enters with its
        inertia about its origin.
    true : ndarray, shape (links, 6)
    identifiable : ndarray of bool, shape (links, 6)
        Whether torque determines the entry, given masses and centres of mass; others
        come from the convention of the smallest vector, or from a prior.
    bodies : tuple of str
        What is wrong with the mean of each link, in words.
    """

    method: str
    links: tuple[str, ...]
    entries: Array
    true: Array
    identifiable: BoolArray
    bodies: tuple[str, ...]

    @property
    def mean(self) -> Array:
        """Over the experiments, shape (links, 6)."""
        return np.asarray(self.entries.mean(axis=0))

    @property
    def standard_deviation(self) -> Array:
        """Of the sample, shape (links, 6)."""
        return np.asarray(self.entries.std(axis=0, ddof=1))

    @property
    def standard_error(self) -> Array:
        """Of the mean, if experiments err independently, shape (links, 6)."""
        return np.asarray(self.standard_deviation / np.sqrt(len(self.entries)))


def inertia_tables(
    problem: Problem, inertial: Array, done: Reproduction
) -> tuple[InertiaTable, ...]:
    """Return each method's inertias about the centres of mass.

    Parameters
    ----------
    inertial : ndarray, shape (10 links,)
        The truth.
    """
    model, size = problem.model, problem.model.layout.inertial_size
    true = np.array(list(central_inertia_of(model, inertial).values()))
    identifiable = _identifiable(problem)
    tables = []
    for i, first in enumerate(done.experiments[0].estimates):
        vectors = [e.estimates[i].parameters[:size] for e in done.experiments]
        entries = [list(central_inertia_of(model, x).values()) for x in vectors]
        mean = np.mean(vectors, axis=0).reshape(-1, 10)
        words = tuple(in_words(x) if x[0] > 0.0 else "mass unknown" for x in mean)
        tables.append(
            InertiaTable(
                first.method,
                model.layout.links,
                np.array(entries),
                true,
                identifiable,
                words,
            )
        )
    return tuple(tables)


def _identifiable(problem: Problem) -> BoolArray:
    """Return which entries every vector with the same torque and datasheet shares."""
    model = problem.model
    known = lowered((FixedMasses(), FixedCentresOfMass()), model)
    rows = np.vstack([base_parameters(model).projection, known.A_eq])
    free = null_space(rows, _SILENT)
    moves = np.linalg.norm(free, axis=1)[: model.layout.inertial_size]
    # Ixx, Iyy, Izz; Iyz, Ixz, Ixy in the order m, hx, hy, hz, Ixx, Ixy, Iyy, Ixz, Iyz.
    places = [4, 6, 9, 8, 7, 5]
    identifiable = moves.reshape(-1, 10)[:, places] <= np.sqrt(_SILENT)
    return np.asarray(identifiable)
