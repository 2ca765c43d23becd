"""Limits that are not linear in the variables, as rows where they matter.

A guard measures each of its items (a joint's torque, a pair of bodies) along a path;
values above zero are not allowed.  Rows are made only at times where an item is near
zero. A row of distances is one pair of bodies at one time, or a smooth maximum over all
pairs; each pose and pair is computed once:

    log(sum over pairs of exp(s x)) / s,    x = tenths of a metre nearer than allowed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol, Self
from weakref import WeakKeyDictionary

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector
from consistent_id.excitation.basis import FourierBasis
from consistent_id.excitation.kernels import ParameterTorque
from consistent_id.motion.collisions.scene import (
    BodyPlaces,
    Scene,
    body_places,
    moving_pairs,
)
from consistent_id.motion.collisions.separation import (
    Separation,
    distances_along,
    separation,
    separation_slopes,
)
from consistent_id.robot.kinematics import link_places

_TIGHTER = 0.03  # share of a limit given up where a proof has failed
_TORQUE = 1e-7  # s of work per joint, joint before it, and member
_ROWS = 128  # in multiples of which torques' rows are computed,
_FEW = (1, 4, 16, 48)  # or in one of these numbers, if there are few
_DENSITY = 24  # samples per period of the highest frequency
_NEAR = 0.05  # share of the limit within which an item gets a row

_CLOSE = 0.1  # m; unit of distances; larger ones need not be accurate
_SPARE = 0.002  # m; distance beyond the required one that is kept at samples
_FURTHER = 0.003  # m; distance added where a proof has failed
_PAIR_DENSITY = 48  # bodies come nearer between samples, by little if many
_NEAR_BODIES = 0.5  # tenths of a metre from the limit within which rows are made
_BEYOND_NEAR = 0.1  # by which distances are exact beyond that: maxima have neighbours
_QUERY = 1.2e-6  # s of work per pair and time; most distances are only bounded
_SHARP = 20.0  # inverse smoothing distance of a row, in tenths of a metre

EVERY = -1
"""Instead of an item: all items of a guard, as one row."""


class ItemRows(NamedTuple):
    """Values, shape (samples,), and derivatives, shape (samples, 3 orders, joints)."""

    values: Vector
    slopes: Array


class Guard(Protocol):
    """A nonlinear limit of a path, item by item.

    Attributes
    ----------
    seconds : float
        Work of measuring all items at one time, see `work`.
    """

    @property
    def seconds(self) -> float:
        """Work of measuring all items at one time."""

    @property
    def keeps_apart(self) -> bool:
        """Whether it is about distances of bodies."""

    @property
    def pairs(self) -> int:
        """Number of pairs of bodies whose distance it measures."""

    @property
    def density(self) -> int:
        """Samples per period of the highest frequency at which it is to measure."""

    @property
    def near(self) -> float:
        """Distance from the limit within which an item gets a row."""

    def measure(self, motion: Array) -> Matrix:
        """Return the excess of each item over its limit, (samples, items).

        The samples are in the order of the path.
        """

    def kept(self, motion: Array) -> bool:
        """Return whether no item exceeds its limit."""

    def moved_by(self, joint: int) -> Self:
        """Return a guard of the items that a joint of the motion affects."""

    def rows(self, motion: Array, items: IntArray) -> "ItemRows":
        """Return one item per sample, with its derivatives."""

    def item_name(self, item: int) -> str:
        """Name an item for people."""

    def initial_places(self, times: int) -> "set[WatchedPlace]":
        """Return the rows that a search has from its start."""

    def tightened(
        self,
        failed: Sequence[tuple[str, str]] = (),
        peaks: Mapping[str, float] | None = None,
    ) -> Self:
        """Return a slightly tighter guard.

        For bodies, the named pairs must stay further apart, or all pairs if none is
        named; for torque, the named joints get lower peaks.
        """


@dataclass(frozen=True, slots=True, eq=False)
class TorqueGuard:
    """Torque of every parameter vector of a set, relative to the limit.

    Parameters
    ----------
    predicted : ParameterTorque
        Tightened guards have the same.
    effort : ndarray, shape (torque joints,), [N m or N]
    reach : float
        Share of the limit that may be used at a sample.
    """

    predicted: ParameterTorque
    effort: Vector
    reach: float

    @property
    def keeps_apart(self) -> bool:
        """It is about torque."""
        return False

    @property
    def pairs(self) -> int:
        """None."""
        return 0

    @property
    def density(self) -> int:
        """Two dozen: torque varies no faster than motion."""
        return _DENSITY

    @property
    def near(self) -> float:
        """A twentieth of the limit."""
        return _NEAR

    @property
    def seconds(self) -> float:
        """Work of all torques at one time."""
        return _TORQUE * len(self.effort) ** 2 * len(self.predicted.parameters)

    def measure(self, motion: Array) -> Matrix:
        """Return the excess of each torque over its limit."""
        torque = self.predicted.kernel.torque(motion)
        return (abs(torque) / self.effort - self.reach).reshape(len(torque), -1)

    def kept(self, motion: Array) -> bool:
        """Return whether no torque exceeds its limit."""
        return bool(self.measure(motion).max() <= 0.0)

    def moved_by(self, joint: int) -> Self:
        """Return the guard itself: each joint may affect all torques."""
        return self

    def rows(self, motion: Array, items: IntArray) -> ItemRows:
        """Return the sizes of the chosen torques, with derivatives."""
        samples = np.arange(motion.shape[1])
        # Each number of samples has memory: few numbers, by repeating the last one.
        motion = motion[:, np.minimum(np.arange(_padded(len(samples))), samples[-1])]
        kernel = self.predicted.kernel
        member, joint = np.divmod(items, len(self.effort))
        torque = kernel.torque(motion)[samples, member, joint]
        slopes = kernel.slopes(motion)[samples, member, joint]
        share = np.sign(torque) / self.effort[joint]
        return ItemRows(torque * share - self.reach, slopes * share[:, None, None])

    def item_name(self, item: int) -> str:
        """Name the joint."""
        joints = self.predicted.model.torque_joints
        return f"torque of joint {joints[item % len(self.effort)]!r}"

    def initial_places(self, times: int) -> "set[WatchedPlace]":
        """Return none: few torques come near their limits, and rows take time."""
        return set()

    def tightened(
        self,
        failed: Sequence[tuple[str, str]] = (),
        peaks: Mapping[str, float] | None = None,
    ) -> Self:
        """Return a guard with lower limits, and given peaks for some joints."""
        joints = self.predicted.model.torque_joints
        most = np.array([(peaks or {}).get(joint, np.inf) for joint in joints])
        return replace(
            self, reach=self.reach - _TIGHTER, effort=np.minimum(self.effort, most)
        )


def _padded(samples: int) -> int:
    """Return the number of samples at which so many rows are computed."""
    few = next((count for count in _FEW if samples <= count), None)
    return -(-samples // _ROWS) * _ROWS if few is None else few


@dataclass(frozen=True, slots=True, eq=False)
class ClearanceGuard:
    """Bodies that must stay apart, in tenths of a metre.

    Parameters
    ----------
    spare : mapping of int to float, [m]
        Distance beyond the required one, and beyond the usual 2 mm, that a pair keeps
        at samples, by its index in the scene.
    """

    scene: Scene
    spare: Mapping[int, float] = field(default_factory=dict)

    @property
    def keeps_apart(self) -> bool:
        """It is about distances."""
        return True

    @property
    def pairs(self) -> int:
        """All of the scene."""
        return len(self.scene.pairs)

    @property
    def density(self) -> int:
        """Samples per period of the highest frequency at which it is to measure."""
        return _PAIR_DENSITY

    @property
    def near(self) -> float:
        """Five centimetres, in tenths of a metre."""
        return _NEAR_BODIES

    @property
    def seconds(self) -> float:
        """Work of all distances at one time."""
        return _QUERY * len(self.scene.pairs)

    def measure(self, motion: Array) -> Matrix:
        """Return the violation of each pair's required distance; far off, a bound."""
        least = self._least
        near = least + _CLOSE * (_NEAR_BODIES + _BEYOND_NEAR)
        found = distances_along(self.scene, motion[0], near)
        return np.asarray((least - np.asarray(found)) / _CLOSE)

    def kept(self, motion: Array) -> bool:
        """Return whether all bodies are as far apart as required."""
        least = self._least
        return distances_along(self.scene, motion[0], least, least=least) is not None

    def moved_by(self, joint: int) -> Self:
        """Return a guard of the pairs that a joint moves against each other."""
        kept = np.flatnonzero(moving_pairs(self.scene)[:, joint]).tolist()
        scene = replace(self.scene, pairs=tuple(self.scene.pairs[k] for k in kept))
        spare = {n: self.spare[k] for n, k in enumerate(kept) if k in self.spare}
        return replace(self, scene=scene, spare=spare)

    @property
    def _least(self) -> Vector:
        """Distances that pairs keep at samples, [m]."""
        kept = np.array([pair.wanted + _SPARE for pair in self.scene.pairs])
        for pair, more in self.spare.items():
            kept[pair] += more
        return kept

    def rows(self, motion: Array, items: IntArray) -> ItemRows:
        """Return the chosen pairs, or a smooth maximum over all, with derivatives."""
        chosen = _chosen(motion[0], items, len(self.scene.pairs))
        near = self._near(chosen.poses, chosen.sample, chosen.which)
        largest = _smooth_largest(near.value[chosen.query], chosen.starts)
        gradient = separation_slopes(
            near.places, self.scene.pairs, near.found, chosen.sample, chosen.which
        )
        pull = largest.share[:, None] * gradient[chosen.query]
        slopes = np.zeros((len(items), *np.delete(motion.shape, 1)))
        slopes[:, 0] = -np.add.reduceat(pull, chosen.starts, axis=0) / _CLOSE
        return ItemRows(largest.value, slopes)

    def _near(self, q: Matrix, sample: IntArray, which: IntArray) -> "_Near":
        scene = self.scene
        places = body_places(scene, link_places(scene.robot, q))
        found = separation(places, scene.pairs, sample, which, _CLOSE)
        value = (self._least[which] - found.distance) / _CLOSE
        return _Near(value, places, found)

    def item_name(self, item: int) -> str:
        """Name the two bodies."""
        first, second = self.scene.names(self.scene.pairs[item])
        return f"the distance of {first!r} and {second!r}"

    def initial_places(self, times: int) -> "set[WatchedPlace]":
        """Return none: rows come where a path is near to bodies."""
        return set()

    def tightened(
        self,
        failed: Sequence[tuple[str, str]] = (),
        peaks: Mapping[str, float] | None = None,
    ) -> Self:
        """Return a guard with larger distances for bodies that were too near."""
        spare = dict(self.spare)
        for place, pair in enumerate(self.scene.pairs):
            if not failed or self.scene.names(pair) in failed:
                spare[place] = spare.get(place, 0.0) + _FURTHER
        return replace(self, spare=spare)


