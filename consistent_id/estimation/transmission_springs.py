"""Springs between motors and links, and their stiffness.

The torque of springs depends on their stiffness nonlinearly; the rest of the fit is
linear.  So stiffness is scanned, and for each value the other parameters are solved for
(variable projection).  Motors of a group have equal springs.  The group whose spring
lowers the misfit most gets it; then the other groups are tried again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import BoolArray, Vector, freeze_arrays
from consistent_id._support.tables import Table, brief
from consistent_id.constraints import Constraint
from consistent_id.estimation.determination import FreeParameters, least_squares
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.drive_torque import stiffness_of
from consistent_id.regression.correlated_noise import SHOWN, spectral_errors
from consistent_id.regression.elastic_joints import as_rigid, link_inertias
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regression import build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import joint_noise

FREQUENCIES = (20.0, 14.0, 10.0, 7.0, 5.0)
"""Natural frequencies of links on the springs that are tried [Hz].  A stiffer one
changes motion below 4 Hz by a twentieth at most; a joint on a softer one has a spring
by design, whose stiffness is known.
"""

WORTH = 0.025
"""Least relative decrease of the squared misfit for a spring: the same threshold as for
other terms of a model.  For a leg with a spring of 7 Hz the decrease is 0.65; with
stiff gears every spring that is tried increases the misfit.
"""

_HALVINGS = 4  # refinements of the factor between frequencies, each with two more fits
_FACTOR = 2.0**0.5  # between frequencies
_AROUND = 0.05  # step of the compliance, for the misfit's parabola and its effect


@brief
@dataclass(frozen=True, slots=True, eq=False)
class JointSprings:
    """Springs between motors and links, and their standard errors.

    Parameters
    ----------
    joints : tuple of str
    compliance : array_like, shape (joints,), [rad/(N m) or m/N]
        Zero for a rigid joint.
    standard_errors : array_like, shape (joints,)
        Standard errors of the compliance, for noise as correlated as the residuals;
        zero for a rigid joint.
    misfit : float
        Least weighted squared misfit, over that of a rigid robot.
    """

    joints: tuple[str, ...]
    compliance: Vector
    standard_errors: Vector
    misfit: float

    def __post_init__(self) -> None:
        shape = (len(self.joints),)
        shapes = {"compliance": shape, "standard_errors": shape}
        freeze_arrays(self, shapes, "springs of joints", finite=False)

    @property
    def stiffness(self) -> Vector:
        """Stiffness of the springs, infinite for a rigid joint, [N m/rad or N/m]."""
        return stiffness_of(self.compliance)

    def table(self) -> Table:
        """Return the springs, for people."""
        rows = [
            (joint, f"{1.0 / c:.4g} +- {e / c**2:.2g}" if c > 0.0 else "rigid")
            for joint, c, e in zip(
                self.joints, self.compliance, self.standard_errors, strict=True
            )
        ]
        return Table(
            f"Springs between motors and links: squared misfit {self.misfit:.3f} of a "
            "rigid robot's",
            ("joint", "stiffness [N m/rad, N/m]"),
            tuple(rows),
            (
                "+- 1 standard error, for this model of bodies and friction; rigid: no "
                f"spring at which links vibrate below {FREQUENCIES[0]:g} Hz lowers "
                f"the squared misfit by {100 * WORTH:g} %",
            ),
        )


def joint_springs(
    model: TorqueModel,
    recordings: Sequence[Recording],
    *,
    groups: Sequence[Sequence[str]] = (),
    constraints: Sequence[Constraint] = (),
) -> JointSprings:
    """Find springs between motors and links.

    Parameters
    ----------
    model : TorqueModel
        With nominal bodies, from which the springs' torque is computed.
    recordings : sequence of Recording
        Prepared, with torque as it was recorded; on uniform clocks.
    groups : sequence of sequence of str
        Joints of equal motors; every other joint is a group of its own.
    constraints : sequence of Constraint
        Only equalities are used, such as known bodies and equal motors.

    Raises
    ------
    ModelError
        If bodies of the robot are not known.
    RecordingError
        If the recordings cannot be used.
    """
    search = _search(model, recordings, groups, constraints)
    names = model.robot.joint_names
    soft, errors = np.zeros(len(names)), np.zeros(len(names))
    stiff, found = search.misfit(soft), []
    left = list(search.units)
    while left:
        candidates = [search.softened(soft, unit) for unit in left]
        place = int(np.argmin([search.misfit(c) for c in candidates]))
        if search.misfit(candidates[place]) > (1.0 - WORTH) * search.misfit(soft):
            break
        soft = candidates[place]
        found.append(left.pop(place))
    for unit in found:
        soft = search.at_vertex(search.finer(soft, unit), unit)
    for unit in found:
        errors[unit > 0.0] = search.error(soft, unit)
    return JointSprings(names, soft, errors, search.misfit(soft) / stiff)


@dataclass(frozen=True, slots=True, eq=False)
class _SpringSearch:
    """The state of the search.

    A unit is the compliance of a group's joints on which their links vibrate at 1 Hz,
    zero elsewhere.  The standard error is that of a compliance and the group whose it
    is, from residuals of the fit with springs: those of a rigid robot are as correlated
    as the motion.
    """

    units: tuple[Vector, ...]
    misfit: Callable[[Vector], float]
    error: Callable[[Vector, Vector], float]

    def softened(self, soft: Vector, unit: Vector) -> Vector:
        """Return the compliances with the best spring of a group, of those tried.

        All are tried: stiffer springs whose links vibrate with the motion may raise the
        misfit tenfold before it falls.
        """
        return min((soft + unit / f**2 for f in FREQUENCIES), key=self.misfit)

    def finer(self, soft: Vector, unit: Vector) -> Vector:
        """Return the compliances with a group's spring between those tried."""
        own, factor = unit > 0.0, _FACTOR
        for _ in range(_HALVINGS):
            factor **= 0.5
            near = (np.where(own, soft * f, soft) for f in (factor**2, factor**-2))
            soft = min((soft, *near), key=self.misfit)
        return soft

    def at_vertex(self, soft: Vector, unit: Vector) -> Vector:
        """Return the compliances with a group's at the vertex of the misfit's parabola.

        Steps of the search are larger than the standard error from a long log.
        """
        own = unit > 0.0
        step = _AROUND * float(soft[own][0])
        low, least, high = self._around(soft, own, step)
        bend = low - 2.0 * least + high
        part = 0.5 * (low - high) / bend if bend > 0.0 else 0.0
        return soft + float(np.clip(part, -1.0, 1.0)) * step * own

    def _around(self, soft: Vector, own: BoolArray, step: float) -> list[float]:
        """Return the misfit below, at and above a group's compliance."""
        return [self.misfit(soft + k * step * own) for k in (-1, 0, 1)]


