"""Errors of rollouts, compared over the levels of joints."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

from commanded_leg import write_leg

from consistent_id import Recording, load_problem
from consistent_id.rollout import candidates as module
from consistent_id.rollout.candidates import Candidates
from consistent_id.rollout.chosen_settings import chosen_settings
from consistent_id.rollout.commanded_motion import Replay
from consistent_id.rollout.compared_models import Rollout
from consistent_id.rollout.part_errors import (
    LEAST_LEVEL,
    is_larger,
    joint_weights,
    squares_of_part,
)
from consistent_id.rollout.refined_parts import best_ridge
from consistent_id.rollout.settings import Settings, rollout_error, torque_fit

BLOCKS = np.array([0.9, 1.1, 1.2, 0.8])
LEVELS = np.array([1.0, 100.0, 4.0])  # squared, of three joints
SQUARES = BLOCKS[:, None] * LEVELS


def test_weights_give_joints_equal_shares_of_the_same_sum():
    weighted = SQUARES * joint_weights(SQUARES)
    assert weighted.sum(axis=0) == pytest.approx(SQUARES.sum() / 3.0)
    scaled = [1.0, 1e-3, 1.0]  # a joint in other units
    again = SQUARES * scaled * joint_weights(SQUARES * scaled)
    assert again / again.sum() == pytest.approx(weighted / weighted.sum())


def test_a_joint_at_rest_and_a_motion_that_diverges_have_no_weights_of_their_own():
    still = SQUARES * [0.0, 1.0, 1.0]
    weights = joint_weights(still)
    assert np.isfinite(weights).all()
    assert weights[0] == pytest.approx(weights[2] / LEAST_LEVEL**2)
    assert weights[2] == pytest.approx(25.0 * weights[1])
    assert (joint_weights(SQUARES * [1.0, np.inf, 1.0]) == 1.0).all()
    assert (joint_weights(0.0 * SQUARES) == 1.0).all()


@pytest.mark.parametrize("times", [20.0, 200.0, 1e4])
def test_shares_are_equal_however_large_the_error_of_one_joint(times):
    one = SQUARES * [1.0, times**2, 1.0]
    shares = (one * joint_weights(one)).sum(axis=0)
    assert shares == pytest.approx(one.sum() / 3.0)


def test_a_joint_with_a_large_error_does_not_hide_what_is_lost_at_others():
    now = SQUARES * [1.5, 0.97, 1.5]
    assert now.sum() < SQUARES.sum()
    assert is_larger(now, SQUARES)
    assert not is_larger(SQUARES, now)
    # Over the levels before: over its own, the first joint would count a hundredth.
    first = SQUARES * [10.0, 0.8, 0.8]
    assert is_larger(first, SQUARES) and not is_larger(SQUARES, first)
    parts = {None: (SQUARES, SQUARES), 0.1: (now, now)}
    assert best_ridge(parts) is None
    parts = {None: (now, now), 0.1: (SQUARES, SQUARES)}
    assert best_ridge(parts) == 0.1


def test_errors_are_larger_by_as_many_standard_errors_as_are_asked():
    spread = np.array([1.0, -1.0, 2.0, -2.0])
    error = np.std(spread, ddof=1) / 2.0
    before = np.full((4, 1), 10.0)
    now = before + (spread + 2.0 * error)[:, None]
    assert is_larger(now, before, errors=1.9)
    assert not is_larger(now, before, errors=2.1)
    assert not is_larger(now, before)  # 3.2 of them, with four blocks


@pytest.mark.slow
def test_settings_whose_motion_diverges_are_infinite_in_both_parts(
    tmp_path, monkeypatch
):
    write_leg(tmp_path)
    candidates = Candidates(load_problem(tmp_path))
    found = iter([np.ones((4, 2)), np.full((4, 2), np.inf)])
    monkeypatch.setattr(module, "squares_of_part", lambda *given: next(found))
    settings = Settings(cutoff=20.0)
    assert np.isinf(candidates.by_joint(settings)).all()
    assert candidates.by_joint(settings).shape == (8, 2)
    assert np.isinf([candidates.tried[settings], candidates.error(settings)]).all()
    assert candidates.built and not candidates.skipped
    candidates.weigh(settings)
    assert np.isinf(candidates.error(settings))


@pytest.mark.slow
def test_squares_of_both_parts_make_the_mean_square(tmp_path):
    write_leg(tmp_path)
    problem = load_problem(tmp_path)
    candidates = Candidates(problem)
    settings = Settings(cutoff=20.0)
    plain = candidates.by_joint(settings)
    assert candidates.tried[settings] == pytest.approx(np.sqrt(plain.sum()))
    assert candidates.squares(settings) == pytest.approx(plain.sum(axis=1))
    candidates.weigh(settings)
    assert candidates.error(settings) == pytest.approx(candidates.tried[settings])
    shares = (plain * joint_weights(plain)).sum(axis=0)
    assert shares[0] == pytest.approx(shares[1])
    assert candidates.squares(settings) == pytest.approx(plain @ joint_weights(plain))
    # One part that is both learnt from and judged: half of its mean square.
    whole = tuple((log.time[0], log.time[-1]) for log in problem.logs("training"))
    squares = squares_of_part(problem, whole, whole)
    estimate, _ = torque_fit(problem)
    error = rollout_error(problem, estimate, problem.logs("training"))
    assert squares.shape[1] == 2
    assert 2.0 * squares.sum() == pytest.approx(error**2, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.003, 0.007])
def test_a_joint_that_meets_a_stop_does_not_decide_the_delay_of_all(tmp_path, delay):
    """The knee's stop is not in the replay, so its error is fifty times the hip's."""
    write_leg(tmp_path, delay=delay, stop=0.2)
    choice = chosen_settings(load_problem(tmp_path))
    assert abs(choice.settings.delay - delay) < 1e-3
    low, high = choice.delay_interval
    assert low <= delay <= high


def test_the_error_of_a_joint_is_that_of_all_samples():
    logs = []
    for count, error in [(100, 30e-3), (300, 1e-3)]:
        rest = np.zeros((count, 3))
        log = Recording(("a", "b", "c"), np.arange(count) / 100.0, rest, rest)
        moved = rest + np.array([0.0, 1e-3, error])
        logs.append(Replay("model", log, moved, rest))
    found = Rollout({"model": tuple(logs)}, {}, 0.0)
    whole = np.sqrt((100 * 30.0**2 + 300) / 400)
    others = np.sqrt(0.5)
    assert f"(c {whole:.2f}, the others {others:.2f})" in found.sentence
    parts = (whole**2 + 2.0 * others**2) / 3.0
    assert f"{np.sqrt(parts):.2f} mrad" in found.sentence


@pytest.mark.parametrize(
    ("errors", "said"),
    [
        ((3e-3, 4e-3, 20e-3), " (c 20.00, the others 3.54)"),
        ((3e-3, 4e-3, 4e-3), ""),
        ((0.0, 0.0, 0.0), ""),
        ((3e-3, 20e-3), ""),
    ],
    ids=["one joint", "alike", "none", "two joints"],
)
def test_a_joint_with_most_of_the_error_is_named_beside_the_others(errors, said):
    joints = ("a", "b", "c")[: len(errors)]
    rest = np.zeros((50, len(errors)))
    log = Recording(joints, np.arange(50) / 100.0, rest, rest)
    moved = Replay("model", log, rest + errors, rest)
    found = Rollout({"model": (moved,)}, {}, 0.0)
    assert found.sentence.split("root mean square of ")[1] == (
        f"all joints{said}, commands 0.00 ms late"
    )
