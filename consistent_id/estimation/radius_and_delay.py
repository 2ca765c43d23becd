"""The effective radius of round feet and the delay of the torque, from the log.

Rubber deforms, and a sole wears.  If a foot touches a few tenths of a millimetre higher
than stated, its forces cause moments that bias the trunk's inertia.  Drivers often
stamp a torque at the start of the step for which it is held: then it comes half a step
before the motion that it causes, which looks like inertia or viscous friction.

The least misfit of the rows free of contact forces is a parabola in a common offset of
all radii and in the torque's delay; a few values determine its vertex.  Both are
estimated together, as an error of one may look like the other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import (
    Array,
    BoolArray,
    Matrix,
    Vector,
    freeze_arrays,
)
from consistent_id._support.executors import single_threaded
from consistent_id._support.tables import brief
from consistent_id.constraints import Constraint
from consistent_id.errors import RecordingError
from consistent_id.estimation.determination import FreeParameters, least_squares
from consistent_id.recordings.recording import Recording, several
from consistent_id.recordings.signals.clocks import cubic_spline, own_rate
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.recordings.signals.parts import blocks_of
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.contact_free import masked_factors

BLOCKS = 6
"""Blocks of the motion, each left out once for the standard errors."""

# Share of the smallest radius by which feet are moved; soft rubber deforms less
_STEP = 0.05
_LATER = 0.25  # sampling periods by which the torque is moved; filters round it little
_PASSES = 4  # until the vertex is within a step
_LEVEL = 0.975  # quantile of intervals of 95 %
_SAID = 0.1  # prior standard deviation of a radius, relative to it
_STAMP = 1.0  # the same of the torque's delay, in sampling periods
_MOST = 5.0  # sampling periods by which the torque is moved, at the most
_TRIED = (-1, 0, 1)  # steps about the present values


class _Jackknifed:
    """The common properties of the two values: an error of some degrees of freedom."""

    __slots__ = ()
    standard_error: float
    freedom: float

    @property
    def half_width(self) -> float:
        """Half of the 95 % interval, with Student's quantile for the blocks."""
        from scipy.special import stdtrit

        return float(stdtrit(self.freedom, _LEVEL)) * self.standard_error


@brief
@dataclass(frozen=True, slots=True)
class ContactRadius(_Jackknifed):
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


@brief
@dataclass(frozen=True, slots=True)
class TorqueDelay(_Jackknifed):
    """The delay of the torque behind the motion.

    Parameters
    ----------
    seconds : float, [s]
        Negative if the torque is early.  Shrunk towards zero if the log contains less
        information than the prior, a standard deviation of a sampling period.
    standard_error : float, [s]
        By leaving out blocks of the motion, a jackknife [Efron1982]_.
    freedom : float
        Its degrees of freedom: few blocks show it only roughly.
    """

    seconds: float
    standard_error: float
    freedom: float = np.inf

    @property
    def significant(self) -> bool:
        """Whether the 95 % interval does not contain zero."""
        return abs(self.seconds) > self.half_width


@brief
@dataclass(frozen=True, slots=True, eq=False)
class RadiusAndDelay:
    """The radius of round feet and the delay of the torque, and their common error.

    Parameters
    ----------
    feet : ContactRadius, optional
    delay : TorqueDelay, optional
    covariance : ndarray, shape (2, 2)
        Covariance of offset [m] and delay [s]; zero for one that is not estimated.
    """

    feet: ContactRadius | None
    delay: TorqueDelay | None
    covariance: Matrix

    def __post_init__(self) -> None:
        freeze_arrays(self, {"covariance": (2, 2)}, "radius and delay")

    def applied(self, recording: Recording) -> Recording:
        """Return a recording with corrected radius and without the delay."""
        offset = 0.0 if self.feet is None else self.feet.offset
        late = 0.0 if self.delay is None else self.delay.seconds
        return without_torque_delay(with_radii(recording, offset), late)

    def widened(self, quantile: float) -> "RadiusAndDelay":
        """Return it with errors of which `quantile` are half of a 95 % interval."""
        found = self.feet, self.delay
        widths = [0.0 if f is None else f.half_width / quantile for f in found]
        whole = _correlation(self.covariance) * np.outer(widths, widths)
        return replace(self, covariance=whole)

    def changes(self) -> list[tuple[float, float]]:
        """Return independent changes of offset [m] and delay [s].

        Their outer products add up to the covariance, so that a value that depends on
        both is uncertain by the root of the sum of its squared changes.
        """
        values, axes = np.linalg.eigh(_correlation(self.covariance))
        sizes = np.sqrt(np.diag(self.covariance))
        return [
            (float(s * axis[0] * sizes[0]), float(s * axis[1] * sizes[1]))
            for s, axis in zip(np.sqrt(np.maximum(values, 0.0)), axes.T, strict=True)
            if s * abs(axis * sizes).max() > 0.0
        ]


