"""Robots of one type, identified together.

Bodies are shared; friction, offsets and payloads are each robot's own. Own parameters
are projected out of each robot's regression, so the cost grows with the number of
robots and the shared problem has the size of one robot's; `settling` says how
constraints on them are kept.
"""

import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id._support.executors import Executor, single_threaded
from consistent_id._support.progress import Counter, counted
from consistent_id.constraints import Constraint, lowered
from consistent_id.constraints.priors import Prior
from consistent_id.errors import NotExcitedError, ProblemError
from consistent_id.estimation.best_fit import base_factor
from consistent_id.estimation.constrained import (
    constrained_least_squares,
)
from consistent_id.estimation.constrained_fit import (
    DEFAULT_CONSTRAINTS,
)
from consistent_id.estimation.estimate import Estimate
from consistent_id.fleet.fleet_model import (
    FleetModel,
    OwnSet,
    RobotShare,
    fleet_model,
    own_sets,
    read_share,
    robot_share,
    shared_constraints,
    write_share,
)
from consistent_id.fleet.fleet_result import Fleet, FleetRobot, Outliers, find_outliers
from consistent_id.fleet.payloads import (
    FREE,
    CarriedBody,
    PlacedBody,
    SharedErrors,
    found_payload,
    placed,
    shared_errors,
    without_load,
)
from consistent_id.fleet.settling import StoredRobot, held_rows, own_fits, settle
from consistent_id.fleet.stream import obstacle, stream_regression
from consistent_id.problems.loading import require_distinct
from consistent_id.problems.problem import Problem
from consistent_id.problems.robot_preparation import regression_of
from consistent_id.problems.stated_model import datasheet_of
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.parameters import did_you_mean


def identify_fleet(
    problems: Sequence[Problem],
    *,
    executor: str | Executor = "serial",
    progress: bool = False,
) -> Fleet:
    """Identify robots of one type from a problem file each.

    Bodies, rotor inertias, springs and coupled gears are shared, friction, offsets and
    the [payload] of its file are each robot's own.  Robots with other bodies are named
    and left out. Training recordings are used; they are streamed if possible, see
    `stream_regression`.

    Parameters
    ----------
    problems : sequence of Problem
        Problems of the same model, constraints and prior, with different names.
    executor : str or Executor
        Where the recordings are compressed, a robot at a time; the result does not
        depend on it.
    progress : bool
        Show the progress on the standard error.

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
    payloads = {p.name: body for p in problems if (body := carried_body(p)) is not None}
    first = next((p for p in problems if p.name not in payloads), None)
    if first is None:
        raise ProblemError(
            "fleet: every robot has a payload, so the data do not separate the link "
            "from its load; give a robot without [payload]"
        )
    for problem in problems:
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
    given = first.constraints, first.prior
    with counted(len(problems), "robots", progress) as count:
        told = _told(shares, count)
        found = _identified(fleet, told, payloads, *given)
    return replace(found, seconds=perf_counter() - started)


def fleet_estimate(
    model: TorqueModel,
    regressions: Mapping[str, Regression],
    *,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    prior: Prior | None = None,
    payloads: Mapping[str, CarriedBody] | None = None,
) -> Fleet:
    """Identify robots of one type from their regressions, by name.

    See `identify_fleet`; regressions are those of `stream_regression`,
    `build_regression` or `load_regression`, payloads what single robots carry.
    """
    if not regressions:
        raise ProblemError("there is no robot in the fleet")
    fleet = fleet_model(model)
    shares = (robot_share(name, fleet, r) for name, r in regressions.items())
    carried = {} if payloads is None else payloads
    for name in set(carried) - set(regressions):
        near = did_you_mean(name, list(regressions))
        raise ProblemError(f"payload of {name!r}: no such robot; {near}")
    return _identified(fleet, shares, carried, constraints, prior)


def carried_body(problem: Problem) -> CarriedBody | None:
    """Return the load that a problem's file states for its robot, if any."""
    table = problem.table.payload
    if table is None:
        return None
    return CarriedBody(table.link, datasheet_of(table))


def _share_of(fleet: FleetModel, problem: Problem) -> RobotShare:
    try:
        if obstacle(problem):
            regression = regression_of(problem.table, problem.model, problem.training)
        else:
            regression = stream_regression(problem)
        return robot_share(problem.name, fleet, regression)
    except NotExcitedError as cause:  # which says joints, but not of which robot
        raise NotExcitedError(f"{problem.name}: {cause}") from None


