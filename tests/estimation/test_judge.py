"""Verdicts: clean logs are used, faulty ones are not, and the reason is the cause."""

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from experiments import experiment, pendulum
from logged import DRIVE, URDF, moved

from consistent_id import (
    DriveTerms,
    FixedMasses,
    NonNegativeDrive,
    PhysicalConsistency,
    ProblemError,
    Recording,
    TorqueModel,
    build_regression,
    compare,
    constrained_least_squares,
    differentiated,
    huber,
    least_squares,
    low_passed,
    simulate_torque,
)
from consistent_id.estimation import judge, weighted_least_squares
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.fit import _excess, fit_of, usual_efforts
from consistent_id.estimation.slope_reasons import doubtful_joints, slope_reasons
from consistent_id.estimation.torque_error import Slopes, slopes_on
from consistent_id.estimation.verdict import WORDS, Verdict, confirmed
from consistent_id.export import to_json
from consistent_id.recordings.recording import LogFinding
from consistent_id.regression import GearCoupling, base_parameters
from consistent_id.regression.residual_noise import unconstrained_fit
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


def test_a_clean_log_is_used_by_ten_lines_of_python():
    verdict = verdict_of(log())
    assert (verdict.word, verdict.grounds) == ("use", ())
    assert verdict.sentence == "use: constrained"
    assert str(verdict) == "use"


def with_torque(change):
    """The log with another torque, changed before it is filtered."""
    return altered(log(), lambda raw: replace(raw, torque=change(raw.torque)))


def test_a_joint_s_reversed_torque_is_not_used_and_its_sign_is_named_first():
    verdict = verdict_of(with_torque(lambda torque: torque * [-1.0, 1.0]))
    assert verdict.word == "do not use"
    assert kinds(verdict)[0] == "torque sign"
    assert "shoulder -" in verdict.grounds[0].statement
    assert verdict.lines[-1].endswith("consistent-id help bad-result")


def test_all_torque_reversed_is_not_used():
    assert verdict_of(with_torque(np.negative)).word == "do not use"


@pytest.mark.parametrize("gain", [100.0, 0.01, 1.6])
def test_a_wrong_gain_is_not_simply_used(gain):
    verdict = verdict_of(with_torque(lambda torque: gain * torque))
    assert verdict.word != "use"
    assert "gain or unit" in kinds(verdict) or "torque channel" in kinds(verdict)


def test_torque_beyond_the_drive_s_limit_is_said():
    assert "effort limit" in kinds(verdict_of(with_torque(lambda tau: 100.0 * tau)))


def test_gravity_taken_out_of_the_channel_is_said():
    raw = log().torque_filter.source
    still = replace(raw, velocity=0 * raw.velocity, acceleration=0 * raw.acceleration)
    bodies = TorqueModel(model().robot)
    gravity = simulate_torque(bodies, model().robot.nominal, still).torque
    verdict = verdict_of(with_torque(lambda torque: torque - gravity))
    assert verdict.word == "do not use"
    assert {"torque channel", "nominal model"} & set(kinds(verdict))


def test_torque_that_has_nothing_to_do_with_the_motion_is_not_used():
    noise = np.random.default_rng(0).normal(size=log().torque.shape)
    verdict = verdict_of(with_torque(lambda _: noise))
    assert verdict.word == "do not use"
    assert "misfit" in kinds(verdict)


def test_a_negative_mass_is_never_used_and_says_so():
    good = constrained_least_squares(model(), build_regression(model(), log()))
    x = good.parameters.copy()
    x[0] *= -1.0
    verdict = replace(good, parameters=x).verdict
    assert verdict.word == "do not use"
    assert "inconsistent bodies" in kinds(verdict)


def test_a_body_without_mass_is_not_used():
    good = constrained_least_squares(model(), build_regression(model(), log()))
    x = good.parameters.copy()
    x[10:20] = 0.0
    assert "vanishing mass" in kinds(replace(good, parameters=x).verdict)


def test_a_negative_rotor_inertia_is_caught_by_the_mass_matrix():
    arm, _truth, recording = experiment(0, joints=2)
    good = constrained_least_squares(arm, build_regression(arm, recording))
    x = good.parameters.copy()
    x[list(arm.layout.drive_indices("rotor_inertia"))] = -1e3
    assert "mass matrix" in kinds(replace(good, parameters=x).verdict)


def test_findings_decide_and_can_be_accepted():
    good = constrained_least_squares(model(), build_regression(model(), log()))
    evidence = good.evidence()
    words = {}
    for severity in ("fault", "warning", "note"):
        found = LogFinding("clock", severity, "log", "seen", "mend it")
        words[severity] = judge(replace(evidence, findings=(found,))).word
    assert words == {"fault": WORDS[2], "warning": WORDS[1], "note": WORDS[0]}
    found = LogFinding("clock", "fault", "log", "seen", "mend it")
    accepted = judge(replace(evidence, findings=(found,), accepted=("clock",)))
    assert (accepted.word, accepted.accepted) == ("use", ("clock",))
    assert any("accepted by the user" in line for line in accepted.lines)


