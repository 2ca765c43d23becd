"""The shared problem of a fleet, solved until convergence.

Robots' own parameters have been projected out of their rows without constraints. If
constraints are active, the rows that the constrained parameters do not explain are
added to the shared problem, and it is solved again, until no active bound of friction
or offsets changes, and payloads have converged. The result is the optimum of all robots
together.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.executors import tree_reduced
from consistent_id.errors import ProblemError
from consistent_id.estimation.estimate import Estimate
from consistent_id.fleet.fleet_model import (
    FleetModel,
    OwnFit,
    OwnSet,
    bound_rows,
    own_fit,
    read_share,
)
from consistent_id.fleet.payloads import (
    FREE,
    LoadFit,
    PlacedBody,
    load_fit,
    without_load,
)
from consistent_id.regression.regression import Regression, triangle

_ROUNDS = 30  # of the shared problem, until nothing changes
_SAME = 1e-8  # relative squared misfit for convergence of payloads


@dataclass(frozen=True, eq=False)
class StoredRobot:
    """The data of a robot in memory.

    Parameters
    ----------
    file : Path
        File of its share; see `share_files`.
    own : tuple of ndarray
        See `RobotShare.own`.
    sigma : ndarray, shape (joints,), [N m or N]
        Its noise.
    torque, alone : float, [N m or N]
        See `RobotShare`.
    place : PlacedBody, optional
        Body that it carries.
    """

    name: str
    file: Path
    own: tuple[Matrix, ...]
    sigma: Vector
    torque: float
    alone: float
    samples: int
    place: PlacedBody | None = None


@dataclass(frozen=True, eq=False)
class Settled:
    """The shared estimate, and the data that it was found from.

    Parameters
    ----------
    shared : Regression
        Regression of the shared parameters, without the robots' own.
    settled : bool
        Whether the iteration converged.
    """

    bodies: Estimate
    shared: Regression
    settled: bool


@dataclass(frozen=True, eq=False)
class _Own:
    """A robot's own parameters, beside given shared ones.

    `surprise` is the relative difference of its squared misfit from that which was
    assumed when the shared parameters were found.
    """

    fits: tuple[OwnFit, ...]
    load: LoadFit = FREE
    surprise: float = 0.0

    def follows(self, before: "_Own") -> bool:
        """Return whether it is what the shared parameters were found with."""
        pairs = zip(before.fits, self.fits, strict=True)
        return self.surprise <= _SAME and all(a.bound == b.bound for a, b in pairs)


class _CarryingRobot(NamedTuple):
    """A robot that carries something, and where."""

    robot: StoredRobot
    place: PlacedBody


def settle(
    fleet: FleetModel,
    robots: Sequence[StoredRobot],
    limits: Sequence[OwnSet],
    solved: Callable[[Regression], Estimate],
) -> Settled:
    """Solve the shared problem until nothing of the robots' own changes.

    Parameters
    ----------
    robots : sequence of StoredRobot
        Robots whose bodies are alike.
    limits : sequence of OwnSet
        On own parameters, by joint.
    solved : callable
        From a regression of the shared parameters to their estimate.

    Raises
    ------
    ProblemError
        If there is no robot.
    """
    if not robots:
        raise ProblemError("no robot is left to share bodies with others; give more")
    plain = [robot for robot in robots if robot.place is None]
    loaded = [_CarryingRobot(r, r.place) for r in robots if r.place is not None]
    reference = robots[0].sigma
    read = (_scaled(read_share(robot.file, fleet), reference) for robot in plain)
    start = tree_reduced(read, Regression.__add__)  # read once, whatever the rounds
    nothing = _Own((OwnFit(np.zeros(0), ()),) * len(limits))
    of_plain, of_loaded = [nothing] * len(plain), [nothing] * len(loaded)
    for _ in range(_ROUNDS):
        first = [] if start is None else [_with_held(start, plain, of_plain, limits)]
        others = (
            _scaled(
                without_load(_held(fleet, robot, own, limits), place, own.load),
                reference,
            )
            for (robot, place), own in zip(loaded, of_loaded, strict=True)
        )
        shared = reduce(Regression.__add__, chain(first, others))
        bodies = solved(shared)
        x, before = bodies.parameters, [*of_plain, *of_loaded]
        of_plain = [_Own(own_fits(robot, x, limits)) for robot in plain]
        of_loaded = [
            _loaded(_held(fleet, one.robot, own, limits), one, own, x, limits)
            for one, own in zip(loaded, of_loaded, strict=True)
        ]
        after = [*of_plain, *of_loaded]
        if all(b.follows(a) for a, b in zip(before, after, strict=True)):
            return Settled(bodies, shared, True)
    return Settled(bodies, shared, False)


def own_fits(
    robot: StoredRobot, shared: Vector, limits: Sequence[OwnSet]
) -> tuple[OwnFit, ...]:
    """Return a robot's friction and offsets, joint by joint.

    Parameters
    ----------
    shared : ndarray
        Shared parameters, its load in its carrier.
    """
    pairs = zip(robot.own, limits, strict=True)
    return tuple(own_fit(rows, shared, limit) for rows, limit in pairs)


def _scaled(regression: Regression, reference: Vector) -> Regression:
    """Return a robot's regression in the noise of a reference."""
    scale, noise = reference / regression.sigma, regression.noise
    if noise is not None:
        noise = noise.through(lambda j, N: N * scale[j] ** 2)
    factors = tuple(F * c for F, c in zip(regression.factors, scale, strict=True))
    return replace(
        regression,
        factors=factors,
        noise=noise,
        sigma=reference,
        peaks=regression.peaks * scale,
    )


