"""Clock, gain, zeros and base beside nominal bodies, on logs whose fault is known."""

from dataclasses import replace

import numpy as np
import pytest
from known_arm import arm, logged, pendulum
from robots import random_robot, random_states
from spoilt_arm import FAULTS, accusing, factor_logs, faulty

from consistent_id import Recording, TorqueModel
from consistent_id.diagnosis import LogFinding, diagnose, whole_robot
from consistent_id.diagnosis.factor_findings import (
    FoundFactor,
    gate_of,
)
from consistent_id.diagnosis.factor_logs import (
    FactorLogs,
    factors_of,
    gain_of,
    leaning,
    least_costs,
)
from consistent_id.diagnosis.factor_rows import Factor, FactorRows, relative_noise
from consistent_id.diagnosis.whole_robot import (
    contradicted,
    doubted_gain,
    gain_beside_bodies,
    weighed_gain,
    whole_robot_factors,
    whole_robot_findings,
)
from consistent_id.problems.log_entries import motion_of_joints
from consistent_id.problems.statement_words import values
from consistent_id.robot.scaling import body_sizes, link_scales


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "place", "size"), FAULTS)
def test_a_fault_of_a_robot_as_drawn_is_measured_exactly(kind, place, size):
    model, log = logged(0, noise=0.0)
    found = whole_robot_factors(factor_logs(*faulty(log, model, kind, place, size)))
    best = found[0]
    assert _is(best.factor, kind, place)
    found_size = abs(best.size) if kind == "gravity" else best.size
    assert found_size == pytest.approx(abs(size) if kind == "gravity" else size, 0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "place", "size"), FAULTS)
def test_the_fault_explains_most_where_bodies_differ_from_the_drawing(
    kind, place, size
):
    model, log = logged(1, spread=0.5)
    found = whole_robot_factors(factor_logs(*faulty(log, model, kind, place, size)))
    best = next(f for f in found if f.ratio >= gate_of(f.factor))
    assert _is(best.factor, kind, place)
    if kind == "gravity":
        best, size = replace(best, size=abs(best.size)), abs(size)
    assert abs(best.size - size) <= 3.0 * best.error
    (finding,) = accusing(
        whole_robot_findings(factor_logs(*faulty(log, model, kind, place, size)))
    )
    assert finding.kind == kind


def _is(factor, kind, place):
    """Return whether a factor is a fault; an axis may be its opposite."""
    of_joint = kind in ("offset zero", "torque gain")
    return factor.kind == kind and (not of_joint or factor.joint == place)


@pytest.mark.slow
def test_errors_are_those_of_robots_drawn_as_the_widths_say():
    """Of factors of clean logs, size over error has a root mean square of about one."""
    ratios = {}
    for seed in range(6):
        model, log = logged(100 + seed, spread=1.0)
        for found in whole_robot_factors(factor_logs(model, log)):
            if np.isfinite(found.error):
                ratios.setdefault(found.factor.kind, []).append(found.ratio)
    assert {"clock", "masses or gain", "offset zero"} <= set(ratios)
    every = np.concatenate(list(ratios.values()))
    assert 0.5 < np.sqrt(np.mean(every**2)) < 1.3
    assert np.mean(every > 3.0) < 0.02


def test_a_clean_log_has_no_finding():
    model, log = logged(2, spread=0.7)
    assert accusing(whole_robot_findings(factor_logs(model, log))) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_bodies_known_half_as_well_are_no_fault_of_the_log(seed):
    model, log = logged(seed, spread=2.0)
    assert accusing(whole_robot_findings(factor_logs(model, log))) == []


@pytest.mark.slow
def test_free_masses_take_up_a_gain():
    model, log = logged(4, spread=0.5)
    _, log = faulty(log, model, "masses or gain", 0, np.log(1.4))
    (finding,) = accusing(whole_robot_findings(factor_logs(model, log)))
    assert finding.kind == "masses or gain"
    free = factor_logs(model, log, masses_known=False)
    assert accusing(whole_robot_findings(free)) == []


