"""An estimate that follows an arm whose friction and load change as known."""

from dataclasses import replace

import numpy as np
import pytest

import consistent_id as ci
from consistent_id.constraints.cones.certificate import (
    ball_about,
    certify,
    solve_certified,
)
from consistent_id.constraints.cones.least_norm import LeastNorm
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.estimation.verdict import Reason, Verdict
from consistent_id.recordings.signals.filters import low_passed
from consistent_id.regression.linear import triangle
from consistent_id.robot.inertia import pseudo_inertia
from consistent_id.service import LoadWatch, OnlineEstimate, control_model
from consistent_id.service.load_watch import WINDOW, Quiet, WatchedRows
from consistent_id.service.online_estimate import resolved
from consistent_id.service.running_log import local_motion, without_body
from consistent_id.service.warm_fit import cone_coordinates, warm_fit

NOISE = 0.1
BODY = [4, 0.8, 0.1, 0, 0.15, 0, 0.3, 0, 0, 0.3]
LOAD = np.array([1.0, 0.1, 0.02, 0.05, 0.02, 0, 0.03, 0, 0, 0.03])  # consistent


def arm():
    rows = [ci.DHRow(-np.pi / 2, 0), ci.DHRow(0, 0.4)]
    robot = ci.from_modified_dh("arm", rows, gravity=(9.81, 0, 0))
    return ci.TorqueModel(robot, ci.DriveTerms(viscous=True, coulomb="sign"))


MODEL = arm()
TRUTH = np.array(BODY * 2 + [2, 1] * 2, dtype=float)


def motion(seed, seconds=20.0):
    size = np.random.default_rng(seed).normal(size=(2, 5, 2)) * 0.25
    harmonics = ci.recordings.harmonics_of(0.1, 5)
    path = ci.recordings.FourierTrajectory(
        MODEL.robot.joint_names, harmonics, [0, 0], *size, duration=seconds
    )
    return path.recording(rate=100.0)


def log(seed, truth=TRUTH, seconds=20.0):
    rng = np.random.default_rng(seed + 1000)
    return ci.simulate_torque(MODEL, truth, motion(seed, seconds), noise=NOISE, rng=rng)


def after(first, second):
    """Return two logs, one after the other, without a gap in the clock."""
    channels = ("position", "velocity", "acceleration", "torque")
    step = first.time[1] - first.time[0]
    time = second.time - second.time[0] + first.time[-1] + step
    both = {c: np.vstack([getattr(first, c), getattr(second, c)]) for c in channels}
    return replace(first, time=np.concatenate([first.time, time]), **both)


@pytest.fixture(scope="module")
def estimate():
    known = [
        ci.PhysicalConsistency(),
        ci.FixedMasses({name: 4.0 for name in MODEL.robot.link_names}),
        ci.NonNegativeDrive(),
    ]
    regression = ci.build_regression(MODEL, log(0))
    return ci.constrained_least_squares(MODEL, regression, constraints=known)


@pytest.fixture(scope="module")
def watched(estimate):
    logs = [log(seed) for seed in (1, 2, 3, 4)]
    return OnlineEstimate(estimate, memory=20.0).watching(logs, false_alarms=30.0)


def quadratic(factor):
    return factor.T @ factor


@pytest.mark.slow
def test_without_forgetting_the_factor_is_that_of_the_whole_log(estimate):
    online = OnlineEstimate(estimate, memory=np.inf, period=100.0)
    whole = log(5, seconds=2.0)
    state = online.along(whole)[-1]
    near = 1.0 - np.tanh(whole.velocity / 0.05) ** 2
    noise = np.sqrt(online.sigma**2 + near * online.held**2)
    batch = ci.build_regression(
        MODEL, whole, row_weights=[online.sigma / noise], noise=False
    ).weighted(online.sigma)
    expected = quadratic(batch.stacked())
    assert abs(quadratic(state.factor) - expected).max() < 1e-12 * expected.max()


