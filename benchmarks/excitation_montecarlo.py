"""Does it pay?  Least squares on simulated recordings of different motions.

Motions of equal length, equal sampling and equal noise; many draws of the noise; the
scatter of the base parameters, and of the torque they predict on another motion.
"""

from dataclasses import dataclass

import numpy as np
from excitation_cases import RATE, Case

import consistent_id as ci
from consistent_id import signals
from consistent_id.excitation.accuracy import path_regressor
from consistent_id.recordings.joint_paths import JointPath

DRAWS = 500


@dataclass(frozen=True)
class Scatter:
    """What noise made of an identification.

    Parameters
    ----------
    errors : ndarray, shape (base parameters,)
        Standard deviation of each, in its own unit.
    torque : float, [N m]
        Root mean square error of predicted torque on the held-out motion.
    """

    errors: np.ndarray
    torque: float


def scatter(
    case: Case,
    motion: JointPath | ci.Recording,
    held_out: JointPath | ci.Recording,
    noise: np.ndarray,
    seed: int = 0,
) -> Scatter:
    """Identify a robot from many noisy recordings of one motion.

    Weighted least squares is linear in the noise, so that the true parameters do not
    matter: estimates are those and ``pinv(W) noise``.
    """
    rng = np.random.default_rng(seed)
    W = regressor(case, motion) / noise[:, None, None]
    rows = W.reshape(-1, W.shape[2])
    errors = np.linalg.pinv(rows) @ rng.normal(size=(len(rows), DRAWS))
    V = regressor(case, held_out).reshape(-1, W.shape[2])
    return Scatter(errors.std(axis=1), float(np.sqrt(np.mean((V @ errors) ** 2))))


def regressor(case: Case, motion: JointPath | ci.Recording) -> np.ndarray:
    """Return the base regressor at 100 Hz, (joints, samples, base)."""
    base = ci.regression.base_parameters(case.model)
    if not isinstance(motion, ci.Recording):
        return path_regressor(case.model, base, motion, RATE)
    step = round((len(motion) - 1) / motion.duration / RATE)
    motion = signals.decimated(motion, step) if step > 1 else motion
    Y = case.model.regressor(motion.position, motion.velocity, motion.acceleration)
    return Y[:, list(base.independent)].transpose(0, 2, 1)


def row(name: str, condition: float, mine: Scatter, reference: list[Scatter]) -> str:
    """Return a line of the table, relative to the median of the random paths."""
    errors = np.median([one.errors for one in reference], axis=0)
    torque = float(np.median([one.torque for one in reference]))
    ratio = mine.errors / errors
    return (
        f"| {name} | {condition:.4g} | {np.exp(np.log(ratio).mean()):.2f} "
        f"| {np.sqrt((ratio**2).mean()):.2f} | {ratio.max():.2f} "
        f"| {mine.torque:.3g} | {mine.torque / torque:.2f} |"
    )


HEADER = (
    "| motion | condition number | standard error, geometric mean | RMS | largest "
    "| held-out torque [N m] | the same, relative |\n|---|" + "---:|" * 6
)
