"""The parts of a selection: blocks, band, factors, screening, gains."""

import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.optimize import lsq_linear

from consistent_id import ProblemError, Recording, draft_problem
from consistent_id.problems.selection.band import prediction_band, velocity_edge
from consistent_id.problems.selection.choice import (
    Choice,
    ModelMove,
    delay_moves,
    scale_moves,
    setter,
    with_drive,
)
from consistent_id.problems.selection.evaluation import (
    Evaluator,
    _drive,
    torque_delay,
)
from consistent_id.problems.selection.fits import (
    Gain,
    HeldOut,
    JointFactors,
    gain,
)
from consistent_id.problems.selection.gates import enough
from consistent_id.problems.selection.samples import (
    EDGES,
    NUMBERS,
    cells,
    folds,
)
from consistent_id.problems.selection.setup import beginning
from tests.helpers.logged import write_arm


def test_each_number_of_blocks_leaves_every_cell_out_once():
    for number in NUMBERS:
        left = sorted(c for n, out in folds() if n == number for c in out)
        assert left == list(range(len(EDGES) - 1))


def test_training_factors_are_those_of_the_rows_outside_each_block():
    rows = np.random.default_rng(0).normal(size=(len(EDGES) - 1, 5, 4))
    cells_of = np.zeros((len(rows), 4, 4))
    for cell, own in zip(cells_of, rows, strict=True):
        cell[:] = np.linalg.qr(own, mode="r")
    found = JointFactors(np.eye(2, 20), {}, cells_of).training
    for (_, out), R in zip(folds(), found, strict=True):
        outside = np.delete(rows, list(out), axis=0).reshape(-1, 4)
        np.testing.assert_allclose(R.T @ R, outside.T @ outside, rtol=0, atol=1e-12)


def test_blocks_of_a_number_are_equally_long():
    lengths = np.diff(EDGES)
    for number, out in folds():
        assert lengths[list(out)].sum() == pytest.approx(1.0 / number)


def test_a_phase_that_comes_again_is_in_the_same_cell():
    time = np.linspace(0.0, 9.99, 1000)
    found = cells(time, 0.0, 9.99, 2.5, 0.0)
    np.testing.assert_array_equal(found[:250], found[250:500])
    assert len(set(found)) == len(EDGES) - 1


def test_no_sample_near_an_edge_belongs_to_a_cell():
    time = np.linspace(0.0, 24.0, 24001)
    found = cells(time, 0.0, 24.0, None, 0.1)
    edges = 24.0 * np.array(EDGES)
    distance = abs(time[:, None] - edges).min(axis=1)
    np.testing.assert_array_equal(found[distance < 0.0999], -1)
    assert (found[distance > 0.1001] >= 0).all()


def test_the_velocity_of_sinusoids_ends_at_the_fastest_of_weight():
    time = np.arange(4000) / 100.0
    q = np.sin(2 * np.pi * 0.25 * time) + 0.2 * np.sin(2 * np.pi * 1.5 * time)
    rng = np.random.default_rng(0)
    noisy = q + 1e-4 * rng.normal(size=len(q))
    log = Recording(("a",), time, noisy[:, None], name="log")
    assert velocity_edge(log) == pytest.approx(1.5, abs=0.08)
    assert prediction_band([log]) == pytest.approx(25.0)  # a quarter of the rate
    slow = Recording(("a",), time, np.sin(2 * np.pi * 0.25 * time)[:, None], name="s")
    assert prediction_band([slow]) == pytest.approx(20 * 0.25, rel=0.3)


def test_stamps_that_jitter_in_step_with_the_sampling_are_no_motion():
    time = np.arange(4000) / 100.0
    late = time + 2e-3 * (np.arange(4000) % 2)  # every other sample is read late
    q = np.sin(2 * np.pi * 0.25 * late) + 0.2 * np.sin(2 * np.pi * 1.5 * late)
    q += 1e-4 * np.random.default_rng(0).normal(size=len(q))
    log = Recording(("a",), time, q[:, None], name="log")
    assert velocity_edge(log) == pytest.approx(1.5, abs=0.08)


@pytest.mark.slow
def test_a_joint_that_carries_next_to_nothing_has_no_load_friction(tmp_path):
    urdf, log = write_arm(tmp_path)
    text = urdf.read_text().replace('<mass value="2"/>', '<mass value="0.002"/>')
    urdf.write_text(re.sub('(i[xyz]{2})="0.0[13]"', r'\1="1e-5"', text))
    problem = draft_problem(urdf, log, select=False, cutoff=10.0).problem()
    begun = beginning(problem, problem.logs("training"), (), 10.0)
    assert begun.evaluator.setting.loaded == ("shoulder",)