@pytest.mark.slow
def test_older_samples_fade_by_their_age_alone(estimate):
    # The same samples in blocks of other lengths: the same factor.
    whole = log(6, seconds=1.5)
    found = [
        quadratic(OnlineEstimate(estimate, memory=5.0).along(whole, size)[-1].factor)
        for size in (0.1, 0.37)
    ]
    assert abs(found[0] - found[1]).max() < 1e-12 * found[0].max()
    ages = whole.time[-1] - whole.time
    online = OnlineEstimate(estimate, memory=5.0)
    near = 1.0 - np.tanh(whole.velocity / 0.05) ** 2
    noise = np.sqrt(online.sigma**2 + near * online.held**2)
    weights = np.exp(-0.5 * ages / 5.0)[:, None] * online.sigma / noise
    batch = ci.build_regression(MODEL, whole, row_weights=[weights], noise=False)
    expected = quadratic(batch.weighted(online.sigma).stacked())
    assert abs(found[0] - expected).max() < 1e-12 * expected.max()


def test_each_solution_is_certified_and_the_least_misfit(estimate):
    online = OnlineEstimate(estimate, memory=10.0)
    states = online.along(log(7, seconds=1.0))
    for state in states:
        assert state.optimality.verdict == "certified"
        assert online.delivered(state).certificate.verdict == "certified"
    state = states[-1]
    # By another solver, from the factor and the anchor alone.
    x, n = estimate.parameters, len(estimate.parameters)
    rows = np.column_stack([np.diag(online.alone.anchor), online.alone.anchor * x])
    stacked = triangle(np.asfortranarray(np.vstack([state.factor, rows])))
    size = abs(stacked[n, n])
    problem = LeastNorm(
        stacked[:n, :n] * (online.unit / size),
        stacked[:n, n] / size,
        online.alone.cone.domain,
    )
    other, _ = solve_certified(problem, x / online.unit, reference=0.5)
    best = np.sum((problem.G @ other.u - problem.g) ** 2)
    found = resolved(online, state, online.alone).fit
    own = np.sum((problem.G @ found.u - problem.g) ** 2)
    assert own - best < 1e-6  # gap of half the square, of one half


def test_links_on_the_boundary_are_solved_by_the_path_and_certified(estimate):
    # Least squares alone would be outside: data of bodies without thickness.
    online = OnlineEstimate(estimate)
    cone, n = online.alone.cone, len(online.unit)
    rng = np.random.default_rng(0)
    G = triangle(np.asfortranarray(np.eye(n) + 0.1 * rng.normal(size=(n, n))))
    goal = estimate.parameters / online.unit + rng.normal(size=n)
    found = warm_fit(G, G @ goal, cone, goal)
    assert found.path  # no other solver was needed
    assert found.optimality.verdict == "certified"
    assert cone.domain.violation(found.u) < 1e-9
    assert cone.domain.block_rows.margins(found.u).min() < 1e-3
    again = warm_fit(G, G @ (goal + 1e-5), cone, goal, found.path)
    assert again.path
    assert again.steps < found.steps
    # The proof is from the problem's data: a point beside the optimum has none.
    problem = LeastNorm(G, G @ goal, cone.domain)
    solution, _ = solve_certified(problem, goal, reference=0.5)
    beside = replace(solution, u=solution.u * 1.01)
    assert (
        certify(problem, beside, ball_about(goal), reference=0.5).verdict
        == "uncertified"
    )


def test_the_same_blocks_give_the_same_state(estimate):
    online = OnlineEstimate(estimate)
    first, second = (online.along(log(8, seconds=0.5))[-1] for _ in range(2))
    assert np.array_equal(first.parameters, second.parameters)
    assert np.array_equal(first.factor, second.factor)


