"""The least misfit that constraints allow, certified.

Everything is dimensionless (`ScaledFit`): parameters, misfit and constraints are near
one.

Physical consistency of a link asks for a mass of ``h^T S^-1 h`` or more, ``h`` its
first moment and ``S`` its second.  Data that want a first moment with next to no
inertia, as noise does of joints that move little, want that mass without end: the least
misfit is approached as the mass grows, but by no robot.  A bound on the total mass lets
it be reached, and proven (`attained_fit`).  The bound is raised as long as the data ask
for more.

Where data are poor, the best fit is mostly on the boundary of the cone: links without
thickness, which no robot has.  Therefore each link is to contain a share of its nominal
body, as large as the data allow: what they determine is to move by a small part of a
standard error at the most (`inner_fit`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.executors import single_threaded
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
from consistent_id.regression.residual_noise import ResidualNoise, residual_noise
from consistent_id.robot.scaling import link_scales

_USABLE = 1e-5  # violation beyond which a point is no answer at all

EXACT_FIT = 1e-6
"""Misfit, relative to the torque, that counts as none."""

_STILL = 1e-3
"""Share of the largest column of the same drive term below which a column is the
encoder's noise: its joint stands still.  Noise does not say what a typical parameter
is, else a prior would let friction of a joint at rest be anything."""

# Misfits are measured in units of the residual, or of a millionth of the torque: half
# a unit squared is theirs.
REFERENCE = 0.5

BOUNDS = (10.0, 100.0, 1000.0)
"""Bounds tried, in units of the links' typical masses together: a model's masses are
seldom wrong by a factor of ten, but placeholders may be."""

_RAISED = 10.0  # times the bound: what more mass would bring is judged up to there
_SIGNIFICANT = 3.84  # chi^2 of one parameter that chance exceeds once in twenty times
_REACHED = 0.99  # share of the bound from which it counts as reached

MOVE = 0.25
"""Standard errors by which the share may move all that the data determine, together."""

_AIM = 0.9  # of `MOVE`, at which a smaller share aims
_LESS = 0.1  # of a share that other constraints do not allow
_TRIES = 3
_LEAST = 1e-5  # share below which a link is on the boundary all the same


@dataclass(frozen=True, slots=True, eq=False)
class ScaledFit:
    """``minimise ||M u - z||`` over a set, ``u = x / unit``.

    Parameters
    ----------
    M, z : ndarray
        Of the base regressor's factor, divided by `size`.
    residual : float
        What no parameters explain, divided by `size`.
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
    R = regression.stacked()
    return triangle(np.asfortranarray(R[:, [*base.independent, -1]]))


def scaled_fit(
    model: TorqueModel,
    regression: Regression,
    base: BaseParameters,
    constraints: Sequence[Constraint],
) -> ScaledFit:
    """Make a fit dimensionless.

    Raises
    ------
    ProblemError, NotExcitedError
        See `require_match`.
    """
    require_match(model, regression, base)
    R = regression.stacked()
    factor = base_factor(regression, base)
    torque = float(np.linalg.norm(R[:, -1]))
    residual = float(abs(factor[-1, -1])) if len(factor) > len(base) else 0.0
    inertial = link_scales(model.robot).units
    norms = _drive_columns(model, R)
    drive = torque / np.where(norms > 0.0, norms, np.inf)
    unit = np.concatenate([inertial, np.where(drive > 0.0, drive, 1.0)])
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
    """Return norms of the drive terms' columns, those of joints at rest raised."""
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
        """The best fitting parameters, in original units; open ones as they fell."""
        return self.solution.u * self.scaled.unit

    @property
    def misfit(self) -> float:
        """Norm of the whole misfit, in the units of the regression's rows."""
        excess = self.scaled.excess(self.solution.u)
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

    With a larger relative `gap` of the squared misfit it is certified to that.

    Raises
    ------
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    scaled = scaled_fit(model, regression, base, constraints)
    return BestFit(scaled, *solved(scaled.problem, scaled.centre, gap=gap))


