"""Settings of a torque fit of commands, and its errors in rollouts.

The danger is overfitting: a model of slow motion may be wrong for fast motion. So a fit
to one part of the training motion is judged by its rollouts of the other one, see
`slow_and_fast`.

A file format, or a simulator, has its own form of friction.  An export leaves other
terms out, and their friction is then missing.  If friction is fitted again without
these terms, the remaining terms compensate for them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import msgspec
import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.constraints.cones.certificate import Certificate
from consistent_id.errors import (
    ProblemError,
    RecordingError,
)
from consistent_id.estimation.best_fit import best_fit
from consistent_id.estimation.constrained import (
    constrained_least_squares,
)
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.method import Method, fitted_spans
from consistent_id.problems.file import (
    DataTable,
    GainsTable,
    JointTable,
    ProblemTable,
)
from consistent_id.problems.loading import problem_of
from consistent_id.problems.problem import Problem
from consistent_id.problems.stated_model import drive_of
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains
from consistent_id.regression.base import base_parameters
from consistent_id.regression.drive.drive_terms import DEFAULTS
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import joint_noise
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import require_known
from consistent_id.rollout.commanded_motion import replay, replayable
from consistent_id.rollout.faded_friction import (
    without_slow_friction,
    without_stribeck,
)
from consistent_id.rollout.replay_model import STEP, replay_model

_EVERYWHERE = ("viscous", "coulomb", "velocity_scale", "offset", "rotor_inertia")

TERMS: Mapping[str, tuple[str, ...]] = {
    "mjcf": (*_EVERYWHERE, "spring", "friction_slope"),
    "mjlab": (*_EVERYWHERE, "spring", "friction_slope"),
    "isaaclab": _EVERYWHERE,
    "urdf": _EVERYWHERE,
}
"""Drive terms that are fitted for a format.  An offset is fitted for all: without it
friction would compensate for it; an export of a format without it has a note.
"""


def in_form_of(problem: Problem, form: str) -> Problem:
    """Return the problem without drive terms that a format lacks.

    Asymmetric friction becomes Coulomb friction and an offset.

    Parameters
    ----------
    form : str
        One of `TERMS`.

    Raises
    ------
    ProblemError
        If the format is not known.
    """
    if form not in TERMS:
        known = ", ".join(TERMS)
        raise ProblemError(f"no form of friction {form!r}, expected one of {known}")
    changed = table_in_form_of(problem.table, form)
    made = problem_of(changed, problem.source or problem.folder / "problem.toml")
    return _same_logs(made, problem)


def table_in_form_of(table: ProblemTable, form: str) -> ProblemTable:
    """Return a problem's table without drive terms that a format of `TERMS` lacks.

    Asymmetric friction becomes Coulomb friction and an offset.
    """
    change = msgspec.structs.replace
    lacking = [name for name in DEFAULTS if name not in TERMS[form]]

    def reduced(drive: Any) -> Any:
        stated = {
            name: DEFAULTS[name]
            for name in lacking
            if getattr(drive, name) is not msgspec.UNSET
        }
        if getattr(drive, "asymmetric") is True:  # noqa: B009  fields made by msgspec
            stated["offset"] = True
        return change(drive, **stated)

    return change(
        table,
        drive=reduced(table.drive),
        joints={name: reduced(joint) for name, joint in table.joints.items()},
    )


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of a torque fit of commands.

    Parameters
    ----------
    cutoff : float, [Hz]
        Cut-off of motion and torque.
    velocity_scale : float, [rad/s or m/s]
    friction_slope : tuple of str
        Joints whose friction varies with position.
    delay, delay_error : float, [s]
        Delay of commands, and its standard error.
    stiffness : tuple of float, optional, [N m/rad or N/m]
        Stiffness of springs between motors and links, one each, infinite for a rigid
        joint; by default those of the problem.
    equal_motors : tuple of tuple of str, optional
        Joints of equal motors; by default those of the problem.
    simulated : bool
        Only drive terms that MuJoCo has; the others are missing in rollouts.
    spring : bool, optional
        Whether all joints have the drive term ``spring``, or none; by default those of
        the problem.
    couplings : bool
        Whether gears are coupled as the problem says, or not at all.
    stribeck_velocity : float, optional, [rad/s or m/s]
        Speed at which Stribeck friction of all joints fades; by default that of the
        problem.
    load_friction : bool, optional
        Whether friction depends on the load; by default that of the problem.
    least_joint_speed : float, optional, [rad/s or m/s]
        Speed below which rows of a joint are left out, with those around its reversals;
        by default that of the problem.
    bodies : {"model"}, optional
        Bodies of the robot's file, of which the drives alone are fitted; by default as
        the problem says.
    """

    cutoff: float = 10.0
    velocity_scale: float = 0.05
    friction_slope: tuple[str, ...] = ()
    delay: float = 0.0
    stiffness: tuple[float, ...] | None = None
    equal_motors: tuple[tuple[str, ...], ...] | None = None
    simulated: bool = False
    spring: bool | None = None
    couplings: bool = True
    stribeck_velocity: float | None = None
    load_friction: bool | None = None
    least_joint_speed: float | None = None
    bodies: Literal["model"] | None = None
    delay_error: float = 0.0


