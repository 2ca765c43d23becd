"""Derivatives of the torque by joint zero offsets, gains and lag, near an estimate.

The columns include base parameters and friction that the model may lack: otherwise
friction that changes with speed or load would look like a wrong zero offset.

Standard errors come from leaving segments out (`Jackknife`).  The misfit of a model
that is not quite right is neither white nor of one size, so that the scatter over
segments shows how uncertain the estimate is.  The plain sandwich estimator uses the
remaining misfit, which is too small where there are as many parameters as segments.
The jackknife uses the misfit to the segment that was left out.  In periodic motion a
segment is a phase of all periods, because the errors of the model repeat as well.

Segments are compressed once, and columns that all fits share are eliminated once, so
that fits with other columns cost little.
"""

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.singular import svd
from consistent_id.diagnosis.sample_rows import SampleRows, of_own_row
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.filters import zero_phase
from consistent_id.recordings.signals.repetitions import estimated_period
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.linear import column_sizes, extended, smallest_solution
from consistent_id.regression.regression import triangle
from consistent_id.regression.regressor import TorqueModel

SEGMENTS = 20
RANK = 1e-6  # of the largest singular value of unit columns
_LOST = 1e-6  # squared share in the null space of an undetermined parameter
_TINY = 1e-300  # least divisor in place of an error of zero


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A solution, its standard errors and its misfit.

    Parameters
    ----------
    solution : ndarray, shape (columns,)
    errors : ndarray, shape (columns,)
        Infinite where the data do not determine the value.
    misfit : float
        Norm of ``A x - z``.
    """

    solution: Vector
    errors: Vector
    misfit: float


@dataclass(frozen=True, slots=True, eq=False)
class Jackknife:
    """Factors of ``[A, z]``: of all segments, and of all but one.

    Parameters
    ----------
    whole : ndarray, shape (rows, columns + 1)
    others : tuple of ndarray, each shape (rows, columns + 1)
    """

    whole: Matrix
    others: tuple[Matrix, ...]

    def fitted(self, columns: list[int]) -> Fitted:
        """Solve ``A x = z`` for some columns in the least-squares sense.

        With ``x_g`` the solution without segment ``g`` of ``G``, the standard errors
        are the roots of ``(G - 1) / G sum_g (x_g - x)^2``.
        """
        A, z = self.whole[:, columns], self.whole[:, -1]
        _, s, Vt = svd(A / column_sizes(A), full_matrices=False)
        kept = Vt[s > RANK * s.max(initial=0.0)]
        x = self.solution(columns)
        moves = [
            smallest_solution(F[:, columns], F[:, -1], RANK) - x for F in self.others
        ]
        share = (len(moves) - 1) / len(moves)
        errors = np.sqrt(share * np.sum(np.square(moves), axis=0))
        lost = 1.0 - np.sum(kept**2, axis=0) > _LOST
        errors = np.where(lost, np.inf, np.maximum(errors, _TINY))
        return Fitted(x, errors, float(np.linalg.norm(z - A @ x)))

    def solution(self, columns: list[int]) -> Vector:
        """Return the solution of `fitted` alone."""
        return smallest_solution(self.whole[:, columns], self.whole[:, -1], RANK)

    def misfit(self, columns: list[int]) -> float:
        """Return the misfit of `fitted` alone."""
        A, z = self.whole[:, columns], self.whole[:, -1]
        return float(np.linalg.norm(z - A @ self.solution(columns)))

    def by_instrument(self, column: int, instrument: int) -> Fitted:
        """Solve ``a x = z`` for one column ``a`` by an instrument ``w``.

        It is ``x = w^T z / w^T a``, with errors as of `fitted`.  Where ``a`` contains
        the same errors as ``z``, least squares is biased; a ``w`` without them is not.
        The error is infinite where ``w`` and ``a`` are orthogonal.
        """
        w, a, z = (self.whole[:, k] for k in (instrument, column, -1))
        if w @ a <= RANK * np.linalg.norm(w) * np.linalg.norm(a):
            return Fitted(np.zeros(1), np.full(1, np.inf), float(np.linalg.norm(z)))
        x = float(w @ z / (w @ a))
        moves = [
            float(F[:, instrument] @ F[:, -1] / (F[:, instrument] @ F[:, column])) - x
            for F in self.others
        ]
        share = (len(moves) - 1) / len(moves)
        error = max(float(np.sqrt(share * np.sum(np.square(moves)))), _TINY)
        left = float(np.linalg.norm(z - x * a))
        return Fitted(np.array([x]), np.array([error]), left)

    def __add__(self, other: "Jackknife") -> "Jackknife":
        """Return the factors of both together; each pair of segments is left out."""
        others = map(_merged, self.others, other.others)
        return Jackknife(_merged(self.whole, other.whole), tuple(others))

    def without(self, count: int) -> "Jackknife":
        """Eliminate the first columns: the others become orthogonal to them.

        Columns that only have rounding errors left become zero.
        """
        sizes = np.linalg.norm(self.whole[:, count:], axis=0)
        return self.eliminated(count).cleared(sizes)

    def eliminated(self, count: int) -> "Jackknife":
        """Eliminate the first columns, as `without`; rounding errors are left."""
        kept = _independent(self.whole[:, :count]) if count else []
        rank = len(kept)
        whole, *others = (
            _factor(np.column_stack([F[:, kept], F[:, count:]]))[rank:, rank:]
            for F in (self.whole, *self.others)
        )
        return Jackknife(whole, tuple(others))

    def cleared(self, sizes: Vector) -> "Jackknife":
        """Make columns zero that are rounding errors beside the given sizes."""
        left = np.linalg.norm(self.whole, axis=0) > RANK * sizes
        left[-1] = True
        whole, *others = (F * left for F in (self.whole, *self.others))
        return Jackknife(whole, tuple(others))


def jackknife(
    A: Array, z: Matrix, phase: Vector | None = None, *, segments: int = SEGMENTS
) -> Jackknife:
    """Compress segments, and all but one of them.

    Parameters
    ----------
    A : ndarray, shape (joints, samples, columns)
    z : ndarray, shape (joints, samples)
    phase : ndarray, shape (samples,), optional
        Order in which samples are cut into segments; by default the order of time.
    """
    rows = np.concatenate([A, z[:, :, None]], axis=2)
    order = np.arange(rows.shape[1]) if phase is None else np.argsort(phase)
    segments_of = [c for c in np.array_split(order, segments) if len(c)]
    parts = [_factor(rows[:, c].reshape(-1, rows.shape[2])) for c in segments_of]
    none = np.zeros((0, rows.shape[2]))
    before = list(accumulate(parts, _merged, initial=none))
    after = list(accumulate(parts[::-1], _merged, initial=none))[::-1]
    others = tuple(map(_merged, before[:-1], after[1:]))
    return Jackknife(before[-1], others)


def _factor(*rows: Matrix) -> Matrix:
    return triangle(np.asfortranarray(np.vstack(rows)))


def _merged(one: Matrix, other: Matrix) -> Matrix:
    return extended(np.array(one, order="F"), np.array(other, order="F"))


def _independent(columns: Matrix) -> list[int]:
    """Return independent columns with the same span."""
    from scipy.linalg import qr

    R, order = qr(columns / column_sizes(columns), mode="r", pivoting=True)
    size = abs(np.diag(R))
    rank = int((size > RANK * size.max(initial=0.0)).sum())
    return sorted(int(i) for i in order[:rank])


_HARMONICS = 10  # of the Fourier series that finds a period: enough for phases
_PERIODS = 20  # above this number single periods are segments
_PAD = 15  # samples by which the filter extends either end
_BAND = 8.0  # times the motion's bandwidth: above it is only noise and friction
_POWER = 0.99  # share of the velocity's power within the bandwidth
LEAST = 1e-3
"""Share of a joint's torque: least misfit by which its rows are weighted."""


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """Factors of all torque joints' rows, each joint's divided by its misfit.

    Parameters
    ----------
    factors : Jackknife
        Columns of friction that builds up, of the lag, of the joints' zero offsets, and
        of the gains of the torque joints.  Base parameters and friction are eliminated.
    building_up : int
        Number of columns of friction that builds up.
    joints : int
        Number of joints.
    quickness : float, [1/s]
        Rate of change of the torque over the torque: the effect of a lag per second.
    """

    factors: Jackknife
    building_up: int
    joints: int
    quickness: float

    @property
    def without_lag(self) -> Jackknife:
        """Columns of zero offsets and gains, the lag eliminated."""
        whole, *others = (
            F[:, self.building_up :] for F in (self.factors.whole, *self.factors.others)
        )
        return Jackknife(whole, tuple(others)).without(1)

    @property
    def with_lag(self) -> Jackknife:
        """Columns of lag, zero offsets and gains, friction that builds up eliminated.

        Where a joint turns back, bristles and teeth bend first.  This delays friction
        alone, so a lag has to show in the rest of the torque.
        """
        return self.factors.without(self.building_up)