def _correlation(covariance: Matrix) -> Matrix:
    sizes = np.sqrt(np.diag(covariance))
    unit = np.where(sizes > 0.0, sizes, 1.0)
    return np.asarray(covariance / np.outer(unit, unit))


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
    found = estimate_radius_and_delay(
        model, recordings, constraints=constraints, delay=False
    )
    if found.feet is None:
        raise RecordingError("no contact has a radius; give ContactFlags(radius=...)")
    return found.feet


@single_threaded
def estimate_radius_and_delay(
    model: TorqueModel,
    recordings: Recording | Sequence[Recording],
    *,
    constraints: Sequence[Constraint] = (),
    radius: bool = True,
    delay: bool = True,
) -> RadiusAndDelay:
    """Estimate the radius of round feet and the delay of the torque together.

    Parameters
    ----------
    model : TorqueModel
        With rows free of contact forces, see `contact_free_model`.
    recordings : Recording or sequence of Recording
        As for `contact_radius`.
    constraints : sequence of Constraint
        Only their equalities are used, such as known bodies.
    radius, delay : bool
        Whether it is estimated; feet that are points have no radius.

    Raises
    ------
    NotExcitedError
        If the motion is too short.
    """
    logs = several(recordings)
    radii = [flags.radius for log in logs for flags in log.contacts if flags.radius]
    period = 1.0 / min(own_rate(log) for log in logs)
    smallest = min(radii) if radius and radii else 0.0
    wanted = np.array([smallest > 0.0, delay])
    steps = np.array([_STEP * smallest, _LATER * period])[wanted]
    said = np.array([_SAID * smallest, _STAMP * period])[wanted]
    most = np.array([np.inf, _MOST * period])[wanted]
    free = FreeParameters.of(constraints, model)
    combinations = np.column_stack([free.directions, free.start])
    at = np.zeros(len(steps))
    blocks: list[Sequence[Matrix]] = []
    for _ in range(_PASSES if len(at) else 0):
        moves = wanted, at, steps
        blocks = _moved_factors(model, logs, combinations, moves)
        vertex = _vertex(_misfits(blocks, wanted))
        at = np.clip(at + steps * vertex, -most, most)
        if not (abs(vertex) > 1.0).any():  # within the tried range, or nowhere
            break
    count = len(blocks)
    left = [_misfits(blocks[:k] + blocks[k + 1 :], wanted) for k in range(count)]
    return _shrunk(wanted, at, steps * np.array([_vertex(m) for m in left]), said)


def _shrunk(
    wanted: BoolArray, at: Vector, left: Matrix, said: Vector
) -> RadiusAndDelay:
    """Return the values that the data determine, and their errors.

    Parameters
    ----------
    wanted : ndarray of bool, shape (2,)
    at : ndarray, shape (values,)
        The estimates; NaN where the data contain nothing of them.
    left : ndarray, shape (blocks, values)
        The same without each block.
    said : ndarray, shape (values,)
        Prior standard deviations.
    """
    count, prior = len(left), np.diag(said**2)
    share = np.zeros((len(at), len(at)))
    found, covariance = np.zeros(len(at)), prior
    if len(at) and np.isfinite(np.vstack([at, left])).all():
        apart = left - left.mean(axis=0)
        noise = (count - 1) / count * apart.T @ apart
        share = np.linalg.solve(prior + noise, prior).T
        found, covariance = share @ at, share @ noise
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    whole = np.zeros((2, 2))
    whole[np.ix_(wanted, wanted)] = (covariance + covariance.T) / 2.0
    # Of an offset that the prior determines, the error is as sure as the prior.
    trust = np.clip(np.diag(share), 1e-9, 1.0)
    freedom = np.where(trust > 1e-6, (count - 1.0) / trust**2, np.inf)
    values = iter(zip(found.tolist(), errors.tolist(), freedom.tolist(), strict=True))
    feet = ContactRadius(*next(values)) if wanted[0] else None
    delay = TorqueDelay(*next(values)) if wanted[1] else None
    return RadiusAndDelay(feet, delay, whole)