def test_an_error_above_predicting_nothing_is_never_used():
    good = constrained_least_squares(model(), build_regression(model(), log()))
    other = with_torque(np.negative)
    (report,) = compare([good], [other]).reports
    assert report.held_out_error > 1.0
    assert report.verdict.word == "do not use"
    assert "held-out error" in kinds(report.verdict)


def test_a_joint_that_rests_while_tested_does_not_decide():
    good = constrained_least_squares(model(), build_regression(model(), log()))
    error = compare([good], [log()]).reports[0].validation[0]
    quiet = replace(
        error, relative=np.array([0.01, 5.0]), torque=error.torque * [1.0, 1e-3]
    )
    assert judge(replace(good.evidence(), held_out=(quiet,))).word == "use"


def test_each_share_of_torque_says_of_which_joints_and_data_it_is():
    good = constrained_least_squares(model(), build_regression(model(), log()))
    error = compare([good], [log()]).reports[0].validation[0]
    fit = replace(good.fit, misfits=np.array([0.01, 0.41]), shares=np.ones(2))
    far = replace(error, stacked=0.31, stacked_beyond=0.31, beyond=0.45 * error.torque)
    evidence = replace(good.evidence(), fit=fit, held_out=(far,))
    joint = fit.joints[1]
    said = {reason.kind: reason.statement for reason in judge(evidence).grounds}
    assert said["misfit"] == f"training misfit of {joint}: 41 % of its RMS torque"
    assert said["held-out error"].startswith("held-out error of all joints: 31 %;")
    assert judge(evidence).sentence.startswith(
        f"use with care: constrained, held-out error 31 % (all joints, {log().name})"
    )
    # What friction can hold at rest is taken off the error that is judged.
    rests = replace(far, stacked_beyond=0.11)
    (said,) = (
        reason.statement
        for reason in judge(replace(evidence, held_out=(rests,))).grounds
        if reason.kind == "held-out error"
    )
    assert "beyond friction at rest: 45 % of its RMS torque" in said


def test_recordings_are_named_or_counted():
    names = ("a.csv", "b.csv", "c.csv")
    for count, said in ((0, ""), (1, ", a.csv"), (2, ", a.csv, b.csv")):
        verdict = Verdict("use", "x", (), (), 0.031, names[:count])
        assert verdict.sentence == f"use: x, held-out error 3.1 % (all joints{said})"
    verdict = Verdict("use", "x", (), (), 0.031, names)
    assert "(all joints, 3 recordings; least squares 46 %)" in verdict.compared(0.46)
    assert Verdict.from_dict(verdict.to_dict()) == verdict
    old = verdict.to_dict()
    del old["held_out_recordings"]
    assert Verdict.from_dict(old).recordings == ()


def test_an_unproven_optimum_asks_for_care():
    good = constrained_least_squares(model(), build_regression(model(), log()))
    doubted = replace(
        good, certificate=replace(good.certificate, verdict="uncertified")
    )
    assert kinds(doubted.verdict) == ["optimum not proven"]
    assert doubted.verdict.word == "use with care"


def test_a_contradicting_mass_is_said_by_the_excess():
    arm, _, recording = pendulum()
    regression = build_regression(arm, recording)
    wrong = constrained_least_squares(
        arm,
        regression,
        constraints=[PhysicalConsistency(), FixedMasses({"link1": 2.0})],
    )
    assert wrong.fit.excess == pytest.approx(1.0, abs=0.1) or wrong.fit.misfit < 0.02
    bounded = constrained_least_squares(
        model(),
        build_regression(model(), with_torque(lambda torque: 3.0 * torque)),
        constraints=[
            PhysicalConsistency(),
            FixedMasses(),
            NonNegativeDrive(),
        ],
    )
    assert bounded.verdict.word != "use"


def test_every_estimator_says_how_well_it_fits():
    arm, _, recording = experiment(1, joints=2, noise=0.05)
    regression = build_regression(arm, recording)
    estimates = (
        least_squares(arm, regression),
        weighted_least_squares(arm, regression),
        huber(arm, recording),
        constrained_least_squares(arm, regression),
    )
    for estimate in estimates:
        by_hand = np.linalg.norm(
            recording.torque - estimate.predict(recording)
        ) / np.linalg.norm(recording.torque)
        assert estimate.fit.misfit == pytest.approx(by_hand, rel=1e-6)
        assert estimate.fit.floor <= estimate.fit.misfit * (1 + 1e-9)


