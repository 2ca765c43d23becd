"""The interval of a delay, on errors whose least value is known, and on a leg."""

from dataclasses import replace

import numpy as np
import pytest

from consistent_id import load_problem
from consistent_id.rollout.delay_interval import (
    damping_sentence,
    delay_error,
    delay_interval,
    delay_sentence,
    delay_words,
    other_frictions,
)
from consistent_id.rollout.delay_search import MOST, NEAR, SAME, FoundDelay, found_delay
from consistent_id.signals import PDGains

PLACES = np.array([0.006, 0.0075, 0.009, 0.0087] * 2)  # s, of blocks of equal weight
STANDARD = PLACES.std(ddof=1) / np.sqrt(len(PLACES))
QUANTILE = 2.364624  # Student's t, 7 degrees of freedom, 97.5 %
FOUND = FoundDelay(0.007, 1e-4, False, 8)


def least_at(places):
    return lambda delay: 1e-6 + (delay - places) ** 2


def test_without_other_friction_it_is_the_scatter_between_blocks():
    half = QUANTILE * FOUND.error + SAME
    expected = 0.007 - half, 0.007 + half
    assert delay_interval(FOUND, [], MOST) == pytest.approx(expected, rel=1e-6)


def test_an_unknown_interval_counts_as_the_step_in_which_delays_are_tried():
    assert delay_error(FOUND, None) == NEAR
    # By the end that is farther away, 2.5 ms at 1.96 standard errors.
    assert delay_error(FOUND, (0.006, 0.0095)) == pytest.approx(0.0025 / 1.96, rel=1e-2)


def test_it_contains_the_intervals_with_other_friction():
    others = [least_at(PLACES), least_at(PLACES + 0.004)]
    low, high = delay_interval(FOUND, others, MOST)
    half = QUANTILE * STANDARD + SAME
    own = 0.007 - QUANTILE * 1e-4 - SAME
    assert low == pytest.approx(min(own, PLACES.mean() - half))
    assert high == pytest.approx(PLACES.mean() + 0.004 + half)


def test_it_begins_at_none_if_with_other_friction_there_is_none():
    low, high = delay_interval(FOUND, [least_at(PLACES - 0.02)], MOST)
    assert low == 0.0 and high == pytest.approx(0.007 + QUANTILE * FOUND.error + SAME)


def test_it_contains_a_second_least_error_with_other_friction():
    """It is at 7 ms; at 12 ms it is nearly as small, in some blocks smaller."""
    differences = 1e-6 * np.array([1.0, -1.0] * 3 + [1.0, 1.0])

    def squares(delay):
        sooner = np.full(8, (delay - 0.007) ** 2)
        return 1e-5 + np.minimum(sooner, (delay - 0.012) ** 2 + differences)

    low, high = delay_interval(FOUND, [squares], MOST)
    assert low == pytest.approx(0.007 - QUANTILE * 1e-4 - SAME, abs=1e-4)
    assert high == pytest.approx(0.012 + SAME, abs=1e-4)


def test_there_is_none_if_other_friction_has_a_delay_beyond_the_longest():
    assert delay_interval(FOUND, [least_at(PLACES + 0.02)], MOST) is None


@pytest.mark.parametrize(
    "other",
    [np.full(8, np.inf), np.full(8, 1.0), np.full(8, 0.3)],
    ids=["diverges", "flat", "flat up to rounding"],
)
def test_there_is_none_where_friction_of_another_kind_has_no_best_delay(other):
    assert delay_interval(FOUND, [lambda _: other], MOST) is None


NONE = FoundDelay(0.0, np.inf, True, 8, limit=0.001)


def test_that_of_no_delay_ends_at_the_longest_upper_limit_of_all_frictions():
    later = least_at(PLACES - PLACES.mean() + 0.003)
    sooner = least_at(PLACES - 0.02)
    low, high = delay_interval(NONE, [sooner, later], MOST)
    assert low == 0.0
    assert high == pytest.approx(0.003 + QUANTILE * STANDARD + SAME, rel=1e-3)


def test_commands_that_are_logged_late_are_told_to_check_their_clock():
    late = FoundDelay(0.0, np.inf, True, 8, limit=0.0)
    interval = delay_interval(late, [], MOST)
    assert interval == (0.0, SAME)
    assert "check their clock" in delay_sentence(late, interval)
    assert "check their clock" not in delay_sentence(
        NONE, delay_interval(NONE, [], MOST)
    )


