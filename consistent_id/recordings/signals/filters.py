"""Zero-phase filters, on motion and torque alike."""

from dataclasses import replace
from functools import partial

from consistent_id._support.arrays import Matrix
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.beside import filtered_beside
from consistent_id.recordings.signals.butterworth import zero_phase
from consistent_id.recordings.signals.clocks import uniform_rate

_FILTERED = ("position", "velocity", "acceleration", "torque")
DECIMATION_ORDER = 8  # of the filter against aliasing
_LOWEST = 1e-5  # cut-off over sampling rate


def low_passed(
    recording: Recording,
    *,
    motion_cutoff: float | None = None,
    torque_cutoff: float | None = None,
    order: int = 4,
) -> Recording:
    """Filter with a zero-phase Butterworth filter, run forwards and backwards.

    Parameters
    ----------
    recording : Recording
        Uniformly sampled.
    motion_cutoff, torque_cutoff : float, optional, [Hz]
        Cut-off of position, velocity and acceleration, also of a base, and of torque
        and wrenches; none to leave them as they are.
    order : int
        Of the one-way filter; the attenuation at the cut-off is 6 dB.

    Raises
    ------
    RecordingError
        If the clock is not uniform or a cut-off is not below half the sampling rate.
    """
    rate = uniform_rate(recording)
    if not isinstance(order, int) or order < 1:
        raise RecordingError(f"filter order is {order!r}, expected 1, 2, 3, ...")

    def smooth(values: Matrix, cutoff: float) -> Matrix:
        if not _LOWEST * rate <= cutoff < rate / 2:
            raise RecordingError(
                f"{recording.name}: cut-off {cutoff:g} Hz, expected between "
                f"{_LOWEST * rate:.2g} Hz (below, the filter loses its digits; "
                f"decimate first) and half of the sampling rate, {rate / 2:.6g} Hz"
            )
        pad = min(len(values) - 1, int(3 * order * rate / cutoff))
        return zero_phase(values, cutoff=cutoff, rate=rate, order=order, pad=pad)

    motion, torque = (
        None if cutoff is None else partial(smooth, cutoff=cutoff)
        for cutoff in (motion_cutoff, torque_cutoff)
    )
    filters = (motion, motion, motion, torque)
    channels = {
        channel: own(values)
        for channel, own in zip(_FILTERED, filters, strict=True)
        if own is not None and (values := getattr(recording, channel)) is not None
    }
    beside = filtered_beside(recording, motion, torque)
    return replace(recording, **channels, **beside)  # type: ignore[arg-type]


def decimated(recording: Recording, factor: int) -> Recording:
    """Keep every `factor`-th sample, after filtering all channels alike.

    The anti-aliasing filter is a zero-phase Butterworth of order 8 at 0.8 of the new
    Nyquist frequency, on motion and torque.
    """
    if not isinstance(factor, int) or factor < 1:
        raise RecordingError(f"decimation factor is {factor!r}, expected 1, 2, 3, ...")
    if factor == 1:
        return recording
    return anti_aliased(recording, factor).samples(slice(None, None, factor))


def anti_aliased(recording: Recording, factor: int) -> Recording:
    """Return what `decimated` takes its samples from."""
    cutoff = decimation_cutoff(uniform_rate(recording), factor)
    return low_passed(
        recording,
        motion_cutoff=cutoff,
        torque_cutoff=cutoff,
        order=DECIMATION_ORDER,
    )


def decimation_cutoff(rate: float, factor: int) -> float:
    """Return the cut-off [Hz] of the filter against aliasing."""
    return 0.8 * rate / (2 * factor)
