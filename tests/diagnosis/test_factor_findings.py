"""Which factors are named, from which gates, and what they do to an estimate."""

from dataclasses import replace

import numpy as np
import pytest
from known_arm import arm, logged, pendulum
from spoilt_arm import FAULTS, factor_logs, faulty

from consistent_id.diagnosis.clock_speeds import ClockSpeeds, _Left
from consistent_id.diagnosis.factor_findings import (
    FoundFactor,
    effects,
    factor_findings,
    harm,
    hidden_factors,
    promising,
    worth_a_look,
)
from consistent_id.diagnosis.factor_logs import (
    HARM,
    drives_share,
    factors_of,
    gain_of,
    joint_gains,
    told_gains,
)
from consistent_id.diagnosis.whole_robot import (
    whole_robot_factors,
)


@pytest.mark.parametrize(("kind", "shown"), [("offset zero", False), ("clock", True)])
def test_a_zero_that_leaves_nearly_all_unexplained_is_not_named(kind, shown):
    """Friction that varies with position looks like a zero, and not like a clock."""
    factor = next(f for f in factors_of(arm()) if f.kind == kind)
    size = 5.0 * factor.least
    little = FoundFactor(
        factor, size, size / 6.0, size / 6.0, explained=20.0, cost=1000.0
    )
    assert bool(factor_findings(arm(), [little])) == shown
    assert not factor_findings(arm(), [replace(little, explained=9.9)])
    assert factor_findings(arm(), [replace(little, explained=50.0)])
    # Where the drives take less, what makes an estimate harmful is named.
    harmful = replace(little, harm=HARM, drives=0.4)
    assert factor_findings(arm(), [harmful])
    assert bool(factor_findings(arm(), [replace(harmful, drives=0.6)])) == shown


@pytest.mark.parametrize(
    ("kind", "times", "errors", "harm", "severity"),
    [
        ("offset zero", 2.1, 4.0, 0.05, "warning"),
        ("offset zero", 2.1, 6.0, 0.05, "fault"),
        # With one more of four standard errors, it would mean a tenth of the torque.
        ("offset zero", 2.1, 4.0, 0.10, "fault"),
        ("offset zero", 2.1, 4.0, 0.081, "fault"),
        ("offset zero", 2.1, 4.0, 0.079, "warning"),
        ("clock", 2.1, 2.6, 0.17, "fault"),
        ("masses or gain", 1.9, 4.9, 0.30, "warning"),
        ("masses or gain", 1.9, 5.1, 0.30, "fault"),
        ("masses or gain", 2.1, 4.9, 0.30, "warning"),
        ("masses or gain", 2.1, 5.1, 0.30, "fault"),
    ],
)
def test_a_factor_is_a_fault_if_it_is_sure_or_likely_and_harmful(
    kind, times, errors, harm, severity
):
    factor = next(f for f in factors_of(arm()) if f.kind == kind)
    size = times * factor.least
    found = FoundFactor(factor, size, *[size / errors] * 2, 500.0, 1000.0, harm)
    (finding,) = factor_findings(arm(), [found])
    assert finding.severity == severity
    assert f"would be {harm:.0%} off in torque" in finding.statement
    only_then = harm < HARM <= harm * (1.0 + 1.0 / errors)
    assert ("with a standard error more" in finding.statement) == only_then


@pytest.mark.parametrize(
    ("gain", "errors", "explained", "named"),
    [
        (1.21, 5.1, 45.0, True),
        (0.82, 5.1, 45.0, True),
        (1.19, 9.0, 45.0, False),  # as small as errors of the model
        (1.21, 4.9, 45.0, False),  # friction may look like it
        (1.21, 5.1, 35.0, False),  # of 1000
        (3.1, 9.0, 45.0, False),  # a unit, or a joint that bodies hardly move
    ],
)
def test_a_joint_s_gain_is_named_from_its_gates(gain, errors, explained, named):
    factor, size = gain_of(arm(), arm().torque_joints[1]), float(np.log(gain))
    error = abs(size) / errors
    found = FoundFactor(factor, size, error, error, explained, 1000.0, 0.2)
    said = factor_findings(arm(), [found])
    assert bool(said) is named
    if named:
        assert (said[0].kind, said[0].severity) == ("torque gain", "fault")
        stated = f"if the torque of {factor.where} is {said[0].size} times the robot's"
        assert stated in said[0].statement
        assert said[0].size.startswith(f"{gain:.3g} +- ")
    assert not hidden_factors(arm(), [replace(found, doubt=1.0, size=0.01)])