@pytest.mark.parametrize("limit", [0.001, None])
def test_that_of_no_delay_is_its_upper_limit(limit):
    interval = delay_interval(replace(NONE, limit=limit), [], MOST)
    assert interval == (None if limit is None else (0.0, limit + SAME))


def test_there_is_none_for_no_delay_if_other_friction_has_a_long_one():
    assert delay_interval(NONE, [least_at(PLACES + 0.004)], MOST) is None


@pytest.mark.parametrize(
    ("found", "interval", "said"),
    [
        (NONE, (0.0, 0.00694), "delay 0 (at most 6.9 ms)"),
        (NONE, None, "delay 0 (at most: unknown)"),
        (NONE, (0.0, 0.0), "delay 0 (at most 0.0 ms)"),
        (replace(FOUND, delay=0.02, at_bound=True), None, "delay 20 ms, the longest"),
        (FOUND, (0.0061, 0.0079), "delay 7.00 ms (6.1 to 7.9 ms, 95 %)"),
        (FOUND, None, "delay 7.00 ms (error unknown)"),
    ],
)
def test_how_well_a_delay_is_known_is_said(found, interval, said):
    words = delay_words(found, interval)
    assert words.startswith(said)
    sentence = delay_sentence(found, interval)
    assert sentence.startswith(f"{words}: ")
    logged_late = interval == (0.0, 0.0)
    assert ("logged later than they act" in sentence) == logged_late


@pytest.mark.parametrize(
    "found", [replace(FOUND, at_bound=True), replace(FOUND, error=np.inf)]
)
def test_there_is_none_where_the_delay_itself_is_not_known(found):
    assert delay_interval(found, [least_at(PLACES)], MOST) is None


@pytest.mark.slow
@pytest.mark.parametrize(("stribeck", "width"), [(0.4, 0.003), (0.8, 0.007)])
def test_a_true_delay_is_inside_though_friction_is_of_another_kind(
    tmp_path, monkeypatch, stribeck, width
):
    pytest.importorskip("mujoco")
    from commanded_leg import write_leg

    from consistent_id.rollout import chosen_settings as chosen
    from consistent_id.rollout.candidates import Candidates

    searches = []

    def noted(*given, beyond):
        searches.append(beyond)
        return found_delay(*given, beyond=beyond)

    monkeypatch.setattr(chosen, "found_delay", noted)
    write_leg(tmp_path, delay=0.007, stribeck=stribeck)
    problem = load_problem(tmp_path)
    choice = chosen.chosen_settings(problem)
    # Of the delay that is reported, others that are as good are looked for.
    assert searches[-1] and not any(searches[:-1])
    best = replace(choice.settings, delay_error=0.0)
    assert choice.settings.delay_error > 0.0
    assert best.least_joint_speed is not None
    same = [s.delay for s, _ in choice.tried if replace(s, delay=best.delay) == best]
    assert min(same) < best.delay - 0.004 and max(same) > best.delay + 0.004
    low, high = choice.delay_interval
    assert low < 0.007 < high < low + width
    # With all rows, the delay makes up for friction: by scatter it is outside.
    rows = replace(choice.settings, least_joint_speed=None, cutoff=10.0)
    candidates = Candidates(problem)
    found = found_delay(candidates.by_delay(rows))
    assert abs(found.delay - 0.007) > 2.0 * found.error
    others = other_frictions(problem, rows, candidates)
    low, high = delay_interval(found, others, MOST)
    assert low < 0.007 < high < low + 0.012


def test_late_commands_act_like_viscous_friction():
    gains = PDGains(np.array([40.0, 300.0]), 2.0)
    said = damping_sentence(gains, ("hip", "knee"))
    assert said.startswith("1 ms more of delay acts like 0.3 more of viscous friction")
    assert "at knee" in said
    time = np.arange(4000) / 4000
    told, late = np.sin(3.0 * time), np.sin(3.0 * (time - 1e-3))
    rate = 3.0 * np.cos(3.0 * time)
    np.testing.assert_allclose(300.0 * (told - late), 0.3 * rate, atol=2e-3)
