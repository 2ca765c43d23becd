"""Logs beside nominal bodies, and how factors of a whole robot change them.

Nominal bodies are rows beside those of the logs, weighted by their usual errors.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.singular import lstsq
from consistent_id.diagnosis.channel_factors import joint_factor
from consistent_id.diagnosis.factor_rows import (
    ALL_GAINS,
    ONE_GAIN,
    RANK,
    Factor,
    FactorRows,
    Limb,
    relative_noise,
    residual_of,
    torque_sizes,
)
from consistent_id.diagnosis.linearise import SEGMENTS, Jackknife, jackknife
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.regression.linear import column_sizes, smallest_solution
from consistent_id.regression.regression import triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.chains import last_links
from consistent_id.robot.scaling import (
    USUAL_WIDTHS,
    body_sizes,
    link_scales,
    reference_bodies,
)

LEAN = float(np.radians(2.0))
"""Least angle of a leaning base that is reported.

Of clean logs, no lean of 0.5 degrees or more is 1.6 standard errors large.
"""

HARM = 0.10
"""Error of an estimate, over the torque of all joints, that is harmful."""

_LEAST_GAIN = float(np.log(1.2))
_LOADED = 0.3  # least torque of bodies over a joint's, for its gain to be tested
_FREE_MASS = 0.3  # where masses are free to differ from the model's


@dataclass(frozen=True, slots=True, eq=False)
class FactorLogs:
    """Logs, perhaps with a factor removed, and the model that belongs to them.

    Parameters
    ----------
    rows : FactorRows
    widths : ndarray, shape (3,)
        Relative errors of nominal masses, centres of mass and second moments.
    noise : ndarray, shape (torque joints,)
        Noise of the unchanged logs, relative to the torque; see `relative_noise`.
    loaded : bool
        Whether the bodies of links that carry no other link are free.
    """

    rows: FactorRows
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
        rows = FactorRows(model, logs)
        return cls(rows, widths, relative_noise(rows))

    @property
    def model(self) -> TorqueModel:
        """The model that belongs to the logs."""
        return self.rows.model

    @property
    def logs(self) -> Sequence[Recording]:
        """The logs."""
        return self.rows.logs

    def without(self, factor: Factor, size: float) -> "FactorLogs":
        """Return the logs without a factor."""
        model, logs = self.model, self.logs
        if size == 0.0:
            return self
        if factor.kind == "gravity":
            model = leaning(model, factor.axis, size)
        else:
            logs = [
                altered(log, lambda raw: _without(raw, factor, size)) for log in logs
            ]
        rows = FactorRows(model, logs, loads=self.rows.loads)
        return replace(self, rows=rows)


def _without(log: Recording, factor: Factor, size: float) -> Recording:
    if factor.kind == "clock":
        speed = np.exp(size)
        velocity, acceleration = np.asarray(log.velocity), np.asarray(log.acceleration)
        return replace(
            log, velocity=speed * velocity, acceleration=speed**2 * acceleration
        )
    if factor.kind == ALL_GAINS:
        return replace(log, torque=np.asarray(log.torque) * np.exp(-size))
    own = np.arange(log.position.shape[1]) == factor.joint
    if factor.kind == ONE_GAIN:
        return replace(log, torque=np.asarray(log.torque) * np.exp(-size * own))
    zeros = size * own
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
        Factor(ALL_GAINS, "all joints", _LEAST_GAIN),
    ]
    for k, joint in enumerate(joints):
        least = 0.05 if joint.kind == "prismatic" else float(np.radians(6.0))
        found.append(Factor("offset zero", joint.name, least, joint=k))
    gravity = np.asarray(model.robot.gravity)
    if gravity.any():
        level = np.linalg.svd(gravity[None])[2][1:]
        found += [Factor("gravity", "base", LEAN, axis=tuple(k)) for k in level]
    return found


def joint_gains(model: TorqueModel) -> list[Factor]:
    """Return the gain of each joint's torque, if there are several joints."""
    joints = model.torque_joints
    return [gain_of(model, joint) for joint in joints] if len(joints) > 1 else []


