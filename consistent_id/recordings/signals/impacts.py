"""Samples around touch-down and lift-off, in which a filter mixes before and after."""

from dataclasses import replace

import numpy as np

from consistent_id.errors import RecordingError
from consistent_id.recordings.contacts import away_from_changes
from consistent_id.recordings.recording import Recording

# The response of `low_passed` to an impact has fallen to 0.4 % of its peak, after half
# a period to 13 %.  In simulation misfits have fallen after half a period, and up to
# four the trunk is found as well (benchmarks/quadruped.py --first 10 --logs 2 --guards
# 0 0.5 1 2 3 4); foot switches may be late, too.
_PERIODS = 2.0


def impact_guard(cutoff: float) -> float:
    """Return for how long a filter spreads an impact to either side, [s].

    Parameters
    ----------
    cutoff : float, [Hz]
        Of `low_passed`; of motion and torque the lower one.

    Raises
    ------
    RecordingError
        If it is not a positive number.

    Examples
    --------
    >>> impact_guard(20.0)
    0.1
    """
    return spread(_PERIODS, cutoff)


def spread(periods: float, cutoff: float) -> float:
    """Return how long so many periods of a cut-off [Hz] are, [s]."""
    if not (np.isfinite(cutoff) and cutoff > 0.0):
        raise RecordingError(f"cut-off is {cutoff} Hz, expected a positive number")
    return periods / cutoff


def without_impacts(recording: Recording, guard: float) -> Recording:
    """Return a recording whose contacts are not certain around each change of theirs.

    Touch-down is an impact, shorter than a sample; a filter spreads it, and mixes
    forces of different contacts.

    Parameters
    ----------
    recording : Recording
        With contacts.
    guard : float, [s]
        Before and after touch-down and lift-off; see `impact_guard`.

    Returns
    -------
    Recording
        The same but for `ContactFlags.certain`: those samples have no rows.

    Raises
    ------
    RecordingError
        If there are no contacts, or the guard is negative or not a number.

    Examples
    --------
    >>> from consistent_id import ContactFlags
    >>> closed = [False, False, True, True, True]
    >>> time, q = np.linspace(0.0, 0.4, 5), np.zeros((5, 1))
    >>> log = Recording(("knee",), time, q, contacts=[ContactFlags("foot", closed)])
    >>> without_impacts(log, 0.1).contacts[0].certain
    array([ True, False, False,  True,  True])
    """
    if not recording.contacts:
        raise RecordingError(
            f"{recording.name}: there are no contacts that could change; give "
            "Recording(..., contacts=...)"
        )
    if not 0.0 <= guard < np.inf:
        raise RecordingError(f"guard is {guard} s, expected zero or more")
    contacts = tuple(
        replace(
            flags,
            certain=flags.certain
            & away_from_changes(flags.closed, recording.time, guard),
        )
        for flags in recording.contacts
    )
    return replace(recording, contacts=contacts)
