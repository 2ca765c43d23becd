"""The search of a delay, on errors whose least value is known."""

import numpy as np
import pytest

from consistent_id.rollout.delay_search import FIRST, MOST, NEAR, found_delay

PLACES = np.array([0.012, 0.0135, 0.015, 0.0147])  # s, of blocks of equal weight


def squares(delay, places=PLACES):
    return 1e-6 + (delay - places) ** 2


@pytest.mark.parametrize("first", [FIRST, (0.011 - NEAR, 0.011, 0.011 + NEAR)])
def test_a_delay_beyond_one_sample_is_found_with_the_scatter_of_its_blocks(first):
    found = found_delay(squares, first)
    # Parabolas of one bend: the least value is the mean of the blocks', and the
    # jackknife of a mean is its standard error.
    assert found.delay == pytest.approx(PLACES.mean(), abs=1e-6)
    standard = PLACES.std(ddof=1) / np.sqrt(len(PLACES))
    assert found.error == pytest.approx(standard, rel=1e-6)
    assert not found.at_bound


def test_a_delay_beyond_the_longest_is_at_its_bound():
    found = found_delay(lambda delay: squares(delay, PLACES + 0.02))
    assert found.at_bound and found.delay == MOST
    assert found.error == np.inf


@pytest.mark.parametrize("first", [FIRST, (-NEAR, 0.0, NEAR)])
def test_commands_that_act_before_they_are_logged_are_at_the_bound_of_none(first):
    found = found_delay(lambda delay: squares(delay, PLACES - 0.019), first)
    assert found.at_bound and found.delay == 0.0
    assert found.error == np.inf


def test_a_longer_range_has_a_longer_delay():
    found = found_delay(lambda delay: squares(delay, PLACES + 0.02), (0.03, 0.04), 0.04)
    assert found.delay == pytest.approx(PLACES.mean() + 0.02, abs=1e-6)
    assert not found.at_bound and found.error < 1e-3


def test_no_delay_has_a_standard_error_too():
    found = found_delay(lambda delay: squares(delay, PLACES - 0.0138), [-NEAR, 0.0])
    assert found.delay == 0.0
    standard = PLACES.std(ddof=1) / np.sqrt(len(PLACES))
    assert found.error == pytest.approx(standard, rel=1e-6)


def test_rollouts_that_diverge_are_passed_over():
    def diverging(delay):
        return squares(delay, PLACES - 0.01) if delay < 0.009 else np.full(4, np.inf)

    found = found_delay(diverging)
    assert found.delay == pytest.approx(PLACES.mean() - 0.01, abs=1e-6)


def test_no_parabola_no_standard_error():
    assert found_delay(lambda delay: np.full(4, np.inf)).error == np.inf


@pytest.mark.parametrize("squares", [[1.0, 1.3, 1.5, 1.9], [1.0, 1.02, 1.1, 1.9]])
def test_an_error_that_rises_from_no_delay_on_has_its_least_there(squares):
    """Through 0, 2.5 and 5 ms the second has a parabola that is lowest at 0.5 ms."""
    known = np.array([0.0, 6e-4, 2.5e-3, 5e-3])

    def of(delay):
        return np.full(4, np.interp(delay, known, squares))

    found = found_delay(of, [0.0, 2.5e-3])
    assert found.delay == 0.0 and found.at_bound


def test_a_delay_of_none_has_an_upper_limit_by_the_scatter_of_its_blocks():
    places = PLACES - 0.0145  # their mean is below 0
    found = found_delay(lambda delay: squares(delay, places), [-NEAR, 0.0])
    standard = places.std(ddof=1) / np.sqrt(len(places))
    assert found.at_bound and found.delay == 0.0
    assert found.limit == pytest.approx(places.mean() + 3.182446 * standard, abs=1e-5)
    assert found.interval == (0.0, found.limit)


def test_the_upper_limit_of_none_is_found_among_longer_delays():
    places = np.array([-0.012, 0.004, -0.001, 0.003])
    found = found_delay(lambda delay: squares(delay, places), [-NEAR, 0.0])
    standard = places.std(ddof=1) / np.sqrt(len(places))
    assert found.limit == pytest.approx(places.mean() + 3.182446 * standard, abs=1e-5)
    assert found.limit > 4.0 * NEAR


def test_commands_that_act_long_before_they_are_logged_have_a_limit_of_none():
    found = found_delay(lambda delay: squares(delay, PLACES - 0.019), [-NEAR, 0.0])
    assert found.limit == 0.0


def test_there_is_no_upper_limit_where_blocks_do_not_agree_that_the_error_rises():
    places = np.array([-0.05, 0.045, -0.05, 0.04])
    found = found_delay(lambda delay: squares(delay, places), [-NEAR, 0.0])
    assert found.at_bound and found.limit is None and found.interval is None


def test_longer_delays_that_diverge_leave_the_upper_limit_unknown():
    places = np.array([-0.012, 0.004, -0.001, 0.003])

    def diverging(delay):
        return squares(delay, places) if delay < 0.006 else np.full(4, np.inf)

    found = found_delay(diverging, [-NEAR, 0.0])
    assert found.at_bound and found.limit is None