def test_slopes_and_shares_are_those_of_least_squares_on_the_samples():
    arm = TorqueModel(model().robot, DriveTerms(viscous=True))
    estimate = least_squares(arm, build_regression(arm, log()))
    bodies = TorqueModel(model().robot)
    raw = log().torque_filter.source
    nominal = simulate_torque(bodies, model().robot.nominal, raw).torque

    def rows(values):  # five per period of 10 Hz, of 100
        return low_passed(replace(raw, torque=values), torque_cutoff=10.0).torque[::2]

    expected, velocity = rows(nominal), rows(raw.velocity)
    for j in range(2):
        columns = np.column_stack([expected[:, j], velocity[:, j]])
        (slope, _), *_ = np.linalg.lstsq(columns, log().torque[::2, j], rcond=None)
        assert estimate.fit.slopes[j] == pytest.approx(slope, rel=1e-8)
    peak = abs(log().torque).max(axis=0)
    np.testing.assert_allclose(estimate.fit.efforts, peak / [90.0, 60.0])


def test_the_largest_torque_survives_cutting_and_merging():
    from consistent_id.regression import segment_regressions

    parts = segment_regressions(model(), log(), count=7)
    whole = sum(parts[1:], parts[0])
    np.testing.assert_array_equal(whole.peaks, abs(log().torque).max(axis=0))


def test_fit_and_acceptance_survive_the_file(tmp_path):
    good = constrained_least_squares(model(), build_regression(model(), log()))
    good = replace(good, accepted=("clock",))
    read = Estimate.load(good.save(tmp_path / "e.json"), good.model, good.base)
    assert read.fit.to_dict() == good.fit.to_dict()
    assert read.accepted == ("clock",)
    assert read.verdict == good.verdict


def test_a_file_is_json_whatever_figures_an_estimate_has(tmp_path):
    """JSON has no word for NaN and infinity [RFC 8259]."""
    good = constrained_least_squares(model(), build_regression(model(), log()))
    proof = good.certificate
    odd = replace(proof, figures={"known": 0.5, "none": np.nan, "endless": np.inf})
    file = replace(good, certificate=odd).save(tmp_path / "e.json")

    def refused(word):
        raise AssertionError(word)

    figures = json.loads(file.read_text(), parse_constant=refused)["certificate"]
    assert figures["figures"] == {"known": 0.5, "none": None, "endless": None}
    read = Estimate.load(file, good.model, good.base).certificate.figures
    assert read["known"] == 0.5
    assert np.isnan([read["none"], read["endless"]]).all()


def test_a_joint_that_rests_and_carries_nothing_has_any_slope():
    """Friction turns a slope of no torque by any amount, and nothing overflows."""
    estimate = least_squares(model(), build_regression(model(), log()))
    fit = replace(
        estimate.fit,
        moving=np.array([0.0, 1.0]),
        expected=np.array([0.0, 1.0]),
        holding=np.array([50.0, 50.0]),
    )
    assert "torque sign" not in [reason.kind for reason in slope_reasons(fit, None)]


def test_a_joint_at_rest_gets_no_boundless_friction():
    rng = np.random.default_rng(2)

    def held(recording):
        return replace(
            recording,
            position=recording.position * [1.0, 0.0],
            velocity=np.column_stack(
                [recording.velocity[:, 0], 1e-9 * rng.normal(size=len(recording))]
            ),
            acceleration=recording.acceleration * [1.0, 0.0],
        )

    still = altered(log(), held)
    estimate = constrained_least_squares(model(), build_regression(model(), still))
    assert abs(estimate["elbow.viscous"]) < 1e5


def test_a_verdict_of_who_knows_more_goes_with_the_estimate_into_its_file(tmp_path):
    good = constrained_least_squares(model(), build_regression(model(), log()))
    found = LogFinding("clock", "fault", "log", "seen", "mend it")
    (report,) = compare([good], [log()], findings=[found]).reports
    words = good.verdict.word, report.with_verdict.verdict.word
    assert words == ("use", "do not use")
    path = report.with_verdict.save(tmp_path / "e.json")
    read = Estimate.load(path, good.model, good.base)
    assert read.verdict == report.verdict
    with pytest.raises(ProblemError, match=r"do not use: constrained.*clock"):
        to_json(read)