@pytest.mark.slow
def test_factors_do_not_depend_on_which_were_made_before(tmp_path):
    problem = draft_problem(*write_arm(tmp_path), select=False, cutoff=10.0).problem()
    begun = beginning(problem, problem.logs("training"), (), 10.0)
    choice, used = begun.plain.choice, begun.evaluator
    wide = tuple(
        msgspec.structs.replace(drive, velocity_scale=0.2) for drive in choice.drive
    )
    one = choice
    changes = [{"delay": 0.01}, {"least_speed": 0.5}, {"motion_cutoff": 5.0}]
    for change in (*changes, {"drive": wide}):  # each leaves the others as they were
        one = replace(one, **change)
        fresh = Evaluator(used.setting).factors(one)
        for own, other in zip(used.factors(one).joints, fresh.joints, strict=True):
            np.testing.assert_array_equal(own.cells, other.cells)
    assert fresh.counts.sum() < used.factors(choice).counts.sum()  # slow rows are out


@pytest.mark.slow
def test_friction_that_comes_late_is_no_delay_of_all_torque(tmp_path):
    urdf, log = write_arm(tmp_path)
    names = log.read_text().splitlines()[0]
    table = np.loadtxt(log, delimiter=",", skiprows=1)
    q, rate = table[:, 1:3], 100.0
    levels, late = np.array([3.0, 1.5]), 1  # Coulomb friction and samples
    sign = np.tanh(rate * np.gradient(q, axis=0) / 0.02)
    table[:, 3:] += levels * (np.roll(sign, late, axis=0) - sign)
    np.savetxt(log, table, "%.9g", ",", header=names, comments="")
    problem = draft_problem(urdf, log, select=False, cutoff=10.0).problem()
    begun = beginning(problem, problem.logs("training"), (), 10.0)
    plain, setting = begun.plain, begun.evaluator.setting
    factors = begun.evaluator.factors(plain.choice)
    found = torque_delay(plain.fits.candidate, factors, setting.base, setting.sigma)
    assert abs(found) < 0.25 * late / rate  # two thirds, were it taken for one


def _predicted(model, x, samples):
    """The torque of parameters, filtered like the torque that is predicted."""
    found = []
    for part in samples.parts:
        along, rows = part.motion.along, part.rows
        torque = model.predict(x, along.q, along.dq, along.ddq)
        marks = 1.0 if along.weights is None else along.weights
        found.append(rows.by(marks * torque, rows.kept))
    return np.concatenate(found)


@pytest.mark.slow
def test_errors_from_factors_are_those_of_the_predicted_torque(begun):
    evaluator, plain = begun.evaluator, begun.plain
    samples = evaluator.samples(plain.choice.motion_cutoff)
    sigma = evaluator.setting.sigma
    for k, (_, out) in enumerate(folds()):
        rows = np.isin(samples.cell, out)
        model, x = plain.fits.candidate.model, plain.fits.parameters[k]
        error = (_predicted(model, x, samples) - samples.torque)[rows] / sigma
        np.testing.assert_allclose(
            plain.errors.squares[k], (error**2).sum(axis=0), rtol=1e-8
        )


def test_a_fit_without_a_block_is_the_best_on_the_other_rows(begun):
    """No step among friction coefficients lowers the squared error of the others."""
    evaluator, plain = begun.evaluator, begun.plain
    samples = evaluator.samples(plain.choice.motion_cutoff)
    model, x = plain.fits.candidate.model, plain.fits.parameters[0]
    rows = ~np.isin(samples.cell, folds()[0][1])

    def misfit(x):
        error = (_predicted(model, x, samples) - samples.torque)[rows]
        return float(((error / evaluator.setting.sigma) ** 2).sum())

    least = misfit(x)
    for i in range(model.layout.inertial_size, len(model.layout)):
        for sign in (-1.0, 1.0):
            moved = x.copy()
            moved[i] += sign * 0.02 * max(abs(x[i]), 0.1)
            assert misfit(moved) > least


def test_screened_drive_terms_are_the_bounded_least_squares_solution():
    rng = np.random.default_rng(3)
    A, b = rng.normal(size=(20, 30, 5)) * [1, 10, 0.1, 1, 5], rng.normal(size=(20, 30))
    nonnegative = np.array([True, True, False, True, False])
    low = np.where(nonnegative, 0.0, -np.inf)
    expected = [
        lsq_linear(*fold, (low, np.inf), tol=1e-13).x for fold in zip(A, b, strict=True)
    ]
    np.testing.assert_allclose(_drive(A, b, nonnegative), expected, atol=1e-6)


