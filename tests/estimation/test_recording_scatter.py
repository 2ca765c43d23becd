"""Scatter between recordings: planted, found again, and part of what is quoted."""

import numpy as np
import pytest
from scipy.special import stdtrit

from consistent_id import (
    DHRow,
    DriveTerms,
    InertialParameters,
    Recording,
    TorqueModel,
    build_regression,
    from_modified_dh,
    least_squares,
    simulate_torque,
)
from consistent_id.constraints import Penalty
from consistent_id.estimation.best_fit import FitProblem
from consistent_id.estimation.constrained_fit import constrained_fit
from consistent_id.estimation.uncertainties import parameter_scatter
from consistent_id.estimation.uncertainties.beyond_noise import ScatterCauses
from consistent_id.estimation.uncertainties.block_scatter import (
    RecordingScatter,
    excess,
    recording_scatter,
)
from consistent_id.estimation.uncertainties.intervals import consistent_intervals
from consistent_id.estimation.uncertainties.parameter_scatter import (
    covariance,
    shift_scores,
)
from consistent_id.estimation.uncertainties.parameter_uncertainty import uncertainty
from consistent_id.regression import base_parameters, segment_regressions
from consistent_id.regression.residual_noise import unconstrained_fit
from consistent_id.regression.segments import merged, segment_sources
from consistent_id.robot import Datasheet

NOISE, PLANTED = 0.2, 0.1


def arm():
    """Two parallel axes half a metre apart, of 3 and 2 kg, with friction."""
    robot = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.5)])
    sheets = {"link1": Datasheet(mass=3.0), "link2": Datasheet(mass=2.0)}
    drive = DriveTerms(viscous=True, offset=True)
    model = TorqueModel(robot.with_datasheet(sheets), drive)
    bodies = [
        InertialParameters.from_central(m, (0.2, 0.05, 0.0), 0.02 * m * np.eye(3))
        for m in (3.0, 2.0)
    ]
    drives = [0.3, 0.1, 0.2, -0.1]
    return model, np.concatenate([*(b.vector for b in bodies), drives])


MODEL, TRUTH = arm()
BASE = base_parameters(MODEL)
VARIED = np.array([name.startswith("joint") for name in MODEL.layout.names])
FRICTION = VARIED[list(BASE.independent)]


def logs(count, planted, rng, samples=400, *, together=False):
    """Recordings whose friction differs by `planted`; all else is alike."""
    found = []
    for _ in range(count):
        states = rng.uniform(-2, 2, (3, samples, 2))
        names, time = MODEL.robot.joint_names, np.arange(samples) / 100
        change = rng.normal(size=1 if together else len(TRUTH))
        x = TRUTH + VARIED * change * planted
        log = Recording(names, time, *states)
        found.append(simulate_torque(MODEL, x, log, noise=NOISE, rng=rng))
    return found


def regressions(count, planted, rng, *, together=False):
    weights = np.full(2, NOISE)
    recordings = logs(count, planted, rng, together=together)
    return [build_regression(MODEL, r).weighted(weights) for r in recordings]


@pytest.mark.slow
def test_planted_scatter_is_found_where_it_is():
    rng = np.random.default_rng(0)
    squares = [
        recording_scatter(MODEL, regressions(8, PLANTED, rng), BASE).deviations ** 2
        for _ in range(30)
    ]
    found = np.sqrt(np.mean(squares, axis=0))
    # Thirty variances of seven degrees of freedom: ten per cent, and five for standard
    # deviations; three of these.
    assert found[FRICTION] == pytest.approx(PLANTED, rel=0.15)
    # Noise moves the others by 0.01, and little of that passes for scatter.
    assert found[~FRICTION].max() < 0.1 * PLANTED


@pytest.mark.slow
@pytest.mark.parametrize("together", [False, True])
@pytest.mark.parametrize(("count", "least"), [(2, 0.85), (4, 0.88), (6, 0.92)])
def test_standard_errors_with_it_cover_what_those_of_noise_do_not(
    count, least, together
):
    rng = np.random.default_rng(count)
    truth, inside, without = BASE.projection @ TRUTH, [], []
    for _ in range(200):
        parts = regressions(count, PLANTED, rng, together=together)
        whole = merged(parts)
        noise = unconstrained_fit(whole, BASE).noise
        full = recording_scatter(MODEL, parts, BASE).added_to(noise, parts, BASE)
        error = abs(least_squares(MODEL, whole, base=BASE).base_values - truth)
        for kept, n in ((inside, full), (without, noise)):
            t = stdtrit(n.freedoms(np.eye(len(BASE))), 0.975)
            size = t * np.sqrt(np.diag(n.steps @ n.scatter @ n.steps.T))
            kept.append(np.mean((error <= size)[FRICTION]))
    # If parameters change together, the mean over 200 sets is uncertain by 2 % for two
    # recordings and 1 % for six.  Intervals for two are too wide if each changes alone.
    assert least < np.mean(inside) < 0.99
    assert np.mean(without) < 0.4