def linearised(
    model: TorqueModel, x: Vector, recording: Recording, base: BaseParameters
) -> Linearised:
    """Return the derivatives of the torque by zero offsets, gains and lag.

    Rows are filtered like the torque (`SampleRows`).  Columns and torque pass one more
    low-pass filter, which removes noise and the edges of friction.

    Parameters
    ----------
    x : ndarray, shape (parameters,)
        Constrained estimate about which the torque is linearised.
    recording : Recording
        With velocity, acceleration and torque.
    """
    recording = recording.of(model.robot.joint_names)
    rate, rows_of_log = recording.rate, SampleRows.of(model, recording)
    columns, torque = rows_of_log.regressor(), rows_of_log.torque
    predicted = np.einsum("jps,p->js", columns, x)
    lag = -np.gradient(predicted, 1.0 / rate, axis=1)
    along = rows_of_log.along.predicted(model, x).T
    shapes = rows_of_log.frictions(along)
    known = [columns[:, list(base.independent)], of_own_row(shapes)]
    late = of_own_row(np.gradient(shapes, axis=2))
    slopes = rows_of_log.slopes_by_position(x, range(len(model.robot)))
    unknown = [late, lag[:, None], slopes]
    gains = of_own_row(predicted[:, None])
    rows = np.concatenate([*known, *unknown, gains, torque[:, None]], axis=1)
    cutoff = _BAND * _bandwidth(rows_of_log.motion.dq, rate)
    rows = np.swapaxes(_smooth(rows, cutoff, rate), 1, 2)
    count = sum(part.shape[1] for part in known)
    rows = rows / _misfits(rows[:, :, :count], rows[:, :, -1])[:, None, None]
    phase = _phase(recording)
    factors = jackknife(rows[:, :, :-1], rows[:, :, -1], phase).without(count)
    sizes = np.maximum(np.linalg.norm(torque, axis=1), 1e-300)
    quickness = np.sqrt(np.mean((np.linalg.norm(lag, axis=1) / sizes) ** 2))
    return Linearised(factors, late.shape[1], len(model.robot), float(quickness))


