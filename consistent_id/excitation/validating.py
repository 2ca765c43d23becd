"""A validation motion that has no frequency in common with the training motion.

Its frequencies lie half-way between those of the design.  It is the best conditioned of
some random paths, and proven to keep all limits.
"""

from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.brief import brief
from consistent_id._support.executors import single_threaded
from consistent_id.errors import InfeasibleError
from consistent_id.excitation.accuracy import predicted_accuracy
from consistent_id.excitation.basis import FourierBasis, limit_rows
from consistent_id.excitation.designed import ExcitationDesign
from consistent_id.excitation.search_problem import clear_start
from consistent_id.excitation.verification import PathProof
from consistent_id.recordings.joint_paths import FourierTrajectory

_REACH = 0.95  # share of the limits that a path may use
_SWINGS = (1.0, 0.85, 0.65, 0.4, 0.2)  # shares of its amplitude, tried in this order
_AMONG_BODIES = 6  # random paths to choose from in a scene, where each takes long
_GRID = 8  # samples per period of the highest frequency, at which guards measure


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ValidationPath:
    """A motion to validate estimates on.

    Parameters
    ----------
    trajectory : FourierTrajectory
    proof : PathProof
        Proof of the same limits as the design's.
    likeness : ndarray, shape (joints,)
        Correlation of each joint's velocity with the design's, over its duration.
    """

    trajectory: FourierTrajectory
    proof: PathProof
    likeness: Vector


@single_threaded
def validation_trajectory(
    design: ExcitationDesign, *, seed: int = 0, candidates: int = 24
) -> ValidationPath:
    """Return the best conditioned of some random paths that share no frequency.

    Parameters
    ----------
    design : ExcitationDesign
    seed : int
    candidates : int
        Random paths to choose from; in a scene at most six.

    Raises
    ------
    InfeasibleError
        If none of them is proven to keep the limits, even at a fifth of them.
    """
    form = replace(design.form, between=not design.form.between)
    basis = FourierBasis(
        design.limits, form.frequencies, form.duration, form.rest, form.smooth
    )
    shape = (basis.size, len(basis.unit))
    rows = limit_rows(basis, basis.trajectory(np.zeros(shape)).period)
    rng = np.random.default_rng(seed)
    drawn = [rng.normal(size=shape) for _ in range(candidates)]
    for variables in drawn:
        variables[0] = rng.uniform(-0.3, 0.3, shape[1])
    guards = design.demands.guards
    count = int(np.ceil(_GRID * form.frequencies[-1] * form.duration))
    time = np.linspace(0.0, form.duration, count + 1)
    if any(guard.keeps_apart for guard in guards):
        drawn = drawn[:_AMONG_BODIES]
    drawn = [
        clear_start(v * (_REACH / rows.largest(v)), basis, rows, guards, time, rng)
        for v in drawn
    ]
    for share in _SWINGS:
        paths = [basis.trajectory(np.vstack([v[:1], share * v[1:]])) for v in drawn]
        conditions = [
            predicted_accuracy(
                design.measured, design.base, path, design.aim
            ).condition.value
            for path in paths
        ]
        for i in np.argsort(conditions, kind="stable"):
            proof = design.demands.proof(paths[i])
            if proof.holds:
                likeness = _likeness(paths[i], design.trajectory)
                return ValidationPath(paths[i], proof, likeness)
    raise InfeasibleError(
        f"none of {len(drawn)} random paths, even at a fifth of the limits, is proven "
        "to keep them all; widen the limits"
    )


def _likeness(one: FourierTrajectory, other: FourierTrajectory) -> Vector:
    duration = min(one.duration, other.duration)
    time = np.linspace(0.0, duration, 2001)
    a, b = (path.evaluate(path.start + time, 1)[1] for path in (one, other))
    return np.asarray(
        (a * b).sum(axis=0) / np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0))
    )