class WatchedPlace(NamedTuple):
    """Position of a guard's row: a time of the grid, and an item."""

    time: int
    item: int


def near_places(measure: Matrix, near: float) -> set[WatchedPlace]:
    """Return the local maxima over time that are near their limits."""
    before = np.roll(measure, 1, axis=0)
    after = np.roll(measure, -1, axis=0)
    peaks = (measure >= before) & (measure >= after) & (measure > -near)
    return {WatchedPlace(int(t), int(i)) for t, i in np.argwhere(peaks)}


def guard_rows(
    guard: Guard,
    places: list[WatchedPlace],
    basis: FourierBasis,
    time: Vector,
    variables: Matrix,
) -> tuple[Vector, Matrix]:
    """Return the values of a guard's rows and their Jacobian in the variables.

    Parameters
    ----------
    time : ndarray, shape (samples,), [s]
        The grid of the places' times.
    variables : ndarray, shape (size, joints)
    """
    columns, motion, items = _at(places, basis, time, variables)
    values, slopes = guard.rows(motion, items)
    jacobian = np.zeros((len(places), *variables.shape))
    for order in range(3):
        if slopes[:, order].any():
            pull = slopes[:, order] * basis.unit
            jacobian[:, 1:] += columns[order, :, :, None] * pull[:, None]
    jacobian[:, 0] = slopes[:, 0] * basis.limits.derivative(0)
    return values, jacobian.reshape(len(places), -1)


