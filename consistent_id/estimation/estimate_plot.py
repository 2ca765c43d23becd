"""Torque over time, and parameters with error bars, drawn into axes of Matplotlib."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id._support.extras import needed
from consistent_id.errors import ProblemError
from consistent_id.estimation.torque_error import measured_torque
from consistent_id.recordings.recording import Recording
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_names import in_newton
from consistent_id.robot.parameters import ParameterLayout, did_you_mean

_MEASURED = "measured"
_BESIDE = 0.2  # distance of a second estimate's bars, in rows


@dataclass(frozen=True, slots=True, eq=False)
class TorqueCurves:
    """Torques along one recording.

    Parameters
    ----------
    labels : tuple of str
        Labels of each row, with its unit.
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
    recording: Recording,
    joints: Sequence[str] | None,
) -> TorqueCurves:
    """Return the curves of some joints along a recording, by default of all.

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
    measured = measured_torque(model, recording)
    return TorqueCurves(
        tuple(f"{n} [{'N' if in_newton(model.robot, n) else 'N m'}]" for n in wanted),
        recording.time,
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
    labels = ", ".join(curves.labels)
    drawn = axes_for(axes, (rows, 1), f"the torque of {rows} joints ({labels})").ravel()
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


@dataclass(frozen=True, slots=True, eq=False)
class ParameterBars:
    """Parameters of one unit, with their 95 % intervals.

    Parameters
    ----------
    unit : str
    names : tuple of str
    values : ndarray, shape (names,)
    widths : ndarray, shape (names,)
        Half the widths of the intervals, NaN where they are not known.
    """

    unit: str
    names: tuple[str, ...]
    values: Vector
    widths: Vector


def parameter_bars(
    layout: ParameterLayout,
    values: Vector,
    half_intervals: Vector | None,
    names: Sequence[str] | None,
) -> tuple[ParameterBars, ...]:
    """Return the bars of some parameters, by default of all.

    Parameters
    ----------
    values : ndarray, shape (parameters,)
    half_intervals : ndarray, shape (parameters,), optional
        Half of 95 % intervals.
    names : sequence of str, optional
        Parameters, or bodies and joints whose parameters are all drawn.

    Raises
    ------
    ProblemError
        If a name is unknown.
    """
    unknown = np.full(len(values), np.nan)
    widths = unknown if half_intervals is None else half_intervals
    return tuple(
        ParameterBars(
            unit,
            tuple(layout.names[i] for i in places),
            values[places],
            widths[places],
        )
        for unit, places in _by_unit(layout, names).items()
    )


def draw_parameters(
    bars: Sequence[ParameterBars], method: str, axes: Any = None
) -> Any:
    """Draw parameters as dots with bars, those of each unit in one axes.

    Values whose error is not known are hollow, without a bar.

    Parameters
    ----------
    bars : sequence of ParameterBars
    method : str
        Name in the legend.
    axes : matplotlib.axes.Axes or array_like of it, shape (units,), optional
        By default those of a new figure of `matplotlib.pyplot`.

    Returns
    -------
    ndarray of matplotlib.axes.Axes, shape (units,)

    Raises
    ------
    ProblemError
        If the number of axes is not that of the units.
    """
    heights = [len(panel.names) + 1.5 for panel in bars]
    units = ", ".join(panel.unit for panel in bars)
    drawn = axes_for(
        axes, (len(bars), 1), f"parameters of {len(bars)} units ({units})", heights
    ).ravel()
    for axis, panel in zip(drawn, bars, strict=True):
        before = len(axis.containers)
        row = np.arange(len(panel.names)) + _BESIDE * before
        shown, width = panel.values, panel.widths
        known = np.isfinite(width)
        dots = axis.errorbar(
            shown[known], row[known], xerr=width[known], fmt="o", ms=4, label=method
        )
        colour = dots.lines[0].get_color()
        axis.plot(shown[~known], row[~known], "o", ms=4, mfc="none", color=colour)
        if not before:
            axis.set_yticks(row, panel.names, fontsize="small")
            axis.invert_yaxis()
            axis.axvline(0.0, color="0.7", lw=0.8, zorder=0)
        axis.set_xlabel(f"[{panel.unit}]")
        axis.grid(True, axis="x", alpha=0.3)
    drawn[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, frameon=False)
    return drawn


def axes_for(
    axes: Any, shape: tuple[int, int], what: str, heights: Sequence[float] | None = None
) -> Any:
    """Return axes that were given, if their number is right, or those of a new figure.

    Only a new figure is one of `matplotlib.pyplot`, so that notebooks show it.

    Parameters
    ----------
    axes : matplotlib.axes.Axes or array_like of it, optional
    shape : (int, int)
        Rows and columns of axes.
    what : str
        Their purpose, for the error.
    heights : sequence of float, shape (rows,), optional
        Relative heights, a row of text each; by default equal.

    Returns
    -------
    ndarray of matplotlib.axes.Axes, of that shape

    Raises
    ------
    ProblemError
        If their number is not that of the shape.
    """
    rows, columns = shape
    if axes is None:
        plt = needed("matplotlib.pyplot", "plots", "plotting")
        tall = 1.6 * rows if heights is None else 0.22 * sum(heights)
        _, axes = plt.subplots(
            *shape,
            squeeze=False,
            sharex=heights is None,
            figsize=(8.0 if columns == 1 else 4.0 * columns, tall + 0.8),
            layout="constrained",
            height_ratios=heights,
        )
    given = np.ravel(np.asarray(axes, dtype=object))
    if len(given) != rows * columns:
        raise ProblemError(
            f"{len(given)} axes for {what}; give {rows * columns}, or name fewer to "
            "draw"
        )
    return given.reshape(shape)


def _by_unit(
    layout: ParameterLayout, names: Sequence[str] | None
) -> Mapping[str, list[int]]:
    """Return the indices of the parameters to draw, by their unit."""
    bodies = dict.fromkeys(name.rpartition(".")[0] for name in layout.names)
    for name in names or ():
        if name not in bodies and name not in layout.names:
            known = (*bodies, *layout.names)
            raise ProblemError(f"no parameter {name!r}; {did_you_mean(name, known)}")
    panels: dict[str, list[int]] = {}
    for i, (name, unit) in enumerate(zip(layout.names, layout.units, strict=True)):
        if names is None or name in names or name.rpartition(".")[0] in names:
            panels.setdefault(unit, []).append(i)
    return panels


def _relative_error(measured: Vector, predicted: Vector) -> float:
    known = np.isfinite(measured)
    size = np.linalg.norm(measured[known])
    missed = np.linalg.norm(measured[known] - predicted[known])
    return float(missed / size) if size else np.nan
