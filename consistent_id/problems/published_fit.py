"""A paper's least squares, done again."""

from time import perf_counter

import numpy as np

from consistent_id.constraints import FixedCentresOfMass, FixedMasses, lowered
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.fit import fit_of
from consistent_id.estimation.least_squares import stationarity_certificate
from consistent_id.estimation.method import Method
from consistent_id.problems.parametrisation import Combination, Parametrisation
from consistent_id.problems.problem import Problem
from consistent_id.problems.published import parametrisation_of, published_table
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import (
    BaseParameters,
    base_parameters,
    open_combinations,
    parameter_origins,
)
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.noise import residual_sigma
from consistent_id.regression.regression import build_regression
from consistent_id.regression.regressor import TorqueModel


def published_least_squares(
    problem: Problem,
    recording: Recording,
    *,
    base: BaseParameters | None = None,
    drive: DriveTerms | None = None,
) -> Estimate:
    """Identify as the paper did: its parameters, some fixed from the datasheet.

    The smallest of all vectors that fit best, where the paper's ``Y^T Y`` is singular;
    the estimate names the combinations that are not identifiable.

    Parameters
    ----------
    base : BaseParameters, optional
        Of the problem's model, or of the one with `drive`.
    drive : DriveTerms, optional
        Friction and drive terms of each joint that the paper left out.
    """
    started = perf_counter()
    mine, table = parametrisation_of(problem), published_table(problem)
    if drive is not None:
        mine = _with_drive(mine, drive)
    model = mine.model
    known = lowered((FixedMasses(), FixedCentresOfMass()), model)
    fixed, free = mine.places(table.fixed), mine.others(table.fixed)
    alpha = mine.matrix @ mine.parameters(np.zeros(len(mine)), known)
    R = mine.factor(recording)
    target = R[:, -1] - R[:, fixed] @ alpha[fixed]
    solution = solve_linear(R[:, free], target)
    alpha[free] = solution.x
    x = mine.parameters(alpha, known)
    base = base_parameters(model) if base is None else base
    regression = build_regression(model, recording)
    names = tuple(mine.names[i] for i in free)
    return Estimate(
        method=Method.AS_PUBLISHED
        if drive is None
        else Method.AS_PUBLISHED_WITH_FRICTION,
        model=model,
        base=base,
        parameters=x,
        base_covariance=None,
        origins=parameter_origins(
            solution.row_space @ mine.matrix[free], known.A_eq, elsewhere="convention"
        ),
        undetermined=open_combinations(solution, names),
        sigma=residual_sigma(regression, x, solution.rank),
        certificate=stationarity_certificate(R[:, free], target, solution),
        notes=(
            f"the data determine {solution.rank} of {len(free)} free parameters; this "
            "is the smallest of all vectors that fit best",
        ),
        seconds=perf_counter() - started,
        fit=fit_of(model, regression, x, base),
    )


def _with_drive(mine: Parametrisation, drive: DriveTerms) -> Parametrisation:
    """Return a parametrisation with each drive parameter as one more combination."""
    model = TorqueModel(mine.model.robot, drive)
    layout, start = model.layout, model.layout.inertial_size
    added = tuple(
        Combination(name, name, unit, {name: 1.0})
        for name, unit in zip(layout.names[start:], layout.units[start:], strict=True)
    )
    return Parametrisation(model, (*mine.combinations, *added), mine.zero)
