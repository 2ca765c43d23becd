"""Synchronisation of an experiment's two logs, ready for a regression."""

from dataclasses import dataclass, replace

from consistent_id.laboratory.experiment import ExperimentLog
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.alignment import aligned
from consistent_id.recordings.signals.cuts import trimmed
from consistent_id.recordings.signals.delay import Delay, estimate_delay
from consistent_id.recordings.signals.differences import differentiated
from consistent_id.recordings.signals.filters import low_passed
from consistent_id.recordings.signals.track import track


@dataclass(frozen=True, slots=True, eq=False)
class SynchronisedLog:
    """Motion and torque on one clock, and the delay that was taken out.

    Parameters
    ----------
    recording : Recording
        Position, velocity, acceleration and torque, at the slower of the two rates.
    delay : Delay
        Of the cameras, as estimated.
    """

    recording: Recording
    delay: Delay


def synchronised(
    log: ExperimentLog, *, cutoff: float, trim: float = 0.0, longest: float = 0.5
) -> SynchronisedLog:
    """Synchronise encoders, load cell and cameras.

    The delay comes from the encoders' positions and the cameras' accelerations;
    velocities are differences of encoder positions; all channels pass the same filters,
    which leaves what is linear in them true.

    Parameters
    ----------
    cutoff : float, [Hz]
        Of a low-pass without phase, below the slower clock's Nyquist frequency.
    trim : float, [s]
        Cut off at either end, where filters see one side only.
    longest : float, [s]
        Longest delay that is looked for.
    """
    delay = estimate_delay(
        track(log.encoders, "position"),
        track(log.cameras, "acceleration"),
        longest=longest,
    )
    moving = replace(log.encoders, velocity=differentiated(log.encoders).velocity)
    seen = track(log.cameras, "acceleration")
    together = aligned(moving, seen, delay=delay.seconds)
    smooth = low_passed(together, motion_cutoff=cutoff, torque_cutoff=cutoff)
    start, stop = smooth.time[0] + trim, smooth.time[-1] - trim
    name = f"{log.wanted.name} (synchronised)"
    return SynchronisedLog(replace(trimmed(smooth, start, stop), name=name), delay)
