"""The data detective, on logs whose one fault is known."""

import importlib.util
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from consistent_id import (
    Datasheet,
    DHRow,
    DriveTerms,
    Recording,
    TorqueModel,
    base_parameters,
    build_regression,
    from_modified_dh,
)
from consistent_id.diagnosis import Diagnosis, Finding, diagnose
from consistent_id.diagnosis.clock import clock_findings, velocity_findings
from consistent_id.diagnosis.coverage import (
    leak_findings,
    rank_findings,
    saturation_findings,
    standstill_findings,
)
from consistent_id.diagnosis.small_shifts import estimate_shifts

DRIVE = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True)


@cache
def _detective():
    path = Path(__file__).parent.parent / "benchmarks" / "detective.py"
    spec = importlib.util.spec_from_file_location("detective", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["detective"] = module  # dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


@cache
def _arm():
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
def _clean(seed):
    return _detective().clean(_arm(), np.random.default_rng(seed)).log


def _diagnosed(log, validation=()):
    return diagnose(_arm(), log, validation, prepare=_detective().prepared)


@pytest.mark.parametrize("seed", range(3))
def test_a_clean_log_is_not_accused(seed):
    assert _diagnosed(_clean(seed)).findings == ()


@pytest.mark.parametrize(
    "fault",
    [
        "degrees",
        "torque reversed",
        "torque channels exchanged",
        "position channels exchanged",
        "torque in kN m",
        "zero off by 90 degrees",
        "zero off by 4 to 10 degrees",
        "torque late by 40 to 100 ms",
    ],
)
def test_a_fault_that_only_the_torque_tells_is_found_as_what_it_is(fault):
    kind, inject = _detective().FAULTS[fault]
    log = inject(_clean(5), np.random.default_rng(1))
    found = _diagnosed(log)
    assert kind in {f.kind for f in found.faults}
    assert all(f.advice and f.statement for f in found.findings)


def test_a_zero_off_by_a_known_angle_is_measured():
    model, log = _arm(), _detective().prepared(_clean(2))
    base = base_parameters(model)
    moved = log.position.copy()
    moved[:, 1] += np.radians(3.0)
    wrong = replace(log, position=moved)
    from consistent_id import constrained_least_squares

    regression = build_regression(model, wrong)
    weighted = regression.weighted(regression.torque_rms)
    x = constrained_least_squares(model, weighted, base=base).parameters
    shifts = estimate_shifts(model, x, wrong, base)
    assert np.degrees(shifts.offsets[1]) == pytest.approx(-3.0, abs=0.7)
    assert shifts.offset_errors[1] < np.radians(0.5)
    # About gravity, or of the last body, no zero can be told.
    assert abs(shifts.offsets[0]) < 8.0 * shifts.offset_errors[0]


@pytest.mark.parametrize("late", [6, -6])
def test_a_lag_is_measured_with_its_sign(late):
    from consistent_id import constrained_least_squares

    model, raw = _arm(), _clean(4)
    shifted = replace(raw, torque=np.roll(raw.torque, late, axis=0))
    log = _detective().prepared(shifted.samples(slice(10, -10)))
    base = base_parameters(model)
    regression = build_regression(model, log)
    weighted = regression.weighted(regression.torque_rms)
    x = constrained_least_squares(model, weighted, base=base).parameters
    shifts = estimate_shifts(model, x, log, base)
    # Six samples at 200 Hz; linearisation and friction leave a fifth.
    assert shifts.lag == pytest.approx(late / 200.0, rel=0.2)
    words = [f.statement for f in _diagnosed(shifted.samples(slice(10, -10))).of("lag")]
    assert words and ("later" if late > 0 else "earlier") in words[0]


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milli"), (1e6, "micro")])
def test_a_clock_that_is_not_in_seconds_is_told_with_its_unit(factor, unit):
    log = _clean(0)
    (finding,) = clock_findings(replace(log, time=log.time * factor))
    assert unit in finding.statement
    assert clock_findings(log) == []


def test_a_fast_clock_in_milliseconds_shows_in_the_velocity():
    log = _clean(0)
    fast = replace(log, time=np.linspace(0, 0.2, len(log)) * 1e3)
    (finding,) = velocity_findings(replace(fast, velocity=fast.velocity * 100))
    assert finding.kind == "clock"


def test_velocities_that_are_reversed_or_anothers_are_told():
    log = _clean(0)
    velocity = log.velocity.copy()
    velocity[:, 2] *= -1
    (finding,) = velocity_findings(replace(log, velocity=velocity))
    assert (finding.kind, finding.where) == ("velocity sign", "joint3")
    swapped = log.velocity[:, [1, 0, 2, 3]]
    found = velocity_findings(replace(log, velocity=swapped))
    assert {f.kind for f in found} == {"channel order"}


def test_torque_that_stays_at_its_limit_is_saturated():
    log = _clean(0)
    limit = 0.6 * abs(log.torque[:, 1]).max()
    clipped = log.torque.copy()
    clipped[:, 1] = np.clip(clipped[:, 1], -limit, limit)
    (finding,) = saturation_findings(replace(log, torque=clipped))
    assert finding.where == "joint2"
    assert f"{limit:.4g}" in finding.statement
    assert saturation_findings(log) == []


def test_rests_are_counted():
    log = _detective().resting(_clean(0), np.random.default_rng(0))
    (finding,) = standstill_findings(log)
    assert "50%" in finding.statement or "51%" in finding.statement
    assert standstill_findings(_clean(0)) == []


def test_validation_that_repeats_the_training_is_a_leak():
    log = _clean(0)
    half = log.samples(slice(1000, 3000))
    (finding,) = leak_findings([log], [half])
    assert finding.kind == "leak"
    assert leak_findings([log], [_clean(1)]) == []


def test_what_the_data_leave_open_is_named():
    model = _arm()
    log = _detective().prepared(_clean(0))
    frozen = Recording(
        log.joints,
        log.time,
        np.tile(log.position[0], (len(log), 1)),
        0 * log.velocity,
        0 * log.acceleration,
        log.torque,
    )
    (finding,) = rank_findings(build_regression(model, frozen), base_parameters(model))
    assert "of" in finding.statement
    assert rank_findings(build_regression(model, log), base_parameters(model)) == []


def test_findings_are_ranked_by_gravity():
    note = Finding("a", "note", "x", "s", "do")
    fault = Finding("b", "fault", "x", "s", "do")
    warning = Finding("c", "warning", "x", "s", "do")
    found = Diagnosis((note, warning, fault))
    assert [f.kind for f in found.findings] == ["b", "c", "a"]
    assert found.of("c") == (warning,)


ARM_URDF = """<robot name="arm">
<link name="base"/>
<link name="upper"><inertial><origin xyz="0.2 0.05 0"/><mass value="5"/>
<inertia ixx="0.05" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.15 0 0.05"/><mass value="3"/>
<inertia ixx="0.03" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="3" effort="200"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
<origin xyz="0.4 0 0"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" velocity="3" effort="200"/></joint>
</robot>"""


@pytest.mark.parametrize(("sign", "code"), [(1.0, 0), (-1.0, 1)])
def test_the_shell_checks_a_log_without_a_problem_file(tmp_path, capsys, sign, code):
    from consistent_id import load_urdf
    from consistent_id.cli import main

    (tmp_path / "arm.urdf").write_text(ARM_URDF)
    model = TorqueModel(load_urdf(tmp_path / "arm.urdf"), DRIVE)
    log = _detective().clean(model, np.random.default_rng(3)).log
    torque = log.torque * [1.0, sign]
    table = np.column_stack([log.time, log.position, torque])
    names = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow"
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=names, comments="")
    arguments = ["check", str(tmp_path / "arm.urdf"), str(tmp_path / "log.csv")]
    assert main(arguments) == code
    out = capsys.readouterr().out
    assert ("torque sign" in out and "elbow" in out) == (code == 1)
    assert main([*arguments, "--json"]) == code
