"""Logs that rest, saturate, repeat themselves, or leave parameters open."""

from collections.abc import Sequence

import numpy as np

from consistent_id._arrays import Array
from consistent_id.base import BaseParameters
from consistent_id.diagnosis.findings import Finding
from consistent_id.recording import Recording
from consistent_id.regression import Regression
from consistent_id.study import excitation_of

_STILL = 0.02  # of a joint's largest velocity, below which it stands
_IDLE = 0.2  # share of samples with all joints at rest that is worth a warning
_PINNED = 5  # samples in a row at the largest torque that are a saturation
_SAME = 1e-3  # of a joint's range, within which two motions are the same
_SPAN = 50  # samples over which they are compared


def standstill_findings(recording: Recording) -> list[Finding]:
    """Warn of long rests of all joints together."""
    velocity = recording.velocity
    if velocity is None:
        velocity = np.gradient(recording.position, recording.time, axis=0)
    largest = abs(velocity).max(axis=0)
    still = (abs(velocity) <= _STILL * np.where(largest > 0.0, largest, 1.0)).all(
        axis=1
    )
    share = float(still.mean())
    if share < _IDLE:
        return []
    return [
        Finding(
            "standstill",
            "warning",
            recording.name,
            f"all joints stand still in {share:.0%} of {len(recording)} samples",
            "trim the rests; Coulomb friction at rest is anything between its bounds",
            share / _IDLE,
        )
    ]


def saturation_findings(recording: Recording) -> list[Finding]:
    """Find torques that stay at their largest value."""
    if recording.torque is None:
        return []
    found = []
    for joint, tau in zip(recording.joints, recording.torque.T, strict=True):
        for limit in (tau.max(), tau.min()):
            if limit == 0.0:
                continue
            run = _longest_run(tau == limit)
            if run >= _PINNED:
                found.append(
                    Finding(
                        "saturation",
                        "fault",
                        joint,
                        f"{joint}: torque stays at {limit:.4g} for {run} samples",
                        "leave these samples out, or move more gently: what the drive "
                        "could not give is missing from the torque",
                        run / _PINNED,
                    )
                )
                break
    return found


def leak_findings(
    training: Sequence[Recording], validation: Sequence[Recording]
) -> list[Finding]:
    """Find validation motion that was already in the training."""
    found = []
    for held in validation:
        for learnt in training:
            share = _shared(held.of(learnt.joints).position, learnt.position)
            if share > 0.0:
                found.append(
                    Finding(
                        "leak",
                        "fault",
                        held.name,
                        f"{share:.0%} of {held.name} repeat {learnt.name} to within "
                        f"{_SAME:.1%} of the joints' ranges",
                        "judge by a motion of its own; a repeated one only tells noise",
                        1.0 + share,
                    )
                )
    return found


def rank_findings(regression: Regression, base: BaseParameters) -> list[Finding]:
    """Name the combinations that the data leave open."""
    excitation = excitation_of(regression, base)
    missing = excitation.structural_rank - excitation.data_rank
    if missing == 0:
        return []
    return [
        Finding(
            "rank",
            "warning",
            "all joints",
            f"the data determine {excitation.data_rank} of "
            f"{excitation.structural_rank} base parameters; open: "
            + "; ".join(excitation.undetermined),
            "move the joints that these combinations name, and not all alike",
            1.0 + missing,
        )
    ]


def _longest_run(flags: Array) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return int(max(edges[1::2] - edges[::2], default=0))


def _shared(a: Array, b: Array) -> float:
    """Return the share of spans of `a` that occur in `b`."""
    if min(len(a), len(b)) < 2 * _SPAN:
        return 0.0
    tolerance = _SAME * np.maximum(np.ptp(b, axis=0), 1e-12)
    starts = range(0, len(a) - _SPAN, _SPAN)
    hits = 0
    for start in starts:
        first, last = a[start], a[start + _SPAN - 1]
        near = (abs(b[: len(b) - _SPAN + 1] - first) <= tolerance).all(axis=1)
        near &= (abs(b[_SPAN - 1 :] - last) <= tolerance).all(axis=1)
        span = a[start : start + _SPAN]
        moves = (np.ptp(span, axis=0) > 10 * tolerance).any()
        hits += moves and any(
            (abs(b[i : i + _SPAN] - span) <= tolerance).all()
            for i in np.flatnonzero(near)[:20]
        )
    return hits / max(len(starts), 1)
