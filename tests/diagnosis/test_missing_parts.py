"""What a log's residuals look like: contact in a while, magnitudes without a sign."""

from dataclasses import replace

import numpy as np
import pytest
from faulty_logs import arm, at_samples, clean_case, clean_log
from scipy.integrate import cumulative_trapezoid

from consistent_id import Recording, differentiated, simulate_torque
from consistent_id.diagnosis.contact_stretches import (
    JointResidual,
    contact,
    joint_residuals,
    standing_out,
)
from consistent_id.diagnosis.explain import datasheet_constraints, fitted_log
from consistent_id.diagnosis.torque_causes import lost_signs
from consistent_id.regression import base_parameters


def _as_is(log):
    model = arm()
    ready = at_samples(log)
    return fitted_log(
        model, ready, datasheet_constraints(model), base_parameters(model)
    )


def _pushed(log, start, stop):
    """Return a log in which something pushes for a while."""
    torque = np.array(log.torque)
    rows = slice(int(start * len(log)), int(stop * len(log)))
    torque[rows] += 10.0 * torque.std(axis=0)
    return replace(log, torque=torque)


@pytest.mark.parametrize(("start", "stop"), [(0.45, 0.47), (0.3, 0.45)])
def test_a_stretch_in_which_something_pushes_is_contact(start, stop):
    log = _pushed(clean_log(4), start, stop)
    (found,) = contact(_as_is(log))
    assert found.cause.kind == "contact"
    words = found.cause.statement.split()
    first, last = float(words[1]), float(words[4])
    pushed = log.time[[int(start * len(log)), int(stop * len(log)) - 1]]
    assert first <= pushed[0] and last >= pushed[1]
    # Lengths are whole cells, each half as long again as the one before at the most.
    assert last - first <= 1.5 * (pushed[1] - pushed[0]) + 4.0 * log.duration / 64


@pytest.mark.parametrize(("start", "stop"), [(0.0, 0.03), (0.97, 1.0)])
def test_at_the_ends_filters_settle_and_nothing_touches(start, stop):
    assert list(contact(_as_is(_pushed(clean_log(4), start, stop)))) == []


@pytest.mark.slow
def test_what_friction_holds_while_the_robot_rests_is_no_contact():
    log = clean_log(4)
    rows = np.insert(np.arange(len(log)), 1800, np.full(400, 1800))
    rest = slice(1800, 2201)
    stamps = log.time[0] + np.arange(len(rows)) * float(np.diff(log.time).mean())
    velocity, torque = np.array(log.velocity)[rows], np.array(log.torque)[rows]
    velocity[rest] = 0.0
    paused = replace(
        log,
        time=stamps,
        position=log.position[rows],
        velocity=velocity,
        torque=torque,
    )
    torque = torque.copy()
    torque[rest] += 3.0 * torque.std(axis=0)
    held = replace(paused, torque=torque)
    model = arm()
    as_is = fitted_log(
        model,
        differentiated(held),
        datasheet_constraints(model),
        base_parameters(model),
    )
    assert as_is.misfit > 0.03  # else it would not be looked for
    every = np.ones(len(as_is.recording), dtype=bool)
    assert standing_out(joint_residuals(as_is, every)) is not None
    assert list(contact(as_is)) == []


def test_friction_that_the_model_lacks_and_a_delay_are_no_contact():
    log = clean_log(4)
    speed, torque = np.gradient(log.position, axis=0), np.array(log.torque)
    load = abs(torque) * np.tanh(speed / (0.05 * abs(speed).max(axis=0)))
    late = np.roll(torque + 0.2 * load, 3, axis=0)
    as_is = _as_is(replace(log, torque=late))
    assert as_is.misfit > 0.03  # else it would not be looked for
    assert list(contact(as_is)) == []


@pytest.mark.slow
def test_noise_of_its_own_length_and_amplitude_makes_no_contact():
    rng = np.random.default_rng(0)
    samples, found = 1000, 0
    spanned, _ = np.linalg.qr(rng.normal(size=(samples, 12)))
    smooth = np.exp(-0.5 * (np.arange(-30, 31) / 10.0) ** 2)
    for _ in range(40):
        noise = np.convolve(rng.normal(size=samples + 60), smooth, mode="valid")
        noise *= np.exp(0.5 * np.sin(np.linspace(0.0, 20.0, samples)))
        rest = noise - spanned @ (spanned.T @ noise)
        found += standing_out([JointResidual(spanned, rest)]) is not None
    assert found == 0