def test_what_is_no_factor_of_a_robot_is_left_out():
    model = arm()
    weightless = replace(model, robot=replace(model.robot, gravity=np.zeros(3)))
    kinds = [factor.kind for factor in factors_of(weightless)]
    assert "gravity" not in kinds
    assert len([k for k in kinds if k == "offset zero"]) == 4


def test_bodies_are_known_as_well_as_the_docs_say():
    as_is = factor_logs(*logged(0))
    assert as_is.widths.tolist() == [0.05, 0.15, 0.30]


@pytest.mark.slow
def test_the_zero_of_a_pendulum_is_known_as_well_as_the_way_to_its_centre_of_mass():
    """A centre of mass beside the arm, by ``w`` of its length ``c``, turns it by w/c.

    Gravity tells the torque exactly, and a base that leans turns it alike.
    """
    model, log = pendulum(np.radians(42.0))
    found = {f.factor.kind: f for f in whole_robot_factors(factor_logs(model, log))}
    (size,) = body_sizes(model.robot)
    for kind in ("offset zero", "gravity"):
        assert abs(found[kind].size) == pytest.approx(np.radians(42.0), rel=0.01)
        assert found[kind].error == pytest.approx(0.15 * size / 0.3, rel=0.01)
    (finding,) = accusing(whole_robot_findings(factor_logs(model, log)))
    assert finding.severity == "fault"  # whichever of both it is
    for cause in ("the base leans by 42 ", "with +42 (", "; or "):
        assert cause in finding.statement


def test_noise_that_stays_for_eight_samples_counts_eight_times():
    model, log = logged(8, noise=0.0)
    rng = np.random.default_rng(0)
    white = rng.normal(size=log.torque.shape)
    found = []
    for noise in (white, np.repeat(white[:75], 8, axis=0)):
        noisy = replace(log, torque=log.torque + 0.05 * noise)
        size = np.sqrt(np.mean(noisy.torque**2, axis=0))
        found.append(relative_noise(FactorRows(model, [noisy])) * size)
    assert found[0] == pytest.approx(np.full(4, 0.05), rel=0.2)
    assert found[1] == pytest.approx(np.full(4, 0.05 * np.sqrt(8.0)), rel=0.3)


def test_one_odd_second_makes_a_factor_doubtful():
    """The likelihood alone would be surer than that."""
    model, log = logged(7)
    odd = np.ones(600)
    odd[330:360] = 1.5
    spoilt = replace(log, torque=log.torque * odd[:, None])
    found = whole_robot_factors(factor_logs(model, spoilt))
    (zero,) = (f for f in found if _is(f.factor, "offset zero", 1))
    assert abs(zero.size) < zero.error


@pytest.mark.slow
@pytest.mark.parametrize(
    ("degrees", "severity"), [(0.0, None), (3.0, "warning"), (5.0, "fault")]
)
def test_a_base_that_leans_a_little_is_named(degrees, severity):
    model, log = logged(2, spread=0.5)
    axis = next(f.axis for f in factors_of(model) if f.kind == "gravity")
    leant = leaning(model, axis, -np.radians(degrees))
    found = accusing(whole_robot_findings(factor_logs(leant, log)))
    named = [] if severity is None else [("gravity", severity)]
    assert [(f.kind, f.severity) for f in found] == named