def noisy(count, colour, seed=0):
    """A simulated log whose noise goes on for more samples the nearer colour is one."""
    rng = np.random.default_rng(seed)
    arm, truth, clean = experiment(seed, joints=2, samples=count)
    white = rng.normal(size=(count + 500, 2))
    for i in range(1, len(white)):
        white[i] = colour * white[i - 1] + np.sqrt(1.0 - colour**2) * white[i]
    noise = 0.02 * clean.torque.std(axis=0) * white[500:]
    smooth = np.arange(count)[:, None] / 100 * [1.0, 1.7]
    motion = replace(
        clean,
        position=np.sin(smooth),
        velocity=np.cos(smooth) * [1.0, 1.7],
        acceleration=-np.sin(smooth) * [1.0, 2.89],
    )
    motion = simulate_torque(arm, truth, motion)
    regression = build_regression(arm, replace(motion, torque=motion.torque + noise))
    return constrained_least_squares(
        arm, regression, constraints=[PhysicalConsistency(), NonNegativeDrive()]
    )


def said(verdict, kind):
    return [r for r in verdict.reasons if r.kind == kind]


def test_correlated_residuals_are_worth_knowing_and_change_no_verdict():
    white, coloured = noisy(4000, 0.0), noisy(4000, 0.9)
    assert not said(white.verdict, "correlated residuals")
    (reason,) = said(coloured.verdict, "correlated residuals")
    assert reason.word == "use"
    # Of slow motion 1 + 2 sum 0.9^k = 19 samples carry the information of one.
    assert coloured.fit.correlation == pytest.approx(19.0, rel=0.5)
    assert white.fit.correlation == pytest.approx(1.0, rel=0.3)


def test_few_independent_samples_ask_for_care():
    good = constrained_least_squares(model(), build_regression(model(), log()))
    few = replace(good, fit=replace(good.fit, spare=2.9, correlation=40.0))
    (reason,) = said(few.verdict, "few samples")
    assert (few.verdict.word, reason.word) == ("use with care", "use with care")
    assert "2.9 independent" in reason.statement


def test_data_against_all_bodies_are_worth_knowing_and_change_no_verdict():
    good = constrained_least_squares(model(), build_regression(model(), log()))
    evidence = replace(good.evidence(), contradicted="chi^2 rises by 80")
    verdict = judge(evidence)
    (reason,) = said(verdict, "physical consistency")
    assert (verdict.word, reason.statement) == ("use", "chi^2 rises by 80")


def test_an_estimate_of_an_older_file_has_no_figures_of_noise():
    good = constrained_least_squares(model(), build_regression(model(), log()))
    record = good.fit.to_dict()
    del record["spare"], record["correlation"]
    assert np.isnan(type(good.fit).from_dict(record).spare)


@pytest.mark.filterwarnings("error")
def test_columns_that_underflow_are_no_drive_terms():
    arm, truth, clean = experiment(0, joints=2, samples=300)
    still = clean.velocity.copy()
    still[:, 1] = 1e-170  # what a filter leaves of a joint at rest
    regression = build_regression(arm, replace(clean, velocity=still))
    free = unconstrained_fit(regression, base_parameters(arm))
    assert np.isfinite(fit_of(arm, free, truth).misfit)


def test_a_gain_that_masses_and_drives_both_deny_is_refused():
    verdict = verdict_of(with_torque(lambda torque: 100.0 * torque))
    assert (verdict.word, kinds(verdict)[0]) == ("do not use", "gain or unit")


def good_with(**figures):
    """The verdict on a clean log, with other figures of its fit."""
    good = constrained_least_squares(model(), build_regression(model(), log()))
    changed = {name: np.array(values) for name, values in figures.items()}
    return judge(replace(good.evidence(), fit=replace(good.fit, **changed)))


@pytest.mark.slow
def test_peaks_beyond_an_effort_limit_are_doubted_even_if_the_gain_is_confirmed():
    right = good_with(efforts=[2.0, 0.5], slopes=[1.02, 1.0])
    assert right.word == "use with care"
    (doubt,) = [r for r in right.reasons if r.kind == "effort limit"]
    assert "shoulder 1.02: peaks, perhaps outliers" in doubt.statement
    for slope in (1.2, 0.85, np.nan):
        doubt = good_with(efforts=[2.0, 0.5], slopes=[slope, 1.0]).grounds[-1]
        assert doubt.kind == "effort limit"
        assert "peaks" not in doubt.statement
    assert "effort limit" in kinds(
        good_with(efforts=[2.0, 2.0], explained=[1.0, 0.1], slopes=[1.0, 1.0])
    )


def test_peaks_of_few_samples_beyond_an_effort_limit_are_a_note():
    good = constrained_least_squares(model(), build_regression(model(), log()))
    fit = replace(good.fit, efforts=np.array([2.0, 0.5]))
    for usual, word in (([1.1, 0.5], "use"), ([1.3, 0.5], "use with care")):
        verdict = judge(
            replace(good.evidence(), fit=fit, usual_efforts=np.array(usual))
        )
        assert verdict.word == word
        assert "effort limit" in [r.kind for r in verdict.reasons]


