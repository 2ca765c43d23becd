"""Filtered torque: edges of friction that rows of samples miss accuse no log."""

from dataclasses import replace
from functools import cache
from gc import collect
from weakref import ref

import numpy as np
import pytest

from consistent_id import (
    DHRow,
    DriveTerms,
    InertialParameters,
    Recording,
    TorqueModel,
    from_modified_dh,
    low_passed,
    simulate_torque,
)
from consistent_id.diagnosis import diagnose
from consistent_id.diagnosis.all_logs import (
    _of_the_robot,
    _of_whole_robot,
)
from consistent_id.diagnosis.alternatives import gravity_in
from consistent_id.diagnosis.channel_factors import channel_factors, least_misfits
from consistent_id.diagnosis.contact_stretches import joint_residuals
from consistent_id.diagnosis.explain import (
    RUBS,
    datasheet_constraints,
    fitted_log,
    thinned,
)
from consistent_id.diagnosis.factor_logs import FactorLogs, factors_of, least_misfit
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.joint_shifts import corrected_shifts
from consistent_id.diagnosis.linearise import LEAST, linearised
from consistent_id.diagnosis.sample_rows import SampleRows
from consistent_id.diagnosis.torque_causes import lost_signs, residuals
from consistent_id.diagnosis.torque_parts import torque_parts
from consistent_id.regression.base import base_parameters
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.robot.model import Link

SHARP = DriveTerms(viscous=True, coulomb="sign")
SLENDER = np.diag([0.004, 0.02, 0.022])  # kg m^2 per kg
SMOOTH = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True)
CUTOFFS = [0.5, 2.0, 5.0]


@cache
def _run(drive=SHARP):
    """Return an arm with sharp friction, and its log without noise."""
    rows = [DHRow(0, 0, 0.3), DHRow(-np.pi / 2, 0), DHRow(0, 0.5, 0.1)]
    robot = from_modified_dh("arm", rows)
    centres = ([0, 0.02, -0.1], [0.2, 0, 0.1], [0, -0.1, 0.05])
    bodies = (
        InertialParameters.from_central(mass, centre, mass * SLENDER)
        for mass, centre in zip((8.0, 6.0, 4.0), centres, strict=True)
    )
    links = tuple(
        Link(link.name, body) for link, body in zip(robot.links, bodies, strict=True)
    )
    model = TorqueModel(replace(robot, links=links), drive)
    time = np.arange(3000) / 100.0
    rates = 2 * np.pi * np.array([0.07, 0.16, 0.31])[:, None] * [1.0, 1.1, 0.9]
    angle = time[:, None, None] * rates + np.arange(9).reshape(3, 3)
    motion = Recording(
        model.robot.joint_names,
        time,
        0.5 * np.sin(angle).sum(axis=1),
        0.5 * (rates * np.cos(angle)).sum(axis=1),
        -0.5 * (rates**2 * np.sin(angle)).sum(axis=1),
    )
    return model, simulate_torque(model, _truth(model), motion)


