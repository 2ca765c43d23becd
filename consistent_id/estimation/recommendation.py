"""The recommended estimate and its slack, chosen by errors on training data left out.

Blocks of consecutive segments are left out of the fit one after another and predicted.
Of the methods whose pooled error is within one standard error of the least, the
simplest is recommended: a smaller difference is chance. Held-out recordings are not
used, so the choice does not bias their error.

`PointToSet` takes the estimate nearest to the nominal robot among those whose misfit is
within a slack of the best.  The default slack moves the parameters that the data
determine by one standard error at most.  With poor motion a larger one predicts other
motion better: the best fit follows noise and what the model lacks.  So a series of
slacks is tried on the blocks left out, and the one with the least pooled error is used.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.constraints.priors import PointToSet, Prior
from consistent_id.errors import ProblemError
from consistent_id.estimation.expected_error import ExpectedError, expected_error
from consistent_id.estimation.left_out import (
    LeftOutErrors,
    LeftOutFits,
    left_out_errors,
)
from consistent_id.estimation.verdict import percent

SLACKS = (0.001, 0.003, 0.01, 0.02, 0.05)
"""Slacks tried besides the default: relative increase of the misfit's norm."""


@dataclass(frozen=True, slots=True, eq=False)
class SlackChoice:
    """The priors that were tried, and the one that predicts left-out data best.

    Parameters
    ----------
    tried : tuple of PointToSet or Penalty
        The weakest first.
    left_out : LeftOutErrors
        One fit for each.
    """

    tried: tuple[Prior, ...]
    left_out: LeftOutErrors

    @property
    def best(self) -> int:
        """Index of the least pooled error; the first if no block can be left out."""
        errors = self.left_out.pooled
        return int(np.argmin(errors)) if np.isfinite(errors).any() else 0

    @property
    def prior(self) -> Prior:
        """The prior with the least pooled error."""
        return self.tried[self.best]

    @property
    def chosen(self) -> LeftOutErrors:
        """The errors with this prior."""
        return self.left_out.of(self.best)

    @property
    def slacks(self) -> tuple[str, ...]:
        """The slacks tried, as text; none if the problem states the prior."""
        priors = [p for p in self.tried if isinstance(p, PointToSet)]
        if len(priors) < 2:
            return ()
        return tuple("default" if p.slack is None else f"{p.slack:g}" for p in priors)

    @property
    def statement(self) -> str:
        """The slack chosen and the errors of all, in a sentence; empty if stated."""
        if not self.slacks:
            return ""
        pairs = zip(self.slacks, self.left_out.pooled, strict=True)
        errors = ", ".join(f"{slack} {100 * e:.2f} %" for slack, e in pairs)
        return (
            f"slack {self.slacks[self.best]}, chosen by the least error on blocks of "
            f"the training data left out: {errors}"
        )

    def to_dict(self) -> dict[str, Any] | None:
        """Return plain numbers and text, for JSON; None if the prior is stated."""
        if not self.slacks:
            return None
        errors = [float(e) if np.isfinite(e) else None for e in self.left_out.pooled]
        return {
            "chosen": self.slacks[self.best],
            "left_out_errors": dict(zip(self.slacks, errors, strict=True)),
        }


def chosen_slack(fits: LeftOutFits, prior: Prior) -> SlackChoice:
    """Try slacks on the blocks left out.

    Parameters
    ----------
    fits : LeftOutFits
        With the prior's share inside.
    prior : PointToSet or Penalty
        One with a stated slack or weight is the only one tried.
    """
    tried: tuple[Prior, ...] = (prior,)
    if isinstance(prior, PointToSet) and prior.slack is None:
        tried += tuple(replace(prior, slack=slack) for slack in SLACKS)
    return SlackChoice(tried, left_out_errors(fits, tried))


@dataclass(frozen=True, slots=True, eq=False)
class Recommendation:
    """The recommended method, and the errors of every candidate on data left out.

    Parameters
    ----------
    left_out : mapping of str to LeftOutErrors
        By method, from the simplest to the most complex.
    """

    method: str
    left_out: Mapping[str, LeftOutErrors]

    @property
    def candidates(self) -> tuple[str, ...]:
        """The methods, from the simplest to the most complex."""
        return tuple(self.left_out)

    @property
    def error(self) -> Vector:
        """Pooled error of each candidate on the data left out, shape (candidates,)."""
        return np.concatenate([found.pooled for found in self.left_out.values()])

    @property
    def expected(self) -> ExpectedError | None:
        """Torque error to expect on a motion not seen; None if it is not known."""
        return expected_error(self.left_out[self.method])

    @property
    def statement(self) -> str:
        """The error to expect and its range, in a sentence."""
        expected = self.expected
        if expected is None:
            return f"{self.method}, the simplest; no block of the data can be left out"
        if not expected.predicts:
            return (
                f"error to expect on a motion not seen: {expected}: on parts of the "
                "training data that were left out of the fit, it is larger than the "
                "torque; record faster motion of all joints"
            )
        return (
            f"error to expect on a motion not seen: {expected} (all joints; from parts "
            "of the training data that were left out of the fit in turn)"
        )

    @property
    def others(self) -> str:
        """The errors of the other methods on the same blocks; empty without any."""
        pairs = zip(self.candidates, self.error, strict=True)
        named = [f"{m} {percent(e)}" for m, e in pairs if m != self.method]
        if self.expected is None or not named:
            return ""
        return f"other methods on these parts of the data: {', '.join(named)}"


def recommend(left_out: Mapping[str, LeftOutErrors]) -> Recommendation:
    """Recommend one of several methods.

    Parameters
    ----------
    left_out : mapping of str to LeftOutErrors
        By method, from the simplest to the most complex; each of one fit.

    Raises
    ------
    ProblemError
        If there is no method.
    """
    if not left_out:
        raise ProblemError("there is no method to recommend; expected one or more")
    return Recommendation(list(left_out)[_simplest(list(left_out.values()))], left_out)


def _simplest(left_out: list[LeftOutErrors]) -> int:
    """Return the first whose mean square is within one standard error of the least.

    The standard error is that of the least one, over segments.
    """
    squared = np.array([found.pooled[0] ** 2 for found in left_out])
    best = int(np.argmin(squared))
    if not np.isfinite(squared[best]):
        return 0
    (errors,) = left_out[best].errors
    spread = float(np.std(errors**2, ddof=1)) / np.sqrt(len(errors))
    return int(np.argmax(squared <= squared[best] + spread))
