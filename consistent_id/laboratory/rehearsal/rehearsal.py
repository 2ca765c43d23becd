"""Rehearsals: motions played by planted robots, and what came of their predictions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.tables import Table
from consistent_id.estimation.torque_error import torque_errors
from consistent_id.excitation.accuracy import PredictedAccuracy
from consistent_id.laboratory.rehearsal.holding import Holding, held_poses
from consistent_id.laboratory.rehearsal.identified import identified, prepared
from consistent_id.laboratory.rehearsal.planted import PlantedRobot
from consistent_id.laboratory.rehearsal.playing import PlayedMotion, play
from consistent_id.motion.limits import MotionLimits
from consistent_id.recordings.paths import JointPath
from consistent_id.regression.base import BaseParameters

SENSED = 0.5
"""Share of the predicted noise that sensors have; friction's errors are the rest."""
_WITHIN = 1.96  # standard errors that hold 95 % of a normal distribution


@dataclass(frozen=True, slots=True, eq=False)
class Rehearsal:
    """One motion, played by one planted robot.

    Parameters
    ----------
    errors : ndarray, shape (base,)
        Of the base parameters by weighted least squares.
    predicted : ndarray, shape (base,)
        Standard errors that were predicted.
    held_out : float
        Error of the predicted torque on another motion, RMS, in shares of the noise.
    reached : mapping of str to ndarray, shape (joints,)
        Largest share of each limit, by quantity: position, velocity, torque.
    tracking : float, [rad or m]
        Largest root-mean-square tracking error of a joint.
    """

    base: BaseParameters
    errors: Vector
    predicted: Vector
    held_out: float
    holding: Holding
    reached: Mapping[str, Vector]
    tracking: float

    @property
    def mean_error(self) -> float:
        """Geometric mean of the errors' sizes."""
        size = np.maximum(abs(self.errors), np.finfo(float).tiny)
        return float(np.exp(np.log(size).mean()))

    @property
    def ratio(self) -> float:
        """Root mean square of errors over predicted standard errors."""
        return float(np.sqrt(np.mean((self.errors / self.predicted) ** 2)))

    @property
    def covered(self) -> float:
        """Share of the predicted 95 % intervals that hold the truth."""
        return float(np.mean(abs(self.errors) <= _WITHIN * self.predicted))


def rehearse(
    robot: PlantedRobot,
    accuracy: PredictedAccuracy,
    path: JointPath,
    validation: JointPath,
    limits: MotionLimits,
    noise: Vector,
    rng: np.random.Generator,
    *,
    highest: float,
    rate: float = 100.0,
) -> Rehearsal:
    """Play a motion, identify, and compare with the truth and with predictions.

    Parameters
    ----------
    accuracy : PredictedAccuracy
        Of the motion, for this robot's model.
    path, validation : JointPath
        What is identified from, and another motion whose torque is predicted.
    noise : ndarray, shape (joints,), [N m or N]
        That accuracy was predicted for; that of the sensors is `SENSED` times this.
    highest : float, [Hz]
        Frequency of the motion.
    rate : float, [Hz]
        Of the log.
    """
    played = play(robot, path, SENSED * noise, rng, rate=rate)
    found = identified(robot, accuracy.base, played.log, noise, highest)
    unseen = play(robot, validation, np.zeros_like(noise), rng, rate=rate).log
    (unexplained,) = torque_errors([found.constrained], prepared(unseen, highest))
    return Rehearsal(
        base=accuracy.base,
        errors=found.errors(robot, accuracy.base),
        predicted=accuracy.standard_errors(),
        held_out=float(np.sqrt(np.mean((unexplained.rms / noise) ** 2))),
        holding=held_poses(robot, found.constrained, limits, rng),
        reached=_reached(played, limits),
        tracking=float(played.tracking_error.max()),
    )


def _reached(played: PlayedMotion, limits: MotionLimits) -> dict[str, Vector]:
    """Return the largest share of each limit that was used in truth."""
    truth = played.truth
    motion = {
        "position": abs(truth.position - limits.middle) / limits.derivative(0),
        "velocity": abs(np.asarray(truth.velocity)) / limits.velocity,
        "torque": abs(np.asarray(truth.torque)) / limits.effort,
    }
    return {name: share.max(axis=0) for name, share in motion.items()}


def rehearsal_table(title: str, rehearsals: Mapping[str, Sequence[Rehearsal]]) -> Table:
    """Return what became of predictions, a line for each motion.

    Parameters
    ----------
    rehearsals : mapping of str to sequence of Rehearsal
        By the motion's name, those of all planted robots.
    """
    rows = []
    for name, some in rehearsals.items():
        poses = sum(one.holding.poses for one in some)
        rows.append(
            (
                name,
                f"{np.median([one.mean_error for one in some]):.3g}",
                f"{np.median([one.held_out for one in some]):.3g}",
                f"{np.sqrt(np.mean([one.ratio**2 for one in some])):.2f}",
                f"{100.0 * np.mean([one.covered for one in some]):.0f} %",
                f"{sum(one.holding.held for one in some)} of {poses}",
            )
        )
    count = min(len(some) for some in rehearsals.values())
    return Table(
        title,
        ("motion", "error", "held-out", "over predicted", "in 95 %", "poses held"),
        tuple(rows),
        (
            f"{count} planted robots; medians; error: geometric mean over base "
            "parameters, in SI units",
            "held-out: torque error on another motion, RMS, in shares of the noise",
            "over predicted: RMS of errors over predicted standard errors, 1 if true",
            "poses held: by the identified gravity torque alone, within 0.2 degrees "
            "for a second",
        ),
    )