def _search(
    model: TorqueModel,
    recordings: Sequence[Recording],
    groups: Sequence[Sequence[str]],
    constraints: Sequence[Constraint],
) -> _SpringSearch:
    robot = model.robot
    names = robot.joint_names
    # Only ratios of the joints' noise count, which its correlation does not change.
    first = build_regression(model, recordings, noise=False)
    sigma = joint_noise(model, first)
    free = FreeParameters.of(constraints, model)
    known: dict[bytes, float] = {}

    def rigid(soft: Vector) -> list[Recording]:
        return [as_rigid(robot, log, soft) for log in recordings]

    def misfit(soft: Vector) -> float:
        if (key := soft.tobytes()) not in known:
            regression = build_regression(model, rigid(soft), noise=False)
            known[key] = free.misfit(regression.weighted(sigma))
        return known[key]

    def error(soft: Vector, unit: Vector) -> float:
        own = unit > 0.0
        step = _AROUND * float(soft[own][0])
        return _standard_error(model, rigid(soft), rigid(soft + step * own), step, free)

    q = np.vstack([log.of(names).position for log in recordings])
    unit = 1.0 / (link_inertias(robot, q.mean(axis=0)) * (2.0 * np.pi) ** 2)
    grouped = {name for group in groups for name in group}
    alone = [(name,) for name in names if name not in grouped]
    units = []
    for group in (*groups, *alone):
        own = np.array([name in group for name in names])
        units.append(np.where(own, unit[own].mean(), 0.0))
    return _SpringSearch(tuple(units), misfit, error)


def _standard_error(
    model: TorqueModel,
    here: Sequence[Recording],
    softer: Sequence[Recording],
    step: float,
    free: FreeParameters,
) -> float:
    """Return the standard error of a compliance beside all free parameters.

    Noise is as correlated as the residuals.

    Parameters
    ----------
    here, softer : sequence of Recording
        Without the effect of springs of the compliance found, and of one that is larger
        by `step`.
    """
    regression = build_regression(model, here)
    sigma = joint_noise(model, regression)
    weighted = regression.weighted(sigma)
    free = free.determined(weighted)
    stacked = weighted.stacked()
    y = least_squares(*free.reduced(stacked[:, :-1], stacked[:, -1]))
    x = free.start + free.directions @ y
    parts, count, total = [], 0, 0
    for one, other in zip(here, softer, strict=True):
        whole, moved = motion_of(model, one, None), motion_of(model, other, None)
        first = max(len(whole.q) - SHOWN, 0) // 2
        shown, beside = (m.samples(first, first + SHOWN) for m in (whole, moved))
        count, total = count + len(shown.q), total + len(whole.q)
        parts += [
            np.column_stack(
                [
                    Y.T @ free.directions,
                    ((Z - Y).T @ x - (late - torque)) / step,
                    torque - Y.T @ free.start,
                ]
            )
            / s
            for Y, Z, torque, late, s in zip(
                shown.regressor(model),
                beside.regressor(model),
                shown.torque.T,
                beside.torque.T,
                sigma,
                strict=True,
            )
        ]
    # The samples that are not shown are like those that are.
    return float(spectral_errors(parts)[-1] * np.sqrt(count / total))
