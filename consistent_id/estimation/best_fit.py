"""The least misfit that constraints allow, certified.

Everything is dimensionless (`ScaledFit`): parameters, misfit and constraints are near
one.

A physically consistent link has a mass of at least ``h^T S^-1 h``, with ``h`` its first
moment and ``S`` its second moment.  Noise of joints that move little may prefer a first
moment with hardly any inertia. Then the misfit decreases without end as the mass grows,
and no robot attains its infimum. With a bound on the total mass the least misfit is
attained and can be proven (`attained_fit`). The bound is raised as long as this reduces
the misfit significantly.

With poor data, the best fit is mostly on the boundary of the cone: links without
thickness, which no robot has.  Therefore each link must contain a share of its nominal
body, as large as the data allow: the parameters that they determine may move by a small
part of a standard error at most (`inner_fit`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.tables import brief
from consistent_id.constraints import (
    Constraint,
    PhysicalConsistency,
    TotalMass,
    lowered,
)
from consistent_id.constraints.cones.certificate import (
    FEASIBILITY_TOLERANCE,
    GAP_TOLERANCE,
    Optimality,
    solve_certified,
)
from consistent_id.constraints.cones.interior import irreducible_conflict
from consistent_id.constraints.cones.least_norm import ConeSolution, LeastNorm
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.constraints.priors import nominal_point
from consistent_id.errors import InfeasibleError, SolverError
from consistent_id.regression.base import BaseParameters, require_match
from consistent_id.regression.regression import Regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import UnconstrainedFit, unconstrained_fit
from consistent_id.robot.scaling import link_scales

_USABLE = 1e-5  # violation beyond which a point is not a usable answer

EXACT_FIT = 1e-6
"""Misfit, relative to the torque, that counts as zero."""

_STILL = 1e-3
"""Share of the largest column of the same drive term, below which a column is only the
encoder's noise: its joint stands still.  Noise must not define the typical size of a
parameter; otherwise the prior would not restrict the friction of a joint at rest.
"""

# Misfits are measured in units of the residual, or of a millionth of the torque, if
# that is larger: the least half squared misfit is then about one half.
REFERENCE = 0.5

BOUNDS = (10.0, 100.0, 1000.0)
"""Bounds tried, in units of the links' typical masses together: a model's masses are
seldom wrong by a factor of ten, but placeholders may be."""

_RAISED = 10.0  # times the bound: the gain from more mass is computed up to this mass
_SIGNIFICANT = 3.84  # chi^2 of one parameter that chance exceeds once in twenty times
_REACHED = 0.99  # share of the bound with which it counts as reached

MOVE = 0.25
"""Standard errors by which the share may move all determined parameters, together."""

_AIM = 0.9  # part of `MOVE` that a smaller share aims at
_LESS = 0.1  # factor on a share that other constraints do not allow
_TRIES = 3
_LEAST = 1e-5  # share below which a link still counts as on the boundary


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ScaledFit:
    """``minimise ||M u - z||`` over a set, ``u = x / unit``.

    Parameters
    ----------
    M, z : ndarray
        The base regressor's factor, divided by `size`.
    residual : float
        The residual that no parameters explain, divided by `size`.
    constraints : ConicSet
        In original units.
    domain : ConicSet
        The same, normalised.
    centre : ndarray, shape (parameters,)
        The nominal robot.
    unit : ndarray, shape (parameters,)
    projection : ndarray, shape (base, parameters)
        Base parameters of ``u``.
    size : float, [N m], or dimensionless if weighted
        Residual norm of least squares, or a millionth of the torque's.
    """

    M: Matrix
    z: Vector
    residual: float
    constraints: ConicSet
    domain: ConicSet
    centre: Vector
    unit: Vector
    projection: Matrix
    size: float

    @property
    def problem(self) -> LeastNorm:
        """The least-norm problem."""
        return LeastNorm(self.M, self.z, self.domain)

    def excess(self, u: Vector) -> float:
        """Return the squared misfit beyond `residual` squared."""
        return float(np.sum((self.M @ u - self.z) ** 2))

    def with_factor(self, factor: Matrix) -> "ScaledFit":
        """Return the fit to other data, in the same units.

        Parameters
        ----------
        factor : ndarray, shape (rows, base + 1)
            Triangular factor of base columns and torque; see `base_factor`.
        """
        b = len(self.projection)
        scaled = factor / self.size
        rows = np.vstack([scaled, np.zeros((max(b + 1 - len(scaled), 0), b + 1))])
        return replace(
            self,
            M=rows[:b, :b] @ self.projection,
            z=rows[:b, b],
            residual=float(abs(rows[b, b])),
        )


def base_factor(regression: Regression, base: BaseParameters) -> Matrix:
    """Return the triangular factor of base columns and torque, weights applied."""
    return _base_factor(regression.stacked(), base)


def _base_factor(R: Matrix, base: BaseParameters) -> Matrix:
    return triangle(np.asfortranarray(R[:, [*base.independent, -1]]))


def scaled_fit(
    model: TorqueModel,
    regression: Regression,
    base: BaseParameters,
    constraints: Sequence[Constraint],
) -> ScaledFit:
    """Make a fit dimensionless; model, regression and base match (`require_match`)."""
    R = regression.stacked()
    inertial = link_scales(model.robot).units
    torque = float(np.linalg.norm(R[:, -1]))
    norms = _drive_columns(model, R)
    drive = torque / np.where(norms > 0.0, norms, np.inf)
    unit = np.concatenate([inertial, np.where(drive > 0.0, drive, 1.0)])
    factor = _base_factor(R, base)
    residual = float(abs(factor[-1, -1])) if len(factor) > len(base) else 0.0
    possible = lowered(constraints, model)
    blank = ScaledFit(
        M=np.zeros((0, len(unit))),
        z=np.zeros(0),
        residual=0.0,
        constraints=possible,
        domain=possible.normalised(unit),
        centre=nominal_point(model, unit),
        unit=unit,
        projection=base.projection * unit,
        size=max(residual, EXACT_FIT * torque, 1e-300),
    )
    return blank.with_factor(factor)


def _drive_columns(model: TorqueModel, R: Matrix) -> Vector:
    """Return norms of the drive terms' columns, raised for joints at rest."""
    norms = np.linalg.norm(R[:, model.layout.inertial_size : -1], axis=0)
    terms = np.array([term for _, term in model.layout.drive])
    for term in set(terms.tolist()):
        same = terms == term
        norms[same] = np.maximum(norms[same], _STILL * norms[same].max())
    return np.asarray(norms)


