"""Distances of bodies as a guard: each pose and pair is looked at once.

A row is one pair at one time, or a smooth maximum over all pairs:

    log(sum over pairs of exp(s x)) / s,    x = tenths of a metre nearer than allowed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector
from consistent_id.excitation.guards import EVERY, ItemRows, Place
from consistent_id.motion.collisions.scene import BodyPlaces, Scene, body_places
from consistent_id.motion.collisions.separation import (
    Separation,
    separation,
    separation_slopes,
)
from consistent_id.robot.kinematics import link_places

_CLOSE = 0.1  # m; unit of distances, and beyond it they need not be known well
_SPARE = 0.002  # m; distance beyond what is wanted that is kept at samples
_FURTHER = 0.003  # m; distance added where a proof has failed
_DENSITY = 48  # bodies come nearer between samples, by little if these are many
_NEAR = 0.5  # tenths of a metre from what is allowed, within which there are rows
_QUERY = 5e-6  # s of work per pair and time
_SHARP = 20.0  # one over the distance, in tenths of a metre, at which a row is blunt


@dataclass(frozen=True, slots=True, eq=False)
class ClearanceGuard:
    """Bodies that must stay apart, in tenths of a metre.

    Parameters
    ----------
    spare : mapping of int to float, [m]
        Distance beyond what is wanted, and beyond the usual 2 mm, that a pair keeps at
        samples, by its place in the scene.
    """

    scene: Scene
    spare: Mapping[int, float] = field(default_factory=dict)

    @property
    def density(self) -> int:
        """Samples per period of the highest frequency at which it is to measure."""
        return _DENSITY

    @property
    def near(self) -> float:
        """Five centimetres, in tenths of a metre."""
        return _NEAR

    @property
    def seconds(self) -> float:
        """Work of all distances at one time."""
        return _QUERY * len(self.scene.pairs)

    def measure(self, motion: Array) -> Matrix:
        """Return how much nearer than allowed each pair of bodies is."""
        every = np.indices((motion.shape[1], len(self.scene.pairs)))
        sample, which = (index.ravel() for index in every)
        return self._near(motion[0], sample, which).value.reshape(every.shape[1:])

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
        found = separation(scene, places, scene.pairs, sample, which, _CLOSE)
        wanted = np.array([pair.wanted for pair in scene.pairs])[which]
        kept = np.full(len(scene.pairs), _SPARE)
        for pair, more in self.spare.items():
            kept[pair] += more
        value = (kept[which] - (found.distance - wanted)) / _CLOSE
        return _Near(value, places, found)

    def item_name(self, item: int) -> str:
        """Name the two bodies."""
        first, second = self.scene.names(self.scene.pairs[item])
        return f"the distance of {first!r} and {second!r}"

    def initial_places(self, times: int) -> "set[Place]":
        """Return none: rows come where a path is near to bodies."""
        return set()

    def tightened(
        self,
        failed: Sequence[tuple[str, str]] = (),
        peaks: Mapping[str, float] | None = None,
    ) -> Self:
        """Return a guard that keeps the bodies that were too near further apart."""
        spare = dict(self.spare)
        for place, pair in enumerate(self.scene.pairs):
            if not failed or self.scene.names(pair) in failed:
                spare[place] = spare.get(place, 0.0) + _FURTHER
        return replace(self, spare=spare)


class _Near(NamedTuple):
    """How much nearer than allowed some pairs are, and what shows it."""

    value: Vector
    places: BodyPlaces
    found: Separation


class _Chosen(NamedTuple):
    """Different poses and the pairs to look at there, each once; rows begin at starts.

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


def _chosen(q: Matrix, items: IntArray, pairs: int) -> _Chosen:
    poses, pose = np.unique(q, axis=0, return_inverse=True)
    counts = np.where(items == EVERY, pairs, 1)
    starts = np.cumsum(counts) - counts
    row = np.repeat(np.arange(len(items)), counts)
    pair = np.where(items[row] == EVERY, np.arange(len(row)) - starts[row], items[row])
    once, query = np.unique(pose.ravel()[row] * pairs + pair, return_inverse=True)
    return _Chosen(poses, once // pairs, once % pairs, query, starts)


class _Largest(NamedTuple):
    """Smooth maxima, shape (rows,), and their slopes, shape (entries,)."""

    value: Vector
    share: Vector


def _smooth_largest(near: Vector, starts: IntArray) -> _Largest:
    """Return the smooth maximum of each row; of one entry, that entry."""
    counts = np.diff(starts, append=len(near))
    largest = np.maximum.reduceat(near, starts)
    share = np.exp(_SHARP * (near - np.repeat(largest, counts)))
    total = np.add.reduceat(share, starts)
    return _Largest(largest + np.log(total) / _SHARP, share / np.repeat(total, counts))
