"""A recording is checked once, at the door, and never changes afterwards."""

from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording, instant

JOINTS = ("shoulder", "elbow", "wrist")
CHANNELS = ("position", "velocity", "acceleration", "torque")
# Seeds explicit: hypothesis derives its examples from the test's own source.
REPEATABLE = settings(derandomize=True, deadline=None, max_examples=50)


def arrays(samples=6):
    """All channels, every entry different from every other."""
    values = np.arange(4.0 * samples * len(JOINTS))
    channels = values.reshape(4, samples, len(JOINTS))
    time = 10.0 + 0.25 * np.arange(samples)
    return {"time": time, **dict(zip(CHANNELS, channels, strict=True))}


def recording(**changed):
    return Recording(JOINTS, **(arrays() | changed))


@pytest.mark.parametrize("channel", CHANNELS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_is_named_by_channel_joint_and_sample(
    channel, value
):
    faulty = arrays()[channel].copy()
    faulty[4, 1] = value
    with pytest.raises(
        RecordingError,
        match=rf"^log 7: {channel} of joint 'elbow' is {value} at sample 4 \(t = 11 s",
    ):
        recording(**{channel: faulty}, name="log 7")


def test_the_first_of_several_faults_in_time_is_named_and_all_are_counted():
    faulty = arrays()["torque"].copy()
    faulty[[5, 2, 3], [0, 2, 1]] = np.nan
    with pytest.raises(RecordingError, match=r"'wrist'.*sample 2 .*first of 3"):
        recording(torque=faulty)


@pytest.mark.parametrize(
    ("time", "message"),
    [
        ([0, 1, 2, 2, 3, 4], r"from 2 s \(sample 2\) to 2 s.*repeated"),
        ([0, 1, 2, 1.5, 3, 4], r"from 2 s \(sample 2\) to 1\.5 s.*[Ss]ort"),
        ([5, 4, 3, 2, 1, 0], r"from 5 s \(sample 0\) to 4 s"),
        ([0, 1, 2, 3, 4, 0], r"from 4 s \(sample 4\) to 0 s"),
        ([0, 1, np.nan, 3, 4, 5], "time of sample 2 is nan"),
        ([0, 1, 2, 3, 4, np.inf], "time of sample 5 is inf"),
    ],
)
def test_time_that_does_not_increase_is_refused_with_the_sample(time, message):
    with pytest.raises(RecordingError, match=message):
        recording(time=time)


def test_a_repeated_stamp_is_seen_next_to_epoch_time():
    # Unix time in double precision: 2.4e-7 s is one unit in the last place.
    step = np.spacing(1.7e9)
    stamps = 1.7e9 + step * np.arange(6)
    assert len(recording(time=stamps)) == 6
    stamps[3] = stamps[2]
    with pytest.raises(RecordingError, match="sample 2"):
        recording(time=stamps)


@pytest.mark.parametrize("channel", CHANNELS)
@pytest.mark.parametrize("shape", [(5, 3), (6, 2), (3, 6), (6,), (6, 3, 1), ()])
def test_a_channel_of_another_shape_is_refused(channel, shape):
    with pytest.raises(
        RecordingError, match=rf"{channel}: expected shape \(6, 3\), got"
    ):
        recording(**{channel: np.zeros(shape)})


@pytest.mark.parametrize("time", [np.zeros((6, 1)), 3.0])
def test_time_that_is_not_a_vector_is_refused(time):
    with pytest.raises(RecordingError, match=r"time: expected shape \(any\)"):
        recording(time=time)


@pytest.mark.parametrize("values", [[["x"] * 3] * 6, [[1, 2, 3], [4, 5]], 1j])
def test_what_is_not_an_array_of_numbers_is_refused(values):
    with pytest.raises(RecordingError, match="velocity: expected numbers"):
        recording(velocity=values)


@pytest.mark.parametrize("samples", [0, 1])
def test_fewer_than_two_samples_are_refused(samples):
    with pytest.raises(RecordingError, match=f"{samples} samples, expected 2"):
        Recording(JOINTS, **arrays(samples))


@pytest.mark.parametrize("joints", [(), ("elbow", "wrist", "elbow")])
def test_joints_need_distinct_names(joints):
    with pytest.raises(RecordingError, match="expected distinct names"):
        Recording(joints, **arrays())


def test_arrays_are_copies_that_cannot_be_written():
    given_arrays = arrays()
    log = Recording(JOINTS, **given_arrays)
    for name, mine in given_arrays.items():
        kept = getattr(log, name)
        assert not np.shares_memory(kept, mine)
        with pytest.raises(ValueError, match="read-only"):
            kept[0] = 1.0
        mine *= -1.0
        np.testing.assert_array_equal(kept, arrays()[name])
    with pytest.raises(FrozenInstanceError):
        log.time = np.arange(6.0)


def test_integers_and_lists_become_float64():
    log = Recording(("elbow",), [0, 1], [[1], [2]], torque=[[3], [4]])
    assert {log.time.dtype, log.position.dtype, log.torque.dtype} == {
        np.dtype("float64")
    }
    assert log.velocity is None and log.acceleration is None


def test_rate_is_steps_over_duration():
    log = recording(time=[0.0, 0.1, 0.2, 0.5, 0.6, 1.0])
    assert (len(log), log.duration, log.rate) == (6, 1.0, 5.0)


@REPEATABLE
@given(st.lists(st.sampled_from(JOINTS), min_size=1, max_size=3, unique=True))
def test_joints_are_matched_by_name_whatever_their_order(names):
    log = recording()
    chosen = log.of(names)
    assert chosen.joints == tuple(names)
    for channel in CHANNELS:
        for place, name in enumerate(names):
            column = getattr(log, channel)[:, JOINTS.index(name)]
            np.testing.assert_array_equal(getattr(chosen, channel)[:, place], column)
    np.testing.assert_array_equal(chosen.time, log.time)


@REPEATABLE
@given(st.permutations(JOINTS))
def test_reordering_joints_and_back_changes_nothing(order):
    log = recording()
    back = log.of(order).of(JOINTS)
    for channel in CHANNELS:
        np.testing.assert_array_equal(getattr(back, channel), getattr(log, channel))


def test_a_channel_that_was_not_recorded_stays_absent():
    log = Recording(JOINTS, arrays()["time"], arrays()["position"], name="log 7")
    for changed in (log.of(("wrist",)), log.samples(slice(3))):
        assert changed.velocity is changed.acceleration is changed.torque is None
        assert changed.name == "log 7"


def test_a_joint_that_was_not_recorded_is_refused_with_near_names():
    with pytest.raises(RecordingError, match="no joint 'elbo'; known: elbow"):
        recording().of(("wrist", "elbo"))


def test_a_joint_cannot_be_asked_for_twice():
    with pytest.raises(RecordingError, match="distinct names"):
        recording().of(("wrist", "wrist"))


@pytest.mark.slow
@REPEATABLE
@given(
    st.integers(2, 30),
    st.integers(0, 5) | st.none(),
    st.integers(6, 30) | st.none(),
    st.integers(1, 4),
)
def test_a_run_of_samples_keeps_time_and_channels_together(n, start, stop, step):
    keep = slice(start, stop, step)
    kept = range(n)[keep]
    log = Recording(JOINTS, **arrays(n))
    if len(kept) < 2:
        with pytest.raises(RecordingError, match="expected 2 or more"):
            log.samples(keep)
        return
    part = log.samples(keep)
    for name, values in arrays(n).items():
        np.testing.assert_array_equal(getattr(part, name), values[list(kept)])
    # Quarter-second steps are exact in binary, and so are their sums.
    assert part.duration == 0.25 * step * (len(kept) - 1)


def test_samples_do_not_run_backwards():
    with pytest.raises(RecordingError, match="must increase"):
        recording().samples(slice(None, None, -1))


@pytest.mark.parametrize(
    ("start", "duration", "at", "said"),
    [
        (0.0, 20.0, 12.34567, "12.35"),
        (0.0, 2000.0, 1234.567, "1235"),
        (0.0, 30000.0, 20000.4, "20000"),
        (1772619072.0, 20.0, 12.34567, "1772619084.3"),
        (-50.0, 5.0, 1.23456, "-48.765"),
        (3.0, 0.0, 0.0, "3"),
    ],
)
def test_an_instant_is_told_from_others_of_its_log(start, duration, at, said):
    assert instant(start + at, start + np.array([0.0, duration])) == said
