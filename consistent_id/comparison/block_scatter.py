"""How much parameters differ between blocks of a recording, beyond noise.

Noise says how well a block determines a parameter.  What the model lacks says more: it
is not alike in slow and fast motion, or cold and warm.  So parameters of a block are
taken to be shifted by amounts of its own, a random effect [DerSimonian1986]_: found
from the blocks, as `RecordingScatter` finds it from recordings, but of the parameters
themselves, with what equalities fix held.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import BoolArray, Vector, freeze_arrays
from consistent_id._support.tables import Table
from consistent_id.comparison.recording_scatter import excess
from consistent_id.constraints import Constraint
from consistent_id.errors import NotExcitedError
from consistent_id.estimation.equalities import FreeParameters, least_squares
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.segments import merged

BLOCKS = 6
"""Blocks of a training motion: of chirps of 15 s each has several turns of a joint."""

_LEVEL = 0.975  # quantile of intervals of 95 %
_NORMAL = 1.96
_FREE = 1e-9  # part of a parameter that is free, below which it is none


@dataclass(frozen=True, slots=True, eq=False)
class BlockScatter:
    """Parameters that equalities leave free, and how sure they are.

    Parameters
    ----------
    values : array_like, shape (parameters,)
        Of weighted least squares with equalities, of all blocks.
    noise : array_like, shape (parameters,)
        Standard errors by noise as correlated as the residuals are.
    between : array_like, shape (parameters,)
        Standard deviation between blocks, beyond noise.
    """

    names: tuple[str, ...]
    values: Vector
    noise: Vector
    between: Vector
    blocks: int

    def __post_init__(self) -> None:
        shape = (len(self.names),)
        freeze_arrays(self, dict.fromkeys(("values", "noise", "between"), shape))

    @property
    def standard_errors(self) -> Vector:
        """Standard errors of the values, for motion of which the blocks are samples."""
        return np.asarray(np.sqrt(self.noise**2 + self.between**2 / self.blocks))

    @property
    def quantile(self) -> float:
        """Standard errors either way for 95 %: of few blocks more than 1.96."""
        from scipy.special import stdtrit

        return float(stdtrit(self.blocks - 1, _LEVEL)) if self.blocks > 1 else _NORMAL

    def holds(self, other: "BlockScatter", *, between: bool = True) -> BoolArray:
        """Return whether another motion's values are within 95 % intervals of these.

        Parameters
        ----------
        other : BlockScatter
            Of one block of other motion, with the same parameters.
        between : bool
            Whether intervals contain the scatter between blocks; else noise alone.
        """
        variance = self.noise**2 + other.noise**2
        if between:
            variance = variance + self.between**2 * (1.0 + 1.0 / self.blocks)
        width = self.quantile if between else _NORMAL
        return np.asarray(abs(self.values - other.values) <= width * np.sqrt(variance))

    def to_dict(self) -> dict[str, dict[str, float]]:
        """Return values and errors by name, for JSON."""
        fields = ("values", "noise", "between", "standard_errors")
        return {
            name: {field: float(getattr(self, field)[k]) for field in fields}
            for k, name in enumerate(self.names)
        }

    def table(self) -> Table:
        """Return values and errors for people."""
        return Table(
            f"Parameters and their scatter between {self.blocks} blocks of the motion",
            ("parameter", "value", "by noise", "between blocks", "standard error"),
            tuple(
                (name, f"{x:.4g}", f"{a:.2g}", f"{b:.2g}", f"{s:.2g}")
                for name, x, a, b, s in zip(
                    self.names,
                    self.values,
                    self.noise,
                    self.between,
                    self.standard_errors,
                    strict=True,
                )
            ),
            (
                "values of least squares with the equalities alone",
                "a motion of a block's length of its own may differ by the scatter "
                "between blocks; the standard error is that of their mean, and "
                f"{self.quantile:.2f} of it either way hold 95 %",
            ),
        )


def block_scatter(
    model: TorqueModel,
    blocks: Sequence[Regression],
    *,
    constraints: Sequence[Constraint] = (),
) -> BlockScatter:
    """Find the scatter of parameters between blocks; of one block, noise alone.

    Parameters
    ----------
    blocks : sequence of Regression
        Of consecutive motion, with one weight for each joint; see
        `segment_regressions`.
    constraints : sequence of Constraint
        Of these the equalities count, such as known bodies and equal motors.

    Raises
    ------
    NotExcitedError
        If a block leaves a parameter open that all together determine.
    """
    free = FreeParameters.of(constraints, model)
    whole = _fit(merged(blocks), free)
    parts = [_fit(block, free) for block in blocks]
    shown = np.linalg.norm(free.directions, axis=1) > _FREE
    between = np.zeros(len(shown))
    if len(blocks) > 1:
        spread = excess(
            np.array([part.values[shown] for part in parts]),
            np.array([part.errors[shown] ** -2.0 for part in parts]),
        )
        between[shown] = np.sqrt(np.maximum(spread.ratio - 1.0, 0.0) * spread.unit)
    names = [n for n, use in zip(model.layout.names, shown, strict=True) if use]
    return BlockScatter(
        tuple(names),
        whole.values[shown],
        whole.errors[shown],
        between[shown],
        len(blocks),
    )


class _Fit(NamedTuple):
    values: Vector
    errors: Vector


def _fit(regression: Regression, free: FreeParameters) -> _Fit:
    """Return least squares with equalities, and its errors by correlated noise."""
    length = np.sqrt(regression.correlation)
    white = regression.weighted(regression.sigma * length).stacked()
    A, rest = free.reduced(white[:, :-1], white[:, -1])
    scale = np.linalg.norm(A, axis=0)
    if not (scale > 0.0).all() or np.linalg.matrix_rank(A / scale) < A.shape[1]:
        raise NotExcitedError(
            "a block of the motion leaves parameters open that are free; take fewer "
            "blocks, or fix these parameters"
        )
    values = free.start + free.directions @ least_squares(A, rest)
    return _Fit(values, free.moves(A))
