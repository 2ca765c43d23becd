"""The cut-off that predicts best, and preparation by method and in parts."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from experiments import experiment as random_log
from robots import random_robot

import consistent_id as ci
from consistent_id import build_regression, least_squares
from consistent_id.estimation.cutoff import CutoffChoice, _held_out, _parts, _Sides
from consistent_id.problems.file import ColumnsTable, DataTable, PreparationTable
from consistent_id.problems.preparation import (
    check_base,
    check_preparation,
    prepared,
)
from consistent_id.recordings.joint_paths import Sinusoid, SinusoidalMotion
from consistent_id.regression import base_parameters
from consistent_id.regression.segments import merged
from consistent_id.regression.torque_along import predicted_torque

CANDIDATES = (2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 40.0)
RATE = 200.0


@pytest.fixture(scope="module")
def arm():
    _, robot = random_robot(np.random.default_rng(3), 2)
    terms = ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.05)
    return ci.TorqueModel(robot, (terms, terms))


def experiment(arm, seed, noise):
    """A motion below 2 Hz, its true torque, and a log with noise on both."""
    rng = np.random.default_rng(seed)
    truth = np.concatenate(
        [*(body.vector for body in bodies(arm)), rng.uniform(0.5, 1.5, 4)]
    )
    joints = tuple(
        tuple(
            Sinusoid(0.3 / f, 0.3 / f, f, rng.uniform(0, 6))
            for f in rng.uniform(0.2, 2.0, 5)
        )
        for _ in range(2)
    )
    motion = SinusoidalMotion(24.0, RATE, joints).recording(arm.robot.joint_names)
    exact = ci.simulate_torque(arm, truth, motion)
    q = exact.position + noise * rng.normal(size=exact.position.shape)
    tau = exact.torque + 0.05 * exact.torque.std(axis=0) * rng.normal(size=q.shape)
    log = replace(exact, position=q, velocity=None, acceleration=None, torque=tau)
    return exact, log


def bodies(arm):
    rng = np.random.default_rng(8)
    for _ in arm.robot.links:
        c = 0.2 * rng.normal(size=3)
        yield ci.InertialParameters.from_central(2.0, c, 0.05 * np.eye(3))


def test_a_candidate_is_doubted_by_the_scatter_of_its_folds():
    errors = np.sqrt([[1.0, 2.0, 3.0, 2.0], [2.0, 2.0, 5.0, 3.0]])
    choice = CutoffChoice([5.0, 8.0], [6.0, 9.0], 20.0, errors)
    assert (choice.best, choice.motion_cutoff, choice.torque_cutoff) == (0, 5.0, 6.0)
    assert choice.error == pytest.approx(np.sqrt([2.0, 3.0]))
    # Differences of squares 1, 0, 2, 1: their variance is 2/3, their mean's 1/6.
    assert choice.doubt == pytest.approx([0.0, np.sqrt(1.0 / 6.0) / 2.0])
    turned = CutoffChoice([5.0, 8.0], [6.0, 9.0], 20.0, errors[::-1])
    assert (turned.best, turned.torque_cutoff) == (1, 9.0)


@pytest.mark.slow
def test_the_chosen_cutoff_predicts_nearly_as_well_as_the_best_there_is(arm):
    chosen = []
    for noise in (3e-5, 1e-3):
        _, log = experiment(arm, 0, noise)
        choice = ci.estimation.best_cutoff(arm, log, CANDIDATES)
        exact, fresh = experiment(arm, 1, noise)
        true = []
        for f in CANDIDATES:
            both = ci.low_passed(log, motion_cutoff=f, torque_cutoff=f)
            learned = ci.trimmed(ci.differentiated(both), 1.0, 23.0)
            x = ci.least_squares(arm, ci.build_regression(arm, learned)).parameters
            test = ci.differentiated(ci.low_passed(fresh, motion_cutoff=f))
            off = (
                arm.predict(x, test.position, test.velocity, test.acceleration)
                - exact.torque
            )
            true.append(np.linalg.norm((off / exact.torque.std(axis=0))[200:-200]))
        assert true[choice.best] < 1.5 * min(true)
        assert choice.doubt[choice.best] == 0.0
        chosen.append(choice.motion_cutoff)
    assert chosen[0] > chosen[1]  # more noise, lower cut-off


@pytest.mark.slow
def test_smoother_torque_to_learn_from_is_not_rewarded(arm):
    _, log = experiment(arm, 0, 1e-4)
    pairs = [(8.0, f) for f in (2.0, 8.0, 40.0)]
    choice = ci.estimation.best_cutoff(arm, log, pairs, target=40.0)
    assert choice.target == 40.0
    # Torque of 2 Hz lacks what the motion asks for, though it would be fitted best.
    assert choice.error[0] > choice.error[1:].min()


def test_what_no_cutoff_can_be_chosen_from_is_refused(arm):
    _, log = experiment(arm, 0, 1e-4)
    for arguments, options, error, message in (
        ((5.0,), {}, ci.ProblemError, "two positive"),
        ((5.0, -1.0), {}, ci.ProblemError, "two positive"),
        (
            (5.0, 9.0),
            {"target": 6.0},
            ci.ProblemError,
            "smoother torque has no advantage",
        ),
        ((5.0, 9.0), {"folds": 1}, ci.ProblemError, "expected 2 or more"),
        ((0.5, 9.0), {}, ci.RecordingError, "Use fewer folds"),
    ):
        with pytest.raises(error, match=message):
            ci.estimation.best_cutoff(arm, log, arguments, **options)


def test_rows_of_weight_zero_are_neither_fitted_nor_counted(arm):
    exact, _ = experiment(arm, 0, 0.0)
    mask = np.zeros((len(exact), 2), dtype=bool)
    mask[100:1000, 1] = True
    spoilt = replace(exact, torque=np.where(mask, 99.0, exact.torque))
    weights = ci.signals.row_weights(spoilt, mask, arm.torque_joints)
    regression = ci.build_regression(arm, spoilt, row_weights=[weights])
    assert regression.counts == (len(exact), len(exact) - 900)
    x = ci.least_squares(arm, regression).parameters
    assert (regression.residual_rms(x) < 1e-9 * regression.torque_rms).all()
    with pytest.raises(ci.NotExcitedError, match="has the weight 0"):
        ci.build_regression(arm, spoilt, row_weights=[0 * weights])


def table(**keys):
    return msgspec.convert(keys, PreparationTable)


@pytest.mark.slow
@pytest.mark.parametrize(
    "keys",
    [
        {"motion_cutoff": 10.0},
        {"method": "savitzky-golay", "window": 0.15},
        {"method": "smoother", "order": 5},
        {"method": "fourier", "period": 4.0},
        {"method": "fourier", "period": "estimated", "harmonics": 3},
    ],
)
def test_every_method_prepares_a_log_cut_to_its_rows(keys):
    time = np.arange(2400) / RATE
    w = 2 * np.pi / 4.0
    q = (np.sin(w * time) + 0.3 * np.cos(2 * w * time))[:, None]
    log = ci.Recording(("j",), time, q, torque=q)
    (found,) = prepared(log, table(torque_cutoff=20.0, **keys), 1.0, 11.0)
    assert found.time[0] == 1.0 and found.time[-1] == 11.0
    t = found.time
    truth = -(w**2) * (np.sin(w * t) + 1.2 * np.cos(2 * w * t))
    np.testing.assert_allclose(found.acceleration[:, 0], truth, atol=0.02)


def test_parts_between_gaps_are_prepared_apart_and_cut_to_the_rows():
    time = np.delete(np.arange(3000) / RATE, range(1000, 1400))
    time = np.delete(time, range(1010, 1030))
    log = ci.Recording(
        ("j",), time, np.sin(time)[:, None], torque=np.ones((len(time), 1))
    )
    keys = {"max_gap": 0.05, "resample": RATE, "motion_cutoff": 10.0}
    parts = prepared(log, table(**keys), 0.5, 14.0)
    # The run of ten samples between both gaps is shorter than a second.
    assert [p.name for p in parts] == ["recording (part 1)", "recording (part 2)"]
    assert parts[0].time[0] == 0.5 and parts[-1].time[-1] <= 14.0
    assert max(np.diff(p.time).max() for p in parts) < 0.0051
    assert len(prepared(log, table(**keys), 0.5, 4.0)) == 1
    with pytest.raises(ci.RecordingError, match="0 samples between"):
        prepared(log, table(**keys), 100.0, 200.0)


def test_delays_are_taken_out_and_standstill_is_cut_off():
    time = np.arange(3000) / RATE
    u = np.clip(time - 2.0, 0.0, 10.0)
    phase = 2 * u + u**2 / 10
    q, rate = 1 - np.cos(phase), (2 + u / 5) * ((u > 0) & (u < 10))
    late = np.interp(time - 0.1, time, rate * np.sin(phase))
    log = ci.Recording(("j",), time, q[:, None], velocity=late[:, None])
    keys = {"motion_cutoff": 20.0, "trim_standstill": 0.05}
    for delay in (0.1, "estimated"):
        (found,) = prepared(log, table(delays={"velocity": delay}, **keys))
        inside = (found.time > 2.5) & (found.time < 11.5)
        truth = (rate * np.sin(phase))[np.searchsorted(time, found.time - 1e-9)]
        assert abs(found.velocity[:, 0] - truth)[inside].max() < 0.02
        assert found.time[0] == pytest.approx(2.0, abs=0.1)
        assert found.time[-1] == pytest.approx(12.0, abs=0.1)


@pytest.mark.parametrize(
    ("keys", "columns", "message"),
    [
        ({"method": "fourier"}, {}, "needs period"),
        ({"method": "smoother", "motion_cutoff": 5}, {}, "motion_cutoff belongs to"),
        ({"window": 0.1}, {}, 'belongs to method = "savitzky-golay"'),
        ({"method": "smoother"}, {"velocity": "dq"}, "leave velocity out"),
        ({"delays": {"velocity": 0.1}}, {}, "does not name"),
        ({"delays": {"position": "estimated"}}, {"position": "q"}, "give a number"),
        ({"shortest_part": 1.0}, {}, "only with max_gap"),
        (
            {"method": "fourier", "period": 1, "trim_standstill": True},
            {},
            "give the rows",
        ),
    ],
)
def test_keys_that_contradict_each_other_are_refused(keys, columns, message):
    with pytest.raises(ci.ProblemError, match=message):
        check_preparation(table(**keys), ColumnsTable(**columns))


def test_the_delay_of_torque_is_estimated_only_for_a_base_that_floats():
    late = table(delays={"torque": "estimated"})
    data = DataTable(recordings=[], preparation=late)
    with pytest.raises(ci.ProblemError, match="only for a base that floats"):
        check_base(data, floating=False)


def test_each_part_is_predicted_by_the_others_in_shares_of_all_torque():
    model, _, log = random_log(6, joints=2, noise=0.5, samples=300)
    runs = slice(0, 80), slice(80, 200), slice(200, 300)
    parts = [log.samples(run) for run in runs]
    rows = [build_regression(model, part, noise=False) for part in parts]
    base = base_parameters(model)

    def fitted(regression):
        return least_squares(model, regression, base=base).parameters

    found = _held_out(_Sides(rows, rows), fitted)
    size = np.sqrt(np.mean(log.torque**2, axis=0))
    for k, part in enumerate(parts):
        x = fitted(merged([own for i, own in enumerate(rows) if i != k]))
        off = part.torque - predicted_torque(model, x, part)
        expected = np.sqrt(np.mean(np.mean(off**2, axis=0) / size**2))
        assert found[k] == pytest.approx(expected)


def test_parts_are_all_samples_and_longer_recordings_have_more_of_them():
    logs = [
        ci.Recording(("a",), start + np.arange(n) / 10, np.arange(float(n))[:, None])
        for start, n in ((0.0, 301), (50.0, 101))
    ]
    parts = _parts(logs, 8, 1.0)
    assert [len(part) for part in parts] == [50, 50, 50, 51, 50, 50, 50, 51]
    whole = np.concatenate([part.time for part in parts])
    np.testing.assert_array_equal(whole, np.concatenate([log.time for log in logs]))
