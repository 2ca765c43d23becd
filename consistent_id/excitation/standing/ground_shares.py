"""How much of what the ground bears a motion asks of it: no slip, no tilt, no lift.

A ball keeps its cone of friction, ``|f_xy| <= mu f_z``.  A sole is pressed at its
corners ``(+-X, +-Y)``, each with friction of at most ``mu`` along either side.  What
they can transmit together, however they share it, is exactly [Caron2015]_

    |f_x|, |f_y| <= mu f_z,
    |t_x| <= Y f_z,  |t_y| <= X f_z,
    s t_z + |Y f_x + s mu t_x| + |X f_y + s mu t_y| <= mu (X + Y) f_z,  s = +-1,

of force ``f`` and moment ``t`` about the sole's middle: it does not slip, its centre of
pressure is in it, it does not turn.
"""

from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.excitation.standing.ground_forces import GroundForces
from consistent_id.excitation.standing.stance import Stance, StandingFoot

_NO_PRESS = 1e-9  # N; a foot without weight slips at any force
_CORNER = 2.0**-0.5  # of a cone of friction, along two sides at once


class GroundShare(NamedTuple):
    """A limit, and the share of it that a foot uses at each time."""

    what: str
    foot: str
    share: Vector


def ground_shares(
    stance: Stance, ground: GroundForces, friction: float, least_press: float
) -> list[GroundShare]:
    """Return how much of each foot's limits a motion uses: at most 1, if it keeps them.

    Parameters
    ----------
    stance : Stance
    ground : GroundForces
    friction : float
        Coefficient that may be used.
    least_press : float
        Of its share of the weight, with how much each foot is pressed at least.
    """
    found: list[GroundShare] = []
    first = 0
    for foot, rotation in zip(stance.feet, _turns(stance), strict=True):
        forces = ground.forces[:, first : first + len(foot.points)]
        first += len(foot.points)
        usual = ground.share * len(foot.points)
        press = forces[..., 2].sum(axis=1)
        lift = (usual - press) / (usual * (1.0 - least_press))
        if foot.flat:
            wrench = _sole_wrench(foot, forces @ rotation)
            shares = sole_shares(wrench, _half_sides(foot), friction * _CORNER)
        else:
            along = np.linalg.norm(forces[..., :2].sum(axis=1), axis=1)
            shares = {"friction cone": along / (friction * _pressed(press))}
        shares = {"pressing": lift, **shares}
        found += [GroundShare(what, foot.frame, s) for what, s in shares.items()]
    return found


def sole_shares(wrench: Matrix, half: Vector, friction: float) -> dict[str, Vector]:
    """Return which shares of its limits a sole uses.

    Parameters
    ----------
    wrench : ndarray, shape (samples, 6), [N, N m]
        On the sole, force first, about its middle, z away from the ground.
    half : ndarray, shape (2,), [m]
        Half of its length, along x, and of its width.
    friction : float
        Coefficient along each side.
    """
    fx, fy, _, tx, ty, tz = wrench.T
    press, mu = _pressed(wrench[:, 2]), friction
    X, Y = half
    slip = np.maximum(abs(fx), abs(fy)) / (mu * press)
    tilt = np.maximum(abs(tx) / Y, abs(ty) / X) / press
    turns = [
        s * tz + abs(Y * fx + s * mu * tx) + abs(X * fy + s * mu * ty)
        for s in (-1.0, 1.0)
    ]
    turn = np.max(turns, axis=0) / (mu * (X + Y) * press)
    return {"friction cone": slip, "centre of pressure": tilt, "turning": turn}


def _pressed(press: Vector) -> Vector:
    return np.maximum(press, _NO_PRESS)


def _turns(stance: Stance) -> list[Array]:
    """Return how feet are turned in the world, each shape (3, 3)."""
    return [seen.rotation[0] for seen in stance.seen(stance.pose[None])]


def _half_sides(foot: StandingFoot) -> Vector:
    """Return half of a sole's length and width."""
    return np.asarray(0.5 * np.ptp(foot.points, axis=0)[:2])


def _sole_wrench(foot: StandingFoot, forces: Array) -> Matrix:
    """Return force and moment of corners about their middle, in the foot's axes."""
    low, high = foot.points.min(axis=0), foot.points.max(axis=0)
    arms = foot.points - 0.5 * (low + high)
    moment = np.cross(arms, forces).sum(axis=1)
    return np.hstack([forces.sum(axis=1), moment])
