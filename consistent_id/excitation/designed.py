"""The result of a design: its stages, each proven, and their predicted accuracy."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.tables import Table, brief
from consistent_id.estimation.estimate_plot import axes_for
from consistent_id.excitation.accuracy import PredictedAccuracy, RelativeAccuracy
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.path_search import FoundPath
from consistent_id.excitation.verification import Demands, PathProof
from consistent_id.motion.limits import MotionLimits
from consistent_id.recordings.joint_paths import FourierTrajectory
from consistent_id.regression.base import BaseParameters, ConditionNumber
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_structure import RowModel
from consistent_id.regression.rows.sensor_rows import SensorRows

SAMPLES = 1000
"""Samples of a path that figures draw."""
PATH, _LIMIT = "#0072b2", "#d55e00"


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """The result of one stage of a design, proven to keep all limits.

    Parameters
    ----------
    objective : str
    trajectory : FourierTrajectory
    value : float
        The objective's own: a condition number, or a size of standard errors.
    accuracy : PredictedAccuracy
        At all samples that will be recorded.
    proof : PathProof
    candidates : tuple of FoundPath
        The searches' results: first the trajectory's own, then the others, best first.
    searches : int
        Number of searches from the stage's starts.
    cut_short : bool
        Whether its allowance or the user ended a search.
    improved : bool
        Whether it found a better path than the earlier ones.
    """

    objective: str
    trajectory: FourierTrajectory
    value: float
    accuracy: PredictedAccuracy
    proof: PathProof
    candidates: tuple[FoundPath, ...]
    searches: int
    cut_short: bool
    improved: bool = True

    @property
    def iterations(self) -> int:
        """Iterations of the solver in all of its searches."""
        return sum(one.iterations for one in self.candidates)

    @property
    def number(self) -> int:
        """Index of the search that found it, from 0."""
        return self.candidates[0].number


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ExcitationDesign:
    """An exciting trajectory, with its proof and its predicted accuracy.

    Parameters
    ----------
    model : TorqueModel
    base : BaseParameters
    demands : Demands
    form : PathForm
    aim : Aim
    stages : tuple of Stage
        The last one's trajectory is the design's.
    unoptimised : PredictedAccuracy
        Accuracy of the best of the random paths that the searches began with.
    seed : int
    seconds : float
    notes : tuple of str
    interrupted : bool
        Whether the user ended the search; the design is the best so far.
    relative : RelativeAccuracy, optional
        Its errors relative to the parameters of the robot, if these are known.
    tried : tuple of PathForm
        Forms that `form` was chosen from.
    sensor : SensorRows, optional
        The sensor whose tool the motion is for, instead of the robot's parameters.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> limits = ci.motion_limits(arm, position={"joint1": (-1, 1)}, velocity=2.0)
    >>> form = ci.PathForm(5.0, 2)
    >>> design = ci.design_trajectory(arm, form, limits=limits, starts=1, workers=1)
    >>> design.proof.holds, design.trajectory.duration
    (True, 5.0)
    """

    model: TorqueModel
    base: BaseParameters
    demands: Demands
    form: PathForm
    aim: Aim
    stages: tuple[Stage, ...]
    unoptimised: PredictedAccuracy
    seed: int
    seconds: float
    notes: tuple[str, ...]
    interrupted: bool = False
    relative: RelativeAccuracy | None = None
    tried: tuple[PathForm, ...] = ()
    sensor: SensorRows | None = None

    def __repr__(self) -> str:
        verdict = "all limits proven" if self.proof.holds else "limits not proven"
        return (
            f"ExcitationDesign({self.model.robot.name!r}: {verdict}, "
            f"{self.form.duration:.4g} s, condition number "
            f"{self.condition.value:.4g} (random path: "
            f"{self.unoptimised.condition.value:.4g}))"
        )

    def _repr_html_(self) -> str:
        return Table(repr(self), (), (), self.notes).html()

    @property
    def measured(self) -> RowModel:
        """The model whose rows a recording of the motion has."""
        return self.model if self.sensor is None else self.sensor

    @property
    def limits(self) -> MotionLimits:
        """The limits of its motion."""
        return self.demands.limits

    @property
    def starts(self) -> int:
        """Random paths that were searched from."""
        return self.stages[0].searches

    @property
    def trajectory(self) -> FourierTrajectory:
        """The path to play."""
        return self.stages[-1].trajectory

    @property
    def accuracy(self) -> PredictedAccuracy:
        """Predicted accuracy of the base parameters from its recording."""
        return self.stages[-1].accuracy

    @property
    def condition(self) -> ConditionNumber:
        """Condition number of its base regressor."""
        return self.accuracy.condition

    @property
    def proof(self) -> PathProof:
        """Its proof."""
        return self.stages[-1].proof

    def plot(self, axes: Any = None) -> Any:
        """Draw each joint's position, velocity and acceleration as shares of limits.

        Positions are counted from the middle of their range, so that both limits are
        at -1 and 1.  A quantity without a limit is drawn dashed, in SI units.

        Parameters
        ----------
        axes : array_like of matplotlib.axes.Axes, shape (joints, 3), optional
            By default those of a new figure of `matplotlib.pyplot`.

        Returns
        -------
        ndarray of matplotlib.axes.Axes, shape (joints, 3)

        Raises
        ------
        ProblemError
            If the number of axes is not three for each joint.
        """
        limits, path = self.limits, self.trajectory
        joints = len(limits.joints)
        axes = axes_for(axes, (joints, 3), f"the motion of {joints} joints")
        time = path.start + path.duration * np.linspace(0.0, 1.0, SAMPLES)
        motion = path.evaluate(time)
        for column, quantity in enumerate(("position", "velocity", "acceleration")):
            axes[0, column].set_title(f"{quantity}, share of limit", fontsize=10)
            limit = limits.derivative(column)
            middle = limits.middle if column == 0 else np.zeros(joints)
            for j, axis in enumerate(axes[:, column]):
                _draw(axis, time, motion[column, :, j] - middle[j], limit[j])
        for axis, joint in zip(axes[:, 0], limits.joints, strict=True):
            axis.set_ylabel(joint, fontsize=8)
        for axis in axes[-1]:
            axis.set_xlabel("time [s]")
        return axes


def _draw(axis: Any, time: Vector, values: Vector, limit: float) -> None:
    axis.grid(alpha=0.3)
    if np.isfinite(limit):
        axis.plot(time, values / limit, color=PATH, lw=1.2)
        axis.axhline(1.0, color=_LIMIT, lw=0.8)
        axis.axhline(-1.0, color=_LIMIT, lw=0.8)
        axis.set_ylim(-1.1, 1.1)
    else:
        axis.plot(time, values, color=PATH, lw=1.2, ls="--")
        axis.text(0.02, 0.85, "no limit; SI", transform=axis.transAxes, fontsize=7)
