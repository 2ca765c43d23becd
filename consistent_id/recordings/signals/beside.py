"""What was recorded beside the joints, filtered and resampled as the joints are."""

from collections.abc import Callable
from dataclasses import replace
from typing import TypedDict

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.recordings.base_motion import BaseMotion
from consistent_id.recordings.contacts import ContactFlags, Wrench
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.spline import cubic_spline

Filter = Callable[[Matrix], Matrix]


class Beside(TypedDict):
    """The fields of a recording that are not of joints."""

    base: BaseMotion | None
    wrenches: tuple[Wrench, ...]
    contacts: tuple[ContactFlags, ...]


def filtered_beside(
    recording: Recording, motion: Filter | None, torque: Filter | None
) -> Beside:
    """Return it filtered: the base as motion is, wrenches as torque is.

    Channels of the base are filtered in its own axes.  Neither its rotation, of which
    only the direction of forces is taken, nor contacts are.
    """
    base, wrenches = recording.base, recording.wrenches
    if base is not None and motion is not None:
        w, dw, felt = np.split(motion(base.stacked), 3, axis=1)
        base = BaseMotion(w, dw, felt, base.rotation)
    if torque is not None:
        wrenches = tuple(replace(w, values=torque(w.values)) for w in wrenches)
    return Beside(base=base, wrenches=wrenches, contacts=recording.contacts)


def resampled_beside(recording: Recording, clock: Vector) -> Beside:
    """Return it at other times; contacts are certain where both neighbours agree."""
    time, base = recording.time, recording.base
    if base is not None:
        w, dw, felt = np.split(cubic_spline(time, base.stacked, clock), 3, axis=1)
        rotation = base.rotation
        if rotation is not None:
            rotation = interpolated_rotations(time, rotation, clock)
        base = BaseMotion(w, dw, felt, rotation)
    wrenches = (
        replace(w, values=cubic_spline(time, w.values, clock))
        for w in recording.wrenches
    )
    before = np.maximum(np.searchsorted(time, clock, side="right") - 1, 0)
    after = np.minimum(before + 1, len(time) - 1)
    contacts = (
        replace(
            flags,
            closed=flags.closed[before],
            certain=flags.certain[before]
            & flags.certain[after]
            & (flags.closed[before] == flags.closed[after]),
        )
        for flags in recording.contacts
    )
    return Beside(base=base, wrenches=tuple(wrenches), contacts=tuple(contacts))


def interpolated_rotations(time: Vector, rotation: Array, clock: Vector) -> Array:
    """Return rotations at other times: those nearest to interpolated matrices."""
    matrices = cubic_spline(time, rotation.reshape(-1, 9), clock).reshape(-1, 3, 3)
    U, _, Vt = np.linalg.svd(matrices)
    return np.asarray(U @ Vt)