@dataclass(frozen=True, slots=True, eq=False)
class BestFit:
    """The best fit under constraints."""

    scaled: ScaledFit
    solution: ConeSolution
    optimality: Optimality

    @property
    def parameters(self) -> Vector:
        """The best fit, in original units; undetermined parameters are arbitrary."""
        return self.solution.u * self.scaled.unit

    @property
    def misfit(self) -> float:
        """Norm of the whole misfit, in the units of the regression's rows."""
        return self.misfit_of(self.solution.u)

    def misfit_of(self, u: Vector) -> float:
        """Norm of the misfit of other parameters, in units of the problem."""
        excess = self.scaled.excess(u)
        return self.scaled.size * float(np.sqrt(excess + self.scaled.residual**2))


@single_threaded
def best_fit(
    model: TorqueModel,
    regression: Regression,
    constraints: Sequence[Constraint],
    *,
    base: BaseParameters,
    gap: float = GAP_TOLERANCE,
) -> BestFit:
    """Return the least weighted misfit over the constraints, certified.

    It is the first stage of `constrained_least_squares`, whose second one moves within
    one standard error to the point nearest to nominal.  With a larger relative `gap` of
    the squared misfit, the fit is certified to that gap.

    Raises
    ------
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    require_match(model, regression, base)
    return _least_misfit(scaled_fit(model, regression, base, constraints), gap)


def _least_misfit(scaled: ScaledFit, gap: float = GAP_TOLERANCE) -> BestFit:
    return BestFit(scaled, *solved(scaled.problem, scaled.centre, gap=gap))


def solved(
    problem: LeastNorm,
    centre: Vector,
    *,
    reach: float = 0.0,
    gap: float = GAP_TOLERANCE,
) -> tuple[ConeSolution, Optimality]:
    """Solve and certify; if this fails, test whether a solution can exist."""
    found = None
    try:
        found = solution, optimality = solve_certified(
            problem, centre, reference=REFERENCE, reach=reach, gap=gap
        )
    except SolverError as failure:
        reason = str(failure)
    else:
        if optimality.violation <= FEASIBILITY_TOLERANCE:
            return solution, optimality
        reason = f"the best point violates constraints by {optimality.violation:.1e}"
    members = irreducible_conflict(problem.domain)
    if members:
        labels = "; ".join(problem.domain.labels[m] for m in members)
        raise InfeasibleError(
            f"no parameters satisfy these together: {labels}. Loosen one of them, or "
            "check the datasheet values and the margin",
            members,
        )
    if found is not None and found[1].violation <= _USABLE:
        return found
    raise SolverError(
        "no usable optimum, though no contradiction in the constraints was proven: "
        f"{reason}"
    )


@dataclass(frozen=True, slots=True, eq=False)
class FitProblem:
    """A robot's data and constraints, with least squares on the same data.

    Parameters
    ----------
    model : TorqueModel
    free : UnconstrainedFit
        Least squares, with the regression and its base parameters.
    constraints : sequence of Constraint
    """

    model: TorqueModel
    free: UnconstrainedFit
    constraints: Sequence[Constraint]

    @staticmethod
    def of(
        model: TorqueModel,
        regression: Regression,
        constraints: Sequence[Constraint],
        base: BaseParameters,
    ) -> "FitProblem":
        """Return the problem of a regression, after a check that all is of one model.

        Raises
        ------
        ProblemError, NotExcitedError
            See `require_match`.
        """
        require_match(model, regression, base)
        return FitProblem(model, unconstrained_fit(regression, base), constraints)

    def scaled(self) -> ScaledFit:
        """Return the fit under the constraints, dimensionless."""
        free = self.free
        return scaled_fit(self.model, free.regression, free.base, self.constraints)


@dataclass(frozen=True, slots=True, eq=False)
class AttainedFit:
    """The best fit, and the bound on total mass under which it was found.

    Parameters
    ----------
    constraints : tuple of Constraint
        Those given, and the bound if there is one.
    note : str
        The mass that the data do not bound, if the bound is reached; else empty.
    """

    best: BestFit
    constraints: tuple[Constraint, ...]
    note: str = ""


def attained_fit(problem: FitProblem) -> AttainedFit:
    """Return the least misfit over the constraints, and over bounded masses.

    A bound is put on the total mass where no constraint bounds all masses.  It is the
    least of `BOUNDS` beyond which ten times the mass would not lower the squared misfit
    significantly.

    Raises
    ------
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    model, given = problem.model, tuple(problem.constraints)
    consistent = any(isinstance(c, PhysicalConsistency) for c in given)
    if not consistent or _bounded(model, given).all():
        return AttainedFit(_least_misfit(problem.scaled()), given)
    noise = problem.free.noise
    allowed = _SIGNIFICANT * float(np.trace(noise.inflation)) / noise.rank
    typical = float(link_scales(model.robot).mass.sum())
    found: AttainedFit | None = None
    for times in BOUNDS:
        total = TotalMass(0.0, times * typical)
        bounded = replace(problem, constraints=(*given, total))
        try:
            best = _least_misfit(bounded.scaled())
        except InfeasibleError:
            continue
        note = _note(model, best, total, times)
        found = AttainedFit(best, (*given, total), note)
        if _gain(best, total) <= allowed:
            return found
    if found is not None:
        return found
    return AttainedFit(_least_misfit(problem.scaled()), given)


