"""How long to move until errors are a twentieth of the parameters."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import ProblemError
from consistent_id.excitation.accuracy import PredictedAccuracy
from consistent_id.regression.row_model import RowModel
from consistent_id.regression.rows.sensor_rows import SensorRows

_WANTED = 0.05  # standard error, in shares of the parameter
_MATTERS = 0.01  # share of the path's torque, RMS, that a parameter must make up


@dataclass(frozen=True, slots=True)
class RelativeAccuracy:
    """Standard errors of one repetition beside the parameters of a known robot.

    Only base parameters count that make up a hundredth of the torque along the path, in
    units of its noise: of a parameter near zero no share means anything.  Of a motion
    for some parameters, only those.

    Parameters
    ----------
    matter : tuple of str
        Base parameters that count, by their leaders.
    accurate : int
        Those of them with a standard error of 5 % or less.
    unknown : int
        Those with a standard error above the parameter itself.
    repetitions : float, optional
        After which all of them have 5 % or less; None if no number is enough.
    duration : float, [s]
        Of one repetition.
    """

    matter: tuple[str, ...]
    accurate: int
    unknown: int
    repetitions: float | None
    duration: float

    @property
    def useless(self) -> bool:
        """Whether most of what matters stays unknown."""
        return 2 * self.unknown > len(self.matter)

    @property
    def note(self) -> str:
        """How long to move for 5 %."""
        many = f"{len(self.matter)} base parameters that make up 1 % of the torque"
        now = f"{self.accurate} of the {many} have a standard error of 5 % or less"
        if self.repetitions is None:
            return f"{now}; no number of repetitions is enough for all"
        count = max(int(np.ceil(self.repetitions)), 1)
        if count == 1:
            return f"all of the {many} have a standard error of 5 % or less"
        return (
            f"{now}; for all of them play it {count} times, "
            f"{count * self.duration:.0f} s"
        )


def relative_accuracy(
    model: RowModel, accuracy: PredictedAccuracy, reference: Vector | None = None
) -> RelativeAccuracy | None:
    """Compare predicted errors with parameters; None if these are not known.

    Parameters
    ----------
    model : TorqueModel or SensorRows
    accuracy : PredictedAccuracy
    reference : ndarray, shape (parameters,), optional
        By default the nominal robot without friction, or the nominal tool.
    """
    if reference is None:
        body = model.tool.robot if isinstance(model, SensorRows) else model.robot
        nominal = body.nominal
        if nominal is None:
            return None
        reference = np.zeros(len(model.layout))
        reference[: len(nominal)] = nominal
    x = accuracy.base.projection @ reference
    size = np.linalg.norm(accuracy.factor * x, axis=0)
    whole = float(np.linalg.norm(accuracy.factor @ x))
    matters = (size >= _MATTERS * whole) & (abs(x) > 0.0)
    if accuracy.interest:
        matters &= np.isin(np.arange(len(x)), accuracy.interest)
    if accuracy.unit_noise or not matters.any():
        return None
    names = tuple(np.array(accuracy.base.names)[matters].tolist())
    share = accuracy.standard_errors()[matters] / abs(x[matters])
    wanted = dict(zip(names, (_WANTED * abs(x[matters])).tolist(), strict=True))
    repetitions: float | None
    try:
        repetitions = accuracy.repetitions_for(wanted)
    except ProblemError:
        repetitions = None
    return RelativeAccuracy(
        matter=names,
        accurate=int((share <= _WANTED).sum()),
        unknown=int((share > 1.0).sum()),
        repetitions=repetitions,
        duration=accuracy.duration,
    )
