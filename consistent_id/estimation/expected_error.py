"""The torque error to expect on a motion not seen, with its 80 % range.

The expected error is pooled over the segments of the training data, each predicted by a
fit without its block: ``E = sqrt(sum of squared errors / sum of squared torque)``.

The range comes from the scatter of the segments.  With ``e_k`` the error of segment
``k``, ``s`` the standard deviation of ``log e_k`` over ``n`` segments and ``t`` the
90 % quantile of Student's distribution with ``n - 1`` degrees of freedom:

    h = t s sqrt(1 + 1/n),    low = E exp(-h),    high = E exp(h)

The logarithm, because errors are positive and differ by factors.  The segments stand
for motions: another motion differs from the training motion as parts of it differ from
each other.  The scatter is that of one more draw, not that of the mean.

If the new motion is known, its distance from the training rows is, too.  ``D^2`` is the
mean variance of predicted rows (`prediction_spread`), of the new rows after a fit to
all data, and of the rows left out (``D_0^2``) after the fits without them.  What the
rows left out cost beyond the fit itself (error ``F`` on the data fitted) grows with it:

    E_new^2 = E^2 + max(E^2 - F^2, 0) max(D^2 / D_0^2 - 1, 0)

So the range widens upwards, and only for a motion farther from the training rows than
the blocks that were left out: a nearer one was tested already.

The torque of the new motion is predicted, too.  ``r`` is the root mean square torque of
the training data over that of the new motion.  Noise does not depend on torque: its
relative error is ``r`` times as large there.  Errors of friction and bodies grow with
the torque: their relative error stays.  Data do not separate the two well, so the
expected error is in the middle, ``sqrt(r) E_new``, and the range covers both:

    low = min(1, r) E exp(-h),    high = max(1, r) E_new exp(h)

Predicting no torque at all has an error of 100 %.  If the expected error is no less,
the training data give no information on other motion, and no figure is printed.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.tables import brief
from consistent_id.constraints.priors import Prior, nominal_distance
from consistent_id.errors import ProblemError
from consistent_id.estimation.best_fit import FitProblem, ScaledFit
from consistent_id.estimation.left_out import (
    LeftOutErrors,
    prediction_root,
    prediction_spread,
)
from consistent_id.estimation.torque_error import (
    stacked_of_kinds,
    stacked_of_regression,
)
from consistent_id.estimation.verdict import percent
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel

SHARE = 0.8
"""Share of motions whose error is in the range."""

_NOTHING = 1.0  # the error of predicting no torque at all
_LEAST = 1e-6  # share of the pooled error below which a segment's error is rounding


@dataclass(frozen=True, slots=True)
class ExpectedError:
    """The relative torque error of all joints to expect on a motion not seen.

    Parameters
    ----------
    error : float
        Error pooled over all data left out; for a known motion, increased by its
        distance from the training rows.
    low, high : float
        Range of the error in `SHARE` of motions.

    Examples
    --------
    >>> print(ExpectedError(0.032, 0.024, 0.043))
    3.2 %, 80 % range 2.4 % to 4.3 %
    >>> print(ExpectedError(0.7, 0.16, 3.1))
    70 %, 80 % range 16 % to over 100 %
    >>> print(ExpectedError(3.9, 0.4, 40.0))
    unknown, the data do not predict other motion
    """

    error: float
    low: float
    high: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.low <= self.error <= self.high < np.inf:
            raise ProblemError(
                f"expected error {self.error:.3g}, range {self.low:.3g} to "
                f"{self.high:.3g}; expected finite values in order"
            )

    def __str__(self) -> str:
        if not self.predicts:
            return "unknown, the data do not predict other motion"
        return f"{percent(self.error)}, {percent(SHARE)} range {self.range}"

    @property
    def predicts(self) -> bool:
        """Whether less error is expected than without any prediction, 100 %."""
        return self.error < _NOTHING

    @property
    def range(self) -> str:
        """The range in words; errors above 100 % are not distinguished."""
        low, high = (
            percent(end) if end < _NOTHING else f"over {percent(_NOTHING)}"
            for end in (self.low, self.high)
        )
        return low if low == high else f"{low} to {high}"

    def contains(self, error: float) -> bool:
        """Return whether an error is in the range."""
        return self.low <= error <= self.high

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, for JSON."""
        return {
            "error": self.error,
            "low": self.low,
            "high": self.high,
            "share_of_motions": SHARE,
        }


