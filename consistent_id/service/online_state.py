"""What an estimate that follows knows after a block of samples, and its verdict."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.brief import brief
from consistent_id.constraints.cones.certificate import Optimality
from consistent_id.estimation.judgement import HELD_OUT_CARE, NO_BETTER_THAN_ZERO
from consistent_id.estimation.verdict import Reason, Verdict, Word, percent, weighed
from consistent_id.recordings.recording import Recording
from consistent_id.service.load_watch import WatchedBlock
from consistent_id.service.warm_fit import PathPoint

METHOD = "followed"


@dataclass(frozen=True, slots=True, eq=False)
class WaitingBlock:
    """A block that waits until it is sure that no load came within it."""

    watched: WatchedBlock
    rows: Matrix


@brief
@dataclass(frozen=True, slots=True, eq=False)
class LoadChange:
    """A change of the load that was announced.

    Parameters
    ----------
    time : float, [s]
        Of the announcement.
    loaded : bool
        Whether the robot carries a load since then.
    score : float
        Over the limit.
    """

    time: float
    loaded: bool
    score: float


@brief
@dataclass(frozen=True, slots=True, eq=False)
class OnlineState:
    """What is known after a block.

    Parameters
    ----------
    time, solved : float, [s]
        Of the last sample, and of the one at the last solution.
    factor : ndarray, shape (parameters + 1, parameters + 1)
        ``||factor [x, -1]||^2`` is the weighted squared misfit of all samples so far,
        each faded by its age.
    weight : float
        Samples that count, faded.
    errors : ndarray, shape (torque joints, 2), [(N m)^2 or N^2]
        Faded sums of squared prediction errors and squared torques: each block is
        predicted before it is learned from.
    parameters, deviations : ndarray, shape (parameters,)
        The estimate, and standard errors of samples and anchor under the equalities:
        zero for a mass that one fixes.  Inequalities and cones do not count.
    optimality : Optimality
    change : LoadChange, optional
        The last announcement.
    score : float
        Of the watch, over its limit: 1 or more announces a change.
    relearned : float, [s]
        Time at which the carrying link's body was last forgotten.
    verdict : Verdict
    """

    time: float
    solved: float
    factor: Matrix
    weight: float
    errors: Matrix
    parameters: Vector
    deviations: Vector
    carried: Matrix
    optimality: Optimality
    verdict: Verdict
    change: LoadChange | None = None
    score: float = 0.0
    relearned: float = -np.inf
    path: tuple[PathPoint, ...] = ()
    waiting: tuple[WaitingBlock, ...] = ()
    tail: Recording | None = None

    def __repr__(self) -> str:
        load = "with a load" if self.loaded else "no load"
        return f"OnlineState({self.time:.6g} s, {load}, {self.verdict})"

    @property
    def loaded(self) -> bool:
        """Whether the robot carries a load, as far as was announced."""
        return self.change is not None and self.change.loaded

    @property
    def prediction_errors(self) -> Vector:
        """RMS error of each joint's predicted torque over its RMS torque."""
        torque = np.maximum(self.errors[:, 1], np.finfo(float).tiny)
        return np.asarray(np.sqrt(self.errors[:, 0] / torque))


def verdict_of(state: OnlineState, start: Verdict) -> Verdict:
    """Return whether the followed estimate may be used, and why not.

    Parameters
    ----------
    start : Verdict
        On the estimate that it began from, to which the anchor holds all that the
        samples do not determine.
    """
    errors = state.errors.sum(axis=0)
    error = float(np.sqrt(errors[0] / errors[1])) if errors[1] > 0.0 else None
    reasons = [*_of_start(start), *_reasons(state, error)]
    return weighed(METHOD, reasons, (), error, ())


def _of_start(start: Verdict) -> Iterator[Reason]:
    if start.word != "use":
        kinds = ", ".join(dict.fromkeys(r.kind for r in start.grounds))
        yield Reason(
            "start",
            start.word,
            f"the verdict on the estimate at the start is {start.word!r}: {kinds}",
            "identify the robot again, and begin with that estimate",
        )


def _reasons(state: OnlineState, error: float | None) -> Iterator[Reason]:
    if state.optimality.verdict != "certified":
        yield Reason(
            "optimum",
            "do not use",
            f"the optimum is known only to a relative gap of {state.optimality.gap:.1e}"
            f", constraints to {state.optimality.violation:.1e}",
            "begin again with `start`",
        )
    if error is not None and error > HELD_OUT_CARE:
        word: Word = "do not use" if error > NO_BETTER_THAN_ZERO else "use with care"
        yield Reason(
            "prediction error",
            word,
            f"the torque of the last blocks was predicted with an error of "
            f"{percent(error)}, each before it was learned from",
            "look for a collision, a load that was not announced, or wrong torques",
        )
    if state.loaded and state.change is not None:
        yield Reason(
            "load",
            "use",
            f"a load came, announced at {state.change.time:.6g} s",
        )
