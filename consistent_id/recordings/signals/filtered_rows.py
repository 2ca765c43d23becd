"""One filter for both sides of ``Y x = tau``: torque, and the rows that predict it.

``F M Y x = F M tau`` holds exactly whatever the columns of ``Y`` are, as the filter
``F`` is linear.  Rows of filtered motion do not have this property: the friction of a
filtered speed is not the filtered friction.  So a recording keeps the samples from
before the filter (`TorqueFilter`), and the same filter is applied to its rows.

``F`` is the zero-phase Butterworth filter, as a symmetric kernel that ends where it has
fallen to a millionth.  The ends of a recording are reflected.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.recordings.beside import BaseMotion, ContactFlags
from consistent_id.recordings.recording import Recording, TorqueFilter
from consistent_id.recordings.signals.clocks import uniform_rate

DENSE = 5.0
"""Rows per period of the cut-off that are kept: more add no information."""

_FORGOTTEN = 1e-6  # of its peak, to which the kernel has fallen at its ends
_ROWS = 48  # kept rows that one matrix product makes
_SPECTRAL = 500  # reach over step, from which on a Fourier transform is faster
_SAME = 1e-9  # relative difference of torque that is rounding

_UNFILTERED = (
    "time",
    "position",
    "velocity",
    "acceleration",
    "torque_known",
    "base",
    "contacts",
)
_PerSample = Array | BaseMotion | tuple[ContactFlags, ...] | None


@dataclass(frozen=True, slots=True)
class RowFilter:
    """A zero-phase low-pass filter along rows of equal steps.

    Parameters
    ----------
    cutoff : float
        Over the sampling rate, below 0.5; the attenuation there is 6 dB.
    order : int
        Order of the one-way Butterworth filter.
    squared : bool
        Take the squares of the kernel, of sum one: they add the power of white noise.
    """

    cutoff: float
    order: int = 4
    squared: bool = False

    @property
    def _taps(self) -> Vector:
        h = _kernel(self.cutoff, self.order)
        return h**2 / np.sum(h**2) if self.squared else h

    @property
    def reach(self) -> int:
        """Samples on either side of a row that have a part in it."""
        return len(_kernel(self.cutoff, self.order)) // 2

    @property
    def step(self) -> int:
        """Step between kept rows: `DENSE` are kept in a period of the cut-off."""
        return max(int(1.0 / (DENSE * self.cutoff) * (1.0 + 1e-9)), 1)

    def spans(self, kept: IntArray, samples: int) -> Iterator[tuple[slice, slice]]:
        """Yield runs of kept rows, and the samples that have a part in them.

        Parameters
        ----------
        kept : ndarray of int, shape (rows,)
            Ascending.
        samples : int
            Number of samples of the whole recording.
        """
        reach = self.reach
        longest = max(8 * reach, 4096)
        start = 0
        while start < len(kept):
            stop = int(np.searchsorted(kept, kept[start] + longest))
            first, last = kept[start] - reach, kept[stop - 1] + reach + 1
            # What is reflected at an end has to be among them.
            low = 0 if first < 0 else first
            high = samples if last > samples else last
            if first < 0 or last > samples:
                low = max(min(low, samples - reach - 1), 0)
                high = min(max(high, reach + 1), samples)
            yield slice(start, stop), slice(int(low), int(high))
            start = stop

    def __call__(self, values: Array, kept: IntArray) -> Matrix:
        """Return filtered rows of a whole recording, shape (rows kept, columns).

        Parameters
        ----------
        values : ndarray, shape (samples, columns)
        kept : ndarray of int, shape (rows,)
            Ascending.
        """
        if len(kept) > 1 and self.reach * (len(kept) - 1) > _SPECTRAL * (
            kept[-1] - kept[0]
        ):
            return self._spectral(values)[kept]
        return self.of_spans(lambda span: values[span], kept, len(values))

    def of_spans(
        self, values: Callable[[slice], Matrix], kept: IntArray, samples: int
    ) -> Matrix:
        """Return filtered rows of values that are computed span by span."""
        parts = [
            self.part(values(span), kept[rows], span, samples)
            for rows, span in self.spans(kept, samples)
        ]
        return np.concatenate(parts) if parts else values(slice(0, 0))

    def part(self, values: Matrix, kept: IntArray, span: slice, samples: int) -> Matrix:
        """Return filtered rows of a span; see `spans`.

        Parameters
        ----------
        values : ndarray, shape (samples of the span, columns)
        kept : ndarray of int
            Rows wanted, by samples of the whole recording.
        span : slice
        samples : int
            Number of samples of the whole recording.
        """
        h, reach = self._taps, self.reach
        first, last = int(kept[0]) - reach, int(kept[-1]) + reach + 1
        if first >= span.start and last <= span.stop:
            padded = values[first - span.start : last - span.start]
        else:
            there = _reflected(np.arange(first, last), samples)
            padded = values[there - span.start]
        out = np.empty((len(kept), values.shape[1]))
        for start in range(0, len(kept), _ROWS):
            few = kept[start : start + _ROWS]
            offsets = few - few[0]
            low = int(few[0] - kept[0])
            H = _band(h.tobytes(), offsets.tobytes())
            out[start : start + len(few)] = H @ padded[low : low + H.shape[1]]
        return out

    def _spectral(self, values: Array) -> Matrix:
        """Return all rows, filtered by Fourier transforms."""
        h, reach, n = self._taps, self.reach, len(values)
        padded = values[_reflected(np.arange(-reach, n + reach), n)]
        size = 2 ** int(np.ceil(np.log2(n + 4 * reach)))
        spectrum = np.fft.rfft(padded, size, axis=0)
        spectrum *= np.fft.rfft(h, size)[:, None]
        return np.asarray(np.fft.irfft(spectrum, size, axis=0)[2 * reach :][:n])

    def shares(self, counted: Array, kept: IntArray) -> Matrix:
        """Return the share of each row's noise that stays where samples are left out.

        ``sum_k h_k^2 c_k / sum_k h_k^2``, of white noise.

        Parameters
        ----------
        counted : ndarray, shape (samples, columns)
            Share of each sample's noise that stays: 0 where it is left out.
        kept : ndarray of int, shape (rows,)
        """
        squared = replace(self, squared=True)
        return np.clip(squared(counted, kept), 0.0, 1.0)


@lru_cache(maxsize=16)
def _kernel(cutoff: float, order: int) -> Vector:
    """Return the symmetric kernel of sum one.

    The inverse transform of ``1 / (1 + (tan(pi f) / tan(pi f_c))^(2 order))``, the
    squared magnitude of the one-way filter by the bilinear transform.
    """
    d = 2.0 * np.sin(np.pi / (2 * order))
    w = np.tan(np.pi * cutoff)
    # As long as the slowest pole, of z^2 (1 + d w + w^2) + ... + (1 - d w + w^2), takes
    # to fade.
    squared = (1.0 - d * w + w**2) / (1.0 + d * w + w**2)
    reach = int(np.ceil(np.log(_FORGOTTEN) / (0.5 * np.log(squared)))) + 1
    size = 2 ** int(np.ceil(np.log2(8 * reach)))
    ratio = np.tan(np.pi * np.arange(size // 2) / size) / w
    gain = np.append(1.0 / (1.0 + ratio ** (2 * order)), 0.0)
    h = np.fft.irfft(gain, size)
    kernel = np.concatenate([h[-reach:], h[: reach + 1]])
    kernel /= kernel.sum()
    kernel.setflags(write=False)
    return kernel


@lru_cache(maxsize=16)
def _band(kernel: bytes, offsets: bytes) -> Matrix:
    """Return the matrix that makes rows at some offsets of the samples around them."""
    h, places = np.frombuffer(kernel), np.frombuffer(offsets, dtype=np.intp)
    H = np.zeros((len(places), int(places[-1]) + len(h)))
    H[np.arange(len(places))[:, None], places[:, None] + np.arange(len(h))] = h
    return H


def _reflected(places: IntArray, samples: int) -> IntArray:
    """Return places beyond either end mirrored into ``0 <= place < samples``."""
    inside = places % (2 * samples)
    mirrored = np.minimum(inside, 2 * samples - 1 - inside)
    return np.asarray(mirrored, dtype=np.intp)


def row_filter(recording: Recording) -> RowFilter:
    """Return the filter that a recording's torque went through."""
    behind = require_filter(recording)
    rate = uniform_rate(behind.source)
    return RowFilter(behind.cutoff / rate, behind.order)


