"""Corrections after preparation, and from compressed factors, against the slow way."""

import re
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from faulty_logs import arm, at_samples, clean_case, clean_log, logs
from some_fast import some_fast

from consistent_id import build_regression
from consistent_id.diagnosis import diagnose
from consistent_id.diagnosis.alternatives import _row_misfits
from consistent_id.diagnosis.channel_factors import channel_factors
from consistent_id.diagnosis.corrections import FAULT_KINDS, corrections
from consistent_id.diagnosis.explain import (
    corrected,
    datasheet_constraints,
    explanations,
    fitted_log,
)
from consistent_id.estimation.best_fit import best_fit
from consistent_id.problems.file import PreparationTable
from consistent_id.problems.log_entries import motion_of_joints
from consistent_id.problems.preparation import prepared
from consistent_id.problems.statement_words import values
from consistent_id.regression import base_parameters
from consistent_id.robot.model import Mimic

JOINTS = ("joint1", "joint2", "joint3", "joint4")

# As in the problem folders, and what else a problem file can ask for.
PREPARATIONS = {
    "resampled": {"resample": 190.0, "motion_cutoff": 7.5, "torque_cutoff": 10.0},
    "as logged": {"motion_cutoff": 20.0, "torque_cutoff": 20.0},
    "decimated": {"motion_cutoff": 40.0, "torque_cutoff": 40.0, "decimate": 4},
    "polynomials": {"method": "savitzky-golay", "window": 0.2, "torque_cutoff": 10.0},
    "smoother": {"method": "smoother", "order": 4, "torque_cutoff": 10.0},
    "series": {"method": "fourier", "period": 10.0, "harmonics": 5},
    "delayed": {"delays": {"velocity": 0.003}, "motion_cutoff": 8.0},
    "trimmed": {"motion_cutoff": 8.0, "trim_standstill": True},
}


_OF_SUMS = 0.02  # error of a correction that adds channels, over their norm


def _exchanged(values, i, j):
    values = values.copy()
    values[:, [i, j]] = values[:, [j, i]]
    return values


def _by_hand(correction, log):
    """Return the raw log without a fault, each kind written out."""
    kind, channels = correction.fault.kind, correction.fault.channels
    places = [JOINTS.index(n) for n in correction.where.split(", ") if n in JOINTS]
    moving = [c for c in ("position", "velocity") if getattr(log, c) is not None]
    if kind == "channel order":
        names = ["torque"] if channels != "motion" else []
        names += moving if channels != "torque" else []
        return replace(log, **{n: _exchanged(getattr(log, n), *places) for n in names})
    if kind == "coupled drives":
        (i, j), sign = places, correction.change.size
        changed = {n: getattr(log, n).copy() for n in (*moving, "torque")}
        changed["torque"][:, i] += sign * log.torque[:, j]
        for n in moving if channels == "both" else ():
            changed[n][:, j] -= sign * getattr(log, n)[:, i]
        return replace(log, **changed)
    if kind in ("degrees", "position sign", "encoder scale"):
        scale = np.ones(len(JOINTS))
        size = {"degrees": np.pi / 180, "position sign": -1.0}
        scale[places or slice(None)] = size.get(kind, correction.change.size)
        return replace(log, **{n: getattr(log, n) * scale for n in moving})
    if kind == "offset zero":
        position = log.position.copy()
        position[:, places] += np.radians(correction.change.size)
        return replace(log, position=position)
    torque = log.torque.copy()
    if kind == "torque sign":
        torque[:, places or slice(None)] *= -1.0
    else:
        assert kind == "torque unit"
        torque *= {"kN m": 1e3, "N mm": 1e-3}[correction.change.unit]
    return replace(log, torque=torque)


@pytest.mark.slow
@pytest.mark.parametrize("name", some_fast(PREPARATIONS, 2))
def test_a_correction_of_a_prepared_log_is_the_prepared_log_corrected(name):
    table = PreparationTable(**PREPARATIONS[name])
    log = clean_log(0).samples(slice(0, 2200))  # more than the longest period
    log = log if name == "delayed" else replace(log, velocity=None)
    tried = corrections(arm().robot, JOINTS)
    # What a second derivative loses to rounding, where a constant is added before.
    tolerance = 1e-8
    if name == "smoother":  # is slow, and stops its search for the noise at 1e-6 or so
        log, tolerance = log.samples(slice(0, 600)), 1e-5
        tried = list({c.fault: c for c in tried}.values())
    (once,) = prepared(log, table)
    for correction in tried:
        (slow,) = prepared(_by_hand(correction, log), table)
        fast = correction.applied(once)
        assert len(fast) == len(slow)
        for channel in ("position", "velocity", "acceleration", "torque"):
            expected = getattr(slow, channel)
            size = tolerance * abs(expected).max(axis=0)
            error = abs(getattr(fast, channel) - expected)
            if correction.fault.kind == "coupled drives":
                # Ends, and noise, are those of each channel, and not of their sum.
                assert np.linalg.norm(error) <= _OF_SUMS * np.linalg.norm(expected)
                continue
            assert (error <= size).all(), (correction.statement, channel)


