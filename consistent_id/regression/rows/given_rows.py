"""A regression whose regressor somebody else computed, with names for its rows.

Whatever measured them: force plates under a person, a crane's load cell, a satellite.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import checked
from consistent_id._support.executors import single_threaded
from consistent_id.errors import ProblemError
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.linear import independent_columns
from consistent_id.regression.regression import Regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import RobotModel


class GivenRows(NamedTuple):
    """The input of estimators: a model, its regression and its base parameters.

    Parameters
    ----------
    model : TorqueModel
    regression : Regression
    base : BaseParameters
    """

    model: TorqueModel
    regression: Regression
    base: BaseParameters


@single_threaded
def given_rows(
    robot: RobotModel,
    rows: Sequence[str],
    regressor: ArrayLike,
    measured: ArrayLike,
    *,
    sigma: ArrayLike = 1.0,
) -> GivenRows:
    """Compress a given regressor: ``measured = regressor @ x`` for every sample.

    Parameters
    ----------
    robot : RobotModel
        Model whose bodies the columns belong to; `free_bodies` makes one.
    rows : sequence of str
        Names of the rows of a sample, such as ``("nx", "ny", "fz")``.
    regressor : array_like, shape (samples, rows, 10 links)
        Columns in this package's order: see `InertialParameters`.
    measured : array_like, shape (samples, rows)
    sigma : array_like, shape (rows,)
        Standard deviation of each row's noise.

    Returns
    -------
    GivenRows
        Its base parameters are those of the regressor: what other motions would show
        is not known.

    Raises
    ------
    ProblemError
        If a shape is wrong or a value is not finite.
    """
    model = TorqueModel(robot, torque_joints=tuple(rows))
    if robot.connected:
        raise ProblemError(
            f"robot {robot.name!r}: its links are connected, so its regressor follows "
            "from its motion; give bodies (free_bodies), or use build_regression"
        )
    Y = checked(regressor, (None, len(rows), len(model.layout)), "regressor")
    tau = checked(measured, (len(Y), len(rows)), "measured")
    whole = np.concatenate([Y, tau[:, :, None]], axis=2)
    regression = Regression(
        layout=model.layout,
        joints=model.torque_joints,
        factors=tuple(
            triangle(np.asfortranarray(whole[:, j])) for j in range(len(rows))
        ),
        counts=(len(Y),) * len(rows),
        sigma=np.broadcast_to(checked_sigma(sigma, len(rows)), (len(rows),)),
        fingerprint=model.fingerprint,
        peaks=abs(tau).max(axis=0),
    )
    split = independent_columns(regression.stacked()[:, :-1])
    base = BaseParameters(model.layout, *split, fingerprint=model.fingerprint)
    return GivenRows(model, regression, base)


def checked_sigma(sigma: ArrayLike, rows: int) -> np.ndarray:
    """Return one noise level for each row."""
    return checked(sigma, (rows,) if np.ndim(sigma) else (), "sigma")
