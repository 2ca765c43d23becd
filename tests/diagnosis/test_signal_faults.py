"""Faults that signals show by themselves, put into a clean log one by one."""

from dataclasses import replace

import numpy as np
import pytest
from faulty_logs import clean_log

from consistent_id.diagnosis.clock import velocity_findings
from consistent_id.diagnosis.coverage import saturation_findings
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.frozen_channels import (
    frozen_findings,
    named_as_constant,
    standing_findings,
)
from consistent_id.diagnosis.signal_faults import (
    hold_findings,
    jump_findings,
    noise_findings,
    noise_share,
    resolution_findings,
    spike_findings,
)
from consistent_id.recordings.signals import unwrapped
from consistent_id.recordings.signals.drive_limits import cut_off


def _with(channel, change, joint=1):
    log = clean_log(0)
    values = getattr(log, channel).copy()
    values[:, joint] = change(values[:, joint])
    return replace(log, **{channel: values})


def _stopped(values):
    half = len(values) // 2
    return np.where(np.arange(len(values)) < half, values, values[half])


def test_clean_signals_are_not_accused():
    log = clean_log(0)
    found = [*frozen_findings(log), *spike_findings(log), *jump_findings(log)]
    found += [*noise_findings(log), *hold_findings(log), *standing_findings(log)]
    assert found + resolution_findings(log, log) == []


@pytest.mark.parametrize("channel", ["torque", "velocity", "position"])
def test_a_channel_that_stops_while_the_joint_moves_is_frozen(channel):
    (finding,) = frozen_findings(_with(channel, _stopped))
    assert (finding.kind, finding.where) == ("frozen channel", "joint2")
    assert f"{channel} is" in finding.statement
    assert "from 10 s" in finding.statement


def test_a_dead_torque_is_zero_without_a_sign():
    log = clean_log(0)
    dead = replace(log, torque=log.torque * [1.0, -0.0, 1.0, 1.0])
    (finding,) = frozen_findings(dead)
    assert "torque is 0 throughout" in finding.statement


@pytest.mark.parametrize("kind", ["encoder scale", "offset zero", "clock"])
def test_a_position_that_never_changes_is_said_to(kind):
    log = replace(clean_log(0), velocity=None, acceleration=None)
    position = log.position.copy()
    position[:, 1] = 0.3
    found = LogFinding(kind, "fault", "joint2", "times 0.02", "multiply")
    named = named_as_constant(found, replace(log, position=position))
    assert named_as_constant(found, log) == found
    if kind == "clock":
        assert named == found
    else:
        assert named.kind == "dead channel"
        assert (
            "position is 0.3 throughout: the channel never changes" in named.statement
        )
        assert "--lock joint2=POSITION" in named.advice


def _cruising():
    """A log without noise whose second joint moves at one speed for 3 s of 20 s."""
    log = clean_log(0)
    velocity = log.velocity.copy()
    velocity[2000:2600, 1] = 0.5
    position = np.cumsum(velocity, axis=0) * np.diff(log.time)[0]
    weights = np.hanning(100) / np.hanning(100).sum()
    torque = np.column_stack(
        [np.convolve(column, weights, "same") for column in log.torque.T]
    )
    torque[2000:2600, 1] = 3.0
    return replace(log, position=position, velocity=velocity, torque=torque)


def test_a_joint_at_one_speed_has_one_velocity_and_may_have_one_torque():
    assert frozen_findings(_cruising()) == []


@pytest.mark.parametrize(
    ("noise", "step", "kinds"),
    [
        (0.02, 0.0, ["frozen channel"]),
        (0.02, 0.005, ["frozen channel"]),
        (0.0, 0.005, []),  # the last digit flickers
        (0.002, 0.005, []),
    ],
)
def test_a_noisy_torque_is_not_constant_at_one_speed(noise, step, kinds):
    log, rng = _cruising(), np.random.default_rng(0)
    values = log.torque + noise * rng.normal(size=log.torque.shape)
    if step:
        values = np.round(values / step) * step
    values[2000:2600, 1] = 3.0
    found = frozen_findings(replace(log, torque=values))
    assert [f.kind for f in found] == kinds


@pytest.mark.parametrize("channel", ["torque", "velocity"])
def test_a_channel_that_stops_elsewhere_is_found_beside_a_joint_at_one_speed(channel):
    log = _cruising()
    values = getattr(log, channel).copy()
    values[600:1100, 1] = values[600, 1]
    (finding,) = frozen_findings(replace(log, **{channel: values}))
    assert f"{channel} is {values[600, 1]:.4g} from 3 s" in finding.statement


