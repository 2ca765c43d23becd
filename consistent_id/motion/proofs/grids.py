"""What samples say of a trigonometric polynomial between them."""

import numpy as np

from consistent_id.errors import ProblemError


def between_samples(degree: int, samples: int) -> float:
    """Return what a trigonometric polynomial can exceed its samples by, a factor.

    ``max |T| <= max_samples |T| / cos(pi H / N)`` for degree ``H`` and ``N > 2 H``
    equidistant samples of its period, wherever they begin.  A cosine reaches it where
    ``2 H`` divides ``N``.

    Parameters
    ----------
    degree : int
        Period times highest frequency.
    samples : int
        Over one period, its end not counted.

    Raises
    ------
    ProblemError
        With two samples per cycle or fewer, which bound nothing.

    References
    ----------
    [EhlichZeller1964]_, for polynomials, which are the even ones of these;
    ``docs/limits-for-all-time.md`` has the proof.

    Examples
    --------
    >>> round(between_samples(5, 60), 4)
    1.0353
    """
    if degree < 0 or not samples > 2 * degree:
        raise ProblemError(
            f"{samples} samples of a trigonometric polynomial of degree {degree}, "
            f"expected more than {2 * degree}; take more samples"
        )
    return float(1.0 / np.cos(np.pi * degree / samples))
