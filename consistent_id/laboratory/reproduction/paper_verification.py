"""Verification on motions that nothing was identified from, as a paper's Table VI."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.laboratory.experiment import Laboratory, perform, synchronised
from consistent_id.laboratory.from_problem import laboratory_table
from consistent_id.laboratory.reproduction.experiments import Reproduction
from consistent_id.problems.problem import Problem
from consistent_id.problems.published import published_table
from consistent_id.recordings.recording import Recording
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.torque_along import predicted_torque


@dataclass(frozen=True, slots=True, eq=False)
class Predictor:
    """Parameters that predict torque: the mean of a method's over experiments.

    Parameters
    ----------
    source : str
        The motion.
    parameters : ndarray, shape (parameters,)
    """

    source: str
    method: str
    model: TorqueModel
    parameters: Vector

    def predict(self, recording: Recording) -> Array:
        """Return torques, shape (samples, joints), [N m or N]."""
        return predicted_torque(self.model, self.parameters, recording)


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """Errors of predicted torque on motions of their own.

    Parameters
    ----------
    recordings : tuple of Recording
        The measured recordings, one for each motion.
    predictors : tuple of Predictor
        The last one has the true parameters: its errors are those of the sensors.
    mean_squared_errors : ndarray, shape (predictors, motions, joints), [(N m)^2]
        ``sum (measured - predicted)^2 / samples``.
    """

    joints: tuple[str, ...]
    recordings: tuple[Recording, ...]
    predictors: tuple[Predictor, ...]
    mean_squared_errors: Array


def verification_motions(problem: Problem) -> dict[str, Recording]:
    """Return the motions that a problem's laboratory verifies with.

    Without any, the one of the paper.
    """
    names = laboratory_table(problem).verification
    return {
        name: problem.motion(name)
        for name in names or [published_table(problem).motion]
    }


def mean_predictors(source: str, done: Reproduction) -> tuple[Predictor, ...]:
    """Return the mean of each method, as the paper predicts with.

    A mean of physically consistent parameters is physically consistent.
    """
    return tuple(
        Predictor(
            source,
            first.method,
            first.model,
            np.mean([e.estimates[i].parameters for e in done.experiments], axis=0),
        )
        for i, first in enumerate(done.experiments[0].estimates)
    )


def verify(
    problem: Problem,
    laboratory: Laboratory,
    motions: Mapping[str, Recording],
    predictors: Sequence[Predictor],
    *,
    seed: int,
) -> Verification:
    """Perform motions in the laboratory and predict their torque.

    Prepared like the experiments: synchronised, filtered, trimmed.

    Parameters
    ----------
    predictors : sequence of Predictor
        The truth is added to them.
    seed : int
        Seed of noise; another than the experiments'.
    """
    table, robot = laboratory_table(problem), laboratory.robot
    streams = np.random.default_rng(seed).spawn(len(motions))
    logs = [
        perform(laboratory, motion, rng)
        for motion, rng in zip(motions.values(), streams, strict=True)
    ]
    recordings = tuple(
        synchronised(log, cutoff=table.cutoff, trim=table.trim).recording
        for log in logs
    )
    truth = Predictor("the laboratory", "truth", robot.model, robot.parameters)
    every = (*predictors, truth)
    errors = [[mean_squared_error(one, log) for log in recordings] for one in every]
    return Verification(robot.joints, recordings, every, np.array(errors))


def mean_squared_error(predictor: Predictor, recording: Recording) -> Vector:
    """Return the mean of squares of measured less predicted torque, by joint."""
    measured = recording.of(predictor.model.torque_joints).torque
    if measured is None:
        return np.full(len(predictor.model.torque_joints), np.nan)
    return np.asarray(((measured - predictor.predict(recording)) ** 2).mean(axis=0))
