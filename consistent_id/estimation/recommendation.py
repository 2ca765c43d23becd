"""The recommended estimate, chosen by its prediction of left-out training data.

Blocks of consecutive segments are left out of the fit one after another and predicted.
Of the methods whose pooled error is within one standard error of the least, the
simplest is recommended: a smaller difference is chance. Held-out recordings are not
used, so the choice does not bias their error.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import ProblemError
from consistent_id.estimation.expected_error import ExpectedError, expected_error
from consistent_id.estimation.left_out import LeftOutErrors
from consistent_id.estimation.verdict import percent


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
                f"error to expect on a motion not seen: {expected}: on blocks left out "
                "it is larger than the torque; record faster motion of all joints"
            )
        return (
            f"error to expect on a motion not seen: {expected} (all joints, blocks "
            "left out)"
        )

    @property
    def others(self) -> str:
        """The errors of the other methods on the same blocks; empty without any."""
        pairs = zip(self.candidates, self.error, strict=True)
        named = [f"{m} {percent(e)}" for m, e in pairs if m != self.method]
        if self.expected is None or not named:
            return ""
        return f"other methods on the blocks left out: {', '.join(named)}"


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
