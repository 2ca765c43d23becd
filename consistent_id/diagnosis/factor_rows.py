"""Rows of logs beside nominal bodies, and how factors of a whole robot change them.

A factor is one number: the clock's speed, a gain of all torques, a zero, the angle of a
leaning base.  The rows of a log are those of all parameters, of the factors, and of the
nominal bodies, which pull as far as bodies are usually known.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.diagnosis.alternatives import last_links
from consistent_id.diagnosis.linearise import Jackknife, jackknife
from consistent_id.diagnosis.sample_rows import SampleRows, of_own_row
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.regression.correlated_noise import correlation_lengths
from consistent_id.regression.linear import smallest_solution
from consistent_id.regression.regression import triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.scaling import (
    USUAL_WIDTHS,
    link_scales,
    reference_bodies,
)

LEAN = float(np.radians(5.0))
"""Least angle of a leaning base that is reported."""

_FREE_MASS = 0.3  # where masses are free to differ from the model's

_RANK = 1e-7  # of the largest singular value of unit columns
_STEP = 1e-4  # of the direction of gravity, for its derivative
_EXACT = 1e-3  # of the torque: least residual that weights a joint's rows


@dataclass(frozen=True, slots=True)
class Factor:
    """A fault of which one number is unknown.

    Parameters
    ----------
    kind : {"clock", "masses or gain", "offset zero", "gravity"}
    where : str
    least : float
        Least size that is reported: log of the clock's speed or of the gain, [rad or
        m] for zeros and [rad] for the base.
    joint : int
        Of a zero.
    axis : tuple of float
        Level unit vector about which the base may lean.
    """

    kind: str
    where: str
    least: float
    joint: int = 0
    axis: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class FactorLogs:
    """Logs, perhaps with a factor taken out, and the model that belongs to them.

    Parameters
    ----------
    model : TorqueModel
        Of a robot with nominal bodies and a fixed base.
    logs : sequence of Recording
        Prepared, with the robot's joints; few samples suffice.
    widths : ndarray, shape (3,)
        Those to which masses, centres of mass and second moments are known.
    noise : ndarray, shape (torque joints,)
        Relative to the torque; of the logs as they are, see `relative_noise`.
    loaded : bool
        Whether links that carry no other may carry anything: their bodies are free.
    """

    model: TorqueModel
    logs: Sequence[Recording]
    widths: Vector
    noise: Vector
    loaded: bool = False

    @classmethod
    def of(
        cls, model: TorqueModel, logs: Sequence[Recording], *, masses_known: bool = True
    ) -> "FactorLogs":
        """Return logs as they are.

        Parameters
        ----------
        masses_known : bool
            Whether masses are those of the datasheet.
        """
        mass, centre, moment = USUAL_WIDTHS
        widths = np.array([mass if masses_known else _FREE_MASS, centre, moment])
        return cls(model, logs, widths, relative_noise(model, logs))

    def without(self, factor: Factor, size: float) -> "FactorLogs":
        """Take a factor out."""
        if factor.kind == "gravity":
            return replace(self, model=leaning(self.model, factor.axis, size))
        return replace(
            self,
            logs=[
                altered(log, lambda raw: _without(raw, factor, size))
                for log in self.logs
            ],
        )


def _without(log: Recording, factor: Factor, size: float) -> Recording:
    if factor.kind == "clock":
        speed = np.exp(size)
        velocity, acceleration = np.asarray(log.velocity), np.asarray(log.acceleration)
        return replace(
            log, velocity=speed * velocity, acceleration=speed**2 * acceleration
        )
    if factor.kind == "masses or gain":
        return replace(log, torque=np.asarray(log.torque) * np.exp(-size))
    zeros = size * (np.arange(log.position.shape[1]) == factor.joint)
    return replace(log, position=log.position + zeros)


def leaning(model: TorqueModel, axis: Sequence[float], angle: float) -> TorqueModel:
    """Return a model whose gravity is turned about a level axis."""
    gravity = np.asarray(model.robot.gravity)
    turned = np.cos(angle) * gravity + np.sin(angle) * np.cross(axis, gravity)
    return replace(model, robot=replace(model.robot, gravity=turned))


def factors_of(model: TorqueModel) -> list[Factor]:
    """Return the factors that a robot with a fixed base may have."""
    joints = model.robot.driven
    found = [
        Factor("clock", "time", float(np.log(1.15))),
        Factor("masses or gain", "all joints", float(np.log(1.2))),
    ]
    for k, joint in enumerate(joints):
        least = 0.05 if joint.kind == "prismatic" else float(np.radians(6.0))
        found.append(Factor("offset zero", joint.name, least, joint=k))
    gravity = np.asarray(model.robot.gravity)
    if gravity.any():
        level = np.linalg.svd(gravity[None])[2][1:]
        found += [Factor("gravity", "base", LEAN, axis=tuple(k)) for k in level]
    return found


def factor_system(
    state: FactorLogs,
    factors: Sequence[Factor],
    *,
    nominal: bool = True,
    instruments: bool = False,
) -> Jackknife:
    """Return rows of the factors, with bodies and drives eliminated.

    Without `nominal`, nothing pulls the bodies.  With `instruments`, the columns of the
    factors are followed by those that they have with nominal bodies.
    """
    model = state.model
    rows, A, torque = _rows(model, state.logs)
    weights = 1.0 / (state.noise * _size(torque))
    pull, pulled_to = _pull(state, A.shape[1])
    if not nominal:
        pull, pulled_to = pull[:0], pulled_to[:0]
    c = np.zeros((len(A), 0, A.shape[2]))
    if factors:
        at = [_solution(A, torque, weights, pull, pulled_to)]
        if instruments:
            drawn = np.zeros(A.shape[1])
            drawn[: model.layout.inertial_size] = reference_bodies(model.robot).ravel()
            at.append(drawn)
        slopes = [
            np.concatenate([r.slopes(x, factors) for x in at], axis=1) for r in rows
        ]
        c = np.concatenate(slopes, axis=2)
    every = np.concatenate([A, c], axis=1).transpose(0, 2, 1) * weights[:, None, None]
    free = jackknife(every, torque * weights[:, None])
    prior = np.column_stack([pull, np.zeros((len(pull), c.shape[1])), pulled_to])
    whole, *others = (
        triangle(np.asfortranarray(np.vstack([F, prior])))
        for F in (free.whole, *free.others)
    )
    return Jackknife(whole, tuple(others)).without(A.shape[1])


def _rows(
    model: TorqueModel, logs: Sequence[Recording]
) -> tuple[list["_Rows"], Array, Matrix]:
    """Return the rows of each log, and the columns and torque of all."""
    rows = [_Rows.of(model, log) for log in logs]
    A = np.concatenate([r.columns for r in rows], axis=2)
    return rows, A, np.concatenate([r.torque for r in rows], axis=1)


def _size(torque: Matrix) -> Vector:
    """Return the root mean square of each joint's torque."""
    return np.asarray(np.maximum(np.sqrt(np.mean(torque**2, axis=1)), 1e-300))


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Rows of one log, filtered like its torque.

    Parameters
    ----------
    log : SampleRows
    columns : ndarray, shape (torque joints, columns, samples)
        The model's, then rotor inertias and friction that it may lack.
    at_rest : ndarray, shape (torque joints, inertial, samples)
        Inertial columns without motion.
    torque : ndarray, shape (torque joints, samples)
    """

    log: SampleRows
    columns: Array
    at_rest: Array
    torque: Matrix

    @classmethod
    def of(cls, model: TorqueModel, log: Recording) -> "_Rows":
        rows = SampleRows.of(model, log)
        rotors = rows.filtered(rows.change[:, None])
        own = np.concatenate([rotors, rows.frictions(rows.smooth_torque())], axis=1)
        columns = np.concatenate([rows.regressor(), of_own_row(own)], axis=1)
        rest = rows.at_rest.regressor()[:, : model.layout.inertial_size]
        return cls(rows, columns, rest, rows.torque)

    def slopes(self, x: Vector, factors: Sequence[Factor]) -> Array:
        """Return what a unit of each factor adds, (torque joints, factors, samples).

        Torque is changed by a clock ``exp(f)`` times too slow, by a gain ``exp(f)``, by
        positions that are ``f`` too small, by gravity that leans.
        """
        layout = self.log.model.layout
        inertial = layout.inertial_size
        bodies = np.zeros(len(layout))
        bodies[:inertial] = x[:inertial]
        moving = self.columns[:, :inertial] - self.at_rest
        moved = [f.joint for f in factors if f.kind == "offset zero"]
        zeros = np.zeros((0, 0, 0))
        if moved:
            zeros = self.log.slopes_by_position(bodies, moved)
        found = []
        for factor in factors:
            if factor.kind == "clock":
                part = 2.0 * np.einsum("jps,p->js", moving, x[:inertial])
            elif factor.kind == "masses or gain":
                part = np.einsum("jps,p->js", self.columns, x)
            elif factor.kind == "offset zero":
                part = zeros[:, moved.index(factor.joint)]
            else:
                part = _by_gravity(self.log.at_rest, bodies, factor.axis)
            found.append(part)
        return np.stack(found, axis=1)


def _by_gravity(rows: SampleRows, bodies: Vector, axis: Sequence[float]) -> Matrix:
    """Return the slope of the torque over the angle by which the base leans."""
    ahead, behind = (
        replace(rows, model=leaning(rows.model, axis, step)).predicted(bodies)
        for step in (_STEP, -_STEP)
    )
    return np.asarray((ahead - behind) / (2.0 * _STEP))


def _pull(state: FactorLogs, columns: int) -> tuple[Matrix, Vector]:
    """Return the rows and values that pull bodies to nominal ones."""
    robot = state.model.robot
    scales = link_scales(robot)
    m, d = scales.mass, scales.length
    mass, centre, moment = state.widths
    width = np.column_stack([mass * m, *[centre * m * d] * 3, *[moment * m * d**2] * 6])
    if state.loaded:
        last = {link.name for link in last_links(robot)}
        width[[link.name in last for link in robot.links]] = np.inf
    rows = np.zeros((width.size, columns))
    rows[:, : width.size] = np.diag(1.0 / width.ravel())
    return rows, (reference_bodies(robot) / width).ravel()


def relative_noise(model: TorqueModel, logs: Sequence[Recording]) -> Vector:
    """Return each joint's noise over its torque, as if samples were independent.

    It is the residual of least squares times the root of the number of samples over
    which it is correlated.
    """
    rest, size = _residual(model, logs)
    ends = np.cumsum([len(log) for log in logs])[:-1]
    lengths = correlation_lengths(np.split(rest.T, ends))
    sigma = np.maximum(_size(rest), _EXACT * size)
    return np.asarray(sigma / size * np.sqrt(lengths))


def least_misfit(state: FactorLogs) -> float:
    """Return the residual of least squares over the torque, joints counting alike."""
    rest, size = _residual(state.model, state.logs)
    return float(np.sqrt(np.mean((_size(rest) / size) ** 2)))


def _residual(model: TorqueModel, logs: Sequence[Recording]) -> tuple[Matrix, Vector]:
    """Return the residual of least squares, and the size of each joint's torque.

    Joints are weighted by their residuals in turn.
    """
    _, A, torque = _rows(model, logs)
    size = _size(torque)
    sigma, rest = size, torque
    empty = np.zeros((0, A.shape[1])), np.zeros(0)
    for _ in range(3):
        x = _solution(A, torque, 1.0 / sigma, *empty)
        rest = torque - np.einsum("jps,p->js", A, x)
        sigma = np.maximum(_size(rest), _EXACT * size)
    return rest, size


def _solution(
    A: Array, torque: Matrix, weights: Vector, pull: Matrix, nominal: Vector
) -> Vector:
    rows = [
        np.column_stack([Y.T, tau]) * w
        for Y, tau, w in zip(A, torque, weights, strict=True)
    ]
    R = triangle(
        np.asfortranarray(np.vstack([*rows, np.column_stack([pull, nominal])]))
    )
    return smallest_solution(R[:, :-1], R[:, -1], _RANK)
