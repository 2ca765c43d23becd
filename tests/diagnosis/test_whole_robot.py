"""Clock, gain, zeros and base beside nominal bodies, on logs whose fault is known."""

from dataclasses import replace

import numpy as np
import pytest
from known_arm import OTHER_ROWS, arm, logged, pendulum
from robots import random_robot, random_states

from consistent_id import InertialParameters, Recording, TorqueModel, simulate_torque
from consistent_id.diagnosis import LogFinding, diagnose, whole_robot
from consistent_id.diagnosis.all_logs import _without_wrong_gains
from consistent_id.diagnosis.factor_findings import (
    FoundFactor,
    effects,
    factor_findings,
    gate_of,
    harm,
    hidden_factors,
    promising,
    worth_a_look,
)
from consistent_id.diagnosis.factor_rows import (
    HARM,
    Factor,
    FactorLogs,
    FactorRows,
    drives_share,
    factors_of,
    gain_of,
    joint_gains,
    leaning,
    least_costs,
    least_misfit,
    relative_noise,
    told_gains,
)
from consistent_id.diagnosis.whole_robot import (
    _distance_of_loaded,
    contradicted,
    doubted_gain,
    gain_beside_bodies,
    of_usual_size,
    other_robot,
    weighed_gain,
    whole_robot_factors,
    whole_robot_findings,
)
from consistent_id.problems.log_entries import motion_of_joints
from consistent_id.problems.statement_words import values
from consistent_id.robot.scaling import body_sizes, link_scales


def faulty(log, model, kind, place, size):
    """Return a log from which a factor of that size has to be taken out."""
    if kind == "clock":
        speed = np.exp(-size)
        log = replace(
            log,
            velocity=speed * log.velocity,
            acceleration=speed**2 * log.acceleration,
        )
    elif kind == "masses or gain":
        log = replace(log, torque=np.exp(size) * log.torque)
    elif kind == "torque gain":
        log = replace(log, torque=np.exp(size * (np.arange(4) == place)) * log.torque)
    elif kind == "offset zero":
        log = replace(log, position=log.position - size * (np.arange(4) == place))
    else:
        axis = [f.axis for f in factors_of(model) if f.kind == "gravity"][place]
        model = leaning(model, axis, -size)
    return model, log


_LITTLE = (0.2, 0.2, 0.0)
_GAIN = ("masses or gain", 0, np.log(1.4))
FAULTS = [
    ("clock", 0, np.log(2.0)),
    ("clock", 0, np.log(0.7)),
    _GAIN,
    ("masses or gain", 0, np.log(0.6)),
    ("offset zero", 1, np.radians(15.0)),
    ("offset zero", 2, np.radians(-20.0)),
    ("gravity", 0, np.radians(12.0)),
    ("gravity", 1, np.radians(-12.0)),
    ("torque gain", 1, np.log(1.3)),
    ("torque gain", 0, np.log(0.75)),
]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "place", "size"), FAULTS)
def test_a_fault_of_a_robot_as_drawn_is_measured_exactly(kind, place, size):
    model, log = logged(0, noise=0.0)
    found = whole_robot_factors(_as_is(*faulty(log, model, kind, place, size)))
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
    found = whole_robot_factors(_as_is(*faulty(log, model, kind, place, size)))
    best = next(f for f in found if f.ratio >= gate_of(f.factor))
    assert _is(best.factor, kind, place)
    if kind == "gravity":
        best, size = replace(best, size=abs(best.size)), abs(size)
    assert abs(best.size - size) <= 3.0 * best.error
    (finding,) = accusing(
        whole_robot_findings(_as_is(*faulty(log, model, kind, place, size)))
    )
    assert finding.kind == kind


def _is(factor, kind, place):
    """Return whether a factor is a fault; an axis may be its opposite."""
    of_joint = kind in ("offset zero", "torque gain")
    return factor.kind == kind and (not of_joint or factor.joint == place)


def accusing(found):
    """Return the findings that are no notes."""
    return [finding for finding in found if finding.severity != "note"]


def _as_is(model, log, *, masses_known=True):
    return FactorLogs.of(model, [log], masses_known=masses_known)


@pytest.mark.slow
def test_errors_are_those_of_robots_drawn_as_the_widths_say():
    """Of factors of clean logs, size over error has a root mean square of about one."""
    ratios = {}
    for seed in range(6):
        model, log = logged(100 + seed, spread=1.0)
        for found in whole_robot_factors(_as_is(model, log)):
            if np.isfinite(found.error):
                ratios.setdefault(found.factor.kind, []).append(found.ratio)
    assert {"clock", "masses or gain", "offset zero"} <= set(ratios)
    every = np.concatenate(list(ratios.values()))
    assert 0.5 < np.sqrt(np.mean(every**2)) < 1.3
    assert np.mean(every > 3.0) < 0.02