def gain_of(model: TorqueModel, joint: str) -> Factor:
    """Return the factor of one joint's gain."""
    place = model.robot.joint_names.index(joint)
    return Factor(ONE_GAIN, joint, _LEAST_GAIN, joint=place)


@dataclass(frozen=True, slots=True, eq=False)
class FactorSystem(Jackknife):
    """Rows of factors, with bodies and drives eliminated.

    Parameters
    ----------
    pulled : ndarray, shape (columns,)
        Squared norm of the part of each column that is in rows of nominal bodies; the
        rest is in the data's.
    """

    pulled: Vector


def told_gains(state: FactorLogs) -> list[Factor]:
    """Return the gains of the joints that bodies load: friction tells of no gain."""
    size, x = state.model.layout.inertial_size, solution_of(state)
    bodies = state.rows.torque_of(x, slice(size))
    torque = np.linalg.norm(state.rows.torque, axis=1)
    loaded = np.linalg.norm(bodies, axis=1) >= _LOADED * torque
    return [f for j, f in enumerate(joint_gains(state.model)) if loaded[j]]


def drives_share(state: FactorLogs) -> float:
    """Return the torque of the drives over that of all joints."""
    first, x = state.model.layout.inertial_size, solution_of(state)
    drives = state.rows.torque_of(x, slice(first, None))
    return float(np.linalg.norm(drives) / np.linalg.norm(state.rows.torque))


def factor_system(
    state: FactorLogs,
    factors: Sequence[Factor],
    *,
    nominal: bool = True,
    scatter: bool = True,
) -> FactorSystem:
    """Return rows of the factors, with bodies and drives eliminated.

    Without `nominal`, there are no rows of nominal bodies; without `scatter`, no
    segments are left out.  The last column, after those of the factors, is that of a
    gain with nominal bodies: an instrument.
    """
    joints, samples = state.rows.torque.shape
    c = np.zeros((joints, 0, samples))
    if factors:
        x = solution_of(state)
        slopes = [rows.slopes(x, factors) for rows in state.rows.each]
        c = np.concatenate(slopes, axis=2)
    if any(f.kind == ALL_GAINS for f in factors):
        bodies = reference_bodies(state.model.robot).ravel()
        drawn = state.rows.torque_of(bodies)
        c = np.concatenate([c, drawn[:, None]], axis=1)
    return eliminated(state, c, nominal=nominal, scatter=scatter)


def eliminated(
    state: FactorLogs, c: Array, *, nominal: bool, scatter: bool
) -> FactorSystem:
    """Return rows of further columns, with bodies and drives eliminated.

    Parameters
    ----------
    c : ndarray, shape (torque joints, further columns, samples)
    """
    torque, groups, width = state.rows.torque, state.rows.groups, state.rows.width
    weights = 1.0 / (state.noise * torque_sizes(torque))
    pull, pulled_to = _pull(state, width)
    if not nominal:
        pull, pulled_to = pull[:0], pulled_to[:0]
    prior = np.column_stack([pull, np.zeros((len(pull), c.shape[1])), pulled_to])
    systems, squares, pulled = [], np.zeros(c.shape[1] + 1), np.zeros(c.shape[1])
    for group in groups:
        rows = np.concatenate([state.rows.of_group(group), c[group.joints]], axis=1)
        w = weights[group.joints, None]
        own = _of_group(prior, group, width)
        whole, *others = (
            triangle(np.asfortranarray(np.vstack([F, own])))
            for F in _free(rows * w[:, :, None], torque[group.joints] * w, scatter)
        )
        count = len(group.columns)
        squares += np.sum(whole[:, count:] ** 2, axis=0)
        pulled += _pulled(whole, own, count)
        systems.append(Jackknife(whole, tuple(others)).eliminated(count))
    found = reduce(add, systems).cleared(np.sqrt(squares))
    return FactorSystem(found.whole, found.others, pulled)


def _free(A: Array, torque: Matrix, scatter: bool) -> Iterator[Matrix]:
    """Yield a factor of all rows, and with `scatter` of all segments but each."""
    if scatter:
        free = jackknife(A.transpose(0, 2, 1), torque, segments=SEGMENTS)
        yield from (free.whole, *free.others)
        return
    # Most columns belong to one joint.
    pairs = zip(A, torque[:, :, None], strict=True)
    yield np.vstack([joint_factor(own, tau) for own, tau in pairs])