def test_blocks_have_to_be_in_order(estimate):
    online, whole = OnlineEstimate(estimate), log(9, seconds=1.0)
    state = online.follow(online.start(), whole.samples(slice(50, None)))
    with pytest.raises(ci.ProblemError, match="the time is nan"):
        online.start(np.nan)
    with pytest.raises(ci.ProblemError, match="begin again"):
        online.follow(state, whole.samples(slice(0, 50)))


def test_without_an_end_of_its_period_an_estimate_stays_as_it_is(estimate):
    online = OnlineEstimate(estimate, period=np.inf)
    state = online.along(log(12, seconds=2.0))[-1]
    assert np.array_equal(state.parameters, online.start().parameters)
    assert state.prediction_errors.shape == (2,) and state.weight > 0.0


@pytest.mark.slow
def test_standard_errors_are_those_under_the_equalities(estimate):
    """Of generalised least squares with Lagrange multipliers, solved densely."""
    online = OnlineEstimate(estimate, memory=np.inf, period=0.01)
    state = online.along(log(12, seconds=2.0))[-1]
    assert state.solved == state.time
    anchor, unit = online.alone.anchor, online.unit
    fixed = online.alone.cone.domain.A_eq
    n = len(anchor)
    R = state.factor[:n, :n]
    scaled = (R.T @ R + np.diag(anchor**2)) * np.outer(unit, unit)
    saddle = np.block([[scaled, fixed.T], [fixed, np.zeros((len(fixed), len(fixed)))]])
    expected = unit * np.sqrt(np.maximum(np.diag(np.linalg.inv(saddle))[:n], 0.0))
    masses = [i for i, name in enumerate(MODEL.layout.names) if name.endswith(".m")]
    assert len(fixed) == len(masses) == 2  # the datasheet's
    assert state.deviations[masses] == pytest.approx(0.0, abs=1e-12)
    assert state.deviations == pytest.approx(expected, rel=1e-6, abs=1e-7)


@pytest.mark.slow
def test_friction_that_falls_is_followed_and_bodies_stay(estimate):
    cold, warm = log(10), log(11, TRUTH * np.r_[np.ones(20), np.full(4, 0.6)])
    online = OnlineEstimate(estimate, memory=5.0, period=1.0)
    state = online.along(after(cold, warm))[-1]
    friction = slice(20, 24)
    error = state.parameters[friction] - 0.6 * TRUTH[friction]
    # 20 s are four times the memory: 2 % of the change is left of the cold samples.
    assert (abs(error) < 3.0 * state.deviations[friction] + 0.03 * TRUTH[20:24]).all()
    assert state.verdict.word == "use"
    q = np.array([0.3, -0.2])
    started, now = (
        control_model(e).gravity(q) for e in (estimate, online.delivered(state))
    )
    assert abs(now - started).max() < 0.05 * abs(started).max()


def test_a_load_is_announced_within_half_a_second_and_once(estimate):
    heavy = TRUTH.copy()
    heavy[10:20] += LOAD
    watch = LoadWatch(
        NOISE**2 * np.eye(2), np.ones(2), np.array([1.0, 0.2, 0.2, 0.2]), 5.5
    )
    online = OnlineEstimate(estimate, watch=watch)
    states = online.along(after(log(12, seconds=1.0), log(12, heavy, seconds=1.0)), 0.1)
    changes = {s.change.time for s in states if s.change}
    assert len(changes) == 1
    assert 1.0 < changes.pop() < 1.5
    assert states[-1].loaded


def test_blocks_wait_for_the_watch_and_are_learned_from_then(estimate):
    quiet = LoadWatch(np.eye(2), np.ones(2), np.ones(4), np.inf)
    whole = log(14, seconds=1.0)
    plain, watched = (
        OnlineEstimate(estimate, watch=watch, period=100.0).along(whole)[-1]
        for watch in (None, quiet)
    )
    assert watched.waiting
    factors = [watched.factor, *(waiting.rows for waiting in watched.waiting)]
    together = sum(quadratic(factor) for factor in factors)
    expected = quadratic(plain.factor)
    assert abs(together - expected).max() < 1e-12 * expected.max()


