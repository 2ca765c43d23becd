"""Settings that were tried, and how well they predict motion that was not learnt from.

The faster part of the training motion is predicted by the fit to the slower one, and
the slower part by the fit to the faster one; both count alike.  So do all joints: the
error of each is divided by its error with the settings that `Candidates.weigh` got.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.executors import companion
from consistent_id.errors import ConsistentIdError, RecordingError
from consistent_id.problems.problem import Problem
from consistent_id.rollout.motion_parts import slow_and_fast
from consistent_id.rollout.part_errors import (
    diverged,
    joint_weights,
    squares_of_part,
)
from consistent_id.rollout.settings import Settings, with_settings

_Handed = Callable[[Settings], Callable[[], Matrix]]


class Candidates:
    """Settings that were tried, on parts of the training motion.

    Attributes
    ----------
    parts : tuple of Spans
        The slower and the faster part.
    tried : dict of Settings to float, [rad or m]
        Their errors, the root mean square of all joints.
    skipped : dict of str to None
        Reasons why settings could not be built.
    built : bool
        Whether any were, though their rollouts may diverge.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.parts = slow_and_fast(problem)
        self.tried: dict[Settings, float] = {}
        self.skipped: dict[str, None] = {}
        self.built = False
        self._squares: dict[Settings, Matrix] = {}
        self._weights: Vector | None = None
        self._beside: _Handed | None = None

    @contextmanager
    def in_two_processes(self) -> Iterator[None]:
        """Let another process predict the slower part meanwhile, if it can."""
        with companion(self._slow_part) as self._beside:
            try:
                yield
            finally:
                self._beside = None

    def weigh(self, settings: Settings) -> None:
        """Let all joints count alike, over their levels with these settings."""
        self._weights = joint_weights(self.by_joint(settings))

    def squares(self, settings: Settings) -> Vector:
        """Return the sums of squared errors of blocks; infinite if it cannot be built.

        Both parts count alike.
        """
        return self.weighted(self.by_joint(settings))

    def weighted(self, squares: Matrix) -> Vector:
        """Return the sums over joints of squares, shape (blocks, joints)."""
        weights = self._weights
        return np.asarray(squares.sum(1) if weights is None else squares @ weights)

    def by_joint(self, settings: Settings) -> Matrix:
        """Return the squared errors of the blocks of both parts, by joint.

        They are infinite if it cannot be built, or a motion diverges.
        """
        if settings not in self._squares:
            slow, fast = self.parts
            lost = np.vstack([diverged(self.problem)] * 2)
            try:
                of_slow = None if self._beside is None else self._beside(settings)
                made = with_settings(self.problem, settings)
                of_fast = squares_of_part(made, slow, fast)
                if of_slow is None:
                    of_slow = partial(squares_of_part, made, fast, slow)
                found = np.concatenate([of_fast, of_slow()])
                self.built = True
            except ConsistentIdError as reason:
                self.skipped[str(reason)] = None
                found = lost
            self._squares[settings] = found if np.isfinite(found).all() else lost
            self.tried[settings] = float(np.sqrt(self._squares[settings].sum()))
        return self._squares[settings]

    def error(self, settings: Settings) -> float:
        """Return the root-mean-square error of rollouts of parts not learnt from.

        All joints count alike, see `weigh`.
        """
        return float(np.sqrt(self.squares(settings).sum()))

    def by_delay(self, settings: Settings) -> Callable[[float], Vector]:
        """Return the squared errors of blocks by the delay [s]."""
        return lambda delay: self.squares(replace(settings, delay=delay))

    def none_found(self) -> RecordingError:
        """Return why no settings have an error."""
        seen = "; ".join(self.skipped)
        if self.built:
            what = (
                "with no settings the rollouts stay near the robot; check gains, "
                "columns and units"
            )
        else:
            what = "no settings can be fitted to a part of the training motion"
        return RecordingError(
            f"problem {self.problem.name!r}: {what}{seen and '. Seen: ' + seen}"
        )

    def _slow_part(self, settings: Settings) -> Matrix:
        slow, fast = self.parts
        return squares_of_part(with_settings(self.problem, settings), fast, slow)