def _bounded(model: TorqueModel, constraints: Sequence[Constraint]) -> np.ndarray:
    """Return for each link whether a row bounds its mass from above."""
    rows_only = [c for c in constraints if not isinstance(c, PhysicalConsistency)]
    layout, known = model.layout, lowered(rows_only, model)
    masses = [layout.index(f"{link}.m") for link in layout.links]
    rows = np.vstack([known.A_in, known.A_eq])
    others = np.delete(rows, masses, axis=1)
    sums = (rows >= 0.0).all(axis=1) & ~others.any(axis=1)
    return np.asarray((rows[sums][:, masses] > 0.0).any(axis=0))


def _gain(best: BestFit, total: TotalMass) -> float:
    """Bound the decrease of the squared misfit at `_RAISED` times the total mass.

    The least half square is convex in the bound ``b``; its slope is minus the row's
    multiplier.
    """
    domain = best.scaled.domain
    row = domain.in_labels.index(_label(total))
    price = float(best.solution.multipliers.at_most[row])
    more = (_RAISED - 1.0) * float(domain.b_in[row])
    return 2.0 * price * more * best.scaled.size**2


def _label(total: TotalMass) -> str:
    return f"total mass <= {total.upper_bound:g} kg"


def _note(model: TorqueModel, best: BestFit, total: TotalMass, times: float) -> str:
    links = best.parameters[: model.layout.inertial_size].reshape(-1, 10)
    masses = links[:, 0]
    if masses.sum() < _REACHED * total.upper_bound:
        return ""
    heaviest = int(np.argmax(masses / link_scales(model.robot).mass))
    return (
        f"the data do not bound the mass of {model.layout.links[heaviest]} from "
        "above: the "
        "heavier it is, with its centre of mass nearer the joint, the better it fits. "
        f"The total mass is bounded by {total.upper_bound:.3g} kg, {times:g} times "
        f"the typical mass of the links: state masses, or a total mass"
    )


