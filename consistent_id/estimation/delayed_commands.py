"""The delay of commands to drives, found by a scan.

The least misfit over the parameters of the fit is a function of it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import (
    Vector,
    freeze_arrays,
)
from consistent_id._support.tables import Table, brief
from consistent_id.constraints import Constraint
from consistent_id.estimation.determination import FreeParameters
from consistent_id.estimation.drive_calibration import LATER
from consistent_id.recordings.recording import Recording
from consistent_id.regression.correlated_noise import SHOWN, spectral_errors
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regression import build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import joint_noise

LONGEST = 0.03
"""Longest delay that is tried [s]: six periods of a bus of 200 Hz, more than drives in
a usable control loop have.
"""

_SCANNED = 6  # steps; the misfit is smooth, as commands are filtered like torque
_HALVINGS = 3  # of the step around the least, each with two more delays


@brief
@dataclass(frozen=True, slots=True, eq=False)
class CommandDelay:
    """A delay of commands, and its standard error.

    Parameters
    ----------
    seconds : float, [s]
        Not below zero.
    standard_error : float, [s]
        For noise as correlated as the residuals, at the frequencies of the delay's
        effect on the torque; infinite without curvature of the misfit.
    tried : array_like, shape (delays,), [s]
    misfits : array_like, shape (delays,)
        Least weighted squared misfit at each delay, relative to the smallest.
    """

    seconds: float
    standard_error: float
    tried: Vector
    misfits: Vector

    def __post_init__(self) -> None:
        shapes = {"tried": (None,), "misfits": (None,)}
        freeze_arrays(self, shapes, "delay of commands")

    @property
    def bounded_error(self) -> float:
        """The standard error, at most the longest delay that was tried [s]."""
        return float(min(self.standard_error, self.tried.max()))

    def table(self) -> Table:
        """Return the delay, and the misfit at all tried delays, for people."""
        order = np.argsort(self.tried)
        return Table(
            f"Commands are late by {1e3 * self.seconds:.2f} +- "
            f"{1e3 * self.standard_error:.2f} ms",
            ("delay [ms]", "misfit over the least"),
            tuple(
                (f"{1e3 * self.tried[i]:.3g}", f"{self.misfits[i]:.4f}") for i in order
            ),
            (
                "the interval is 1 standard error, for this model of friction. It does "
                "not contain the error of interpolating commands between samples",
            ),
        )


def command_delay(
    model: TorqueModel,
    recordings: Callable[[float], Sequence[Recording]],
    *,
    constraints: Sequence[Constraint] = (),
    longest: float = LONGEST,
) -> CommandDelay:
    """Estimate the delay with which commands reach the drives.

    Parameters
    ----------
    model : TorqueModel
    recordings : callable
        Function from a delay [s] to prepared recordings with the torque of commands
        with that delay; see `commanded`.
    constraints : sequence of Constraint
        Only their equalities are used, such as known bodies and equal motors.
    longest : float, [s]

    Raises
    ------
    RecordingError
        If the recordings cannot be used.
    """
    free = FreeParameters.of(constraints, model)
    built = {0.0: build_regression(model, recordings(0.0))}
    sigma = joint_noise(model, built[0.0])

    def misfit(delay: float) -> float:
        if delay not in built:
            built[delay] = build_regression(model, recordings(delay), noise=False)
        return free.misfit(built[delay].weighted(sigma))

    step = longest / _SCANNED
    for delay in np.arange(1, _SCANNED + 1) * step:
        misfit(float(delay))
    best = min(built, key=misfit)
    for _ in range(_HALVINGS):
        step /= 2.0
        near = [d for d in (best - step, best + step) if 0.0 <= d <= longest]
        best = min((best, *near), key=misfit)
    # Far from the delay, residuals are mostly its own error, which is correlated.
    built[best] = build_regression(model, recordings(best))
    sigma = joint_noise(model, built[best])
    seconds, bend = _parabola(best, step, longest, misfit)
    tried = np.array(list(built))
    misfits = np.array([misfit(delay) for delay in built])
    later = recordings(best + LATER)
    error = _delay_error(model, recordings(best), later, sigma, free)
    return CommandDelay(
        seconds=min(max(seconds, 0.0), longest),
        standard_error=error if bend > 0.0 else np.inf,
        tried=tried,
        misfits=misfits / misfits.min(),
    )


def _delay_error(
    model: TorqueModel,
    here: Sequence[Recording],
    later: Sequence[Recording],
    sigma: Vector,
    free: FreeParameters,
) -> float:
    """Return the standard error of the delay beside all free parameters.

    Parameters
    ----------
    here, later : sequence of Recording
        With the torque of commands at the delay found, and `LATER` after it.
    sigma : ndarray, shape (joints,)
        Each joint's noise.
    """
    parts, rows, total = [], 0, 0
    for one, other in zip(here, later, strict=True):
        whole, late = motion_of(model, one, None), motion_of(model, other, None)
        first = max(len(whole.q) - SHOWN, 0) // 2
        shown, delayed = (m.samples(first, first + SHOWN) for m in (whole, late))
        effect = (delayed.torque - shown.torque) / LATER
        rows, total = rows + len(shown.q), total + len(whole.q)
        parts += [
            np.column_stack([Y.T @ free.directions, c, t - Y.T @ free.start]) / s
            for Y, c, t, s in zip(
                shown.regressor(model), effect.T, shown.torque.T, sigma, strict=True
            )
        ]
    # What is not shown is like what is.
    return float(spectral_errors(parts)[-1] * np.sqrt(rows / total))


def _parabola(
    best: float, step: float, longest: float, misfit: Callable[[float], float]
) -> tuple[float, float]:
    """Return the lowest point, and the second derivative, of a parabola near a delay.

    It goes through the best delay and its neighbours; at either end, through the next
    ones.
    """
    middle = min(max(best, step), longest - step)
    low, centre, high = (misfit(middle + k * step) for k in (-1, 0, 1))
    bend = (low - 2.0 * centre + high) / step**2
    slope = (high - low) / (2.0 * step)
    return (middle - slope / bend, bend) if bend > 0.0 else (best, bend)
