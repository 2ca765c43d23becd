"""The delay of a standing robot's torque, found with the radius of its feet."""

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from quadrupeds import FEET, FOOT, quadruped_text

import consistent_id as ci
from consistent_id.estimation import radius_and_delay
from consistent_id.estimation.radius_and_delay import (
    TorqueDelay,
    _around,
    _shrunk,
    _vertex,
)

RATE, SAMPLES = 200, 1200
LATE = -2e-3  # s: early, by less than half a step
RADIUS = 0.02  # m


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "quadruped.xml"
    path.write_text(quadruped_text())
    return ci.robot.load_mjcf(path, base="floating")


@pytest.fixture(scope="module")
def known(robot):
    model = ci.regression.contact_free_model(ci.TorqueModel(robot))
    values = dict(zip(model.layout.names[10:], robot.nominal[10:], strict=True))
    return model, [ci.constraints.FixedParameters(values)]


@pytest.fixture(scope="module")
def log(robot):
    return smooth_log(robot)


def smooth_log(robot, *, late=LATE, noise=0.0, seed=0):
    """A log of sinusoids, all four balls on level ground; its torque is late.

    Only differentiable motion has a torque at other times.
    """
    rng = np.random.default_rng(seed)
    stamps = np.arange(SAMPLES) / RATE
    turns = rng.uniform(0.3, 3.0, 30) * 2 * np.pi
    phases, size = rng.uniform(0, 6.0, 30), rng.uniform(0.05, 0.3, 30)

    def moved(t):
        x = size * np.sin(np.outer(t, turns) + phases)
        dx = size * turns * np.cos(np.outer(t, turns) + phases)
        return x, dx, -x * turns**2

    def torque(t):
        (q, _, _), (_, dq, _), (_, _, ddq) = ([x[:, :12] for x in moved(t)],) * 3
        return rows(q, dq, ddq, base(t, level=None))

    def base(t, level):
        x, dx, _ = moved(t)
        felt = x[:, 18:21] + np.array([0.0, 0.0, 9.81])
        return ci.recordings.BaseMotion(x[:, 12:15], dx[:, 12:15], felt, level)

    def rows(q, dq, ddq, base):
        forces = ci.TorqueModel(robot).predict(robot.nominal, q, dq, ddq, base=base)
        whole = [
            ci.regression.contact_jacobian(robot, q, frame=foot, point=FOOT)
            for foot in FEET
        ]
        arm = np.array([[0, -RADIUS, 0], [RADIUS, 0, 0], [0, 0, 0]])
        pushes = np.concatenate([J[:, :3] + arm @ J[:, 3:] for J in whole], axis=1)
        balance = np.linalg.pinv(np.swapaxes(pushes[:, :, :6], 1, 2))
        acting = np.einsum("nfr,nr->nf", balance, forces[:, :6])
        return (forces - np.einsum("nfr,nf->nr", pushes, acting))[:, 6:]

    q, dq, ddq = (x[:, :12] for x in moved(stamps))
    level = np.tile(np.eye(3), (SAMPLES, 1, 1))
    closed = np.ones(SAMPLES, dtype=bool)
    logged = torque(stamps - late)
    return ci.Recording(
        robot.joint_names,
        stamps,
        q,
        dq,
        ddq,
        logged + noise * rng.normal(size=logged.shape),
        base=base(stamps, level),
        contacts=tuple(
            ci.recordings.ContactFlags(foot, closed, FOOT, radius=RADIUS)
            for foot in FEET
        ),
    )


@pytest.mark.slow
def test_early_torque_is_found_and_taken_back(log, known):
    model, constraints = known
    found = ci.estimation.estimate_radius_and_delay(model, log, constraints=constraints)
    assert found.delay.significant
    assert found.delay.seconds == pytest.approx(LATE, rel=0.01)
    assert abs(found.feet.offset) < 2e-6
    errors = found.feet.standard_error, found.delay.standard_error
    np.testing.assert_allclose(np.diag(found.covariance), np.square(errors), rtol=1e-9)


