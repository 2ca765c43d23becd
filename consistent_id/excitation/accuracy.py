"""Predicted standard errors of the base parameters along a motion.

With noise of standard deviation ``sigma_j`` on each torque, independent from sample to
sample, least squares has the covariance ``(sum_j W_j^T W_j / sigma_j^2 + M)^-1``, where
``M`` is the information of earlier recordings.

This gives the duration after which errors are a twentieth of the parameters. Unstated
noise has defaults: for joints from their effort limits, and for a sensor.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector, checked
from consistent_id._support.executors import single_threaded
from consistent_id._support.given_values import require_type
from consistent_id._support.singular import svd
from consistent_id._support.tables import Table, brief
from consistent_id.errors import NotExcitedError, ProblemError
from consistent_id.excitation.aims import Aim, places_of_interest
from consistent_id.motion.limits import MotionLimits
from consistent_id.recordings.joint_paths import JointPath
from consistent_id.regression.base import (
    BaseParameters,
    ConditionNumber,
    condition_number,
    linear_combination,
    require_same_model,
)
from consistent_id.regression.regression import triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import WHITE
from consistent_id.regression.row_structure import RowModel
from consistent_id.regression.rows.sensor_rows import SensorRows
from consistent_id.robot.parameters import did_you_mean

_PART = 0.2  # share of the largest part of a combination; smaller parts are not listed
_MOST = 1e9  # repetitions; more would not be played
_LEAST = 1e-9  # repetitions; fewer count as zero

_WANTED = 0.05  # standard error, in shares of the parameter
_MATTERS = 0.01  # least share of the path's torque, RMS, for a parameter that matters

_SHARE = 0.005  # of the effort limit; 0.4 to 0.7 % in a UR10e's six joints
# N and N m: errors of sensors for arms of 3 to 20 kg, from vibration and hysteresis.
# Their ratio, which affects the design, is a lever as long as a tool, 0.1 m.
_SENSOR = (0.2,) * 3 + (0.02,) * 3


@brief
@dataclass(frozen=True, slots=True, eq=False)
class PredictedAccuracy:
    """Predicted accuracy of the base parameters from a recording of a path.

    Parameters
    ----------
    base : BaseParameters
    factor : ndarray, shape (base, base)
        Triangular: ``R^T R`` is the information of one repetition.
    earlier : ndarray, shape (rows, base)
        ``E^T E`` is the information of earlier recordings.
    condition : ConditionNumber
        Condition number of one repetition's base regressor; its rows are divided by the
        noise if it was stated.
    duration : float, [s]
        Duration of one repetition.
    unit_noise : bool
        Whether no noise was given, so that errors are per N m (or N) of it.
    correlation : float
        Samples that carry the information of one independent sample: the mean over
        joints of earlier recordings, or the samples in the aim's correlation time.
    noise_note : str
        The assumption on noise, in words.
    interest : tuple of int
        Indices of the base parameters that the motion is for; empty for all.
    """

    base: BaseParameters
    factor: Matrix
    earlier: Matrix
    condition: ConditionNumber
    duration: float
    unit_noise: bool
    correlation: float = 1.0
    noise_note: str = ""
    interest: tuple[int, ...] = ()

    def standard_errors(self, repetitions: float = 1.0) -> Vector:
        """Return the standard error of each base parameter, in its own unit.

        Raises
        ------
        ProblemError
            If the number of repetitions is negative or not finite.
        NotExcitedError
            If some are not identifiable.
        """
        if not 0.0 <= repetitions < np.inf:
            raise ProblemError(f"repetitions is {repetitions}, expected 0 or more")
        rows = np.vstack([np.sqrt(repetitions) * self.factor, self.earlier])
        R = triangle(rows)
        size = abs(np.diag(R))
        if len(R) < len(self.base) or size.min() <= 1e-13 * size.max():
            raise NotExcitedError(
                "the path does not identify all base parameters; they have no "
                "standard errors"
            )
        inverse = np.linalg.solve(R, np.eye(len(R)))
        return np.asarray(np.linalg.norm(inverse, axis=1) * np.sqrt(self.correlation))

    def repetitions_for(self, wanted: Mapping[str, float]) -> float:
        """Return the number of repetitions for which standard errors are small enough.

        Zero, if earlier recordings are enough by themselves.

        Parameters
        ----------
        wanted : mapping from the name of a base parameter's leader to its error

        Raises
        ------
        ProblemError
            If a name leads no base parameter, an error is not positive, or no number of
            repetitions is enough.
        NotExcitedError
            If path and earlier recordings do not determine all parameters.
        """
        places = [self._place(name) for name in wanted]
        target = checked(list(wanted.values()), (len(wanted),), "wanted errors")
        if not (target > 0.0).all():
            raise ProblemError(f"wanted errors are {target}, expected positive ones")

        self.standard_errors()  # refuses a path for which no number is enough

        def enough(repetitions: float) -> bool:
            try:
                errors = self.standard_errors(repetitions)
            except NotExcitedError:  # too few of them for double precision
                return False
            return bool((errors[places] <= target).all())

        if enough(0.0):
            return 0.0
        high = 1.0
        while not enough(high):
            high *= 2.0
            if high > _MOST:
                raise ProblemError(
                    f"even {_MOST:g} repetitions are not enough for {dict(wanted)}"
                )
        low = 0.0
        while high - low > max(1e-6 * high, _LEAST):
            middle = (low + high) / 2.0
            low, high = (low, middle) if enough(middle) else (middle, high)
        return high

    @property
    def weakest(self) -> str:
        """The least identifiable combination of base parameters in one repetition.

        It has unit length in units of the columns' inverse norms; only its largest
        parts are listed.
        """
        norms = np.linalg.norm(self.factor, axis=0)
        units = np.where(norms > 0.0, norms, 1.0)
        _, _, Vt = svd(self.factor / units)
        direction = Vt[-1] / abs(Vt[-1]).max()
        return linear_combination(
            np.where(abs(direction) > _PART, direction, 0.0), self.base.names, digits=2
        )

    def _place(self, name: str) -> int:
        if name not in self.base.names:
            near = did_you_mean(name, self.base.names)
            raise ProblemError(f"{name!r} leads no base parameter; {near}")
        return self.base.names.index(name)

    def table(self) -> Table:
        """Return the predicted standard errors for people."""
        layout = self.base.layout
        unit = " per N m of noise" if self.unit_noise else ""
        errors = self.standard_errors()
        names, leaders = self.base.names, self.base.independent
        shown = self.interest or range(len(names))
        unknown = len(names) - len(shown)
        others = (
            f"for the parameters of interest, with {unknown} other unknown parameters"
            if unknown
            else "for the parameters of interest, all others being known",
        )
        return Table(
            "Predicted standard errors, one repetition",
            ("base parameter, led by", f"standard error{unit}", "unit"),
            tuple(
                (names[k], f"{errors[k]:.3g}", layout.units[leaders[k]]) for k in shown
            ),
            (
                *others * bool(self.interest),
                f"condition number {self.condition}",
                f"least identifiable: {self.weakest} (in units of the columns' norms)",
                self.noise_note,
            ),
        )


@single_threaded
def predicted_accuracy(
    model: RowModel, base: BaseParameters, path: JointPath, aim: Aim | None = None
) -> PredictedAccuracy:
    """Predict the accuracy of the base parameters from a recording of a path.

    Parameters
    ----------
    model : TorqueModel or SensorRows
    base : BaseParameters
    path : JointPath
    aim : Aim, optional
        The source of noise, sampling rate, earlier recordings and column scaling.

    Raises
    ------
    ProblemError
        If the path moves other joints than the robot has, or in another order, or
        earlier recordings are of another torque model.
    """
    require_type(base, BaseParameters, "base")
    require_type(path, JointPath, "path")
    if not isinstance(model, SensorRows):
        require_type(model, TorqueModel, "model")
    aim = aim or Aim()
    columns, noise = list(base.independent), aim.noise_of(model.torque_joints)
    earlier = earlier_rows(model, base, aim)
    rows = path_regressor(model, base, path, aim.rate)
    factor = triangle((rows / noise[:, None, None]).reshape(-1, len(columns)))
    # rows of a sensor differ in their units, so even a default weighs them
    stated = aim.noise is not None and (
        isinstance(model, SensorRows) or not aim.assumed_noise
    )
    plain = factor if stated else triangle(rows.reshape(-1, len(columns)))
    condition = condition_number(
        plain,
        basis=f"{len(base)} base parameters" + ", rows divided by the noise" * stated,
        unit_columns=aim.scaling == "unit columns",
    )
    return PredictedAccuracy(
        base=base,
        factor=factor,
        earlier=earlier,
        condition=condition,
        duration=path.duration,
        unit_noise=aim.noise is None,
        correlation=_correlation(aim),
        noise_note=_noise_note(model, aim),
        interest=places_of_interest(base, aim.interest),
    )


def _correlation(aim: Aim) -> float:
    """Return the samples that carry the information of one independent sample.

    It is that of earlier recordings together, over all joints; else the number in the
    aim's correlation time.
    """
    if not aim.recordings:
        return max(aim.correlation_time * aim.rate, 1.0)
    counts = sum(sum(r.counts) for r in aim.recordings)
    effective = sum(float(r.effective.sum()) for r in aim.recordings)
    length = counts / effective
    return length if length > WHITE else 1.0


def _noise_note(model: RowModel, aim: Aim) -> str:
    """Return the assumption on noise, and its validity on a real robot, in words."""
    size = (
        f"noise is assumed to be {assumed_noise(model)}, because none is stated"
        if aim.assumed_noise
        else "noise is assumed to be 1 N m or N, because none is stated"
        if aim.noise is None
        else "noise is as stated"
    )
    length = _correlation(aim)
    if length == 1.0:
        return (
            f"{size}; white, unlike on real robots, where noise is correlated over "
            f"0.1 to 0.35 s"
        )
    whence = "as in earlier recordings" if aim.recordings else "as on real robots"
    return f"{size}; correlated over {length:.0f} samples, {whence}"


def earlier_rows(model: RowModel, base: BaseParameters, aim: Aim) -> Matrix:
    """Return ``E``, shape (rows, base): ``E^T E`` is the information of earlier ones.

    Raises
    ------
    ProblemError
        If one is of another torque model.
    """
    columns, noise = list(base.independent), aim.noise_of(model.torque_joints)
    rows = [np.zeros((0, len(columns)))]
    for regression in aim.recordings:
        require_same_model(model, regression, base)
        rows.append(regression.weighted(noise).stacked()[:, columns])
    return np.vstack(rows)


def path_regressor(
    model: RowModel, base: BaseParameters, path: JointPath, rate: float
) -> Matrix:
    """Return a path's base regressor, shape (torque joints, samples, base).

    At equal steps, no faster than `rate` [Hz], both ends included.

    Raises
    ------
    ProblemError
        If the path moves other joints than the robot has, or in another order.
    """
    if path.joints != model.robot.joint_names:
        raise ProblemError(
            f"the path moves {', '.join(path.joints)}; the robot's joints are "
            f"{', '.join(model.robot.joint_names)}; expected the same, in order"
        )
    steps = max(1, int(path.duration * rate * (1.0 + 1e-12)))
    time = path.start + path.duration * np.arange(steps + 1) / steps
    columns = list(base.independent)
    blocks = [
        block[:, columns].transpose(0, 2, 1)
        for _, block in model.chunks(*path.evaluate(time))
    ]
    return np.concatenate(blocks, axis=1)


_PRACTICAL = 30  # repetitions; more are not advised


@dataclass(frozen=True, slots=True)
class RelativeAccuracy:
    """Standard errors of one repetition relative to the parameters of a known robot.

    Only base parameters are used that explain a hundredth of the torque along the path,
    in units of its noise: relative errors of parameters near zero are meaningless.  For
    a motion for some parameters, only those are used.

    Parameters
    ----------
    matter : tuple of str
        Base parameters that matter, by their leaders.
    accurate : int
        Those of them with a standard error of 5 % or less.
    unknown : int
        Those with a standard error above the parameter itself.
    repetitions : float, optional
        After which all of them have 5 % or less; None if no number is enough.
    duration : float, [s]
        Duration of one repetition.
    """

    matter: tuple[str, ...]
    accurate: int
    unknown: int
    repetitions: float | None
    duration: float

    @property
    def useless(self) -> bool:
        """Whether most parameters that matter stay unknown."""
        return 2 * self.unknown > len(self.matter)

    @property
    def note(self) -> str:
        """The duration for errors of 5 %, in words."""
        many = f"{len(self.matter)} base parameters that make up 1 % of the torque"
        now = f"{self.accurate} of the {many} have a standard error of 5 % or less"
        if self.repetitions is None:
            return f"{now}; no number of repetitions is enough for all"
        count = max(int(np.ceil(self.repetitions)), 1)
        if count == 1:
            return f"all of the {many} have a standard error of 5 % or less"
        if count > _PRACTICAL:
            return (
                f"{now}; it would have to be played {count} times to reach this for "
                "all of them: state the noise of your torques if it is less (--noise), "
                "or what matters (--for)"
            )
        return (
            f"{now}; to reach this for all of them, play it {count} times, "
            f"{count * self.duration:.0f} s"
        )


def relative_accuracy(
    model: RowModel, accuracy: PredictedAccuracy, reference: Vector | None = None
) -> RelativeAccuracy | None:
    """Compare predicted errors with parameters; None if these are unknown.

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


def with_default_noise(aim: Aim, model: RowModel, limits: MotionLimits) -> Aim:
    """Return the aim with default noise of each row, if none is stated.

    Nothing changes if noise is stated or if there are earlier recordings, nor, for
    joints, if the objective is a condition number, which uses no weights, or if an
    effort limit is missing.  Rows of a sensor always get noise, because they differ in
    their units.
    """
    if aim.noise is not None or aim.recordings:
        return aim
    if isinstance(model, SensorRows):
        return replace(aim, noise=np.array(_SENSOR), assumed_noise=True)
    if "condition" in aim.objectives:
        return aim
    places = [limits.joints.index(name) for name in model.torque_joints]
    effort = limits.effort[places]
    if not np.isfinite(effort).all():
        return aim
    return replace(aim, noise=_SHARE * effort, assumed_noise=True)


def assumed_noise(model: RowModel) -> str:
    """Return the default noise of `with_default_noise`, in words."""
    if isinstance(model, SensorRows):
        return f"{_SENSOR[0]:g} N and {_SENSOR[-1]:g} N m"
    return f"{100.0 * _SHARE:g} % of each effort limit"
