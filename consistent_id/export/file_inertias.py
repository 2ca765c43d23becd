"""Inertias in the form of files: about the centre of mass, divided among fixed links.

Only the inertia of a whole moving link is identifiable: its division among parts that
never move against each other has no effect on torque.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.robot.inertia import InertialParameters

_ROUNDING = 1e-12  # of the largest eigenvalue: the digits of a difference of inertias


@dataclass(frozen=True, slots=True, eq=False)
class FileLink:
    """A link of the file: its parameters in its own frame, and that frame's place.

    `rotation` and `translation` place it in the frame of the moving link.
    """

    name: str
    body: InertialParameters
    rotation: Matrix
    translation: Vector

    @property
    def placed(self) -> InertialParameters:
        """The parameters in the moving link's frame."""
        return self.body.transformed(self.rotation, self.translation)

    def given(
        self, whole: InertialParameters, share: float = 1.0
    ) -> InertialParameters:
        """Return a share of the whole, in the part's own frame."""
        body = InertialParameters(share * whole.vector)
        back = self.rotation.T
        return body.transformed(back, -back @ self.translation)


@dataclass(frozen=True, slots=True, eq=False)
class SplitInertia:
    """Parameters of the parts, in their own frames and order, and how they came."""

    bodies: tuple[InertialParameters, ...]
    note: str = ""


def split_inertia(whole: InertialParameters, parts: Sequence[FileLink]) -> SplitInertia:
    """Divide the whole among parts, of which the first is the moving link itself.

    The others keep the file's values if these, and the remainder for the first, are
    physically consistent.  Otherwise each gets a share of the whole in proportion to
    its mass; all of these are consistent.
    """
    own, *others = parts
    heavy = [part for part in others if part.body.vector.any()]
    if not heavy:
        return SplitInertia((own.given(whole), *(part.body for part in others)))
    stated = np.sum([part.placed.vector for part in heavy], axis=0)
    rest = InertialParameters(whole.vector - stated)
    names = ", ".join(part.name for part in heavy)
    keeps = all(part.body.is_consistent(_ROUNDING) for part in heavy)
    if not whole.is_consistent(_ROUNDING) or (keeps and rest.is_consistent(_ROUNDING)):
        note = f"{own.name} is the remainder without {names}, which are not changed"
        return SplitInertia((own.given(rest), *(part.body for part in others)), note)
    masses = np.maximum([part.body.mass for part in parts], 0.0)
    if masses.sum() == 0.0:
        masses[0] = 1.0
    weights = masses / masses.sum()
    bodies = tuple(p.given(whole, w) for p, w in zip(parts, weights, strict=True))
    note = (
        f"the remainder of {own.name} without {names} would not be physically "
        f"consistent: the whole is divided in proportion to the masses"
    )
    return SplitInertia(bodies, note)


def central(body: InertialParameters) -> tuple[float, Vector, Matrix]:
    """Return mass, centre of mass and inertia about it; the origin if massless."""
    if body.mass == 0.0:
        return 0.0, np.zeros(3), body.inertia
    return body.mass, body.com, body.central_inertia