def _truth(model):
    bodies = np.ravel(model.robot.nominal)
    drives = [5.0, 12.0, 0.3][: (len(model.layout) - len(bodies)) // 3]
    return np.concatenate([bodies, drives * 3])


def _fitted(model, log):
    base = base_parameters(model)
    return fitted_log(model, log, datasheet_constraints(model), base)


@pytest.mark.parametrize("cutoff", CUTOFFS)
def test_rows_filtered_like_the_torque_explain_a_log_without_noise(cutoff):
    model, log = _run()
    smooth = low_passed(log, torque_cutoff=cutoff)
    (factors,) = channel_factors(model, base_parameters(model), [smooth])
    assert factors.least_misfit() < 1e-9
    as_is = _fitted(model, smooth)
    assert as_is.misfit < 1e-5  # of a cone programme
    assert as_is.least_likely < 1e-5


@pytest.mark.parametrize(
    "cutoff", [0.5, *(pytest.param(f, marks=pytest.mark.slow) for f in CUTOFFS[1:])]
)
def test_what_a_diagnosis_compares_with_a_filtered_torque_leaves_nothing(cutoff):
    model, log = _run()
    smooth, base = low_passed(log, torque_cutoff=cutoff), base_parameters(model)
    rows = SampleRows.of(model, smooth)
    assert np.array_equal(rows.motion.q, smooth.position)
    missed = rows.torque - rows.predicted(_truth(model))
    assert abs(missed).max() < 1e-9 * abs(rows.torque).max()
    linear = linearised(model, _truth(model), smooth, base)
    whole = linear.factors.whole  # of the torque over the joints' misfits
    assert abs(whole[:, -1]).max() < 1e-9 * np.sqrt(len(smooth) * 3) / LEAST
    assert least_misfit(FactorLogs.of(model, [smooth])) < 1e-9
    as_is = _fitted(model, smooth)
    assert max(r.energy for r in residuals(as_is)) < 1e-18
    every = np.ones(len(smooth), dtype=bool)
    assert max(abs(r.rest).max() for r in joint_residuals(as_is, every)) < 1e-9


@pytest.mark.parametrize("cutoff", CUTOFFS)
def test_slopes_on_the_nominal_model_are_one_behind_a_filter(cutoff):
    model, log = _run(SMOOTH)
    smooth = low_passed(log, torque_cutoff=cutoff)
    parts = torque_parts(model, smooth)
    np.testing.assert_allclose(parts.gravity[1:], 1.0, rtol=1e-7)  # the first is level
    np.testing.assert_allclose(parts.inertial, 1.0, rtol=1e-7)
    assert parts.rest.max() < 1e-9
    gravity = gravity_in(model, smooth)
    np.testing.assert_allclose(gravity, model.robot.gravity, atol=1e-7)


def test_rows_of_samples_would_miss_a_tenth_of_a_torque_behind_a_filter():
    model, log = _run()
    smooth = low_passed(log, torque_cutoff=CUTOFFS[0])
    bare = replace(smooth, torque_filter=None)
    assert _fitted(model, bare).misfit > 0.1


@pytest.mark.parametrize("first", range(4))
@pytest.mark.parametrize("most", [300, 700, 1100, 1500])
def test_a_log_with_gaps_keeps_its_rows_when_it_is_thinned(first, most):
    """Slow samples were left out: what is left is not evenly spaced any more."""
    model, log = _run(SMOOTH)
    log = low_passed(log, torque_cutoff=5.0)
    moving = np.flatnonzero(np.arange(len(log)) % 301 > 40)[first:]
    log = log.samples(moving)
    few = thinned(log, most)
    assert len(few) <= 1.02 * most
    rows, of_all = (len(motion_of(model, each, None).torque) for each in (few, log))
    # As many as there were, or one of each sample.
    assert rows >= 0.75 * min(of_all, len(few))


@pytest.mark.parametrize(
    ("where", "severity"),
    [(("late",), "note"), (("early", "late"), "fault"), (("early",), "fault")],
)
def test_a_coupling_that_only_validation_shows_is_a_note(where, severity):
    found = [
        LogFinding("coupling", "fault", "5, 6", "with a coupling", "", 2.0, log)
        for log in where
    ]
    said = _of_the_robot(found, {"early"})
    assert {f.severity for f in said} == {severity}
    lag = replace(found[0], kind="lag")
    assert _of_the_robot([lag], {"early"}) == [lag]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["position", "torque", "clock"])
def test_a_fault_is_taken_out_before_the_filter(kind):
    model, log = _run()
    faulty = {
        "position": replace(log, position=log.position - [0.0, 0.1, 0.0]),
        "torque": replace(log, torque=log.torque * [1.0, 1.3, 1.0]),
        "clock": replace(
            log, velocity=log.velocity / 1.2, acceleration=log.acceleration / 1.44
        ),
    }[kind]
    smooth = low_passed(faulty, torque_cutoff=1.0)
    assert _fitted(model, smooth).misfit > 1e-3
    if kind == "clock":
        state = FactorLogs.of(model, [smooth])
        factor = next(f for f in factors_of(model) if f.kind == "clock")
        (mended,) = state.without(factor, np.log(1.2)).logs
    else:
        shifts = {"position": [0, 0.1, 0, 0, 0, 0], "torque": [0, 0, 0, 0, 0.3, 0]}
        as_is = _fitted(model, smooth)
        mended = corrected_shifts(as_is, np.array(shifts[kind])).recording
    assert _fitted(model, mended).misfit < 1e-5


