"""Refuses what belongs to another torque model."""

from consistent_id.errors import NotExcitedError, ProblemError
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_model import RowModel


def require_match(
    model: TorqueModel, regression: Regression, base: BaseParameters
) -> None:
    """Refuse a regression or base parameters of another torque model, or no torque.

    Raises
    ------
    ProblemError
        If layouts, joints or fingerprints differ.
    NotExcitedError
        If a joint's torque is zero throughout: a dead channel, not a joint at ease.
    """
    require_same_model(model, regression, base)
    rms = regression.torque_rms
    dead = [j for j, size in zip(regression.joints, rms, strict=True) if size == 0.0]
    if dead:
        raise NotExcitedError(
            f"the torque is zero throughout for {', '.join(dead)}; check column, unit "
            "and gain, or leave the joint out of the model's torque_joints"
        )


def require_same_model(
    model: RowModel, regression: Regression, base: BaseParameters
) -> None:
    """Refuse a regression or base parameters of another torque model.

    Raises
    ------
    ProblemError
        If layouts, joints or fingerprints differ.
    """
    for what, found in (("regression", regression), ("base parameters", base)):
        same = found.layout == model.layout and found.fingerprint in (
            "",
            model.fingerprint,
        )
        if not same:
            raise ProblemError(
                f"the {what} are of another torque model: geometry, gravity, drive "
                "terms or names differ. Build them with this model"
            )
    if regression.joints != model.torque_joints:
        raise ProblemError(
            f"the regression is of joints {regression.joints}, the model has torques "
            f"of {model.torque_joints}"
        )
