"""Measured and predicted torque over time, drawn into axes of Matplotlib."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.errors import ProblemError
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_names import in_newton
from consistent_id.robot.parameters import did_you_mean

_MEASURED = "measured"


@dataclass(frozen=True, slots=True, eq=False)
class TorqueCurves:
    """Torques along one recording.

    Parameters
    ----------
    labels : tuple of str
        Of each row, with its unit.
    time : ndarray, shape (samples,), [s]
    predicted : ndarray, shape (samples, rows), [N m or N]
    measured : ndarray, shape (samples, rows), [N m or N], optional
        NaN where it is not known.
    """

    labels: tuple[str, ...]
    time: Vector
    predicted: Array
    measured: Array | None


def torque_curves(
    model: TorqueModel,
    predicted: Array,
    measured: Array | None,
    time: Vector,
    joints: Sequence[str] | None,
) -> TorqueCurves:
    """Return the curves of some joints, by default of all.

    Raises
    ------
    ProblemError
        If the model has no torque of a joint.
    """
    rows = model.torque_joints
    wanted = rows if joints is None else tuple(joints)
    for name in wanted:
        if name not in rows:
            raise ProblemError(f"no torque of {name!r}; {did_you_mean(name, rows)}")
    some = [rows.index(name) for name in wanted]
    return TorqueCurves(
        tuple(f"{n} [{'N' if in_newton(model.robot, n) else 'N m'}]" for n in wanted),
        time,
        predicted[:, some],
        None if measured is None else measured[:, some],
    )


def draw_torque(curves: TorqueCurves, method: str, axes: Any = None) -> Any:
    """Draw each row's torque into axes of its own; return the axes.

    Parameters
    ----------
    method : str
        Name of the predicted torque in the legend.
    axes : matplotlib.axes.Axes or array_like of it, shape (rows,), optional
        By default those of a new figure of `matplotlib.pyplot`.

    Returns
    -------
    ndarray of matplotlib.axes.Axes, shape (rows,)

    Raises
    ------
    ProblemError
        If the number of axes is not that of the rows.
    """
    rows = len(curves.labels)
    if axes is None:
        import matplotlib.pyplot as plt

        size = (8.0, 1.6 * rows + 0.8)
        _, axes = plt.subplots(
            rows, squeeze=False, sharex=True, figsize=size, layout="constrained"
        )
    drawn = np.ravel(np.asarray(axes, dtype=object))
    if len(drawn) != rows:
        raise ProblemError(
            f"{len(drawn)} axes for the torque of {rows} joints; give one of each "
            f"joint, or name the joints to draw ({', '.join(curves.labels)})"
        )
    for row, axis in enumerate(drawn):
        predicted = curves.predicted[:, row]
        if curves.measured is not None:
            measured = curves.measured[:, row]
            # A second estimate in the same axes does not cover the first.
            if _MEASURED not in axis.get_legend_handles_labels()[1]:
                axis.plot(curves.time, measured, color="0.6", lw=2, label=_MEASURED)
            before = axis.get_title(loc="right")
            error = f"{_relative_error(measured, predicted):.1%}"
            title = f"{before} / {error}" if before else f"error {error}"
            axis.set_title(title, loc="right", fontsize="small")
        axis.plot(curves.time, predicted, lw=1, label=method)
        axis.set_ylabel(curves.labels[row])
        axis.grid(True, alpha=0.3)
    drawn[-1].set_xlabel("time [s]")
    drawn[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, frameon=False)
    return drawn


def _relative_error(measured: Vector, predicted: Vector) -> float:
    known = np.isfinite(measured)
    size = np.linalg.norm(measured[known])
    missed = np.linalg.norm(measured[known] - predicted[known])
    return float(missed / size) if size else np.nan
