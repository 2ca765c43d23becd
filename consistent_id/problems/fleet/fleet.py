"""Robots of one type, identified together.

Bodies are shared, friction and offsets each robot's own.  Own parameters are taken out
of each robot's regression, so that the cost grows with the number of robots and the
shared problem has the size of one robot's.  Where a robot's own parameters are held by
constraints, the rows that they then fail to explain go back to the shared problem, and
it is solved again, until no bound changes: that is the optimum of all together.
"""

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.executors import Executor, tree_reduced
from consistent_id._support.threads import single_threaded
from consistent_id.constraints import Constraint, lowered
from consistent_id.constraints.priors import Prior
from consistent_id.errors import NotExcitedError, ProblemError
from consistent_id.estimation.constrained import (
    DEFAULT_CONSTRAINTS,
    constrained_least_squares,
)
from consistent_id.estimation.estimate import Estimate
from consistent_id.problems.fleet.fleet_model import (
    FleetModel,
    OwnSet,
    fleet_model,
    own_sets,
    shared_constraints,
)
from consistent_id.problems.fleet.fleet_result import Fleet, FleetRobot
from consistent_id.problems.fleet.outliers import Outliers, find_outliers
from consistent_id.problems.fleet.robot_share import (
    OwnFit,
    RobotShare,
    bound_rows,
    own_fit,
    robot_share,
)
from consistent_id.problems.fleet.share_files import read_share, write_share
from consistent_id.problems.problem import Problem
from consistent_id.problems.several import require_distinct
from consistent_id.problems.streaming.obstacle import obstacle
from consistent_id.problems.streaming.stream import stream_regression
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.correlated_noise import CorrelatedNoise
from consistent_id.regression.regression import Regression, build_regression, triangle
from consistent_id.regression.regressor import TorqueModel

_ROUNDS = 20  # of the shared problem, until no bound of own parameters changes