@pytest.mark.slow
def test_lost_signs_are_put_back_before_the_filter():
    model, log = _run()
    torque = np.array(log.torque)
    torque[:, 1] = abs(torque[:, 1])
    smooth = low_passed(replace(log, torque=torque), torque_cutoff=5.0)
    (found,) = lost_signs(_fitted(model, smooth))
    assert found.cause.where == model.torque_joints[1]
    assert found.factors.least_misfit() < 1e-9


def test_columns_of_drives_may_come_from_another_filtered_motion():
    model, log = _run()
    smooth = low_passed(log, torque_cutoff=2.0)
    base = base_parameters(model)
    own, other = channel_factors(model, base, [smooth] * 2, drives=[None, smooth])
    for A, B in zip(own.factors, other.factors, strict=True):
        assert np.allclose(A, B, rtol=0, atol=1e-12 * abs(A).max())


@pytest.mark.parametrize("cutoff", [None, 2.0])
def test_misfits_without_factors_are_those_of_the_factors(cutoff):
    model, log = _run()
    noise = np.random.default_rng(0).normal(size=log.torque.shape)
    rough = replace(log, torque=log.torque + noise)
    given = rough if cutoff is None else low_passed(rough, torque_cutoff=cutoff)
    few, base = given.samples(slice(0, 40)), base_parameters(model)
    logs, drives = [given, few, given], [None, None, given]
    by_factors = channel_factors(model, base, logs, drives=drives)
    found = least_misfits(model, base, logs, drives=drives)
    expected = [factors.least_misfit() for factors in by_factors]
    assert expected[0] > 1e-3
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)


def _kinds(model, log, cutoff):
    found = diagnose(
        model, log, prepare=lambda raw: low_passed(raw, torque_cutoff=cutoff)
    )
    return {f.kind for f in found.suspicious}


@pytest.mark.slow
@pytest.mark.parametrize("cutoff", CUTOFFS)
def test_a_clean_log_is_not_accused_for_its_filter(cutoff):
    assert not _kinds(*_run(), cutoff)


@pytest.mark.slow
def test_a_log_that_no_robot_explains_is_still_called_so_behind_a_filter():
    model, log = _run()
    swing = np.sin(2 * np.pi * 0.43 * log.time + np.arange(3)[:, None]).T
    spoilt = replace(log, torque=log.torque + log.torque.std(axis=0) * swing)
    assert "model does not explain" in _kinds(model, spoilt, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(("times", "named"), [(0.5, True), (20.0, False)])
def test_bodies_that_friction_hides_show_no_wrong_clock(times, named):
    model, log = _run()
    truth = _truth(model)
    truth[10 * len(model.robot) :] *= times
    log = simulate_torque(model, truth, replace(log, torque=None))
    rates = {"velocity": log.velocity / 2, "acceleration": log.acceleration / 4}
    as_is = _fitted(model, low_passed(replace(log, **rates), torque_cutoff=5.0))
    assert (as_is.friction < RUBS) == named
    found = [f.kind for f in _of_whole_robot([as_is]) if f.severity != "note"]
    assert found == ["clock"] * named


def test_what_is_kept_of_a_log_goes_with_it():
    model, log = _run()
    smooth = low_passed(log, torque_cutoff=5.0)
    rows = SampleRows.of(model, smooth)
    assert SampleRows.of(model, smooth).motion is rows.motion
    rows.regressor()
    motion_of(model, smooth, None).regressor(model)
    left = ref(smooth)
    del smooth, rows
    collect()
    assert left() is None