def with_settings(problem: Problem, settings: Settings) -> Problem:
    """Return a problem with other settings; its logs are not read again.

    Raises
    ------
    ProblemError
        If the problem has no gains, or no Coulomb friction of the shape ``"tanh"``.
    """
    table, change = problem.table, msgspec.structs.replace
    if settings.simulated:
        table = table_in_form_of(table, "mjcf")
    if table.data is None or table.data.gains is None:
        raise _without_gains(problem)
    drives = _drive_terms(settings)
    joints = problem.model.robot.joint_names
    require_known(settings.friction_slope, joints, "friction_slope: no joint")
    named = dict.fromkeys((*table.joints, *settings.friction_slope), JointTable())
    exceptions = {
        name: change(
            joint, **drives | {"friction_slope": name in settings.friction_slope}
        )
        for name, joint in (named | table.joints).items()
    }
    constraints, couplings = table.constraints, table.couplings
    if not settings.couplings:
        constraints, couplings = change(constraints, shared_motors=False), []
    if settings.bodies is not None:
        constraints = change(constraints, bodies=settings.bodies)
    if settings.equal_motors is not None:
        constraints = change(
            constraints, equal_motors=[list(group) for group in settings.equal_motors]
        )
    drive = change(table.drive, **drives)
    data = _data(problem, table.data, table.data.gains, settings)
    changed = change(
        table,
        data=data,
        drive=drive,
        joints=without_slow_friction(data.preparation, drive, exceptions, joints),
        constraints=constraints,
        couplings=couplings,
    )
    file = problem.source or problem.folder / "problem.toml"
    # The robot is the problem's; behind a wrench sensor, the file's is another one.
    alike = table.wrist_sensor is None
    model = _driven(changed, problem.model.robot) if alike else None
    return _same_logs(problem_of(changed, file, model=model), problem)


def without_friction(problem: Problem, joints: Sequence[str]) -> Problem:
    """Return a problem of which some joints have no Stribeck friction."""
    own = without_stribeck(problem.table.joints, joints)
    changed = msgspec.structs.replace(problem.table, joints=own)
    file = problem.source or problem.folder / "problem.toml"
    return _same_logs(problem_of(changed, file), problem)


def _same_logs(made: Problem, problem: Problem) -> Problem:
    """Return a problem of the same file, with the logs that were read already."""
    same = replace(made, source=problem.source)
    same._read.update(problem._read)
    return same


def _drive_terms(settings: Settings) -> dict[str, Any]:
    """Return the keys of ``[drive]`` that settings change."""
    optional = {
        "spring": settings.spring,
        "stribeck_velocity": settings.stribeck_velocity,
        "load_friction": settings.load_friction,
    }
    return {
        "velocity_scale": settings.velocity_scale,
        "coulomb": "tanh",
        "friction_slope": False,
        **{key: value for key, value in optional.items() if value is not None},
    }


def _data(
    problem: Problem, data: DataTable, gains: GainsTable, settings: Settings
) -> DataTable:
    """Return ``[data]`` with a cut-off, a delay and the calibration that is known."""
    change, known = msgspec.structs.replace, problem.drives.calibration
    cutoff, slowest = settings.cutoff, data.preparation.least_joint_speed
    if settings.least_joint_speed is not None:
        slowest = settings.least_joint_speed
    return change(
        data,
        gains=change(
            gains,
            delay=settings.delay,
            delay_error=settings.delay_error,
            scale=known.scale.tolist(),
            encoder_bias=known.encoder_bias.tolist(),
            stiffness=_stated(problem, settings.stiffness),
        ),
        preparation=change(
            data.preparation,
            motion_cutoff=cutoff,
            torque_cutoff=cutoff,
            least_joint_speed=slowest,
        ),
    )