@pytest.mark.slow
def test_a_load_is_announced_weighed_and_missed_again(watched):
    heavy = TRUTH.copy()
    heavy[10:20] += LOAD
    free, loaded = log(12, seconds=10.0), log(12, heavy, seconds=10.0)
    whole = after(after(free, loaded), free)
    states = watched.along(whole)
    changes = {s.change.time: s.change.loaded for s in states if s.change}
    on, off = sorted(changes)
    assert changes == {on: True, off: False}
    assert 10.0 < on < 10.5
    assert 20.0 < off < 20.5
    before_off = [s for s in states if s.time < off][-1]
    load, error = watched.load(before_off)
    assert abs(load - LOAD)[:4].max() < 0.1
    assert (abs(load - LOAD)[:4] < 4.0 * error[:4] + 0.01).all()
    # The load is a body, and without a load the link's mass is the datasheet's again.
    assert np.linalg.eigvalsh(pseudo_inertia(load)).min() > -1e-6
    assert states[-1].parameters[10] == pytest.approx(4.0)
    assert any(r.kind == "load" for r in before_off.verdict.reasons)


@pytest.mark.slow
def test_false_alarms_are_as_rare_as_stated(estimate):
    online = OnlineEstimate(estimate, memory=20.0)
    online = online.watching([log(s) for s in range(20, 28)], false_alarms=120.0)
    count = 0
    for seed in range(40, 52):
        changes = {s.change.time for s in online.along(log(seed)) if s.change}
        count += len(changes)
    # Two a minute are stated; of four minutes, 1 to 20 with 30 % for the limit's error.
    assert 1 <= count <= 20


def test_a_body_that_is_forgotten_leaves_the_rest_as_it_was():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(40, 9))
    factor = triangle(np.array(rows, order="F"))
    left = without_body(factor, slice(2, 5))
    assert not left[:, 2:5].any()
    z = rng.normal(size=9)
    # Closed form: the least misfit over the three parameters.
    others = np.delete(np.arange(9), [2, 3, 4])
    goal = rows[:, others] @ z[others]
    own = rows[:, 2:5]
    least = np.linalg.norm(goal - own @ np.linalg.lstsq(own, goal, rcond=None)[0])
    assert np.linalg.norm(left @ z) == pytest.approx(least, rel=1e-12)


def test_local_polynomials_are_exact_on_parabolas_with_uneven_stamps():
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.008, 0.012, 60))
    t = time[:, None]
    log = ci.Recording(
        ("a",),
        time,
        1.0 + 2.0 * t + 3.0 * t**2,
        torque=(t - 0.005) ** 2,
    )
    for velocity in (None, 2.0 + 6.0 * t):
        found = local_motion(replace(log, velocity=velocity), 5, 0.005)
        at = found.time[:, None]
        assert abs(found.position - (1.0 + 2.0 * at + 3.0 * at**2)).max() < 1e-10
        assert abs(found.velocity - (2.0 + 6.0 * at)).max() < 1e-9
        assert abs(found.acceleration - 6.0).max() < 1e-6
        assert abs(found.torque - at**2).max() < 1e-10


@pytest.mark.slow
def test_raw_samples_are_followed_a_few_samples_late(estimate):
    whole = replace(log(13, seconds=3.0), velocity=None, acceleration=None)
    online = OnlineEstimate(estimate, half=3)
    state = online.along(whole)[-1]
    assert state.time == pytest.approx(whole.time[-1 - online.half])
    assert state.verdict.word == "use"
    assert (state.prediction_errors < 0.15).all()


