"""How a model's motion under commands depends on its parameters.

By finite differences of rollouts.  Branches that a held base carries do not feel each
other, so a parameter of each is changed in one rollout.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector
from consistent_id._support.threads import worker_threads
from consistent_id.constraints import Constraint, lowered
from consistent_id.estimation.estimate import Estimate
from consistent_id.laboratory.rollout.replay import replay
from consistent_id.laboratory.rollout.replay_model import replay_model
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel

_CHANGE = 0.02
"""Torque of a finite difference over a joint's torque (both root mean square): small
enough for a straight line, and large beside where friction makes joints stick."""

_WORKERS = 2


@dataclass(frozen=True, slots=True, eq=False)
class RolloutErrors:
    """Errors of replays, and their derivatives.

    Parameters
    ----------
    errors : ndarray, shape (joints, samples)
        Of position, all logs one after another, [rad or m].
    by_parameter : ndarray, shape (joints, samples, parameters)
    """

    errors: Matrix
    by_parameter: Array


@dataclass(frozen=True, slots=True, eq=False)
class Replays:
    """What is replayed, for any parameters.

    Parameters
    ----------
    estimate : Estimate
        Whose model it is.
    logs : tuple of Recording
        See `replayable`.
    """

    estimate: Estimate
    logs: tuple[Recording, ...]
    gains: PDGains

    def errors(self, x: Vector, delay: float) -> Matrix:
        """Return errors of position, shape (joints, samples)."""
        period = min(1.0 / log.rate for log in self.logs)
        model = replay_model(
            replace(self.estimate, parameters=x),
            self.estimate.model.robot.joint_names,
            self.gains,
            period=period,
        )
        done = [replay(model, log, delay=delay).errors for log in self.logs]
        return np.asarray(np.vstack(done).T)

    def linearised(
        self, x: Vector, delay: float, free: IntArray, changes: Vector
    ) -> RolloutErrors:
        """Return errors and their derivatives with respect to `free` parameters.

        `changes` are the steps of the finite differences, one for each parameter.
        """
        first = self.errors(x, delay)
        by_parameter = np.zeros((*first.shape, len(x)))
        branches = _branches(self.estimate.model)
        groups = list(_side_by_side(self.estimate.model, branches, free))

        def changed(group: Sequence[int]) -> Matrix:
            moved = x.copy()
            moved[list(group)] += changes[list(group)]
            return self.errors(moved, delay)

        with worker_threads(_WORKERS) as pool:
            moved = list(pool.map(changed, groups))
        for group, errors in zip(groups, moved, strict=True):
            for i in group:
                rows = branches == _branch_of(self.estimate.model, branches, i)
                by_parameter[rows, :, i] = (errors - first)[rows] / changes[i]
        return RolloutErrors(first, by_parameter)


def free_parameters(model: TorqueModel, constraints: Sequence[Constraint]) -> IntArray:
    """Return the parameters that the equalities do not fix."""
    known = lowered(constraints, model)
    if not len(known.A_eq):
        return np.arange(len(model.layout))
    A = known.A_eq / np.linalg.norm(known.A_eq, axis=1, keepdims=True)
    _, s, Vt = np.linalg.svd(A)
    rank = int((s > 1e-12 * s[0]).sum())
    return np.flatnonzero(np.linalg.norm(Vt[rank:], axis=0) > 1e-9)


def finite_changes(regression: Regression) -> Vector:
    """Return a step of each parameter that changes torque by a small share."""
    size = np.zeros(len(regression.layout))
    for factor, count, rms in zip(
        regression.factors, regression.counts, regression.torque_rms, strict=True
    ):
        columns = np.linalg.norm(factor[:, :-1], axis=0) / np.sqrt(count)
        size = np.maximum(size, columns / rms)
    seen = size > 0.0
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
