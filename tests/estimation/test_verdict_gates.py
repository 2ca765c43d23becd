"""Each gate of a verdict, at both sides: made-up fits that differ in one figure."""

from dataclasses import replace

import numpy as np
import pytest
from made_up_fits import JOINTS, evidence, fit, held_out

from consistent_id.constraints.delivered_bodies import LinkCondition, RobotSize
from consistent_id.estimation.drive_ratios import DriveRatios, drive_reasons
from consistent_id.estimation.judgement import _prior_is_good, judge
from consistent_id.estimation.verdict import (
    Reason,
    Verdict,
    confirmed,
    factor_of,
    joined,
    percent,
    weighed,
)
from consistent_id.recordings.recording import LogFinding

CARE, NO, NOTE = "use with care", "do not use", "use"


def words(found):
    """The word of each kind of reason."""
    return {reason.kind: reason.word for reason in judge(found).reasons}


def test_made_up_fits_give_no_reason():
    assert judge(evidence(held_out=(held_out(),))).reasons == ()


@pytest.mark.parametrize(("misfit", "word"), [(0.08, CARE), (0.081, NO)])
def test_a_weight_that_is_chosen_is_no_contradiction_up_to_the_misfit_that_is_good(
    misfit, word
):
    chosen = replace(
        evidence(fit=fit(excess=9.0, misfit=misfit)), method="cross-validated"
    )
    assert words(chosen)["contradiction"] == word


def test_a_finding_about_a_whole_recording_names_it_once():
    short = LogFinding("short", "warning", "a.csv", "2 turns", "", 1.0, "a.csv")
    (reason,) = judge(evidence(findings=(short,))).reasons
    assert reason.statement == "a.csv: 2 turns"


def test_a_joint_is_named_once_in_a_finding_about_it():
    gain = LogFinding("torque gain", "fault", "s1", "s1: its torque", "", 1.0, "a.csv")
    (reason,) = judge(evidence(findings=(gain,))).reasons
    assert reason.statement == "a.csv, s1: its torque"


@pytest.mark.parametrize(
    ("errors", "good"), [(0.08, True), (0.081, False), (np.nan, False)]
)
def test_a_prior_is_good_up_to_the_misfit_that_is(errors, good):
    one = fit(("a",), torque=1.0, prior_errors=errors)
    assert _prior_is_good(one) == good


@pytest.mark.parametrize(("errors", "good"), [(0.3, True), (0.301, False)])
def test_a_prior_of_a_weak_joint_is_good_up_to_the_misfit_of_one(errors, good):
    weak = fit(torque=[1.0, 10.0, 10.0], prior_errors=[errors, 0.01, 0.01])
    assert _prior_is_good(weak) == good


# One changed figure of the fit, the kind of reason, and its word.
FIT = [
    ({"misfit": 0.08}, {}),
    ({"misfit": 0.081}, {"misfit": CARE}),
    ({"misfit": 0.5}, {"misfit": CARE}),
    ({"misfit": 0.501}, {"misfit": NO}),
    ({"misfits": [0.06, 0.3, 0.06]}, {}),
    ({"misfits": [0.06, 0.301, 0.06]}, {"misfit": CARE}),
    ({"misfits": [0.06, 0.9, 0.06], "shares": [1.0, 0.05, 1.0]}, {"misfit": CARE}),
    ({"misfits": [0.06, 0.9, 0.06], "shares": [1.0, 0.049, 1.0]}, {}),
    ({"excess": 1.15}, {}),
    ({"excess": 1.151}, {"contradiction": CARE}),
    ({"excess": 2.0}, {"contradiction": CARE}),
    ({"excess": 2.01}, {"contradiction": NO}),
    ({"excess": 2.01, "misfit": 0.005}, {}),
    ({"excess": 2.01, "misfit": 0.0051}, {"contradiction": NO}),
    ({"friction_share": 0.01}, {}),
    ({"friction_share": 0.0099}, {"no friction": CARE}),
    ({"friction_share": np.nan}, {}),
    ({"spare": 3.0}, {}),
    ({"spare": 2.99, "correlation": 9.0}, {"few samples": CARE}),
    ({"spare": np.nan, "correlation": 9.0}, {}),
    ({"correlation": 1.5}, {}),
    ({"correlation": 1.51}, {"correlated residuals": NOTE}),
    ({"moving": [0.9, 0.05, 0.9], "holding": 0.0}, {}),
    ({"moving": [0.9, 0.049, 0.9], "holding": 0.0}, {"joint at rest": CARE}),
    ({"guessed": 0.3}, {}),
    ({"guessed": 0.301}, {"mostly guessed": CARE}),
    ({"guessed": 0.9, "prior_errors": 0.079}, {"mostly guessed": NOTE}),
    ({"guessed": 0.9, "prior_errors": 0.081}, {"mostly guessed": CARE}),
    ({"guessed": 0.9, "prior_errors": [0.0, np.nan, 0.0]}, {"mostly guessed": CARE}),
]
WEAK = {"guessed": 0.9, "torque": [1.0, 10.0, 10.0]}  # an error of one weak joint
FIT += [
    ({**WEAK, "prior_errors": [0.3, 0.0, 0.0]}, {"mostly guessed": NOTE}),
    ({**WEAK, "prior_errors": [0.301, 0.0, 0.0]}, {"mostly guessed": CARE}),
]