@pytest.mark.slow
def test_unknown_torque_is_not_learned_from_with_or_without_acceleration(estimate):
    whole = log(15, seconds=1.0)
    known = np.ones(whole.torque.shape, dtype=bool)
    known[20:60, 0] = False
    raw = replace(whole, velocity=None, acceleration=None)
    for plain in (whole, raw):
        found = []
        for torque in (50.0, -80.0):  # of a joint that something else holds
            values = np.where(known, plain.torque, torque)
            part = replace(plain, torque=values, torque_known=known)
            online, state = OnlineEstimate(estimate), OnlineEstimate(estimate).start()
            for first in (0, 30, 60):
                state = online.follow(state, part.samples(slice(first, first + 30)))
            found.append(state)
        assert np.array_equal(found[0].parameters, found[1].parameters)
        assert found[0].verdict.word != "do not use"


def test_blocks_may_have_other_channels(estimate):
    raw = replace(log(15, seconds=0.6), velocity=None, acceleration=None)
    commanded = replace(raw, position_command=raw.position)
    online = OnlineEstimate(estimate)
    found = []
    for whole in (raw, commanded):
        state = online.start()
        for first in (0, 30):
            state = online.follow(state, whole.samples(slice(first, first + 30)))
        found.append(state)
    assert np.array_equal(found[0].factor, found[1].factor)


def test_torque_filtered_with_samples_to_come_is_refused(estimate):
    online, whole = (
        OnlineEstimate(estimate),
        low_passed(log(15, seconds=1.0), torque_cutoff=5.0),
    )
    for velocity in (whole.velocity, None):
        motion = replace(whole, velocity=velocity, acceleration=velocity)
        with pytest.raises(ci.ProblemError, match="filtered with samples to come"):
            online.follow(online.start(), motion)


def test_a_gap_is_not_time_in_which_loads_were_watched():
    rows = [
        WatchedRows(np.arange(5) * 0.1 + first, *[np.zeros((5, 2, 4))] * 3)
        for first in (0.0, 0.5, 3600.0)
    ]
    # 9 steps of 0.1 s, a gap that counts as the window, and 4 steps.
    assert Quiet(rows, np.eye(4)).seconds == pytest.approx(1.3 + WINDOW)


def test_a_gap_within_a_block_does_not_fill_the_window():
    watch = LoadWatch(np.eye(2), np.ones(2), np.ones(4), 1.0)
    time = np.array([0.0, 0.01, 1.0, 1.01])
    columns, load = np.ones((4, 2, 4)), np.full((4, 2), 50.0)
    late = watch.block(WatchedRows(time, columns, load, load))
    assert late.first == 1.0
    assert watch.score([late], np.eye(4)) == 0.0
    whole = watch.block(WatchedRows(np.arange(4) * 0.1, columns, load, load))
    assert watch.score([whole], np.eye(4)) > 1.0


def test_logs_too_short_to_be_smoothed_teach_no_watch(estimate):
    raw = replace(log(1, seconds=0.05), velocity=None, acceleration=None)
    with pytest.raises(ci.ProblemError, match="have 0 s"):
        OnlineEstimate(estimate).watching(raw)


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_rates_of_false_alarms_that_make_no_sense_are_refused(estimate, rate):
    with pytest.raises(ci.ProblemError, match="false alarms an hour"):
        OnlineEstimate(estimate).watching(log(1, seconds=0.1), false_alarms=rate)


@pytest.mark.parametrize(
    "wrong",
    [
        {"period": np.nan},
        {"period": -1.0},
        {"bodies": np.inf},
        {"capacity": np.inf},
        {"half": 1},
        {"half": 2.5},
        {"torque_delay": np.nan},
    ],
)
def test_numbers_that_would_stop_it_in_silence_are_refused(estimate, wrong):
    with pytest.raises(ci.ProblemError, match=next(iter(wrong))):
        OnlineEstimate(estimate, **wrong)


def test_a_delay_beyond_the_window_is_refused_and_a_path(estimate):
    # A polynomial outside its samples says nothing.
    raw = replace(log(1, seconds=0.5), velocity=None, acceleration=None)
    with pytest.raises(ci.ProblemError, match="half a window"):
        OnlineEstimate(estimate, torque_delay=0.2).along(raw)
    with pytest.raises(ci.ProblemError, match=r"samples: a str.*read_recording"):
        OnlineEstimate(estimate).along("service.csv")