def test_a_clean_log_has_no_finding():
    model, log = logged(2, spread=0.7)
    assert accusing(whole_robot_findings(_as_is(model, log))) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_bodies_known_half_as_well_are_no_fault_of_the_log(seed):
    model, log = logged(seed, spread=2.0)
    assert accusing(whole_robot_findings(_as_is(model, log))) == []


@pytest.mark.slow
def test_free_masses_take_up_a_gain():
    model, log = logged(4, spread=0.5)
    _, log = faulty(log, model, "masses or gain", 0, np.log(1.4))
    (finding,) = accusing(whole_robot_findings(_as_is(model, log)))
    assert finding.kind == "masses or gain"
    free = _as_is(model, log, masses_known=False)
    assert accusing(whole_robot_findings(free)) == []


def test_what_is_no_factor_of_a_robot_is_left_out():
    model = arm()
    weightless = replace(model, robot=replace(model.robot, gravity=np.zeros(3)))
    kinds = [factor.kind for factor in factors_of(weightless)]
    assert "gravity" not in kinds
    assert len([k for k in kinds if k == "offset zero"]) == 4


@pytest.mark.slow
def test_the_log_of_a_robot_with_other_axes_is_another_robot_s():
    model, log = logged(5, spread=0.5, friction=_LITTLE)
    assert other_robot(_as_is(model, log)) == []
    (finding,) = other_robot(_as_is(arm(OTHER_ROWS), log))
    assert (finding.kind, finding.severity) == ("another robot", "fault")


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "place", "size"), FAULTS)
def test_one_fault_makes_no_other_robot(kind, place, size):
    model, log = logged(6, spread=0.5)
    assert other_robot(_as_is(*faulty(log, model, kind, place, size))) == []


@pytest.mark.slow
def test_a_diagnosis_names_another_robot_before_its_effects():
    _, log = logged(5, spread=0.5, friction=_LITTLE)
    assert diagnose(arm(OTHER_ROWS), [log]).findings[0].kind == "another robot"


@pytest.mark.slow
def test_torque_in_another_unit_makes_no_other_robot():
    model, log = logged(6, spread=0.5)
    far = _as_is(model, replace(log, torque=1e3 * log.torque))
    assert other_robot(of_usual_size(far)) == []
    (other,) = other_robot(of_usual_size(_as_is(arm(OTHER_ROWS), far.logs[0])))
    assert other.kind == "another robot"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "place", "size", "first"),
    [
        ("masses or gain", 0, np.log(100.0), {"torque gain", "torque unit"}),
        ("offset zero", 1, np.pi, {"offset zero"}),
        ("gravity", 0, np.pi, {"gravity"}),
    ],
)
def test_a_large_fault_that_explains_the_log_is_named_alone(kind, place, size, first):
    """However far bodies would be from the nominal ones without it."""
    model, log = logged(6, spread=0.5)
    model, log = faulty(log, model, kind, place, size)
    assert other_robot(_as_is(model, log)) != []
    found = diagnose(model, [log]).findings
    assert found[0].kind in first
    assert all(f.kind != "another robot" for f in found)


@pytest.mark.slow
def test_the_torque_of_one_motor_in_front_of_its_gear_makes_no_other_robot():
    model, log = logged(6, spread=0.5)
    torque = log.torque / np.where(np.arange(log.torque.shape[1]) == 1, 80.0, 1.0)
    log = replace(log, torque=torque)
    assert other_robot(_as_is(model, log)) != []
    found = diagnose(model, [log]).findings
    assert (found[0].kind, found[0].severity) == ("torque gain", "fault")
    assert all(f.kind != "another robot" for f in found)


def test_joints_with_a_wrong_gain_are_left_out_of_the_test_for_another_robot():
    model = arm()
    gain = LogFinding("torque gain", "fault", "joint2", "", "", 1.0, "log")
    # A fault of all joints, a doubt, another kind, and a fault of the nominal bodies.
    others = [
        replace(gain, where="all joints"),
        replace(gain, where="joint1", severity="warning"),
        replace(gain, where="joint3", kind="offset zero"),
        replace(gain, where="joint4", recording=""),
    ]
    left = _without_wrong_gains(model, [gain, *others])
    assert left.torque_joints == ("joint1", "joint3", "joint4")
    # Most gains are wrong by one cause, which may be another robot.
    more = [replace(gain, where=f"joint{k}") for k in (1, 2, 3)]
    assert len(_without_wrong_gains(model, more[:2]).torque_joints) == 2
    assert _without_wrong_gains(model, more) is model


