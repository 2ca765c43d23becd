"""The result of a design: its stages, each proven, and their predicted accuracy."""

from dataclasses import dataclass

from consistent_id._support.brief import brief
from consistent_id._support.tables import Table
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
