"""Figures: joint motion, and measured and predicted torque."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.estimation.estimate import Estimate
from consistent_id.recordings.recording import Recording
from consistent_id.regression.row_names import in_newton
from consistent_id.regression.torque_along import measured_torque
from consistent_id.robot.model import Joint, RobotModel

_POINTS = 2000  # samples drawn per curve; more would not be visible
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")


def motion_figure(robot: RobotModel, recording: Recording) -> Any:
    """Return a figure of the joints' positions over time."""
    recording = recording.of(robot.joint_names)
    figure, axes = _panels(len(recording.joints), "joint motion: " + recording.name)
    keep = _downsampled(recording)
    for axis, joint, q in zip(axes, robot.driven, recording.position.T, strict=True):
        axis.plot(recording.time[keep], q[keep], color=_COLOURS[0])
        axis.set_ylabel(f"{joint.name}\n[{_unit(joint, 'rad', 'm')}]")
    axes[-1].set_xlabel("time [s]")
    return figure


def torque_drawing(estimates: Sequence[Estimate]) -> Callable[[Recording], Any]:
    """Return what draws a recording's measured and predicted torque, and the rest.

    It draws into one figure, whose curves change: to set up axes takes longer.
    """
    model = estimates[0].model
    rows = model.torque_joints
    figure, axes = _panels(len(rows), "", columns=2)
    left, right = axes[::2], axes[1::2]
    for axis, name in zip(left, rows, strict=True):
        unit = "N" if in_newton(model.robot, name) else "N m"
        axis.set_ylabel(f"{name}\n[{unit}]")
    given = [_curve(axis, "0.6", 2.5, "measured") for axis in left]
    pairs = [
        (
            [_curve(axis, colour, 1, estimate.method) for axis in left],
            [_curve(axis, colour, 0.8, estimate.method) for axis in right],
        )
        for estimate, colour in zip(estimates, _cycle(len(estimates)), strict=True)
    ]
    axes[0].set_title("measured and predicted", fontsize=10)
    axes[1].set_title("measured less predicted", fontsize=10)
    for axis in axes[-2:]:
        axis.set_xlabel("time [s]")
    figure.legend(
        *axes[0].get_legend_handles_labels(),
        loc="lower center",
        ncol=4,
        fontsize=8,
        frameon=False,
    )

    def drawn(recording: Recording) -> Any:
        _title(figure, "torque: " + recording.name)
        keep = _downsampled(recording)
        time = recording.time[keep]
        measured = measured_torque(model, recording)[keep]
        _draw(given, time, measured)
        for estimate, (predictions, rests) in zip(estimates, pairs, strict=True):
            predicted = estimate.predict(recording)[keep]
            _draw(predictions, time, predicted)
            _draw(rests, time, measured - predicted)
        for axis in axes:
            axis.relim()
            axis.autoscale_view()
        return figure

    return drawn


def save_figure(figure: Any, path: Path) -> Path:
    """Write a figure as PNG, whole or not at all."""
    import io

    from consistent_id._support.files import write_atomically

    buffer = io.BytesIO()
    figure.savefig(
        buffer,
        format="png",
        dpi=110,
        metadata={"Software": "consistent-id: figure"},
        pil_kwargs={"compress_level": 1},
    )
    return write_atomically(path, buffer.getvalue())


def _panels(rows: int, title: str, columns: int = 1) -> tuple[Any, list[Any]]:
    # The object interface keeps figures out of pyplot's global state.
    from matplotlib.figure import Figure

    width, height = 6.0 if columns == 1 else 10.0, 1.6 * rows + 1.4
    figure = Figure(figsize=(width, height))
    # Fixed margins [inch] and few ticks: a layout engine draws everything twice.
    axes = figure.subplots(rows, columns, sharex=True, squeeze=False)
    figure.subplots_adjust(
        left=1.0 / width,
        right=1.0 - 0.15 / width,
        bottom=0.8 / height,
        top=1.0 - 0.6 / height,
        wspace=0.14,
        hspace=0.16,
    )
    _title(figure, title)
    for axis in axes.ravel():
        axis.grid(alpha=0.3)
        axis.locator_params(nbins=5)
    return figure, list(axes.ravel())


def _title(figure: Any, title: str) -> None:
    y = 1.0 - 0.1 / figure.get_figheight()
    figure.suptitle(title, fontsize=11, y=y, va="top")


def _curve(axis: Any, colour: str, width: float, label: str) -> Any:
    """Return a curve without points as yet."""
    (line,) = axis.plot([], [], color=colour, lw=width, label=label)
    return line


def _draw(lines: Sequence[Any], time: Vector, values: Matrix) -> None:
    for line, series in zip(lines, values.T, strict=True):
        line.set_data(time, series)


def _unit(joint: Joint, turning: str, sliding: str) -> str:
    return sliding if joint.kind == "prismatic" else turning


def _downsampled(recording: Recording) -> slice:
    return slice(None, None, max(1, int(np.ceil(len(recording) / _POINTS))))


def _cycle(count: int) -> list[str]:
    return [_COLOURS[i % len(_COLOURS)] for i in range(count)]
