"""What people and programs do wrong when they write an inertial, undone."""

from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from itertools import combinations, permutations

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.robot.loaders.urdf_inertial import inertia_attributes, inertia_matrix

_SLIPS = (-1, 1, -3, 3, -2, 2, -6, 6)  # powers of ten of one entry
_MASS_SLIPS = (-1, 1, -3, 3, -2, 2)
# kg mm^2, kg cm^2, g m^2, g cm^2, g mm^2, and slips of all entries.
_UNITS = (-6, -4, -3, -7, -9, 3, -1, 1, -2, 2)
_GRAMS = (-3, -7, -9)  # of the inertia beside a mass in grams
_SAME = 1e-9  # of the largest entry

# Where the six numbers ixx, ixy, ixz, iyy, iyz, izz stand, counted in the file's order.
_ORDERS = (
    ("the diagonal was written first (xx yy zz xy xz yz)", (0, 3, 4, 1, 5, 2), 0.0),
    ("the diagonal was written first (xx yy zz xy yz xz)", (0, 3, 5, 1, 4, 2), 2.5),
    ("the diagonal was written first (xx yy zz yz xz xy)", (0, 5, 4, 1, 3, 2), 2.5),
    ("the lower triangle was written row by row", (0, 1, 3, 2, 4, 5), 0.0),
)


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """What a link's inertial may have been meant to be.

    Parameters
    ----------
    cause : str
        What would have gone wrong.
    mass : float, [kg]
    inertia : ndarray, shape (3, 3), [kg m^2]
        About the centre of mass, in the inertial's own axes.
    price : float
        Minus the logarithm of how common the cause is beside the commonest.
    """

    cause: str
    mass: float
    inertia: Matrix
    price: float = 0.0

    def same(self, other: "Candidate") -> bool:
        """Return whether another is the same body."""
        size = max(abs(self.inertia).max(), abs(other.inertia).max())
        alike = abs(self.inertia - other.inertia).max() <= _SAME * size
        return bool(alike and self.mass == other.mass)


def candidates(
    mass: float, com: Vector, axes: Matrix, inertia: Matrix
) -> tuple[Candidate, ...]:
    """Return what an inertial may have been meant to be, by one mistake undone.

    Parameters
    ----------
    mass : float, [kg]
    com : ndarray, shape (3,), [m]
        In the link's frame.
    axes : ndarray, shape (3, 3)
        Of the inertial, as columns in the link's frame.
    inertia : ndarray, shape (3, 3), [kg m^2]
        As stated, in those axes.

    Returns
    -------
    tuple of Candidate
        Different bodies, none the stated one; not all of them consistent.
    """
    found: list[Candidate] = []
    stated = Candidate("", mass, inertia)
    for one in _all(mass, com, axes, inertia):
        if not any(one.same(other) for other in (stated, *found)):
            found.append(one)
    return tuple(found)


def _all(
    mass: float, com: Vector, axes: Matrix, inertia: Matrix
) -> Iterator[Candidate]:
    for cause, matrix, price in _of_entries(inertia):
        yield Candidate(cause, mass, matrix, price)
    turned = axes.T @ com
    steiner = mass * (turned @ turned * np.eye(3) - np.outer(turned, turned))
    about = "the inertia was stated about the link's origin"
    yield Candidate(about, mass, inertia - steiner, 0.3)
    twice = "the inertia was moved to the centre of mass twice"
    yield Candidate(twice, mass, inertia + steiner, 1.0)
    back = axes.T @ inertia @ axes
    yield Candidate("the inertia was stated in the link's axes", mass, back, 0.5)
    transposed = axes.T @ back @ axes
    cause = "the inertia was turned by the transpose of its rotation"
    yield Candidate(cause, mass, transposed, 0.5)
    for places in _MASS_SLIPS:
        cause = f"the mass is {_times(places)}"
        yield Candidate(cause, shifted(mass, places), inertia, _slip_price(places))
    for places in _GRAMS:
        matrix = _scaled(inertia, places)
        cause = f"the mass is in grams, the inertia {_times(places)}"
        yield Candidate(cause, shifted(mass, -3), matrix, 1.0)


def _of_entries(inertia: Matrix) -> Iterator[tuple[str, Matrix, float]]:
    """Yield mistakes in the six entries alone."""
    entries = inertia_attributes(inertia)
    names, values = list(entries), list(entries.values())
    products = [name for name in ("ixy", "ixz", "iyz") if entries[name] != 0.0]
    for count in (1, 3, 2):
        for some in combinations(products, count):
            signed = {n: -v if n in some else v for n, v in entries.items()}
            price = {1: 0.0, 3: 0.2, 2: 0.7}[count]
            wrong = f"the sign of {' and '.join(some)} is wrong"
            yield wrong, inertia_matrix(list(signed.values())), price
    for name in ("ixx", "iyy", "izz"):
        if entries[name] < 0.0:
            positive = entries | {name: -entries[name]}
            matrix = inertia_matrix(list(positive.values()))
            yield f"the sign of {name} is wrong", matrix, 0.0
    for name in names:
        for places in _SLIPS if entries[name] != 0.0 else ():
            slipped = entries | {name: shifted(entries[name], places)}
            matrix = inertia_matrix(list(slipped.values()))
            wrong = f"{name} is {_times(places)}"
            yield wrong, matrix, 0.5 + _slip_price(places)
    for places in _UNITS:
        wrong = f"the inertia is {_times(places)}"
        yield wrong, _scaled(inertia, places), _slip_price(places)
    for wrong, order, price in _ORDERS:
        yield wrong, inertia_matrix([values[k] for k in order]), price
    yield from _swapped(entries)


def _swapped(entries: dict[str, float]) -> Iterator[tuple[str, Matrix, float]]:
    """Yield diagonal entries, or products, that stand in each other's places."""
    for among, price in ((("ixx", "iyy", "izz"), 2.0), (("ixy", "ixz", "iyz"), 2.0)):
        for order in permutations(among):
            if order != among:
                moved = dict(zip(among, (entries[n] for n in order), strict=True))
                matrix = inertia_matrix(list((entries | moved).values()))
                wrong = f"{' '.join(order)} stand in the places of {' '.join(among)}"
                yield wrong, matrix, price


def shifted(value: float, places: int) -> float:
    """Return a number with its decimal point moved; its digits stay."""
    return float(Decimal(repr(float(value))).scaleb(places))


def _scaled(inertia: Matrix, places: int) -> Matrix:
    entries = inertia_attributes(inertia).values()
    return inertia_matrix([shifted(value, places) for value in entries])


def _slip_price(places: int) -> float:
    """Thousands are units, and ten is a digit; others are rarer."""
    return 0.0 if abs(places) in (1, 3) else 0.7


def _times(places: int) -> str:
    word = "large" if places < 0 else "small"
    return f"{10 ** abs(places):g} times too {word}"
