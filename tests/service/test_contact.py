"""Contacts in noise whose statistics are known."""

import ctypes
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from consistent_id import ProblemError, Recording
from consistent_id.service import ContactDetector

NEEDS_CC = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no cc")
JOINTS = ("shoulder", "elbow", "wrist")
SIGMA = np.array([2.0, 1.0, 0.3])


def noise(seconds, seed, rate=200.0, memory=0.8):
    """AR noise of three correlated joints, beside slow errors of a model."""
    rng = np.random.default_rng(seed)
    n = round(seconds * rate)
    mixed = np.linalg.cholesky(np.array([[1, 0.5, 0], [0.5, 1, 0.3], [0, 0.3, 1]]))
    fresh = rng.normal(size=(n, 3)) @ mixed.T * np.sqrt(1.0 - memory**2)
    fresh[0] = rng.normal(size=3)
    out = lfilter([1.0], [1.0, -memory], fresh, axis=0)
    time = np.arange(n) / rate
    slow = 5.0 * np.sin(0.3 * time[:, None] + np.arange(3))
    return Recording(JOINTS, time, np.zeros((n, 3)), torque=SIGMA * (out + slow))


def moving(seconds, seed):
    """The same while joints turn round, where friction is wrong by three deviations."""
    log = noise(seconds, seed)
    rate = 0.5 * np.sin(1.3 * log.time[:, None] + np.arange(3) * 2.0)
    return replace(
        log, velocity=rate, torque=log.torque + 3.0 * SIGMA * np.tanh(rate / 0.02)
    )


@pytest.fixture(scope="module")
def detector():
    return ContactDetector.fit([noise(60.0, 0), noise(60.0, 1)], false_alarms=60.0)


@pytest.mark.slow
def test_false_alarms_are_as_rare_as_stated(detector):
    log = noise(600.0, 2)
    alarms = detector.along(log).starts
    # One a minute is stated; of independent alarms, 10 minutes have 2 to 21 (99.5 %,
    # with 20 % for the limit's own error).
    assert 2 <= len(alarms) <= 21
    assert detector.hours == pytest.approx(120.0 / 3600.0, rel=0.02)


@pytest.mark.slow
def test_covariance_is_that_of_the_difference(detector):
    # Noise at one time, plus that of a mean over 250 ms (some 5 % of the variance each
    # way), beside a slow error.
    found = detector.covariance
    scale = np.sqrt(np.diag(found))
    assert (abs(scale / SIGMA - 1.0) < 0.2).all()
    correlation = found / np.outer(scale, scale)
    assert correlation[0, 1] == pytest.approx(0.5, abs=0.1)
    assert correlation[1, 2] == pytest.approx(0.3, abs=0.1)


@pytest.mark.slow
def test_a_step_is_found_at_once_and_by_the_stated_threshold(detector):
    log = noise(20.0, 4)
    threshold = detector.along(log).threshold[-1]
    assert np.isinf(detector.along(log).threshold[:59]).all()  # no mean of 0.3 s yet
    for j in range(3):
        push = np.zeros((len(log), 3))
        push[2000:, j] = 2.0 * threshold[j]
        found = detector.along(replace(log, torque=log.torque + push))
        assert found.contact[2000:2010].any()  # 50 ms
        assert not found.contact[1900:2000].any()
        small = replace(log, torque=log.torque + 0.1 * push)
        assert not detector.along(small).contact[1900:2100].any()


@pytest.mark.slow
def test_sample_by_sample_is_the_same():
    fitted = ContactDetector.fit([moving(60.0, 5)])
    log = moving(1.0, 6)
    found = fitted.along(log)
    state = fitted.start(log.time[0])
    for k, time in enumerate(log.time):
        state = fitted.step(state, time, log.torque[k], log.velocity[k])
        assert state.contact == found.contact[k]
        # Sums of a whole log and of one memory differ by their last digits.
        assert state.distance == pytest.approx(found.distance[k], abs=1e-9)
        np.testing.assert_allclose(state.change, found.change[k], atol=1e-9)
        np.testing.assert_allclose(fitted.thresholds(state), found.threshold[k])


@pytest.mark.slow
def test_thresholds_rise_where_a_joint_turns_round():
    fitted = ContactDetector.fit([moving(120.0, 7)])
    log = moving(30.0, 8)
    threshold = fitted.along(log).threshold
    for j in range(3):
        rate = abs(log.velocity[:, j])
        turning, fast = (rate < 0.03), (rate > 0.45)
        turning[:60] = fast[:60] = False
        # Friction changes by 6 deviations there; noise is one.
        assert np.median(threshold[turning, j]) > 1.5 * np.median(threshold[fast, j])