def _driven(table: ProblemTable, robot: RobotModel) -> TorqueModel:
    """Return a robot with a table's drive terms; the same object for equal terms.

    So what has been found of a model, such as its base parameters, is found once.
    """
    model = drive_of(table, robot)
    return _kept_model(robot, model.terms, model.couplings, model.torque_joints)


_kept_model = lru_cache(maxsize=16)(TorqueModel)
_base_of = lru_cache(maxsize=16)(base_parameters)


def _stated(problem: Problem, stiffness: Sequence[float] | None) -> list[float] | None:
    """Return the stiffness of springs as a file states it; None for a rigid robot."""
    if stiffness is None:
        joints = len(problem.model.robot)
        stiffness = gains_of(problem).of(joints).stiffness.tolist()
    return list(stiffness) if np.isfinite(stiffness).any() else None


def torque_fit(
    problem: Problem, training: Sequence[Recording] | None = None
) -> tuple[Estimate, Regression]:
    """Return the constrained torque fit, weighted by each joint's noise."""
    model = problem.model
    base = _base_of(model)
    recordings = problem.training if training is None else training
    plain = build_regression(model, recordings)
    regression = plain.weighted(joint_noise(model, plain, base=base))
    estimate = constrained_least_squares(
        model,
        regression,
        constraints=problem.constraints,
        prior=problem.prior,
        base=base,
        method=Method.WEIGHTED_CONSTRAINED,
    )
    return replace(estimate, fitted_to=fitted_spans(recordings)), regression


def compared_fit(
    problem: Problem, training: Sequence[Recording]
) -> tuple[Estimate, Regression]:
    """Return the best fit under the constraints, not audited: to compare settings.

    How noise is correlated is not found: it scales the noise of all joints alike, and
    the best fit depends on its ratios.
    """
    model = problem.model
    base = _base_of(model)
    plain = build_regression(model, training, noise=False)
    regression = plain.weighted(joint_noise(model, plain, base=base))
    fit = best_fit(model, regression, problem.constraints, base=base)
    estimate = Estimate(
        method=Method.WEIGHTED_CONSTRAINED,
        model=model,
        base=base,
        parameters=fit.parameters,
        base_covariance=None,
        origins=("data",) * len(fit.parameters),
        undetermined=(),
        sigma=np.zeros(len(model.torque_joints)),
        certificate=Certificate("uncertified", "not audited: to compare settings"),
    )
    return estimate, regression


def gains_of(problem: Problem) -> PDGains:
    """Return the gains of a problem's drives.

    Raises
    ------
    ProblemError
        If it has none.
    """
    gains = problem.gains
    if gains is None:
        raise _without_gains(problem)
    return gains


def _without_gains(problem: Problem) -> ProblemError:
    return ProblemError(
        f"problem {problem.name!r} has no [data.gains]; a rollout replays commands of "
        "PD-controlled joints: give kp, kd and [data.columns] position_command"
    )


def rollout_error(
    problem: Problem,
    estimate: Estimate,
    logs: Sequence[Recording],
    step: float = STEP,
) -> float:
    """Return the root-mean-square error of an estimate's rollouts [rad or m].

    It is infinite if a motion diverges.
    """
    try:
        errors = replay_errors(problem, estimate, logs, step)
    except RecordingError:
        return np.inf
    return float(np.sqrt((np.vstack(errors) ** 2).mean()))


def replay_errors(
    problem: Problem,
    estimate: Estimate,
    logs: Sequence[Recording],
    step: float = STEP,
    offsets: Sequence[Matrix] | None = None,
) -> list[Matrix]:
    """Return the errors of an estimate's rollouts, (samples, joints) of each log.

    Parameters
    ----------
    offsets : sequence of ndarray, shape (samples, joints), optional, [N m or N]
        Additional friction at the samples of each log, of which the clock is uniform.

    Raises
    ------
    RecordingError
        If a motion diverges.
    """
    gains = gains_of(problem)
    joints = problem.model.robot.joint_names
    known = [replayable(log.of(joints)) for log in logs]
    period = min(1.0 / log.rate for log in known)
    model = replay_model(estimate, joints, gains, period=period, step=step)
    delay = problem.delay_of_commands
    more = [None] * len(known) if offsets is None else offsets
    return [
        replay(model, log, delay=delay, offsets=given).errors
        for log, given in zip(known, more, strict=True)
    ]