def test_the_usual_torque_is_that_of_99_per_cent_of_the_known_samples():
    raw = log()
    spiky, tau = raw.torque.copy(), abs(raw.torque)
    spiky[[5, 50, 500], 0] = 1e3
    known = np.ones(tau.shape, dtype=bool)
    known[:40, 1] = False
    spiky[:40, 1] = 1e3
    logs = [replace(raw, torque=spiky, torque_known=known)]
    usual = usual_efforts(model(), logs) * [90.0, 60.0]
    assert np.quantile(tau[:, 0], 0.98) <= usual[0] <= tau[:, 0].max()
    moves = abs(raw.velocity[40:, 1]) >= 0.01 * abs(raw.velocity[:, 1]).max()
    assert usual[1] == pytest.approx(np.quantile(tau[40:, 1][moves], 0.99))
    assert usual_efforts(model(), []) is None


@pytest.mark.parametrize(
    ("share", "exceeds"), [(0.0, False), (0.005, False), (0.02, True)]
)
def test_long_rests_do_not_hide_torque_beyond_a_limit_in_motion(share, exceeds):
    raw = log()
    rests = 3 * len(raw.time)  # after the motion, at its last position
    torque = np.clip(raw.torque, -10.0, 10.0)
    fast = np.argsort(abs(raw.velocity[:, 0]))[::-1]
    torque[fast[: round(share * len(fast))], 0] = 200.0  # the limit is 90 N m
    step = raw.time[1] - raw.time[0]

    def held(channel, value):
        return np.concatenate([channel, np.broadcast_to(value, (rests, 2))])

    resting = Recording(
        raw.joints,
        raw.time[0] + step * np.arange(len(raw.time) + rests),
        held(raw.position, raw.position[-1]),
        held(raw.velocity, 0.0),
        torque=held(torque, 1.0),
    )
    for logs in ([resting], [replace(raw, torque=torque)]):
        assert (usual_efforts(model(), logs)[0] > 1.0) == exceeds


def test_a_few_samples_in_motion_are_no_measure_of_the_usual_torque():
    raw = log()
    velocity, torque = np.zeros_like(raw.velocity), np.ones_like(raw.torque)
    velocity[100:150] = 1.0
    torque[[110, 120]] = 1e3
    still = replace(raw, velocity=velocity, torque=torque)
    assert (usual_efforts(model(), [still]) < 0.1).all()


@pytest.mark.parametrize(
    ("slopes", "doubted"),
    [
        ([1.2, 1.17], True),
        ([0.8, 0.85], True),
        ([1.2, 1.05], False),  # bodies of one joint
        ([1.14, 1.13], False),
        ([1.2, 0.83], False),
        ([1.11, 1.1], False),  # clean simulated logs: 0.92 to 1.12
        ([0.89, 0.9], False),
    ],
)
def test_slopes_that_are_all_off_to_one_side_are_as_one_gain_would_make_them(
    slopes, doubted
):
    verdict = good_with(slopes=slopes, explained=[0.9, 0.9], expected=[0.5, 0.5])
    assert ("gain or unit" in kinds(verdict)) == doubted
    near = max(abs(np.array(slopes) - 1.0)) < 0.12
    likely = slopes == [0.8, 0.85]  # a mean of 0.82: a factor of 1.21
    word = "do not use" if likely else "use with care"
    assert verdict.word == ("use" if near else word)
    if doubted:
        (reason,) = [r for r in verdict.reasons if r.kind == "gain or unit"]
        mean = np.exp(np.mean(np.log(slopes)))
        assert f"nothing in the log separates a gain of {mean:.2f}" in reason.statement


def test_one_joint_alone_shows_no_common_gain():
    verdict = good_with(slopes=[1.2, 1.2], explained=[0.9, 0.1], expected=[0.5, 0.5])
    assert "gain or unit" not in kinds(verdict)


def strong_with(slopes, torque=(10.0, 1.0), **figures):
    both = {"explained": [0.9, 0.9], "expected": [0.5, 0.5], "torque": torque}
    return good_with(slopes=slopes, **{**both, **figures})


@pytest.mark.parametrize(
    ("slopes", "figures", "word"),
    [
        ([1.14, 1.0], {}, "use with care"),  # 14 % of the torque of the strong joint
        ([0.86, 1.0], {}, "use with care"),
        ([1.11, 1.0], {}, "use"),
        ([1.0, 1.2], {}, "use"),  # 20 % of a joint with a tenth of the torque
        ([1.14, 1.0], {"expected": [0.2, 0.5]}, "use"),  # friction is most of it
        ([1.14, 1.0], {"explained": [0.2, 0.9]}, "use"),
    ],
)
def test_a_gain_that_may_make_an_eighth_of_all_torque_wrong_is_doubted(
    slopes, figures, word
):
    verdict = strong_with(slopes, **figures)
    assert verdict.word == word
    if word != "use":
        (reason,) = verdict.grounds
        share = abs(slopes[0] - 1.0) * 10.0 / np.hypot(10.0, slopes[0])
        assert f"would make {share:.0%} of all joints' torque wrong" in reason.statement