@pytest.mark.slow
def test_repeated_values_change_nothing():
    logs = [noise(60.0, 9), noise(60.0, 10)]
    twice = [
        Recording(
            log.joints,
            np.arange(2 * len(log)) / 400.0,
            np.repeat(log.position, 2, axis=0),
            torque=np.repeat(log.torque, 2, axis=0),
        )
        for log in logs
    ]
    once, repeated = (ContactDetector.fit(x) for x in (logs, twice))
    np.testing.assert_allclose(repeated.covariance, once.covariance, atol=0.03)
    assert repeated.limit == pytest.approx(once.limit, rel=0.05)


@pytest.mark.slow
def test_samples_that_are_not_free_are_not_learned():
    log = noise(120.0, 11)
    push = np.zeros((len(log), 3))
    push[4000:4100] = 50.0
    free = np.ones(len(log), dtype=bool)
    free[4000:4100] = False
    touched = replace(log, torque=log.torque + push)
    clean = ContactDetector.fit([log])
    spared = ContactDetector.fit([touched], free=[free])
    np.testing.assert_allclose(spared.covariance, clean.covariance, atol=0.03)
    assert ContactDetector.fit([touched]).covariance[2, 2] > 10 * clean.covariance[2, 2]


@pytest.mark.slow
def test_a_push_that_moves_a_resting_arm_does_not_hide_itself():
    rng = np.random.default_rng(12)
    log = noise(60.0, 12)
    tremble = 1e-4 * rng.normal(size=(len(log), 3))
    fitted = ContactDetector.fit([replace(log, velocity=tremble)])
    push, pushed = np.zeros((len(log), 3)), tremble.copy()
    push[6000:6040, 0], pushed[6000:6040, 0] = 40.0, 0.04
    found = fitted.along(replace(log, velocity=pushed, torque=log.torque + push))
    assert found.contact[6000:6010].any()


@pytest.mark.slow
def test_a_clock_that_goes_back_is_refused_and_one_that_stands_is_not(detector):
    state = detector.step(detector.start(5.0), 5.0, np.zeros(3))
    state = detector.step(state, 5.0, np.zeros(3))
    for time in (4.9, np.nan):
        with pytest.raises(ProblemError, match="does not go back"):
            detector.step(state, time, np.zeros(3))


def test_uneven_stamps_count_as_the_time_that_they_take():
    log = noise(60.0, 3)
    part = np.concatenate([np.arange(k, k + 4) for k in range(0, len(log) - 4, 8)])
    bursts = ContactDetector.fit([log.samples(part)])
    assert bursts.hours == pytest.approx(60.0 / 3600.0, rel=0.02)


@pytest.mark.slow
def test_one_log_is_as_good_as_a_list_and_a_path_is_none(detector):
    log = noise(60.0, 13)
    one, listed = ContactDetector.fit(log), ContactDetector.fit([log])
    assert one.limit == listed.limit
    for refused in (ContactDetector.fit, detector.along):
        with pytest.raises(
            ProblemError, match=r"a str, expected.*read_recording\('free"
        ):
            refused("free.csv")


@pytest.mark.slow
def test_what_cannot_be_learned_is_refused(detector):
    log = noise(60.0, 13)
    with pytest.raises(ProblemError, match="no log"):
        ContactDetector.fit([])
    with pytest.raises(ProblemError, match="or more to learn from"):
        ContactDetector.fit([noise(5.0, 14)])
    with pytest.raises(ProblemError, match="has no torque"):
        ContactDetector.fit([replace(log, torque=None)])
    with pytest.raises(ProblemError, match="free samples"):
        ContactDetector.fit([log], free=[np.ones(3, dtype=bool)])
    for rate in (0.0, np.inf):
        with pytest.raises(ProblemError, match="expected a number above 0"):
            ContactDetector.fit([log], false_alarms=rate)
    still = log.torque * [1.0, 1.0, 0.0]
    with pytest.raises(ProblemError, match="never changes"):
        ContactDetector.fit([replace(log, torque=still)])
    mirrored = log.torque[:, [0, 1, 1]] * [1.0, 1.0, -1.0]
    with pytest.raises(ProblemError, match="a sum of those of other joints"):
        ContactDetector.fit([replace(log, torque=mirrored)])
    with pytest.raises(ProblemError, match="expected two ages"):
        ContactDetector.fit([log], memory=(0.3, 0.05))
    fast = ContactDetector.fit([moving(60.0, 15)])
    with pytest.raises(ProblemError, match="no velocity"):
        fast.step(fast.start(0.0), 0.0, np.zeros(3))
    with pytest.raises(ProblemError, match="no velocity"):
        fast.along(log)