@dataclass(frozen=True, slots=True, eq=False)
class InnerFit:
    """The best fit with links inside.

    Parameters
    ----------
    share : float
        Least share of its nominal body that every link contains.
    move : float
        Standard errors by which the share moves the determined parameters, together.
    """

    best: BestFit
    share: float = 0.0
    move: float = 0.0

    @property
    def note(self) -> str:
        """The share in words; empty if there is none."""
        if not self.share:
            return ""
        return (
            f"every link contains at least {self.share:.2g} of its nominal body, "
            f"which moves the parameters that the data determine by {self.move:.2g} "
            f"standard errors, together"
        )


def inner_fit(problem: FitProblem, best: BestFit, *, share: float) -> InnerFit:
    """Return the best fit whose links contain a share of their nominal bodies.

    Parameters
    ----------
    problem : FitProblem
        The constraints of `best`; without `PhysicalConsistency` nothing is changed.
    share : float
        The wanted share; it is reduced until it moves the best fit by at most `MOVE`.
    """
    if not any(isinstance(c, PhysicalConsistency) for c in problem.constraints):
        return InnerFit(best)
    base, noise = problem.free.base, problem.free.noise
    A = problem.free.regression.stacked()[:, list(base.independent)]
    score = (A @ noise.steps).T @ A @ best.scaled.projection
    for _ in range(_TRIES):
        if share < _LEAST:
            break
        found = _containing(problem.model, problem.constraints, best, share)
        if found is None:  # another constraint does not allow it
            share *= _LESS
            continue
        move = noise.errors(score @ (found.solution.u - best.solution.u))
        if move <= MOVE:
            return InnerFit(found, share, move)
        # The best fit moves nearly in proportion to the share.
        share *= _AIM * MOVE / move
    return InnerFit(best)


def _containing(
    model: TorqueModel, constraints: Sequence[Constraint], best: BestFit, share: float
) -> BestFit | None:
    """Return the best fit with a share, equally well proven; None if there is none."""
    inner = [
        replace(c, share=max(c.share, share))
        if isinstance(c, PhysicalConsistency)
        else c
        for c in constraints
    ]
    possible = lowered(inner, model)
    scaled = replace(
        best.scaled,
        constraints=possible,
        domain=possible.normalised(best.scaled.unit),
    )
    try:
        solution, optimality = solve_certified(
            scaled.problem, scaled.centre, reference=REFERENCE
        )
    except SolverError:
        return None
    gap = max(GAP_TOLERANCE, best.optimality.gap)
    if optimality.violation > FEASIBILITY_TOLERANCE or optimality.gap > gap:
        return None
    return BestFit(scaled, solution, optimality)
