"""A constrained estimate as a CVXPY problem, to add own terms and constraints.

The unknowns are ``u = x / unit``, pure numbers near one.  Half the squared misfit in
units of least squares' residual norm, plus the prior, is minimised over the package's
constraints; users can add convex terms and constraints, or replace the objective. The
proof of the optimum is recomputed: without own terms, by the certificate of all other
estimates; with own terms, on the cone programme that CVXPY makes of them,
``minimise f(y) = 1/2 y.P y + q.y  subject to  b - A y in K``.

As in `certificate`: with ``g = P y + q`` and multipliers in the dual cone, no feasible
``y'`` of a ball has less than ``f(y) + g.(y' - y)``, and `lower_bound` returns a lower
bound of ``g.y'``.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.tables import brief
from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.certificate import (
    FEASIBILITY_TOLERANCE,
    GAP_TOLERANCE,
    OptimumProof,
    ball_about,
)
from consistent_id.constraints.cones.least_norm import ConeSolution
from consistent_id.constraints.cones.programmes import (
    ConeKind,
    ConeRows,
    Multipliers,
    lower_bound,
    set_multipliers,
)
from consistent_id.constraints.cones.sets import ConicSet, lengths, stacked
from consistent_id.constraints.priors import EntropicDistance, NominalDistance, Prior
from consistent_id.errors import InfeasibleError, ProblemError, SolverError
from consistent_id.estimation.best_fit import REFERENCE, FitProblem, ScaledFit
from consistent_id.estimation.constrained import FoundOptimum, audited
from consistent_id.estimation.constrained_fit import (
    DEFAULT_CONSTRAINTS,
    constrained_fit,
)
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.penalised import Compromise
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.inertia import PSEUDO_INERTIA_BASIS

CLARABEL = {"tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10, "tol_feas": 1e-10}
"""Options of the solver."""

_ALLOWED = f"{GAP_TOLERANCE:.0e} of the optimum, {FEASIBILITY_TOLERANCE:.0e}"


class ConicOptimum(NamedTuple):
    """``minimise 1/2 y.P y + q.y`` over rows, and a point with multipliers."""

    rows: tuple[ConeRows, ...] | None
    slope: Vector
    y: Vector
    duals: list[Vector]

    def gap(self) -> float:
        """Return the largest possible decrease of the objective in the ball."""
        within = ball_about(self.y)
        bound = lower_bound(self.slope, self.rows or (), self.duals, within)
        return max(float(self.slope @ self.y) - bound, 0.0)

    def violation(self) -> float:
        """Return the distance of the point from the cones."""
        return max((block.violation(self.y) for block in self.rows or ()), default=0.0)


def conic_optimum(problem: Any) -> ConicOptimum:
    """Solve by Clarabel, and assign the values of the problem's variables.

    The result has no rows if the problem needs unsupported cones.
    """
    import cvxpy as cp

    try:
        options = dict(CLARABEL)
        data, chain, inverse = problem.get_problem_data(
            cp.CLARABEL, solver_opts=options
        )
        found = chain.solve_via_data(problem, data, solver_opts=options)
        with warnings.catch_warnings():
            # "Solution may be inaccurate": the proof shows it, with figures.
            warnings.simplefilter("ignore", UserWarning)
            problem.unpack_results(found, chain, inverse)
    except (cp.error.SolverError, ValueError) as cause:
        raise SolverError(f"CVXPY found no point: {cause}") from None
    if "infeasible" in problem.status:
        raise InfeasibleError(
            "no parameters satisfy the package's constraints and your own together; "
            "loosen your own; CVXPY does not name them"
        )
    y, z = np.asarray(found.x), np.asarray(found.z)
    if problem.status not in ("optimal", "optimal_inaccurate"):
        raise SolverError(
            f"CVXPY ended {problem.status!r}; is the objective bounded from below?"
        )
    P = data.get("P")
    slope = data["c"] if P is None else data["c"] + P @ y
    rows = _cone_rows(data["A"].toarray(), data["b"], data["dims"])
    ends = np.cumsum([len(block.b) for block in rows or ()])[:-1]
    return ConicOptimum(rows, slope, y, np.split(z, ends))


def _cone_rows(A: Matrix, b: Vector, dims: Any) -> tuple[ConeRows, ...] | None:
    """Return CVXPY's rows, zero cone first; None if other cones are among them."""
    kinds: list[tuple[ConeKind, int, tuple[int, ...]]] = [
        ("zero", dims.zero, ()),
        ("nonnegative", dims.nonneg, ()),
        *(("second order", size, ()) for size in dims.soc),
        ("semidefinite", sum(lengths(dims.psd)), tuple(dims.psd)),
    ]
    ends = np.cumsum([size for _, size, _ in kinds])
    if ends[-1] != len(b):
        return None
    return tuple(
        ConeRows(kind, A[end - size : end], b[end - size : end], orders)
        for (kind, size, orders), end in zip(kinds, ends, strict=True)
    )


