"""Gains, peaks and factors of torque: what is doubted, and which reasons are one."""

import json
from dataclasses import replace

import numpy as np
import pytest
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
    Recording,
)
from consistent_id.estimation import judge
from consistent_id.estimation.fit import usual_efforts
from consistent_id.estimation.slope_reasons import doubtful_joints
from consistent_id.estimation.torque_error import Slopes
from consistent_id.estimation.verdict import Reason, Verdict, confirmed, joined
from consistent_id.recordings.recording import LogFinding


@pytest.mark.slow
def test_a_gain_that_masses_and_drives_both_deny_is_refused():
    verdict = verdict_of(with_torque(lambda torque: 100.0 * torque))
    assert (verdict.word, kinds(verdict)[0]) == ("do not use", "gain or unit")


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
    good = good_estimate()
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
    good = good_estimate()
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
    good = good_estimate()
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


def test_how_to_accept_a_joined_reason_is_said_once():
    lead = Reason("torque gain", "use with care", "", '--accept "torque gain"', "one")
    advice = replace(lead, word="do not use"), replace(lead, kind="nominal model")
    (reason,) = joined(advice)
    assert reason.advice.count('--accept "torque gain"') == 1


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
