"""The search for the weight that uses up the slack, on laws written by hand."""

import numpy as np
import pytest

from consistent_id.estimation.nearest import _Search


def tries(law, start=0.0, most=30):
    """Return how many weights are tried until 95 to 100 % of the slack are used."""
    search = _Search(start)
    for number in range(1, most + 1):
        used = law(np.exp(search.log_weight))
        if 0.95 <= used <= 1.0:
            return number
        search = search.narrowed(used)
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


def test_a_misfit_that_never_uses_up_the_slack_raises_the_weight_without_end():
    search = _Search(0.0)
    for _ in range(5):
        raised = search.narrowed(0.0)
        assert raised.log_weight > search.log_weight + 1.0
        search = raised
