"""The search for the weight that uses up the slack, on laws written by hand."""

import numpy as np
import pytest

from consistent_id.estimation.penalised import _WeightSearch


def tries(law, start=0.0, most=30, share=0.95, **options):
    """Return how many weights are tried until a share of the slack is used, or all."""
    search = _WeightSearch(start)
    for number in range(1, most + 1):
        used = law(np.exp(search.log_weight))
        if share <= used <= 1.0:
            return number
        search = search.narrowed(used, **options)
    return np.inf


@pytest.mark.parametrize("end", [-15.0, -2.0, 0.0, 3.0, 12.0])
@pytest.mark.parametrize("power", [1.0, 1.5, 2.0])
def test_a_power_law_takes_few_tries_from_either_side(end, power):
    # A small weight moves the estimate in proportion, and the misfit by its square.
    # Steps of a factor of 1000 at the most, a bracket, and one or two more.
    assert tries(lambda w: (w / np.exp(end)) ** power) <= 4 + abs(end) / np.log(1e3)


def test_a_law_that_bends_takes_few_tries():
    # The square of the weight while it is small, then less and less: as of real logs.
    def law(w):
        return 40.0 * w**2 / (1.0 + w) ** 1.5

    assert tries(law, start=-6.0) <= 6
    assert tries(law, start=6.0) <= 6


def test_a_share_that_rests_below_the_slack_is_left_soon():
    # As of few data: the nominal robot almost fits, and beyond it nothing happens long.
    def law(w):
        return 0.63 * w / (w + 1e-8) + 0.5 * w

    assert tries(law, start=-18.0) <= 18  # in steps of like length, 28


def test_what_is_aimed_at_is_used():
    found = tries(lambda w: w**1.5, start=-4.0, share=0.995, aim=0.997)
    assert found <= 6


def test_a_misfit_that_never_uses_up_the_slack_raises_the_weight_without_end():
    search = _WeightSearch(0.0)
    for _ in range(5):
        raised = search.narrowed(0.0)
        assert raised.log_weight > search.log_weight + 1.0
        search = raised