def require_filter(recording: Recording) -> TorqueFilter:
    """Return a recording's filter.

    Raises
    ------
    RecordingError
        If its torque is not filtered.
    """
    if recording.torque_filter is None:
        raise RecordingError(f"{recording.name}: its torque is not filtered")
    return recording.torque_filter


def torque_filtered(recording: Recording, cutoff: float, order: int = 4) -> Recording:
    """Return a recording whose torque and wrenches are low-passed.

    It keeps the samples from before the filter.  A filtered recording is filtered anew
    from those, where the cut-off is lower than its own; else it is returned as it is.

    Parameters
    ----------
    recording : Recording
        Uniformly sampled.
    cutoff : float, [Hz]
    order : int
        Order of the one-way Butterworth filter.
    """
    behind = recording.torque_filter
    if behind is None:
        behind = TorqueFilter(cutoff, order, recording, np.arange(len(recording)))
    elif cutoff >= behind.cutoff:
        return recording
    else:
        require_unchanged(recording)
    return _through(recording, replace(behind, cutoff=cutoff, order=order))


def altered(
    recording: Recording, change: Callable[[Recording], Recording]
) -> Recording:
    """Return a recording changed before its torque is filtered.

    Parameters
    ----------
    recording : Recording
        If its torque is filtered, the change is made to all samples from before the
        filter; then torque is filtered, unless neither it nor the clock was changed,
        and samples are kept, as they were.
    change : callable
        Returns a recording with as many samples.

    Raises
    ------
    RecordingError
        If the recording was changed after its torque had been filtered: the change
        would be lost.

    Examples
    --------
    >>> time, ones = np.arange(200) * 0.01, np.ones((200, 1))
    >>> log = Recording(("elbow",), time, time[:, None], torque=ones)
    >>> smooth = torque_filtered(log, 5.0)
    >>> doubled = altered(smooth, lambda raw: replace(raw, torque=2.0 * raw.torque))
    >>> bool(np.allclose(doubled.torque, 2.0))
    True
    """
    behind = recording.torque_filter
    if behind is None:
        return change(recording)
    require_unchanged(recording)
    changed = change(behind.source)
    before = behind.source
    same = _same(changed.torque, before.torque) and _same(changed.time, before.time)
    torque = recording.torque if same else None
    return _through(recording, replace(behind, source=changed), torque)


