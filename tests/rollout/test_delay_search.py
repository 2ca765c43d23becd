"""The search of a delay, on errors whose least value is known."""

import numpy as np
import pytest

from consistent_id.rollout.delay_search import APART, FIRST, MOST, NEAR, found_delay

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


def test_neighbours_of_the_best_delay_are_nearer_where_rollouts_diverge():
    """From 0.7 ms after it on: without a neighbour there is no parabola."""
    best = PLACES.mean() - 0.01

    def diverging(delay):
        near = delay < best + 0.0007
        return squares(delay, PLACES - 0.01) if near else np.full(4, np.inf)

    found = found_delay(diverging, [best - APART, best, best + APART])
    assert found.delay == pytest.approx(best, abs=1e-6)
    standard = PLACES.std(ddof=1) / np.sqrt(len(PLACES))
    assert found.error == pytest.approx(standard, rel=1e-6)


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


SIGNS = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, 1.0])
FAR = (0.011 - APART, 0.011 - NEAR, 0.011, 0.011 + NEAR, 0.011 + APART)  # s


def two_valleys(differences):
    """Least errors at 6 and 11 ms, which differ by these of blocks: later is best."""
    differences = np.asarray(differences)

    def of(delay):
        later = (delay - 0.011) ** 2 + 0.0 * differences
        return 1e-5 + np.minimum(later, (delay - 0.006) ** 2 + differences)

    return of


def test_a_second_least_error_is_inside_if_blocks_disagree_which_is_lower():
    squares = two_valleys(1e-6 * SIGNS)
    found = found_delay(squares, FAR, beyond=True)
    assert found.delay == pytest.approx(0.011, abs=1e-4)
    assert found.interval[0] == pytest.approx(0.006) and found.interval[1] < 0.0115
    # By scatter around the best one alone, it is far outside.
    assert found_delay(squares, FAR).interval[0] > 0.009


def test_a_second_least_error_is_outside_if_all_blocks_agree_that_it_is_higher():
    """One block has nearly all of the difference: t is 1.03, far from certain."""
    more = np.array([1e-5, *[2e-8] * 7])
    assert more.sum() / (np.std(more, ddof=1) * np.sqrt(8)) < 1.1
    found = found_delay(two_valleys(more), FAR, beyond=True)
    assert found.interval == found_delay(two_valleys(more), FAR).interval


@pytest.mark.parametrize(("worse", "outside"), [(1, True), (2, False)])
def test_it_is_outside_if_blocks_agree_so_much_by_chance_in_1_of_40_cases(
    worse, outside
):
    """The 256 sums of 8 numbers with any signs are counted by hand.

    Of seven ones and -0.5, 2 sums are as large as theirs: with -0.5 or 0.5 and seven
    ones.  Of six ones, -1 and -0.5, one of the seven may be negative, too: 16.
    """
    differences = np.ones(8)
    differences[:worse] = [-0.5, -1.0][:worse]
    found = found_delay(two_valleys(1e-6 * differences), FAR, beyond=True)
    assert (found.interval[0] > 0.009) == outside


def test_delays_as_good_are_looked_for_until_one_is_worse_with_certainty():
    """Below 8.5 ms blocks disagree if the error is larger; above 11 ms it rises."""
    tried = []

    def squares(delay):
        tried.append(delay)
        if delay < 0.0085:
            return 1e-5 + 7e-6 * SIGNS
        return 1e-5 + np.full(8, (delay - 0.011) ** 2)

    found = found_delay(squares, FAR, beyond=True)
    assert found.as_good[0] == 0.0 and found.as_good[1] < 0.0085
    assert min(tried) == 0.0 and max(tried) == 0.011 + APART


def test_no_further_delay_is_tried_where_the_error_has_one_least_value():
    def counted(**options):
        tried = []

        def one(delay):
            tried.append(delay)
            return 1e-6 + (delay - np.tile(PLACES, 2) + 0.003) ** 2

        return found_delay(one, FAR, **options), len(tried)

    (found, count), (plain, before) = counted(beyond=True), counted()
    assert count == before
    assert found.interval == plain.interval


def test_delays_that_diverge_are_not_as_good():
    near = two_valleys(1e-6 * SIGNS)

    def squares(delay):
        return near(delay) if 0.004 < delay < 0.014 else np.full(8, np.inf)

    found = found_delay(squares, FAR, beyond=True)
    assert found.as_good[0] == pytest.approx(0.006) and found.as_good[1] < 0.014
    nowhere = found_delay(lambda delay: np.full(8, np.inf), FAR, beyond=True)
    assert nowhere.as_good is None


def test_the_only_valley_has_the_scatter_of_its_parabola_however_wide_it_is():
    """Excess of squares is twice as uncertain as where their slope is zero.

    At 5 ms from the least error, differences of blocks are by chance, and slopes not.
    """
    places = 0.011 + np.array([-4.0, 4.0, -3.0, 3.0, -4.0, 4.0, -2.0, 2.0]) * 1e-3

    def one(delay):
        return 1e-6 + (delay - places) ** 2

    found = found_delay(one, FAR, beyond=True)
    more = one(FAR[0]) - one(0.011)
    assert (more < 0.0).sum() == 3 and found.as_good is None
    assert found.interval == found_delay(one, FAR).interval
