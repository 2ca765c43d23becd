"""Whether the data contradict physical consistency, not only the least-squares point.

If the truth is near the boundary of the set of consistent robots, noise moves the
least-squares point outside: this is not a contradiction.  The test is how much worse
the best consistent robot fits: `consistency_test`.  With noise of unit level its
increase of the squared misfit,

``T = min_{u in C} ||M u - z||^2 - min_u ||M u - z||^2``,

has a chi-bar-square distribution where the truth is on the boundary: a mixture of
``chi^2`` of different orders [Shapiro1988]_.  Its weights have no closed form for cones
of matrices, so it is simulated: noise is added to the prediction of the best consistent
robot, and the constrained fit is solved again.  Constraints that this robot satisfies
by less than `NEAR` standard errors are moved until they are active: noise has moved
about half of the truly active ones inside, and a simulation without them has too small
``T`` [Andrews2010]_.  Each joint's noise level is an estimate, often with few degrees
of freedom ``n`` (`ResidualNoise.level_freedom`).  So each draw divides the joint's
variance by ``chi^2_n / n``, and ``T`` is compared with a mixture of ``F`` distributions
instead of ``chi^2``.  Three things save work.  That robot
itself satisfies the constraints, so ``T`` of simulated data is at most the noise's
square: if ``T`` of the data is larger, it is not reached, and no fit is needed.  Others
are fitted roughly, until a robot shows that ``T`` is clearly less than the data's, and
exactly where it is near.  The simulation ends when `REACHED` draws have reached it,
which shows that it is not rare; their share is a valid p-value [Besag1991]_.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.executors import Executor, single_threaded
from consistent_id._support.singular import lstsq, pinv, svd
from consistent_id.constraints import Constraint, PhysicalConsistency
from consistent_id.constraints.cones.least_norm import LeastNorm, solve_least_norm
from consistent_id.constraints.cones.programmes import COARSE
from consistent_id.constraints.cones.repeated import rough_squares
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.errors import ProblemError, SolverError
from consistent_id.estimation.best_fit import BestFit, best_fit
from consistent_id.estimation.uncertainties.block_scatter import shrunk
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.linear import DATA_RANK_TOLERANCE
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import (
    ResidualNoise,
    UnconstrainedFit,
    joint_noise,
    unconstrained_fit,
)

DRAWS = 199
"""Simulated data sets: a p-value of 0.05 is then known to 0.03 (two standard errors).
"""

REACHED = 10
"""Number of draws with at least the data's ``T`` after which the simulation ends: more
than a significant result of `DRAWS` draws has, so a contradiction always uses all
draws.
"""

NEAR = 2.0
"""Standard errors from the boundary within which a constraint counts as active."""

SIGNIFICANT = 0.05
"""p-value below which data are said to contradict the constraints."""

_NONE = 1e-9  # increase that is rounding: all data reach it
_SMALL = 0.01  # increase that need not be told from less
_CLEAR = 0.2  # share by which a rough increase is surely less or more than another
_FIRST = 10  # draws simulated before they are counted
_MOST = 40  # the same of later ones, which are solved together


@dataclass(frozen=True, slots=True)
class ConsistencyTest:
    """The increase of the misfit by the constraints, and its significance.

    Parameters
    ----------
    increase : float
        Increase of the squared misfit over that of least squares, with each joint
        divided by its noise level and for the effective number of samples: an effective
        chi^2.
    p_value : float
        Share of simulated data of the best robot with as large an increase.
    draws : int
        Simulated data sets with a result.
    white : bool
        Whether noise was assumed to be white, because residuals were missing.
    """

    increase: float
    p_value: float
    draws: int
    white: bool

    @property
    def significant(self) -> bool:
        """Whether the data contradict the constraints."""
        return self.p_value < SIGNIFICANT

    @property
    def sentence(self) -> str:
        """The result in words, for an estimate that is impossible."""
        if self.significant:
            return f"and no consistent robot fits as well ({self._figures})"
        return (
            f"the point itself is impossible; a consistent robot fits as well "
            f"({self._figures})"
        )

    @property
    def contradiction(self) -> str:
        """The consequence of a contradiction for consistent estimates, or nothing."""
        if not self.significant:
            return ""
        return (
            f"no consistent robot fits as well as least squares ({self._figures}): "
            f"the model lacks a term, perhaps of friction"
        )

    @property
    def _figures(self) -> str:
        figures = f"chi^2 rises by {self.increase:.3g}, p = {self.p_value:.2g}"
        return f"{figures}, for white noise" if self.white else figures


@single_threaded
def consistency_test(
    model: TorqueModel,
    regression: Regression,
    *,
    constraints: Sequence[Constraint] = (PhysicalConsistency(margin=0.0),),
    base: BaseParameters | None = None,
    draws: int = DRAWS,
    enough: int = REACHED,
    seed: int = 0,
    executor: str | Executor | None = None,
) -> ConsistencyTest:
    """Test whether data contradict constraints, by default physical consistency.

    Each joint is weighted by its own noise, not by the regression's weights.  At most
    `draws` data sets are simulated, fewer if `enough` of them reach the increase.
    `executor` is as for `bootstrap`; the result does not depend on it.

    Raises
    ------
    ProblemError
        If the number of draws is not positive.
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`; also if no simulated data give a fit.
    """
    if draws < 1 or enough < 1:
        raise ProblemError(
            f"draws is {draws} and enough is {enough}, expected 1 or more"
        )
    base = base_parameters(model) if base is None else base
    weighted = regression.weighted(joint_noise(model, regression, base=base))
    noise = unconstrained_fit(weighted, base).noise
    levels = _levels(noise)
    weighted = weighted.weighted(levels.values)
    best = best_fit(model, weighted, constraints, base=base)
    increase = _squared_distance(best, best.scaled.z)
    free = unconstrained_fit(weighted, base)
    rng = np.random.default_rng(seed)
    shaken = _drawn_noise(best, free, levels.freedom, draws, rng)
    scaled = replace(best.scaled, domain=_with_near_active(best))
    reached, answers = _simulated(
        replace(best, scaled=scaled),
        increase,
        shaken,
        enough,
        Executor.chosen(executor),
    )
    early = reached == enough
    return ConsistencyTest(
        increase=increase,
        p_value=reached / answers if early else (1 + reached) / (1 + answers),
        draws=answers,
        white=not noise.measured,
    )


class _Levels(NamedTuple):
    """White noise that does as much as each joint's, and its degrees of freedom."""

    values: Vector
    freedom: Vector


def _levels(noise: ResidualNoise) -> _Levels:
    """Return noise levels, their correlation being shrunk towards that of all joints.

    The spectrum at the few frequencies of the motion is the uncertain part of a level;
    joints have filters, drives and friction of one kind.
    """
    own = noise.level_freedom
    if not noise.measured:
        return _Levels(noise.level, own)
    length = shrunk(noise.length, float(own.mean()))
    freedom = np.minimum(own * length.freedom / own.mean(), own.sum())
    return _Levels(noise.sigma * np.sqrt(length.values), freedom)


def _drawn_noise(
    best: BestFit,
    free: UnconstrainedFit,
    freedom: Vector,
    draws: int,
    rng: np.random.Generator,
) -> Matrix:
    """Return noise of the rows of ``M``, each joint's level being drawn too.

    Shape (draws, rows); only noise in the range of ``M`` moves a fit.
    """
    noise, regression = free.noise, free.regression
    columns, steps = list(free.base.independent), noise.steps
    rows = [
        F[:, columns] @ steps / sigma
        for F, sigma in zip(regression.factors, regression.sigma, strict=True)
    ]
    parts = np.array([Q.T @ Q for Q in rows])  # of the joints; they add up to one
    to_rows = best.scaled.M @ pinv(best.scaled.projection) @ steps
    drawn = rng.normal(size=(draws, noise.rank))
    levels = freedom / rng.chisquare(freedom, size=(draws, len(freedom)))
    roots = np.linalg.cholesky(np.einsum("dj,jkl->dkl", levels, parts))
    return np.asarray(
        np.einsum("dkl,dl->dk", roots, drawn) @ to_rows.T * best.scaled.size
    )


def _with_near_active(best: BestFit) -> ConicSet:
    """Return constraints moved to the best robot where it nearly touches them.

    These are rows, and eigenvalues of blocks; standard errors are those of the
    combinations of parameters that the data determine.
    """
    scaled, u = best.scaled, best.solution.u
    domain = scaled.domain
    _, s, Vt = svd(scaled.M, full_matrices=False)
    seen = s > DATA_RANK_TOLERANCE * s.max(initial=0.0)
    steps = Vt[seen].T / (s[seen] * scaled.size)

    def near(values: Vector, gradients: Matrix) -> Vector:
        errors = np.linalg.norm(gradients @ steps, axis=1)
        return np.where((values > 0.0) & (values < NEAR * errors), values, 0.0)

    blocks = []
    for block in domain.blocks:
        values, V = np.linalg.eigh(block.value(u))
        gradients = np.einsum("ik,pij,jk->kp", V, block.coefficients, V)
        taken = (V * near(values, gradients)) @ V.T
        blocks.append(replace(block, constant=block.constant - taken))
    slack = domain.b_in - domain.A_in @ u
    return replace(
        domain, b_in=domain.b_in - near(slack, domain.A_in), blocks=tuple(blocks)
    )


class _Count(NamedTuple):
    """Number of draws that reached the data's ``T``, and of all draws with a result."""

    reached: int
    answers: int


def _simulated(
    best: BestFit,
    increase: float,
    noise: Matrix,
    enough: int,
    executor: Executor | None,
) -> _Count:
    """Count simulated data sets until enough have reached an increase."""
    each = partial(_reaching, best, increase)
    # Workers share small batches evenly.
    most = _MOST if executor is None else _FIRST
    some, count = _in_batches(noise, most), _Count(0, 0)
    answers = map(each, some) if executor is None else executor.map(each, some)
    for answer in chain.from_iterable(answers):
        if answer is not None:
            count = _Count(count.reached + answer, count.answers + 1)
        if count.reached == enough:
            break
    if not count.answers:
        raise SolverError("none of the simulated data gave a constrained fit")
    return count


def _in_batches(noise: Matrix, most: int) -> Iterator[Matrix]:
    """Yield a few draws, then twice as many each time, at most some."""
    start, size = 0, _FIRST
    while start < len(noise):
        yield noise[start : start + size]
        start, size = start + size, min(2 * size, most)


@single_threaded
def _reaching(best: BestFit, increase: float, noise: Matrix) -> list[bool | None]:
    """Return whether simulated data reach an increase; None where there is no fit.

    `noise` is in the range of ``M``, shape (draws, rows).
    """
    if increase <= _NONE:
        return [True] * len(noise)
    scaled, origin = best.scaled, best.solution.u
    found: list[bool | None] = [False] * len(noise)
    able = np.flatnonzero(np.sum(noise**2, axis=1) >= increase)
    if not len(able):
        return found
    z = scaled.M @ origin + noise[able] / scaled.size
    # Least squares has no misfit: prediction and noise are in the range of M.
    unit = max(increase, _SMALL)
    less = increase - _CLEAR * unit
    squares = scaled.size**2
    rough = squares * rough_squares(
        scaled.M,
        z,
        scaled.domain,
        origin,
        unit=unit / squares,
        enough=less / squares,
    )
    for draw, squared, data in zip(able, rough, z, strict=True):
        if squared - increase >= _CLEAR * max(unit, squared):
            found[draw] = True
        elif squared > less or not np.isfinite(squared):
            try:
                found[draw] = _squared_distance(best, data) >= increase
            except SolverError:
                found[draw] = None
    return found


def _squared_distance(best: BestFit, z: Vector) -> float:
    """Return ``T`` of data, in the units of the rows."""
    scaled = best.scaled
    problem = LeastNorm(scaled.M, z, scaled.domain)
    u = solve_least_norm(problem, tolerance=COARSE, origin=best.solution.u).u
    free = lstsq(scaled.M, z)
    misfit, least = (float(np.sum((scaled.M @ v - z) ** 2)) for v in (u, free))
    return max(misfit - least, 0.0) * scaled.size**2