@pytest.mark.slow
def test_recordings_that_are_alike_cost_little():
    rng = np.random.default_rng(1)
    grown = []
    for _ in range(10):
        parts = regressions(5, 0.0, rng)
        noise = unconstrained_fit(merged(parts), BASE).noise
        full = recording_scatter(MODEL, parts, BASE).added_to(noise, parts, BASE)
        grown.append(np.trace(full.scatter) / np.trace(noise.inflation))
    assert np.median(grown) < 1.3


def test_two_values_scatter_by_half_their_squared_difference():
    x, w = np.array([[0.3], [-0.3]]), np.full((2, 1), 1 / 0.04)
    found = excess(x, w)
    assert found.ratio == pytest.approx(0.18 / 0.04)
    assert found.unit == pytest.approx(0.04)
    assert found.freedom == 1.0


def test_friction_that_scatters_leaves_that_of_bodies_to_noise():
    rng = np.random.default_rng(7)
    found = recording_scatter(MODEL, regressions(6, PLANTED, rng), BASE)
    assert set(found.freedom) == {"inertial", "friction"}
    assert np.array([kind == "friction" for kind in found.kinds]) == pytest.approx(
        FRICTION
    )
    # Noise moves inertial parameters by 0.01.
    assert found.deviations[~FRICTION].max() < 0.02
    assert found.deviations[FRICTION].min() > 0.03


def test_parameters_that_scatter_together_have_the_freedom_of_one():
    rng = np.random.default_rng(5)
    same = np.repeat(rng.normal(size=(200, 1)), 5, axis=1)
    own = rng.normal(size=(200, 5))
    w = np.full((200, 5), 9.0)
    assert excess(same, w).freedom == pytest.approx(199.0, rel=1e-6)
    # At most five times as much; the common ratio's dispersion is estimated as well.
    assert excess(own, w).freedom > 3.0 * 199.0


def test_few_recordings_say_what_is_missing():
    rng = np.random.default_rng(6)
    few, enough = (
        recording_scatter(MODEL, regressions(n, PLANTED, rng), BASE).sentence
        for n in (2, 6)
    )
    assert "2 recordings hardly show" in few and "at least 6" in few
    assert "hardly show" not in enough


def test_two_recordings_are_enough_and_one_is_not():
    parts = regressions(2, PLANTED, np.random.default_rng(4))
    assert recording_scatter(MODEL, parts, BASE).recordings == 2
    assert recording_scatter(MODEL, parts[:1], BASE) is None


def test_a_recording_that_tells_too_little_does_not_count():
    rng = np.random.default_rng(2)
    parts = regressions(3, PLANTED, rng)
    still = Recording(
        MODEL.robot.joint_names, np.arange(50) / 100, *np.zeros((3, 50, 2))
    )
    still = simulate_torque(MODEL, TRUTH, still, noise=NOISE, rng=rng)
    idle = build_regression(MODEL, still).weighted(np.full(2, NOISE))
    assert recording_scatter(MODEL, [*parts, idle], BASE).recordings == 3
    assert recording_scatter(MODEL, [parts[0], idle], BASE) is None


@pytest.mark.slow
def test_uncertainty_has_it_in_errors_intervals_and_a_figure_of_its_own():
    # Twice this makes an offset of 0.1 loosely determined, which has no error.
    rng, planted = np.random.default_rng(3), 0.02
    recordings = logs(6, planted, rng, samples=1600)
    weights = np.full(2, NOISE)
    segments = segment_regressions(MODEL, recordings, sigma=weights)
    alone = uncertainty(MODEL, segments, replicates=10)
    sources = segment_sources(recordings)
    found = uncertainty(MODEL, segments, replicates=10, sources=sources)
    assert found.recordings.recordings == 6
    assert found.to_dict()["recordings"] == 6
    assert alone.recordings is None
    plain = least_squares(MODEL, merged(segments), base=BASE)
    for name in ("joint1.viscous", "joint2.offset"):
        p = found[name]
        # A standard deviation of five degrees of freedom, within three errors.
        assert p.between_recordings == pytest.approx(planted, rel=0.9)
        # Noise, and the sixth part of the variance between six recordings.
        white = plain.standard_errors[BASE.names.index(name)]
        expected = np.hypot(white, p.between_recordings / 6**0.5)
        assert p.standard_error == pytest.approx(expected, rel=0.3)
        assert np.isnan(alone[name].between_recordings)
        mine, its = (np.ptp(q.consistent) for q in (p, alone[name]))
        assert mine > 1.5 * its
    noise = unconstrained_fit(merged(segments), BASE).noise
    same = consistent_intervals(
        MODEL, merged(segments), base=BASE, causes=ScatterCauses(noise)
    )
    assert same.bounds == pytest.approx(alone.intervals.bounds, rel=1e-9)


