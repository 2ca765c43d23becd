"""Drive gains, from motor currents and a load of known mass.

The torque is ``tau_j = k_j i_j``, so that ``Y x - K i = 0`` holds for any multiple of
parameters ``x`` and gains ``k``: from the motion of a robot alone, only ratios are
identifiable.  A load of known mass fixes the scale [Gautier2014]_.

Noise is on the current, and the gains multiply it.  Least squares on ``Y x - K i``
therefore finds gains that are too small, the smaller the more noise: it is only the
start.  Then the misfit in amperes is minimised,

``sum_j || Y_j x / k_j - i_j ||^2 / s_j^2``,

with ``x`` eliminated and each joint's noise ``s_j`` estimated as well.  The result has
maximum likelihood for white noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector, freeze_arrays
from consistent_id._support.executors import single_threaded
from consistent_id._support.singular import svd
from consistent_id._support.tables import brief
from consistent_id.errors import RecordingError, SolverError
from consistent_id.estimation.loaded_robot import (
    LoadedRobot,
    likely_body,
    loaded_robot,
)
from consistent_id.recordings.recording import Recording, several
from consistent_id.regression.correlation_lengths import correlation_length
from consistent_id.regression.linear import column_sizes, independent_columns
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import Link

_OPEN = 1e-6  # singular value, of unit columns, below which a direction counts as open
_ROUNDS = 20  # rounds of gains and noise in turn
_SETTLED = 1e-4  # relative change of the noise that ends the rounds


@brief
@dataclass(frozen=True, slots=True, eq=False)
class DriveGains:
    """Drive gains, and whether they are identifiable from the runs.

    Parameters
    ----------
    joints : tuple of str
    gains : array_like, shape (torque joints,), [N m/A or N/A]
        Where `identifiable` is false, only their ratios are identified.
    covariance : array_like, shape (torque joints, torque joints)
        Of the gains' relative errors, for noise as correlated as the residuals;
        infinite on the diagonal where not identifiable, and zero beside it.
    parameters : array_like, shape (parameters,)
        Parameters of robot and load for these gains; unidentifiable ones are zero.
    linear : array_like, shape (torque joints,)
        Gains of least squares on ``Y x - K i``; noise makes them too small.
    current_noise : array_like, shape (torque joints,), [A]
        Residual standard deviation of each joint.
    correlation : float
        Samples that carry the information of one independent sample.
    accuracy : float
        Relative standard error that counts as identified.
    scale_open : bool
        Whether the runs do not determine the absolute scale.
    robot : LoadedRobot
    seconds : float
    """

    joints: tuple[str, ...]
    gains: Vector
    covariance: Matrix
    parameters: Vector
    linear: Vector
    current_noise: Vector
    correlation: float
    accuracy: float
    scale_open: bool
    robot: LoadedRobot
    seconds: float

    def __post_init__(self) -> None:
        joints = len(self.joints)
        shapes: dict[str, tuple[int, ...]]
        shapes = dict.fromkeys(("gains", "linear", "current_noise"), (joints,))
        freeze_arrays(self, {**shapes, "covariance": (joints, joints)}, finite=False)

    @property
    def relative_errors(self) -> Vector:
        """Standard errors over the gains, shape (torque joints,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def standard_errors(self) -> Vector:
        """Shape (torque joints,), [N m/A or N/A]; infinite where not identifiable."""
        return np.asarray(self.gains * self.relative_errors)

    @property
    def identified(self) -> tuple[bool, ...]:
        """Whether each gain is known to the required accuracy."""
        return tuple((self.relative_errors < self.accuracy).tolist())

    @property
    def identifiable(self) -> bool:
        """Whether all gains are."""
        return all(self.identified)

    @property
    def verdict(self) -> str:
        """The parameters that the runs identify, and missing information."""
        if self.scale_open:
            return (
                "the absolute scale is open: gains and parameters may all be "
                "multiplied by the same number. Runs with a load of known mass and "
                "without it are missing, or exchanged"
            )
        poor = [
            f"{joint} ({error / gain:.0%})"
            for joint, gain, error, good in zip(
                self.joints,
                self.gains,
                self.standard_errors,
                self.identified,
                strict=True,
            )
            if not good
        ]
        if not poor:
            return f"all gains are known to {self.accuracy:.0%} or better"
        return (
            f"not known to {self.accuracy:.0%}: {', '.join(poor)}. The known load "
            f"has little effect there: use a heavier one, or motions in which it "
            f"changes the torques of these joints"
        )


class GainFit(NamedTuple):
    """Everything at one set of gains."""

    x: Vector
    residual: Vector
    jacobian: Matrix  # of the residual by log gains, parameters following
    raw: Matrix  # the same with fixed parameters


class Likely(NamedTuple):
    """The most likely gains."""

    log_gains: Vector
    noise: Vector
    fit: GainFit
    scale_open: bool


@dataclass(frozen=True, slots=True, eq=False)
class Currents:
    """Compressed rows of all joints, in amperes once divided by gains."""

    A: Matrix  # (rows, unknown parameters), [N m per unit]
    known: Vector  # (rows,), torque of the known parameters
    current: Vector  # (rows,)
    joint: IntArray  # (rows,), which joint a row is of

    def at(self, log_gains: Vector, noise: Vector) -> GainFit:
        """Return the best parameters for given gains, and the residual."""
        j = self.joint
        weight = 1.0 / (np.exp(log_gains[j]) * noise[j])
        Q, x = _solved(
            self.A * weight[:, None], self.current / noise[j] - self.known * weight
        )
        torque = (self.A @ x + self.known) * weight
        residual = torque - self.current / noise[j]
        raw = np.zeros((len(j), len(log_gains)))
        raw[np.arange(len(j)), j] = -torque
        return GainFit(x, residual, raw - Q @ (Q.T @ raw), raw)


@single_threaded
def identify_gains(
    model: TorqueModel,
    loaded: Recording | Sequence[Recording],
    unloaded: Recording | Sequence[Recording],
    *,
    known: Mapping[str, float],
    load: Link | None = None,
    carrier: str | None = None,
    accuracy: float = 0.05,
) -> DriveGains:
    """Estimate drive gains and parameters together.

    Parameters
    ----------
    model : TorqueModel
        Model of the robot without the load.
    loaded, unloaded : Recording or sequence of Recording
        With velocity, acceleration, and currents [A] in place of torques.
    known : mapping of str to float
        Known parameters of robot and load, by name, such as ``{"load.m": 2.8}``.
    load : Link, optional
        The load's name; by default ``"load"``.
    carrier : str, optional
        Link that carries the load; by default the last one of a chain.
    accuracy : float
        Relative standard error that counts as identified.

    Raises
    ------
    NotExcitedError, RecordingError, ProblemError
        If runs are missing or do not fit the model.
    SolverError
        If the search does not end.
    """
    started = perf_counter()
    load = Link("load") if load is None else load
    robot = loaded_robot(model, load, carrier=carrier)
    runs = (several(unloaded), several(loaded))
    found = _once(robot, runs, known, accuracy)
    load_found = likely_body(found.parameters[robot.load_slice])
    in_need = model.load_reference is not None and load.nominal is None
    if in_need and load_found is not None and not found.scale_open:
        # From now on, gear friction depends on the load.
        found = _once(robot.with_nominal(load_found), runs, known, accuracy)
    return replace(found, seconds=perf_counter() - started)


def _once(
    robot: LoadedRobot,
    runs: tuple[Sequence[Recording], Sequence[Recording]],
    known: Mapping[str, float],
    accuracy: float,
) -> DriveGains:
    """Estimate gains; gear friction depends on the load's nominal parameters."""
    regression = robot.regression(*runs)
    rms = dict(zip(regression.joints, regression.torque_rms, strict=True))
    if dead := [joint for joint, size in rms.items() if size == 0.0]:
        raise RecordingError(f"the current is zero throughout for {', '.join(dead)}")
    rows, unknown, values = _rows(robot, regression, known)
    linear = linear_gains(rows, len(regression.joints))
    found = most_likely_gains(rows, regression, linear)
    x = values.copy()
    x[unknown] = found.fit.x
    gains, noise = np.exp(found.log_gains), found.noise
    correlation = correlation_length(_residuals(robot, runs, x, gains), noise)
    covariance = np.diag(np.full(len(gains), np.inf))
    if not found.scale_open:
        covariance = _spread(found.fit.jacobian) * correlation
    return DriveGains(
        joints=regression.joints,
        gains=gains,
        covariance=covariance,
        parameters=x,
        linear=linear,
        current_noise=noise,
        correlation=correlation,
        accuracy=accuracy,
        scale_open=found.scale_open,
        robot=robot,
        seconds=0.0,
    )


def _spread(J: Matrix) -> Matrix:
    """Return ``(J^T J)^-1``, with an infinite diagonal alone where it is singular."""
    R = np.linalg.qr(J, mode="r")
    size = abs(np.diag(R))
    if size.min() <= np.finfo(float).eps * size.max():
        return np.diag(np.full(len(R), np.inf))
    inverse = np.linalg.inv(R)
    return np.asarray(inverse @ inverse.T)


def _rows(
    robot: LoadedRobot, regression: Regression, known: Mapping[str, float]
) -> tuple[Currents, list[int], Vector]:
    """Return compressed rows, which parameters are unknown, and the known ones."""
    layout = robot.model.layout
    values = np.zeros(len(layout))
    places = {layout.index(name): float(value) for name, value in known.items()}
    values[list(places)] = list(places.values())
    others = [i for i in range(len(layout)) if i not in places]
    stacked = np.vstack(regression.factors)
    independent, _, _ = independent_columns(stacked[:, others])
    unknown = [others[i] for i in independent]
    joint = np.repeat(
        np.arange(len(regression.factors)), [len(f) for f in regression.factors]
    )
    rows = Currents(
        stacked[:, unknown],
        stacked[:, :-1] @ values,
        stacked[:, -1],
        joint,
    )
    return rows, unknown, values


def _residuals(
    robot: LoadedRobot,
    runs: tuple[Sequence[Recording], Sequence[Recording]],
    x: Vector,
    gains: Vector,
) -> list[Vector]:
    """Return each joint's misfit in amperes, sample by sample."""
    parts = []
    for k, logs in enumerate(runs):
        for log in logs:
            current = np.asarray(log.of(robot.bare.torque_joints).torque)
            parts.append(robot.predict(x, log, loaded=k == 1) / gains - current)
    return list(np.vstack(parts).T)


def linear_gains(rows: Currents, joints: int) -> Vector:
    """Return the gains of least squares on ``Y x - K i = - known``."""
    currents = np.zeros((len(rows.joint), joints))
    currents[np.arange(len(rows.joint)), rows.joint] = -rows.current
    A = np.hstack([rows.A, currents])
    _, solution = _solved(A, -rows.known)
    return np.asarray(solution[-joints:])


def most_likely_gains(rows: Currents, regression: Regression, linear: Vector) -> Likely:
    """Minimise the misfit in amperes; gains and noise in turn until both converge."""
    from scipy.optimize import least_squares

    counts = np.array(regression.counts, dtype=np.float64)
    log_gains = _start(rows, linear)
    noise = regression.torque_rms  # of the currents, to begin with
    floor = 1e-6 * noise
    spent = (rows.A.shape[1] + len(counts)) / counts.sum()
    free = _identifiable(rows.at(log_gains, noise))
    for _ in range(_ROUNDS):
        origin, sigma = log_gains, noise
        found = least_squares(
            lambda v, u=origin, s=sigma: rows.at(u + free @ v, s).residual,
            np.zeros(free.shape[1]),
            jac=lambda v, u=origin, s=sigma: rows.at(u + free @ v, s).jacobian @ free,
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-12,
        )
        log_gains = origin + free @ found.x
        squares = rows.at(log_gains, noise).residual ** 2
        left = np.bincount(rows.joint, squares) / counts / max(1.0 - spent, 1e-3)
        noise = np.maximum(noise * np.sqrt(left), floor)
        if (abs(noise - sigma) <= _SETTLED * sigma).all():
            fit = rows.at(log_gains, noise)
            return Likely(log_gains, noise, fit, free.shape[1] < len(counts))
    raise SolverError(
        f"gains and noise did not converge in {_ROUNDS} rounds; the runs do not "
        f"determine the gains, the runs with and without the load are exchanged, or "
        f"the model is far from the robot"
    )


def _start(rows: Currents, linear: Vector) -> Vector:
    """Return logarithms of the gains of least squares, where they are positive."""
    # If the scale is not determined, zero torque fits best: gains of zero.
    torque = np.linalg.norm(linear[rows.joint] * rows.current)
    positive = linear > 0.0
    if not positive.any() or torque <= _OPEN * np.linalg.norm(rows.known):
        return np.zeros(len(linear))
    return np.log(np.where(positive, linear, np.median(linear[positive])))


def _identifiable(fit: GainFit) -> Matrix:
    """Return a basis of the directions of log gains that are identifiable."""
    sizes = column_sizes(fit.raw)
    _, s, Vt = svd(fit.jacobian / sizes, full_matrices=False)
    null = (Vt[s <= _OPEN] / sizes).T
    Q, _ = np.linalg.qr(np.hstack([null, np.eye(len(sizes))]))
    return Q[:, null.shape[1] :]


def _solved(A: Matrix, b: Vector) -> tuple[Matrix, Vector]:
    """Return an orthonormal basis of unit columns, and the least-squares solution."""
    unit = column_sizes(A)
    U, s, Vt = svd(A / unit, full_matrices=False)
    kept = s > 1e-10 * s[0]
    Q = U[:, kept]
    return Q, (Vt[kept].T / s[kept]) @ (Q.T @ b) / unit
