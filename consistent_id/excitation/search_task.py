"""A search's question, in matrices: all of it can be sent to another process."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import ProblemError
from consistent_id.excitation.accuracy import earlier_rows
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.basis import FourierBasis
from consistent_id.excitation.criteria import Scaling
from consistent_id.excitation.guards import Guard
from consistent_id.excitation.verification import robot_limits
from consistent_id.motion.limits import MotionLimits
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regressor import TorqueModel

_SAMPLES = 100  # of a path at least, and ten per period of the highest frequency


@dataclass(frozen=True, slots=True, eq=False)
class SearchTask:
    """What is searched for: all of it can be sent to another process.

    Parameters
    ----------
    model : TorqueModel
    base : BaseParameters
    basis : FourierBasis
    period : float, optional, [s]
        After which paths repeat.
    samples : int
        Of a path at which the regressor is taken.
    recorded : float
        Samples that will be recorded.
    noise : ndarray, shape (torque joints,), [N m or N]
    earlier : ndarray, shape (base, base)
        Information there is already.
    scaling : {"none", "unit columns"}
    gram : ndarray, shape (base, base), optional
        Of the task whose torque is to be predicted.
    guards : tuple of Guard
    seed : int
        Of the random paths that searches begin with.
    """

    model: TorqueModel
    base: BaseParameters
    basis: FourierBasis
    period: float | None
    samples: int
    recorded: float
    noise: Vector
    earlier: Matrix
    scaling: Scaling
    gram: Matrix | None = None
    guards: tuple[Guard, ...] = ()
    seed: int = 0


def search_task(
    model: TorqueModel,
    base: BaseParameters,
    form: PathForm,
    aim: Aim,
    limits: MotionLimits,
    guards: tuple[Guard, ...],
) -> SearchTask:
    """Return the task of a form, an aim and limits.

    Raises
    ------
    ProblemError
        If limits of a joint are missing, or earlier recordings or the task are of
        another robot.
    """
    limits = robot_limits(limits, model.robot)
    basis = FourierBasis(limits, form.frequencies, form.duration, form.rest)
    degree = int(np.ceil(form.frequencies[-1] * form.duration))
    still = basis.trajectory(np.zeros((basis.size, len(limits.joints))))
    earlier = earlier_rows(model, base, aim)
    return SearchTask(
        model=model,
        base=base,
        basis=basis,
        period=still.period,
        samples=max(_SAMPLES, 10 * degree),
        recorded=form.duration * aim.rate,
        noise=aim.noise_of(model.torque_joints),
        earlier=earlier.T @ earlier,
        scaling=aim.scaling,
        gram=_gram(model, base, aim),
        guards=guards,
    )


def _gram(model: TorqueModel, base: BaseParameters, aim: Aim) -> Matrix | None:
    """Return ``V^T V / rows`` of the task's base regressor."""
    if aim.task is None:
        return None
    log = aim.task.of(model.robot.joint_names)
    if log.velocity is None or log.acceleration is None:
        raise ProblemError(
            f"task {log.name}: velocity or acceleration is missing; differentiate it"
        )
    Y = model.regressor(log.position, log.velocity, log.acceleration)
    V = Y[:, list(base.independent)]
    return np.asarray(np.einsum("jps,jqs->pq", V, V) / (len(V) * len(log)))
