"""Simulated logs, and what a verdict says of them."""

from dataclasses import replace
from functools import cache

import numpy as np
from logged import DRIVE, URDF, moved

from consistent_id import (
    TorqueModel,
    build_regression,
    constrained_least_squares,
    differentiated,
    low_passed,
)
from consistent_id.estimation import judge
from consistent_id.robot import load_urdf
from consistent_id.signals import altered


@cache
def model(tmp_name="arm"):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.urdf"
        file.write_text(URDF)
        return TorqueModel(load_urdf(file), DRIVE)


@cache
def log():
    recording = moved(model())
    return differentiated(low_passed(recording, motion_cutoff=10.0, torque_cutoff=10.0))


def verdict_of(recording, robot_model=None):
    robot_model = model() if robot_model is None else robot_model
    return constrained_least_squares(
        robot_model, build_regression(robot_model, recording)
    ).verdict


def kinds(verdict):
    return [reason.kind for reason in verdict.grounds]


def with_torque(change):
    """The log with another torque, changed before it is filtered."""
    return altered(log(), lambda raw: replace(raw, torque=change(raw.torque)))


@cache
def good_estimate():
    return constrained_least_squares(model(), build_regression(model(), log()))


def good_with(**figures):
    """The verdict on a clean log, with other figures of its fit."""
    good = good_estimate()
    changed = {name: np.array(values) for name, values in figures.items()}
    return judge(replace(good.evidence(), fit=replace(good.fit, **changed)))