@pytest.mark.parametrize("length", [0.0, -1.0, np.nan])
def test_blocks_without_length_are_refused(estimate, length):
    with pytest.raises(ci.ProblemError, match="blocks of"):
        OnlineEstimate(estimate).along(log(1, seconds=0.1), length)


def test_a_doubt_about_the_start_is_not_forgotten(estimate):
    doubt = Reason("gain or unit", "do not use", "a gain of 0.7", "")
    doubted = replace(estimate, judged=Verdict("do not use", "study", (doubt,)))
    online = OnlineEstimate(doubted)
    states = [online.start(), *online.along(log(7, seconds=0.2))]
    assert {state.verdict.word for state in states} == {"do not use"}
    assert "gain or unit" in states[-1].verdict.grounds[0].statement
    assert OnlineEstimate(estimate).start().verdict.word == "use"


def test_without_constraints_it_is_least_squares_about_the_anchor(estimate):
    online = OnlineEstimate(estimate, memory=np.inf, constraints=[])
    state = online.follow(online.start(), log(3))
    n, x, anchor = len(TRUTH), estimate.parameters, online.alone.anchor
    A = np.vstack([state.factor[:, :n], np.diag(anchor)])
    b = np.concatenate([state.factor[:, n], anchor * x])
    scale = online.unit
    found = np.linalg.lstsq(A * scale, b, rcond=None)[0] * scale
    # Rounding, times a condition of some thousand.
    np.testing.assert_allclose(state.parameters, found, atol=1e-8, rtol=1e-8)
    assert state.verdict.word == "use"


@pytest.mark.slow
def test_bodies_that_no_matter_has_are_named_if_constraints_allow_them(estimate):
    wrong = TRUTH.copy()
    wrong[19] = -0.05  # Izz of the second link about its joint
    thin = log(3, wrong)
    free = OnlineEstimate(estimate, bodies=1.0, constraints=[]).along(thin)[-1]
    assert free.verdict.word == "do not use"
    (reason,) = (r for r in free.verdict.reasons if r.kind == "inconsistent bodies")
    assert "link2" in reason.statement
    kept = OnlineEstimate(estimate, bodies=1.0).along(thin)[-1]
    assert "inconsistent bodies" not in [r.kind for r in kept.verdict.reasons]


def test_a_load_need_not_fit_into_the_shape_of_its_link(estimate):
    name = MODEL.robot.link_names[1]
    centre = ci.constraints.CentreOfMassIn(
        name, ci.constraints.Ellipsoid([0.2, 0.025, 0.0], [0.03] * 3)
    )
    online = OnlineEstimate(estimate, constraints=[ci.PhysicalConsistency(), centre])
    free, loaded = (r.cone.domain.blocks for r in (online.alone, online.with_load))
    labels = [[block.label for block in blocks] for blocks in (free, loaded)]
    shape = f"{name}: centre of mass in the ellipsoid"
    assert labels[0] == [*MODEL.robot.link_names, shape]
    assert labels[1] == [*MODEL.robot.link_names, "load: physical consistency"]


def test_cones_without_room_are_refused():
    rows, bounds = np.array([[1.0], [-1.0]]), np.array([-1.0, -1.0])
    with pytest.raises(ci.SolverError, match="no room"):
        cone_coordinates(ConicSet.at_most(rows, bounds, ("below", "above")))


def test_settings_that_make_no_sense_are_refused(estimate):
    with pytest.raises(ci.ProblemError, match="memory"):
        OnlineEstimate(estimate, memory=0.0)
    with pytest.raises(ci.ProblemError, match="carries loads"):
        OnlineEstimate(estimate, carrier="hand")
    with pytest.raises(ci.ProblemError, match="expected 60 s or more"):
        OnlineEstimate(estimate).watching(log(1, seconds=1.0))
