"""Simulated logs of a small arm, clean and with one known fault each."""

import importlib.util
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from consistent_id import DHRow, DriveTerms, TorqueModel, from_modified_dh
from consistent_id.robot import Datasheet

DRIVE = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True)


@cache
def logs():
    """Return the module that simulates logs and puts faults into them."""
    path = Path(__file__).parents[2] / "benchmarks" / "detective_logs.py"
    spec = importlib.util.spec_from_file_location("detective_logs", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["detective_logs"] = module  # dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


@cache
def arm():
    """Four joints, shoulder to wrist, with a datasheet."""
    rows = [
        DHRow(0, 0, 0.3),
        DHRow(-np.pi / 2, 0),
        DHRow(0, 0.5, 0.1),
        DHRow(np.pi / 2, 0.05, 0.4),
    ]
    robot = from_modified_dh("arm", rows)
    sheet = {
        name: Datasheet(mass=mass, com=com)
        for name, mass, com in zip(
            robot.link_names,
            (8.0, 6.0, 4.0, 2.0),
            ([0, 0, -0.1], [0.2, 0, 0.1], [0, -0.1, 0.05], [0.05, 0, 0.1]),
            strict=True,
        )
    }
    return TorqueModel(robot.with_datasheet(sheet), DRIVE)


@cache
def clean_case(seed):
    """Return an arm drawn at random, and its motion and log."""
    return logs().clean(arm(), np.random.default_rng(seed))


def clean_log(seed):
    """Return a log without faults."""
    return clean_case(seed).log


def at_samples(log):
    """Return a prepared log as `diagnose` takes it: its rows are those of its samples.

    Channels are turned, shifted and scaled after the filter there.
    """
    return replace(logs().prepared(log), torque_filter=None)
