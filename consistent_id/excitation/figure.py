"""A picture of a design: joint paths in their limits, singular values, the tool."""

from typing import Any

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.excitation.designed import ExcitationDesign
from consistent_id.robot.kinematics import link_places

_SAMPLES = 1000
_PATH, _LIMIT, _BEFORE = "#0072b2", "#d55e00", "0.6"


def design_figure(design: ExcitationDesign, before: Vector | None = None) -> Any:
    """Return a Matplotlib figure of a design.

    Parameters
    ----------
    before : array_like, shape (base parameters,), optional
        Singular values of the base regressor to compare with; by default of the best
        random path that the search began with.
    """
    from matplotlib.figure import Figure

    joints = design.limits.joints
    path = design.trajectory
    time = path.start + path.duration * np.linspace(0.0, 1.0, _SAMPLES)
    motion = path.evaluate(time)
    figure = Figure(figsize=(13.0, 1.5 * len(joints) + 1.5), layout="constrained")
    title = f"{design.model.robot.name}: condition number {design.condition}"
    figure.suptitle("\n".join([title, *_clearance(design)]))
    sides: Any = figure.subfigures(1, 2, width_ratios=(2.0, 1.0))
    left, right = sides
    axes = left.subplots(len(joints), 3, sharex=True, squeeze=False)
    for column, quantity in enumerate(("position", "velocity", "acceleration")):
        axes[0, column].set_title(f"{quantity}, share of limit", fontsize=10)
        limit = design.limits.derivative(column)
        offset = design.limits.middle if column == 0 else np.zeros(len(joints))
        for j, axis in enumerate(axes[:, column]):
            _draw(axis, time, motion[column, :, j] - offset[j], limit[j])
    for axis, joint in zip(axes[:, 0], joints, strict=True):
        axis.set_ylabel(joint, fontsize=8)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    upper, lower = right.subfigures(2, 1)
    _singular_values(upper, design, before)
    _tool_path(lower, design, motion[0])
    return figure


def _clearance(design: ExcitationDesign) -> list[str]:
    report = design.proof.clearance
    if report is None or not report.first:
        return []
    return [
        f"least clearance: {report.first} and {report.second} at {report.time:.2f} s, "
        f"{report.proven * 1e3:.1f} mm proven for all times"
    ]


def _draw(axis: Any, time: Vector, values: Vector, limit: float) -> None:
    axis.grid(alpha=0.3)
    if np.isfinite(limit):
        axis.plot(time, values / limit, color=_PATH, lw=1.2)
        axis.axhline(1.0, color=_LIMIT, lw=0.8)
        axis.axhline(-1.0, color=_LIMIT, lw=0.8)
        axis.set_ylim(-1.1, 1.1)
    else:
        axis.plot(time, values, color=_PATH, lw=1.2, ls="--")
        axis.text(0.02, 0.85, "no limit; SI", transform=axis.transAxes, fontsize=7)


def _singular_values(
    place: Any, design: ExcitationDesign, before: Vector | None
) -> None:
    axis = place.subplots()
    factor = design.unoptimised.factor
    earlier = np.linalg.svd(factor, compute_uv=False) if before is None else before
    number = np.arange(1, len(earlier) + 1)
    after = np.linalg.svd(design.accuracy.factor, compute_uv=False)
    axis.semilogy(
        number, earlier / earlier[0], ".-", color=_BEFORE, label="random path"
    )
    axis.semilogy(number, after / after[0], ".-", color=_PATH, label="design")
    axis.set_title(
        "singular values of the base regressor, over the largest", fontsize=10
    )
    axis.set_xlabel("number")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)


def _tool_path(place: Any, design: ExcitationDesign, q: Any) -> None:
    axis = place.add_subplot(projection="3d")
    robot = design.model.robot
    tip = link_places(robot, q).translation[:, -1]
    axis.plot(*tip.T, color=_PATH, lw=1.0)
    axis.set_title(f"path of {robot.link_names[-1]} [m]", fontsize=10)
    axis.set_aspect("equal")
    axis.tick_params(labelsize=7)
