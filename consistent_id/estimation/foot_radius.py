"""The effective radius of round feet, estimated from the log.

Rubber deforms, and a sole wears.  If a foot touches a few tenths of a millimetre higher
than stated, its forces cause moments that bias the trunk's inertia.  The least misfit
of the rows free of contact forces is a parabola in a common offset of all radii; three
values determine its vertex.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id._support.brief import brief
from consistent_id._support.executors import single_threaded
from consistent_id.constraints import Constraint
from consistent_id.errors import RecordingError
from consistent_id.estimation.equalities import FreeParameters, least_squares
from consistent_id.recordings.recording import Recording, several
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.recordings.signals.parts import blocks_of
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.contact_free import masked_factors

BLOCKS = 6
"""Blocks of the motion, each left out once for the standard error of the offset."""

# Share of the smallest radius by which feet are moved; soft rubber deforms less
_STEP = 0.05
_PASSES = 4  # until the vertex is within a step
_LEVEL = 0.975  # quantile of intervals of 95 %
_SAID = 0.1  # prior standard deviation of a radius, relative to it


@brief
@dataclass(frozen=True, slots=True)
class ContactRadius:
    """The correction of the radius of each round foot.

    Parameters
    ----------
    offset : float, [m]
        Shrunk towards zero if the log contains less information than the prior, a
        standard deviation of a tenth of the radius.
    standard_error : float, [m]
        By leaving out blocks of the motion, a jackknife [Efron1982]_.
    freedom : float
        Its degrees of freedom: few blocks show it only roughly.
    """

    offset: float
    standard_error: float
    freedom: float = np.inf

    @property
    def half_width(self) -> float:
        """Half of the 95 % interval, with Student's quantile for the blocks, [m]."""
        from scipy.special import stdtrit

        return float(stdtrit(self.freedom, _LEVEL)) * self.standard_error


@single_threaded
def contact_radius(
    model: TorqueModel,
    recordings: Recording | Sequence[Recording],
    *,
    constraints: Sequence[Constraint] = (),
) -> ContactRadius:
    """Estimate the correction of the radius of all round feet.

    Parameters
    ----------
    model : TorqueModel
        With rows free of contact forces, see `contact_free_model`.
    recordings : Recording or sequence of Recording
        With velocity, acceleration, torque, base motion and contacts; without rests and
        impacts, whose errors are larger.
    constraints : sequence of Constraint
        Only their equalities are used, such as known bodies.

    Raises
    ------
    RecordingError
        If no contact has a radius.
    NotExcitedError
        If the motion is too short.
    """
    logs = several(recordings)
    radii = [flags.radius for log in logs for flags in log.contacts if flags.radius]
    if not radii:
        raise RecordingError("no contact has a radius; give ContactFlags(radius=...)")
    step = _STEP * min(radii)
    free = FreeParameters.of(constraints, model)
    combinations = np.column_stack([free.directions, free.start])
    pieces, offset = blocks_of(logs, BLOCKS), 0.0
    for _ in range(_PASSES):
        blocks = []
        for piece in pieces:
            moved = [with_radii(piece, offset + k * step) for k in (-1, 0, 1)]
            parts = masked_factors(model, moved, combinations)
            blocks.append([part.factor for part in parts])
        vertex = _vertex(blocks)
        offset += step * vertex
        if not abs(vertex) > 1.0:  # within the tried range, or nowhere
            break
    count = len(blocks)
    left = [_vertex(blocks[:k] + blocks[k + 1 :]) for k in range(count)]
    variance = step**2 * (count - 1) * float(np.var(left))
    said = (_SAID * min(radii)) ** 2
    if not np.isfinite(offset + variance):
        return ContactRadius(0.0, float(np.sqrt(said)))
    share = said / (said + variance)
    error = float(np.sqrt(share * variance))
    # Of an offset that the prior determines, the error is as sure as the prior.
    return ContactRadius(share * offset, error, (count - 1.0) / share**2)


def with_radii(recording: Recording, offset: float) -> Recording:
    """Return a recording whose round feet have a radius larger by an offset [m].

    Parameters
    ----------
    recording : Recording
        With contacts.
    offset : float, [m]
    """

    def change(whole: Recording) -> Recording:
        contacts = tuple(
            replace(flags, radius=flags.radius + offset) if flags.radius else flags
            for flags in whole.contacts
        )
        return replace(whole, contacts=contacts)

    return altered(recording, change)


def _vertex(blocks: Sequence[Sequence[Matrix]]) -> float:
    """Return the minimum of a parabola through misfits at -1, 0 and 1.

    It is NaN if there is none: contact forces cause no moments about feet.
    """
    low, middle, high = (_misfit(parts) for parts in zip(*blocks, strict=True))
    bend = low + high - 2.0 * middle
    return 0.5 * (low - high) / bend if bend > 0.0 else np.nan


def _misfit(parts: Sequence[Matrix]) -> float:
    """Return the least squared misfit; the last two columns have given weights."""
    R = np.vstack(parts)
    A, rest = R[:, :-2], R[:, -1] - R[:, -2]
    return float(((rest - A @ least_squares(A, rest)) ** 2).sum())
