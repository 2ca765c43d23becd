"""What is identified from a log of a rehearsal, beside what was planted."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.constraints import NonNegativeDrive, PhysicalConsistency
from consistent_id.estimation.constrained import constrained_least_squares
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.least_squares import least_squares
from consistent_id.laboratory.rehearsal.planted import PlantedRobot
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import differentiated, low_passed, trimmed
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import build_regression

_CUTOFF = 8.0  # times the highest frequency of the motion
_LOWEST, _HIGHEST = 6.0, 0.2  # Hz; share of the rate
_MIXED = 0.05  # s of which rows are mixed to one
_TRIM = 0.1  # s at either end, where filters have no neighbours


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """Estimates from a log.

    Parameters
    ----------
    plain : Estimate
        Weighted least squares: base parameters.
    constrained : Estimate
        Of physically consistent bodies, with friction that brakes.
    """

    plain: Estimate
    constrained: Estimate

    def errors(self, robot: PlantedRobot, base: BaseParameters) -> Vector:
        """Return the errors of the base parameters by least squares."""
        return np.asarray(self.plain.base_values - base.projection @ robot.parameters)


def prepared(log: Recording, highest: float) -> Recording:
    """Return a log with velocity and acceleration, its motion low-passed.

    Parameters
    ----------
    highest : float, [Hz]
        Frequency of the motion.
    """
    cutoff = min(max(_CUTOFF * highest, _LOWEST), _HIGHEST * log.rate)
    filtered = differentiated(low_passed(log, motion_cutoff=cutoff))
    start, stop = float(log.time[0]), float(log.time[-1])
    return trimmed(filtered, start + _TRIM, stop - _TRIM)


def identified(
    robot: PlantedRobot,
    base: BaseParameters,
    log: Recording,
    noise: Vector,
    highest: float,
) -> Identified:
    """Identify a planted robot from a log, as if nothing were known of its bodies.

    Parameters
    ----------
    robot : PlantedRobot
        Of which only the model is used.
    noise : ndarray, shape (joints,), [N m or N]
        By which rows are divided.
    highest : float, [Hz]
        Frequency of the motion.
    """
    model = robot.model
    ready = prepared(log, highest)
    mixed = max(1, round(_MIXED * ready.rate))
    regression = build_regression(model, ready, decimate=mixed).weighted(noise)
    plain = least_squares(model, regression, base=base)
    constraints = (PhysicalConsistency(), NonNegativeDrive())
    constrained = constrained_least_squares(
        model, regression, constraints=constraints, base=base
    )
    return Identified(plain, constrained)