@pytest.mark.parametrize(("changes", "expected"), FIT)
def test_a_figure_of_the_fit_counts_from_its_gate(changes, expected):
    assert words(evidence(fit=fit(**changes))) == expected


def extent(kind, size, recording="log.csv"):
    return LogFinding(kind, "warning", "", "seen", "move", size, recording)


@pytest.mark.parametrize(
    ("finding", "guessed", "word"),
    [
        (extent("small motion", 1.1), 0.501, NO),
        (extent("small motion", 1.1), 0.5, CARE),
        (extent("short", 10.0), 0.9, CARE),  # a KUKA whose joints never turned back
        (extent("slow motion", 10.0), 0.9, CARE),
        (extent("small motion", 9.0, "other.csv"), 0.9, CARE),  # held out
    ],
)
def test_guesses_from_a_small_motion_are_refused(finding, guessed, word):
    found = evidence(fit=fit(guessed=guessed), findings=(finding,))
    found = replace(found, held_out=(held_out(),))
    assert words(found)["mostly guessed"] == word
    good = replace(found, fit=fit(guessed=guessed, prior_errors=0.01))
    assert words(good)["mostly guessed"] == NOTE


HELD_OUT = [
    (held_out(0.12), {}),
    (held_out(0.121), {"held-out error": CARE}),
    (held_out(0.17), {"held-out error": CARE}),
    (held_out(0.19), {"held-out error": CARE, "overfitting": CARE}),
    (held_out(0.999), {"held-out error": CARE, "overfitting": CARE}),
    (held_out(1.0), {"held-out error": NO, "overfitting": CARE}),
    (held_out(of_joints=[0.05, 0.4, 0.05]), {}),
    (held_out(of_joints=[0.05, 0.41, 0.05]), {"held-out error": CARE}),
    (held_out(of_joints=[0.05, 1.0, 0.05]), {"held-out error": NO}),
    # Half the torque of the training data: half the error, beside that.
    (held_out(of_joints=[0.05, 0.79, 0.05], torque=[10.0, 5.0, 10.0]), {}),
    (held_out(of_joints=0.39, torque=20.0), {}),  # as much as in the log itself
]


@pytest.mark.parametrize(("error", "expected"), HELD_OUT)
def test_a_held_out_error_counts_from_its_gate(error, expected):
    assert words(evidence(held_out=(error,))) == expected


def test_held_out_errors_of_weak_joints_do_not_count():
    error = held_out(of_joints=[0.05, 5.0, 0.05])
    for share, expected in ((0.049, {}), (0.05, {"held-out error": NO})):
        weak = fit(shares=[1.0, share, 1.0])
        assert words(evidence(fit=weak, held_out=(error,))) == expected
    alone = words(evidence(fit=None, held_out=(error,)))
    assert alone == {"unknown fit": CARE}


def test_the_worst_joint_of_all_recordings_is_named():
    errors = (held_out(of_joints=[0.1, 0.41, 0.1]), held_out(of_joints=[0.1, 0.1, 0.6]))
    (reason,) = judge(evidence(held_out=errors)).reasons
    assert "held-out error of c: 60 % of its RMS torque" in reason.statement


