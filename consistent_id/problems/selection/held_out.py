"""Torque errors on blocks that were left out."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.problems.selection.blocks import NUMBERS, left_out
from consistent_id.problems.selection.factors import Factors, JointFactors
from consistent_id.problems.selection.models import Candidate, FoldFits

_TIED = 1e-5
"""Share of the squared error by which a block has to differ to be won or lost: less is
the solver's rounding, or the block has no rows."""


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Squared torque errors of each fold and joint, each joint's in its own unit.

    Parameters
    ----------
    squares : ndarray, shape (folds, torque joints)
    """

    squares: Matrix

    @property
    def blocks(self) -> Vector:
        """Squared error on each block."""
        return np.asarray(self.squares.sum(axis=1))

    @property
    def total(self) -> float:
        """Squared error over all blocks, averaged over the numbers of blocks."""
        return float(self.squares.sum()) / len(NUMBERS)


@dataclass(frozen=True, slots=True)
class Gain:
    """What one choice brings over another.

    Parameters
    ----------
    share : float
        Part of the squared error that is gone.
    error : float
        Its standard error, from the blocks.
    won : float
        Share of the blocks on which the error is less, of those on which it differs.
    """

    share: float
    error: float
    won: float


def gain(before: HeldOut, after: HeldOut) -> Gain:
    """Return what the second brings over the first, on the same rows."""
    less = before.blocks - after.blocks
    starts = np.cumsum((0, *NUMBERS))
    variances = [
        n * float(np.var(less[a : a + n], ddof=1))
        for n, a in zip(NUMBERS, starts[:-1], strict=True)
    ]
    error = float(np.mean(np.sqrt(variances)))
    total = max(before.total, 1e-300)
    share = float(less.sum()) / len(NUMBERS) / total
    decided = less[abs(less) > _TIED * total]
    won = float(np.mean(decided > 0.0)) if len(decided) else 0.0
    return Gain(share, error / total, won)


def held_out(fits: FoldFits, factors: Factors, sigma: Vector) -> HeldOut:
    """Return the errors of fits on the folds that each of them was left out of."""
    return HeldOut(
        np.column_stack(
            [
                joint_errors(fits.candidate, fits.parameters, joint) / s**2
                for joint, s in zip(factors.joints, sigma, strict=True)
            ]
        )
    )


def joint_errors(candidate: Candidate, x: Matrix, joint: JointFactors) -> Vector:
    """Return a joint's squared error on each fold, `x` of shape (folds, parameters)."""
    z = own_parameters(candidate, x, joint)
    squares = np.sum((joint.cells @ z.T) ** 2, axis=1)
    return np.asarray(np.sum(squares.T, axis=1, where=left_out()))


def own_parameters(candidate: Candidate, x: Matrix, joint: JointFactors) -> Array:
    """Return ``[x, -1]`` of each fold in the columns of a joint's factors."""
    size = candidate.model.layout.inertial_size
    kept = len(joint.expand)
    z = np.zeros((len(x), joint.cells[0].shape[1]))
    z[:, :kept] = x[:, :size] @ joint.expand.T
    for i, key in enumerate(candidate.keys):
        if key in joint.places:
            z[:, joint.places[key]] = x[:, size + i]
    z[:, -1] = -1.0
    return z