@pytest.mark.slow
def test_a_load_of_negative_mass_explains_nothing():
    model, log = logged(5, spread=0.5)
    n = 10 * len(model.robot.links)
    last = np.zeros(n)
    last[-10] = 2.0
    lighter = _without_mass(model, log, last)
    assert np.isfinite(_distance_of_loaded(_as_is(model, log)))
    assert _distance_of_loaded(_as_is(model, lighter)) == np.inf


def _without_mass(model, log, bodies):
    """Return a log of a robot without some masses at its links' origins."""
    rigid = TorqueModel(model.robot)
    part = simulate_torque(rigid, bodies, replace(log, torque=None)).torque
    return replace(log, torque=log.torque - part)


def test_bodies_are_known_as_well_as_the_docs_say():
    as_is = _as_is(*logged(0))
    assert as_is.widths.tolist() == [0.05, 0.15, 0.30]


@pytest.mark.slow
def test_the_zero_of_a_pendulum_is_known_as_well_as_the_way_to_its_centre_of_mass():
    """A centre of mass beside the arm, by ``w`` of its length ``c``, turns it by w/c.

    Gravity tells the torque exactly, and a base that leans turns it alike.
    """
    model, log = pendulum(np.radians(42.0))
    found = {f.factor.kind: f for f in whole_robot_factors(_as_is(model, log))}
    (size,) = body_sizes(model.robot)
    for kind in ("offset zero", "gravity"):
        assert abs(found[kind].size) == pytest.approx(np.radians(42.0), rel=0.01)
        assert found[kind].error == pytest.approx(0.15 * size / 0.3, rel=0.01)
    (finding,) = accusing(whole_robot_findings(_as_is(model, log)))
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
    found = whole_robot_factors(_as_is(model, spoilt))
    (zero,) = (f for f in found if _is(f.factor, "offset zero", 1))
    assert abs(zero.size) < zero.error


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
    ("degrees", "severity"), [(0.0, None), (3.0, "warning"), (5.0, "fault")]
)
def test_a_base_that_leans_a_little_is_named(degrees, severity):
    model, log = logged(2, spread=0.5)
    axis = next(f.axis for f in factors_of(model) if f.kind == "gravity")
    leant = leaning(model, axis, -np.radians(degrees))
    found = accusing(whole_robot_findings(_as_is(leant, log)))
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
    found = whole_robot_factors(_as_is(*faulty(log, model, kind, place, size)))
    (fault,) = (f for f in found if _is(f.factor, kind, place))
    assert abs(fault.size - size) < 1.5 * fault.error