@pytest.mark.parametrize(("misfit", "gate"), [(0.03, 0.09), (0.01, 0.06), (0.0, 0.06)])
def test_a_held_out_error_of_three_misfits_is_overfitting(misfit, gate):
    """A misfit below 2 % counts as 2 %."""
    for error, expected in ((gate - 1e-6, {}), (gate + 1e-6, {"overfitting": CARE})):
        found = evidence(fit=fit(misfit=misfit), held_out=(held_out(error),))
        assert words(found) == expected


def test_friction_at_rest_is_named_where_it_changes_the_error():
    for beyond, named in ((0.2, False), (0.19985, False), (0.1997, True)):
        found = evidence(held_out=(held_out(0.2, beyond=beyond),))
        (said, _) = (reason.statement for reason in judge(found).reasons)
        assert ("beyond friction at rest" in said) is named


def test_bodies_that_no_robot_has_are_refused():
    def link(least=1e-3, edge="", name="a"):
        return LinkCondition(name, least, edge)

    for links, least, expected in (
        ([link(-1e-9)], 1.0, {}),
        ([link(-1.1e-9)], 1.0, {"inconsistent bodies": NO}),
        ([link(-1.1e-9)], -1.0, {"inconsistent bodies": NO}),
        ([link()], 0.0, {"mass matrix": NO}),
        ([link()], 1e-300, {}),
        ([link(edge="flat")], 1.0, {"boundary": NOTE}),
        ([link(edge="no mass")], 1.0, {"vanishing mass": NO, "boundary": NOTE}),
        # What is not consistent is not said to lack mass as well.
        (
            [link(-1.0, "no mass")],
            1.0,
            {"inconsistent bodies": NO, "boundary": NOTE},
        ),
    ):
        found = evidence(links=tuple(links), least_mass_eigenvalue=least)
        assert words(found) == expected
    for count, said in ((3, "n0, n1, n2"), (4, "n0, n1, n2 and 1 more")):
        links = tuple(link(-1.0, name=f"n{k}") for k in range(count))
        (reason,) = judge(evidence(links=links)).reasons
        assert reason.statement == f"not physically consistent: {said}"


def size(**changes):
    """Bodies of a tenth of a metre, of links half a metre long."""
    plain = {"size": 0.5, "centre": 0.1, "radius": 0.1, "inertia": 0.5} | changes
    links = tuple(f"link_{name}" for name in JOINTS)
    arrays = {k: np.broadcast_to(v, (3,)).astype(float) for k, v in plain.items()}
    return RobotSize(links, JOINTS, JOINTS, **arrays)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"inertia": [0.5, 1.5, 0.5]}, {}),
        ({"inertia": [0.5, 1.51, 0.5]}, {"robot's size": CARE}),
        ({"inertia": [1.6, 2.0, 1.6]}, {"robot's size": CARE}),
        ({"inertia": [1.6, 2.01, 1.6]}, {"robot's size": NO}),
        ({"inertia": [0.5, np.nan, 0.5]}, {}),
        ({"radius": [0.1, 1.5, 0.1]}, {}),
        ({"radius": [0.1, 1.51, 0.1]}, {"robot's size": CARE}),
        ({"centre": [0.1, 1.5, 0.1]}, {}),
        ({"centre": [0.1, 1.51, 0.1]}, {"robot's size": CARE}),
    ],
)
def test_bodies_larger_than_the_robot_are_doubted(changes, expected):
    assert words(evidence(size=size(**changes))) == expected
    assert words(evidence(fit=None, size=size(**changes))) == {"unknown fit": CARE}


@pytest.mark.parametrize("name", ["inertia", "radius", "centre"])
def test_bodies_that_weak_joints_carry_are_not_judged(name):
    large = size(**{name: [0.1, 9.0, 0.1]})
    for share, expected in ((0.05, {"robot's size"}), (0.049, set())):
        weak = fit(shares=[1.0, share, 1.0])
        assert set(words(evidence(fit=weak, size=large))) == expected


def test_the_body_farthest_beyond_its_size_is_named():
    found = size(radius=[2.0, 1.6, 5.0], size=[0.5, 0.1, 1.0])
    (reason,) = judge(evidence(size=found)).reasons
    assert "radius of gyration of link_b: 1.6 m" in reason.statement
    assert "at most 0.1 m" in reason.statement


