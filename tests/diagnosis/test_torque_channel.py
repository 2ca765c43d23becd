"""What a torque channel is, on logs from which parts of the torque were taken."""

from dataclasses import replace

import numpy as np
import pytest
from faulty_logs import DRIVE
from scipy import stats

from consistent_id import (
    DHRow,
    DriveTerms,
    InertialParameters,
    Recording,
    TorqueModel,
    from_modified_dh,
    simulate_torque,
)
from consistent_id.diagnosis import diagnose
from consistent_id.diagnosis.sample_rows import SampleRows
from consistent_id.diagnosis.torque_channel import channel_findings, nothing_findings
from consistent_id.diagnosis.torque_parts import nominal_parts, torque_parts
from consistent_id.robot.model import Link

_INERTIAS = [size * np.eye(3) for size in (0.1, 0.08, 0.05, 0.02)]
FRICTION = np.array([1.0, 2.0, 0.3])  # viscous, coulomb, offset


def _arm():
    rows = [DHRow(0, 0), DHRow(-np.pi / 2, 0), DHRow(0, 0.5), DHRow(np.pi / 2, 0, 0.4)]
    robot = from_modified_dh("arm", rows)
    body = InertialParameters.from_central(4.0, [0.2, 0.02, 0.05], 0.05 * np.eye(3))
    links = tuple(Link(link.name, body) for link in robot.links)
    return TorqueModel(replace(robot, links=links), DRIVE)


def _parts(rng=None):
    """Return the model, a motion, and the torque's gravity, inertia and friction."""
    model, rng = _arm(), np.random.default_rng(0) if rng is None else rng
    time = np.arange(2000) / 100.0
    f, phase = rng.uniform(0.1, 0.6, (2, 4, 3)) * [[[1.0]], [[10.0]]]
    angle = 2 * np.pi * f[..., None] * time + phase[..., None]
    omega = 2 * np.pi * f[..., None]
    q = 0.4 * np.sin(angle).sum(axis=1).T
    dq = 0.4 * (omega * np.cos(angle)).sum(axis=1).T
    ddq = -0.4 * (omega**2 * np.sin(angle)).sum(axis=1).T
    motion = Recording(model.robot.joint_names, time, q, dq, ddq)
    bodies = np.asarray(model.robot.nominal)
    whole = simulate_torque(model, np.append(bodies, np.tile(FRICTION, 4)), motion)
    gravity, inertial = nominal_parts(SampleRows.of(model, whole))
    return model, motion, gravity, inertial, whole.torque - gravity - inertial


def _said(change):
    model, motion, gravity, inertial, friction = _parts()
    noise = 0.02 * np.random.default_rng(1).normal(size=gravity.shape)
    log = replace(motion, torque=change(gravity, inertial, friction + noise))
    parts = torque_parts(model, log)
    return channel_findings(parts) or nothing_findings(parts)


def test_a_whole_torque_is_not_accused():
    assert _said(lambda g, i, f: g + i + f) == []


def test_rotor_inertia_beside_little_gravity_is_no_motor_current():
    # Geared motors of a small arm: their rotors and friction are most of the torque.
    assert _said(lambda g, i, f: 0.1 * g + i * [6.0, 5.0, 6.0, 8.0] + 2.0 * f) == []


def test_rotors_that_differ_are_no_clock():
    assert _said(lambda g, i, f: g + i * [3.0, 2.0, 5.0, 4.0] + f) == []


@pytest.mark.parametrize(("share", "severity"), [(0.7, "warning"), (3.0, "fault")])
def test_rotors_that_are_alike_may_be_what_a_clock_seems_to_be(share, severity):
    (found,) = _said(lambda g, i, f: g + i * (1.0 + share) + f)
    assert (found.kind, found.severity) == ("clock", severity)
    rotors = found.statement.index("rotors") < found.statement.index("clock")
    assert rotors == (severity == "warning")


def test_rotors_that_are_alike_are_no_gain():
    # Level joints carry no weight: equal rotors show in them as a gain would.
    model, motion, _, inertial, friction = _parts()
    level = replace(model, robot=replace(model.robot, gravity=np.zeros(3)))
    log = replace(motion, torque=3.0 * inertial + friction)
    assert channel_findings(torque_parts(level, log)) == []