def counting(recording: Recording, rows: BoolArray) -> Recording:
    """Return the samples that count; others are left out before the torque is filtered.

    Parameters
    ----------
    recording : Recording
    rows : ndarray of bool, shape (samples,)
        True for samples that count.
    """
    if rows.all():
        return recording
    return left_out(recording, ~rows).samples(np.flatnonzero(rows))


def places_of_rows(behind: TorqueFilter, step: int) -> IntArray:
    """Return the samples of a filtered recording whose rows are worth keeping.

    They are on a grid of the whole log's clock, so that windows of a log have the rows
    that the log has.  There may be none.

    Parameters
    ----------
    behind : TorqueFilter
    step : int
        See `RowFilter.step`.
    """
    own, clock = behind.step, behind.kept + behind.first
    every = own * max(step // own, 1)
    return np.flatnonzero(clock % every == clock[:1] % own)


def left_out(recording: Recording, mask: BoolArray) -> Recording:
    """Return a recording of which samples do not count, if its torque is filtered.

    The filter makes rows of zero of them.  A recording that is not filtered is returned
    as it is.

    Parameters
    ----------
    recording : Recording
    mask : ndarray of bool, shape (samples,)
        True for samples that do not count.
    """
    behind = recording.torque_filter
    if behind is None or not mask.any():
        return recording
    out = np.zeros(len(behind.source), dtype=np.bool_)
    if behind.left_out is not None:
        out |= behind.left_out
    out[around(behind, mask)] = True
    return replace(recording, torque_filter=replace(behind, left_out=out))


def around(behind: TorqueFilter, marked: BoolArray) -> IntArray:
    """Return the samples of the source that are nearest to marked ones."""
    kept, step = behind.kept, behind.step
    near = kept[marked][:, None] + np.arange(-((step - 1) // 2), step // 2 + 1)
    inside = (near >= kept[0]) & (near <= kept[-1])
    return np.asarray(near[inside], dtype=np.intp)


def _through(
    recording: Recording, behind: TorqueFilter, torque: Matrix | None = None
) -> Recording:
    """Return the kept samples of a source, its torque and wrenches filtered.

    Parameters
    ----------
    torque : ndarray, shape (samples, joints), optional
        The filtered torque, if it is known.
    """
    source, kept = behind.source, behind.kept
    uniform_rate(source)
    part = replace(source, torque_filter=behind, name=recording.name)
    if len(kept) < len(source):
        bare = replace(source, torque_filter=None, name=recording.name)
        part = replace(bare.samples(kept), torque_filter=behind)
    through = row_filter(part)
    channels = {}
    if source.torque is not None:
        known = torque is not None
        channels["torque"] = torque if known else through(source.torque, kept)
    if source.torque_shift is not None:
        channels["torque_shift"] = through(source.torque_shift, kept)
    wrenches = tuple(
        replace(own, values=through(whole.values, kept))
        for own, whole in zip(part.wrenches, source.wrenches, strict=True)
    )
    return replace(part, wrenches=wrenches, **channels)  # type: ignore[arg-type]


def require_unchanged(recording: Recording) -> None:
    """Refuse a filtered recording that is no longer what its source makes of it.

    Raises
    ------
    RecordingError
        With the channel that was changed after the filter.
    """
    behind = require_filter(recording)
    source, kept = behind.source, behind.kept
    if recording.joints != source.joints:
        _refuse(recording, "the order of joints")
    if len(kept) != len(recording):
        _refuse(recording, "the clock")
    for channel in _UNFILTERED:
        own, whole = getattr(recording, channel), getattr(source, channel)
        if not _same(own, _at(whole, kept)):
            _refuse(recording, channel)
    own_frames, frames = (
        tuple((wrench.frame, wrench.axes, wrench.point) for wrench in log.wrenches)
        for log in (recording, source)
    )
    if not _same(own_frames, frames):
        _refuse(recording, "wrenches")
    pairs = zip(recording.wrenches, source.wrenches, strict=True)
    for own, whole in pairs:
        if not _passed(behind, own.values, whole.values):
            _refuse(recording, f"the wrench at {own.frame}")
    tau, raw = recording.torque, source.torque
    if tau is None or raw is None:
        if tau is not raw:
            _refuse(recording, "torque")
    elif not _passed(behind, tau, raw):
        _refuse(recording, "torque")


def _passed(behind: TorqueFilter, filtered: Matrix, source: Matrix) -> bool:
    """Return whether values are what the filter makes of others.

    The filter ``F`` is symmetric, ends and all: ``w^T (F tau) = (F w)^T tau`` for any
    weights ``w``, so that one column passes it, and not those of all joints.
    """
    by = RowFilter(behind.cutoff / uniform_rate(behind.source), behind.order)
    w = np.random.default_rng(0).uniform(1.0, 2.0, len(filtered))
    spread = np.zeros((len(source), 1))
    spread[behind.kept, 0] = w
    through = by._spectral(spread)[:, 0]
    rest = w @ filtered - through @ source
    size = abs(filtered).max(axis=0) + abs(source).max(axis=0)
    return bool((abs(rest) <= _SAME * np.sqrt(len(source)) * size).all())


def _at(values: _PerSample, kept: IntArray) -> _PerSample:
    """Return the part that belongs to some samples."""
    if values is None or isinstance(values, np.ndarray):
        return None if values is None else values[kept]
    if isinstance(values, tuple):
        return tuple(flags.samples(kept) for flags in values)
    return values.samples(kept)


def _same(one: object, other: object) -> bool:
    """Return whether two values are equal, arrays and all."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return np.array_equal(one, other)  # type: ignore[arg-type]
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, BaseMotion | ContactFlags) and type(one) is type(other):
        own = (getattr(one, field.name) for field in fields(one))
        return all(map(_same, own, (getattr(other, f.name) for f in fields(one))))
    return one == other


def _refuse(recording: Recording, channel: str) -> None:
    raise RecordingError(
        f"{recording.name}: {channel} was changed after the torque had been low-passed "
        f"at {require_filter(recording).cutoff:g} Hz, so that the rows can no longer "
        "be filtered like the torque. Change it before the filter"
    )