@brief
@dataclass(frozen=True, slots=True, eq=False)
class CvxpyProblem:
    """A constrained estimate as a `cvxpy.Problem`; see `to_cvxpy`.

    Attributes
    ----------
    problem : cvxpy.Problem
        ``minimise misfit + prior`` over the package's constraints.
    variable : cvxpy.Variable, shape (parameters,)
        Parameters in typical units.
    parameters : cvxpy.Expression, shape (parameters,)
        The same in SI units, in the layout's order; `of` returns one of them.
    links : mapping of str to cvxpy.Expression, shape (10,)
        The inertial parameters of each link.
    pseudo_inertias : mapping of str to cvxpy.Expression, shape (4, 4)
        ``J`` of each link, [[kg m^2, kg m], [kg m, kg]].
    residuals : mapping of str to cvxpy.Expression, [N m or N]
        For each joint a vector whose norm is that of its torque error over all samples.
    misfit : cvxpy.Expression
        Half the squared norm of all residuals over the joints' `sigma`, in units of
        `unit_misfit`, less the part that no parameters explain.
    prior : cvxpy.Expression
        Half the squared distance to nominal, times `weight`.
    weight : float
    """

    source: FitProblem
    scaled: ScaledFit
    distance: NominalDistance
    weight: float
    note: str
    problem: Any
    variable: Any
    parameters: Any
    links: Mapping[str, Any]
    pseudo_inertias: Mapping[str, Any]
    residuals: Mapping[str, Any]
    misfit: Any
    prior: Any

    @property
    def unit_misfit(self) -> float:
        """Norm of the residual that counts as one in `misfit`.

        It is the residual norm of least squares, or a millionth of the torque's.
        """
        return self.scaled.size

    def of(self, name: str) -> Any:
        """Return the expression of one parameter, such as ``"joint1.viscous"``."""
        return self.parameters[self.source.model.layout.index(name)]

    def solve(
        self,
        *,
        terms: Sequence[Any] = (),
        constraints: Sequence[Any] = (),
        objective: Any = None,
        method: str = "cvxpy",
    ) -> Estimate:
        """Solve, with own terms and constraints if there are any, and certify.

        Parameters
        ----------
        terms : sequence of cvxpy.Expression
            Convex scalars that are added to the objective.
        constraints : sequence of cvxpy.Constraint
            Convex, in addition to the package's own.
        objective : cvxpy.Expression, optional
            To be minimised instead of ``misfit + prior``.
        method : str
            Name of the estimate's method.

        Returns
        -------
        Estimate
            Its certificate states what was proven: without own terms, the same as for
            every constrained estimate; with own terms, the gap of the cone programme
            that CVXPY makes of them.  Problems with exponential and power cones, such
            as those of ``log`` and ``entr``, are solved but not proven.

        Raises
        ------
        ProblemError
            If the problem is not convex by CVXPY's rules.
        InfeasibleError
            If no parameters satisfy all constraints.
        SolverError
            If no point is found.
        """
        return _solved(self, tuple(terms), tuple(constraints), objective, method)