def test_shifts_between_recordings_move_the_estimate_by_their_information():
    """``(A^T A)^-1 A_k^T A_k b`` of each recording's shift ``b``, where all is free."""
    rng = np.random.default_rng(8)
    parts = regressions(3, PLANTED, rng)
    whole = merged(parts)
    problem = FitProblem.of(MODEL, whole, (), BASE)
    fitted = constrained_fit(problem, Penalty(1e-9))
    deviations = rng.uniform(0.1, 0.3, len(BASE))
    scores = shift_scores(fitted, parts, BASE, deviations)
    found = BASE.projection @ covariance(fitted, scores) @ BASE.projection.T
    columns = list(BASE.independent)
    squares = [A.T @ A for A in (p.stacked()[:, columns] for p in parts)]
    moves = [np.linalg.solve(sum(squares), S * deviations) for S in squares]
    expected = sum(move @ move.T for move in moves)
    np.testing.assert_allclose(np.diag(found), np.diag(expected), rtol=1e-4)
    # As the noise of all has it that contains the scatter.
    scatter = RecordingScatter(3, deviations, ("one",) * len(BASE), {"one": 2.0})
    noise = unconstrained_fit(whole, BASE).noise
    (added,) = scatter.added_to(noise, parts, BASE).between
    np.testing.assert_allclose(
        noise.steps @ added.covariance @ noise.steps.T, expected, rtol=1e-6
    )
    assert added.freedom == 2.0


def test_variances_are_the_mean_with_and_without_active_inequalities(monkeypatch):
    monkeypatch.setattr(
        parameter_scatter,
        "covariance",
        lambda *_, active: np.diag([1.0, 6.0]) if active else np.diag([3.0, 8.0]),
    )
    assert parameter_scatter.variances(None, None).tolist() == [2.0, 7.0]


def test_each_kind_of_parameter_scatters_by_itself():
    drive = DriveTerms(viscous=True, offset=True, rotor_inertia=True)
    model = TorqueModel(MODEL.robot, drive)
    base, rng = base_parameters(model), np.random.default_rng(9)
    truth = rng.uniform(0.1, 0.5, len(model.layout))
    parts = []
    for level in (0.1, 0.2, 0.4):
        log = Recording(
            ("joint1", "joint2"), np.arange(60) / 100, *rng.normal(size=(3, 60, 2))
        )
        x = truth * rng.uniform(0.8, 1.2, len(truth))
        log = simulate_torque(model, x, log, noise=level, rng=rng)
        parts.append(build_regression(model, log))
    found = recording_scatter(model, parts, base)
    fits = [unconstrained_fit(part, base) for part in parts]
    x = np.array([fit.solution.x for fit in fits])
    w = 1.0 / np.array(
        [np.diag(f.noise.steps @ f.noise.inflation @ f.noise.steps.T) for f in fits]
    )
    ends = ("viscous", "offset", "rotor_inertia")
    names = [model.layout.names[i].split(".")[1] for i in base.independent]
    noise, sums = unconstrained_fit(merged(parts), base).noise, []
    for kind, own in (
        ("inertial", [name not in ends for name in names]),
        ("friction", [name in ends[:2] for name in names]),
        ("other drive terms", [name in ends[2:] for name in names]),
    ):
        spread = excess(x[:, own], w[:, own])
        expected = np.maximum(spread.ratio - 1.0, 0.0) * spread.unit
        assert found.deviations[own] ** 2 == pytest.approx(expected)
        assert found.freedom[kind] == spread.freedom
        D = np.diag(np.where(own, found.deviations, 0.0) ** 2)
        grams = [R.T @ R for R in (p.stacked()[:, base.independent] for p in parts)]
        moves = [noise.steps.T @ G for G in grams]
        sums.append(np.sum([M @ D @ M.T for M in moves], axis=0))
    added = found.added_to(noise, parts, base)
    between = {s.freedom: s.covariance for s in added.between}
    for freedom, expected in zip(found.freedom.values(), sums, strict=True):
        np.testing.assert_allclose(between[freedom], expected, rtol=1e-6, atol=1e-12)
