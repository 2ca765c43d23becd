"""Numbers of harmonics to try, from how fast the joints may move."""

import numpy as np

from consistent_id.excitation.aims import PathForm
from consistent_id.motion.limits import MotionLimits

_HARMONICS = (5, 8, 12)  # in a path of ten seconds, for arms of usual speed
_SECONDS = 10.0
_USUAL = 0.1  # Hz; half a range at full speed, of arms between 0.05 and 0.2
_FASTER = 10.0  # times as fast as usual at most
_MOST = 24  # harmonics; beyond it, the base frequency is raised


def forms_to_try(
    limits: MotionLimits,
    duration: float = _SECONDS,
    *,
    rest: bool = True,
    smooth: bool = False,
) -> tuple[PathForm, ...]:
    """Return forms of one duration with more and more harmonics.

    The highest frequencies of arms are 0.5, 0.8 and 1.2 Hz; those of robots that cross
    half of their range faster than in ten seconds, such as legs, are higher in
    proportion.

    Parameters
    ----------
    duration : float, [s]
    rest, smooth : bool
        See `PathForm`.

    Examples
    --------
    >>> limits = MotionLimits(("a",), [-2], [2], [1], [9], [np.inf], [np.inf])
    >>> [form.harmonics for form in forms_to_try(limits, 10.0)]
    [5, 8, 12]
    """
    half = limits.derivative(0)
    speed = np.minimum(limits.velocity, np.sqrt(limits.acceleration * half))
    speed = np.minimum(speed, np.cbrt(limits.jerk * half**2))
    crossing = float(np.median(speed / (2.0 * np.pi * half)))
    faster = float(np.clip(crossing / _USUAL, 1.0, _FASTER))
    forms = []
    for harmonics in _HARMONICS:
        count = max(round(harmonics * duration / _SECONDS * faster), harmonics)
        multiple = -(-count // _MOST)
        base = None if multiple == 1 else multiple / duration
        forms.append(
            PathForm(duration, round(count / multiple), base, rest, smooth=smooth)
        )
    return tuple(dict.fromkeys(forms))
