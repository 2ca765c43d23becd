"""Units of logs: the factors, who states them, and what is refused."""

import math
import re
import shlex

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from consistent_id import (
    Columns,
    Recording,
    RecordingError,
    read_recording,
    recording_from,
)
from consistent_id.problems.statement_words import units as units_of
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.readers.units import (
    KNOWN,
    factors,
    fraction_unit,
    is_time,
    split_clock,
    standard_unit,
    unit_of_a_name,
)
from consistent_id.recordings.time_stamps import unit_option

# By definition: a turn is 2 pi rad, a minute 60 s.
FACTORS = {
    ("time", "ms"): 1e-3,
    ("time", "µs"): 1e-6,
    ("time", "nanoseconds"): 1e-9,
    ("position", "deg"): math.pi / 180,
    ("position", "°"): math.pi / 180,
    ("position", "turns"): 2 * math.pi,
    ("position", "mm"): 1e-3,
    ("velocity", "rpm"): 2 * math.pi / 60,
    ("velocity", "deg/s"): math.pi / 180,
    ("velocity", "degrees per second"): math.pi / 180,
    ("velocity", "mm/s"): 1e-3,
    ("velocity", "dps"): math.pi / 180,
    ("velocity", "deg s^-1"): math.pi / 180,
    ("velocity", "deg·s⁻¹"): math.pi / 180,
    ("velocity", "rad.s-1"): 1.0,
    ("velocity", "deg_s"): math.pi / 180,
    ("velocity", "mdegps"): math.pi / 180e3,
    ("velocity", "mradps"): 1e-3,
    ("position", "Grad"): math.pi / 180,
    ("velocity", "Grad/s"): math.pi / 180,
    ("position", "mdeg"): math.pi / 180e3,
    ("position", "µrad"): 1e-6,
    ("acceleration", "deg.s^-2"): math.pi / 180,
    ("velocity", "rev/s"): 2 * math.pi,
    ("acceleration", "deg/s^2"): math.pi / 180,
    ("acceleration", "mm/s²"): 1e-3,
    ("torque", "mNm"): 1e-3,
    ("torque", "kN m"): 1e3,
    ("torque", "N·m"): 1.0,
    ("torque", "percent"): 1e-2,
    ("torque", "‰"): 1e-3,
    ("torque", "mA"): 1e-3,
}


@pytest.mark.parametrize(("channel", "unit"), FACTORS)
def test_a_unit_has_its_factor(channel, unit):
    factor = KNOWN[channel][standard_unit(channel, unit)]
    assert factor == pytest.approx(FACTORS[channel, unit], rel=1e-15)


@pytest.mark.parametrize(
    ("channel", "unit", "factor"),
    [
        ("position", "rev/4096", 2 * math.pi / 4096),
        ("position", "rev/1e6", 2e-6 * math.pi),
        ("velocity", "rev/2048/s", 2 * math.pi / 2048),
        ("velocity", "rev/2048/min", 2 * math.pi / 2048 / 60),
    ],
)
def test_counts_of_an_encoder_are_parts_of_a_turn(channel, unit, factor):
    known = {channel: standard_unit(channel, unit)}
    assert factors(known, channel, ["a"]) == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize(
    "unit", ["rev/0", "rev/-4096", "deg/4096", "rev/", "rev/1e400"]
)
def test_other_parts_of_a_turn_are_refused(unit):
    with pytest.raises(RecordingError, match="no unit"):
        standard_unit("position", unit)


@pytest.mark.parametrize(
    ("names", "advice"),
    [
        (Columns(position="q_{joint}_ticks"), "--units position=rev/COUNTS"),
        (
            Columns(position="q_{joint}", velocity="dq_{joint} [counts/s]"),
            "--units velocity=rev/COUNTS/s",
        ),
        (
            Columns(position="q_{joint}", acceleration="ddq_{joint}_ticks"),
            "--units acceleration=rev/COUNTS/s^2",
        ),
        (
            Columns(position="q_{joint}", velocity="dq_counts_per_min_{joint}"),
            "--units velocity=rev/COUNTS/min",
        ),
    ],
)
def test_counts_in_a_name_are_asked_for_the_counts_of_a_turn(tmp_path, names, advice):
    file = tmp_path / "log.csv"
    header = "time,q_a,q_a_ticks,dq_a [counts/s],ddq_a_ticks,dq_counts_per_min_a"
    file.write_text(f"{header}\n0,0,0,0,0,0\n1,1,4096,2,2,2\n")
    with pytest.raises(RecordingError, match=re.escape(advice)) as caught:
        read_recording(file, ["a"], names)
    assert shlex.split(caught.value.options) == advice.split()


