"""Whether least squares contradicts physical consistency, and how far it is from it.

Least squares determines base parameters only; infinitely many standard parameters share
them.  It contradicts physics when none of those is physically consistent:
`base_feasibility`.  `consistency_test` says whether the data contradict it, too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from consistent_id._support.arrays import Array, Vector, frozen
from consistent_id._support.executors import single_threaded
from consistent_id._support.tables import brief
from consistent_id.constraints import Constraint, PhysicalConsistency, lowered
from consistent_id.constraints.cones.certificate import OptimumVerdict, solve_certified
from consistent_id.constraints.cones.interior import Interior, find_interior
from consistent_id.constraints.cones.least_norm import LeastNorm, solve_least_norm
from consistent_id.constraints.cones.sets import ConicSet, SemidefiniteBlock
from consistent_id.constraints.priors import nominal_point
from consistent_id.errors import ProblemError, SolverError
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_structure import random_rows
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.scaling import link_scales

_BACK_OFF = 0.01  # share of the margin sacrificed for smaller, more readable numbers
_SMALL = 5e-7  # half the squared torque change, relative, that counts as zero
_UNDECIDED = 1e-9  # margins nearer to zero than this prove nothing


@dataclass(frozen=True, slots=True, eq=False)
class LinkViolation:
    """The fault of a link, for any other links.

    Parameters
    ----------
    margin : float
        Largest least eigenvalue of the link's pseudo-inertia, divided by its typical
        mass and length, over all parameters with the given base parameters; negative.
    statement : str
        The violated inequality and by how much, at the least violating parameters.
    """

    link: str
    margin: float
    statement: str


@dataclass(frozen=True, slots=True, eq=False)
class NearestRobot:
    """The robot that satisfies the constraints and whose torque differs least.

    Parameters
    ----------
    parameters : ndarray, shape (parameters,)
    torque_change : float
        Root-mean-square difference of the torque along random motions, relative to
        the torque that the given base parameters predict.
    verdict : {"certified", "uncertified"}
        Whether no nearer one exists.
    """

    parameters: Vector
    torque_change: float
    verdict: OptimumVerdict


@brief
@dataclass(frozen=True, eq=False)
class BaseFeasibility:
    """Answer to "is there a consistent robot with these base parameters?".

    Parameters
    ----------
    answer : {"consistent", "impossible", "undecided"}
        ``"consistent"`` with `parameters` as a witness; ``"impossible"`` with
        multipliers as a proof (`proof.bound` is negative); ``"undecided"`` very
        near the boundary, or when the solver fails.
    proof : Interior
        In dimensionless parameters.
    parameters : ndarray
        The least violating parameters, in original units.
    violations : tuple of LinkViolation
        Links that cannot be consistent even alone.
    search : callable, optional
        Returns `nearest`, if the answer is ``"impossible"``.
    """

    answer: str
    proof: Interior
    parameters: Vector
    violations: tuple[LinkViolation, ...]
    search: Callable[[], NearestRobot | None] | None = field(default=None, repr=False)

    @cached_property
    def nearest(self) -> NearestRobot | None:
        """The nearest consistent robot, if the answer is ``"impossible"``.

        It is searched for when first needed; None if none was found.
        """
        return None if self.search is None else self.search()

    @property
    def summary(self) -> str:
        """The answer in one sentence."""
        if self.answer == "consistent":
            return "a consistent robot with these base parameters exists"
        if self.answer == "undecided":
            return "neither a consistent robot nor a proof that there is none was found"
        within = (
            f"(proven among parameters up to {self.proof.reach:.0f} times the typical)"
        )
        if self.violations:
            said = "; ".join(v.statement for v in self.violations)
            return f"impossible: {said} {within}"
        blamed = ", ".join(self.proof.to_blame)
        return f"impossible: {blamed} contradict each other {within}"


@single_threaded
def base_feasibility(
    model: TorqueModel,
    base: BaseParameters,
    base_values: Vector,
    *,
    constraints: Sequence[Constraint] = (PhysicalConsistency(margin=0.0),),
    witness: Vector | None = None,
) -> BaseFeasibility:
    """Ask whether any parameters with these base parameters satisfy the constraints.

    Parameters
    ----------
    model : TorqueModel
    base : BaseParameters
    base_values : ndarray, shape (base,)
    constraints : sequence of Constraint
        By default physical consistency of all links.
    witness : ndarray, shape (parameters,), optional
        Parameters that may be the answer, such as an estimate's own; tried first.
    """
    layout = model.layout
    inertial_units = link_scales(model.robot).units
    unit = np.concatenate([inertial_units, np.ones(len(layout) - layout.inertial_size)])
    base_values = frozen(base_values, (len(base),), "base values")
    if base.layout != layout or base.fingerprint not in ("", model.fingerprint):
        raise ProblemError("the base parameters are of another torque model")
    same_torque = ConicSet.equal(base.projection, base_values, base.groupings)
    domain = (same_torque & lowered(constraints, model)).normalised(unit)
    if witness is not None:
        known = _witnessed(domain, frozen(witness, (len(layout),), "witness") / unit)
        if known is not None:
            return BaseFeasibility("consistent", known, known.u * unit, ())
    try:
        proof = find_interior(domain)
    except SolverError:
        nothing = Interior(-np.inf, np.inf, np.zeros(len(layout)), (), ())
        return BaseFeasibility("undecided", nothing, np.zeros(len(layout)), ())
    violations, search = [], None
    if proof.bound < -_UNDECIDED:
        answer = "impossible"
        violations = _violations(domain, unit, layout.links)
        possible = lowered(constraints, model).normalised(unit)
        search = partial(_nearest, model, base, base_values, possible, unit)
    else:
        # A witness must be consistent and have these very base parameters.
        missed = _relative_miss(domain, proof.u)
        is_one = proof.margin >= -_UNDECIDED and missed <= _UNDECIDED
        answer = "consistent" if is_one else "undecided"
    return BaseFeasibility(answer, proof, proof.u * unit, tuple(violations), search)


@single_threaded
def _nearest(
    model: TorqueModel,
    base: BaseParameters,
    base_values: Vector,
    possible: ConicSet,
    unit: Vector,
) -> NearestRobot | None:
    """Return the possible robot whose torque along random motions differs least."""
    rows = random_rows(model).stacked()[:, list(base.independent)]
    R = np.linalg.qr(rows, mode="r")
    size = float(np.linalg.norm(R @ base_values))
    if size == 0.0:
        return None
    problem = LeastNorm(
        R @ (base.projection * unit) / size, R @ base_values / size, possible
    )
    centre = nominal_point(model, unit)
    try:
        # Half a thousandth of the torque, squared, is what a gap is measured against.
        solution, optimality = solve_certified(problem, centre, reference=_SMALL)
    except SolverError:
        return None
    change = float(np.linalg.norm(problem.G @ solution.u - problem.g))
    return NearestRobot(solution.u * unit, change, optimality.verdict)


def _witnessed(domain: ConicSet, u: Vector) -> Interior | None:
    """Return a point as the answer if it satisfies everything, up to rounding."""
    if _relative_miss(domain, u) > _UNDECIDED or domain.violation(u) > _UNDECIDED:
        return None
    margin = float(domain.block_rows.margins(u).min(initial=1.0))
    return Interior(margin, np.inf, u, (), ())


def _relative_miss(domain: ConicSet, u: Vector) -> float:
    """Largest residual of the equalities, relative to their values."""
    residual = abs(domain.A_eq @ u - domain.b_eq)
    return float(residual.max(initial=0.0) / (1.0 + abs(domain.b_eq).max(initial=0.0)))


def _violations(
    domain: ConicSet, unit: Vector, links: tuple[str, ...]
) -> list[LinkViolation]:
    """Repeat the test for each link alone."""
    found = []
    for block in domain.blocks:
        if block.label not in links:
            continue
        try:
            alone = find_interior(_only(domain, block))
        except SolverError:
            continue  # no proof for this link alone
        if alone.bound >= -_UNDECIDED:
            continue
        k = links.index(block.label)
        body = (_smallest(domain, block, alone) * unit)[10 * k : 10 * k + 10]
        words = f"{block.label}: {in_words(body)}"
        found.append(LinkViolation(block.label, alone.margin, words))
    return found


def _smallest(domain: ConicSet, block: SemidefiniteBlock, alone: Interior) -> Vector:
    """Return the smallest of the least violating parameters, for the message."""
    size = len(alone.u)
    margin = alone.margin - _BACK_OFF * abs(alone.margin)
    lowered_block = replace(block, constant=block.constant - margin * np.eye(4))
    problem = LeastNorm(np.eye(size), np.zeros(size), _only(domain, lowered_block))
    try:
        return solve_least_norm(problem, tolerance=1e-8).u
    except SolverError:
        return alone.u


def _only(domain: ConicSet, block: SemidefiniteBlock) -> ConicSet:
    return ConicSet(
        domain.A_eq,
        domain.b_eq,
        domain.eq_labels,
        domain.A_in,
        domain.b_in,
        domain.in_labels,
        (block,),
    )


def in_words(vector: Array) -> str:
    """Return in words why ten inertial parameters are inconsistent, and by how much."""
    body = InertialParameters(vector)
    if body.mass <= 0.0:
        return f"mass {body.mass:.4g} kg is not positive"
    central = body.central_inertia
    values, axes = np.linalg.eigh(central)
    if values[0] < 0.0:
        return f"the least moment of inertia, {values[0]:.4g} kg m^2, is negative"
    excess = values[2] - values[0] - values[1]
    if excess > 0.0:
        axis = np.array2string(axes[:, 2], precision=2, suppress_small=True)
        return (
            f"the moment of inertia {values[2]:.4g} kg m^2 about {axis} exceeds the "
            f"sum of the other two, {values[0] + values[1]:.4g}, by {excess:.4g}"
        )
    return "these parameters are physically consistent"
