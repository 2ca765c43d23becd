"""Contact: a stretch of the log whose torque the model does not explain.

The log is cut into cells.  The prediction error on a stretch that was left out of the
fit is compared with that on each other cell.  The model gets a lag and further shapes
of friction, because torque that these explain is no contact.  Residuals of real robots
differ from cell to cell, so that the other cells show which error is usual.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import BoolArray, IntArray, Matrix, Vector
from consistent_id._support.singular import svd
from consistent_id.diagnosis.channel_factors import channel_factors
from consistent_id.diagnosis.corrections import Cause
from consistent_id.diagnosis.explain import Candidate, FittedLog, fitted_log
from consistent_id.diagnosis.sample_rows import SampleRows
from consistent_id.diagnosis.signal_faults import without_spikes
from consistent_id.recordings.recording import Recording, instant
from consistent_id.recordings.signals import speed_share
from consistent_id.recordings.signals.filtered_rows import altered, counting
from consistent_id.recordings.signals.masks import standstill

_THRESHOLD = 1.3  # ratio of misfits, as in the table of corrections
_FELT = 0.03  # of the torque: misfit below which there is no contact
_CELLS = 64
_LENGTHS = (1, 2, 3, 4, 6, 8, 12, 16)  # cells of a stretch, at most a quarter of all
_TRIED = 6  # stretches of each length, those with the largest residuals
_SLOW = 0.05  # of top speed: slower joints rest, or nearly do
_WHILE = 0.5  # s for which joints are slow when they rest
_TINY = 1e-300  # in place of a residual of zero, which has no logarithm
_RANK = 1e-6  # information from the other samples below which a direction is open
# Bound on the probability that some stretch is so large by chance.  It is 0.02 or more
# in recordings without contact of UR10e, KR300, TX40, TIAGo and Z1, and 1e-4 in half of
# the KR300's; pushes of the tests have 1e-16 and less.
_CHANCE = 1e-6
_RESTS = 0.5  # with this share at rest or more, friction explains a stretch


@dataclass(frozen=True, slots=True, eq=False)
class JointResidual:
    """Residual of a joint's torque in least squares.

    Parameters
    ----------
    spanned : ndarray, shape (samples, columns)
        Orthonormal columns of the model.
    rest : ndarray, shape (samples,)
        Relative to the norm of the torque.
    """

    spanned: Matrix
    rest: Vector

    def left_out(self, samples: IntArray) -> float:
        """Return the decrease of the squared residual if samples are left out.

        It is ``r' (I - Q Q')^-1 r``: the squared error of their prediction from the
        other samples, over the variance factor of that prediction.
        """
        Q, r = self.spanned[samples], self.rest[samples]
        seen, others = Q.T @ r, np.eye(Q.shape[1]) - Q.T @ Q
        raised = _along(others, seen)
        if raised is not None:
            return float(r @ r + raised)
        sizes, directions = np.linalg.eigh(others)
        kept = sizes > _RANK
        along = directions[:, kept].T @ seen
        return float(r @ r + along @ (along / sizes[kept]))

    def without(self, samples: IntArray) -> "JointResidual":
        """Return the residual of a fit without samples, zero at these samples."""
        others = np.delete(np.arange(len(self.rest)), samples)
        U, s, _ = svd(self.spanned[others], full_matrices=False)
        U = U[:, s**2 > _RANK]
        spanned = np.zeros((len(self.rest), U.shape[1]))
        spanned[others] = U
        rest = np.zeros_like(self.rest)
        rest[others] = self.rest[others] - U @ (U.T @ self.rest[others])
        return JointResidual(spanned, rest)


def _along(others: Matrix, seen: Vector) -> float | None:
    """Return ``seen' others^-1 seen``; None where an eigenvalue may be `_RANK` or less.

    Eigenvalues are at most one, so that each is at least their product.
    """
    from scipy.linalg.lapack import dpotrf, dpotrs

    root, failed = dpotrf(others)
    if failed or np.prod(np.diagonal(root)) ** 2 <= _RANK:
        return None
    solved, _ = dpotrs(root, seen)
    return float(seen @ solved)


def contact(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the log without the stretch that the model does not explain, if any.

    Stretches nearer to an end of the log than half their length are left out, because
    filters settle there; so are stretches in which the robot mostly rests, because dry
    friction can hold any remaining torque.  A contact lasts longer than an outlier:
    stretches are looked for in torque without outliers.
    """
    log, behind = as_is.recording, as_is.recording.torque_filter
    model, base = as_is.factors.model, as_is.factors.base
    raw = log if behind is None else behind.source
    if without_spikes(raw) is not raw:
        log = altered(log, without_spikes)
        as_is = fitted_log(model, log, as_is.constraints, base)
    moving = ~resting(log)
    if as_is.misfit < _FELT or moving.sum() < 2 * _CELLS:
        return
    found = standing_out(joint_residuals(as_is, moving))
    if found is None:
        return
    start, stop = log.time[moving][found][[0, -1]]
    inside = (log.time >= start) & (log.time <= stop)
    if np.asarray(standstill(log).all(axis=1))[inside].mean() > _RESTS:
        return
    cause = Cause(
        "contact",
        "all joints",
        f"without {instant(start, log.time)} s to {instant(stop, log.time)} s",
        "leave this stretch out: it has a contact, a load or a fault of the log",
        _THRESHOLD,
        of_residual=True,
    )
    (factors,) = channel_factors(model, base, [counting(log, ~inside)])
    yield Candidate(cause, factors, as_is.constraints)