def test_a_strong_joint_s_gain_that_the_others_confirm_is_not_doubted():
    good = constrained_least_squares(model(), build_regression(model(), log()))
    figures = {"slopes": [1.14, 1.0], "explained": [0.9] * 2, "expected": [0.5] * 2}
    changed = {name: np.array(values) for name, values in figures.items()}
    fit = replace(good.fit, torque=np.array([10.0, 1.0]), **changed)
    assert doubtful_joints(fit)[0] == "shoulder"
    for slope, word in ((1.0, "use"), (1.2, "use with care")):
        crossed = Slopes(("shoulder",), [slope], [0.9], [0.5], [0.01])
        evidence = replace(good.evidence(), fit=fit, crossed=crossed)
        assert judge(evidence).word == word


def good_and_found(slopes, *findings, accepted=(), **figures):
    """The verdict on a clean log with other slopes, and with findings."""
    good = constrained_least_squares(model(), build_regression(model(), log()))
    both = np.array([0.9, 0.9])
    changed = {name: np.array(values) for name, values in figures.items()}
    given = {"slopes": np.array(slopes), "explained": both, "expected": both}
    fit = replace(good.fit, **given, **changed)
    changed = {"fit": fit, "findings": findings, "accepted": accepted}
    return judge(replace(good.evidence(), **changed))


def gain_of(where, severity="warning", kind="masses or gain", size="0.77 +- 0.05"):
    return LogFinding(kind, severity, where, "off", "check it", size=size)


def test_reasons_that_state_one_factor_of_all_torques_are_one():
    verdict = good_and_found([0.75, 0.79], gain_of("all joints"))
    (reason,) = verdict.grounds  # the joints' own slopes state nothing else
    assert (reason.kind, reason.word) == ("gain or unit", "do not use")
    assert reason.statement.endswith("states the same factor: 0.77 +- 0.05")
    for cause in ("unit of time", "a load", "a counterbalance", "masses"):
        assert reason.advice.count(cause) >= 1
    assert '--accept "gain or unit"' in reason.advice
    again = Verdict.from_dict(json.loads(json.dumps(verdict.to_dict())))
    assert again == verdict


def test_a_joint_far_from_the_factor_of_all_keeps_a_reason_of_its_own():
    # 0.84 and 0.6: the mean is 0.71, and the second joint 0.85 times that; then 0.77.
    assert kinds(good_and_found([0.84, 0.6])) == ["gain or unit"]
    assert kinds(good_and_found([0.88, 0.5])) == ["gain or unit", "nominal model"]


def test_the_worst_of_joined_reasons_leads_and_only_its_kind_accepts_it():
    fault = gain_of("all joints", "fault", "torque gain", "0.78")
    for accepted, word in (
        ((), "do not use"),
        (("gain or unit",), "do not use"),
        (("torque gain",), "use"),
    ):
        verdict = good_and_found([0.75, 0.79], fault, accepted=accepted)
        assert verdict.word == word
    (reason,) = good_and_found([0.75, 0.79], fault).grounds
    assert reason.kind == "torque gain"
    assert "gain or unit states the same factor: shoulder 0.75" in reason.statement


def test_factors_of_other_joints_and_notes_are_not_joined():
    of_one = gain_of("elbow", kind="torque gain")
    assert kinds(good_and_found([0.85, 0.85], of_one)) == [
        "gain or unit",
        "torque gain",
    ]
    assert kinds(good_and_found([0.85, 0.85], gain_of("all joints", "note"))) == [
        "gain or unit"
    ]
    both = good_and_found([1.0, 0.7], of_one)  # of one joint alone
    assert kinds(both) == ["nominal model"]
    assert "torque gain states the same factor" in both.grounds[0].statement


def test_a_fault_s_advice_is_kept_and_leads_the_slopes_that_show_it():
    mends = "check the gain (times 0.001 would fit)"
    found = LogFinding(
        "torque unit", "fault", "all joints", "N mm", mends, size="1e+03"
    )
    verdict = good_and_found([1000.0, 1000.0], found, efforts=[9.0, 9.0])
    (reason,) = [r for r in verdict.grounds if r.factor]
    assert reason.kind == "torque unit"
    assert reason.advice.startswith(mends)
    assert '--accept "torque unit"' in reason.advice
    assert "shoulder 1000.00" in reason.statement


def gains_of(**sizes):
    """Faults of one joint's gain in logs a, b, ..."""
    for name, size in sizes.items():
        found = gain_of("elbow", "fault", "torque gain", size)
        yield replace(found, recording=name, statement=f"times {size}")