def with_radii(recording: Recording, offset: float) -> Recording:
    """Return a recording whose round feet have a radius larger by an offset [m].

    Parameters
    ----------
    recording : Recording
        With contacts.
    offset : float, [m]
    """
    if not offset:
        return recording

    def change(whole: Recording) -> Recording:
        contacts = tuple(
            replace(flags, radius=flags.radius + offset) if flags.radius else flags
            for flags in whole.contacts
        )
        return replace(whole, contacts=contacts)

    return altered(recording, change)


def without_torque_delay(recording: Recording, delay: float) -> Recording:
    """Return a recording whose torque comes earlier by a delay [s].

    ``tau(t) = logged(t + delay)``, by a cubic spline through the logged samples; at an
    end of the log the last value stays.

    Parameters
    ----------
    recording : Recording
        With torque.
    delay : float, [s]
        Negative for torque that is early.
    """
    if not delay or recording.torque is None:
        return recording

    def change(whole: Recording) -> Recording:
        if whole.torque is None:
            return whole
        clock = np.clip(whole.time + delay, whole.time[0], whole.time[-1])
        return replace(whole, torque=cubic_spline(whole.time, whole.torque, clock))

    return altered(recording, change)


def _moved_factors(
    model: TorqueModel,
    logs: Sequence[Recording],
    combinations: Matrix,
    moves: tuple[BoolArray, Vector, Vector],
) -> list[Sequence[Matrix]]:
    """Return factors of each block, for each radius that is tried.

    The last columns of a factor are the torques of the delays that are tried.

    Parameters
    ----------
    moves : tuple
        Whether radius and delay are wanted, their places, and their steps.
    """
    offsets, lags = _around(*moves)
    variants = [
        blocks_of([with_radii(log, offset) for log in logs], BLOCKS)
        for offset in offsets
    ]
    found: list[Sequence[Matrix]] = []
    for pieces in zip(*variants, strict=True):
        late = [without_torque_delay(pieces[0], lag) for lag in lags]
        parts = masked_factors(model, pieces, combinations, torques=late)
        found.append([part.factor for part in parts])
    return found


def _around(
    wanted: BoolArray, at: Vector, steps: Vector
) -> tuple[list[float], list[float]]:
    """Return radii and delays that are tried, one where it is not wanted."""
    lists: list[list[float]] = [[0.0], [0.0]]
    for place, middle, step in zip(np.flatnonzero(wanted), at, steps, strict=True):
        lists[place] = [float(middle + k * step) for k in _TRIED]
    return lists[0], lists[1]


def _misfits(blocks: Sequence[Sequence[Matrix]], wanted: BoolArray) -> Array:
    """Return least squared misfits, shape (3,) for one value or (3, 3) for two."""
    late = len(_TRIED) if wanted[1] else 1
    found = []
    for parts in zip(*blocks, strict=True):
        R = np.vstack(parts)
        A, start, torques = np.split(R, [R.shape[1] - late - 1, -late], axis=1)
        rest = torques - start
        rest = rest - A @ least_squares(A, rest)
        found.append((rest**2).sum(axis=0))
    return np.array(found).squeeze()


def _vertex(misfits: Array) -> Vector:
    """Return the minimum of a parabola through misfits at -1, 0 and 1.

    It is NaN if there is none: contact forces cause no moments about feet.
    """
    if misfits.ndim == 1:
        misfits = misfits[:, None]
    slopes, bends = [], []
    for values in (misfits[:, misfits.shape[1] // 2], misfits[1]):
        if len(values) > 1:
            slopes.append(0.5 * (values[2] - values[0]))
            bends.append(values[0] + values[2] - 2.0 * values[1])
    H = np.diag(bends)
    if len(bends) > 1:
        corners = misfits[::2, ::2]
        H[0, 1] = H[1, 0] = 0.25 * (np.trace(corners) - np.trace(corners[::-1]))
    if min(bends) <= 0.0 or np.linalg.det(H) <= 0.0:
        return np.full(len(bends), np.nan)
    return np.asarray(-np.linalg.solve(H, slopes))