@pytest.mark.slow
def test_a_wrong_radius_and_early_torque_are_told_apart(log, known):
    model, constraints = known
    thick = ci.estimation.with_radii(log, 4e-4)
    found = ci.estimation.estimate_radius_and_delay(
        model, thick, constraints=constraints
    )
    assert found.delay.seconds == pytest.approx(LATE, rel=0.01)
    assert found.feet.offset == pytest.approx(-4e-4, rel=0.05)


@pytest.mark.slow
def test_early_torque_spoils_the_trunk_and_its_correction_mends_it(log, known):
    model, constraints = known
    found = ci.estimation.estimate_radius_and_delay(model, log, constraints=constraints)

    def off(part):
        fit = ci.constrained_least_squares(
            model,
            ci.regression.contact_free_regression(model, part),
            constraints=constraints,
            base=ci.regression.contact_free_base(model, part.contacts),
        )
        true = model.robot.nominal[:10]
        return abs(fit.parameters[:10] - true).max() / abs(true).max()

    inner = slice(10, -10)  # at its ends a log has no torque to move
    assert off(log.samples(inner)) > 20 * off(found.applied(log).samples(inner))


@pytest.mark.slow
def test_torque_on_time_is_not_significantly_late(robot, known):
    model, constraints = known
    log = smooth_log(robot, late=0.0, noise=0.3, seed=1)
    found = ci.estimation.estimate_radius_and_delay(
        model, log, constraints=constraints, radius=False
    )
    assert found.feet is None
    assert abs(found.delay.seconds) < 3 * found.delay.standard_error


def test_changes_add_up_to_the_covariance():
    covariance = np.array([[4e-8, -1e-7], [-1e-7, 1e-6]])
    delay = TorqueDelay(1e-3, 1e-3)
    radius = ci.estimation.ContactRadius(1e-4, 2e-4)
    found = ci.estimation.RadiusAndDelay(radius, delay, covariance)
    changes = np.array(found.changes())
    assert changes.T @ changes == pytest.approx(covariance, rel=1e-9)
    alone = replace(found, feet=None, covariance=np.diag([0.0, 1e-6]))
    assert alone.changes() == [(0.0, pytest.approx(1e-3))]


@pytest.mark.slow
def test_torque_is_moved_before_the_filter(log):
    smooth = ci.low_passed(log, torque_cutoff=20.0)
    moved = ci.estimation.without_torque_delay(smooth, LATE)
    source = moved.torque_filter.source
    right = ci.estimation.without_torque_delay(log, LATE)
    assert source.torque == pytest.approx(right.torque)
    assert (moved.position == smooth.position).all()


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("at", [[0.3], [-1.7], [0.4, -0.2], [2.0, 0.5]])
def test_the_least_of_a_parabola_is_found_whatever_its_size(at, size):
    places = np.array(np.meshgrid(*[[-1.0, 0.0, 1.0]] * len(at), indexing="ij"))
    away = places - np.reshape(at, (-1, *[1] * len(at)))
    H = size * np.array([[3.0, -0.8], [-0.8, 1.0]])[: len(at), : len(at)]
    misfits = 7.0 * size + 0.5 * np.einsum("i...,ij,j...->...", away, H, away)
    assert _vertex(misfits) == pytest.approx(at)
    assert np.isnan(_vertex(-misfits)).all()
    saddle = misfits + 3.0 * size * places[0] * places[-1] * (len(at) - 1)
    assert np.isnan(_vertex(saddle)).all() == (len(at) > 1)


def test_a_prior_draws_estimates_in_as_far_as_blocks_scatter():
    """Two Gaussians multiplied; the jackknife of five blocks is the likelihood's."""
    said, at = np.array([5e-3, 2e-4]), np.array([2e-3, 3e-4])
    rng = np.random.default_rng(2)
    left = at + rng.normal(size=(5, 2)) @ [[8e-4, 5e-5], [0.0, 1e-4]]
    found = _shrunk(np.array([True, True]), at, left, said)
    noise = 4.0 * np.cov(left.T, bias=True)
    exact, blurred = np.linalg.inv(noise), np.diag(said**-2)
    covariance = np.linalg.inv(exact + blurred)
    trust = covariance @ exact
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-9)
    for k, part in enumerate((found.feet, found.delay)):
        value, error, freedom = (getattr(part, f.name) for f in fields(part))
        assert value == pytest.approx((trust @ at)[k])
        assert error == pytest.approx(np.sqrt(covariance[k, k]))
        # The error is as sure as four degrees of freedom and the prior make it.
        assert freedom == pytest.approx(4.0 / trust[k, k] ** 2)


