"""Settings of a torque fit of commands, and what rollouts say of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from consistent_id.errors import ProblemError, RecordingError
from consistent_id.estimation.constrained import constrained_least_squares
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.method import Method
from consistent_id.laboratory.rollout.replay import replay, replayable
from consistent_id.laboratory.rollout.replay_model import replay_model
from consistent_id.problems.file import JointTable
from consistent_id.problems.loading import problem_of
from consistent_id.problems.problem import Problem
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains
from consistent_id.regression.base import base_parameters
from consistent_id.regression.noise import joint_noise
from consistent_id.regression.regression import Regression, build_regression


@dataclass(frozen=True, slots=True)
class Settings:
    """What a torque fit of commands depends on besides its data.

    Parameters
    ----------
    cutoff : float, [Hz]
        Of motion and torque.
    velocity_scale : float, [rad/s or m/s]
    friction_slope : tuple of str
        Joints whose friction varies with position.
    delay : float, [s]
        Of commands.
    stiffness : tuple of float, optional, [N m/rad or N/m]
        Of springs between motors and links, one each, infinite for a rigid joint; by
        default those of the problem.
    """

    cutoff: float = 10.0
    velocity_scale: float = 0.05
    friction_slope: tuple[str, ...] = ()
    delay: float = 0.0
    stiffness: tuple[float, ...] | None = None


def with_settings(problem: Problem, settings: Settings) -> Problem:
    """Return a problem with other settings; its logs are not read again.

    Raises
    ------
    ProblemError
        If the problem has no gains, or no Coulomb friction of the shape ``"tanh"``.
    """
    table, change = problem.table, msgspec.structs.replace
    if table.data is None or table.data.gains is None:
        raise _without_gains(problem)
    drives = {
        "velocity_scale": settings.velocity_scale,
        "coulomb": "tanh",
        "friction_slope": False,
    }
    preparation = change(
        table.data.preparation,
        motion_cutoff=settings.cutoff,
        torque_cutoff=settings.cutoff,
    )
    known = problem.drives.calibration
    gains = change(
        table.data.gains,
        delay=settings.delay,
        scale=known.scale.tolist(),
        encoder_bias=known.encoder_bias.tolist(),
        stiffness=_stated(problem, settings.stiffness),
    )
    data = change(table.data, gains=gains, preparation=preparation)
    named = dict.fromkeys((*table.joints, *settings.friction_slope), JointTable())
    joints = {
        name: change(
            joint, **drives | {"friction_slope": name in settings.friction_slope}
        )
        for name, joint in (named | table.joints).items()
    }
    changed = change(
        table, data=data, drive=change(table.drive, **drives), joints=joints
    )
    file = problem.source or problem.folder / "problem.toml"
    made = problem_of(changed, file)
    made._read.update(problem._read)
    return replace(made, source=problem.source)


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
    base = base_parameters(model)
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
    problem: Problem, estimate: Estimate, logs: Sequence[Recording]
) -> float:
    """Return the root-mean-square error of an estimate's rollouts [rad or m]."""
    gains = gains_of(problem)
    joints = problem.model.robot.joint_names
    known = [replayable(log.of(joints)) for log in logs]
    try:
        model = replay_model(estimate, joints, gains)
        delay = problem.delay_of_commands
        errors = [replay(model, log, delay=delay).errors for log in known]
    except RecordingError:
        return np.inf
    return float(np.sqrt((np.vstack(errors) ** 2).mean()))