@pytest.mark.parametrize(("channel", "value"), [("torque", 0.0), ("velocity", 0.6)])
def test_a_value_that_the_joints_speed_does_not_explain_is_frozen(channel, value):
    log = _cruising()
    values = getattr(log, channel).copy()
    values[2000:2600, 1] = value
    (finding,) = frozen_findings(replace(log, **{channel: values}))
    assert channel in finding.statement


@pytest.mark.parametrize("limit", [0.2, -0.6])
def test_a_torque_that_is_limited_on_one_side_is_saturated_and_not_frozen(limit):
    # Largest in size on the other side, where it is not limited.
    def limited(torque):
        return np.minimum(torque - np.median(torque), limit * np.std(torque))

    log = _with("torque", limited)
    assert frozen_findings(log) == []
    (finding,) = saturation_findings(log)
    assert (finding.kind, finding.where) == ("saturation", "joint2")
    level = log.torque[:, 1].max()
    assert f"torque stays at {level:.4g} in" in finding.statement
    mirrored = replace(log, torque=-log.torque)
    assert frozen_findings(mirrored) == []
    (finding,) = saturation_findings(mirrored)
    assert f"torque stays at {-level:.4g} in" in finding.statement
    # A channel that stops at its largest value does not come back to it.
    (finding,) = frozen_findings(
        _with("torque", lambda t: np.append(t[:2000], np.full(2000, t[:2000].max())))
    )
    assert finding.kind == "frozen channel"


def test_a_torque_that_is_limited_on_both_sides_stays_at_both_values():
    log = _with("torque", lambda t: np.clip(t - np.median(t), -0.4, 0.6))
    (finding,) = saturation_findings(log)
    assert "torque stays at -0.4 and 0.6 in" in finding.statement


def test_the_torque_of_a_drive_that_is_switched_off_is_not_cut_off():
    log = _with("torque", lambda t: np.maximum(t - np.median(t), 0.0))
    assert not cut_off(log).any()


def test_a_rounded_torque_that_never_changes_its_sign_is_not_cut_off():
    # The least value is read as often as the next ones, and often enough for a limit.
    rng = np.random.default_rng(0)
    log = _with("torque", lambda t: rng.integers(20, 40, len(t)).astype(float))
    assert not cut_off(log).any()


def test_a_value_between_others_that_a_torque_comes_back_to_is_no_limit():
    stops = [slice(600, 1400), slice(2200, 2600)]

    def stopping(torque):
        for stop in stops:
            torque[stop] = np.median(torque)
        return torque

    (finding,) = frozen_findings(_with("torque", stopping))
    assert finding.kind == "frozen channel"


def test_a_joint_that_moves_by_less_than_its_encoder_reads_is_not_frozen():
    log = clean_log(0)
    # At the end the joint creeps by 0.04 rad, within one step of 0.05 rad.
    slow = np.append(np.sin(np.linspace(0, 20, 3200)), np.linspace(0.98, 1.02, 800))
    velocity, position = log.velocity.copy(), log.position.copy()
    velocity[:, 1] = np.gradient(slow, log.time)
    position[:, 1] = np.round(slow / 0.05) * 0.05
    read = replace(log, position=position, velocity=velocity)
    assert frozen_findings(read) == []
    position = read.position.copy()
    position[500:1500, 1] = position[500, 1]
    (finding,) = frozen_findings(replace(read, position=position))
    assert (finding.kind, finding.where) == ("frozen channel", "joint2")


def test_a_coarse_torque_that_changes_by_one_step_is_not_frozen():
    time = np.arange(4000) / 200.0
    torque = np.round(2.4 * np.sin(time / 3.0))  # 2 N m for 5.4 s, and then 1
    torque[0] = 3.0  # so that the longest run is not at the limit

    def found(values):
        return [f.kind for f in frozen_findings(_with("torque", lambda _: values))]

    assert found(torque) == []
    assert found(_stopped(torque)) == ["frozen channel"]  # up to the end
    rows = (time > 9.0) & (time < 16.0)
    assert found(np.where(rows, 0.0, torque)) == ["frozen channel"]  # then two steps


def test_spikes_are_counted_and_steps_are_none():
    rows = [300, 1000, 2500]

    def spoilt(tau):
        out = tau.copy()
        out[rows] += 20.0 * np.std(tau)
        return out

    (finding,) = spike_findings(_with("torque", spoilt))
    assert "3 of 4000" in finding.statement
    stepped = _with("torque", lambda tau: tau + np.where(np.arange(4000) > 900, 50, 0))
    assert spike_findings(stepped) == []


