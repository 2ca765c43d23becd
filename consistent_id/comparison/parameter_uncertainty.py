"""How sure each parameter of the constrained estimate is, and what determines it.

Three answers side by side: the standard error from the scatter between segments,
projected on the active constraints; the bootstrap's interval; and the values that any
consistent robot can have that fits nearly best.  From the last follows the verdict.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.threads import single_threaded
from consistent_id.comparison.intervals import ConsistentIntervals, consistent_intervals
from consistent_id.comparison.segment_bootstrap import Bootstrap, bootstrap
from consistent_id.comparison.sensitivity import covariance, segment_scores
from consistent_id.constraints import Constraint, lowered
from consistent_id.constraints.priors import Prior
from consistent_id.errors import ProblemError
from consistent_id.estimation.constrained import DEFAULT_CONSTRAINTS
from consistent_id.estimation.constrained_fit import ConstrainedFit, constrained_fit
from consistent_id.regression.base import (
    BaseParameters,
    base_parameters,
    parameter_origins,
)
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.segments import merged
from consistent_id.robot.parameters import did_you_mean

KNOWN = 0.5
"""Width of the consistent interval, in typical sizes, up to which data determine it."""

PINNED = 0.1
"""Width up to which constraints and data together determine a parameter."""


@dataclass(frozen=True, slots=True)
class ParameterUncertainty:
    """What is known of one parameter.

    Parameters
    ----------
    name, unit : str
    value : float
        Of the constrained estimate.
    standard_error : float
        See `sensitivity`.
    resampled : tuple of float
        Central 95 % of the bootstrap's estimates.
    consistent : tuple of float
        Least and largest value of any consistent robot that fits nearly best.
    verdict : {"data", "constraint", "combination", "prior"}
        ``"data"``: the data determine it by themselves.  ``"constraint"``: an equality
        fixes it, or constraints together with the data do.  ``"combination"``: the
        data fix only sums it is part of.  ``"prior"``: its value is the prior's.
    """

    name: str
    unit: str
    value: float
    standard_error: float
    resampled: tuple[float, float]
    consistent: tuple[float, float]
    verdict: str


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """What is known of all parameters, and how it was found."""

    parameters: tuple[ParameterUncertainty, ...]
    bootstrap: Bootstrap
    intervals: ConsistentIntervals

    def __getitem__(self, name: str) -> ParameterUncertainty:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        near = did_you_mean(name, [p.name for p in self.parameters])
        raise ProblemError(f"no parameter {name!r}; {near}")

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers and text; None for what is not finite."""
        resampled = self.bootstrap
        return {
            "parameters": [_plain(asdict(p)) for p in self.parameters],
            "bootstrap": {
                "estimates": len(resampled.estimates),
                "certified": resampled.certified,
                "failed": resampled.failed,
                "interrupted": resampled.interrupted,
            },
            "slack": self.intervals.slack,
        }


@single_threaded
def uncertainty(
    model: TorqueModel,
    segments: Sequence[Regression],
    *,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    prior: Prior | None = None,
    base: BaseParameters | None = None,
    slack: float | None = None,
    replicates: int = 200,
    seed: int = 0,
    progress: bool = False,
) -> Uncertainty:
    """Say how sure the constrained estimate's parameters are.

    Parameters
    ----------
    model : TorqueModel
    segments : sequence of Regression
        See `segment_regressions`; their `sigma` are the weights.
    constraints, prior, base
        See `constrained_least_squares`.
    slack : float, optional
        See `consistent_intervals`.
    replicates, seed, progress
        See `bootstrap`.

    Returns
    -------
    Uncertainty
        One answer for each parameter, in the layout's order.

    Raises
    ------
    ProblemError, InfeasibleError, NotExcitedError, SolverError
        See the functions named.
    """
    base = base_parameters(model) if base is None else base
    whole = merged(segments)
    fitted = constrained_fit(model, whole, constraints, prior, base)
    scatter = covariance(fitted, segment_scores(fitted, segments, base))
    errors = np.sqrt(np.maximum(np.diag(scatter), 0.0))
    resampled = bootstrap(
        model,
        segments,
        constraints=constraints,
        prior=prior,
        base=base,
        replicates=replicates,
        seed=seed,
        progress=progress,
    )
    intervals = consistent_intervals(
        model, whole, constraints=constraints, slack=slack, base=base
    )
    verdicts = _verdicts(
        intervals,
        _typical_sizes(model, whole, fitted, intervals.bounds[:, 1]),
        _linear_origins(model, whole, constraints, base),
    )
    layout = model.layout
    return Uncertainty(
        parameters=tuple(
            ParameterUncertainty(name, unit, float(x), float(e), tuple(b), tuple(c), v)
            for name, unit, x, e, b, c, v in zip(
                layout.names,
                layout.units,
                fitted.parameters,
                errors,
                resampled.interval().tolist(),
                intervals.bounds.tolist(),
                verdicts,
                strict=True,
            )
        ),
        bootstrap=resampled,
        intervals=intervals,
    )


def _typical_sizes(
    model: TorqueModel, regression: Regression, fitted: ConstrainedFit, most: Vector
) -> Vector:
    """Return what widths are compared with.

    Of inertial parameters the link's typical size, or the value where that is larger;
    of drive terms the value that would explain all torque of their own joints, or the
    largest possible where they cannot be negative.
    """
    unit, n = fitted.best.scaled.unit.copy(), model.layout.inertial_size
    unit[:n] = np.maximum(unit[:n], abs(fitted.parameters[:n]))
    for i in range(n, len(unit)):
        own = [F for F in regression.factors if F[:, i].any()]
        if own:
            torque = np.sqrt(sum(float(np.sum(F[:, -1] ** 2)) for F in own))
            unit[i] = torque / np.sqrt(sum(float(np.sum(F[:, i] ** 2)) for F in own))
    low, _ = fitted.best.scaled.domain.box
    signed = (low == 0.0) & (np.arange(len(unit)) >= n)
    return np.where(signed, np.minimum(unit, most), unit)


def _linear_origins(
    model: TorqueModel,
    regression: Regression,
    constraints: Sequence[Constraint],
    base: BaseParameters,
) -> tuple[str, ...]:
    R, columns = regression.stacked(), list(base.independent)
    rows = solve_linear(R[:, columns], R[:, -1]).row_space @ base.projection
    return parameter_origins(rows, lowered(constraints, model).A_eq, elsewhere="prior")


def _verdicts(
    intervals: ConsistentIntervals, unit: Vector, origins: tuple[str, ...]
) -> list[str]:
    """Correct what linear algebra says by how wide the intervals are.

    Rank knows neither noise nor inequalities: what it calls determined may be anything
    within reason, and the consistency cone's boundary may determine the rest.
    """
    verdicts = []
    for width, size, origin in zip(intervals.width, unit, origins, strict=True):
        if origin == "data":
            verdicts.append("data" if width <= KNOWN * size else "prior")
        elif origin == "constraint" or width <= PINNED * size:
            verdicts.append("constraint")
        else:
            verdicts.append(origin)
    return verdicts


def _plain(record: dict[str, Any]) -> dict[str, Any]:
    def finite(value: Any) -> Any:
        if isinstance(value, tuple):
            return [finite(v) for v in value]
        return None if isinstance(value, float) and not np.isfinite(value) else value

    return {key: finite(value) for key, value in record.items()}
