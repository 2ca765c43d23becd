"""The verdict on a log is one: of the shell, of Python, of an estimate by itself."""

import json

import numpy as np
import pytest
from logged import DRIVE, write_arm

from consistent_id import (
    FixedMasses,
    NonNegativeDrive,
    PhysicalConsistency,
    Recording,
    TorqueModel,
    build_regression,
    constrained_least_squares,
    differentiated,
    identify_log,
    load_robot,
    low_passed,
)
from consistent_id.cli import main

HEADER = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow"
SPOILS = {
    "whole": lambda table: table,
    "one torque reversed": lambda table: table * [1, 1, 1, 1, -1],
    "torque times 100": lambda table: table * [1, 1, 1, 100, 100],
    "positions in degrees": lambda table: table * [1, 57.3, 57.3, 1, 1],
}


@pytest.mark.slow
@pytest.mark.parametrize("spoil", SPOILS)
def test_shell_and_python_say_the_same_of_a_log(spoil, tmp_path, capsys):
    urdf, first = write_arm(tmp_path)
    table = np.loadtxt(first, delimiter=",", skiprows=1)
    log = tmp_path / "spoilt.csv"
    spoilt = SPOILS[spoil](table)
    np.savetxt(log, spoilt, "%.9g", ",", header=HEADER, comments="")

    study = identify_log(urdf, log)
    code = main(["identify", str(urdf), str(log), "--dry-run", "--json"])
    said = json.loads(capsys.readouterr().out)
    whole = study.verdict.to_dict()
    assert {key: said[key] for key in ("verdict", "method", "reasons")} == {
        key: whole[key] for key in ("verdict", "method", "reasons")
    }
    assert code == (study.verdict.word == "do not use")
    # Nothing but the model, the log and the constraints: no findings, no selection.
    model = TorqueModel(load_robot(urdf), DRIVE)
    time, *columns = spoilt.T
    q, torque = np.column_stack(columns[:2]), np.column_stack(columns[2:])
    recording = Recording(model.robot.joint_names, time, q, torque=torque)
    prepared = differentiated(
        low_passed(recording, motion_cutoff=10.0, torque_cutoff=10.0)
    )
    known = [PhysicalConsistency(), FixedMasses(), NonNegativeDrive()]
    own = constrained_least_squares(
        model, build_regression(model, prepared), constraints=known
    )
    if spoil == "whole":
        assert study.verdict.word == own.verdict.word == "use"
    else:
        assert study.verdict.word == "do not use"
        assert own.verdict.word != "use"