def in_c(detector, folder, rate):
    """The detector, compiled, and a state with the header's fields."""
    source = detector.c(name="arm", rate=rate).save(folder / "arm.c")
    user = folder / "user.c"
    user.write_text('#include "arm.h"\n#include "arm.c"\n#include "arm.h"\n')
    strict = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    library = folder / "arm.so"
    subprocess.run(
        ["cc", *strict, "-shared", "-fPIC", "-o", library, user, "-lm"], check=True
    )
    found = ctypes.CDLL(str(library))
    found.arm_start.argtypes = [ctypes.c_void_p, ctypes.c_double]
    vector = ctypes.POINTER(ctypes.c_double)
    found.arm_step.argtypes = [ctypes.c_void_p, ctypes.c_double, *[vector] * 4]
    n = len(detector.joints)
    text = source.with_suffix(".h").read_text()
    most, row = (
        int(text.split(f"ARM_{word} ")[1].split()[0])
        for word in ("SAMPLES", "IN_A_ROW")
    )

    class State(ctypes.Structure):
        _fields_ = [
            ("contact", ctypes.c_int),
            ("distance", ctypes.c_double),
            ("change", ctypes.c_double * n),
            ("threshold", ctypes.c_double * n),
            ("count", ctypes.c_int),
            ("first", ctypes.c_int),
            ("clock", ctypes.c_double * 2),
            ("recent", ctypes.c_double * row),
            ("memory", ctypes.c_double * (most * (1 + 6 * n))),
        ]

    return found, State()


def as_c(values):
    return None if values is None else (ctypes.c_double * len(values))(*values)


@pytest.mark.slow
@NEEDS_CC
@pytest.mark.parametrize("moves", [True, False])
def test_c_finds_the_same_sample_by_sample(tmp_path, moves):
    make = moving if moves else noise
    log = make(60.0, 5)
    if moves:
        push = np.gradient(log.velocity, log.time, axis=0)
        log = replace(log, acceleration=push, torque_command=2.0 * push)
    detector = ContactDetector.fit([log.samples(slice(0, 9000))])
    library, state = in_c(detector, tmp_path, 200.0)
    rest = log.samples(slice(9000, None))
    torque = rest.torque.copy()
    torque[1500:, 1] += 10.0  # a contact
    assert detector.in_a_row == (3 if moves else 1)
    assert alarms_of_both(detector, library, state, replace(rest, torque=torque)).any()


def alarms_of_both(detector, library, state, log, scale=1.0):
    """Alarms of the detector in C, compared with `step` sample by sample.

    Sums of some tens of numbers differ by their last digits: `scale` is their size.
    """
    known = detector.start(log.time[0])
    library.arm_start(ctypes.byref(state), log.time[0])
    channels = (log.torque, log.velocity, log.acceleration, log.torque_command)
    alarms = []
    for k, time in enumerate(log.time):
        rows = [None if c is None else c[k] for c in channels]
        known = detector.step(known, time, *rows)
        found = library.arm_step(ctypes.byref(state), time, *map(as_c, rows))
        assert found == state.contact == known.contact
        alarms.append(found)
        near = {"rtol": 1e-12 * scale, "atol": 1e-12 * scale}
        np.testing.assert_allclose(state.distance, known.distance, **near)
        np.testing.assert_allclose(list(state.change), known.change, **near)
        threshold = detector.thresholds(known)
        np.testing.assert_allclose(list(state.threshold), threshold, **near)
    return np.array(alarms, dtype=bool)