def _with_held(
    shared: Regression,
    robots: Sequence[StoredRobot],
    own: Sequence[_Own],
    limits: Sequence[OwnSet],
) -> Regression:
    """Return a regression with the rows that robots' fixed parameters leave."""
    factors = []
    for j, limit in enumerate(limits):
        extra = [
            bound_rows(robot.own[j], len(shared.layout), limit, mine.fits[j])
            * (shared.sigma[j] / robot.sigma[j])
            for robot, mine in zip(robots, own, strict=True)
            if mine.fits[j].bound or len(limit.b_eq)
        ]
        rows = np.vstack([shared.factors[j], *extra])
        factors.append(triangle(np.asfortranarray(rows)))
    return replace(shared, factors=tuple(factors))


def held_rows(
    fleet: FleetModel,
    robot: StoredRobot,
    place: PlacedBody,
    shared: Vector,
    limits: Sequence[OwnSet],
) -> Regression:
    """Return a robot's regression with the rows that friction at bounds leaves.

    Beside given shared parameters, whatever it carries fitting best.
    """
    own = _Own((OwnFit(np.zeros(0), ()),) * len(limits))
    for _ in range(_ROUNDS):
        held = _held(fleet, robot, own, limits)
        load = load_fit(held, place, shared)
        before = own
        own = _Own(own_fits(robot, place.added(shared, load.body), limits))
        if own.follows(before):
            break
    return held


def _held(
    fleet: FleetModel, robot: StoredRobot, own: _Own, limits: Sequence[OwnSet]
) -> Regression:
    """Return a robot's own regression, with the rows that fixed parameters leave."""
    return _with_held(read_share(robot.file, fleet), [robot], [own], limits)


def _loaded(
    held: Regression,
    loaded: _CarryingRobot,
    own: _Own,
    shared: Vector,
    limits: Sequence[OwnSet],
) -> _Own:
    """Return the own part of a robot that carries something."""
    robot, place = loaded
    thought = without_load(held, place, own.load)
    rows = thought.residual_rms(shared) / thought.sigma
    expected = float(np.sum(rows**2 * thought.counts))
    load = load_fit(held, place, shared)
    fits = own_fits(robot, place.added(shared, load.body), limits)
    return _Own(fits, load, abs(load.misfit / expected - 1.0))