@pytest.mark.parametrize(
    "measured", [("joint2", "joint4"), pytest.param(JOINTS, marks=pytest.mark.slow)]
)
def test_factors_with_changed_torque_are_those_of_the_changed_log(measured):
    model = replace(arm(), torque_joints=measured)
    log, base = at_samples(clean_log(1)), base_parameters(model)
    (factors,) = channel_factors(model, base, [log])
    x = np.random.default_rng(0).normal(size=len(model.layout))
    kinds = set()
    for correction in corrections(model.robot, measured):
        if correction.fault.channels != "torque":
            continue
        kinds.add(correction.fault.kind)
        changed = factors.changed(correction.change.matrix)
        slow = build_regression(model, _by_hand(correction, log))
        slow = slow.weighted(slow.torque_rms)
        fast = changed.regression()
        np.testing.assert_allclose(fast.sigma, slow.sigma, rtol=1e-12)
        np.testing.assert_allclose(
            fast.residual_rms(x), slow.residual_rms(x), rtol=1e-9
        )
        R = slow.stacked()
        fit = np.linalg.lstsq(R[:, :-1], R[:, -1])[0]
        least = np.linalg.norm(R[:, :-1] @ fit - R[:, -1]) / np.sqrt(sum(slow.counts))
        assert changed.least_misfit() == pytest.approx(least, rel=1e-6)
    drives = {"coupled drives"} if measured == JOINTS else set()
    assert kinds == {"torque sign", "channel order", "torque unit"} | drives


@pytest.mark.slow
def test_motions_compressed_together_are_those_compressed_alone():
    model, log = arm(), at_samples(clean_log(1))
    base = base_parameters(model)
    few = [
        c.applied(log)
        for c in corrections(model.robot, JOINTS)
        if c.fault.channels == "motion"
    ][:7]
    for motion, found in zip(few, channel_factors(model, base, few), strict=True):
        alone = build_regression(model, motion)
        x = np.random.default_rng(1).normal(size=len(model.layout))
        np.testing.assert_allclose(
            found.regression().residual_rms(x), alone.residual_rms(x), rtol=1e-9
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault",
    [
        "torque channels exchanged",
        "torque in kN m",
        "position channels exchanged",
        "zero off by 90 degrees",
        None,
    ],
)
def test_bounds_lose_no_explanation_that_trying_all_would_find(fault):
    model, case = arm(), clean_case(6)
    if fault is not None:
        case = logs().FAULTS[fault][1](case, np.random.default_rng(2))
    raw, base = case.log, base_parameters(model)
    known = datasheet_constraints(model)

    def misfit(log):
        regression = build_regression(model, at_samples(log))
        weighted = regression.weighted(regression.torque_rms)
        fit = best_fit(model, weighted, known, base=base)
        return fit.misfit / np.sqrt(sum(weighted.counts))

    as_is = misfit(raw)
    left = {
        (c.fault.kind, c.where, c.statement): misfit(_by_hand(c, raw))
        for c in corrections(model.robot, JOINTS)
    }
    thresholds = {c.fault.threshold for c in corrections(model.robot, JOINTS)}
    log = fitted_log(model, at_samples(raw), known, base)
    assert log.misfit == pytest.approx(as_is, rel=1e-6)
    candidates = corrected(log, corrections(model.robot, JOINTS))
    found = explanations(log, candidates, noise=0.0)
    if fault is None:
        assert min(left.values()) > as_is / min(thresholds)
        assert found.tried == ()
        return
    best = found.tried[0]
    c = best.cause
    assert (c.kind, c.where, c.statement) == min(left, key=left.get)
    assert best.misfit == pytest.approx(min(left.values()), rel=1e-4)


@pytest.mark.slow
def test_each_log_is_prepared_as_it_is_and_with_one_reading_changed():
    calls = []

    def prepare(log):
        calls.append(log.name)
        return logs().prepared(log)

    other = replace(clean_log(1), name="other")
    diagnose(arm(), clean_log(0), [other], prepare=prepare)
    assert calls == 2 * [clean_log(0).name] + 2 * ["other"]


def test_every_kind_of_the_table_occurs_and_fills_its_sentences():
    found = corrections(arm().robot, JOINTS)
    assert {c.fault for c in found} == set(FAULT_KINDS)
    signs, scales, degrees = 4 + 1 + 4, 4 * 6 + 1, 1 + 4
    drives = 2 * 2 * 3  # two signs, with or without the motion, of joints in sequence
    assert len(found) == signs + 3 * 6 + 2 + scales + degrees + 12 + drives
    assert not any(mark in c.statement + c.advice for c in found for mark in "{}")
    pairs = [", ".join(pair) for pair in combinations(JOINTS, 2)]
    exchanged = [c.where for c in found if c.fault.kind == "channel order"]
    assert exchanged == 3 * pairs


