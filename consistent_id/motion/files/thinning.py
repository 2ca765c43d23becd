"""As few points of a path as controllers need that join them by quintics.

A controller that is given positions, velocities and accelerations joins two points,
``h`` seconds apart, by the quintic that has them at both ends.  It is off by no more
than ``h^6 max |q^(6)| / 46080``, Hermite's remainder with both ends thrice.
"""

import numpy as np

from consistent_id._support.arrays import Vector, number
from consistent_id.errors import ProblemError
from consistent_id.motion.proofs.peaks import smooth_pieces
from consistent_id.recordings.paths import JointPath
from consistent_id.recordings.recording import Recording

_REMAINDER = 720.0 * 2.0**6
"""Of ``((t - a) (b - t))^3 / 6!``, at most ``(h / 2)^6 / 6!``."""
_LEAST = 1e-6  # rad or m; messages round times to nanoseconds


def thinned(path: JointPath, tolerance: float, name: str = "trajectory") -> Recording:
    """Return points between which quintics follow a path within a tolerance.

    In each smooth piece they are at equal steps; where pieces meet is one, too.  A
    quintic, such as a run-in, needs its two ends alone.

    Parameters
    ----------
    tolerance : float, [rad or m]
        Which no joint is off by at any time, proven by a bound of the path's sixth
        derivative.

    Raises
    ------
    ProblemError
        If the tolerance is below a millionth.

    Examples
    --------
    >>> from consistent_id.motion.polynomial_path import PolynomialPath
    >>> quintic = [[0.0], [0.0], [0.0], [1.0], [1.0], [1.0]]
    >>> thinned(PolynomialPath(("elbow",), quintic, duration=2.0), 1e-4).time.tolist()
    [0.0, 2.0]
    """
    if not _LEAST <= number(tolerance, "tolerance") < np.inf:
        raise ProblemError(
            f"tolerance is {tolerance} rad or m, expected {_LEAST:g} or more"
        )
    times = [np.array([path.start])]
    for piece in smooth_pieces(path):
        times.append(piece.start + _steps(piece, tolerance))
    time = np.concatenate(times)
    q, dq, ddq = path.evaluate(time)
    return Recording(path.joints, time, q, dq, ddq, name=name)


def _steps(piece: JointPath, tolerance: float) -> Vector:
    """Return the times of the points after the first, since the piece's start."""
    bend = float(piece.derivative_bound(6).max())
    longest = (_REMAINDER * tolerance / bend) ** (1.0 / 6.0) if bend > 0.0 else np.inf
    count = max(1, int(np.ceil(piece.duration / longest)))
    return np.asarray(piece.duration * np.arange(1, count + 1) / count)