@pytest.mark.slow
def test_a_factor_that_logs_contradict_is_no_factor_of_the_robot():
    """What only a part of the motion shows is something else."""
    model, right = logged(4, noise=0.0)
    _, wrong = faulty(right, model, "clock", 0, np.log(1.3))
    first, second = slice(0, 150), slice(150, 600)

    def kinds(*logs):
        as_is = FactorLogs.of(model, logs, masses_known=True)
        found = accusing(whole_robot_findings(as_is))
        return [finding.kind for finding in found]

    assert kinds(wrong.samples(first), wrong.samples(second)) == ["clock"]
    assert "clock" not in kinds(right.samples(first), wrong.samples(second))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "place", "size"),
    [("clock", 0, np.log(2.0)), ("offset zero", 1, np.radians(15.0))],
)
def test_bodies_known_worse_pull_less(kind, place, size):
    model, log = logged(3, spread=6.0)
    found = whole_robot_factors(factor_logs(*faulty(log, model, kind, place, size)))
    (fault,) = (f for f in found if _is(f.factor, kind, place))
    assert abs(fault.size - size) < 1.5 * fault.error


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "place", "size"),
    [
        ("offset zero", 1, np.radians(4.0)),
        ("clock", 0, np.log(1.1)),
        ("clock", 0, np.log(14.0)),
    ],
)
def test_a_factor_too_small_or_too_large_is_sure_and_not_reported(kind, place, size):
    model, log = logged(6, spread=0.1, noise=0.001)
    as_is = factor_logs(*faulty(log, model, kind, place, size))
    best = whole_robot_factors(as_is)[0]
    assert _is(best.factor, kind, place)
    assert best.ratio > 10.0
    assert accusing(whole_robot_findings(as_is)) == []


def test_limbs_that_share_no_column_cost_what_they_cost_together():
    _, robot = random_robot(np.random.default_rng(5), 4, tree=True)
    model, rng = TorqueModel(robot), np.random.default_rng(1)
    q, dq, ddq = random_states(rng, 4, 150)
    torque = model.predict(robot.nominal, q, dq, ddq) + rng.normal(size=q.shape)
    log = Recording(robot.joint_names, np.arange(150) / 100, q, dq, ddq, torque)
    state = FactorLogs.of(model, [log])
    assert len(state.rows.groups) > 1
    w = 1.0 / (state.noise * np.sqrt(np.mean(torque**2, axis=0)))
    A = np.vstack([Y.T * k for Y, k in zip(state.rows.columns, w, strict=True)])
    z, bodies = (torque * w).T.ravel(), robot.nominal
    m, d = link_scales(robot).mass, body_sizes(robot)
    mass, centre, moment = state.widths
    width = np.column_stack([mass * m, *[centre * m * d] * 3, *[moment * m * d**2] * 6])
    pull = np.eye(len(bodies), A.shape[1]) / width.ravel()[:, None]
    for found, rows, torques in zip(
        least_costs(state),
        (np.vstack([A, pull]), A),
        (np.append(z, bodies / width.ravel()), z),
        strict=True,
    ):
        left = torques - rows @ np.linalg.lstsq(rows, torques, rcond=1e-9)[0]
        assert found == pytest.approx(left @ left, rel=1e-6)


def test_the_gain_of_a_pendulum_is_known_as_well_as_its_centre_of_mass():
    """Gravity tells the first moment exactly; a rotor may add to the inertia."""
    model, log = pendulum(0.0)
    log = replace(log, torque=0.6 * log.torque)
    found = gain_beside_bodies(factor_logs(model, log), model.torque_joints[0])
    (size,) = body_sizes(model.robot)
    assert np.exp(found.size) == pytest.approx(0.6, rel=0.01)
    assert found.error == pytest.approx(0.15 * size / 0.3, rel=0.01)


def _slope(joint, gain):
    words = f"{joint}: both parts are {gain:.2f} times the model's"
    advice, size = "check the gain", f"{gain:.3g}"
    return LogFinding("torque gain", "warning", joint, words, advice, size=size)


@pytest.mark.slow
@pytest.mark.parametrize("place", [1, 2])
def test_the_gain_of_one_joint_is_seen_beside_the_other_joints(place):
    model, log = logged(1, spread=0.5)
    joint = model.torque_joints[place]
    right, finding = factor_logs(model, log), _slope(joint, 0.7)
    note = weighed_gain(finding, right)
    assert (note.severity, note.where) == ("note", joint)
    assert "a gain of 1.0" in note.statement
    wrong = right.without(gain_of(model, joint), np.log(1 / 0.7))
    assert weighed_gain(finding, wrong) == finding
    # A slope above one is none of a gain below one.
    assert weighed_gain(_slope(joint, 1.4), wrong).severity == "note"


