"""The constrained estimate: the best fit, and its audit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

from consistent_id._support.arrays import Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.given_values import require_type
from consistent_id.constraints import Constraint, PhysicalConsistency
from consistent_id.constraints.cones.certificate import Certificate, OptimumProof
from consistent_id.constraints.delivered_bodies import LinkCondition, link_conditions
from consistent_id.constraints.priors import Penalty, Prior
from consistent_id.estimation.best_fit import FitProblem, ScaledFit
from consistent_id.estimation.constrained_fit import (
    DEFAULT_CONSTRAINTS,
    constrained_fit,
)
from consistent_id.estimation.determination import determined
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.fit import fit_of
from consistent_id.estimation.method import FittedUnder, Method
from consistent_id.estimation.uncertainties.parameter_scatter import active_ratios
from consistent_id.regression.base import (
    BaseParameters,
    base_parameters,
    open_combinations,
)
from consistent_id.regression.mass_matrix import (
    POSES,
    least_mass_eigenvalue,
    random_poses,
)
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import residual_sigma

_SEED = 0  # seed of the poses at which mass matrices are examined


@dataclass(frozen=True, slots=True, eq=False)
class FoundOptimum:
    """Parameters that a programme found, and the proof about them.

    Parameters
    ----------
    scaled : ScaledFit
        The programme's data.
    parameters : ndarray, shape (parameters,)
        In original units.
    proof : OptimumProof
    note : str
        How they were found.
    shift : ndarray, shape (parameters,), optional
        How far the prior moved the parameters from the best fit: their bias.  Without
        it, no standard errors are computed.
    along : ndarray, shape (parameters,), optional
        Standard errors along active inequalities over those without; see
        `active_ratios`.
    penalised : bool
        Whether a penalty moved them.
    """

    scaled: ScaledFit
    parameters: Vector
    proof: OptimumProof
    note: str
    shift: Vector | None = None
    along: Vector | None = None
    penalised: bool = False


@single_threaded
def constrained_least_squares(
    model: TorqueModel,
    regression: Regression,
    *,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    prior: Prior | None = None,
    base: BaseParameters | None = None,
    method: str = Method.CONSTRAINED,
) -> Estimate:
    """Estimate all parameters under physical constraints.

    Parameters
    ----------
    model : TorqueModel
    regression : Regression
        Its `sigma` are the weights; see `joint_noise`.
    constraints : sequence of Constraint
        By default every link physically consistent, datasheet masses, and no negative
        friction or rotor inertia.
    prior : PointToSet or Penalty, optional
        Chooses among estimates that fit equally well; by default `PointToSet`.
    base : BaseParameters, optional
    method : str

    Returns
    -------
    Estimate
        Certified when feasibility, both optima and the slack have been verified from
        the problem's own data.

    Raises
    ------
    InfeasibleError
        If no parameters satisfy the constraints; the message names the contradiction.
    NotExcitedError
        If the data excite nothing, or the torque is zero.
    SolverError
        If no solver returns a usable point.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, 1))
    >>> motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    >>> body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    >>> log = ci.simulate_torque(model, [*body, 0.4], motion)
    >>> regression = ci.build_regression(model, log)
    >>> known = [ci.PhysicalConsistency(), ci.FixedMasses({"link1": 2.0})]
    >>> found = ci.constrained_least_squares(model, regression, constraints=known)
    >>> round(found["joint1.viscous"], 4), found.certificate.verdict
    (0.4, 'certified')
    """
    started = perf_counter()
    require_type(model, TorqueModel, "model")
    require_type(regression, Regression, "regression")
    base = base_parameters(model) if base is None else base
    problem = FitProblem.of(model, regression, constraints, base)
    estimate = constrained_estimate(problem, prior, method=method)
    return replace(estimate, seconds=perf_counter() - started)


@single_threaded
def constrained_estimate(
    problem: FitProblem, prior: Prior | None, *, method: str
) -> Estimate:
    """Return the estimate of `constrained_least_squares` of a problem made before."""
    started = perf_counter()
    fitted = constrained_fit(problem, prior)
    found = FoundOptimum(
        fitted.best.scaled,
        fitted.parameters,
        fitted.proof,
        fitted.note,
        abs(fitted.parameters - fitted.best.parameters),
        active_ratios(fitted, problem.free.noise),
        isinstance(prior, Penalty),
    )
    estimate = audited(problem, found, method=method, started=started)
    sigma = problem.free.regression.sigma
    under = FittedUnder(tuple(problem.constraints), prior, sigma)
    return replace(estimate, fitted_under=under)


def audited(
    problem: FitProblem, found: FoundOptimum, *, method: str, started: float
) -> Estimate:
    """Return the estimate of parameters that were found, with its certificate.

    Besides the proof of the optimum, the audit checks in original units the
    constraints, each link's pseudo-inertia, and the mass matrix over random poses.
    """
    model, free = problem.model, problem.free
    base, x, shift = free.base, found.parameters, found.shift
    known = found.scaled.constraints.A_eq
    # Errors of the nominal bodies do not say how wrong the bodies of a penalty are.
    pulled = shift is not None and not found.penalised
    found_by = determined(model, free, known, x, elsewhere="prior")
    stated = None
    if shift is not None:
        stated = found_by.biased(shift)
        if found.along is not None:
            stated = found_by.partly_along(found.along).biased(shift)
    links = link_conditions(model, x)
    return Estimate(
        method=method,
        model=model,
        base=base,
        parameters=x,
        base_covariance=None,
        origins=found_by.origins,
        undetermined=open_combinations(free.solution, base.names),
        sigma=residual_sigma(free.regression, x, len(base)),
        certificate=_certificate(problem, found, links),
        notes=(found.note, *_edges(links)),
        seconds=perf_counter() - started,
        fit=fit_of(model, free, x, known=known, pulled=pulled),
        parameter_errors=None if stated is None else stated.errors,
        parameter_quantiles=None if stated is None else stated.quantiles,
    )


def _edges(links: Sequence[LinkCondition]) -> tuple[str, ...]:
    """Name the links on the boundary of the consistency cone, and its kind."""
    return tuple(
        f"{link.link} is on the boundary of the consistency cone: {link.edge}"
        for link in links
        if link.edge
    )


def _certificate(
    problem: FitProblem, found: FoundOptimum, links: Sequence[LinkCondition]
) -> Certificate:
    """Return the certificate; bodies need positive eigenvalues of the mass matrix."""
    model, x, proof = problem.model, found.parameters, found.proof
    least = least_mass_eigenvalue(model, x, random_poses(model, POSES, _SEED))
    figures = _figures(problem, found, least, links)
    consistent = any(isinstance(c, PhysicalConsistency) for c in problem.constraints)
    if consistent and least <= 0.0:
        reason = (
            f"{proof.statement}; but the mass matrix has an eigenvalue of {least:.3g}: "
            "constrain rotor inertia with NonNegativeDrive"
        )
        return Certificate("uncertified", reason, figures)
    if proof.certified:
        return Certificate("certified", proof.statement, figures)
    reason = (
        f"{proof.statement} (allowed: {proof.allowed}); its optimality is known only "
        f"to these figures"
    )
    return Certificate("uncertified", reason, figures)


def _figures(
    problem: FitProblem,
    found: FoundOptimum,
    least: float,
    links: Sequence[LinkCondition],
) -> dict[str, float]:
    """Return the certificate's figures; `least` is the mass matrix's eigenvalue."""
    regression, x = problem.free.regression, found.parameters
    rms = zip(regression.joints, regression.residual_rms(x), strict=True)
    return {
        "violation in original units": found.scaled.constraints.violation(x),
        **found.proof.figures,
        f"least eigenvalue of M(q) over {POSES} poses": least,
        **{f"RMS residual of {joint}": float(value) for joint, value in rms},
        **{
            f"least eigenvalue of J of {link.link}, per typical link": (
                link.least_eigenvalue
            )
            for link in links
        },
    }