def solved(
    problem: LeastNorm,
    centre: Vector,
    *,
    reach: float = 0.0,
    gap: float = GAP_TOLERANCE,
) -> tuple[ConeSolution, Optimality]:
    """Solve and certify; when nothing comes of it, ask if a solution can exist."""
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
            "check the datasheet values and the margin"
        )
    if found is not None and found[1].violation <= _USABLE:
        return found
    raise SolverError(
        "no usable optimum, though no contradiction in the constraints was proven: "
        f"{reason}"
    )


@dataclass(frozen=True, slots=True, eq=False)
class AttainedFit:
    """The best fit, and the bound on total mass under which it was found.

    Parameters
    ----------
    constraints : tuple of Constraint
        Those given, and the bound if there is one.
    note : str
        Which mass the data leave open, where the bound is reached; else empty.
    """

    best: BestFit
    constraints: tuple[Constraint, ...]
    note: str = ""


def attained_fit(
    model: TorqueModel,
    regression: Regression,
    constraints: Sequence[Constraint],
    *,
    base: BaseParameters,
) -> AttainedFit:
    """Return the least misfit over the constraints, and over bounded masses.

    A bound is put on the total mass where no constraint bounds all masses.  It is the
    least of `BOUNDS` beyond which ten times the mass would not lower the squared misfit
    significantly.

    Raises
    ------
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    given = tuple(constraints)
    consistent = any(isinstance(c, PhysicalConsistency) for c in given)
    if not consistent or _bounded(model, given).all():
        return AttainedFit(best_fit(model, regression, given, base=base), given)
    noise = residual_noise(regression, base)
    allowed = _SIGNIFICANT * float(np.trace(noise.inflation)) / noise.rank
    typical = float(link_scales(model.robot).mass.sum())
    found: AttainedFit | None = None
    for times in BOUNDS:
        total = TotalMass(0.0, times * typical)
        try:
            best = best_fit(model, regression, (*given, total), base=base)
        except InfeasibleError:
            continue
        note = _note(model, best, total, times)
        found = AttainedFit(best, (*given, total), note)
        if _gain(best, total) <= allowed:
            return found
    if found is not None:
        return found
    return AttainedFit(best_fit(model, regression, given, base=base), given)


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
    """Bound what `_RAISED` times the total mass lowers the squared misfit by.

    The least of half the square is convex in the bound ``b``; its slope is less the
    row's multiplier.
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
        f"the data leave the mass of {model.layout.links[heaviest]} open upwards: the "
        "heavier it is, with its centre of mass nearer the joint, the better it fits. "
        f"Total mass is bounded by {total.upper_bound:.3g} kg, {times:g} times what "
        "the links typically weigh: state masses, or a total mass"
    )


@dataclass(frozen=True, slots=True, eq=False)
class InnerFit:
    """The best fit with links inside.

    Parameters
    ----------
    share : float
        Of its nominal body that every link contains, at the least.
    move : float
        Standard errors by which that moves what the data determine, all together.
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
            f"every link contains {self.share:.2g} of its nominal body or more, which "
            f"moves what the data determine by {self.move:.2g} standard errors, in all"
        )


@dataclass(frozen=True, slots=True, eq=False)
class FitProblem:
    """What a constrained estimate is computed from."""

    model: TorqueModel
    regression: Regression
    constraints: Sequence[Constraint]
    base: BaseParameters


def inner_fit(
    problem: FitProblem, best: BestFit, *, share: float, noise: ResidualNoise
) -> InnerFit:
    """Return the best fit whose links contain a share of their nominal bodies.

    Parameters
    ----------
    problem : FitProblem
        Of `best`; without `PhysicalConsistency` nothing is changed.
    share : float
        Wanted; as much of it is taken as moves the best fit by no more than `MOVE`.
    noise : ResidualNoise
        Of the regression.
    """
    if not any(isinstance(c, PhysicalConsistency) for c in problem.constraints):
        return InnerFit(best)
    A = problem.regression.stacked()[:, list(problem.base.independent)]
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
        # The best fit moves nearly in proportion.
        share *= _AIM * MOVE / move
    return InnerFit(best)


def _containing(
    model: TorqueModel, constraints: Sequence[Constraint], best: BestFit, share: float
) -> BestFit | None:
    """Return the best fit with a share, as well proven; None if there is none."""
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
