"""Verdicts: clean logs are used, faulty ones are not, and the reason is the cause."""

import json
from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment, pendulum
from judged_logs import (
    good_estimate,
    good_with,
    kinds,
    log,
    model,
    verdict_of,
    with_torque,
)

from consistent_id import (
    FixedMasses,
    NonNegativeDrive,
    PhysicalConsistency,
    ProblemError,
    TorqueModel,
    build_regression,
    compare,
    constrained_least_squares,
    simulate_torque,
)
from consistent_id.estimation import judge
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.method import Method
from consistent_id.estimation.verdict import WORDS, Verdict
from consistent_id.export import to_json
from consistent_id.recordings.recording import LogFinding


def test_a_clean_log_is_used_by_ten_lines_of_python():
    verdict = verdict_of(log())
    assert (verdict.word, verdict.grounds) == ("use", ())
    assert verdict.sentence == "use: constrained"
    assert str(verdict) == "use"


@pytest.mark.slow
def test_a_joint_s_reversed_torque_is_not_used_and_its_sign_is_named_first():
    verdict = verdict_of(with_torque(lambda torque: torque * [-1.0, 1.0]))
    assert verdict.word == "do not use"
    assert kinds(verdict)[0] == "torque sign"
    assert "shoulder -" in verdict.grounds[0].statement
    assert verdict.lines[-1].endswith("consistent-id help bad-result")


@pytest.mark.slow
def test_all_torque_reversed_is_not_used():
    assert verdict_of(with_torque(np.negative)).word == "do not use"


@pytest.mark.slow
@pytest.mark.parametrize("gain", [100.0, 0.01, 1.6])
def test_a_wrong_gain_is_not_simply_used(gain):
    verdict = verdict_of(with_torque(lambda torque: gain * torque))
    assert verdict.word != "use"
    assert "gain or unit" in kinds(verdict) or "torque channel" in kinds(verdict)


@pytest.mark.slow
def test_torque_beyond_the_drive_s_limit_is_said():
    assert "effort limit" in kinds(verdict_of(with_torque(lambda tau: 100.0 * tau)))


@pytest.mark.slow
def test_gravity_taken_out_of_the_channel_is_said():
    raw = log().torque_filter.source
    still = replace(raw, velocity=0 * raw.velocity, acceleration=0 * raw.acceleration)
    bodies = TorqueModel(model().robot)
    gravity = simulate_torque(bodies, model().robot.nominal, still).torque
    verdict = verdict_of(with_torque(lambda torque: torque - gravity))
    assert verdict.word == "do not use"
    assert {"torque channel", "nominal model"} & set(kinds(verdict))


@pytest.mark.slow
def test_torque_that_has_nothing_to_do_with_the_motion_is_not_used():
    noise = np.random.default_rng(0).normal(size=log().torque.shape)
    verdict = verdict_of(with_torque(lambda _: noise))
    assert verdict.word == "do not use"
    assert "misfit" in kinds(verdict)


def test_a_negative_mass_is_never_used_and_says_so():
    good = good_estimate()
    x = good.parameters.copy()
    x[0] *= -1.0
    verdict = replace(good, parameters=x).verdict
    assert verdict.word == "do not use"
    assert "inconsistent bodies" in kinds(verdict)


def test_a_body_without_mass_is_not_used():
    good = good_estimate()
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
    good = good_estimate()
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "size", "misfit", "excess", "word"),
    [
        ("lag", "0.06", 0.081, 1.16, "do not use"),
        ("lag", "0.06", 0.079, 1.16, "use with care"),  # the log is explained
        ("lag", "0.06", 0.081, 1.14, "use with care"),  # consistent bodies do as well
        ("torque resolution", "0.1", 0.081, 1.0, "do not use"),
        ("torque resolution", "0.1", 0.079, 1.0, "use with care"),
        ("torque resolution", "", 0.081, 1.0, "use with care"),  # coarse, not late
        ("clock", "1.1", 0.081, 1.16, "use with care"),
    ],
)
def test_a_late_torque_that_leaves_much_unexplained_is_not_used(
    kind, size, misfit, excess, word
):
    good = constrained_least_squares(model(), build_regression(model(), log()))
    evidence = good.evidence()
    late = LogFinding(kind, "warning", "log", "seen", "mend it", size=size)
    fit = replace(evidence.fit, misfit=misfit, excess=excess)
    evidence = replace(evidence, fit=fit, findings=(late,))
    (reason,) = [r for r in judge(evidence).reasons if r.kind == kind]
    assert reason.word == word
    assert ("unexplained" in reason.statement) == (word == "do not use")
    (tested,) = compare([good], [log()]).reports
    elsewhere = replace(late, recording=tested.validation[0].recording)
    unseen = replace(evidence, findings=(elsewhere,), held_out=tested.validation)
    assert judge(unseen).word != "do not use"  # the fit has not seen that recording
    noted = replace(evidence, findings=(replace(late, severity="note"),))
    assert judge(noted).word != "do not use"
    assert judge(replace(evidence, accepted=(kind,))).word != "do not use"
    # Rollouts have found how late commands act; they do not show that a torque is held.
    rolled = judge(replace(evidence, method=Method.REFINED_BY_ROLLOUT))
    (reason,) = [r for r in rolled.reasons if r.kind == kind]
    assert reason.word == ("use with care" if kind == "lag" else word)