def test_a_factor_in_which_logs_agree_is_one_reason_that_names_them_all():
    verdict = good_and_found([1.0, 1.0], *gains_of(a="0.5", b="0.51", c="0.5"))
    (reason,) = verdict.grounds
    assert reason.statement == (
        "a, elbow: times 0.5; torque gain states the same factor: 0.51 (b); torque "
        "gain states the same factor: 0.5 (c)"
    )


def test_logs_with_different_factors_keep_a_reason_each():
    verdict = good_and_found([1.0, 1.0], *gains_of(a="0.5", b="2"))
    assert [r.statement for r in verdict.grounds] == [
        "a, elbow: times 0.5",
        "b, elbow: times 2",
    ]
    assert kinds(good_and_found([1.0, 1.0], *gains_of(a="0.5", b=""))) == [
        "torque gain",
        "torque gain",
    ]


def test_a_joined_reason_is_confirmed_once():
    stated = good_and_found([0.65, 0.85], gain_of("all joints"))
    assert (stated.word, kinds(stated)) == ("use with care", ["gain or unit"])
    found = good_and_found([1.0, 1.0], gain_of("all joints"))
    assert kinds(found) == ["masses or gain"]
    assert confirmed(stated, found).reasons == stated.reasons
    worse = good_and_found([1.0, 1.0], gain_of("all joints", "fault"))
    assert confirmed(stated, worse).grounds[0].kind == "masses or gain"
    assert confirmed(stated, worse).word == "do not use"


def test_a_joint_whose_friction_at_rest_is_unknown_hides_no_strong_joint():
    figures = {"moving": [1.0, 0.1], "holding": [0.0, np.nan]}
    assert strong_with([1.14, 1.0], **figures).grounds[0].kind == "nominal model"


def test_what_mends_a_fault_is_said_before_the_slopes_that_show_it():
    mends = "reverse it by --torque-gain -1"
    found = LogFinding("torque sign", "fault", "all joints", "1 % instead of 75", mends)
    verdict = good_and_found([-1.0, -1.0], found)
    assert verdict.grounds[0].advice == mends
    assert "1 % instead of 75" in verdict.brief[0]
    assert kinds(verdict)[:2] == ["torque sign", "torque sign"]


def test_a_guess_by_a_good_prior_is_a_note():
    for errors, word in (
        ([0.05, 0.1], "use"),
        ([0.05, 0.35], "use with care"),  # of one joint
        ([0.12, 0.0], "use with care"),  # of all together
        ([np.nan, np.nan], "use with care"),
    ):
        verdict = good_with(guessed=0.5, prior_errors=errors)
        assert verdict.word == word
        assert "mostly guessed" in [r.kind for r in verdict.reasons]


def test_independent_samples_are_counted_for_each_parameter():
    arm, truth, clean = experiment(0, joints=2, samples=300)
    regression = build_regression(arm, clean)
    free = unconstrained_fit(regression, base_parameters(arm))
    spare = fit_of(arm, free, truth).spare
    assert spare * free.solution.rank == pytest.approx(regression.effective.sum())


def test_friction_of_a_gear_coupling_counts_and_offsets_and_rotors_do_not():
    arm, _, log = experiment(0, joints=2, samples=50)
    one, other = arm.robot.joint_names
    assert len({joint.kind for joint in arm.robot.joints}) == 1
    gears = GearCoupling(one, other, viscous=True)
    drives = DriveTerms(rotor_inertia=True, offset=True)
    arm = TorqueModel(arm.robot, drives, couplings=(gears,))
    x = np.append(arm.robot.nominal, [0.1, 3.0, 0.2, -2.0, 0.7])
    assert arm.layout.names[-1].endswith("viscous")
    log = simulate_torque(arm, x, log)
    rubbing = np.where(np.arange(len(x)) == len(x) - 1, x, 0.0)
    states = log.position, log.velocity, log.acceleration
    share = np.linalg.norm(arm.predict(rubbing, *states)) / np.linalg.norm(log.torque)
    free = unconstrained_fit(build_regression(arm, log), base_parameters(arm))
    assert fit_of(arm, free, x).friction_share == pytest.approx(share)


