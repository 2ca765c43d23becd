"""Motions from pose to pose, as robots are programmed: speed profiles and stops."""

from dataclasses import dataclass

import numpy as np

import consistent_id as ci

_WIDEST = 1.6  # rad or m to either side, where an arm's own limits are wider


@dataclass(frozen=True)
class PointToPoint:
    """Poses that are reached one after another, all joints arriving together.

    Speed is a trapezoid whose flanks take a share of the time, or with `smooth` the
    derivative of a polynomial of fifth degree, as planners use it.

    Parameters
    ----------
    poses : ndarray, shape (poses, joints)
    starts, lengths : ndarray, shape (poses - 1,), [s]
        When each move begins, and how long it takes; between moves the robot stands.
    flanks : float
        Share of a move in which it speeds up, and of another in which it slows down.
    smooth : bool
    """

    poses: np.ndarray
    starts: np.ndarray
    lengths: np.ndarray
    flanks: float
    smooth: bool

    def at(self, joints: tuple[str, ...], time: np.ndarray) -> ci.Recording:
        """Return positions and their derivatives."""
        move = np.clip(np.searchsorted(self.starts, time, "right") - 1, 0, None)
        length = self.lengths[move]
        share = np.clip((time - self.starts[move]) / length, 0.0, 1.0)
        moving = (share > 0.0) & (share < 1.0)
        profile = self._smooth(share) if self.smooth else self._trapezoid(share)
        s, ds, dds = (column[:, None] for column in profile)
        way = self.poses[move + 1] - self.poses[move]
        scale = (moving / length)[:, None]
        states = (self.poses[move] + way * s, way * ds * scale, way * dds * scale**2)
        return ci.Recording(joints, time, *states)

    def _smooth(self, x: np.ndarray) -> tuple[np.ndarray, ...]:
        s = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
        ds = 30.0 * x**2 * (1.0 - x) ** 2
        return s, ds, 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)

    def _trapezoid(self, x: np.ndarray) -> tuple[np.ndarray, ...]:
        a = self.flanks
        speed = 1.0 / (1.0 - a)
        before, after = x < a, x > 1.0 - a
        s = speed * (x - a / 2.0)
        s = np.where(before, speed * x**2 / (2.0 * a), s)
        s = np.where(after, 1.0 - speed * (1.0 - x) ** 2 / (2.0 * a), s)
        ds = np.where(before, speed * x / a, speed)
        ds = np.where(after, speed * (1.0 - x) / a, ds)
        return s, ds, np.where(before, speed / a, np.where(after, -speed / a, 0.0))


def drawn_moves(
    robot: ci.RobotModel, rng: np.random.Generator, duration: float, fastest: float
) -> PointToPoint:
    """Return moves between random poses, within limits of travel and speed.

    In one of three motions the joints move one after another, each there and back.
    """
    low, high, most = (np.zeros(len(robot)) for _ in range(3))
    for j, joint in enumerate(robot.driven):
        first = max(joint.limits.lower, -np.pi)
        last = max(min(joint.limits.upper, np.pi), first + 0.5)
        reach = 0.9 * min((last - first) / 2, _WIDEST)
        low[j], high[j] = (first + last) / 2 - reach, (first + last) / 2 + reach
        most[j] = min(joint.limits.velocity, fastest)
    flanks, smooth = rng.uniform(0.1, 0.5), bool(rng.integers(2))
    peak = 1.875 if smooth else 1.0 / (1.0 - flanks)  # speed over its mean
    tempo, rest = rng.uniform(0.4, 0.9), rng.choice([0.0, 0.3, 1.0])
    alone = not rng.integers(3)
    poses, starts, lengths, now = [rng.uniform(low, high)], [], [], 0.0
    while now < duration:
        poses.append(rng.uniform(low, high))
        if alone:
            moves = np.arange(len(robot)) == (len(starts) // 2) % len(robot)
            poses[-1] = np.where(moves, poses[-1], poses[-2])
            if len(starts) % 2:
                poses[-1] = poses[-3]
        way = abs(poses[-1] - poses[-2])
        lengths.append(max(float((peak * way / (tempo * most)).max()), 0.3))
        starts.append(now)
        now += lengths[-1] + rest * rng.uniform()
    return PointToPoint(
        np.array(poses), np.array(starts), np.array(lengths), flanks, smooth
    )
