"""The assumptions of a following estimate, and its state after a block of samples.

It assumes noise, typical sizes, an anchor and constraints; it knows an estimate with
its verdict.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.tables import brief
from consistent_id.constraints import Constraint, lowered
from consistent_id.constraints.cones.certificate import Optimality
from consistent_id.constraints.cones.sets import ConicSet, SemidefiniteBlock
from consistent_id.constraints.delivered_bodies import LinkCondition
from consistent_id.estimation.constrained_fit import DEFAULT_CONSTRAINTS
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.judgement import HELD_OUT_CARE, NO_BETTER_THAN_ZERO
from consistent_id.estimation.torque_error import holding
from consistent_id.estimation.verdict import Reason, Verdict, Word, percent, weighed
from consistent_id.recordings.recording import Recording
from consistent_id.robot.inertia import PSEUDO_INERTIA_BASIS, pseudo_inertia
from consistent_id.robot.scaling import link_scales
from consistent_id.service.load_watch import WatchedBlock
from consistent_id.service.warm_fit import ConeCoordinates, PathPoint, cone_coordinates

ARM = 0.2
"""Typical distance of a load's centre of mass from its link's frame, [m]."""

_LEAST_DRIVE = 0.1  # of the largest of its kind: typical size of a drive's parameter


class LoadPlace(NamedTuple):
    """The number of the link that carries loads, and the mass of the largest [kg]."""

    link: int
    capacity: float


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Regime:
    """The assumptions about the robot, with or without a load.

    Parameters
    ----------
    cone : ConeCoordinates
    anchor : ndarray, shape (parameters,)
        Inverse widths of parameters about the start.
    """

    cone: ConeCoordinates
    anchor: Vector


def noise_of(estimate: Estimate) -> Vector:
    """Return each joint's noise, times the root of the correlation in samples."""
    fit = estimate.fit
    alike = 1.0 if fit is None or np.isnan(fit.correlation) else fit.correlation
    return np.asarray(estimate.sigma * np.sqrt(max(alike, 1.0)))


def held_of(estimate: Estimate) -> Vector:
    """Return the friction that may balance each joint at rest, [N m or N]."""
    joints = len(estimate.sigma)
    held = holding(estimate.model, estimate.parameters, np.full(joints, np.nan))
    return np.asarray(np.where(np.isfinite(held), held, 0.0))


def units_of(estimate: Estimate) -> Vector:
    """Return the typical size of each parameter."""
    layout, x = estimate.model.layout, estimate.parameters
    first = layout.inertial_size
    sizes = abs(x[first:])
    terms = np.array([term for _, term in layout.drive])
    for term in set(terms.tolist()):
        same = terms == term
        largest = float(sizes[same].max())
        sizes[same] = np.maximum(sizes[same], _LEAST_DRIVE * (largest or 1.0))
    return np.concatenate([link_scales(estimate.model.robot).units, sizes])


def regimes_of(
    estimate: Estimate,
    constraints: Sequence[Constraint] | None,
    bodies: float,
    load: LoadPlace,
) -> tuple[Regime, Regime]:
    """Return what is assumed of the robot without a load, and with one.

    Parameters
    ----------
    estimate : Estimate
    constraints : sequence of Constraint, optional
        By default those of the estimate.
    bodies : float
        Standard deviation of bodies, relative to their typical size.
    load : LoadPlace
    """
    model, x, unit = estimate.model, estimate.parameters, units_of(estimate)
    given = constraints
    if given is None:
        under = estimate.fitted_under
        given = DEFAULT_CONSTRAINTS if under is None else under.constraints
    known = lowered(given, model)
    widths = unit.copy()
    widths[: model.layout.inertial_size] *= bodies
    alone = Regime(cone_coordinates(known.normalised(unit)), 1.0 / widths)
    own = model.layout.link_slice(load.link)
    widths[own] = load.capacity * np.array([1.0, *[ARM] * 3, *[ARM**2] * 6])
    root = np.sqrt(load.capacity) * np.array([ARM, ARM, ARM, 1.0])
    coefficients = np.zeros((len(unit), 4, 4))
    coefficients[own] = PSEUDO_INERTIA_BASIS
    body = SemidefiniteBlock(
        "load: physical consistency", coefficients, -pseudo_inertia(x[own]), root
    )
    others = _without_link(known, own, model.layout.links[load.link])
    loaded = others & ConicSet.semidefinite([body], len(unit))
    return alone, Regime(cone_coordinates(loaded.normalised(unit)), 1.0 / widths)


def _without_link(known: ConicSet, own: slice, consistent: str) -> ConicSet:
    """Return a set without the constraints on a link's body.

    Rows and blocks that contain its parameters, such as its shape, are not of a link
    with a load; its physical consistency, the block of that label, is.
    """
    rows = np.vstack([known.A_eq, known.A_in])[:, own].any(axis=1)
    keep = np.flatnonzero(~rows).tolist()
    first = len(known.b_eq) + len(known.b_in)
    blocks = [
        first + place
        for place, block in enumerate(known.blocks)
        if block.label == consistent or not block.coefficients[own].any()
    ]
    return known.only([*keep, *blocks])