def test_a_gain_is_the_share_of_the_squared_error_that_is_gone():
    before = HeldOut(np.full((14, 2), 2.0))
    after = HeldOut(np.full((14, 2), 1.5))
    found = gain(before, after)
    assert found.share == pytest.approx(0.25)
    assert found.error == pytest.approx(0.0)
    assert found.won == 1.0


def test_blocks_without_rows_and_ties_but_for_rounding_are_neither_won_nor_lost():
    squares = np.full((14, 1), 2.0)
    squares[3] = 0.0  # no row of this block is kept
    less = np.array([1, 1, 0, 0, 1, -1, 1e-9, -1e-9, 1, 1, 0, 1, 1, 1])[:, None]
    found = gain(HeldOut(squares), HeldOut(squares - 0.1 * less))
    assert found.won == pytest.approx(8 / 9)
    assert gain(HeldOut(squares), HeldOut(squares)).won == 0.0


def test_another_value_needs_half_of_the_blocks_and_another_term_more(begun):
    choice = begun.plain.choice
    brought = Gain(share=0.2, error=0.15, won=8 / 14)
    widths = begun.scope.widths[0]._replace(scales=(0.5,))
    width = next(scale_moves(choice, widths))
    rotor = ModelMove("rotor_inertia", "rotor_inertia", choice, choice)
    assert enough(width, brought)
    assert not enough(rotor, brought)
    assert not enough(width, replace(brought, won=6 / 14))
    assert not enough(width, replace(brought, share=0.02))


def test_another_width_keeps_stribeck_velocities_that_were_found(begun):
    change = setter(stribeck_velocity=0.137)
    choice = with_drive(begun.plain.choice, [0, 1], change)
    widths = begun.scope.widths[0]._replace(scales=(0.05,))
    for fading, expected in (((), 0.12), ((0.137,), 0.137)):
        moves = scale_moves(choice, widths, fading)
        (after,) = {d.stribeck_velocity for m in moves for d in m.after.drive}
        assert after == expected


def test_the_error_of_a_gain_is_that_of_a_mean_over_blocks():
    rng = np.random.default_rng(1)
    after = np.append(np.full(8, 10.0), np.full(6, 80.0 / 6.0))[:, None]
    found = []
    for _ in range(1000):
        less = rng.normal(1.0, 2.0, size=8)
        more = np.append(less, np.full(6, less.sum() / 6.0))[:, None]
        found.append(gain(HeldOut(after + more), HeldOut(after)))
    spread = np.std([g.share for g in found])
    # Six blocks alike say that there is no error, eight blocks how large it is.  A
    # standard deviation of 1000 is known to 2.2 %: 10 % is 4.5 of these.
    assert 2.0 * np.mean([g.error for g in found]) == pytest.approx(spread, rel=0.1)


def test_rows_in_which_the_robot_creeps_are_left_out_on_request(tmp_path):
    from consistent_id.recordings.signals import faster, speed_share

    time = np.arange(1000) / 100.0
    dq = np.where(time < 5.0, 1.0, 0.01)[:, None]
    q = np.cumsum(dq, axis=0) / 100.0
    log = Recording(("a",), time, q, dq, np.zeros_like(q), name="log")
    share = speed_share(log)
    assert share[0] == 1.0
    assert share[-1] == pytest.approx(0.01)
    kept = faster(log, 0.05)
    assert kept.time[-1] == pytest.approx(5.0 + 0.12, abs=0.011)
    assert faster(log, 0.005) is log


def test_a_share_of_top_speed_lies_between_none_and_all(tmp_path):
    from consistent_id.problems.file import problem_table

    text = 'name = "x"\n[model]\nurdf = "a"\n[data]\n'
    text += 'recordings = [{ file = "a.csv", role = "training" }]\n'
    text += "preparation = { least_speed = 1.5 }\n"
    with pytest.raises(ProblemError, match="least_speed"):
        problem_table(text, tmp_path / "problem.toml")


def test_a_delay_is_late_or_early_but_never_negative():
    plain = Choice(())
    (late,), (early,) = (delay_moves(plain, delay) for delay in (0.0074, -0.013))
    assert late.label == "torque late by 7.4 ms"
    assert early.label == "torque early by 13 ms"
    assert early.after.delay == -0.013
    assert list(delay_moves(early.after, -0.013)) == []
