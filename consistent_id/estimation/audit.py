"""From constrained parameters to an audited estimate."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from time import perf_counter

from consistent_id._support.arrays import Vector
from consistent_id.constraints.links import LinkCondition, link_conditions
from consistent_id.estimation.best_fit import ScaledFit
from consistent_id.estimation.determination import (
    determinations,
    linear_errors,
    stated_errors,
)
from consistent_id.estimation.estimate import Certificate, Estimate
from consistent_id.estimation.fit import fit_of
from consistent_id.regression.base import BaseParameters, open_combinations
from consistent_id.regression.mass_matrix import (
    POSES,
    least_mass_eigenvalue,
    random_poses,
)
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import (
    base_solution,
    residual_noise,
    residual_sigma,
)

_SEED = 0  # seed of the poses at which mass matrices are examined


@dataclass(frozen=True, slots=True)
class OptimumProof:
    """What is proven about an optimum.

    Parameters
    ----------
    statement : str
        What is proven, or how nearly.
    allowed : str
        The allowed gaps, for a reader of a failed proof.
    """

    certified: bool
    statement: str
    allowed: str
    figures: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class FitData:
    """What a constrained estimate is fitted to: model, regression, base parameters."""

    model: TorqueModel
    regression: Regression
    base: BaseParameters


def audited(
    data: FitData,
    scaled: ScaledFit,
    x: Vector,
    proof: OptimumProof,
    *,
    consistent: bool,
    method: str,
    note: str,
    started: float,
    shift: Vector | None = None,
) -> Estimate:
    """Return the estimate of parameters `x`, with its certificate.

    Besides the proof of the optimum, the audit checks in original units the
    constraints, each link's pseudo-inertia, and the mass matrix over random poses.

    Parameters
    ----------
    consistent : bool
        Whether each link has to be physically consistent: the mass matrix has to be
        positive definite then.
    shift : ndarray, shape (parameters,), optional
        How far the prior moved the parameters from the best fit: their bias.  Without
        it, no standard errors are computed.
    """
    model, regression, base = data.model, data.regression, data.base
    links = link_conditions(model, x)
    least = least_mass_eigenvalue(model, x, random_poses(model, POSES, _SEED))
    figures = _figures(regression, scaled, x, proof, least, links)
    solution, known = base_solution(regression, base), scaled.constraints.A_eq
    errors = linear_errors(base, residual_noise(regression, base), known)
    origins = determinations(
        model, regression, base, errors, x, known=known, elsewhere="prior"
    )
    return Estimate(
        method=method,
        model=model,
        base=base,
        parameters=x,
        base_covariance=None,
        origins=origins,
        undetermined=open_combinations(solution, base.names),
        sigma=residual_sigma(regression, x, len(base)),
        certificate=_certificate(proof, least if consistent else None, figures),
        notes=(note, *_edges(links)),
        seconds=perf_counter() - started,
        fit=fit_of(model, regression, x, base, known=known),
        parameter_errors=(
            None if shift is None else stated_errors(errors, origins, shift)
        ),
    )


def _figures(
    regression: Regression,
    scaled: ScaledFit,
    x: Vector,
    proof: OptimumProof,
    least: float,
    links: Sequence[LinkCondition],
) -> dict[str, float]:
    """Return the certificate's figures; `least` is the mass matrix's eigenvalue."""
    rms = zip(regression.joints, regression.residual_rms(x), strict=True)
    return {
        "violation in original units": scaled.constraints.violation(x),
        **proof.figures,
        f"least eigenvalue of M(q) over {POSES} poses": least,
        **{f"RMS residual of {joint}": float(value) for joint, value in rms},
        **{
            f"least eigenvalue of J of {link.link}, per typical link": (
                link.least_eigenvalue
            )
            for link in links
        },
    }


def _edges(links: Sequence[LinkCondition]) -> tuple[str, ...]:
    """Name the links on the boundary of the consistency cone, and its kind."""
    return tuple(
        f"{link.link} is on the boundary of the consistency cone: {link.edge}"
        for link in links
        if link.edge
    )


def _certificate(
    proof: OptimumProof, least: float | None, figures: dict[str, float]
) -> Certificate:
    """Return the certificate; `least`, of the mass matrix, must be positive."""
    if least is not None and least <= 0.0:
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