def test_drives_are_coupled_with_the_joint_that_carries_them_beside_followers():
    robot = arm().robot
    follower = replace(robot.joints[1], mimic=Mimic("joint1", 0.5))
    turning = (robot.joints[0], follower, *robot.joints[2:])
    last = replace(robot.joints[3], kind="prismatic")
    for joints, coupled in (
        # The second link, which follows joint 1, carries joint 3.
        (turning, {"joint3, joint4"}),
        # A motor that turns a joint slides none.
        ((*robot.joints[:3], last), {"joint1, joint2", "joint2, joint3"}),
    ):
        other = replace(robot, joints=joints)
        found = corrections(other, other.joint_names)
        assert {c.where for c in found if c.fault.kind == "coupled drives"} == coupled
    part = corrections(robot, JOINTS[1:])
    assert not any(
        "joint1" in c.where for c in part if c.fault.kind == "coupled drives"
    )


@pytest.mark.parametrize(("sign", "turns"), [(1.0, "sum"), (-1.0, "difference")])
def test_channels_of_coupled_drives_become_those_of_their_joints(sign, turns):
    log = at_samples(clean_log(0))
    names = ("position", "velocity", "acceleration")
    moved = {name: getattr(log, name).copy() for name in names}
    for motion in moved.values():
        motion[:, 2] += sign * motion[:, 1]  # the motor turns with both joints
    torque = log.torque.copy()
    torque[:, 1] -= sign * torque[:, 2]  # so that both motors have the same power
    power = np.sum(log.torque * log.velocity, axis=1)
    np.testing.assert_allclose(np.sum(torque * moved["velocity"], axis=1), power)
    motors = replace(log, torque=torque, **moved)
    of_joints, of_torque = (
        next(
            c
            for c in corrections(arm().robot, JOINTS)
            if (c.fault.kind, c.fault.channels) == ("coupled drives", channels)
            and (c.where, c.change.size) == ("joint2, joint3", sign)
        )
        for channels in ("both", "torque")
    )
    assert f"turns by the {turns} of both angles" in of_joints.statement
    for name in (*names, "torque"):
        found = getattr(of_joints.applied(motors), name)
        np.testing.assert_allclose(found, getattr(log, name), atol=1e-12)
    done = "added to" if sign > 0.0 else "subtracted from"
    assert f"torque of joint3 {done} that of joint2" in of_torque.statement
    found = of_torque.applied(replace(log, torque=torque))
    np.testing.assert_allclose(found.torque, log.torque, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("moved", [False, True])
def test_the_log_of_a_motor_in_front_of_the_joint_before_is_one_of_coupled_drives(
    moved,
):
    log = clean_log(5)
    torque, motion = log.torque.copy(), {}
    torque[:, 1] -= torque[:, 2]  # the belt of joint 3 turns about joint 2
    for name in ("position", "velocity") if moved else ():
        motion[name] = getattr(log, name).copy()
        motion[name][:, 2] += motion[name][:, 1]
    coupled = replace(log, torque=torque, **motion)
    found = diagnose(arm(), coupled, prepare=logs().prepared)
    assert [(f.kind, f.where) for f in found.faults] == [
        ("coupled drives", "joint2, joint3")
    ]


def test_misfits_of_scaled_torques_are_those_of_the_torques_scaled():
    log, model = at_samples(clean_log(1)), arm()
    base = base_parameters(model)
    (factors,) = channel_factors(model, base, [log])
    scales = (0.01, 0.7, 1.0, 2.5)
    found = factors.least_misfits(scales)
    assert found.shape == (len(model.torque_joints), len(scales))
    for j, row in enumerate(found):
        for scale, misfit in zip(scales, row, strict=True):
            gains = np.ones(len(found))
            gains[j] = scale
            whole = replace(log, torque=log.torque * gains)
            (anew,) = channel_factors(model, base, [whole])
            assert misfit == pytest.approx(anew.least_misfit(), rel=1e-9)


def test_a_column_whose_squares_underflow_explains_no_torque():
    """Such as that of a joint at rest, whose numerical velocity is 1e-285 rad/s."""
    factor = np.random.default_rng(4).normal(size=(30, 7))
    tiny = np.column_stack([factor[:, :1] * 1e-200, factor])
    np.testing.assert_allclose(_row_misfits(tiny, 5), _row_misfits(factor, 4))
    assert np.isfinite(_row_misfits(tiny * 1e-200, 5)).all()


def test_the_option_of_a_finding_is_its_correction():
    """The log, read with the printed option, is the corrected log."""
    log, seen = clean_log(0), set()
    for correction in corrections(arm().robot, JOINTS):
        option = re.search(r"--position-(scale|offset) (\S+=[^ )]+)", correction.advice)
        if option is None:
            continue
        stated = values("--position JOINT=VALUE")([option[2]])
        known = {"scale": None, "offset": None, option[1]: stated}
        read = motion_of_joints(log, wraps="keep", coupled=None, **known)
        expected = correction.applied(log)
        np.testing.assert_allclose(read.position, expected.position, rtol=1e-5)
        seen.add(correction.fault.kind)
    assert seen == {"position sign", "encoder scale", "degrees", "offset zero"}