@pytest.mark.parametrize(
    ("gains", "shown"),
    [
        ([0.03, 0.02, 0.03, 0.02, 0.01, 0.02], True),
        ([0.06, 0.05, 0.0, -0.01, 0.0, 0.01], False),  # of two joints
        ([0.17, 0.0, 0.0, -0.01, 0.0, 0.01], False),
        ([0.19, 0.0, 0.0, -0.01, 0.0, 0.01], True),  # but much
        ([-0.03, -0.02, -0.03, -0.02, -0.01, -0.02], False),
        ([0.02, 0.001], False),
        ([0.1, 0.07], True),
        ([0.1], True),
        ([0.01], False),
    ],
)
def test_a_clock_is_shown_by_all_joints_or_explains_much(gains, shown):
    speeds = object.__new__(ClockSpeeds)
    of_size = -np.array(gains)
    speeds._left = {0.0: _Left(0.0 * of_size, 1.0), 0.3: _Left(of_size, 1.0)}
    assert speeds.all_show(0.3) is shown


@pytest.mark.parametrize(
    ("gain", "errors", "looked_at"),
    [(1.3, 2.1, True), (1.3, 1.9, False), (1.19, 4.0, False), (3.1, 9.0, False)],
)
def test_a_joint_s_gain_is_looked_at_more_closely_from_its_gates(
    gain, errors, looked_at
):
    factor, size = gain_of(arm(), arm().torque_joints[1]), float(np.log(gain))
    found = FoundFactor(factor, size, 1.0, size / errors, 40.0)
    assert promising(found) is looked_at
    clock = factors_of(arm())[0]
    assert not promising(replace(found, factor=clock, size=1.0, cautious=0.41))
    assert promising(replace(found, factor=clock, size=0.01, cautious=0.0039))


def test_friction_tells_of_no_gain_of_a_joint():
    model, log = logged(0, noise=0.0)
    names = list(model.torque_joints)[:3]  # the last carries little
    assert [f.where for f in told_gains(factor_logs(model, log))] == names
    # Joint 2 is swamped by viscous friction: its bodies are less than 30 % of it.
    rub = 100.0 * log.velocity[:, 1] * np.std(log.torque[:, 1])
    torque = log.torque + rub[:, None] * (np.arange(4) == 1)
    rubbed = replace(log, torque=torque)
    assert [f.where for f in told_gains(factor_logs(model, rubbed))] == [
        name for name in names if name != names[1]
    ]


def test_gains_of_joints_that_explain_and_change_little_are_left_out():
    model, log = logged(0, noise=0.0)
    as_is = factor_logs(model, log)
    second = gain_of(model, model.torque_joints[1])
    clock = FoundFactor(factors_of(model)[0], 1.0, 0.1, 0.1, explained=0.0)
    (unit,) = effects(as_is, [second])
    for size, explained, kept in (
        (0.11 / unit, 0.0, True),  # 11 % of the torque
        (-0.11 / unit, 0.0, True),
        (0.09 / unit, 39.0, False),
        (0.09 / unit, 41.0, True),  # of 1000
    ):
        gain = FoundFactor(second, size, 0.01, 0.01, explained)
        left = worth_a_look(as_is, [gain, clock], 1000.0)
        assert left == ([gain, clock] if kept else [clock])


def test_a_robot_with_one_torque_has_no_gain_of_a_joint():
    model = arm()
    assert [f.where for f in joint_gains(model)] == list(model.torque_joints)
    one = replace(model, torque_joints=model.torque_joints[:1])
    assert joint_gains(one) == []


