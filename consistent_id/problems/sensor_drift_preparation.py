"""Recordings of a wrench sensor whose bias drifts, as a problem file says."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.estimation.least_squares import weighted_least_squares
from consistent_id.problems.file import ProblemTable
from consistent_id.recordings.recording import Recording
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.sensor_drift import (
    Drift,
    bias_along,
    driftless_regression,
    driftless_segments,
)
from consistent_id.regression.segments import segment_regressions


@dataclass(frozen=True, slots=True, eq=False)
class SensorDrift:
    """The biases of a sensor, one for each recording, and the tool that tells them.

    Parameters
    ----------
    model : TorqueModel
    drift : {"none", "recordings", "linear"}
    tool : ndarray, shape (parameters,)
        From the training recordings; none, where nothing drifts.
    """

    model: TorqueModel
    drift: Drift
    tool: Vector

    @staticmethod
    def of(
        table: ProblemTable,
        model: TorqueModel,
        training: Callable[[], Sequence[Recording]],
    ) -> "SensorDrift":
        """Fit the tool to recordings, whatever the bias of each, if it drifts."""
        drift = drift_of(table)
        if drift == "none":
            return SensorDrift(model, drift, np.zeros(0))
        regression = driftless_regression(model, training(), drift)
        found = weighted_least_squares(model, regression)
        return SensorDrift(model, drift, found.parameters)

    def left_out(self, parts: Sequence[Recording]) -> tuple[Recording, ...]:
        """Return recordings without their bias, as they are predicted and compared."""
        if self.drift == "none":
            return tuple(parts)
        return tuple(self._without(part) for part in parts)

    def _without(self, log: Recording) -> Recording:
        bias = bias_along(self.model, self.tool, log, self.drift)
        shown = bias.start + np.outer(log.time - log.time[0], bias.rate)
        (wrench,) = log.wrenches
        return replace(log, wrenches=(replace(wrench, values=wrench.values - shown),))


def drift_of(table: ProblemTable) -> Drift:
    """Return how the bias of a problem's wrench sensor drifts."""
    return "none" if table.wrist_sensor is None else table.wrist_sensor.drift


def regression_of(
    table: ProblemTable, model: TorqueModel, recordings: Sequence[Recording]
) -> Regression:
    """Compress prepared recordings; what each tells of its own bias is left out.

    The bias is gone from the recordings, but not what they tell of it: it is unknown.
    """
    drift = drift_of(table)
    if drift == "none":
        return build_regression(model, recordings)
    return driftless_regression(model, recordings, drift)


def segments_of_problem(
    table: ProblemTable, model: TorqueModel, recordings: Sequence[Recording]
) -> tuple[Regression, ...]:
    """Compress prepared recordings in segments, like `regression_of`."""
    drift = drift_of(table)
    if drift == "none":
        return segment_regressions(model, recordings)
    return driftless_segments(model, recordings, drift)
