"""Each gate of a slope, at both sides: made-up fits of joints with known slopes."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment
from made_up_fits import JOINTS, fit

from consistent_id import (
    DHRow,
    DriveTerms,
    TorqueModel,
    build_regression,
    from_modified_dh,
)
from consistent_id.estimation.slope_reasons import (
    _common,
    _wrong_share,
    agreeing,
    confirmed_joints,
    doubtful_joints,
    effort_reasons,
    slope_reasons,
)
from consistent_id.estimation.torque_error import Slopes, holding, slopes_on

CARE, NO, NOTE = "use with care", "do not use", "use"
#: Little torque: a wrong gain of the first joint makes little of all torque wrong.
LITTLE = [0.1, 10.0, 10.0]


def kinds(crossed=None, **changes):
    return [reason.kind for reason in slope_reasons(fit(**changes), crossed)]


def of_first(slope, **changes):
    """Kinds of reasons if the first of three joints has a slope, and little torque."""
    first = {name: [value, *[0.5] * 2] for name, value in changes.items()}
    first.setdefault("moving", 0.9)
    return kinds(slopes=[slope, 1.0, 1.0], torque=LITTLE, **first)


@pytest.mark.parametrize(
    ("slope", "changes", "expected"),
    [
        (-0.01, {}, "torque sign"),
        (0.0, {}, "torque channel"),
        (0.199, {}, "torque channel"),
        (0.201, {}, "nominal model"),
        (0.799, {}, "nominal model"),
        (0.8, {}, None),
        (1.25, {}, None),
        (1.251, {}, "nominal model"),
        # A torque that cannot be missing for lack of excitation is 30 % or more.
        (0.1, {"expected": 0.3}, "torque channel"),
        (0.1, {"expected": 0.299}, "nominal model"),
        (0.1, {"explained": 0.1}, "torque channel"),
        (-0.1, {"explained": 0.1}, "torque channel"),
        # A slope is significant from 30 % of the squared torque, and 10 % of torque.
        (1.5, {"explained": 0.3}, "nominal model"),
        (1.5, {"explained": 0.299}, None),
        (1.5, {"expected": 0.1}, "nominal model"),
        (1.5, {"expected": 0.099}, None),
        (1.5, {"shares": 0.05}, "nominal model"),
        (1.5, {"shares": 0.049}, None),
        (0.1, {"shares": 0.049}, None),
        # With a gain of 100, the nominal torque is a hundredth, but explains it all.
        (100.0, {"expected": 0.003}, "nominal model"),
        (100.0, {"expected": 0.0029}, None),
        (-100.0, {"expected": 0.003}, "torque sign"),
    ],
)
def test_a_slope_of_one_joint_counts_from_its_gates(slope, changes, expected):
    assert of_first(slope, **changes) == ([] if expected is None else [expected])


@pytest.mark.parametrize(
    ("slope", "moving", "expected"),
    [
        # A joint that rests for 64 % of the time: friction of 0.01 N m may balance
        # 0.8 * 0.01 / (0.5 * 0.1) = 0.16 of the bodies' torque.
        (0.63, 0.36, "nominal model"),
        (0.65, 0.36, None),
        (1.40, 0.36, None),
        (1.42, 0.36, "nominal model"),
        (-0.17, 0.36, "torque sign"),
        (-0.15, 0.36, "torque channel"),
        (0.03, 0.36, "torque channel"),
        (0.05, 0.36, "nominal model"),
        # One that rests for less than half of it is not affected.
        (0.79, 0.5, "nominal model"),
        (0.79, 0.499, None),
    ],
)
def test_friction_of_joints_that_rest_may_change_their_slopes(slope, moving, expected):
    moves = [moving, 0.9, 0.9]
    found = kinds(
        slopes=[slope, 1.0, 1.0], torque=LITTLE, moving=moves, holding=[0.01, 1.0, 1.0]
    )
    assert found == ([] if expected is None else [expected])
    unknown = kinds(
        slopes=[slope, 1.0, 1.0],
        torque=LITTLE,
        moving=[0.1, 0.9, 0.9],
        holding=[np.nan, 1.0, 1.0],
    )
    assert unknown == []


@pytest.mark.parametrize(
    ("slopes", "changes", "alike"),
    [
        ([1.3, 1.3, 1.3], {}, True),
        ([1.3, 1.3, 2.02], {}, True),  # 1.25 / 0.8 = 1.5625 apart is 2.03
        ([1.3, 1.3, 2.04], {}, False),
        ([1.3, 1.0, 1.0], {"shares": [1.0, 0.01, 0.01]}, False),  # of one joint
        ([1.3, 1.3, 1.0], {"shares": [1.0, 1.0, 0.01]}, True),  # of two
        ([3.1, 1.0, 1.0], {"shares": [1.0, 0.01, 0.01]}, True),  # unless far off
        ([3.01, 9.0, 99.0], {}, True),
        ([2.99, 9.0, 99.0], {}, False),
        ([0.33, 0.1, 0.01], {"expected": 0.2}, True),
        ([0.34, 0.1, 0.01], {"expected": 0.2}, False),
        ([1.3, 1.3, 1.2], {}, False),  # one of them is not off
    ],
)
def test_one_gain_is_doubted_where_all_slopes_are_off_alike(slopes, changes, alike):
    found = fit(slopes=slopes, torque=LITTLE, **changes)
    reasons = list(slope_reasons(found, None))
    # Otherwise a common factor may be stated, which does not give each slope as a size.
    assert ([reason.kind for reason in reasons] == ["gain or unit"]) is alike or (
        "nothing in the log separates" in reasons[0].statement
    )
    off = bool(np.any((np.array(slopes) < 0.8) | (np.array(slopes) > 1.25)))
    assert (doubtful_joints(found) == ()) is (alike or not off)


def test_a_far_gain_that_exceeds_the_drives_is_refused():
    for slope, effort, word in (
        (3.01, 1.21, NO),
        (3.01, 1.2, CARE),
        (2.99, 1.21, CARE),
    ):
        slopes = [slope, 9.0, 99.0]  # not alike, but all far off
        found = fit(slopes=slopes, efforts=effort)
        reason = next(slope_reasons(found, None))
        assert (reason.kind, reason.word) == ("gain or unit", word)


@pytest.mark.parametrize(
    ("slopes", "word"),
    [
        ([1.2, 1.2, 1.21], NO),
        ([1.19, 1.2, 1.2], CARE),  # a mean of 1.197
        ([1.2, 1.3, 1.43], NO),  # 1.19 apart
        ([1.2, 1.3, 1.45], CARE),  # 1.21 apart, as a load makes them
        ([0.84, 0.81, 0.68], CARE),  # a KUKA whose bodies were guessed
        ([0.8, 0.81, 0.83], NO),  # a mean of 1 / 1.23
        ([0.82, 0.85, 0.85], CARE),  # a mean of 1 / 1.19
        ([1.3, 1.3, 1.3], NO),  # each is off
        ([1.3, 1.4, 1.7], CARE),
    ],
)
def test_slopes_that_are_as_alike_as_one_gain_makes_them_are_refused(slopes, word):
    found = fit(slopes=slopes, torque=LITTLE)
    reasons = [r for r in slope_reasons(found, None) if r.kind == "gain or unit"]
    assert [reason.word for reason in reasons] == [word]
    assert '--accept "gain or unit"' in reasons[0].advice
    on_its_base = replace(found, joints=("base.fz", *found.joints[1:]))
    reasons = [r for r in slope_reasons(on_its_base, None) if r.kind == "gain or unit"]
    assert [reason.word for reason in reasons] == [CARE]


@pytest.mark.parametrize(
    ("slopes", "common"),
    [
        ([1.11, 1.2, 1.2], True),
        ([1.09, 1.2, 1.24], False),  # each by more than 10 %
        ([1.14, 1.15, 1.15], False),  # and their mean by more than 15 %
        ([1.14, 1.16, 1.16], True),
        ([0.9, 0.82, 0.85], True),  # 1 / 1.1 = 0.909, 1 / 1.15 = 0.870
        ([0.92, 0.82, 0.82], False),
        ([0.87, 0.88, 0.88], False),
        ([0.86, 0.87, 0.87], True),
        ([1.2, 1.2, 0.85], False),
    ],
)
def test_a_factor_of_all_joints_is_stated_from_its_gates(slopes, common):
    found = fit(slopes=slopes, torque=[0.1, 0.1, 10.0])
    stated = [r for r in slope_reasons(found, None) if r.kind == "gain or unit"]
    assert bool(stated) is common
    if common:
        mean = np.prod(slopes) ** (1.0 / 3.0)
        assert f"a gain of {mean:.2f}, or a wrong clock" in stated[0].statement
        assert stated[0].size == ", ".join(
            f"{name} {slope:.2f}" for name, slope in zip(JOINTS, slopes, strict=True)
        )


def test_a_common_factor_is_not_stated_of_each_strong_joint_as_well():
    assert kinds(slopes=1.2) == ["gain or unit"]


def test_two_joints_have_a_common_factor_and_one_has_none():
    for shares, expected in (
        ([1.0, 1.0, 0.01], ["gain or unit"]),
        ([1.0, 0.01, 0.01], []),
    ):
        assert kinds(slopes=1.17, shares=shares, torque=[0.1, 0.1, 10.0]) == expected


def test_slopes_that_are_the_common_factor_are_not_stated_again():
    # Mean 1.51: the first two are 0.86 of it, the third is 1.35 times as much.
    common, single = slope_reasons(fit(slopes=[1.3, 1.3, 2.04]), None)
    assert (common.kind, single.kind) == ("gain or unit", "nominal model")
    assert single.size == "c 2.04"
    # Mean 1.30: 1.62 is 1.247 times as much; with a mean of 1.29, 1.26 times.
    (common,) = slope_reasons(fit(slopes=[1.16, 1.165, 1.62]), None)
    assert common.kind == "gain or unit"
    assert len(list(slope_reasons(fit(slopes=[1.14, 1.15, 1.63]), None))) == 2


@pytest.mark.parametrize(
    ("torque", "slope", "doubted"),
    [
        # Bodies' torque 10.6, of all torque 17.67: 0.2 * 10.6 / 17.67 = 0.11995
        (12.72, 1.2, False),
        (12.84, 1.2, True),  # and 0.1207
        # 0.8: bodies' torque 10.6 and 10.7 again, less torque than these have
        (10.6 * 0.8, 0.8, False),
        (10.7 * 0.8, 0.8, True),
    ],
)
def test_a_strong_joints_gain_counts_from_an_eighth_of_all_torque(
    torque, slope, doubted
):
    changes = {"slopes": [slope, 1.0, 1.0], "torque": [torque, 10.0, 10.0]}
    assert kinds(**changes) == ["nominal model"] * doubted
    assert doubtful_joints(fit(**changes)) == (JOINTS if doubted else ())
    # Friction explains too much, the bodies too little, or they are confirmed.
    assert kinds(**changes, expected=[0.3, 0.5, 0.5]) == ["nominal model"] * doubted
    assert kinds(**changes, expected=[0.299, 0.5, 0.5]) == []
    moving = {"moving": [0.1, 0.9, 0.9], "holding": [np.nan, 1.0, 1.0]}
    assert kinds(**changes, **moving) == []
    assert kinds(crossed(1.0), **changes) == []
    # A floating base's force passes no drive.
    base = fit(("base.fz", "b", "c"), **changes)
    assert list(slope_reasons(base, None)) == []


def test_the_wrong_gain_with_the_largest_effect_is_named():
    found = fit(slopes=[1.24, 1.2, 0.9], torque=[5.0, 20.0, 15.0])
    (reason,) = slope_reasons(found, None)
    assert "a wrong gain of b from other bodies" in reason.statement
    # (0.24 * 4.03, 0.2 * 16.7, 0.1 * 16.7) over (4.03, 16.7, 16.7)
    assert "make 16% of all joints' torque wrong" in reason.statement


def crossed(slope, **changes):
    """Slopes of the first joint on bodies that the others determine."""
    own = {"explained": 1.0, "expected": 0.5, "errors": 0.0} | changes
    return Slopes(
        JOINTS[:1],
        [slope],
        *([own[n]] for n in ("explained", "expected")),
        [own["errors"]],
    )


@pytest.mark.parametrize(
    ("slope", "changes", "right"),
    [
        (0.89, {}, True),
        (0.889, {}, False),
        (1.12, {}, True),
        (1.121, {}, False),
        (1.0, {"errors": 0.054}, True),  # 1 - 2 * 0.055 is the gate
        (1.0, {"errors": 0.056}, False),
        (1.06, {"errors": 0.029}, True),
        (1.06, {"errors": 0.031}, False),
        (1.0, {"explained": 0.3}, True),
        (1.0, {"explained": 0.299}, False),
        (1.0, {"expected": 0.3}, True),
        (1.0, {"expected": 0.299}, False),
    ],
)
def test_other_joints_confirm_a_gain_by_a_slope_and_its_error(slope, changes, right):
    beside = crossed(slope, **changes)
    assert confirmed_joints(beside) == JOINTS[: int(right)]
    (reason,) = slope_reasons(fit(slopes=[1.5, 1.0, 1.0], torque=LITTLE), beside)
    assert reason.word == (NOTE if right else CARE)
    assert ("gains are right" in reason.statement) is right
    if "errors" not in changes:
        own = fit(slopes=slope, **{name: value for name, value in changes.items()})
        assert agreeing(own).all() == right


def test_slopes_on_other_joints_bodies_are_shown_where_they_mean_something():
    off = fit(slopes=[1.5, 1.0, 1.0], torque=LITTLE)
    for changes, shown in (
        ({"explained": 0.3, "expected": 0.1}, True),
        ({"explained": 0.299, "expected": 0.1}, False),
        ({"explained": 0.3, "expected": 0.099}, False),
    ):
        (reason,) = slope_reasons(off, crossed(1.4, **changes))
        assert ("that the other joints determine: a 1.40" in reason.statement) is shown


def test_the_torque_of_one_doubtful_joint_is_a_factor_to_join():
    for slopes, factor, size in (
        ([1.5, 1.0, 1.0], "torque of a", "a 1.50"),
        ([1.5, 0.5, 1.0], "", "a 1.50, b 0.50"),
    ):
        (reason,) = slope_reasons(fit(slopes=slopes), None)
        assert (reason.factor, reason.size) == (factor, size)


@pytest.mark.parametrize(
    ("efforts", "usual", "expected"),
    [
        (1.2, None, []),
        (1.21, None, [CARE]),
        (1.21, 1.2, [NOTE]),  # peaks alone
        (1.5, 1.21, [CARE]),
        (1.2, 1.2, []),
    ],
)
def test_torque_beyond_a_limit_is_doubted_unless_single_samples_are(
    efforts, usual, expected
):
    found = fit(efforts=[efforts, 0.5, 0.5])
    of_all = None if usual is None else np.array([usual, 0.5, 0.5])
    reasons = list(effort_reasons(found, of_all))
    assert [reason.word for reason in reasons] == expected
    if expected:
        assert f"limit: a {efforts:.2g} times" in reasons[0].statement
    for slope, peaks in ((1.0, True), (1.2, False)):
        again = fit(efforts=[1.5, 0.5, 0.5], slopes=slope)
        (reason,) = effort_reasons(again, None)
        assert ("perhaps outliers" in reason.statement) is peaks


def test_wrong_gains_make_as_much_of_all_torque_wrong_as_theirs_is():
    """Of 2.5 and 4 N m right, 0.2 of the first less what friction at rest may do."""
    two = fit(JOINTS[:2], slopes=[1.2, 1.5], torque=[3.0, 4.0])
    share = _wrong_share(two, [0], np.array([0.05, 0.0]))
    assert share == pytest.approx(0.15 * 2.5 / np.hypot(2.5, 4.0))
    assert _wrong_share(two, [], np.zeros(2)) == 0.0


def test_slopes_that_may_be_zero_have_no_common_factor():
    both, slopes = np.array([True, True]), np.array([0.2, 0.3])
    most = np.array([0.4, 0.5])
    assert _common(both, np.array([0.1, 0.1]), most, slopes) == [0, 1]
    assert _common(both, np.array([0.0, 0.1]), most, slopes) == []


@pytest.mark.parametrize("size", [1.0, 1e-20])
def test_slopes_are_those_of_torque_without_what_drives_explain(size):
    model, truth, log = experiment(5, joints=2, noise=0.5, samples=200)
    regression = build_regression(model, log, noise=False)
    small = replace(regression, factors=tuple(size * F for F in regression.factors))
    found = slopes_on(model, small, 2.0 * truth[:20])
    for j, F in enumerate(regression.factors):
        drive = F[:, 20:-1]
        drive = drive[:, drive.any(axis=0)]
        bodies, torque = F[:, :20] @ (2.0 * truth[:20]), F[:, -1]
        left = [
            v - drive @ np.linalg.lstsq(drive, v, rcond=None)[0]
            for v in (bodies, torque)
        ]
        slope = left[0] @ left[1] / (left[0] @ left[0])
        assert found.slopes[j] == pytest.approx(slope) == pytest.approx(0.5, abs=0.05)
        assert found.explained[j] == pytest.approx(
            (left[0] @ left[1]) ** 2 / (left[0] @ left[0]) / (left[1] @ left[1])
        )


def test_friction_of_a_joint_that_hardly_moved_may_be_a_quarter_of_its_limit():
    robot = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.4), DHRow(0, 0.3)])
    efforts = (80.0, np.inf, 80.0)
    joints = [
        replace(joint, limits=replace(joint.limits, effort=effort))
        for joint, effort in zip(robot.joints, efforts, strict=True)
    ]
    drive = DriveTerms(coulomb="sign", viscous=True)
    model = TorqueModel(replace(robot, joints=tuple(joints)), drive)
    x = np.full(len(model.layout), 7.0)
    for name in ("joint1", "joint2", "joint3"):
        x[model.layout.index(f"{name}.coulomb")] = 3.0
    found = holding(model, x, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_array_equal(found, [20.0, np.nan, 3.0])