def _at(
    places: list[WatchedPlace], basis: FourierBasis, time: Vector, variables: Matrix
) -> tuple[Array, Array, IntArray]:
    """Return the basis' columns, the motion and the items of some places."""
    known = _COLUMNS.get(basis)
    if known is None or known[0] is not time:
        table = np.array([basis.columns(order, time) for order in range(3)])
        _COLUMNS[basis] = known = (time, table)
    columns = known[1][:, [place.time for place in places]]
    motion = columns @ (variables[1:] * basis.unit)
    motion[0] += basis.offset(variables)
    return columns, motion, np.array([place.item for place in places])


# A grid, and the columns there, which a search needs repeatedly.
_COLUMNS: WeakKeyDictionary[FourierBasis, tuple[Vector, Array]] = WeakKeyDictionary()


class _Near(NamedTuple):
    """Violations of some pairs' required distances, and their planes."""

    value: Vector
    places: BodyPlaces
    found: Separation


class _ChosenPairs(NamedTuple):
    """Distinct poses and their pairs, each once; rows begin at starts.

    Attributes
    ----------
    poses : ndarray, shape (poses, joints)
    sample, which : ndarray, shape (queries,)
        Pose and pair of each query.
    query : ndarray, shape (entries,)
        The queries of all rows, one row after another.
    starts : ndarray, shape (rows,)
    """

    poses: Matrix
    sample: IntArray
    which: IntArray
    query: IntArray
    starts: IntArray


def _chosen(q: Matrix, items: IntArray, pairs: int) -> _ChosenPairs:
    poses, pose = np.unique(q, axis=0, return_inverse=True)
    counts = np.where(items == EVERY, pairs, 1)
    starts = np.cumsum(counts) - counts
    row = np.repeat(np.arange(len(items)), counts)
    pair = np.where(items[row] == EVERY, np.arange(len(row)) - starts[row], items[row])
    once, query = np.unique(pose.ravel()[row] * pairs + pair, return_inverse=True)
    return _ChosenPairs(poses, once // pairs, once % pairs, query, starts)


class _Largest(NamedTuple):
    """Smooth maxima, shape (rows,), and their slopes, shape (entries,)."""

    value: Vector
    share: Vector


def _smooth_largest(near: Vector, starts: IntArray) -> _Largest:
    """Return the smooth maximum of each row; for one entry, that entry."""
    counts = np.diff(starts, append=len(near))
    largest = np.maximum.reduceat(near, starts)
    share = np.exp(_SHARP * (near - np.repeat(largest, counts)))
    total = np.add.reduceat(share, starts)
    return _Largest(largest + np.log(total) / _SHARP, share / np.repeat(total, counts))