def _told(shares: Iterable[RobotShare], count: Counter) -> Iterator[RobotShare]:
    """Yield robots' shares; say how many there are, and whose was the last."""
    for done, share in enumerate(shares, start=1):
        count(done, f"({share.name})")
        yield share


@single_threaded
def _identified(
    fleet: FleetModel,
    shares: Iterable[RobotShare],
    payloads: Mapping[str, CarriedBody],
    constraints: Sequence[Constraint],
    prior: Prior | None,
) -> Fleet:
    started = perf_counter()
    limits = own_sets(fleet, lowered(constraints, fleet.whole))
    base = base_parameters(fleet.shared)
    kept = shared_constraints(fleet, constraints)
    places = {name: placed(fleet, body, name) for name, body in payloads.items()}
    with tempfile.TemporaryDirectory(prefix="consistent-id-fleet-") as folder:
        robots, factors = _stored(shares, Path(folder), base, places)
        outliers = find_outliers(factors)
        solved = partial(
            constrained_least_squares,
            fleet.shared,
            constraints=kept,
            prior=prior,
            base=base,
            method="fleet",
        )
        pairs = zip(robots, outliers.named, strict=True)
        alike = [robot for robot, out in pairs if not out]
        settled = settle(fleet, alike, limits, solved)
        known = lowered(kept, fleet.shared).A_eq
        errors = shared_errors(settled.shared, settled.bodies, known)
        shared = _SharedResult(fleet, limits, settled.bodies, errors)
        found = tuple(
            shared.robot(robot, outliers, k) for k, robot in enumerate(robots)
        )
    return Fleet(
        model=fleet.whole,
        bodies=settled.bodies,
        robots=found,
        spread=outliers.spread,
        settled=settled.settled,
        seconds=perf_counter() - started,
    )


def _stored(
    shares: Iterable[RobotShare],
    folder: Path,
    base: BaseParameters,
    places: Mapping[str, PlacedBody],
) -> tuple[list[StoredRobot], list[Matrix]]:
    """Write the robots' parts to a folder; return the parts that stay in memory.

    Beside the robots these are the factors by which outliers are found.
    """
    robots, factors = [], []
    for k, share in enumerate(shares):
        file, place, r = folder / f"{k}.npz", places.get(share.name), share.shared
        write_share(file, share)
        alike = r.weighted(share.level)
        if place is not None:
            alike = without_load(alike, place, FREE)
        factors.append(base_factor(alike, base))
        ends = share.torque, share.alone, max(r.counts)
        robots.append(StoredRobot(share.name, file, share.own, r.sigma, *ends, place))
    return robots, factors


class _SharedResult(NamedTuple):
    """The bodies that robots share, with their errors, and the limits of the rest."""

    fleet: FleetModel
    limits: Sequence[OwnSet]
    bodies: Estimate
    errors: SharedErrors

    def robot(self, robot: StoredRobot, outliers: Outliers, number: int) -> FleetRobot:
        """Return the result for one robot."""
        x, payload = self.bodies.parameters, None
        if robot.place is not None:
            held = held_rows(self.fleet, robot, robot.place, x, self.limits)
            payload = found_payload(held, robot.place, self.bodies, self.errors)
            x = robot.place.added(x, payload.estimate.parameters)
        own = [fit.values for fit in own_fits(robot, x, self.limits)]
        regression, z = read_share(robot.file, self.fleet), np.append(x, -1.0)
        left = [F @ z for F in regression.factors]
        pairs = zip(robot.own, own, strict=True)
        left += [rows @ np.concatenate([y, z]) for rows, y in pairs]
        misfit = float(np.linalg.norm(np.concatenate(left)))
        size = max(robot.torque, float(np.finfo(float).tiny))
        return FleetRobot(
            name=robot.name,
            samples=robot.samples,
            parameters=self.fleet.parameters(x, own),
            misfit=misfit / size,
            alone=robot.alone / size,
            statistic=float(outliers.statistic[number]),
            freedom=int(outliers.freedom[number]),
            p_value=float(outliers.p_values[number]),
            outlier=bool(outliers.named[number]),
            payload=payload,
        )
