"""The slope of each joint's torque on the torque of given bodies."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector, array_default, freeze_arrays
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel

_ROUNDING = 1e-10  # relative size of a column that drive terms explain up to rounding


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Slopes of joints' torque on the torque of given bodies, with free drive terms.

    Parameters
    ----------
    joints : tuple of str
    slopes : array_like, shape (joints,)
        One, if the torque is that of these bodies.
    explained : array_like, shape (joints,)
        Share of the torque beyond drive terms, squared, that the bodies explain with
        this slope.
    expected : array_like, shape (joints,)
        Torque of the bodies beyond drive terms, over the measured torque.
    errors : array_like, shape (joints,) or (), optional
        Standard errors of the slopes; infinite where they are not known.
    """

    joints: tuple[str, ...]
    slopes: Vector
    explained: Vector
    expected: Vector
    errors: Vector = array_default(np.inf)

    def __post_init__(self) -> None:
        errors = np.broadcast_to(self.errors, (len(self.joints),))
        object.__setattr__(self, "errors", errors)
        names = ("slopes", "explained", "expected", "errors")
        shapes = dict.fromkeys(names, (len(self.joints),))
        freeze_arrays(self, shapes, "slopes", finite=False)


def slopes_on(model: TorqueModel, regression: Regression, bodies: Vector) -> Slopes:
    """Return the slope of each joint's torque on that of bodies.

    Parameters
    ----------
    bodies : ndarray, shape (10 * links,)
    """
    inertial, found = model.layout.inertial_size, []
    for F in regression.factors:
        both = np.column_stack([F[:, :inertial] @ bodies, F[:, -1]])
        drive = F[:, inertial:-1]
        norms = np.linalg.norm(drive, axis=0)
        # After filters, columns of a joint at rest are so small that their squares
        # vanish.
        moving = norms > _ROUNDING * norms.max(initial=0.0)
        if moving.any():
            unit = drive[:, moving] / norms[moving]
            both = both - unit @ np.linalg.lstsq(unit, both, rcond=None)[0]
        expected, beyond = np.linalg.norm(both, axis=0)
        product = float(both[:, 0] @ both[:, 1])
        if expected <= _ROUNDING * np.linalg.norm(F):
            found.append((np.nan, 0.0, 0.0))
            continue
        both_sizes = float(expected) * float(beyond)
        explained = product**2 / max(both_sizes**2, 1e-300)
        size = max(float(np.linalg.norm(F[:, -1])), 1e-300)
        found.append((product / expected**2, explained, expected / size))
    return Slopes(regression.joints, *np.array(found).T)
