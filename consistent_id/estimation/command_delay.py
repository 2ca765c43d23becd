"""How late commands reach the drives of PD-controlled joints.

The torque of commands depends on the delay, not linearly; all else in the fit is
linear.  So the delay is scanned, and for each delay the other parameters are solved for
(variable projection): the least misfit over them is a function of the delay alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector, freeze_arrays
from consistent_id._support.tables import Table
from consistent_id.constraints import Constraint
from consistent_id.estimation.equalities import FreeParameters
from consistent_id.recordings.recording import Recording
from consistent_id.regression.noise import joint_noise
from consistent_id.regression.regression import build_regression
from consistent_id.regression.regressor import TorqueModel

LONGEST = 0.03
"""Longest delay that is looked for [s]: six periods of a bus of 200 Hz, and more than
drives that are of use in a loop have."""

_STEPS = 6  # of the scan; the misfit is smooth, as commands are filtered like torque
_HALVINGS = 3  # of the step around the least, each with two more delays


@dataclass(frozen=True, slots=True, eq=False)
class CommandDelay:
    """A delay of commands, and how sure it is.

    Parameters
    ----------
    seconds : float, [s]
        Not below zero.
    standard_error : float, [s]
        From the bend of the misfit, with as many samples as noise that is correlated
        leaves; infinite where the misfit does not bend.
    tried : array_like, shape (delays,), [s]
    misfits : array_like, shape (delays,)
        Least weighted squared misfit at each of them, over the least of all.
    """

    seconds: float
    standard_error: float
    tried: Vector
    misfits: Vector

    def __post_init__(self) -> None:
        shapes = {"tried": (None,), "misfits": (None,)}
        freeze_arrays(self, shapes, "delay of commands")

    def table(self) -> Table:
        """Return the delay and the misfit at those that were tried, for people."""
        order = np.argsort(self.tried)
        return Table(
            f"Commands are late by {1e3 * self.seconds:.2f} +- "
            f"{1e3 * self.standard_error:.2f} ms",
            ("delay [ms]", "misfit over the least"),
            tuple(
                (f"{1e3 * self.tried[i]:.3g}", f"{self.misfits[i]:.4f}") for i in order
            ),
            ("the interval is 1 standard error, of this model of friction",),
        )


def command_delay(
    model: TorqueModel,
    recordings: Callable[[float], Sequence[Recording]],
    *,
    constraints: Sequence[Constraint] = (),
    longest: float = LONGEST,
) -> CommandDelay:
    """Find how late commands reach the drives.

    Parameters
    ----------
    model : TorqueModel
    recordings : callable
        From a delay [s] to prepared recordings with the torque that commands of that
        delay make; see `commanded`.
    constraints : sequence of Constraint
        Of these the equalities count, such as known bodies and equal motors.
    longest : float, [s]

    Raises
    ------
    RecordingError
        If the recordings cannot be used.
    """
    first = build_regression(model, recordings(0.0))
    sigma = joint_noise(model, first)
    effective = float(first.effective.sum())
    free = FreeParameters.of(constraints, model)
    found = {0.0: free.misfit(first.weighted(sigma))}

    def misfit(delay: float) -> float:
        if delay not in found:
            regression = build_regression(model, recordings(delay))
            found[delay] = free.misfit(regression.weighted(sigma))
        return found[delay]

    step = longest / _STEPS
    for delay in np.arange(1, _STEPS + 1) * step:
        misfit(float(delay))
    best = min(found, key=misfit)
    for _ in range(_HALVINGS):
        step /= 2.0
        near = [d for d in (best - step, best + step) if 0.0 <= d <= longest]
        best = min((best, *near), key=misfit)
    seconds, bend = _parabola(best, step, misfit)
    least = min(found.values())
    # The misfit over its noise is a chi-square in as many samples as are independent.
    curvature = bend / least * effective
    tried = np.array(list(found))
    return CommandDelay(
        seconds=min(max(seconds, 0.0), longest),
        standard_error=float(np.sqrt(2.0 / curvature)) if curvature > 0.0 else np.inf,
        tried=tried,
        misfits=np.array(list(found.values())) / least,
    )


def _parabola(
    best: float, step: float, misfit: Callable[[float], float]
) -> tuple[float, float]:
    """Return the lowest point, and the second derivative, of a parabola near a delay.

    Through the best delay and its neighbours; at zero through those after it.
    """
    middle = max(best, step)
    low, centre, high = (misfit(middle + k * step) for k in (-1, 0, 1))
    bend = (low - 2.0 * centre + high) / step**2
    slope = (high - low) / (2.0 * step)
    return (middle - slope / bend, bend) if bend > 0.0 else (best, bend)