def test_an_encoder_that_wraps_and_rows_that_are_lost_are_told_apart():
    wrapped = _with("position", lambda q: np.mod(q, 0.6 * np.ptp(q)))
    (finding,) = jump_findings(wrapped)
    assert (finding.kind, finding.where) == ("wrapped encoder", "joint2")
    assert "numpy.unwrap" in finding.advice
    wrapped = _with("position", lambda q: np.mod(3.0 * q, 2.0 * np.pi))
    assert {f.kind for f in jump_findings(wrapped)} == {"wrapped encoder"}
    assert "--wraps undo" in jump_findings(wrapped)[0].advice
    assert jump_findings(unwrapped(wrapped)) == []
    log = clean_log(0)
    kept = np.r_[0:2000, 2300:4000]
    lost = log.samples(kept)
    (finding,) = jump_findings(replace(lost, time=log.time[: len(kept)]))
    assert finding.kind == "gap"
    # Stamps that are missing too say so themselves: the log is cut there.
    assert jump_findings(lost) == []


def test_white_noise_is_measured_beside_a_smooth_signal():
    rng, time = np.random.default_rng(0), np.arange(20000) / 1000.0
    smooth = np.sin(time)[:, None]
    noisy = smooth + 0.3 * rng.normal(size=smooth.shape)
    expected = 0.3 / np.sqrt(np.var(smooth) + 0.09)
    # Twenty thousand draws know the median of their sizes to a percent.
    assert noise_share(noisy)[0] == pytest.approx(expected, rel=0.03)


def test_a_clock_of_another_speed_and_a_late_velocity_are_told_apart():
    log = clean_log(0)
    (finding,) = velocity_findings(replace(log, time=0.8 * log.time))
    assert (finding.kind, finding.where) == ("clock", "all joints")
    assert "0.8" in finding.statement
    late = replace(log, velocity=np.roll(log.velocity, 14, axis=0))
    (finding,) = velocity_findings(late.samples(slice(20, -20)))
    assert finding.kind == "lag"
    assert "70 ms later" in finding.statement


def test_a_joint_at_rest_does_not_jump():
    log, rng = clean_log(0), np.random.default_rng(0)
    # The last digit of an encoder, now and then, as of a UR10e's joints at rest.
    flips = 1e-4 * np.cumsum(rng.choice([-1, 0, 1], len(log), p=[0.005, 0.99, 0.005]))
    position = log.position.copy()
    position[:, 1] = 0.3 + np.clip(flips, -2e-4, 2e-4)
    assert jump_findings(replace(log, position=position, velocity=None)) == []


def test_a_ratio_of_few_samples_in_motion_is_chance():
    """Half a second of motion, the velocity rounded: no clock, no scale is shown."""
    log = clean_log(0)
    still = np.ones(len(log.time))
    still[100:] = 0.0
    rng = np.random.default_rng(0)
    moved = np.cumsum(log.velocity * still[:, None], axis=0) / log.rate
    rough = log.velocity + 1.0 * log.velocity.std(axis=0) * rng.normal(
        size=log.velocity.shape
    )
    few = replace(log, position=moved, velocity=1.12 * rough * still[:, None])
    assert velocity_findings(few) == []
    many = replace(log, velocity=1.12 * log.velocity)
    assert [f.kind for f in velocity_findings(many)] == ["clock"]


def _held(log, samples):
    """Return a log of which the torque is new in every so many-th sample."""
    rows = np.arange(len(log)) // samples * samples
    return replace(log, torque=log.torque[rows])


def test_a_torque_that_is_held_is_neither_coarse_nor_at_its_limit():
    log = _held(clean_log(0), 20)  # of 200 Hz
    (finding,) = hold_findings(log)
    assert (finding.kind, finding.severity) == ("torque resolution", "warning")
    assert finding.where == ", ".join(log.joints)
    # Of 3999 samples with one before, 199 are new.
    assert "95% of the torque samples repeat the one before" in finding.statement
    assert "updated only every 0.1 s" in finding.statement
    assert saturation_findings(log) == resolution_findings(log, log) == []
    few = log.samples(slice(0, 800))  # 40 values
    assert resolution_findings(few, few) == []


@pytest.mark.parametrize(("frequency", "severity"), [(0.5, "warning"), (1.5, "fault")])
def test_what_a_torque_loses_between_updates_decides_on_a_fault(frequency, severity):
    """Of a sine, neighbours a time T apart differ by 2 sin(w T / 2) of its size."""
    log = clean_log(0)
    wave = np.sin(2.0 * np.pi * frequency * log.time)
    held = _held(replace(log, torque=np.column_stack([wave] * len(log.joints))), 20)
    (finding,) = hold_findings(held)
    lost = 2.0 * np.sin(np.pi * frequency * 0.1) / np.sqrt(12.0)
    assert f"{lost:.0%} of it is lost" in finding.statement
    assert finding.severity == severity