def test_a_number_of_time_steps_is_no_count_of_an_encoder(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("time_steps,q_a\n0,0\n1,1\n2,3\n")
    log = read_recording(file, ["a"], Columns(time="time_steps", position="q_{joint}"))
    assert log.time.tolist() == [0.0, 1.0, 2.0]


@given(st.sampled_from([(c, u) for c, units in KNOWN.items() for u in units]))
def test_a_unit_as_it_is_spelt_here_stands_for_itself(known):
    channel, unit = known
    assert standard_unit(channel, unit) == unit


TABLE = {
    "time": [0.0, 500.0, 1000.0],
    "q_a": [0.0, 90.0, 180.0],
    "q_b": [0.0, 10.0, 20.0],
    "tau_a": [50.0, -100.0, 0.0],
    "tau_b": [10.0, 20.0, 30.0],
}


def test_values_are_converted_joint_by_joint():
    columns = Columns(
        torque="tau_{joint}",
        units={"time": "ms", "position": ["deg", "mm"], "torque": "%"},
    )
    log = recording_from(TABLE, ["a", "b"], columns, torque_gain=[20.0, 300.0])
    np.testing.assert_allclose(log.time, [0, 0.5, 1])
    np.testing.assert_allclose(log.position[:, 0], [0, math.pi / 2, math.pi])
    np.testing.assert_allclose(log.position[:, 1], [0, 0.01, 0.02])
    # Percent of a rated torque of 20 N m, and of a rated force of 300 N.
    np.testing.assert_allclose(log.torque, [[10, 30], [-20, 60], [0, 90]])


@pytest.mark.parametrize("unit", ["%", "permille", "A", "mA"])
def test_shares_and_currents_are_no_torque_without_a_gain(unit):
    columns = Columns(torque="tau_{joint}", units={"torque": unit})
    with pytest.raises(RecordingError, match=r"without a gain.*--torque-gain"):
        recording_from(TABLE, ["a", "b"], columns)
    assert recording_from(TABLE, ["a", "b"], columns, torque_gain=2.0).torque.any()


REFUSED = {
    "channel": ({"positon": "deg"}, "no channel 'positon'; known: position"),
    "unit": ({"position": "dge"}, "no unit 'dge' of position; known: deg"),
    "dimension": ({"position": "deg/s"}, "no unit 'deg/s' of position"),
    "count": ({"position": ["deg"]}, "1 units of position for 2 joints"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_unit_is_refused(case):
    units, says = REFUSED[case]
    with pytest.raises(RecordingError, match=says):
        recording_from(TABLE, ["a", "b"], Columns(units=units))


def test_a_unit_that_a_name_states_is_asked_for_until_it_is_stated(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("time,q_a_deg\n0,0\n1,180\n")
    named = Columns(position="q_{joint}_deg")
    with pytest.raises(RecordingError, match=r"--units position=deg"):
        read_recording(file, ["a"], named)
    stated = Columns(position="q_{joint}_deg", units={"position": "deg"})
    log = read_recording(file, ["a"], stated)
    np.testing.assert_allclose(log.position[:, 0], [0, math.pi])


def test_in_the_shell_an_angle_is_also_that_of_derivatives_and_commands():
    assert units_of(["deg", "ms", "%"]) == {
        "position": "deg",
        "velocity": "deg/s",
        "acceleration": "deg/s^2",
        "time": "ms",
        "position_command": "deg",
        "velocity_command": "deg/s",
        "torque": "%",
    }
    assert units_of(["velocity=rpm", "deg"])["velocity"] == "rpm"
    assert units_of(["position=deg,mm"]) == {"position": ["deg", "mm"]}
    with pytest.raises(RecordingError, match="no unit 'furlong'; known: s, ms"):
        units_of(["furlong"])


@pytest.mark.parametrize("name", ["ts", "Zeit [ms]", "state.ts", "datetime"])
def test_further_names_of_a_clock(name):
    assert is_time(name)


@pytest.mark.parametrize(
    ("said", "unit", "newton_metres"),
    [
        ("kg.cm", "kgf cm", 0.0980665),
        ("kgf*m", "kgf m", 9.80665),
        ("in-lb", "lbf in", 0.1129848290276167),  # NIST SP 811, appendix B
        ("lbf ft", "lbf ft", 1.3558179483314),
        ("oz-in", "ozf in", 7.0615518142e-3),
        ("LB.IN", "lbf in", 0.1129848290276167),
        ("ft*lb", "lbf ft", 1.3558179483314),
        ("N.mm", "N mm", 1e-3),
    ],
)
def test_torques_of_servos_and_of_workshops(said, unit, newton_metres):
    assert standard_unit("torque", said) == unit
    assert KNOWN["torque"][unit] == pytest.approx(newton_metres, rel=1e-10)
    assert unit_of_a_name("torque", f"tau_{{joint}} [{said}]") == unit


def test_a_clock_of_two_columns_is_in_no_unit_of_its_own(tmp_path):
    file = tmp_path / "log.csv"
    rows = [f"170000000{k // 4},{250000000 * (k % 4)},{k},{k}" for k in range(8)]
    file.write_text("\n".join(["secs,nsecs,q_a,tau_a", *rows]))
    columns = guess_columns(file, KnownColumns(("a",))).columns
    assert (columns.time, columns.units) == ("secs + nsecs", {})
    log = read_recording(file, ["a"], columns)
    np.testing.assert_allclose(np.diff(log.time), 0.25)


@pytest.mark.parametrize("said", ["-Nm", "ozft", "Nm-"])
def test_what_is_no_unit_of_torque_is_refused(said):
    with pytest.raises(RecordingError, match="no unit"):
        standard_unit("torque", said)


@pytest.mark.parametrize(
    ("channel", "name", "unit"),
    [
        ("position", "pos_deg_J{number}", "deg"),
        ("position", "Angle (deg) Joint {number}", "deg"),
        ("position", "position [deg].{joint}", "deg"),
        ("position", "q_deg[{index}]", "deg"),
        ("velocity", "vel_rpm_axis{number}", "rev/min"),
        ("torque", "tau_mNm_J{number}", "mN m"),
        ("torque", "{joint}_force [kN]", "kN"),
        ("velocity", "vel_degps_J{number}", "deg/s"),
        ("velocity", "vel{number}_deg_s", "deg/s"),
        ("velocity", "dq{number} [deg.s-1]", "deg/s"),
        ("velocity", "dq{number} [rad.s^-1]", ""),
        ("position", "q{number}_mrad", "mrad"),
        ("position", "q[{index}]", ""),
        ("position", "pos_rad_J{number}", ""),
    ],
)
def test_a_unit_may_stand_before_the_joint(channel, name, unit):
    assert unit_of_a_name(channel, name) == unit


@pytest.mark.parametrize(
    ("name", "unit", "is_clock"),
    [
        ("time [min]", "min", True),
        ("time_min", "min", True),
        ("Time (h)", "h", True),
        ("t [days]", "day", True),
        ("q_min", "", False),
    ],
)
def test_minutes_and_hours_are_units_of_clocks_alone(name, unit, is_clock):
    """A clock in minutes was read in seconds; q_min is the least of an angle."""
    channel = "time" if is_clock else "position"
    assert unit_of_a_name(channel, name) == unit
    assert is_time(name) == is_clock


@pytest.mark.parametrize("unit", ["mdegps", "mdps", "mradps"])
def test_small_units_of_velocity_are_those_of_a_name(unit):
    """They were taken as rad/s."""
    assert unit_of_a_name("velocity", f"dq{{number}}_{unit}") in ("mdeg/s", "mrad/s")


def test_a_clock_in_two_columns_may_be_named_with_capitals():
    names = ["TimestampSec", "TimestampNanoSec", "q1"]
    assert split_clock(names) == "TimestampSec + TimestampNanoSec"
    assert split_clock(["ZeitInSec", "ZeitInNanoSec"]) == "ZeitInSec + ZeitInNanoSec"
    assert fraction_unit("log", "TimestampNanoSec") == 1e-9
    assert fraction_unit("log", "stamp.nanosec") == 1e-9


@pytest.mark.parametrize(
    ("start", "step", "unit"),
    [
        (1.7e12, 10.0, "ms"),
        (1.7e15, 100.0, "us"),  # 10 kHz, not 10 Hz in milliseconds
        (6.39e17, 1e5, "100ns"),  # from the year 1
        (1.34e17, 1e5, "100ns"),  # from 1601
        (1.7e18, 1e6, "ns"),
        (0.5, 1e-7, "day"),
    ],
)
def test_the_unit_of_a_clock_is_known_by_the_year_from_which_it_counts(
    start, step, unit
):
    times = start + step * np.arange(5)
    assert unit_option(times) == f"--units time={unit}"


def test_stamps_that_are_all_equal_need_a_rate():
    q = np.arange(5.0)[:, None]
    with pytest.raises(RecordingError, match="--time RATEHz"):
        Recording(("a",), np.full(5, 1.7e9), q)


def test_degrees_of_german_headers_are_no_radians():
    """`Winkel 1 [Grad]` was read in rad, in silence."""
    assert unit_of_a_name("position", "Winkel {number} [Grad]") == "deg"
    assert unit_of_a_name("velocity", "Geschwindigkeit_{number}_Grad/s") == "deg/s"
    assert unit_of_a_name("position", "q_gradient_{number}") == ""
