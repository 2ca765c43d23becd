"""How likely other speeds of the clock are, whatever the bodies are.

With ``s_j(f)`` the residual of joint `j` in least squares of a log
whose clock is corrected by ``f``, the concentrated likelihood of ``f`` is that of

    minimise  2 n sum_j log s_j(f)

over bodies, drives, and the noise of each joint.  ``n`` is the number of independent
samples, by the longest correlation length of all joints: most of the residual is an
error of the friction model, and a light joint that is all friction looks white.
Drives have the velocities of the log as it is, or of the other clock, whichever leaves
more: another clock alone would mend friction whose velocity scale is wrong.  Where
drives take most of the torque, friction that the model lacks, such as that of joints
which stick, looks like a clock, too: in some joints, and not in others.  There, all
joints have to show the clock, or it has to explain much.
"""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.diagnosis.factor_logs import FactorLogs, factors_of
from consistent_id.diagnosis.factor_rows import EXACT, FactorRows, residual_of
from consistent_id.regression.correlation_lengths import correlation_lengths

SEVERAL = 2
"""Least number of torques: bodies that one joint carries load another one."""

_AGREE = 0.99  # of Student's t, with which the mean joint must show a clock
# Mean decrease of the logarithm of a joint's residual from which on it is much.  Legs
# of an A1 that stick show up to 0.025 with the right clock, at 8 to 11 standard errors;
# a UR3 whose time is 1.3 times that of its clock 0.035, though its joints disagree.
_MUCH = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class _Left:
    """What least squares leaves of logs.

    Parameters
    ----------
    sizes : ndarray, shape (joints,)
        Logarithm of each joint's residual.
    length : float
        Longest correlation length, in samples.
    """

    sizes: Vector
    length: float

    @classmethod
    def of(cls, rows: FactorRows) -> "_Left":
        rest, size = residual_of(rows)
        ends = np.cumsum([len(log) for log in rows.logs])[:-1]
        lengths = correlation_lengths(np.split(rest.T, ends))
        sigma = np.sqrt(np.mean(rest**2, axis=1))
        logs = np.log(np.maximum(sigma, EXACT * size))
        return cls(logs, float(lengths.max()))


class ClockSpeeds:
    """The likelihood of clocks' speeds, by their logarithm; each is computed once."""

    def __init__(self, as_is: FactorLogs) -> None:
        self.factor = next(f for f in factors_of(as_is.model) if f.kind == "clock")
        self._as_is, self._count = as_is, int(as_is.rows.torque.shape[1])
        self._left = {0.0: _Left.of(as_is.rows)}

    def lost(self, size: float) -> float:
        """Return the sum over joints of logarithms of residuals, less that of zero."""
        if size not in self._left:
            moved = self._as_is.without(self.factor, size).rows
            both = (_Left.of(moved), _Left.of(moved.with_drives_of(self._as_is.rows)))
            self._left[size] = max(both, key=lambda one: float(one.sizes.sum()))
        return float(np.sum(self._left[size].sizes - self._left[0.0].sizes))

    def independent(self, size: float) -> float:
        """Return the number of independent samples, with this speed and without."""
        self.lost(size)
        return self._count / max(self._left[k].length for k in (0.0, size))

    def explained(self, size: float) -> float:
        """Return twice the logarithm of the likelihood ratio."""
        return -2.0 * self.independent(size) * self.lost(size)

    def all_show(self, size: float) -> bool:
        """Return whether joints agree that a speed is likelier, or it explains much."""
        from scipy.special import stdtrit

        self.lost(size)
        gains = self._left[0.0].sizes - self._left[size].sizes
        mean, joints = float(gains.mean()), len(gains)
        if mean >= _MUCH or joints < SEVERAL:
            return mean >= _MUCH
        error = float(gains.std(ddof=1)) / np.sqrt(joints)
        return bool(mean > stdtrit(joints - 1, _AGREE) * error)

    def error(self, size: float, step: float) -> float:
        """Return the standard error, from the bend of the likelihood."""
        low, middle, high = (self.lost(size + k * step) for k in (-1.0, 0.0, 1.0))
        bend = (low - 2.0 * middle + high) / step**2
        return float((self.independent(size) * bend) ** -0.5) if bend > 0.0 else np.inf
