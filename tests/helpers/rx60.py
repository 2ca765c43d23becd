"""The paper's RX-60: its problem, and what its tables say, examined once."""

from functools import cache

from consistent_id import load_problem
from consistent_id.problems.published import check_published

PROBLEM = load_problem("problems/rx60")


@cache
def report():
    return check_published(PROBLEM)


def truth():
    """Return parameters of the consistent robot that is nearest to the paper's mean."""
    return report().vectors[0].nearest.parameters