def test_the_slopes_of_the_parts_are_those_with_which_they_were_added():
    model, motion, gravity, inertial, friction = _parts()
    log = replace(motion, torque=0.6 * gravity + 1.4 * inertial + friction)
    parts = torque_parts(model, log)
    # Friction is the model's own: nothing but rounding is in the way.
    np.testing.assert_allclose(parts.gravity[1:], 0.6, atol=1e-6)
    np.testing.assert_allclose(parts.inertial, 1.4, atol=1e-6)
    assert parts.rest.max() < 1e-6


def test_a_spring_of_the_model_is_no_slope_of_gravity():
    model, motion, gravity, inertial, friction = _parts()
    drives = [DriveTerms(terms=DRIVE.terms, spring=joint == 1) for joint in range(4)]
    sprung = TorqueModel(model.robot, drives)
    motion = replace(motion, position=0.2 * motion.position)  # gravity is near linear
    rows = SampleRows.of(model, replace(motion, torque=gravity))
    gravity, inertial = nominal_parts(rows)
    spring = motion.position * [0.0, 15.0, 0.0, 0.0]
    log = replace(motion, torque=gravity + inertial + friction + spring)
    np.testing.assert_allclose(torque_parts(sprung, log).gravity[1:], 1.0, atol=1e-6)
    # Without the term, the spring is taken for gravity.
    assert abs(torque_parts(model, log).gravity[1] - 1.0) > 0.2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        (lambda g, i, f: i + f, "torque channel", "gravity-compensated"),
        (lambda g, i, f: f, "torque channel", "friction alone"),
        # What a model of friction calls friction may hold rotors.
        (lambda g, i, f: f + 0.15 * i, "torque channel", "friction alone"),
        (lambda g, i, f: g, "torque channel", "gravity torque of a model"),
        (lambda g, i, f: g + i, "torque channel", "no friction"),
        (lambda g, i, f: 1e3 * (g + i + f), "torque unit", "N mm"),
        (lambda g, i, f: 1e-3 * (g + i + 2.0 * f), "torque unit", "kN m"),
        (lambda g, i, f: 1.5 * (g + i + f), "torque gain", "1.5 times"),
        (lambda g, i, f: (g + i + f) / [5, 8, 12, 10], "torque channel", "currents"),
    ],
)
def test_the_channel_is_named_by_the_parts_it_holds(change, kind, words):
    (finding,) = _said(change)
    assert finding.kind == kind
    assert words in finding.statement


def test_one_gain_that_is_off_is_a_warning_with_its_factor():
    (finding,) = _said(lambda g, i, f: (g + i + f) * [1.0, 1.0, 0.5, 1.0])
    assert (finding.severity, finding.kind) == ("warning", "torque gain")
    assert "0.50" in finding.statement
    assert "masses" in finding.statement  # which would look the same


@pytest.mark.parametrize("load", [0.0, 500.0])
@pytest.mark.parametrize("gain", [0.7, 1.3])
def test_a_constant_load_hides_no_gain(load, gain):
    """A weight that never changes is an offset: it does not make slopes less sure."""
    (finding,) = _said(lambda g, i, f: gain * (g + i + f) + load)
    assert (finding.severity, finding.kind) == ("fault", "torque gain")
    assert _said(lambda g, i, f: g + i + f + load) == []


def _tapered():
    """Return the arm with links that differ, as those of a real robot do."""
    model = _arm()
    links = tuple(
        replace(
            link, nominal=InertialParameters.from_central(m, [0.2, 0.02, 0.05], inertia)
        )
        for link, m, inertia in zip(
            model.robot.links, (8.0, 6.0, 4.0, 2.0), _INERTIAS, strict=True
        )
    )
    return TorqueModel(replace(model.robot, links=links), DRIVE)


def _swung_once(factor):
    """Return what is said of 2 s in which no joint turns back, times a factor."""
    model, log = _swung(2.0, 1.0)
    return diagnose(model, replace(log, torque=factor * log.torque)).findings