@single_threaded
def to_cvxpy(
    model: TorqueModel,
    regression: Regression,
    *,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    prior: Prior | None = None,
    base: BaseParameters | None = None,
) -> CvxpyProblem:
    """Return the problem of `constrained_least_squares`, ready for own terms.

    With `PointToSet`, which is the default, the weight of the prior is the one that
    uses up the slack: the problem's optimum is the constrained estimate.

    Parameters
    ----------
    model, regression, constraints, prior, base
        See `constrained_least_squares`.

    Raises
    ------
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(0, 0), ci.DHRow(-np.pi / 2, 0.5)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> q, dq, ddq = np.random.default_rng(0).uniform(-2, 2, (3, 200, 2))
    >>> motion = ci.Recording(arm.joint_names, np.arange(200) / 100, q, dq, ddq)
    >>> body = ci.InertialParameters.from_central(2.0, [0.2, 0, 0], 0.02 * np.eye(3))
    >>> truth = [*body.vector, *body.vector, 0.3, 0.1]
    >>> log = ci.simulate_torque(model, truth, motion)
    >>> regression = ci.build_regression(model, log)
    >>> known = [ci.PhysicalConsistency()]
    >>> form = ci.estimation.to_cvxpy(model, regression, constraints=known)
    >>> slow = form.solve(constraints=[form.of("joint2.viscous") <= 0.05])
    >>> print(f"{slow['joint2.viscous']:.4f}", slow.certificate.verdict)
    0.0500 certified
    """
    import cvxpy as cp

    base = base_parameters(model) if base is None else base
    source = FitProblem.of(model, regression, tuple(constraints), base)
    fitted = constrained_fit(source, prior)
    scaled, distance, layout = fitted.best.scaled, fitted.distance, model.layout
    u = cp.Variable(len(layout), name="parameters in typical units")
    x = cp.multiply(scaled.unit, u)
    links = {name: x[layout.link_slice(k)] for k, name in enumerate(layout.links)}
    misfit = cp.sum_squares(scaled.M @ u - scaled.z) / 2
    prior_term = fitted.final.weight * _half_squared_distance(u, distance)
    return CvxpyProblem(
        source=source,
        scaled=scaled,
        distance=distance,
        weight=fitted.final.weight,
        note=fitted.note,
        problem=cp.Problem(
            cp.Minimize(misfit + prior_term), _cvxpy_constraints(u, scaled.domain)
        ),
        variable=u,
        parameters=x,
        links=MappingProxyType(links),
        pseudo_inertias=MappingProxyType(
            {name: _matrix(PSEUDO_INERTIA_BASIS, link) for name, link in links.items()}
        ),
        residuals=MappingProxyType(
            {
                joint: factor[:, :-1] @ x - factor[:, -1]
                for joint, factor in zip(
                    regression.joints, regression.factors, strict=True
                )
            }
        ),
        misfit=misfit,
        prior=prior_term,
    )


def _half_squared_distance(u: Any, distance: NominalDistance) -> Any:
    import cvxpy as cp

    if not isinstance(distance, EntropicDistance):
        return cp.sum_squares(distance.G @ u - distance.g) / 2
    total = cp.sum_squares(u[10 * len(distance.whitened) :]) / 2
    for k, basis in enumerate(distance.whitened):
        S = _matrix(basis, u[10 * k : 10 * k + 10])
        total = total + cp.trace(S) - cp.log_det(S) - len(basis[0])
    return total


def _matrix(basis: Array, weights: Any) -> Any:
    """Return ``sum_i weights_i basis_i`` as an expression."""
    import cvxpy as cp

    k = basis.shape[-1]
    return cp.reshape(basis.reshape(-1, k * k).T @ weights, (k, k), order="C")


def _cvxpy_constraints(u: Any, domain: ConicSet) -> list[Any]:
    """Return equalities and inequalities, if there are any, then the blocks."""
    rows = []
    if len(domain.b_eq):
        rows.append(domain.A_eq @ u == domain.b_eq)
    if len(domain.b_in):
        rows.append(domain.A_in @ u <= domain.b_in)
    return rows + [_matrix(b.coefficients, u) + b.constant >> 0 for b in domain.blocks]