def resting(log: Recording) -> BoolArray:
    """Return when all joints rest or creep, shape (samples,)."""
    return speed_share(log, _WHILE) < _SLOW


def joint_residuals(as_is: FittedLog, rows: BoolArray) -> list[JointResidual]:
    """Return residuals of the model with a lag and further friction, at samples `rows`.

    The lag is computed from the whole log.  Samples of a joint that rests, or nearly
    does, while others move, are zero: dry friction can hold any remaining torque of it.
    """
    model = as_is.factors.model
    log = SampleRows.of(model, as_is.recording)
    alone = [as_is.recording.of((name,)) for name in model.torque_joints]
    moving = np.array([~resting(one)[rows] for one in alone])
    Y = log.regressor()
    torque = np.einsum("jps,p->js", Y, as_is.fit.parameters)
    friction = log.frictions(log.along.predicted(model, as_is.fit.parameters).T)
    late = np.gradient(torque, axis=1)[:, None]
    lacking = np.concatenate([friction, late], axis=1)
    found = []
    independent = list(as_is.factors.base.independent)
    for row, more, tau, moves in zip(Y, lacking, log.torque, moving, strict=True):
        columns = np.vstack([row[independent], more]).T[rows] * moves[:, None]
        norms = np.linalg.norm(columns, axis=0)
        unit = columns[:, norms > 0.0] / norms[norms > 0.0]
        U, s, _ = svd(unit, full_matrices=False)
        spanned = U[:, s > _RANK * s.max(initial=0.0)]
        felt = tau[rows] * moves
        rest = felt - spanned @ (spanned.T @ felt)
        size = max(float(np.linalg.norm(felt)), _TINY)
        found.append(JointResidual(spanned, rest / size))
    return found


def standing_out(residuals: list[JointResidual]) -> BoolArray | None:
    """Return the samples of an unexplained stretch; None if there is none."""
    samples = len(residuals[0].rest)
    cells = np.array_split(np.arange(samples), _CELLS)
    first, stop = _likeliest(residuals, cells)
    stretch = np.concatenate(cells[first:stop])
    if _chance(residuals, cells, first, stop) > _CHANCE:
        return None
    inside = np.zeros(samples, dtype=np.bool_)
    # Filters spread the torque to half a cell on either side.
    wider = max(len(cells[0]) // 2, 1)
    inside[max(stretch[0] - wider, 0) : stretch[-1] + 1 + wider] = True
    return inside


def _likeliest(
    residuals: list[JointResidual], cells: list[IntArray]
) -> tuple[int, int]:
    """Return the first cell and the end of the likeliest stretch of another variance.

    Its likelihood ratio is that of two variances, inside and outside, to one variance.
    """
    energy = np.array(
        [sum(float(r.rest[c] @ r.rest[c]) for r in residuals) for c in cells]
    )
    sums = np.concatenate([[0.0], np.cumsum(energy)])
    whole = max(float(sums[-1]), _TINY)
    best, found = -np.inf, (0, 1)
    for count in _LENGTHS:
        near = max(count // 2, 1)
        firsts = np.arange(near, len(cells) - count - near + 1, near)
        largest = np.argsort(sums[firsts] - sums[firsts + count])[:_TRIED]
        for first in firsts[largest]:
            stretch = np.concatenate(cells[first : first + count])
            part = sum(r.left_out(stretch) for r in residuals) / whole
            share, outside = count / len(cells), max(1.0 - part, _TINY)
            gain = -share * np.log(max(part, _TINY) / share)
            gain -= (1.0 - share) * np.log(outside / (1.0 - share))
            if part > share and gain > best:
                best, found = gain, (int(first), int(first + count))
    return found


def _chance(
    residuals: list[JointResidual], cells: list[IntArray], first: int, stop: int
) -> float:
    """Return the probability that some stretch has so large a residual by chance.

    Logarithms of the cells' residuals are assumed normal, with the mean and variance of
    the cells outside: it is Student's t, times the number of stretches.
    """
    from scipy.special import stdtr

    stretch = np.concatenate(cells[first:stop])
    others = [r.without(stretch) for r in residuals]
    outside = [*cells[: max(first - 1, 0)], *cells[stop + 1 :]]
    usual = np.log(
        [max(sum(r.left_out(cell) for r in others), _TINY) for cell in outside]
    )
    most = sum(r.left_out(stretch) for r in residuals) / (stop - first)
    n = len(usual)
    spread = max(float(usual.std(ddof=1)), _TINY) * np.sqrt(1.0 + 1.0 / n)
    t = (np.log(max(most, _TINY)) - usual.mean()) / spread
    return float(len(_LENGTHS) * len(cells) * stdtr(n - 1, -t))