def _swung(seconds, forwards):
    """Return a model and its log; at a forward speed of 1 rad/s no joint turns back."""
    model, time = _tapered(), np.arange(int(200 * seconds)) / 200.0
    w = np.array([3.0, 4.0, 5.0, 6.0])  # rad/s
    angle = w * time[:, None] + [0.0, 1.0, 2.0, 3.0]
    motion = Recording(
        model.robot.joint_names,
        time,
        forwards * time[:, None] + 0.8 * np.sin(angle) / w,
        forwards + 0.8 * np.cos(angle),
        -0.8 * w * np.sin(angle),
    )
    bodies = np.asarray(model.robot.nominal)
    log = simulate_torque(model, np.append(bodies, np.tile(FRICTION, 4)), motion)
    noise = 0.02 * np.random.default_rng(2).normal(size=log.torque.shape)
    return model, replace(log, torque=log.torque + noise)


@pytest.mark.slow
def test_a_short_validation_recording_is_judged_by_what_it_tests():
    model, long = _swung(12.0, 0.0)
    training, other = long.samples(slice(0, 1600)), long.samples(slice(1600, None))
    short = replace(_swung(2.0, 1.0)[1], name="short")
    (alone,) = diagnose(model, training, [short]).of("short")
    assert (alone.severity, alone.recording) == ("warning", "short")
    assert "hardly tests the estimate" in alone.statement
    beside = diagnose(model, training, [short, replace(other, name="other")])
    assert [f.severity for f in beside.of("short")] == ["note"]
    # A log that is fitted is judged as before.
    (fitted,) = diagnose(model, short).of("short")
    assert "the bodies are hardly identifiable" in fitted.statement


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factor", "kind", "severity"),
    [(0.5, "torque gain", "warning"), (1e3, "torque unit", "fault")],
)
def test_a_motion_that_never_turns_back_shows_a_unit_and_not_surely_a_gain(
    factor, kind, severity
):
    found = {finding.kind: finding.severity for finding in _swung_once(factor)}
    assert found["short"] == "warning"
    assert found[kind] == severity


@pytest.mark.parametrize("speed", [2.0, 0.5])
def test_a_gain_would_be_gravity_s_too(speed):
    """A clock of another speed changes the inertial part alone: no gain does that."""
    found = _said(lambda g, i, f: g + speed**2 * i + f)
    assert [finding.kind for finding in found] == (["clock"] if speed > 1.0 else [])
    assert [f.kind for f in _said(lambda g, i, f: 2.0 * (g + i + f))] == ["torque gain"]


@pytest.mark.parametrize("rotor", [False, True])
def test_a_rotor_of_the_model_is_no_gain_of_the_inertial_part(rotor):
    """Gravity by another centre of mass, and inertia by a rotor, grow alike."""
    model, motion, gravity, inertial, friction = _parts()
    drives = [DriveTerms(terms=DRIVE.terms, rotor_inertia=rotor)] * 4
    model = TorqueModel(model.robot, drives)

    def said(factor):
        scale = np.array([1.0, 1.0, factor, 1.0])
        log = replace(motion, torque=scale * (gravity + inertial) + friction)
        return [f.where for f in channel_findings(torque_parts(model, log))]

    third = model.torque_joints[2]
    assert said(1.4) == ([] if rotor else [third])
    # A rotor makes no part smaller, and no drawing is so wrong in mass and centre.
    assert said(0.6) == said(1.8) == [third]


def test_slopes_have_the_scatter_between_fits_that_leave_a_twentieth_out():
    model, motion, gravity, inertial, friction = _parts()
    noise = np.random.default_rng(1).normal(size=gravity.shape)
    torque = gravity + inertial + friction + 0.02 * noise
    found = torque_parts(model, replace(motion, torque=torque))
    count, joint = len(torque), 2
    speed = motion.velocity[:, joint]
    columns = np.column_stack(
        [
            gravity[:, joint],
            inertial[:, joint],
            speed,
            np.tanh(speed / 0.02),
            np.ones(count),
        ]
    )

    def slopes(rows):
        return np.linalg.lstsq(columns[rows], torque[rows, joint])[0][:2]

    cuts = np.array_split(np.arange(count), 20)
    every = np.arange(count)
    moved = [slopes(np.setdiff1d(every, cut)) - slopes(every) for cut in cuts]
    scatter = np.sqrt(19.0 / 20.0 * np.sum(np.square(moved), axis=0))
    # Twenty segments: Student's quantile for 19 degrees of freedom, in place of 1.96.
    expected = scatter * stats.t.ppf(0.975, 19) / stats.norm.ppf(0.975)
    shown = found.gravity_error[joint], found.inertial_error[joint]
    np.testing.assert_allclose(shown, expected, rtol=1e-4)
