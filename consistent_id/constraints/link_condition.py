"""Physical consistency of each link, and its place on the cone's boundary."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.inertia import InertialParameters, second_moments
from consistent_id.robot.scaling import link_scales

_CONSISTENT = 1e-9  # eigenvalues of J, per typical link, above -this are >= 0
_NO_MASS = "no mass"
_EDGE = 1e-5  # shares of a typical link's mass or second moment that count as none


@dataclass(frozen=True, slots=True)
class LinkCondition:
    """One link's consistency margin.

    Parameters
    ----------
    link : str
    least_eigenvalue : float
        Smallest eigenvalue of the pseudo-inertia, rows and columns divided by the
        roots of the link's typical mass and second moment.
    edge : str
        Where on the boundary of the consistency cone the link is, in words, such as
        ``"flat: ..."``; empty inside.
    """

    link: str
    least_eigenvalue: float
    edge: str

    @property
    def consistent(self) -> bool:
        """Whether the link is physically consistent, up to rounding."""
        return self.least_eigenvalue >= -_CONSISTENT

    @property
    def massless(self) -> bool:
        """Whether next to no mass is left of the link."""
        return self.edge == _NO_MASS


def link_conditions(model: TorqueModel, x: Vector) -> tuple[LinkCondition, ...]:
    """Examine each link of standard parameters.

    Parameters
    ----------
    model : TorqueModel
    x : ndarray, shape (parameters,)
    """
    scales = link_scales(model.robot)
    links = x[: model.layout.inertial_size].reshape(-1, 10)
    found = []
    for name, vector, root in zip(model.layout.links, links, scales.root, strict=True):
        body = InertialParameters(vector)
        least = np.linalg.eigvalsh(body.pseudo_inertia / np.outer(root, root))[0]
        typical = root**2
        edge = _edge(body, typical[3], typical[0]) if least >= -_CONSISTENT else ""
        found.append(LinkCondition(name, float(least), edge))
    return tuple(found)


def _edge(body: InertialParameters, mass: float, moment: float) -> str:
    """Name the boundary: second moments along principal axes that have vanished.

    A vanishing one is a triangle inequality of the principal moments of inertia that
    holds as an equality.
    """
    if body.mass <= _EDGE * mass:
        return _NO_MASS
    moments, axes = np.linalg.eigh(second_moments(body.central_inertia))
    gone = int((moments <= _EDGE * moment).sum())
    if gone == 0:
        return ""
    if gone == 1:
        return f"flat: no extent along {_axis(axes[:, 0])} (triangle inequality active)"
    if gone == 2:
        return f"a rod along {_axis(axes[:, 2])} (two triangle inequalities active)"
    return "a point mass"


def _axis(axis: Array) -> str:
    axis = axis * np.sign(axis[np.argmax(abs(axis))])
    rounded = np.round(axis, 2) + 0.0  # and no minus zero
    return "[" + " ".join(f"{value:.2f}" for value in rounded) + "]"
