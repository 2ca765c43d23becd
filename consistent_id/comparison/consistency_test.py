"""Whether data contradict constraints, or only least squares' point does.

Least squares falls outside the set of consistent robots as soon as the truth is near
its boundary: that is noise, not a contradiction.  What tells is how much worse the best
consistent robot fits.  With noise of unit level its increase of the squared misfit,

``T = min_{u in C} ||M u - z||^2 - min_u ||M u - z||^2``,

has a chi-bar-square distribution where the truth is on the boundary: a mixture of
``chi^2`` of different orders [Shapiro1988]_.  Its weights have no closed form for cones
of matrices, so it is simulated: noise is added to what the best consistent robot
predicts, and the constrained fit is solved anew.  Two things save work.  That robot
itself satisfies the constraints, so ``T`` of simulated data is at most the noise's
square: where ``T`` of the data is larger still, no fit is needed to know that it is not
reached.  And simulation ends when `REACHED` draws have reached it, which shows that it
is not rare; their share is a p-value as exact as that of all draws [Besag1991]_.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.executors import Executor
from consistent_id._support.threads import single_threaded, worker_threads
from consistent_id.constraints import Constraint, PhysicalConsistency
from consistent_id.constraints.cones.least_norm import LeastNorm, solve_least_norm
from consistent_id.constraints.cones.programmes import COARSE
from consistent_id.errors import ProblemError, SolverError
from consistent_id.estimation.best_fit import BestFit, best_fit
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.noise import joint_noise
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import residual_noise

DRAWS = 199
"""Simulated data sets: a p-value of 0.05 is then known to 0.03 (two standard errors).
"""

REACHED = 10
"""Draws with the data's ``T`` or more after which no further ones are simulated: more
than `DRAWS` admits where data contradict, so that all are simulated before that is
said."""

SIGNIFICANT = 0.05
"""p-value below which data are said to contradict the constraints."""

_WORKERS = 2  # Clarabel frees the interpreter's lock
_AT_ONCE = 10  # draws simulated before they are counted


@dataclass(frozen=True, slots=True)
class ConsistencyTest:
    """How much worse the best robot that satisfies constraints fits, and if by chance.

    Parameters
    ----------
    increase : float
        Of the squared misfit over that of least squares, each joint divided by its
        noise level and samples counted by their correlation: an effective chi^2.
    p_value : float
        Share of simulated data, of the best robot itself, that raise it as much.
    draws : int
        Simulated data sets that gave an answer.
    white : bool
        Whether noise was taken to be white, for want of residuals.
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
        """The answer in words, of an estimate that is impossible."""
        if self.significant:
            return f"nor does a consistent robot fit as well ({self._figures})"
        return (
            f"impossible as a point; a consistent robot fits as well ({self._figures})"
        )

    @property
    def contradiction(self) -> str:
        """What a contradiction says of consistent estimates; empty if there is none."""
        if not self.significant:
            return ""
        return (
            f"no consistent robot fits as well as least squares ({self._figures}): the "
            "model lacks something, perhaps of friction"
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

    Each joint is weighted by its own noise, whatever the regression's weights.  At most
    `draws` data sets are simulated, fewer if `enough` of them reach the increase.  The
    executor says where, see `bootstrap`; the result is the same.

    Raises
    ------
    ProblemError
        If no draws are asked for.
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`; also if no simulated data give a fit.
    """
    if draws < 1 or enough < 1:
        raise ProblemError(
            f"draws is {draws} and enough is {enough}, expected 1 or more"
        )
    base = base_parameters(model) if base is None else base
    weighted = regression.weighted(joint_noise(model, regression, base=base))
    noise = residual_noise(weighted, base)
    best = best_fit(model, weighted.weighted(noise.level), constraints, base=base)
    increase = _squared_distance(best, best.scaled.z)
    rng = np.random.default_rng(seed)
    shaken = rng.normal(size=(draws, len(best.scaled.z)))
    reached, answers = _simulated(
        best, increase, shaken, enough, Executor.chosen(executor)
    )
    early = reached == enough
    return ConsistencyTest(
        increase=increase,
        p_value=reached / answers if early else (1 + reached) / (1 + answers),
        draws=answers,
        white=not noise.measured,
    )


class _Count(NamedTuple):
    """How many draws reached the data's ``T``, of how many that gave an answer."""

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
    some = (noise[k : k + _AT_ONCE] for k in range(0, len(noise), _AT_ONCE))
    count = _Count(0, 0)
    with worker_threads(_WORKERS) as pool:
        alone = (list(pool.map(lambda e: each([e])[0], part)) for part in some)
        answers = alone if executor is None else executor.map(each, some)
        for answer in chain.from_iterable(answers):
            if answer is not None:
                count = _Count(count.reached + answer, count.answers + 1)
            if count.reached == enough:
                break
    if not count.answers:
        raise SolverError("none of the simulated data gave a constrained fit")
    return count


@single_threaded
def _reaching(
    best: BestFit, increase: float, noise: Sequence[Vector]
) -> list[bool | None]:
    """Return which simulated data reach an increase; None where there is no fit."""
    predicted, found = best.scaled.M @ best.solution.u, list[bool | None]()
    for e in noise:
        if e @ e < increase:
            found.append(False)
            continue
        try:
            T = _squared_distance(best, predicted + e / best.scaled.size)
        except SolverError:
            found.append(None)
        else:
            found.append(T >= increase)
    return found


def _squared_distance(best: BestFit, z: Vector) -> float:
    """Return ``T`` for other data, in the units of the rows."""
    scaled = best.scaled
    problem = LeastNorm(scaled.M, z, scaled.domain)
    u = solve_least_norm(problem, tolerance=COARSE, origin=best.solution.u).u
    free = np.linalg.lstsq(scaled.M, z, rcond=None)[0]
    misfit, least = (float(np.sum((scaled.M @ v - z) ** 2)) for v in (u, free))
    return max(misfit - least, 0.0) * scaled.size**2