def test_of_what_the_data_do_not_contain_the_prior_is_left():
    found = _shrunk(
        np.array([False, True]), np.array([np.nan]), np.zeros((5, 1)), np.array([3e-4])
    )
    assert found.feet is None
    value, error, freedom = (getattr(found.delay, f.name) for f in fields(TorqueDelay))
    assert (value, error, freedom) == (0.0, 3e-4, np.inf)
    assert found.covariance.tolist() == [[0.0, 0.0], [0.0, 3e-4**2]]


def test_what_is_not_wanted_stays_as_it_is():
    at, steps = np.array([0.5]), np.array([0.25])
    around = [0.25, 0.5, 0.75]
    assert _around(np.array([False, True]), at, steps) == ([0.0], around)
    assert _around(np.array([True, False]), at, steps) == (around, [0.0])


@pytest.fixture
def tried(monkeypatch):
    """Call an estimate on stated parabolas; returns what it tried, and the result."""

    def run(vertices, logs, **wanted):
        moves, vertices = [], iter(vertices)

        def factors(model, logs, combinations, around):
            moves.append(np.array(around[1:]))
            return [None] * 3

        monkeypatch.setattr(radius_and_delay, "_moved_factors", factors)
        monkeypatch.setattr(radius_and_delay, "_misfits", lambda blocks, wanted: None)
        monkeypatch.setattr(
            radius_and_delay, "_vertex", lambda misfits: np.array(next(vertices))
        )
        model = SimpleNamespace(layout=SimpleNamespace(names=["x"]))
        free = SimpleNamespace(directions=np.eye(1), start=np.zeros(1))
        monkeypatch.setattr(
            radius_and_delay.FreeParameters, "of", staticmethod(lambda *given: free)
        )
        found = ci.estimation.estimate_radius_and_delay(model, logs, **wanted)
        return moves, found

    return run


def feet(radius, rate):
    time = np.arange(40) / rate
    flags = ci.recordings.ContactFlags("ball", np.ones(40, bool), radius=radius)
    return ci.Recording(("a",), time, np.sin(time)[:, None], contacts=(flags,))


LOGS = [feet(0.02, 200.0), feet(0.03, 50.0)]


def test_priors_and_steps_are_those_of_the_smallest_foot_and_slowest_clock(tried):
    """A tenth of a radius and one period; steps of a twentieth and a quarter."""
    moves, found = tried([[np.nan, np.nan]] * 9, LOGS)
    np.testing.assert_allclose(moves, [[[0.0, 0.0], [1e-3, 5e-3]]])
    assert found.feet.standard_error == pytest.approx(2e-3)
    assert found.delay.standard_error == pytest.approx(0.02)
    _, alone = tried([[np.nan]] * 9, LOGS, radius=False)
    assert alone.feet is None
    assert alone.delay.standard_error == pytest.approx(0.02)


@pytest.mark.parametrize(("last", "passes"), [(1.0, 1), (-1.0, 1), (-1.01, 4)])
def test_parabolas_are_moved_until_their_vertex_is_within_a_step(tried, last, passes):
    moves, _ = tried([[0.5, last]] * 9, LOGS)
    assert len(moves) == passes
    expected = [[0.5 * k * 1e-3, k * last * 5e-3] for k in range(passes)]
    np.testing.assert_allclose([at for at, _ in moves], expected)


def test_torque_is_moved_by_five_periods_at_most(tried):
    moves, _ = tried([[10.0, -14.0]] * 9, LOGS)
    ends = [[0.01 * k, max(-0.07 * k, -0.1)] for k in range(4)]
    np.testing.assert_allclose([at for at, _ in moves], ends)