def _pulled(whole: Matrix, own: Matrix, count: int) -> Vector:
    """Return the rows of nominal bodies for each factor, bodies eliminated.

    Parameters
    ----------
    whole : ndarray
        Triangular factor of all rows; its first `count` columns are bodies and drives.
    own : ndarray
        Rows of nominal bodies.
    """
    A = whole[:count, :count]
    sizes = column_sizes(A)
    moved = lstsq(A / sizes, whole[:count, count:-1], RANK)
    return np.asarray(np.sum((own[:, :count] / sizes @ moved) ** 2, axis=0))


def _pull(state: FactorLogs, columns: int) -> tuple[Matrix, Vector]:
    """Return the rows and values that pull bodies to nominal ones."""
    robot = state.model.robot
    m, d = link_scales(robot).mass, body_sizes(robot)
    mass, centre, moment = state.widths
    width = np.column_stack([mass * m, *[centre * m * d] * 3, *[moment * m * d**2] * 6])
    if state.loaded:
        last = {link.name for link in last_links(robot)}
        width[[link.name in last for link in robot.links]] = np.inf
    rows = np.zeros((width.size, columns))
    rows[:, : width.size] = np.diag(1.0 / width.ravel())
    return rows, (reference_bodies(robot) / width).ravel()


def least_costs(state: FactorLogs) -> tuple[float, float]:
    """Return the least sums of squares with nominal bodies, and without them.

    They are those of the torque and of the bodies' distance.
    """
    prior, found = _prior(state), np.zeros(2)
    for group, free in zip(state.rows.groups, _weighted(state), strict=True):
        own, count = _of_group(prior, group, prior.shape[1] - 1), len(group.columns)
        for k, rows in enumerate((np.vstack([free, own]), free)):
            whole = triangle(np.asfortranarray(rows))
            z = Jackknife(whole, ()).without(count).whole[:, -1]
            found[k] += z @ z
    return float(found[0]), float(found[1])


def least_misfit(state: FactorLogs) -> float:
    """Return the residual of least squares over the torque, joints weighted alike."""
    rest, size = residual_of(state.rows)
    return float(np.sqrt(np.mean((torque_sizes(rest) / size) ** 2)))


def solution_of(state: FactorLogs) -> Vector:
    """Return the parameters of logs beside the nominal bodies."""
    prior = _prior(state)
    x, pull = np.zeros(prior.shape[1] - 1), np.diag(prior)
    # Parameters that no data show take their nominal values.
    x[: len(pull)] = prior[:, -1] / np.where(pull > 0.0, pull, np.inf)
    for group, free in zip(state.rows.groups, _weighted(state), strict=True):
        rows = [free, _of_group(prior, group, len(x))]
        R = triangle(np.asfortranarray(np.vstack(rows)))
        x[group.columns] = smallest_solution(R[:, :-1], R[:, -1], RANK)
    return x


def _prior(state: FactorLogs) -> Matrix:
    """Return the rows and values that pull bodies to nominal ones, in one matrix."""
    return np.column_stack(_pull(state, state.rows.width))


def _weighted(state: FactorLogs) -> list[Matrix]:
    """Return rows of each group with the same least squares as its weighted rows."""
    rows = state.rows
    weights = 1.0 / (state.noise * torque_sizes(rows.torque))
    return [
        np.vstack([F * weights[j] for F, j in zip(factors, g.joints, strict=True)])
        for g, factors in zip(rows.groups, rows.factors, strict=True)
    ]


def _of_group(prior: Matrix, group: Limb, width: int) -> Matrix:
    """Return the rows that pull a group's bodies.

    `width` is the number of columns of all groups; others follow them.
    """
    rows = group.columns[group.columns < len(prior)]
    beyond = np.arange(width, prior.shape[1])
    found: Matrix = prior[np.ix_(rows, np.concatenate([group.columns, beyond]))]
    return found