def test_a_residual_without_samples_is_that_of_the_fit_to_the_others():
    rng = np.random.default_rng(1)
    columns, torque = rng.normal(size=(60, 5)), rng.normal(size=60)
    Q, _ = np.linalg.qr(columns)
    rest = torque - Q @ (Q.T @ torque)
    left, others = np.arange(20, 27), np.delete(np.arange(60), np.arange(20, 27))
    _, squared, _, _ = np.linalg.lstsq(columns[others], torque[others])
    one = JointResidual(Q, rest)
    np.testing.assert_allclose(rest @ rest - one.left_out(left), squared[0])
    without = one.without(left)
    np.testing.assert_allclose(without.rest @ without.rest, squared[0])
    assert not without.rest[left].any()


@pytest.mark.slow
@pytest.mark.parametrize("joint", [0, 1])
def test_the_sign_that_a_torque_has_lost_is_found_again(joint):
    log = clean_log(4)
    torque = np.array(log.torque)
    torque[:, joint] = abs(torque[:, joint])
    as_is = _as_is(replace(log, torque=torque))
    (found,) = lost_signs(as_is)
    assert (found.cause.kind, found.cause.where) == ("torque sign", log.joints[joint])
    clean = _as_is(log).factors.least_misfit()
    # Filters round the cusps of a magnitude: not all of it comes back.
    assert found.factors.least_misfit() < 5.0 * clean + 0.02
    assert found.factors.least_misfit() < 0.3 * as_is.factors.least_misfit()


def test_a_torque_with_its_sign_has_lost_none():
    assert list(lost_signs(_as_is(clean_log(4)))) == []
    assert list(lost_signs(_as_is(_pushed(clean_log(4), 0.4, 0.5)))) == []


def _paused(case, at, seconds, held):
    """Return a log whose motion stops for a while; dry friction holds a torque then.

    The path is that of the case, passed at another pace, and torque is simulated.

    Parameters
    ----------
    case : Case
    at : float, [s]
        Time at which the robot begins to brake.
    seconds : float
    held : ndarray, shape (joints,)
        Torque beside that of the place where it rests.
    """
    brake, log = 2.0, case.log
    creep = 1e-9  # as times on the path must increase
    time = np.arange(log.time[0], log.time[-1] + seconds + brake, np.diff(log.time)[0])
    # A half cosine down to zero, the rest, and a half cosine up again.
    angle = np.clip((time - at) / brake, 0.0, 1.0)
    angle += np.clip((time - at - brake - seconds) / brake, 0.0, 1.0)
    pace = np.maximum(0.5 * (1.0 + np.cos(np.pi * angle)), creep)
    place = time[0] + cumulative_trapezoid(pace, time, initial=0.0)
    on_path = case.motion.at(log.joints, place)
    pace = pace[:, None]
    velocity = pace * on_path.velocity
    acceleration = pace**2 * on_path.acceleration
    acceleration += np.gradient(pace, time, axis=0) * on_path.velocity
    states = Recording(log.joints, time, on_path.position, velocity, acceleration)
    rng = np.random.default_rng(0)
    paused = simulate_torque(case.model, case.truth, states, noise=case.noise, rng=rng)
    torque = paused.torque + (pace == creep) * held
    return Recording(log.joints, time, paused.position, torque=torque, name=log.name)


@pytest.mark.slow
def test_a_rest_in_which_dry_friction_holds_a_torque_is_no_contact():
    log = clean_log(4)
    spread = log.torque.std(axis=0)
    middle = log.time[len(log) // 2]
    rest = _paused(clean_case(4), middle, 1.5, 0.7 * spread)
    as_is = _as_is(rest)
    assert as_is.misfit > 0.03  # else it would not be looked for
    assert list(contact(as_is)) == []
    # What pushes while the robot moves is seen beside it.
    torque = np.array(rest.torque)
    torque[len(log) // 5 : len(log) // 4] += 10.0 * spread
    (found,) = contact(_as_is(replace(rest, torque=torque)))
    first, last = (float(found.cause.statement.split()[k]) for k in (1, 4))
    assert first <= rest.time[len(log) // 5] < rest.time[len(log) // 4 - 1] <= last
    assert last < middle


@pytest.mark.parametrize("rests", [True, False])
def test_a_joint_that_rests_while_others_move_shows_no_contact(rests):
    ready, model = at_samples(clean_log(4)), arm()
    first, last = (np.searchsorted(ready.time, t) for t in (9.0, 12.0))
    pushed = (ready.time >= 9.75) & (ready.time < 11.25)  # rest is a while of 0.5 s
    velocity, torque = np.array(ready.velocity), np.array(ready.torque)
    if rests:
        velocity[first:last, -1] = 0.0
    torque[pushed, -1] += 10.0 * torque[:, -1].std()
    log = replace(ready, velocity=velocity, torque=torque)
    as_is = fitted_log(model, log, datasheet_constraints(model), base_parameters(model))
    assert as_is.misfit > 0.03  # else it would not be looked for
    assert bool(list(contact(as_is))) != rests
