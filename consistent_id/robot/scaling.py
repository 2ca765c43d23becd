"""Typical sizes of parameters, by which problems are made dimensionless."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Vector, freeze_arrays, frozen
from consistent_id.robot.inertia import InertialParameters, second_moments
from consistent_id.robot.model import RobotModel

_MASSLESS = 1e-3  # mass of a link stated to have none, over the mean of the others
_EQUAL = 1e-9  # relative difference up to which inertials are equal
_FLAT = 1e-3  # ratio of thickness to length below which a nominal link counts as flat
_THICK = 0.1  # ratio that its reference is then given


USUAL_WIDTHS = (0.05, 0.15, 0.30)
"""Usual errors of nominal masses, centres of mass and second moments.

Relative to the link's mass and length.
"""


@dataclass(frozen=True, slots=True, eq=False)
class LinkScales:
    """Typical mass [kg] and length [m] of each link."""

    mass: Vector
    length: Vector

    def __post_init__(self) -> None:
        freeze_arrays(self, {"mass": (None,), "length": (None,)})

    @property
    def units(self) -> Vector:
        """Typical size of each inertial parameter, shape (10 links,)."""
        m, d = self.mass, self.length
        rows = np.column_stack([m, m * d, m * d, m * d, *[m * d**2 for _ in range(6)]])
        return rows.ravel()

    def widths(self, relative: ArrayLike) -> Vector:
        """Return errors of each inertial parameter, shape (10 links,).

        Parameters
        ----------
        relative : array_like, shape (3,)
            Relative widths of masses, centres of mass and second moments; see
            `USUAL_WIDTHS`.
        """
        mass, centre, moment = np.asarray(relative)
        of_link = np.array([mass, *[centre] * 3, *[moment] * 6])
        widths: Vector = self.units * np.tile(of_link, len(self.mass))
        return widths

    @property
    def root(self) -> Array:
        """Square roots of the pseudo-inertias' diagonals, shape (links, 4)."""
        r = np.sqrt(self.mass)
        return np.column_stack([r * self.length] * 3 + [r])


@lru_cache(maxsize=16)
def link_scales(robot: RobotModel) -> LinkScales:
    """Return each link's typical mass and length.

    Mass: of the datasheet, else nominal, else the mean of those known, else 1 kg; a
    thousandth of that mean for a link whose nominal mass is zero, if others have one.
    Length: the distance to the farthest joint that the link carries, else to the joint
    that carries it, but no less than a tenth of the robot's longest.
    """
    known = [_known_mass(robot, k) for k in range(len(robot.links))]
    stated = [m for m in known if m is not None]
    typical = float(np.mean(stated)) if stated else 1.0
    # A link that the model states to be massless is one, nearly; an unknown one is not,
    # nor are those of a model that has no mass at all.
    massless = _MASSLESS if stated else 1.0
    guess = [
        typical if link.nominal is None else massless * typical for link in robot.links
    ]
    mass = np.array([g if m is None else m for m, g in zip(known, guess, strict=True)])

    reach = np.array([np.linalg.norm(joint.translation) for joint in robot.joints])
    length = reach.copy()
    for k in range(len(robot.links)):
        carried = [r for j, r in zip(robot.joints, reach, strict=True) if j.parent == k]
        length[k] = max([*carried, 0.0]) or reach[k]
    longest = float(length.max()) or 1.0
    return LinkScales(mass, np.maximum(length, 0.1 * longest))


@lru_cache(maxsize=16)
def body_sizes(robot: RobotModel) -> Vector:
    """Return each link's size [m]: its typical length, or how far its mass is spread.

    The latter is ``sqrt(tr(S) / m)``, with ``S`` the second moments of its reference
    body about the link's frame.  Joints of a wrist or a shoulder coincide, so that the
    distance between them says little of the body.
    """
    spread = [
        np.sqrt(np.trace(InertialParameters(body).inertia) / 2.0 / body[0])
        for body in reference_bodies(robot)
    ]
    return np.maximum(link_scales(robot).length, spread)


@lru_cache(maxsize=16)
def reference_bodies(robot: RobotModel) -> Array:
    """Return physically consistent parameters of each link, shape (links, 10).

    Nominal parameters where they are known; if they are flat, as of point masses, or
    not consistent, the extents that vanish are raised to a tenth of the link's length.
    Otherwise a ball of typical mass and length about the datasheet's centre of mass.
    """
    scales = link_scales(robot)
    bodies = []
    for link, m, d in zip(robot.links, scales.mass, scales.length, strict=True):
        if link.nominal is not None and link.nominal.mass > 0.0:
            bodies.append(_thickened(link.nominal, m, d).vector)
            continue
        com = np.zeros(3) if link.datasheet.com is None else link.datasheet.com
        ball = InertialParameters.from_central(m, com, 0.1 * m * d**2 * np.eye(3))
        bodies.append(ball.vector)
    return frozen(bodies, (None, 10), "reference bodies")


def _known_mass(robot: RobotModel, k: int) -> float | None:
    link = robot.links[k]
    if link.datasheet.mass:
        return link.datasheet.mass
    if link.nominal is not None and link.nominal.mass > 0.0:
        return link.nominal.mass
    return None


def _thickened(body: InertialParameters, m: float, d: float) -> InertialParameters:
    """Give a body's vanishing extents a tenth of a length `d`."""
    sigma = second_moments(body.central_inertia)
    moments, axes = np.linalg.eigh(sigma)
    flat = moments < m * (_FLAT * d) ** 2
    sigma = axes @ np.diag(np.where(flat, m * (_THICK * d) ** 2, moments)) @ axes.T
    thick = np.trace(sigma) * np.eye(3) - sigma
    return InertialParameters.from_central(body.mass, body.com, thick)


def placeholders(robot: RobotModel) -> bool:
    """Return whether all links have the same inertials, as placeholders do, or none."""
    bodies = [link.nominal for link in robot.links]
    known = [body for body in bodies if body is not None]
    if len(known) < max(len(bodies), 2):
        return False
    masses = np.array([body.mass for body in known])
    if np.ptp(masses) > _EQUAL * masses.max() or masses.max() == 0.0:
        return bool(masses.max() == 0.0)
    central = np.array([body.central_inertia for body in known])
    return bool(np.ptp(central, axis=0).max() <= _EQUAL * central.max())
