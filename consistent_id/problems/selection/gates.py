"""Gains on blocks left out that a change of the model needs."""

from consistent_id.problems.selection.choice import ModelMove
from consistent_id.problems.selection.fits import Gain

LEAST_HELP = 0.025
"""Least relative decrease of a joint's own squared error by a term that helps it."""

LEAST_GAIN = 0.025
"""Least relative decrease of the squared error by a move."""

SMALL_GAIN = 0.05
"""A gain below this must exceed its standard error as well.  Larger gains need not:
with few blocks, true terms with uneven gains would be rejected.
"""

LEAST_ROW_GAIN = 0.10
"""Least gain of a row mask: higher, as masked rows are no longer predicted."""

LEAST_COUPLING_GAIN = 0.10
"""Least gain of a coupling: a claim about the robot's mechanics, with three terms."""

LEAST_DELAY_GAIN = 0.05
"""Minimum gain of a delay of the torque, which must exceed `SURE` standard errors as
well.  A delay is a claim about the log, and in slow motion it looks like friction.
"""

LEAST_WON = 0.6
"""Least share of the blocks on which a move lowers the error."""

LEAST_WON_BY_VALUES = 0.5
"""The same for another value of an existing setting, such as a cut-off.  It is lower,
because the model does not grow, and the present value is not more likely beforehand.
"""

CONTRADICTION = 3.0
"""Standard errors by which data must contradict the masses that a model states.  Stated
masses are knowledge, unlike a friction law, and free masses can replace springs and
zeros.
"""

LEAST_COST = 0.0125
"""Least gain with which a term stays in the model beside later terms."""

_LEAST = {
    "least_speed": LEAST_ROW_GAIN,
    "coupling": LEAST_COUPLING_GAIN,
    "delay": LEAST_DELAY_GAIN,
}

SURE = 2.0
"""Standard errors by which a term must help a joint, if its gain is small."""

PLAIN = 0.25
"""Gain in a joint's own squared error from which a term is kept for the joint, even if
the gain is uneven over the blocks.
"""

_VALUES = ("velocity_scale", "stribeck_value", "motion_cutoff", "delay")


def enough(move: ModelMove, brought: Gain) -> bool:
    """Return whether a move brings enough, by all joints' errors."""
    least = _LEAST.get(move.kind, LEAST_GAIN)
    least = max(least, min(brought.error, SMALL_GAIN))
    if move.kind == "masses":
        least = max(least, CONTRADICTION * brought.error)
    if move.kind == "delay":
        least = max(least, SURE * brought.error)
    won = LEAST_WON_BY_VALUES if move.kind in _VALUES else LEAST_WON
    return brought.share >= least and brought.won >= won


def better(brought: Gain) -> bool:
    """Return whether a term lowers a joint's own error by enough, on most blocks."""
    return brought.share >= LEAST_HELP and brought.won >= LEAST_WON


def believable(brought: Gain) -> bool:
    """Return whether a term helps a joint, from its own errors on blocks left out.

    The gain must be `better`, and `SURE` standard errors or `PLAIN`.
    """
    return better(brought) and brought.share >= min(SURE * brought.error, PLAIN)


def clear(brought: Gain) -> bool:
    """Return whether a term takes off a large part of a joint's own error, surely."""
    return believable(brought) and brought.share >= max(PLAIN, SURE * brought.error)