def _multipliers(domain: ConicSet, constraints: Sequence[Any]) -> Multipliers:
    """Return the dual values of `_cvxpy_constraints`, made feasible."""
    duals = [np.atleast_1d(np.asarray(c.dual_value)) for c in constraints]
    equal = duals.pop(0) if len(domain.b_eq) else np.zeros(0)
    at_most = duals.pop(0) if len(domain.b_in) else np.zeros(0)
    z = stacked([(Z + Z.T) / 2 for Z in duals])
    return set_multipliers(domain, (equal, at_most, z))


@single_threaded
def _solved(
    form: CvxpyProblem,
    terms: tuple[Any, ...],
    constraints: tuple[Any, ...],
    objective: Any,
    method: str,
) -> Estimate:
    import cvxpy as cp

    started = perf_counter()
    own = bool(terms or constraints) or objective is not None
    problem = form.problem
    if own:
        whole = problem.objective.expr if objective is None else objective
        problem = cp.Problem(
            cp.Minimize(sum(terms, start=whole)), [*problem.constraints, *constraints]
        )
    if not problem.is_dcp():
        raise ProblemError(
            "the problem is not convex by CVXPY's rules; terms must be convex scalars, "
            f"constraints convex: {problem}"
        )
    programme = conic_optimum(problem)
    u = form.scaled.domain.snapped(np.asarray(form.variable.value))
    if own:
        before, form.variable.value = float(problem.value), u
        moved = abs(float(problem.objective.value) - before)
        proof = _own_proof(form, problem, programme, moved, constraints)
        note = f"own terms: {len(terms)}, own constraints: {len(constraints)}" + (
            "" if objective is None else ", and an own objective"
        )
    else:
        proof, note = _proof(form, u), f"{form.note}; solved by CVXPY"
    found = FoundOptimum(form.scaled, u * form.scaled.unit, proof, note)
    return audited(form.source, found, method=method, started=started)


def _proof(form: CvxpyProblem, u: Vector) -> OptimumProof:
    """Return the proof for the problem without own terms."""
    domain = form.scaled.domain
    multipliers = _multipliers(domain, form.problem.constraints)
    solution = ConeSolution(u, multipliers, str(form.problem.status), 0.0, 0.0)
    compromise = Compromise(form.scaled, form.distance, form.weight)
    found = compromise.certified(solution)
    statement = (
        f"final estimate, by CVXPY, proven to a relative {found.gap:.1e}, constraints "
        f"violated by at most {found.violation:.1e}"
    )
    figures = {"relative gap": found.gap, "violation": found.violation}
    return OptimumProof(found.verdict == "certified", statement, _ALLOWED, figures)


def _own_proof(
    form: CvxpyProblem,
    problem: Any,
    programme: ConicOptimum,
    moved: float,
    constraints: Sequence[Any],
) -> OptimumProof:
    """Return the proof for the problem with own terms and constraints.

    The point is the variable's value, whose objective has `moved` from the solver's.
    """
    violation = form.scaled.domain.violation(np.asarray(form.variable.value))
    theirs = [float(np.max(c.violation(), initial=0.0)) for c in constraints]
    figures = {
        "violation": violation,
        "violation of own constraints, in their units": max(theirs, default=0.0),
    }
    held = (
        f"the package's constraints violated by at most {violation:.1e}, own ones by "
        f"{max(theirs, default=0.0):.1e}"
    )
    if programme.rows is None:
        statement = f"no proof is made for the cones of the own terms; {held}"
        return OptimumProof(False, statement, "no such cones", figures)
    size = max(abs(float(problem.value)), REFERENCE)
    relative, missed = (programme.gap() + moved) / size, programme.violation()
    figures = {"relative gap": relative, "violation by CVXPY's rows": missed, **figures}
    certified = relative <= GAP_TOLERANCE and max(violation, missed) <= (
        FEASIBILITY_TOLERANCE
    )
    statement = (
        f"with own terms and constraints, the optimum of the cone programme that CVXPY "
        f"made proven to a relative {relative:.1e}; {held}"
    )
    return OptimumProof(certified, statement, _ALLOWED, figures)