METHOD = "followed"


@brief
@dataclass(frozen=True, slots=True, eq=False)
class WaitingBlock:
    """A block that waits until it is sure that no load came within it."""

    watched: WatchedBlock
    rows: Matrix


@brief
@dataclass(frozen=True, slots=True, eq=False)
class LoadChange:
    """A change of the load that was announced.

    Parameters
    ----------
    time : float, [s]
        Time of the announcement.
    loaded : bool
        Whether the robot carries a load since then.
    score : float
        Over the limit.
    """

    time: float
    loaded: bool
    score: float


@brief
@dataclass(frozen=True, slots=True, eq=False)
class OnlineState:
    """The state after a block.

    Parameters
    ----------
    time, solved : float, [s]
        Times of the last sample, and of the sample at the last solution.
    factor : ndarray, shape (parameters + 1, parameters + 1)
        ``||factor [x, -1]||^2`` is the weighted squared misfit of all samples so far,
        each faded by its age.
    weight : float
        Samples that count, faded.
    errors : ndarray, shape (torque joints, 2), [(N m)^2 or N^2]
        Faded sums of squared prediction errors and squared torques: each block is
        predicted before it is learned from.
    parameters, deviations : ndarray, shape (parameters,)
        The estimate, and standard errors of samples and anchor under the equalities:
        zero for a mass that one fixes.  Inequalities and cones do not count.
    optimality : Optimality
    change : LoadChange, optional
        The last announcement.
    score : float
        Score of the watch, over its limit: 1 or more announces a change.
    relearned : float, [s]
        Time at which the carrying link's body was last forgotten.
    verdict : Verdict
    """

    time: float
    solved: float
    factor: Matrix
    weight: float
    errors: Matrix
    parameters: Vector
    deviations: Vector
    carried: Matrix
    optimality: Optimality
    verdict: Verdict
    change: LoadChange | None = None
    score: float = 0.0
    relearned: float = -np.inf
    path: tuple[PathPoint, ...] = ()
    waiting: tuple[WaitingBlock, ...] = ()
    tail: Recording | None = None

    def __repr__(self) -> str:
        load = "with a load" if self.loaded else "no load"
        return f"OnlineState({self.time:.6g} s, {load}, {self.verdict})"

    @property
    def loaded(self) -> bool:
        """Whether a load was announced that the robot carries."""
        return self.change is not None and self.change.loaded

    @property
    def prediction_errors(self) -> Vector:
        """RMS error of each joint's predicted torque over its RMS torque."""
        torque = np.maximum(self.errors[:, 1], np.finfo(float).tiny)
        return np.asarray(np.sqrt(self.errors[:, 0] / torque))


def verdict_of(
    state: OnlineState, start: Verdict, links: Sequence[LinkCondition]
) -> Verdict:
    """Return whether the followed estimate may be used, and why not.

    Parameters
    ----------
    links : sequence of LinkCondition
        Conditions of the followed parameters: constraints of one's own may allow bodies
        that no matter has.
    start : Verdict
        On the estimate that it began from, to which the anchor holds all that the
        samples do not determine.
    """
    errors = state.errors.sum(axis=0)
    error = float(np.sqrt(errors[0] / errors[1])) if errors[1] > 0.0 else None
    reasons = [*_of_start(start), *_of_links(links), *_reasons(state, error)]
    return weighed(METHOD, reasons, (), error, ())


def _of_start(start: Verdict) -> Iterator[Reason]:
    if start.word != "use":
        kinds = ", ".join(dict.fromkeys(r.kind for r in start.grounds))
        yield Reason(
            "start",
            start.word,
            f"the verdict on the estimate at the start is {start.word!r}: {kinds}",
            "identify the robot again, and begin with that estimate",
        )


def _of_links(links: Sequence[LinkCondition]) -> Iterator[Reason]:
    wrong = [link.link for link in links if not link.consistent]
    if wrong:
        yield Reason(
            "inconsistent bodies",
            "do not use",
            f"not physically consistent: {', '.join(wrong)}",
            "follow with PhysicalConsistency() among the constraints",
        )


def _reasons(state: OnlineState, error: float | None) -> Iterator[Reason]:
    if state.optimality.verdict != "certified":
        yield Reason(
            "optimum",
            "do not use",
            f"the optimum is known only to a relative gap of {state.optimality.gap:.1e}"
            f", constraints to {state.optimality.violation:.1e}",
            "begin again with `start`",
        )
    if error is not None and error > HELD_OUT_CARE:
        word: Word = "do not use" if error > NO_BETTER_THAN_ZERO else "use with care"
        yield Reason(
            "prediction error",
            word,
            f"the torque of the last blocks was predicted with an error of "
            f"{percent(error)}, each before it was learned from",
            "look for a collision, a load that was not announced, or wrong torques",
        )
    if state.loaded and state.change is not None:
        yield Reason(
            "load",
            "use",
            f"a load came, announced at {state.change.time:.6g} s",
        )
