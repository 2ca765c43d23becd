"""Settings that were tried, and how well they predict motion that was not learnt from.

The faster part of the training motion is predicted by the fit to the slower one, and
the slower part by the fit to the faster one; both count alike.  Where bodies are known,
a delay of commands is judged by the faster part alone: fast motion shows it, and at low
speed errors of the friction model look like one.  Bodies that slow motion determines
are uncertain, and their errors look like a delay, too; so both parts judge it where
bodies are identified.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import ConsistentIdError, RecordingError
from consistent_id.problems.problem import Problem
from consistent_id.rollout.motion_parts import slow_and_fast
from consistent_id.rollout.settings import (
    BLOCKS_OF_DELAY,
    BLOCKS_OF_PART,
    Settings,
    part_squares,
    with_settings,
)

Part = Literal["fast", "slow"]


class Candidates:
    """Settings that were tried, on parts of the training motion.

    Attributes
    ----------
    parts : tuple of Spans
        The slower and the faster part.
    tried : dict of Settings to float, [rad or m]
        Errors of those that were tried on both parts.
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
        self._squares: dict[tuple[Settings, Part], Vector] = {}
        self._made: tuple[Settings, Problem] | None = None

    def squares(self, settings: Settings) -> Vector:
        """Return the squared errors of `BLOCKS_OF_PART` blocks of each part.

        They are infinite if it cannot be built.
        """
        both = self._of(settings, "fast"), self._of(settings, "slow")
        found = np.concatenate(both).reshape(2 * BLOCKS_OF_PART, -1)
        blocks = np.asarray(found.sum(axis=1))
        self.tried[settings] = float(np.sqrt(blocks.sum()))
        return blocks

    def error(self, settings: Settings) -> float:
        """Return the root-mean-square error of rollouts of parts not learnt from."""
        if settings not in self.tried:
            self.squares(settings)
        return self.tried[settings]

    def by_delay(self, settings: Settings) -> Callable[[float], Vector]:
        """Return the squared errors of the blocks that judge it, for delays [s]."""
        if self.both_judge(settings):
            return lambda delay: self.squares(replace(settings, delay=delay))
        return lambda delay: self._of(replace(settings, delay=delay), "fast")

    def both_judge(self, settings: Settings) -> bool:
        """Return whether both parts judge a delay; else it is the faster one."""
        stated = self.problem.table.constraints.bodies
        return "model" not in (settings.bodies, stated)

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

    def _of(self, settings: Settings, part: Part) -> Vector:
        if (settings, part) not in self._squares:
            slow, fast = self.parts
            learnt, other = (slow, fast) if part == "fast" else (fast, slow)
            try:
                found = part_squares(self._with(settings), learnt, other)
                self.built = True
            except ConsistentIdError as reason:
                self.skipped[str(reason)] = None
                found = np.full(BLOCKS_OF_DELAY, np.inf)
            self._squares[settings, part] = found
        return self._squares[settings, part]

    def _with(self, settings: Settings) -> Problem:
        """Return the problem with settings; the last one has its prepared logs."""
        if self._made is None or self._made[0] != settings:
            self._made = settings, with_settings(self.problem, settings)
        return self._made[1]
