"""Errors of rollouts, and their derivatives with respect to parameters.

Derivatives are finite differences.  Limbs of a robot whose base is fixed do not affect
each other, so one rollout serves one parameter of each.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector
from consistent_id._support.executors import worker_threads
from consistent_id.estimation.estimate import Estimate
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.rollout.commanded_motion import replay, replayable
from consistent_id.rollout.replay_model import SEARCH_STEP, replay_model

_CHANGE = 0.02
"""Torque of a finite difference over a joint's torque (both root mean square): small
enough to be linear, and large compared with stiction.
"""

_WORKERS = 2

_DERIVATIVE_STEP = 5e-3
"""Longest time step [s] of rollouts whose differences are derivatives: its error is in
both.
"""

_UNSEEN = 1e-9
"""Torque per parameter over the largest of all: below this it is rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class RolloutErrors:
    """Errors of replays, and their derivatives.

    Parameters
    ----------
    errors : ndarray, shape (joints, samples)
        Errors of position, all logs one after another, [rad or m].
    by_parameter : ndarray, shape (joints, samples, parameters)
    """

    errors: Matrix
    by_parameter: Array


@dataclass(frozen=True, slots=True, eq=False)
class Replays:
    """The replays of logs, for any parameters.

    Parameters
    ----------
    estimate : Estimate
        The estimate whose model it is.
    logs : tuple of Recording
        See `replayable`.
    step : float, [s]
        The longest time step.
    """

    estimate: Estimate
    logs: tuple[Recording, ...]
    gains: PDGains
    step: float = SEARCH_STEP
    _last: dict[tuple[bytes, float], Matrix] = field(default_factory=dict)

    @staticmethod
    def of(
        estimate: Estimate,
        logs: Sequence[Recording],
        gains: PDGains,
        step: float = SEARCH_STEP,
    ) -> "Replays":
        """Return the replays of logs as they were logged."""
        joints = estimate.model.robot.joint_names
        known = tuple(replayable(log.of(joints)) for log in logs)
        return Replays(estimate, known, gains, step)

    def errors(self, x: Vector, delay: float, step: float | None = None) -> Matrix:
        """Return errors of position, shape (joints, samples).

        The last ones are remembered: a point that a step of the refinement reaches is
        the next one's start.

        Parameters
        ----------
        step : float, optional, [s]
            Another longest time step.
        """
        step, key = self.step if step is None else step, (x.tobytes(), delay)
        if step == self.step and key in self._last:
            return self._last[key]
        period = min(1.0 / log.rate for log in self.logs)
        model = replay_model(
            replace(self.estimate, parameters=x),
            self.estimate.model.robot.joint_names,
            self.gains,
            period=period,
            step=step,
        )
        done = [replay(model, log, delay=delay).errors for log in self.logs]
        errors = np.asarray(np.vstack(done).T)
        if step == self.step:
            self._last.clear()
            self._last[key] = errors
        return errors

    def linearised(
        self, x: Vector, delay: float, free: IntArray, changes: Vector
    ) -> RolloutErrors:
        """Return errors and their derivatives with respect to `free` parameters.

        `changes` are the steps of the finite differences, one for each parameter.
        """
        coarse = self.errors(x, delay, _DERIVATIVE_STEP)
        by_parameter = np.zeros((*coarse.shape, len(x)))
        branches = _branches(self.estimate.model)
        groups = list(_side_by_side(self.estimate.model, branches, free))

        def changed(group: Sequence[int]) -> Matrix:
            moved = x.copy()
            moved[list(group)] += changes[list(group)]
            return self.errors(moved, delay, _DERIVATIVE_STEP)

        with worker_threads(_WORKERS) as pool:
            moved = list(pool.map(changed, groups))
        for group, errors in zip(groups, moved, strict=True):
            for i in group:
                rows = branches == _branch_of(self.estimate.model, branches, i)
                by_parameter[rows, :, i] = (errors - coarse)[rows] / changes[i]
        return RolloutErrors(self.errors(x, delay), by_parameter)


def finite_changes(regression: Regression) -> Vector:
    """Return a step of each parameter that changes torque by a small share.

    It is infinite where torque does not depend on the parameter.
    """
    size = np.zeros(len(regression.layout))
    for factor, count, rms in zip(
        regression.factors, regression.counts, regression.torque_rms, strict=True
    ):
        columns = np.linalg.norm(factor[:, :-1], axis=0) / np.sqrt(count)
        size = np.maximum(size, columns / rms)
    seen = size > _UNSEEN * size.max()
    changes = np.full(len(size), np.inf)
    changes[seen] = _CHANGE / size[seen]
    return changes


def _branches(model: TorqueModel) -> IntArray:
    """Return, for each moving joint, the joint next to the base that carries it."""
    robot = model.robot
    roots: list[int] = []
    for place, joint in enumerate(robot.joints):
        roots.append(place if joint.parent < 0 else roots[joint.parent])
    names = [joint.name for joint in robot.joints]
    root_of = dict(zip(names, roots, strict=True))
    found = np.array([root_of[name] for name in robot.joint_names])
    coupled = model.couplings or len(robot) < len(robot.joints)
    return np.zeros_like(found) if coupled else found


def _branch_of(model: TorqueModel, branches: IntArray, parameter: int) -> int:
    layout, robot = model.layout, model.robot
    if parameter < layout.inertial_size:
        link = layout.links[parameter // 10]
        joint = [k.name for k in robot.links].index(link)
        names = list(robot.joint_names)
        name = robot.joints[joint].name
        return int(branches[names.index(name)]) if name in names else int(branches[0])
    owner, _ = layout.drive[parameter - layout.inertial_size]
    names = list(robot.joint_names)
    return int(branches[names.index(owner)]) if owner in names else int(branches[0])


def _side_by_side(
    model: TorqueModel, branches: IntArray, free: IntArray
) -> Iterator[list[int]]:
    """Yield parameters to be changed together: one of each branch."""
    by_branch: dict[int, list[int]] = {}
    for i in free.tolist():
        by_branch.setdefault(_branch_of(model, branches, i), []).append(i)
    longest = max((len(found) for found in by_branch.values()), default=0)
    for k in range(longest):
        yield [found[k] for found in by_branch.values() if k < len(found)]