def expected_error(left_out: LeftOutErrors) -> ExpectedError | None:
    """Return the error to expect on an unknown motion.

    Parameters
    ----------
    left_out : LeftOutErrors
        Errors on the rows left out of one fit.

    Returns
    -------
    ExpectedError or None
        None if some block cannot be left out.
    """
    from scipy.special import stdtrit  # scipy.stats takes a second to import

    (error,), (errors,) = left_out.pooled, left_out.errors
    if not np.isfinite(error):
        return None
    n = len(errors)
    logs = np.log(np.maximum(errors, max(_LEAST * error, np.finfo(float).tiny)))
    t = float(stdtrit(n - 1, (1.0 + SHARE) / 2.0))
    factor = float(np.exp(t * np.std(logs, ddof=1) * np.sqrt(1.0 + 1.0 / n)))
    return ExpectedError(float(error), float(error) / factor, float(error) * factor)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ErrorForecast:
    """The error to expect of an estimate, on any motion or on a known one.

    Parameters
    ----------
    model : TorqueModel
    expected : ExpectedError
        Expected error on an unknown motion.
    excess : float
        Squared error on the data left out beyond that on the data fitted, not negative.
    tested : float
        ``D_0^2``, the spread of the rows left out.
    scaled : ScaledFit
        Fit to all data.
    root : ndarray, shape (parameters, parameters)
        See `prediction_root`.
    regression : Regression
        All data, with the weights of the fit.
    parameters : ndarray, shape (parameters,)
        The estimate, which predicts the torque.
    """

    model: TorqueModel
    expected: ExpectedError
    excess: float
    tested: float
    scaled: ScaledFit
    root: Matrix
    regression: Regression
    base: BaseParameters
    parameters: Vector

    def on(self, motion: Regression) -> ExpectedError:
        """Return the error to expect on a known motion; its torque is not used."""
        rows = motion.weighted(self.regression.sigma)
        spread = prediction_spread(self.root, self.scaled, rows, self.base)
        farther = max(spread / self.tested - 1.0, 0.0) if self.tested > 0.0 else 0.0
        known, less = self.expected, self._less_torque(motion)
        error = float(np.sqrt(known.error**2 + self.excess * farther))
        factor = known.high / known.error if known.error > 0.0 else 1.0
        return ExpectedError(
            error * np.sqrt(less),
            known.low * min(less, 1.0),
            error * factor * max(less, 1.0),
        )

    def _less_torque(self, motion: Regression) -> float:
        """Return ``r``, the torque of the data over that of a motion, as predicted."""
        x = self.parameters
        here, there = (one.predicted_rms(x) ** 2 for one in (self.regression, motion))
        if not there.any():
            return 1.0
        return stacked_of_kinds(self.model, here, there)


@single_threaded
def error_forecast(
    problem: FitProblem, left_out: LeftOutErrors, *, parameters: Vector, prior: Prior
) -> ErrorForecast | None:
    """Return the forecast of an estimate's error.

    Parameters
    ----------
    problem : FitProblem
        All training data with the weights of the fit, and its constraints.
    left_out : LeftOutErrors
        Errors on the rows left out of the same fit without each block.
    parameters : ndarray, shape (parameters,)
        The estimate.

    Returns
    -------
    ErrorForecast or None
        None if some block cannot be left out.
    """
    expected = expected_error(left_out)
    if expected is None:
        return None
    model, regression = problem.model, problem.free.regression
    scaled = problem.scaled()
    distance = nominal_distance(model, prior.distance, scaled.unit)
    fitted = stacked_of_regression(model, regression, parameters)
    return ErrorForecast(
        model=model,
        expected=expected,
        excess=max(expected.error**2 - fitted**2, 0.0),
        tested=float(left_out.spreads[0]),
        scaled=scaled,
        root=prediction_root(scaled, distance, float(left_out.weights[0])),
        regression=regression,
        base=problem.free.base,
        parameters=parameters,
    )