def test_an_error_above_predicting_nothing_is_never_used():
    good = good_estimate()
    other = with_torque(np.negative)
    (report,) = compare([good], [other]).reports
    assert report.held_out_error > 1.0
    assert report.verdict.word == "do not use"
    assert "held-out error" in kinds(report.verdict)


def test_a_joint_that_rests_while_tested_does_not_decide():
    good = good_estimate()
    error = compare([good], [log()]).reports[0].validation[0]
    quiet = replace(
        error, relative=np.array([0.01, 5.0]), torque=error.torque * [1.0, 1e-3]
    )
    assert judge(replace(good.evidence(), held_out=(quiet,))).word == "use"


def test_each_share_of_torque_says_of_which_joints_and_data_it_is():
    good = good_estimate()
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
    good = good_estimate()
    doubted = replace(
        good, certificate=replace(good.certificate, verdict="uncertified")
    )
    assert kinds(doubted.verdict) == ["optimum not proven"]
    assert doubted.verdict.word == "use with care"
    # A refinement is no optimum by its kind: this is said, and no reason for care.
    refined = replace(doubted, method=Method.REFINED_BY_ROLLOUT).verdict
    assert refined.word == "use" and not kinds(refined)
    assert "optimum not proven" in [reason.kind for reason in refined.reasons]


@pytest.mark.slow
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


def test_fit_and_acceptance_survive_the_file(tmp_path):
    good = good_estimate()
    good = replace(good, accepted=("clock",))
    read = Estimate.load(good.save(tmp_path / "e.json"), good.model, good.base)
    assert read.fit.to_dict() == good.fit.to_dict()
    assert read.accepted == ("clock",)
    assert read.verdict == good.verdict


def test_a_file_is_json_whatever_figures_an_estimate_has(tmp_path):
    """JSON has no word for NaN and infinity [RFC 8259]."""
    good = good_estimate()
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


def test_a_verdict_of_who_knows_more_goes_with_the_estimate_into_its_file(tmp_path):
    good = good_estimate()
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


@pytest.mark.slow
def test_correlated_residuals_are_worth_knowing_and_change_no_verdict():
    white, coloured = noisy(4000, 0.0), noisy(4000, 0.9)
    assert not said(white.verdict, "correlated residuals")
    (reason,) = said(coloured.verdict, "correlated residuals")
    assert reason.word == "use"
    # Of slow motion 1 + 2 sum 0.9^k = 19 samples carry the information of one.
    assert coloured.fit.correlation == pytest.approx(19.0, rel=0.5)
    assert white.fit.correlation == pytest.approx(1.0, rel=0.3)


def test_few_independent_samples_ask_for_care():
    good = good_estimate()
    few = replace(good, fit=replace(good.fit, spare=2.9, correlation=40.0))
    (reason,) = said(few.verdict, "few samples")
    assert (few.verdict.word, reason.word) == ("use with care", "use with care")
    assert "2.9 independent" in reason.statement


def test_data_against_all_bodies_are_worth_knowing_and_change_no_verdict():
    good = good_estimate()
    evidence = replace(good.evidence(), contradicted="chi^2 rises by 80")
    verdict = judge(evidence)
    (reason,) = said(verdict, "physical consistency")
    assert (verdict.word, reason.statement) == ("use", "chi^2 rises by 80")


def test_an_estimate_of_an_older_file_has_no_figures_of_noise():
    good = good_estimate()
    record = good.fit.to_dict()
    del record["spare"], record["correlation"]
    assert np.isnan(type(good.fit).from_dict(record).spare)


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
