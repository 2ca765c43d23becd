"""Payloads: a load's ten parameters from runs with it and without."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Matrix, Vector, freeze_arrays
from consistent_id._support.executors import single_threaded
from consistent_id._support.tables import brief
from consistent_id.constraints import (
    CentreOfMassBoxes,
    Constraint,
    FixedCentresOfMass,
    FixedMasses,
    MassBounds,
    PhysicalConsistency,
)
from consistent_id.constraints.priors import Prior
from consistent_id.errors import ProblemError, RecordingError
from consistent_id.estimation.base_least_squares import least_squares
from consistent_id.estimation.constrained import (
    constrained_least_squares,
)
from consistent_id.estimation.constrained_fit import (
    DEFAULT_CONSTRAINTS,
)
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.loaded_robot import (
    LoadedRobot,
    OfBareRobot,
    OfLoad,
    likely_body,
    loaded_robot,
)
from consistent_id.recordings.recording import Recording, several
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.correlation_lengths import correlation_length
from consistent_id.regression.linear import smallest_solution
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import joint_noise, unconstrained_fit
from consistent_id.robot.inertia import INERTIAL_NAMES, InertialParameters
from consistent_id.robot.model import Datasheet, Link

_CERTAIN = 5.0  # standard errors
_ROUNDED = 1e-9  # of the largest entry of a covariance
_TINY = np.finfo(np.float64).tiny


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Payload:
    """A load, in the frame of the link that carries it.

    Parameters
    ----------
    body : InertialParameters
        The constrained estimate: physically consistent.
    free : InertialParameters
        The least-squares estimate, which may not be consistent.
    covariance : array_like, shape (10, 10)
        That of `free`, for noise as correlated as the residuals, and for the stated
        uncertainty of gains; infinite on the diagonal where not identifiable, and zero
        beside it.
    quantile : float
        Standard errors of half a 95 % interval: Student's, for the degrees of freedom
        of the identifiable parameters' variance, their harmonic mean.  Errors of gains
        are stated, and not estimated from few data.
    correlation : float
        Samples that carry the information of one independent sample.
    gain_errors : array_like, shape (torque joints,)
        Relative standard errors of gains, as stated.
    robot : LoadedRobot
    estimate, least_squares : Estimate
        Estimates of robot and load together.
    seconds : float
    """

    body: InertialParameters
    free: InertialParameters
    covariance: Matrix
    quantile: float
    correlation: float
    gain_errors: Vector
    robot: LoadedRobot
    estimate: Estimate
    least_squares: Estimate
    seconds: float

    def __post_init__(self) -> None:
        joints = len(self.robot.model.torque_joints)
        shapes = {"covariance": (10, 10), "gain_errors": (joints,)}
        freeze_arrays(self, shapes, finite=False)

    @property
    def standard_errors(self) -> Vector:
        """Roots of the diagonal of `covariance`, shape (10,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def open(self) -> tuple[str, ...]:
        """Names of the load's parameters that are not identifiable."""
        return tuple(
            f"{self.robot.load}.{name}"
            for name, error in zip(INERTIAL_NAMES, self.standard_errors, strict=True)
            if not np.isfinite(error)
        )

    @property
    def condition(self) -> str:
        """The assumption behind the standard errors."""
        if self.robot.bare.robot.floating and not self.gain_errors.any():
            return (
                "the wrist sensor is assumed to be calibrated, with one bias in all "
                "logs"
            )
        if not self.gain_errors.any():
            return (
                "gains that convert currents to torque are assumed to be exact; if "
                "they are not, state their uncertainty: --gain-errors 5 for 5 % "
                "(gain_errors=0.05)"
            )
        low, high = (f"{100 * e:.2g} %" for e in np.sort(self.gain_errors)[[0, -1]])
        span = low if low == high else f"{low} to {high}"
        return f"gains that convert currents to torque are uncertain by {span}"

    def predict(self, recording: Recording, *, loaded: bool = True) -> Array:
        """Return torques along a motion with or without the load.

        Shape (samples, torque joints), [N m or N].

        Parameters
        ----------
        recording : Recording
            With velocity and acceleration.
        loaded : bool
            Whether the robot carries the payload.
        """
        return self.robot.predict(self.estimate.parameters, recording, loaded=loaded)


@single_threaded
def identify_payload(
    model: TorqueModel,
    loaded: Recording | Sequence[Recording],
    unloaded: Recording | Sequence[Recording],
    *,
    load: Link | None = None,
    carrier: str | None = None,
    constraints: Sequence[Constraint] = DEFAULT_CONSTRAINTS,
    load_constraints: Sequence[Constraint] = (),
    prior: Prior | None = None,
    weighted: bool = True,
    gain_errors: ArrayLike = 0.0,
) -> Payload:
    """Estimate a load and the robot that carries it, from runs with it and without.

    Both are estimated together: all runs determine the robot, and the loaded runs
    determine the load.  If friction depends on the load, the payload is included, as
    estimated by least squares.

    Parameters
    ----------
    model : TorqueModel
        Model of the robot without the load.
    loaded, unloaded : Recording or sequence of Recording
        With velocity, acceleration and torque.
    load : Link, optional
        Its name, and its datasheet: a mass, bounds, a centre of mass, all in the frame
        of the link that carries it.  By default nothing.
    carrier : str, optional
        Link that carries the load; by default the last one of a chain.
    constraints : sequence of Constraint
        On the robot without its load.
    load_constraints : sequence of Constraint
        On the load, by its name, besides physical consistency and its datasheet.
    prior : PointToSet or Penalty, optional
        Chooses among estimates that fit equally well.  For a load without nominal
        parameters, the nominal load is the least-squares estimate, made consistent.
    weighted : bool
        Whether joints are weighted by their noise.
    gain_errors : float or array_like
        Relative standard errors of the gains that convert currents to torque, one for
        each torque joint or the same for all; or their covariance, shape (torque
        joints, torque joints), such as that of `identify_gains`, whose errors belong
        together. They cause errors of the load that noise does not show.

    Raises
    ------
    ProblemError
        If there are neither one gain error nor as many as torque joints, nor a
        covariance of them.
    RecordingError
        If the load would have a negative mass: the runs are exchanged.
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    started = perf_counter()
    load = Link("load") if load is None else load
    robot = loaded_robot(model, load, carrier=carrier)
    runs = (several(unloaded), several(loaded))
    fitted = _fitted(robot, runs, weighted)
    likely = likely_body(fitted.free.parameters[robot.load_slice])
    if load.nominal is None and likely is not None:
        robot = robot.with_nominal(likely)
        # From now on, gear friction depends on the load
        fitted = _fitted(robot, runs, weighted)
    regression, free = fitted
    residuals = list(robot.residuals(free.parameters, *runs))
    of_joints = _gain_covariance(gain_errors, len(model.torque_joints))
    slopes = gain_slopes(regression, robot.base)
    scatter = _scatter(robot, regression, free, slopes @ of_joints @ slopes.T)
    carried = InertialParameters(free.parameters[robot.load_slice])
    _require_weight(carried, float(np.sqrt(scatter.covariance[0, 0])))
    estimate = constrained_least_squares(
        robot.model,
        regression,
        constraints=_of_both(robot, load, constraints, load_constraints),
        prior=prior,
        base=robot.base,
        method="payload",
    )
    return Payload(
        body=InertialParameters(estimate.parameters[robot.load_slice]),
        free=carried,
        covariance=scatter.covariance,
        quantile=scatter.quantile,
        correlation=correlation_length(residuals, regression.sigma),
        gain_errors=np.sqrt(np.diag(of_joints)),
        robot=robot,
        estimate=estimate,
        least_squares=free,
        seconds=perf_counter() - started,
    )


class _LoadedFit(NamedTuple):
    regression: Regression
    free: Estimate


def _fitted(
    robot: LoadedRobot,
    runs: tuple[Sequence[Recording], Sequence[Recording]],
    weighted: bool,
) -> _LoadedFit:
    """Return the regression of both runs, and least squares."""
    regression = robot.regression(*runs)
    if weighted:
        sigma = joint_noise(robot.model, regression, base=robot.base)
        regression = regression.weighted(sigma)
    return _LoadedFit(
        regression, least_squares(robot.model, regression, base=robot.base)
    )


def datasheet_constraints(load: Link) -> list[Constraint]:
    """Return the constraints from a load's datasheet."""
    sheet: Datasheet = load.datasheet
    known: list[Constraint] = []
    if sheet.mass is not None:
        known.append(FixedMasses({load.name: sheet.mass}))
    if sheet.mass_bounds is not None:
        known.append(MassBounds({load.name: sheet.mass_bounds}))
    if sheet.com is not None:
        known.append(FixedCentresOfMass({load.name: sheet.com.tolist()}))
    if sheet.com_box is not None:
        low, high = sheet.com_box.tolist()
        known.append(CentreOfMassBoxes({load.name: (low, high)}))
    return known


def _of_both(
    robot: LoadedRobot,
    load: Link,
    constraints: Sequence[Constraint],
    load_constraints: Sequence[Constraint],
) -> list[Constraint]:
    """Return the constraints of a robot and of the load that it carries."""
    return [
        *(OfBareRobot(constraint, robot) for constraint in constraints),
        OfLoad(PhysicalConsistency(), load.name),
        *datasheet_constraints(load),
        *load_constraints,
    ]


def _require_weight(free: InertialParameters, error: float) -> None:
    """Refuse a load of negative mass, beyond what noise explains."""
    if free.mass < -_CERTAIN * error:
        raise RecordingError(
            f"the load would weigh {free.mass:.3g} +- {error:.2g} kg. Are the runs "
            "with the load and without it exchanged, or is the torque's sign reversed?"
        )


def _gain_covariance(gain_errors: ArrayLike, joints: int) -> Matrix:
    """Return the covariance of the joints' relative gain errors."""
    errors = np.asarray(gain_errors, dtype=np.float64)
    if errors.shape == (joints, joints) and joints > 1:
        matrix: Matrix = errors
    elif errors.size in (1, joints) and (errors >= 0.0).all():
        matrix = np.diag(np.broadcast_to(errors.ravel(), (joints,)) ** 2)
    else:
        matrix = np.full((joints, joints), np.nan)
    least = -_ROUNDED * abs(matrix).max()
    if not (np.isfinite(matrix).all() and np.linalg.eigvalsh(matrix)[0] >= least):
        raise ProblemError(
            f"gain_errors are {errors.tolist()}, expected one share or {joints}, zero "
            f"or more, such as 0.05 for 5 %, or their covariance, {joints} x {joints}"
        )
    return matrix


class _LoadScatter(NamedTuple):
    """Covariance of the load's parameters, and the quantile of its intervals."""

    covariance: Matrix
    quantile: float


def _scatter(
    robot: LoadedRobot, regression: Regression, free: Estimate, of_gains: Matrix
) -> _LoadScatter:
    """Return the covariance of the load's parameters by noise and gains.

    Parameters
    ----------
    of_gains : ndarray, shape (base parameters, base parameters)
        Covariance of the base parameters by errors of the gains.
    """
    from scipy.special import stdtrit

    independent = list(robot.base.independent)
    rows, places = [], []
    for i, column in enumerate(range(len(free.parameters))[robot.load_slice]):
        place = independent.index(column) if column in independent else None
        if place is not None and not robot.base.regrouping[place].any():
            rows.append(i)
            places.append(place)
    covariance = np.diag(np.full(10, np.inf))
    if free.base_covariance is None or not rows:
        return _LoadScatter(covariance, float(stdtrit(1.0, 0.975)))
    by_noise = np.diag(free.base_covariance)[places]
    found = (free.base_covariance + of_gains)[np.ix_(places, places)]
    total = np.diag(found).copy()
    unknown = ~np.isfinite(total)
    # [Satterthwaite1946]_: shares of the variance by noise.
    shares = by_noise[~unknown] / total[~unknown]
    found[unknown, :] = found[:, unknown] = 0.0
    found[unknown, unknown] = np.inf
    covariance[np.ix_(rows, rows)] = found
    noise = unconstrained_fit(regression, robot.base).noise
    known = np.array(places)[~unknown]
    freedoms = noise.freedoms(np.eye(len(independent))[known])
    few = float(np.mean(shares**2 / freedoms)) if len(known) else 1.0
    return _LoadScatter(covariance, float(stdtrit(1.0 / max(few, _TINY), 0.975)))


def gain_slopes(regression: Regression, base: BaseParameters) -> Matrix:
    """Return the derivative of the base parameters by the logarithm of each gain.

    The torque of a joint is proportional to its gain, and the solution is linear in the
    torques: with ``x = A^+ b`` the slope of joint ``j`` is ``A^+ b_j``, where ``b_j``
    has the rows of that joint alone.

    Parameters
    ----------
    regression : Regression
        With its weights, which stay fixed.

    Returns
    -------
    ndarray, shape (base parameters, joints)
    """
    scaled = [F / s for F, s in zip(regression.factors, regression.sigma, strict=True)]
    A = np.vstack([own[:, list(base.independent)] for own in scaled])
    torque = np.zeros((len(A), len(scaled)))
    first = 0
    for place, own in enumerate(scaled):
        torque[first : first + len(own), place] = own[:, -1]
        first += len(own)
    return smallest_solution(A, torque)
