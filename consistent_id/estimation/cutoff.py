"""The cut-off of motion and torque, chosen by its error of predicted torque.

A low cut-off removes motion of the robot, a high one leaves noise, which the double
differentiation of the position amplifies.  The best cut-off for a robot and a logger is
the one that best predicts torque that was left out of the fit.  Three precautions make
this test fair:

- The raw recording is cut before anything is filtered, so that no filter carries torque
  from validation into training.  At the ends of a part, where filters extrapolate, a
  period of the lowest cut-off is dropped for all candidates.
- All candidates predict the same torque, filtered once and lightly.  If each candidate
  were judged on torque filtered with its own cut-off, low cut-offs would win, because
  smoother torque is easier to fit.  Here a motion cut-off that removes real torque has
  a larger error.
- The prediction uses motion filtered with the candidate's cut-off, not a common one:
  with the same noisy motion for all, parameters biased by noise would predict best.

So filter and parameters are judged together.  Noise of the torque is the same for all
candidates and does not bias the choice, except for encoder noise that the controller
feeds into the torque: a cut-off that passes it then looks better than it is.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, freeze_arrays
from consistent_id._support.executors import single_threaded, worker_threads
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError, RecordingError
from consistent_id.estimation.estimate import Estimate
from consistent_id.recordings.recording import Recording, several
from consistent_id.recordings.signals import differentiated, low_passed, trimmed
from consistent_id.regression.base import base_parameters
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import base_solution, joint_noise
from consistent_id.regression.segments import merged

_SHARE = 0.25  # share of a part that may be dropped at each end

Estimator = Callable[[TorqueModel, Regression], Estimate]
_Fit = Callable[[Regression], Vector]


@brief
@dataclass(frozen=True, slots=True, eq=False)
class CutoffChoice:
    """Cut-offs tried, and the error of the predicted torque for each.

    Parameters
    ----------
    motion, torque : array_like, shape (candidates,), [Hz]
    target : float, [Hz]
        Cut-off of the torque that all of them predict.
    errors : array_like, shape (candidates, folds)
        On each part when it was left out: the joints' root-mean-square torque errors
        over the root-mean-square of their torque, averaged likewise over joints.
    """

    motion: Vector
    torque: Vector
    target: float
    errors: Matrix

    def __post_init__(self) -> None:
        n = len(self.motion)
        freeze_arrays(self, {"motion": (n,), "torque": (n,), "errors": (n, None)})

    @property
    def error(self) -> Vector:
        """Root-mean-square error over all folds, for each candidate."""
        return np.asarray(np.sqrt(np.mean(self.errors**2, axis=1)))

    @property
    def best(self) -> int:
        """Index of the candidate with the least error."""
        return int(np.argmin(self.error))

    @property
    def motion_cutoff(self) -> float:
        """Cut-off of the best candidate, [Hz]."""
        return float(self.motion[self.best])

    @property
    def torque_cutoff(self) -> float:
        """Cut-off of the best candidate, [Hz]."""
        return float(self.torque[self.best])

    @property
    def doubt(self) -> Vector:
        """Standard error of each candidate's squared error less that of the best.

        It is computed from the folds, in units of the best squared error; zero for the
        best.
        """
        squared = self.errors**2
        more = squared - squared[self.best]
        spread = np.std(more, axis=1, ddof=1) / np.sqrt(squared.shape[1])
        return np.asarray(spread / max(squared[self.best].mean(), 1e-300))


@single_threaded
def best_cutoff(
    model: TorqueModel,
    recordings: Recording | Sequence[Recording],
    candidates: Sequence[float | tuple[float, float]],
    *,
    folds: int = 6,
    target: float | None = None,
    estimator: Estimator | None = None,
) -> CutoffChoice:
    """Choose the cut-off of motion and torque by held-out torque error.

    Parameters
    ----------
    model : TorqueModel
    recordings : Recording or sequence of Recording
        Training data as recorded: uniformly sampled, not filtered.  A measured velocity
        is filtered and differentiated once.
    candidates : sequence of float or (float, float), [Hz]
        Cut-offs of motion and torque alike, or of motion and of torque.
    folds : int
        Runs of consecutive samples left out in turn; each recording is at least one.
    target : float, optional, [Hz]
        Cut-off of the torque that is predicted, at least the highest candidate's for
        motion; by default the highest of all.
    estimator : callable, optional
        ``(model, regression) -> Estimate``; by default weighted least squares.

    Raises
    ------
    ProblemError
        If there are no two candidates or folds, or the target is too low.
    RecordingError
        If parts are too short for the lowest candidate.
    NotExcitedError
        See `least_squares`.
    """
    recordings = several(recordings)
    pairs = [c if isinstance(c, tuple) else (c, c) for c in candidates]
    if len(pairs) < 2 or not min(min(p) for p in pairs) > 0.0:
        raise ProblemError(
            f"candidates are {list(candidates)}, expected two positive cut-offs or more"
        )
    highest = max(motion for motion, _ in pairs)
    target = max(max(p) for p in pairs) if target is None else target
    if not target >= highest:
        raise ProblemError(
            f"target is {target} Hz, expected at least the highest candidate's "
            f"{highest:g} Hz, so that smoother torque has no advantage"
        )
    margin = 1.0 / min(min(p) for p in pairs)
    fitted = _weighted(model) if estimator is None else _by(model, estimator)
    folded = _FoldedRecordings(
        model,
        _parts(recordings, folds, margin),
        margin=margin,
        target=target,
        noise=estimator is not None,
    )
    errors = [_held_out(folded.sides(*pair), fitted) for pair in pairs]
    motion, torque = np.array(pairs).T
    return CutoffChoice(motion, torque, float(target), np.array(errors))


def _weighted(model: TorqueModel) -> _Fit:
    """Return weighted least squares of the parameters alone."""
    base = base_parameters(model)

    def fitted(regression: Regression) -> Vector:
        sigma = joint_noise(model, regression, base=base)
        return base.lift(base_solution(regression.weighted(sigma), base).x)

    return fitted


def _by(model: TorqueModel, estimator: Estimator) -> _Fit:
    return lambda regression: estimator(model, regression).parameters


class _Sides(NamedTuple):
    """Regressions of each part, for training and for validation."""

    training: list[Regression]
    validation: list[Regression]


def _parts(
    recordings: Sequence[Recording], folds: int, margin: float
) -> list[Recording]:
    """Return raw recordings cut into about `folds` consecutive parts."""
    if folds < 2:
        raise ProblemError(f"folds is {folds}, expected 2 or more")
    total = sum(recording.duration for recording in recordings)
    parts = []
    for recording in recordings:
        number = max(round(folds * recording.duration / total), 1)
        ends = np.linspace(0, len(recording), number + 1).round().astype(int).tolist()
        parts += [recording.samples(slice(a, b)) for a, b in pairwise(ends)]
    if len(parts) < 2:
        raise ProblemError(f"{len(parts)} fold, expected 2 or more")
    shortest = min(parts, key=lambda part: part.duration)
    if _SHARE * shortest.duration < margin:
        raise RecordingError(
            f"{shortest.name}: a part lasts {shortest.duration:.4g} s and loses "
            f"{margin:.4g} s at each end to the lowest cut-off. Use fewer "
            "folds, or leave the lowest candidates out"
        )
    return parts


@dataclass(frozen=True, slots=True, eq=False)
class _FoldedRecordings:
    """Raw recordings in parts, and the torque that all candidates predict.

    Parameters
    ----------
    margin : float, [s]
        Time that is dropped at both ends of a part once it is filtered.
    target : float, [Hz]
        Cut-off of the predicted torque.
    noise : bool
        Whether the estimator may use the noise of the training data.
    """

    model: TorqueModel
    parts: Sequence[Recording]
    margin: float
    target: float
    noise: bool

    def sides(self, motion: float, torque: float) -> _Sides:
        """Return the regressions of each part, filtered with a pair of cut-offs."""

        def both(part: Recording) -> tuple[Regression, Regression]:
            training = differentiated(
                low_passed(part, motion_cutoff=motion, torque_cutoff=torque)
            )
            rows = build_regression(self.model, self._inner(training), noise=self.noise)
            if torque == self.target and not self.noise:
                return rows, rows  # the filters are the same, too
            lightly = low_passed(
                differentiated(low_passed(part, motion_cutoff=motion)),
                torque_cutoff=self.target,
            )
            inner = self._inner(lightly)
            return rows, build_regression(self.model, inner, noise=False)

        with worker_threads(2) as pool:
            training, validation = zip(*pool.map(both, self.parts), strict=True)
        return _Sides(list(training), list(validation))

    def _inner(self, part: Recording) -> Recording:
        start, stop = part.time[0] + self.margin, part.time[-1] - self.margin
        return trimmed(part, start, stop)


def _held_out(sides: _Sides, fitted: _Fit) -> Array:
    """Return the error on each part, fitted to all others."""
    whole = merged(sides.validation).torque_rms
    errors = []
    for k, validation in enumerate(sides.validation):
        others = [side for i, side in enumerate(sides.training) if i != k]
        x = fitted(merged(others))
        relative = validation.residual_rms(x) / whole
        errors.append(np.sqrt(np.mean(relative**2)))
    return np.array(errors)