@pytest.mark.slow
@NEEDS_CC
@pytest.mark.skipif(
    "CONSISTENT_ID_DATASETS" not in os.environ,
    reason="CONSISTENT_ID_DATASETS does not name the folder of recordings",
)
def test_c_finds_the_touches_of_a_recording_as_numpy_does(tmp_path):
    folder = Path(os.environ["CONSISTENT_ID_DATASETS"], "franka_contacts")
    last, *others = [franka(file) for file in sorted(folder.glob("*.parquet"))]
    detector = ContactDetector.fit(
        [log for log, _ in others], free=[label == 0 for _, label in others]
    )
    library, state = in_c(detector, tmp_path, 1000.0)
    log, label = last
    # The largest of the sums is that of 60 torques of some 30 N m.
    alarms = alarms_of_both(detector, library, state, log, scale=100.0)
    np.testing.assert_array_equal(alarms, detector.along(log).contact)
    starts = np.flatnonzero(np.diff(label) > 0) + 1
    assert len(starts) > 3
    for start in starts:  # a glove's label may be late by 50 ms
        near = (log.time > log.time[start] - 0.05) & (log.time < log.time[start] + 0.2)
        assert alarms[near].any()


def franka(file):
    """The log of a resting arm, and the labels of its touches."""
    import pyarrow.parquet as parquet

    table = parquet.read_table(file)
    time = table["time"].to_numpy().astype(float)
    new = np.concatenate([[True], np.diff(time) > 0])
    q, dq, torque = (
        np.column_stack([table[f"{name}{j}"].to_numpy() for j in range(7)])[new]
        for name in ("q", "dq", "tau_J")
    )
    joints = tuple(f"joint_{j + 1}" for j in range(7))
    label = table["label"].to_numpy()[new].astype(int)
    return Recording(joints, time[new], q, velocity=dq, torque=torque), label


@pytest.mark.slow
def test_a_wrong_sample_is_no_contact_and_a_push_is_one():
    log = replace(moving(60.0, 5), torque_command=np.zeros((12000, 3)))
    fitted = ContactDetector.fit([log.samples(slice(0, 9000))])
    rest = log.samples(slice(9000, None))
    size = 10.0 * fitted.along(rest).threshold[1500]
    for samples, found in ((2, False), (3, True), (40, True)):
        torque = rest.torque.copy()
        torque[1500 : 1500 + samples] += size
        contacts = fitted.along(replace(rest, torque=torque))
        assert contacts.contact[1500:1510].any() == found
        assert not contacts.contact[1500:1502].any()
    alone = ContactDetector.fit([log.samples(slice(0, 9000))], in_a_row=1)
    torque = rest.torque.copy()
    torque[1500] += size
    assert alone.along(replace(rest, torque=torque)).contact[1500]


@pytest.mark.parametrize("row", [0, 1.5, np.nan])
def test_samples_in_a_row_are_a_whole_number(row):
    with pytest.raises(ProblemError, match="expected a whole number of samples"):
        ContactDetector.fit([noise(60.0, 0)], in_a_row=row)


@pytest.mark.slow
@NEEDS_CC
def test_c_leaves_out_samples_that_are_none(tmp_path, detector):
    library, state = in_c(detector, tmp_path, 100.0)
    library.arm_start(ctypes.byref(state), 0.0)
    address, zero = ctypes.byref(state), [0.0] * 3

    def step(time, torque):
        return library.arm_step(address, time, as_c(torque), None, None, None)

    assert step(0.01, zero) == 0
    before = bytes(state)
    assert step(0.0, zero) == -1  # the clock goes back
    assert step(0.02, [0.0, np.nan, 0.0]) == -1
    assert step(np.inf, zero) == -1
    assert library.arm_step(address, 0.02, None, None, None, None) == -1
    assert bytes(state) == before
    # 32 samples have room; the 33rd within 0.3 s has not, and later ones have again.
    answers = [step(0.01 + 1e-3 * k, zero) for k in range(1, 40)]
    assert answers[:31] == [0] * 31
    assert set(answers[31:]) == {-2}
    assert step(1.0, zero) == 0


def test_a_memory_without_room_for_a_sample_is_refused(detector):
    with pytest.raises(ProblemError, match="rate is 3"):
        detector.c(rate=3.0)


@pytest.mark.parametrize("time", [np.nan, np.inf])
def test_times_that_are_none_are_refused(detector, time):
    with pytest.raises(ProblemError, match="the time is"):
        detector.start(time)
    with pytest.raises(ProblemError, match="the time is"):
        detector.step(detector.start(0.0), time, np.zeros(3))


@pytest.mark.slow
@NEEDS_CC
def test_c_that_was_started_without_a_time_does_not_stay_silent(tmp_path, detector):
    library, state = in_c(detector, tmp_path, 100.0)
    library.arm_start(ctypes.byref(state), np.nan)
    zero = as_c([0.0] * 3)
    answer = library.arm_step(ctypes.byref(state), 0.0, zero, None, None, None)
    assert answer == -1
