"""Where the errors of a paper's least squares come from: a budget, cause by cause.

Least squares is linear in torque, ``alpha = Y^+ (tau - Y_fixed alpha_fixed)``: torque
that the model does not have moves the estimate by ``Y^+`` times that torque, so that
each joint's friction, and each offset, has its own part of the error.  Nothing need be
performed for it; the motion is enough.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.threads import single_threaded
from consistent_id.errors import ProblemError
from consistent_id.laboratory import Laboratory
from consistent_id.laboratory.reproduction.experiments import Reproduction
from consistent_id.problems.parametrisation import Parametrisation
from consistent_id.problems.problem import Problem
from consistent_id.problems.published import parametrisation_of, published_table
from consistent_id.recordings.recording import Recording, states
from consistent_id.recordings.signals.clocks import uniform_rate
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.mass_matrix import mass_matrices


@dataclass(frozen=True, slots=True, eq=False)
class ErrorBudget:
    """Parts of the errors of least squares as published, over experiments.

    Along directions in which torque does not change they have no part.

    Parameters
    ----------
    names : tuple of str
        Of the paper's combinations.
    parts : ndarray, shape (experiments, causes, joints, combinations)
    noise : ndarray, shape (experiments, combinations)
        Standard errors to be expected of the sensors' noise alone.
    """

    names: tuple[str, ...]
    experiments: tuple[str, ...]
    causes: tuple[str, ...]
    joints: tuple[str, ...]
    parts: Array
    noise: Matrix

    def error(self, cause: str | None = None) -> Matrix:
        """Return what a cause adds, or all of them, (experiments, combinations)."""
        if cause is None:
            return np.asarray(self.parts.sum(axis=(1, 2)))
        if cause not in self.causes:
            raise ProblemError(f"no cause {cause!r}; known are {self.causes}")
        return np.asarray(self.parts[:, self.causes.index(cause)].sum(axis=1))

    def scatter(self, cause: str | None = None) -> Vector:
        """Return the standard deviation of `error` over experiments."""
        return np.asarray(self.error(cause).std(axis=0, ddof=1))

    @property
    def noise_scatter(self) -> Vector:
        """Standard deviation over experiments that noise alone predicts."""
        return np.asarray(np.sqrt((self.noise**2).mean(axis=0)))


def error_budget(
    problem: Problem,
    laboratory: Laboratory,
    recordings: Mapping[str, Recording],
    *,
    cell_rate: float,
) -> ErrorBudget:
    """Account for the errors of least squares as published.

    Parameters
    ----------
    laboratory : Laboratory
        With the friction, the offsets and the noise to account for.
    recordings : mapping of str to Recording
        What each experiment is identified from, or the motion that is planned for it.
    cell_rate : float, [Hz]
        At which the load cell is read.
    """
    mine, fixed = parametrisation_of(problem), published_table(problem).fixed
    rows = [
        _account(mine, fixed, laboratory, recording, cell_rate)
        for recording in recordings.values()
    ]
    return ErrorBudget(
        names=mine.names,
        experiments=tuple(recordings),
        causes=(*_terms(laboratory), "offset"),
        joints=laboratory.robot.joints,
        parts=np.array([parts for parts, _ in rows]),
        noise=np.array([noise for _, noise in rows]),
    )


def budget_of(
    problem: Problem, laboratory: Laboratory, done: Reproduction
) -> ErrorBudget:
    """Account for the errors of reproduced experiments."""
    recordings = {e.name: e.synchronised_log.recording for e in done.experiments}
    rate = uniform_rate(done.experiments[0].log.encoders)
    return error_budget(problem, laboratory, recordings, cell_rate=rate)


@single_threaded
def _account(
    mine: Parametrisation,
    fixed: Sequence[str],
    laboratory: Laboratory,
    recording: Recording,
    cell_rate: float,
) -> tuple[Array, Vector]:
    """Return parts, shape (causes, joints, combinations), and noise's errors."""
    recording = recording.of(laboratory.robot.joints)
    q, dq, ddq = states(recording)
    free = mine.others(fixed)
    Y = mine.regressor(q, dq, ddq)[:, free]
    joints, _, samples = Y.shape
    rows = Y.transpose(0, 2, 1).reshape(joints * samples, len(free))
    inverse = np.zeros((len(mine), joints, samples))
    solved = solve_linear(rows, np.zeros(len(rows))).pseudo_inverse
    inverse[free] = solved.reshape(len(free), joints, samples)
    torque = unmodelled_torque(laboratory, q, dq, ddq)
    parts = np.einsum("ajs,cjs->cja", inverse, torque, optimize=True)
    return parts, _noise(inverse, laboratory, recording, cell_rate)


def unmodelled_torque(laboratory: Laboratory, q: Array, dq: Array, ddq: Array) -> Array:
    """Return each cause's torque, shape (causes, joints, samples); offsets last."""
    robot = laboratory.robot
    start, terms = robot.model.layout.inertial_size, _terms(laboratory)
    Y = robot.model.regressor(q, dq, ddq)
    torque = np.zeros((len(terms) + 1, len(robot.joints), len(q)))
    for i, (_, term) in enumerate(robot.model.layout.drive, start):
        torque[terms.index(term)] += Y[:, i] * robot.parameters[i]
    offset = np.broadcast_to(laboratory.load_cell.offset, len(robot.joints))
    torque[-1] = offset[:, None]
    return torque


def _terms(laboratory: Laboratory) -> list[str]:
    return list(dict.fromkeys(t for _, t in laboratory.robot.model.layout.drive))


def _noise(
    inverse: Array, laboratory: Laboratory, recording: Recording, cell_rate: float
) -> Vector:
    """Return the standard errors due to white noise of load cell and cameras.

    To first order an error ``n`` of the acceleration is one of ``-M(q) n`` of the
    torque.  A low-pass above the motion's frequencies leaves noise its density, so that
    a sample counts for ``sensor rate / recording rate`` samples of the sensor.
    """
    robot, rate = laboratory.robot, uniform_rate(recording)
    n = len(robot.joints)
    cell = np.broadcast_to(laboratory.load_cell.noise, n)
    seen = np.broadcast_to(laboratory.cameras.acceleration_noise, n)
    M = mass_matrices(robot.model, robot.parameters, recording.position)
    through = np.einsum("ajs,sjk->aks", inverse, M, optimize=True)
    of_cell = (inverse**2).sum(axis=2) @ cell**2 * rate / cell_rate
    of_cameras = (through**2).sum(axis=2) @ seen**2 * rate / laboratory.cameras.rate
    return np.asarray(np.sqrt(of_cell + of_cameras))
