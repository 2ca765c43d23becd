"""Recordings of the UR10e with 2.805 kg on its flange and without."""

import os
from functools import cache

from consistent_id import (
    Columns,
    differentiated,
    load_problem,
    low_passed,
    read_recording,
    resampled,
    trimmed,
)


def prepared(path, gains=None):
    """A recording of the UR10e, as read and as prepared."""
    problem = load_problem("problems/ur10e")
    columns = Columns("time", "q{number}", "dq{number}", None, "current{number}")
    gain = problem.table.data.torque_gain if gains is None else list(gains)
    joints = problem.model.robot.joint_names
    raw = read_recording(path, joints, columns, torque_gain=gain)
    log = low_passed(resampled(raw, 100.0), motion_cutoff=7.5, torque_cutoff=10.0)
    return raw, differentiated(log)


@cache
def ur10e_runs(gains=None):
    """The UR10e and its runs of one trajectory with 2.805 kg and without."""
    folder = os.environ["CONSISTENT_ID_DATASETS"] + "/ur10e/"
    logs = []
    for file, first, last in (
        ("payload/ur-20_02_19_14harm50secLoad.parquet", 308, 5071),
        ("identification/ur-20_02_19_14harm50sec.parquet", 195, 4966),
    ):
        raw, log = prepared(folder + file, gains)
        logs.append(trimmed(log, raw.time[first - 1], raw.time[last - 1]))
    return load_problem("problems/ur10e"), *logs