def test_a_rival_that_is_harmful_makes_a_fault():
    clock, gain = factors_of(arm())[:2]
    found = FoundFactor(clock, 0.3, 0.1, 0.1, 500.0, 1000.0, 0.05)
    rival = FoundFactor(gain, 0.5, 0.1, 0.1, 450.0, 1000.0, 0.4)
    (finding,) = factor_findings(arm(), [found, rival])
    assert (finding.kind, finding.severity) == ("clock", "fault")
    assert "would be 5% off in torque, or 40% with the other cause" in finding.statement
    (finding,) = factor_findings(arm(), [found, replace(rival, explained=300.0)])
    assert finding.severity == "warning"


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "place", "size"), FAULTS[:6])
def test_the_harm_of_a_factor_is_the_error_of_least_squares_from_its_log(
    kind, place, size
):
    """Fitted to the wrong log, the estimate predicts the right one."""
    model, right = logged(0, noise=0.0)
    _, wrong = faulty(right, model, kind, place, size)
    rows = model.regressor(wrong.position, wrong.velocity, wrong.acceleration)
    rows = np.concatenate(list(rows), axis=1).T
    x = np.linalg.lstsq(rows, wrong.torque.T.ravel(), rcond=1e-10)[0]
    said = model.predict(x, right.position, right.velocity, right.acceleration)
    error = np.linalg.norm(said - right.torque) / np.linalg.norm(right.torque)
    factor = next(
        f
        for f in factors_of(model)
        if f.kind == kind and (kind != "offset zero" or f.joint == place)
    )
    found = harm(factor_logs(model, wrong), factor, size)
    assert found == pytest.approx(error, rel=0.1)


def test_the_effect_of_a_gain_is_all_torque():
    model, log = logged(0, noise=0.0)
    gain = factors_of(model)[1]
    one = gain_of(model, model.torque_joints[1])
    share = np.linalg.norm(log.torque[:, 1]) / np.linalg.norm(log.torque)
    found = effects(factor_logs(model, log), [gain, one])
    assert found == pytest.approx([1.0, share], 0.01)


@pytest.mark.parametrize(("friction", "share"), [((0.0, 0.0, 0.0), 0.0), (None, 1.0)])
def test_the_share_of_drives_is_that_of_their_torque(friction, share):
    model, log = logged(0, noise=0.0, friction=friction or (50.0, 100.0, 0.0))
    assert drives_share(factor_logs(model, log)) == pytest.approx(share, abs=0.05)


def test_what_bodies_may_hide_of_a_gain_is_its_error():
    model, log = pendulum(0.0)
    found = whole_robot_factors(factor_logs(model, log))
    (gain,) = (f for f in found if f.factor.kind == "masses or gain")
    assert gain.doubt == pytest.approx(gain.cautious, rel=0.01)
    (finding,) = hidden_factors(model, [gain])
    assert finding.severity == "note"
    large = replace(
        gain, error=0.4, cautious=0.4, doubt=0.4
    )  # as where masses are free
    assert [f.severity for f in hidden_factors(model, [large])] == ["note"]
    said = (
        f"torques {np.exp(gain.cautious):.2f} times the robot's (an estimate is then "
    )
    assert f"{said}{gain.doubt:.0%} off in torque)" in finding.statement


@pytest.mark.parametrize("error", [5.0, 5e3])
def test_what_no_log_shows_may_have_any_size(error):
    """The exponential of such an error overflows."""
    clock, gain, zero = factors_of(arm())[:3]
    for factor, said in (
        (clock, "a clock of any speed (an estimate is then 30% off"),
        (gain, "torques of any size (an estimate"),
        (zero, f"any zero of {zero.where} (an estimate"),
    ):
        hidden = FoundFactor(factor, 0.0, error, error, 0.0, 1000.0, 0.0, 0.3)
        (finding,) = hidden_factors(arm(), [hidden])
        assert said in finding.statement


@pytest.mark.parametrize(
    ("size", "error", "doubt", "severity"),
    [
        (0.01, 0.2, 0.3, "warning"),
        (0.01, 0.2, 0.09, "note"),
        (0.01, 0.1, 0.3, "note"),  # of the clock's speed, 15 % would be reported
    ],
)
def test_a_hidden_factor_is_a_warning_if_it_should_be_reported_and_is_harmful(
    size, error, doubt, severity
):
    clock, gain = factors_of(arm())[:2]
    hidden = FoundFactor(clock, size, error, error, 0.0, 1000.0, 0.0, doubt)
    (finding,) = hidden_factors(arm(), [hidden])
    assert (finding.where, finding.severity) == ("time", severity)
    # Where a factor was found, errors of others contain it.
    found = FoundFactor(gain, 0.5, 0.1, 0.1, 900.0, 1000.0, 0.5, 0.1)
    (finding,) = hidden_factors(arm(), [hidden, found])
    assert finding.severity == "note"
    assert hidden_factors(arm(), [found]) == []