def _standing(samples, *, brakes=False):
    """Return a log that repeats a row, or of a robot that brakes and rests."""
    log = clean_log(0)
    rows = np.arange(len(log))
    if brakes:  # along the same path, slower and slower, and back to speed
        pace = np.clip(abs(rows - 2000) / 300.0 - 0.2, 0.0, 1.0)
        path = np.cumsum(pace)
        position = np.column_stack([np.interp(path, rows, q) for q in log.position.T])
        still = np.concatenate(
            [[False], (np.diff(position, axis=0) == 0.0).all(axis=1)]
        )
        last = np.maximum.accumulate(np.where(still, 0, rows))
        return replace(log, position=position, velocity=None, torque=log.torque[last])
    kept = np.where(rows < 2000, rows, np.maximum(rows - samples, 2000))
    return replace(log, position=log.position[kept], torque=log.torque[kept])


@pytest.mark.parametrize(
    ("samples", "severities"), [(400, ["fault"]), (60, ["warning"]), (30, [])]
)
def test_a_log_that_repeats_a_row_stood_still_and_no_robot_did(samples, severities):
    found = standing_findings(_standing(samples))
    assert [f.severity for f in found] == severities
    assert all("(10 to 12 s)" in f.statement for f in found if f.severity == "fault")


def test_a_robot_that_brakes_and_rests_is_no_log_that_stood_still():
    log = _standing(0, brakes=True)
    rests = (np.diff(log.position, axis=0) == 0.0).all(axis=1)
    assert rests.sum() > 100  # half a second
    assert standing_findings(log) == []
    brief = log.samples(
        slice(1930, 2070)
    )  # nearly all rest: too little to compare with
    assert standing_findings(brief) == []
    coarse = replace(log, position=np.round(log.position / 1e-4) * 1e-4)
    assert standing_findings(coarse) == []


def test_a_torque_that_is_held_for_less_than_a_filter_takes_is_not_worth_a_word():
    assert hold_findings(_held(clean_log(0), 4)) == []


def test_a_limit_shows_in_a_torque_that_is_held():
    log = clean_log(0)
    limit = 0.6 * abs(log.torque[:, 1]).max()
    clipped = log.torque.copy()
    clipped[:, 1] = np.clip(clipped[:, 1], -limit, limit)
    (finding,) = saturation_findings(_held(replace(log, torque=clipped), 10))
    assert finding.where == "joint2"


def test_a_stretch_in_which_a_joint_hardly_moves_is_not_without_a_signal():
    rng, time = np.random.default_rng(0), np.arange(2000) / 200.0
    rest = np.where(np.arange(2000) < 1600, 50.0 * np.sin(3.0 * time), 20.0)
    log = clean_log(0).samples(slice(0, 2000))
    torque = np.array(log.torque)
    torque[:, 1] = rest + rng.normal(size=2000)
    log = replace(log, torque=torque)
    moving, still = log.samples(slice(0, 1600)), log.samples(slice(1600, None))
    (finding,) = noise_findings(still)
    assert (finding.kind, finding.where) == ("torque channel", "joint2")
    assert noise_findings(still, [moving]) == []
    # Noise as large as what the channel has elsewhere is all that there is.
    torque = np.array(still.torque)
    torque[:, 1] = 80.0 * rng.normal(size=len(torque))
    noisy = replace(still, torque=torque)
    assert [f.severity for f in noise_findings(noisy, [moving])] == ["fault"]


def test_few_leaps_of_a_short_log_prove_no_share_of_them():
    log = clean_log(0).samples(slice(0, 450))

    def leaping(count):
        torque = np.array(log.torque)
        torque[20 : 20 + 30 * count : 30, 1] += 20.0 * np.std(torque[:, 1])
        return spike_findings(replace(log, torque=torque))

    assert [f.severity for f in leaping(1)] == ["warning"]
    assert [f.severity for f in leaping(9)] == ["fault"]
    # Beside what the channel does elsewhere they are small.
    wide = replace(log, torque=1e3 * np.asarray(log.torque))
    torque = np.array(log.torque)
    torque[20, 1] += 20.0 * np.std(torque[:, 1])
    assert spike_findings(replace(log, torque=torque), [wide]) == []