@pytest.mark.parametrize(
    ("ratios", "friction", "rotors"),
    [
        ([1.99] * 3, False, False),
        ([2.01] * 3, True, False),
        ([1 / 2.01] * 3, True, False),
        ([2.99] * 3, True, False),
        ([3.01] * 3, True, True),
        ([3.01] * 2, False, False),  # two joints show no scatter
        ([3.01, 3.01, np.nan], False, False),
        ([3.01, 3.01, 3.01, 1e-4], False, False),  # one has none
        # The mean of logarithms over its standard error: 3.02, and 2.98
        (3.0 * np.exp([-0.63, 0.0, 0.63]), True, False),
        (3.0 * np.exp([-0.64, 0.0, 0.64]), False, False),
    ],
)
def test_a_factor_of_all_drives_is_reported_where_joints_agree(
    ratios, friction, rotors
):
    joints = tuple(f"j{k}" for k in range(len(ratios)))
    none = np.full(len(ratios), np.nan)
    assert bool(list(drive_reasons(DriveRatios(joints, ratios, none)))) is friction
    assert bool(list(drive_reasons(DriveRatios(joints, none, ratios)))) is rotors


def test_the_factor_of_drives_is_the_geometric_mean_with_its_error():
    ratios = DriveRatios(JOINTS, 4.0 * np.exp([-0.5, 0.0, 0.5]), [np.nan] * 3)
    (reason,) = drive_reasons(ratios)
    assert "friction of 3 joints is 4 times" in reason.statement
    # 0.5 / sqrt(3) is the standard error of the mean logarithm.
    assert f"a factor of {np.exp(0.5 / np.sqrt(3.0)):.2g})" in reason.statement


def test_what_is_known_only_in_part_is_noted():
    found = evidence(
        fit=fit(guessed=0.42),
        undetermined=("p", "q", "r", "s"),
        loose_trunk=("base.m",),
        contradicted="significant",
        impossible="no robot",
        optimum="uncertified",
    )
    said = {reason.kind: reason.statement for reason in judge(found).reasons}
    assert said["mostly guessed"].startswith("on other motions up to 42 % of")
    assert said["mostly guessed"].endswith("4 combinations are not identifiable")
    assert said["not identifiable"].endswith("p, q, r and 1 more")
    assert "only sums of base.m with" in said["trunk"]
    assert said["physical consistency"] == "significant"
    assert words(found)["impossible robot"] == NO
    assert words(found)["optimum not proven"] == CARE


def finding(severity="fault", kind="torque gain", where="a", **changes):
    return LogFinding(kind, severity, where, "seen", "mend it", **changes)


def test_findings_are_told_with_their_recording_and_place():
    (reason,) = judge(evidence(findings=(finding(recording="x.csv"),))).reasons
    assert reason.statement == "x.csv, a: seen"
    note = finding("note")
    assert judge(evidence(findings=(note,))).reasons == ()
    hidden = replace(note, kind="hidden factor")
    assert words(evidence(findings=(hidden,))) == {"hidden factor": NOTE}


def test_a_fault_comes_before_the_slopes_that_it_explains():
    off = fit(slopes=[-1.0, 1.0, 1.0])
    for kind, expected in (
        ("torque sign", ["torque sign", "torque sign"]),
        ("clock", ["torque sign", "clock"]),
    ):
        found = evidence(fit=off, findings=(finding(kind=kind),))
        assert [reason.kind for reason in judge(found).reasons] == expected
        first = judge(found).reasons[0].statement
        assert (first == "a: seen") is (kind == "torque sign")


@pytest.mark.parametrize(
    ("sizes", "recordings", "factor"),
    [
        (("1.30",), ("x",), "torque of a"),
        (("1.30", "1.42"), ("x", "y"), "torque of a"),
        (("1.30", "1.44"), ("x", "y"), ""),  # more than 1.1 times as large
        (("1.30", "9.00"), ("x", "x"), "torque of a"),  # one log alone
        (("1.30", ""), ("x", "y"), ""),  # of one the factor is not known
    ],
)
def test_logs_state_one_factor_if_they_agree_in_it(sizes, recordings, factor):
    pairs = zip(sizes, recordings, strict=True)
    found = [finding(size=s, recording=r) for s, r in pairs]
    assert factor_of(found[0], found)[0] == factor
    other = finding(kind="clock", size="3")
    assert factor_of(other, [other]) == ("", "3")
    # Those of other joints, notes, and logs without a name do not count.
    apart = [
        finding(size="9.0", recording="z", where="b"),
        finding("note", size="9.0", recording="z"),
        finding(size="9.0"),
    ]
    assert factor_of(found[0], [found[0], *apart])[0] == "torque of a"