@pytest.mark.parametrize(
    ("kind", "times", "errors", "harm", "severity"),
    [
        ("offset zero", 2.1, 4.0, 0.05, "warning"),
        ("offset zero", 2.1, 6.0, 0.05, "fault"),
        # It would mean a tenth of the torque.
        ("offset zero", 2.1, 4.0, 0.10, "fault"),
        ("offset zero", 2.1, 4.0, 0.099, "warning"),
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


@pytest.mark.parametrize(
    ("gain", "errors", "explained", "named"),
    [
        (1.21, 5.1, 40.0, True),
        (0.82, 5.1, 40.0, True),
        (1.19, 9.0, 40.0, False),  # as small as errors of the model
        (1.21, 4.9, 40.0, False),  # friction may look like it
        (1.21, 5.1, 20.0, False),  # of 1000
        (3.1, 9.0, 40.0, False),  # a unit, or a joint that bodies hardly move
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
    assert [f.where for f in told_gains(_as_is(model, log))] == names
    # Joint 2 is swamped by viscous friction: its bodies are less than 30 % of it.
    rub = 100.0 * log.velocity[:, 1] * np.std(log.torque[:, 1])
    torque = log.torque + rub[:, None] * (np.arange(4) == 1)
    rubbed = replace(log, torque=torque)
    assert [f.where for f in told_gains(_as_is(model, rubbed))] == [
        name for name in names if name != names[1]
    ]


def test_gains_of_joints_that_explain_and_change_little_are_left_out():
    model, log = logged(0, noise=0.0)
    as_is = _as_is(model, log)
    second = gain_of(model, model.torque_joints[1])
    clock = FoundFactor(factors_of(model)[0], 1.0, 0.1, 0.1, explained=0.0)
    (unit,) = effects(as_is, [second])
    for size, explained, kept in (
        (0.11 / unit, 0.0, True),  # 11 % of the torque
        (-0.11 / unit, 0.0, True),
        (0.09 / unit, 29.0, False),
        (0.09 / unit, 31.0, True),  # of 1000
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
    assert harm(_as_is(model, wrong), factor, size) == pytest.approx(error, rel=0.1)


def test_the_effect_of_a_gain_is_all_torque():
    model, log = logged(0, noise=0.0)
    gain = factors_of(model)[1]
    one = gain_of(model, model.torque_joints[1])
    share = np.linalg.norm(log.torque[:, 1]) / np.linalg.norm(log.torque)
    assert effects(_as_is(model, log), [gain, one]) == pytest.approx([1.0, share], 0.01)


@pytest.mark.parametrize(("friction", "share"), [((0.0, 0.0, 0.0), 0.0), (None, 1.0)])
def test_the_share_of_drives_is_that_of_their_torque(friction, share):
    model, log = logged(0, noise=0.0, friction=friction or (50.0, 100.0, 0.0))
    assert drives_share(_as_is(model, log)) == pytest.approx(share, abs=0.05)


def test_what_bodies_may_hide_of_a_gain_is_its_error():
    model, log = pendulum(0.0)
    found = whole_robot_factors(_as_is(model, log))
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
    as_is = _as_is(*faulty(log, model, kind, place, size))
    best = whole_robot_factors(as_is)[0]
    assert _is(best.factor, kind, place)
    assert best.ratio > 10.0
    assert accusing(whole_robot_findings(as_is)) == []


@pytest.mark.slow
def test_a_clock_far_from_the_linear_makes_no_other_robot():
    model, log = logged(6, spread=0.1, noise=0.001)
    assert other_robot(_as_is(*faulty(log, model, "clock", 0, np.log(8.0)))) == []


@pytest.mark.slow
def test_a_robot_on_the_wall_is_no_other_robot():
    """Bodies of any kind leave much unexplained there, but the nominal ones fit."""
    model, log = logged(10, spread=0.02, noise=0.0005)
    as_is = _as_is(*faulty(log, model, "gravity", 1, np.radians(90.0)))
    assert least_misfit(as_is) > 0.2
    assert other_robot(as_is) == []


@pytest.mark.slow
def test_what_the_last_link_carries_makes_no_other_robot():
    """A large load and noise would, if the last link's body were taken for known."""
    model, log = logged(1, spread=0.5)
    load = InertialParameters.from_central(15.0, [0.3, 0.3, 0.4], 150.0 * np.eye(3))
    body = np.zeros(len(model.layout))
    body[30:40] = load.vector
    carrying = model.predict(body, log.position, log.velocity, log.acceleration)
    torque = log.torque + carrying
    noise = 0.11 * np.sqrt(np.mean(torque**2, axis=0))
    torque += noise * np.random.default_rng(0).normal(size=torque.shape)
    assert other_robot(_as_is(model, replace(log, torque=torque))) == []


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
    found = gain_beside_bodies(_as_is(model, log), model.torque_joints[0])
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
    right, finding = _as_is(model, log), _slope(joint, 0.7)
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
    note = weighed_gain(_slope("joint1", 0.7), _as_is(level, still))
    assert note.severity == "note"
    assert "do not show its gain" in note.statement


@pytest.mark.slow
def test_nominal_bodies_speak_against_a_zero_that_is_right():
    model, right = logged(3, spread=1.0)
    zero = next(f for f in factors_of(model) if f.joint == 2)
    size = np.radians(20.0)
    as_is = _as_is(model, right)
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
    assert doubted_gain(finding, _as_is(model, wrong)) == finding
    note = doubted_gain(finding, _as_is(model, right))
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
    (finding,) = accusing(whole_robot_findings(_as_is(model, spoilt)))
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
    """Steps of twice the way go to and fro for ever; longer ones go away."""
    truth, asked = 0.4, []

    def estimated(logs, factors):
        asked.append(logs.size)
        found = slope * (truth - logs.size) * (1.0 + 0.3 * logs.size)
        return [FoundFactor(factors[0], found, 0.05, 0.06, 1.0)]

    monkeypatch.setattr(whole_robot, "_estimated", estimated)
    found = whole_robot._converged_from(_Left(slope), Factor("clock", "time", 0.1))
    assert found.size == pytest.approx(truth, abs=0.03)
    assert len(asked) <= 6
