"""The sources of errors of a paper's least squares: a budget, cause by cause.

A paper's verification errors bound the torque that its model lacks, so assumed friction
may be too large.  Inertial torque decreases with the square of a task's tempo and
Coulomb friction does not, so the allowed friction may still suffice if the tasks were
slow.  So friction is set to the printed errors, joint by joint, and the tasks' tempo is
varied.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.laboratory.experiment import Laboratory
from consistent_id.laboratory.reproduction.experiments import Reproduction
from consistent_id.problems.problem import Problem
from consistent_id.problems.published import (
    Parametrisation,
    parametrisation_of,
    published_table,
)
from consistent_id.recordings.recording import Recording, states
from consistent_id.recordings.signals.clocks import uniform_rate
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.mass_matrix import mass_matrices

SLOWNESS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ErrorBudget:
    """Parts of the errors of least squares as published, over experiments.

    Along directions in which torque does not change they have no part.

    Parameters
    ----------
    names : tuple of str
        Names of the paper's combinations.
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
        """Return the error from one or all causes, (experiments, combinations)."""
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
        Recording of each experiment, or its planned motion.
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


@dataclass(frozen=True, slots=True, eq=False)
class Tempo:
    """Scatter over experiments whose tasks are slowed down.

    Parameters
    ----------
    names : tuple of str
        Names of the paper's combinations.
    slowness : ndarray, shape (tempos,)
        Factors by which tasks take longer.
    allowed : ndarray, shape (joints,)
        Factors of the laboratory's friction at which friction alone, along the paper's
        verification motion, has the mean square that the paper prints as its error.
    scatter : ndarray, shape (tempos, combinations)
        Scatter of least squares as published, with friction as allowed.
    noise : ndarray, shape (tempos, combinations)
        Scatter from the sensors' noise alone.
    """

    names: tuple[str, ...]
    slowness: Vector
    allowed: Vector
    scatter: Matrix
    noise: Matrix

    def needed(self, place: int, value: float) -> float:
        """Return the slowness at which a parameter scatters by `value`.

        Interpolated between logarithms; infinite or 1 beyond what was looked at.
        """
        total = np.hypot(self.scatter[:, place], self.noise[:, place])
        if total[0] >= value:
            return 1.0
        above = np.flatnonzero(total >= value)
        if not len(above):
            return float("inf")
        k = int(above[0])
        low, high = np.log(total[k - 1 : k + 1])
        share = (np.log(value) - low) / (high - low)
        first, second = np.log(self.slowness[k - 1 : k + 1])
        return float(np.exp(first + share * (second - first)))


@dataclass(frozen=True, slots=True, eq=False)
class PrintedSpread:
    """Torque of a paper's own vectors along its own verification motion.

    Parameters
    ----------
    vectors : ndarray, shape (experiments, joints), [(N m)^2]
        Mean square of the torque by which each vector differs from the mean.
    most_scattered : ndarray, shape (joints,), [(N m)^2]
        The same for one standard deviation of the parameter that scatters most, alone.
    printed : ndarray, shape (motions, joints), [(N m)^2]
        The errors that the paper prints.
    """

    vectors: Matrix
    most_scattered: Vector
    printed: Matrix


def slowed(motion: Recording, factor: float) -> Recording:
    """Return the same path in `factor` times the time."""
    velocity, acceleration = motion.velocity, motion.acceleration
    return replace(
        motion,
        time=motion.time * factor,
        velocity=None if velocity is None else velocity / factor,
        acceleration=None if acceleration is None else acceleration / factor**2,
    )


def tempo_of(
    problem: Problem,
    laboratory: Laboratory,
    motions: Mapping[str, Recording],
    *,
    cell_rate: float,
    slowness: Sequence[float] = SLOWNESS,
) -> Tempo:
    """Slow tasks down, with as much friction as the printed errors allow."""
    allowed = allowed_friction(problem, laboratory)
    budgets = []
    for factor in slowness:
        slow = {name: slowed(motion, factor) for name, motion in motions.items()}
        budgets.append(error_budget(problem, laboratory, slow, cell_rate=cell_rate))
    parts = np.array([budget.parts[:, :-1].sum(axis=1) for budget in budgets])
    errors = np.einsum("j,teja->tea", allowed, parts)
    return Tempo(
        names=budgets[0].names,
        slowness=np.array(slowness),
        allowed=allowed,
        scatter=np.asarray(errors.std(axis=1, ddof=1)),
        noise=np.array([budget.noise_scatter for budget in budgets]),
    )


def allowed_friction(problem: Problem, laboratory: Laboratory) -> Vector:
    """Return the factor of each joint's friction that the printed errors allow.

    With the mean of the errors printed for a joint; one where nothing is printed.
    """
    printed = np.array(published_table(problem).mean_squared_errors)
    if not printed.size:
        return np.ones(len(laboratory.robot.joints))
    torque = unmodelled_torque(laboratory, *_states(problem))[:-1].sum(axis=0)
    square = np.asarray((torque**2).mean(axis=1))
    return np.asarray(np.sqrt(printed.mean(axis=0) / np.where(square > 0, square, 1)))


def printed_spread(problem: Problem, most_scattered: int) -> PrintedSpread:
    """Compare a paper's vectors along its verification motion.

    Parameters
    ----------
    most_scattered : int
        Place of the parameter that scatters most.
    """
    table, mine = published_table(problem), parametrisation_of(problem)
    Y = mine.regressor(*_states(problem))
    vectors = np.array(table.experiments)
    apart = vectors - vectors.mean(axis=0)
    torque = np.einsum("jas,ea->ejs", Y, apart, optimize=True)
    alone = Y[:, most_scattered] * vectors[:, most_scattered].std(ddof=1)
    joints = Y.shape[0]
    return PrintedSpread(
        vectors=np.asarray((torque**2).mean(axis=2)),
        most_scattered=np.asarray((alone**2).mean(axis=1)),
        printed=np.array(table.mean_squared_errors).reshape(-1, joints),
    )


def _states(problem: Problem) -> tuple[Array, Array, Array]:
    motion = problem.motion(published_table(problem).motion)
    return states(motion.of(problem.model.robot.joint_names))