def _phase(recording: Recording) -> Vector | None:
    """Return the phase of each sample in its period, 0 to 1; None without a period."""
    try:
        shortest = recording.duration / _PERIODS
        period = estimated_period(recording, shortest=shortest, harmonics=_HARMONICS)
    except RecordingError:
        return None
    return np.asarray(recording.time / period % 1.0)


def _bandwidth(velocity: Array, rate: float) -> float:
    """Return the frequency [Hz] below which nearly all of the motion's power lies."""
    spectrum = abs(np.fft.rfft(velocity - velocity.mean(axis=0), axis=0)) ** 2
    moving = spectrum[:, spectrum.any(axis=0)]
    if not moving.size:
        return rate
    shares = np.cumsum(moving, axis=0) / moving.sum(axis=0)
    places = np.argmax(shares >= _POWER, axis=0)
    return float(np.fft.rfftfreq(len(velocity), 1.0 / rate)[max(int(places.max()), 1)])


def _smooth(values: Array, cutoff: float, rate: float) -> Array:
    """Low-pass along samples, both ways; unchanged if the cut-off is near the rate."""
    if cutoff >= 0.4 * rate:
        return values
    series = values.reshape(-1, values.shape[-1])
    there = series.any(axis=1)  # more than half are zero: columns of other joints
    columns = series[there].T
    pad = min(len(columns) - 1, _PAD)
    smooth = np.zeros_like(series)
    smooth[there] = zero_phase(columns, cutoff=cutoff, rate=rate, order=4, pad=pad).T
    return smooth.reshape(values.shape)


def _misfits(rows: Array, torque: Matrix) -> Vector:
    """Return each joint's misfit, by which its rows are weighted, [N m or N].

    The fit weights joints by their torque.
    """
    scale = np.sqrt(np.mean(torque**2, axis=1))
    scale = np.where(scale > 0.0, scale, 1.0)
    weighted = np.concatenate([rows, torque[:, :, None]], axis=2)
    weighted = (weighted / scale[:, None, None]).reshape(-1, weighted.shape[2])
    R = triangle(np.asfortranarray(weighted))
    rest = torque - rows @ smallest_solution(R[:, :-1], R[:, -1], RANK)
    misfit = np.sqrt(np.mean(rest**2, axis=1))
    return np.asarray(np.maximum(misfit, LEAST * scale))