def test_the_first_of_the_worst_reasons_leads_those_of_the_same_factor():
    def reason(kind, word, size=""):
        return Reason(kind, word, f"by {kind}", f"mend {kind}", "torque of a", size)

    mild = reason("nominal model", CARE, "1.3")
    worse, also = reason("torque gain", NO, "1.31"), reason("torque unit", NO)
    (lead,) = joined([mild, worse, also])
    assert lead.kind == "torque gain"
    assert lead.statement == (
        "by torque gain; nominal model states the same factor: 1.3; "
        "torque unit states the same factor"
    )
    assert lead.advice.startswith("mend torque gain; if all this is known")
    (lead,) = joined([mild, replace(mild, kind="masses or gain", size="")])
    assert lead.advice.startswith("check the gain and the unit of torque, drive terms")
    assert "or a counterbalance; if masses are not known" in lead.advice
    noted = replace(mild, word=NOTE)
    assert joined([noted, worse]) == [noted, worse]
    apart = replace(mild, factor="")
    assert joined([apart, worse]) == [apart, worse]


@pytest.mark.parametrize(
    ("share", "said"),
    [
        (0.0, "0.00 %"),
        (0.00146, "0.15 %"),
        (0.0994, "9.9 %"),
        (0.1, "10 %"),
        (10.0, "1000 %"),
        (10.01, "over 1000 %"),
    ],
)
def test_shares_are_said_with_two_digits(share, said):
    assert percent(share) == said


def test_the_worst_reason_that_is_not_accepted_decides():
    care, no = Reason("clock", CARE, "slow"), Reason("misfit", NO, "large")
    found = weighed("m", [care, no], (), None, ())
    assert (found.word, found.usable) == (NO, False)
    assert [reason.kind for reason in found.reasons] == ["misfit", "clock"]
    found = weighed("m", [care, no], ("misfit",), None, ())
    assert (found.word, found.usable) == (CARE, True)
    assert found.reasons[1].statement == "large (accepted by the user)"
    assert weighed("m", [], (), None, ()).word == NOTE


def test_three_kinds_of_reasons_are_shown_on_a_terminal():
    kinds = ("k0", "k1", "k1", "k2", "k3")
    found = weighed("m", [Reason(k, CARE, k * 99, "do") for k in kinds], (), None, ())
    assert found.sentence == "use with care: m; k0, k1, k2"
    assert len(found.brief) == 5  # three reasons, what to do, and the page to read
    assert [line[:3] for line in found.brief[:3]] == ["k0:", "k1:", "k2:"]
    assert found.brief[3] == "to do: do"
    wide = Reason("k", CARE, " ".join(["word"] * 99))
    (line, _) = weighed("m", [wide], (), None, ()).brief
    assert 170 < len(line) <= 180


def test_a_stated_verdict_is_never_better_than_what_is_found_now():
    stated = Verdict(CARE, "m", (Reason("misfit", CARE, "old"),), (), 0.10, ("x",))
    for word, expected in ((CARE, ["old"]), (NO, ["new", "old"])):
        now = Verdict(word, "m", (Reason("misfit", word, "new"),), (), 0.2, ("y",))
        both = confirmed(stated, now)
        assert [reason.statement for reason in both.reasons] == expected
        assert (both.word, both.held_out, both.recordings) == (word, 0.2, ("x",))
    # The same factor under another name is no new reason; another factor is.
    old = Reason("torque gain", CARE, "old", "", "torque of a")
    new = Reason("nominal model", CARE, "new", "", "torque of a")
    for found, count in ((new, 1), (replace(new, factor="torque of b"), 2)):
        both = confirmed(
            Verdict(CARE, "m", (old,)), Verdict(CARE, "m", (found,), (), None)
        )
        assert len(both.reasons) == count


def test_a_reason_is_cut_at_two_lines_of_a_terminal():
    long = Reason("misfit", CARE, "ab " * 200)
    said, *_ = Verdict(CARE, "m", (long,)).brief
    whole, *_ = Verdict(CARE, "m", (Reason("misfit", CARE, "x" * 172),)).brief
    assert whole == f"misfit: {'x' * 172}" and len(whole) == 180
    cut, *_ = Verdict(CARE, "m", (Reason("misfit", CARE, "x" * 173),)).brief
    assert len(said) <= 180 and len(cut) < 180