def test_a_joint_that_moves_no_body_shows_no_gain():
    model, log = logged(1)
    level = replace(model, robot=replace(model.robot, gravity=np.zeros(3)))
    still = replace(log, velocity=0.0 * log.velocity, acceleration=0.0 * log.position)
    note = weighed_gain(_slope("joint1", 0.7), factor_logs(level, still))
    assert note.severity == "note"
    assert "do not show its gain" in note.statement


@pytest.mark.slow
def test_nominal_bodies_speak_against_a_zero_that_is_right():
    model, right = logged(3, spread=1.0)
    zero = next(f for f in factors_of(model) if f.joint == 2)
    size = np.radians(20.0)
    as_is = factor_logs(model, right)
    moved = as_is.without(zero, size)
    assert contradicted(as_is, moved)
    assert not contradicted(moved, as_is)


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.7, 1.3])
def test_a_gain_of_all_joints_is_doubted_where_bodies_speak_against_it(gain):
    model, right = logged(3, spread=1.0)
    finding = LogFinding(
        "torque gain", "fault", "all joints", "seen", "check", size=f"{gain:.3g}"
    )
    _, wrong = faulty(right, model, "masses or gain", 0, np.log(gain))
    assert doubted_gain(finding, factor_logs(model, wrong)) == finding
    note = doubted_gain(finding, factor_logs(model, right))
    assert (note.severity, note.kind) == ("note", "torque gain")
    assert "bodies would then be farther" in note.statement


@pytest.mark.slow
def test_a_coarse_encoder_matters_where_a_log_is_fitted():
    model, log = logged(2, spread=0.5)
    coarse = replace(log, name="coarse", position=np.round(log.position / 0.02) * 0.02)

    def severities(*logs):
        found = diagnose(model, logs[0], logs[1:]).findings
        return {f.severity for f in found if f.kind == "encoder resolution"}

    assert severities(coarse, log) == {"warning"}
    assert severities(log, coarse) == {"note"}


@pytest.mark.slow
def test_the_printed_option_takes_a_zero_back():
    model, log = logged(0)
    _, spoilt = faulty(log, model, "offset zero", 1, np.radians(15.0))
    (finding,) = accusing(whole_robot_findings(factor_logs(model, spoilt)))
    _, option = finding.advice.split("--position-offset ")
    read = motion_of_joints(
        spoilt,
        wraps="keep",
        scale=None,
        offset=values("--position-offset JOINT=VALUE")([option]),
        coupled=None,
    )
    np.testing.assert_allclose(read.position, log.position, atol=np.radians(2.0))


class _Left:
    """Logs of which a known amount of a factor is left."""

    def __init__(self, slope, size=0.0):
        self.slope, self.size = slope, size

    def without(self, factor, size):
        return _Left(self.slope, size)


@pytest.mark.parametrize("slope", [0.5, 0.9, 1.0, 1.6, 2.0, 2.5])
def test_a_factor_settles_though_steps_are_too_long(slope, monkeypatch):
    """Steps of twice the way go to and fro for ever; longer ones go away.

    Errors, which take most of the time, are computed once, of the last round.
    """
    truth, asked, weighed = 0.4, [], []

    def step(logs, factor):
        asked.append(logs.size)
        return slope * (truth - logs.size) * (1.0 + 0.3 * logs.size)

    def estimated(logs, factors):
        weighed.append(logs.size)
        return [FoundFactor(factors[0], 0.0, 0.05, 0.06, 1.0)]

    monkeypatch.setattr(whole_robot, "_step", step)
    monkeypatch.setattr(whole_robot, "estimated", estimated)
    found = whole_robot._converged_from(_Left(slope), Factor("clock", "time", 0.1))
    assert found.size == pytest.approx(truth, abs=0.03)
    assert (found.error, found.cautious) == (0.05, 0.06)
    assert len(asked) <= 6 and weighed == asked[-1:]
