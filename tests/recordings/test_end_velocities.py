"""First and last velocities that are zero because nobody computed them."""

import numpy as np
import pytest
from logged import write_arm

import consistent_id as ci
from consistent_id.recordings.signals.end_velocities import with_end_velocities

TIME = np.arange(400) / 200
Q = np.column_stack([0.5 * np.sin(3.0 * TIME), 0.2 * np.cos(5.0 * TIME + 1.0)])
EXACT = np.column_stack([1.5 * np.cos(3.0 * TIME), -np.sin(5.0 * TIME + 1.0)])


def log(velocity, q=Q):
    return ci.Recording(("hip", "knee"), TIME, q, velocity)


def differences(q, end):
    """Differences of positions, with zeros in the row at one end."""
    steps = np.diff(q, axis=0) * 200
    parts = {"first": [0.0 * q[:1], steps], "last": [steps, 0.0 * q[:1]]}
    return np.vstack(parts[end])


@pytest.mark.parametrize(("end", "place"), [("first", 0), ("last", -1)])
def test_an_end_without_a_difference_gets_that_of_its_neighbour(end, place, caplog):
    made_up = differences(Q, end)
    mended = with_end_velocities(log(made_up)).velocity
    other = slice(1, None) if place == 0 else slice(None, -1)
    np.testing.assert_array_equal(mended[other], made_up[other])
    np.testing.assert_allclose(mended[place], EXACT[place], atol=0.02)
    assert f"the {end} velocity is zero, but the joints move" in caplog.text


@pytest.mark.slow
def test_a_joint_whose_step_is_another_gets_the_next_velocity():
    """By a whole turn, by an encoder's step at rest, or against the velocity."""
    q = np.column_stack([Q[:, 0], Q[:, 0], 0.0 * TIME, Q[:, 0]])
    dq = differences(q, "first")
    q[0, 1] -= 2.0 * np.pi
    q[0, 2] = 1e-4
    dq[:, 3] *= -1.0
    log = ci.Recording(("hip", "turn", "rest", "wrong"), TIME, q, dq)
    mended = with_end_velocities(log).velocity
    np.testing.assert_array_equal(mended[0, 1:], dq[1, 1:])
    np.testing.assert_allclose(mended[0, 0], EXACT[0, 0], atol=0.02)


def test_the_filter_then_has_the_acceleration_of_the_motion():
    exact = -9.0 * Q[:, 0]

    def worst(recording):
        smooth = ci.low_passed(recording, motion_cutoff=8.0)
        return abs(np.gradient(smooth.velocity[:, 0], TIME) - exact)[:50].max()

    raw = log(differences(Q, "first"))
    assert worst(raw) > 10.0
    assert worst(with_end_velocities(raw)) < 1.0


def at_rest(noise):
    """A motion from rest, with noise of encoders and velocities from it."""
    rng = np.random.default_rng(0)
    q = 0.3 * (1.0 - np.cos(3.0 * TIME))[:, None] * [1.0, 0.5]
    q += noise * rng.standard_normal(q.shape)
    return q


@pytest.mark.parametrize(
    "recording",
    [
        log(EXACT),
        log(None),
        log(differences(at_rest(0.0), "first"), at_rest(0.0)),
        log(differences(at_rest(1e-4), "first"), at_rest(1e-4)),
        log(differences(np.round(at_rest(0.0), 3), "first"), np.round(at_rest(0.0), 3)),
        log(differences(Q, "first"), 0.0 * Q),  # of a joint that does not move
        log(differences(Q, "first"), 0.3 * Q),  # nor as its velocity says
        log(differences(Q, "first"), 3.0 * Q),
        log(None).samples(slice(2)),
        log(0.0 * Q).samples(slice(3)),
        log(differences(Q, "first")).samples(slice(2)),
    ],
)
def test_other_logs_stay_as_they_are(recording):
    assert with_end_velocities(recording) is recording


@pytest.mark.slow
def test_a_draft_of_a_log_whose_first_velocity_is_zero_has_the_motion(tmp_path, caplog):
    urdf, file = write_arm(tmp_path)
    rows = np.genfromtxt(file, delimiter=",", names=True)
    names = rows.dtype.names
    positions = np.column_stack([rows[n] for n in names if n.startswith("q")])
    steps = np.diff(positions, axis=0) / np.diff(rows["time"])[:, None]
    table = {name: rows[name] for name in names}
    start = 200  # where the arm moves
    for j, name in enumerate(n for n in names if n.startswith("q")):
        table[f"d{name}"] = np.append(0.0, steps[:, j])
    moving = {name: values[start:].copy() for name, values in table.items()}
    for name in moving:
        if name.startswith("dq"):
            moving[name][0] = 0.0
    problem = ci.draft_problem(urdf, moving, select=False, cutoff=10.0).problem()
    assert "the first velocity is zero" in caplog.text
    (training,) = problem.training[:1]
    dq = np.gradient(training.position, training.time, axis=0)
    assert abs(training.velocity - dq)[:20].max() < 0.1 * abs(dq).max()