def identify_fleet(
    problems: Sequence[Problem], *, executor: str | Executor = "serial"
) -> Fleet:
    """Identify robots of one type from a problem file each.

    Bodies, rotor inertias, springs and coupled gears are shared, friction and offsets
    each robot's own; robots whose bodies are others are named and left out of what is
    shared.  Training recordings count; they are streamed if that is possible, see
    `stream_regression`.

    Parameters
    ----------
    problems : sequence of Problem
        Of the same model, constraints and prior, with different names.
    executor : str or Executor
        Where the recordings are compressed, a robot at a time; the result does not
        depend on it.

    Raises
    ------
    ProblemError
        If the problems do not belong together.
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    if not problems:
        raise ProblemError("there is no robot in the fleet")
    require_distinct([problem.name for problem in problems])
    first = problems[0]
    for problem in problems[1:]:
        for what in ("constraints", "prior", "links"):
            if getattr(problem.table, what) != getattr(first.table, what):
                raise ProblemError(
                    f"fleet: {problem.name} has other [{what}] than {first.name}; "
                    "robots of a fleet have the same"
                )
        if problem.model.fingerprint != first.model.fingerprint:
            raise ProblemError(
                f"fleet: {problem.name} has another model than {first.name}: geometry, "
                "gravity or drive terms differ; identify the two types by themselves"
            )
    started = perf_counter()
    fleet = fleet_model(first.model)
    shares = Executor.named(executor).map(partial(_share_of, fleet), problems)
    return _identified(fleet, shares, first.constraints, first.prior, started)


def fleet_estimate(
    model: TorqueModel,
    regressions: Mapping[str, Regression],
    *,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    prior: Prior | None = None,
) -> Fleet:
    """Identify robots of one type from their regressions, by name.

    See `identify_fleet`; regressions are those of `stream_regression`,
    `build_regression` or `load_regression`.
    """
    if not regressions:
        raise ProblemError("there is no robot in the fleet")
    started, fleet = perf_counter(), fleet_model(model)
    shares = (robot_share(name, fleet, r) for name, r in regressions.items())
    return _identified(fleet, shares, constraints, prior, started)


def _share_of(fleet: FleetModel, problem: Problem) -> RobotShare:
    try:
        if obstacle(problem, "training"):
            regression = build_regression(problem.model, problem.training)
        else:
            regression = stream_regression(problem)
        return robot_share(problem.name, fleet, regression)
    except NotExcitedError as cause:  # which says joints, but not of which robot
        raise NotExcitedError(f"{problem.name}: {cause}") from None


@dataclass(frozen=True, eq=False)
class _Robot:
    """What memory holds of a robot."""

    name: str
    file: Path
    own: tuple[Matrix, ...]
    sigma: Vector
    torque: float
    alone: float
    samples: int


@single_threaded
def _identified(
    fleet: FleetModel,
    shares: Iterable[RobotShare],
    constraints: Sequence[Constraint],
    prior: Prior | None,
    started: float,
) -> Fleet:
    limits = own_sets(fleet, lowered(constraints, fleet.whole))
    base = base_parameters(fleet.shared)
    with tempfile.TemporaryDirectory(prefix="consistent-id-fleet-") as folder:
        robots, factors = _stored(shares, Path(folder), base)
        outliers = find_outliers(factors)
        alike = [
            robot for robot, out in zip(robots, outliers.named, strict=True) if not out
        ]
        shared = _together(fleet, alike)
        solved = partial(
            constrained_least_squares,
            fleet.shared,
            constraints=shared_constraints(fleet, constraints),
            prior=prior,
            base=base,
            method="fleet",
        )
        bodies, settled = _settled(fleet, alike, shared, limits, solved)
        found = tuple(
            _robot(fleet, robot, bodies.parameters, limits, outliers, k)
            for k, robot in enumerate(robots)
        )
    return Fleet(
        model=fleet.whole,
        bodies=bodies,
        robots=found,
        spread=outliers.spread,
        settled=settled,
        seconds=perf_counter() - started,
    )


def _stored(
    shares: Iterable[RobotShare], folder: Path, base: BaseParameters
) -> tuple[list[_Robot], list[Matrix]]:
    """Write the robots' parts to a folder; return what memory holds of them.

    Beside the robots these are the factors by which outliers are found.
    """
    robots, factors = [], []
    for k, share in enumerate(shares):
        file = folder / f"{k}.npz"
        write_share(file, share)
        factors.append(_weighted(share, base))
        r = share.shared
        ends = share.torque, share.alone, max(r.counts)
        robots.append(_Robot(share.name, file, share.own, r.sigma, *ends))
    return robots, factors


def _weighted(share: RobotShare, base: BaseParameters) -> Matrix:
    """Return the factor of shared base parameters, rows divided by the noise."""
    pairs = zip(share.shared.factors, share.level, strict=True)
    rows = np.vstack([F[:, [*base.independent, -1]] / level for F, level in pairs])
    return triangle(np.asfortranarray(rows))


def _together(fleet: FleetModel, robots: Sequence[_Robot]) -> Regression:
    """Return the regression of what robots share, in the noise of the first."""
    reference = robots[0].sigma

    def weighted(robot: _Robot) -> Regression:
        r = read_share(robot.file, fleet)
        scale = reference / r.sigma
        noise = r.noise
        if noise is not None:
            scores = zip(noise.scores, scale, strict=True)
            noise = CorrelatedNoise(noise.effective, tuple(N * c**2 for N, c in scores))
        factors = tuple(F * c for F, c in zip(r.factors, scale, strict=True))
        return replace(
            r, factors=factors, noise=noise, sigma=reference, peaks=r.peaks * scale
        )

    whole = tree_reduced(map(weighted, robots), Regression.__add__)
    if whole is None:
        raise ProblemError("no robot is left to share bodies with others; give more")
    return whole


def _settled(
    fleet: FleetModel,
    robots: Sequence[_Robot],
    shared: Regression,
    limits: Sequence[OwnSet],
    solved: "partial[Estimate]",
) -> tuple[Estimate, bool]:
    """Solve the shared problem until no bound of own parameters changes."""
    nothing = np.zeros(0)
    bounds = [[OwnFit(nothing, ()) for _ in limits] for _ in robots]
    for _ in range(_ROUNDS):
        factors = []
        for j, limit in enumerate(limits):
            extra = [
                bound_rows(robot.own[j], len(shared.layout), limit, fits[j])
                * (shared.sigma[j] / robot.sigma[j])
                for robot, fits in zip(robots, bounds, strict=True)
                if fits[j].bound or len(limit.b_eq)
            ]
            rows = np.vstack([shared.factors[j], *extra])
            factors.append(triangle(np.asfortranarray(rows)))
        bodies = solved(replace(shared, factors=tuple(factors)))
        found = [_own(robot, bodies.parameters, limits) for robot in robots]
        if [_reached(f) for f in found] == [_reached(f) for f in bounds]:
            return bodies, True
        bounds = found
    return bodies, False


def _own(robot: _Robot, shared: Vector, limits: Sequence[OwnSet]) -> list[OwnFit]:
    pairs = zip(robot.own, limits, strict=True)
    return [own_fit(rows, shared, limit) for rows, limit in pairs]


def _reached(fits: Sequence[OwnFit]) -> list[tuple[int, ...]]:
    return [fit.bound for fit in fits]


def _robot(
    fleet: FleetModel,
    robot: _Robot,
    shared: Vector,
    limits: Sequence[OwnSet],
    outliers: Outliers,
    place: int,
) -> FleetRobot:
    """Return what was found of one robot."""
    own = [fit.values for fit in _own(robot, shared, limits)]
    regression = read_share(robot.file, fleet)
    z = np.append(shared, -1.0)
    left = [F @ z for F in regression.factors]
    left += [
        rows @ np.concatenate([y, z]) for rows, y in zip(robot.own, own, strict=True)
    ]
    misfit = float(np.linalg.norm(np.concatenate(left)))
    size = max(robot.torque, float(np.finfo(float).tiny))
    return FleetRobot(
        name=robot.name,
        samples=robot.samples,
        parameters=fleet.parameters(shared, own),
        misfit=misfit / size,
        alone=robot.alone / size,
        statistic=float(outliers.statistic[place]),
        freedom=int(outliers.freedom[place]),
        p_value=float(outliers.p_values[place]),
        outlier=bool(outliers.named[place]),
    )
