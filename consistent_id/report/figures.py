"""Figures: joint motion, and measured beside predicted torque."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id.estimation.estimate import Estimate
from consistent_id.recordings.recording import Recording
from consistent_id.robot.model import Joint, RobotModel

_POINTS = 2000  # samples drawn per curve; more would not be seen
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")


def motion_figure(robot: RobotModel, recording: Recording) -> Any:
    """Return a figure of the joints' positions over time."""
    recording = recording.of(robot.joint_names)
    figure, axes = _panels(len(recording.joints), "joint motion: " + recording.name)
    keep = _downsampled(recording)
    for axis, joint, q in zip(axes, robot.joints, recording.position.T, strict=True):
        axis.plot(recording.time[keep], q[keep], color=_COLOURS[0])
        axis.set_ylabel(f"{joint.name}\n[{_unit(joint, 'rad', 'm')}]")
    axes[-1].set_xlabel("time [s]")
    return figure


def torque_figure(recording: Recording, estimates: Sequence[Estimate]) -> Any:
    """Return a figure of measured and predicted torque, and of what is left."""
    model = estimates[0].model
    joints = [j for j in model.robot.joints if j.name in model.torque_joints]
    figure, axes = _panels(len(joints), "torque: " + recording.name, columns=2)
    keep = _downsampled(recording)
    time = recording.time[keep]
    measured = recording.of(model.torque_joints).torque
    for j, joint in enumerate(joints):
        left = axes[2 * j]
        left.set_ylabel(f"{joint.name}\n[{_unit(joint, 'N m', 'N')}]")
        if measured is not None:
            left.plot(time, measured[keep, j], color="0.6", lw=2.5, label="measured")
    for estimate, colour in zip(estimates, _cycle(len(estimates)), strict=True):
        predicted = estimate.predict(recording)
        for j in range(len(joints)):
            label = estimate.method
            axes[2 * j].plot(time, predicted[keep, j], color=colour, lw=1, label=label)
            if measured is not None:
                rest = measured[keep, j] - predicted[keep, j]
                axes[2 * j + 1].plot(time, rest, color=colour, lw=0.8, label=label)
    axes[0].set_title("measured and predicted", fontsize=10)
    axes[1].set_title("measured less predicted", fontsize=10)
    for axis in axes[-2:]:
        axis.set_xlabel("time [s]")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="lower center", ncol=4, fontsize=8, frameon=False
    )
    return figure


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
    figure.suptitle(title, fontsize=11, y=1.0 - 0.1 / height, va="top")
    for axis in axes.ravel():
        axis.grid(alpha=0.3)
        axis.locator_params(nbins=5)
    return figure, list(axes.ravel())


def _unit(joint: Joint, turning: str, sliding: str) -> str:
    return sliding if joint.kind == "prismatic" else turning


def _downsampled(recording: Recording) -> slice:
    return slice(None, None, max(1, int(np.ceil(len(recording) / _POINTS))))


def _cycle(count: int) -> list[str]:
    return [_COLOURS[i % len(_COLOURS)] for i in range(count)]