def test_figures_of_a_fit_are_those_of_its_samples():
    arm, truth, log = experiment(3, joints=3, noise=2.0, samples=200)
    assert arm.forces.any() and not arm.forces.all()
    velocity = log.velocity.copy()
    velocity[50:100, 1] = 0.0
    log = replace(log, velocity=velocity)
    regression = build_regression(arm, log).weighted([0.5, 2.0, 4.0])
    base = base_parameters(arm)
    free = unconstrained_fit(regression, base)
    found = fit_of(arm, free, truth)

    def rms(torque):
        return np.sqrt(np.mean(torque**2, axis=0))

    def left(x):
        return log.torque - arm.predict(x, log.position, log.velocity, log.acceleration)

    friction = np.where(np.arange(len(truth)) < 30, 0.0, truth)
    torque, misses = np.linalg.norm(log.torque), left(truth)
    assert found.misfit == pytest.approx(np.linalg.norm(misses) / torque)
    least = left(free.parameters)
    assert found.floor == pytest.approx(np.linalg.norm(least) / torque)
    drive = np.linalg.norm(log.torque - left(friction)) / torque
    assert 0.01 < found.drive_share == pytest.approx(drive)
    rubs = [n.endswith(("viscous", "coulomb")) for n in arm.layout.names]
    rubbing = np.linalg.norm(log.torque - left(np.where(rubs, truth, 0.0))) / torque
    assert found.friction_share == pytest.approx(rubbing)
    assert 0.0 < rubbing < drive
    np.testing.assert_allclose(found.torque, rms(log.torque))
    np.testing.assert_allclose(found.misfits, rms(misses) / rms(log.torque))
    kinds = [log.torque[:, kind] for kind in (arm.forces, ~arm.forces)]
    largest = [rms(kind).max() for kind in kinds]
    sizes = np.where(arm.forces, *largest)
    np.testing.assert_allclose(found.shares, rms(log.torque) / sizes)
    np.testing.assert_allclose(found.moving, [1.0, 0.75, 1.0])
    coulomb = [truth[arm.layout.index(f"j{k}.coulomb")] for k in range(3)]
    np.testing.assert_allclose(found.holding, coulomb)
    weighted = [np.sum((x / [0.5, 2.0, 4.0]) ** 2) for x in (misses, least)]
    rows, rank = 600, len(base)
    excess = np.sqrt(weighted[0] / rows / (weighted[1] / (rows - rank)))
    assert found.excess == pytest.approx(excess)
    assert found.correlation == pytest.approx(rows / regression.effective.sum())


@pytest.mark.parametrize(("rank", "excess"), [(9, np.sqrt(0.1)), (10, np.nan)])
def test_of_as_many_parameters_as_rows_there_is_no_excess(rank, excess):
    regression = SimpleNamespace(counts=(4, 6), sigma=np.array([0.5, 2.0]))
    rms = np.array([1.0, 3.0])
    found = _excess(regression, 5.0 * rms, rms, rank)
    assert found == pytest.approx(5.0 * excess, nan_ok=True)


def test_how_much_nominal_bodies_explain_does_not_depend_on_their_size():
    arm, _, clean = experiment(0, joints=2, samples=300)
    bodies = arm.robot.nominal.ravel()
    light = replace(clean, torque=1e-6 * clean.torque)
    whole, small = (
        slopes_on(arm, build_regression(arm, log), body)
        for log, body in ((clean, bodies), (light, 1e-6 * bodies))
    )
    assert whole.explained.min() > 0.5
    np.testing.assert_allclose(small.explained, whole.explained, rtol=1e-6)
    np.testing.assert_allclose(small.slopes, whole.slopes, rtol=1e-6)
    # Nor on the unit of all rows.
    regression = build_regression(arm, clean)
    faint = replace(regression, factors=tuple(1e-9 * F for F in regression.factors))
    other = slopes_on(arm, faint, bodies)
    np.testing.assert_allclose(other.slopes, whole.slopes, rtol=1e-6)


@pytest.mark.parametrize("drive", [DriveTerms(), DriveTerms(viscous=True, offset=True)])
def test_slopes_are_the_coefficients_of_bodies_beside_drive_terms(drive):
    arm, _, log = experiment(1, joints=3, noise=3.0, samples=200, drive=drive)
    rng = np.random.default_rng(0)
    bodies = arm.robot.nominal * rng.uniform(0.5, 2.0, arm.robot.nominal.shape)
    found = slopes_on(arm, build_regression(arm, log), bodies)
    Y = arm.regressor(log.position, log.velocity, log.acceleration)
    for j, own in enumerate(Y):
        body, terms, torque = bodies @ own[:30], own[30:].T, log.torque[:, j]
        columns = np.column_stack([body, terms])
        x = np.linalg.lstsq(columns, torque)[0]
        rest = torque - columns @ x
        alone = torque - terms @ np.linalg.lstsq(terms, torque)[0]
        left = body - terms @ np.linalg.lstsq(terms, body)[0]
        assert found.slopes[j] == pytest.approx(x[0], rel=1e-8)
        share = 1.0 - rest @ rest / (alone @ alone)
        assert found.explained[j] == pytest.approx(share, rel=1e-8)
        size = np.linalg.norm(left) / np.linalg.norm(torque)
        assert found.expected[j] == pytest.approx(size, rel=1e-8)
