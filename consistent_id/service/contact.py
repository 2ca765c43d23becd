"""Is something touching the arm?  A detector with a short memory.

Torque from outside is never zero: gains, friction and bodies are a little wrong.
These errors change slowly; a touch does not.  So the detector compares the torque with
its own mean of 50 to 300 ms ago.  How far this difference moves without a contact
depends on the motion; that is learned from logs in which nothing touched the arm.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    BoolArray,
    IntArray,
    Matrix,
    Vector,
)
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.export.export_formats import Export
from consistent_id.recordings.recording import Recording, several
from consistent_id.service.contact_c import DetectorValues, detector_c
from consistent_id.service.residual_spread import (
    SLACK,
    ResidualSpread,
    compared,
    fitted_spread,
    free_part,
    least_of_row,
    signals_of,
    window_states,
)

MEMORY = (0.05, 0.3)  # s
OF_OBSERVER = 3
"""Samples in a row for torque of an observer: one wrong sample spoils two steps."""


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ContactState:
    """The detector's state after a sample.

    Attributes
    ----------
    time : float, [s]
    contact : bool
        Whether a contact begins, changes or ends: the distance is above 1.
    distance : float
        Distance of the torque from its mean, over the threshold; the least of the
        samples in a row that have to exceed it.
    change : ndarray, shape (joints,), [N m or N]
        The torque less its mean.
    begun : float, [s]
        Time of the first sample.
    times, rows : ndarray
        The memory: its times and signals.
    mean : ndarray
        Mean of the signals that the sample was compared with; NaN without one.
    recent : ndarray
        Distances of this sample and of those before it, as many as the row has.
    """

    time: float
    contact: bool
    distance: float
    change: Vector
    begun: float
    times: Vector
    rows: Matrix
    mean: Vector
    recent: Vector


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """The result of a detector for a log.

    Attributes
    ----------
    time : ndarray, shape (samples,), [s]
    contact : ndarray of bool, shape (samples,)
    distance : ndarray, shape (samples,)
        Over the threshold; the least of the samples in a row.
    change : ndarray, shape (samples, joints), [N m or N]
        The torque less its mean before.
    threshold : ndarray, shape (samples, joints), [N m or N]
        Change of one joint's torque alone that is found if it lasts as many samples.
    """

    time: Vector
    contact: BoolArray
    distance: Vector
    change: Matrix
    threshold: Matrix

    @property
    def starts(self) -> IntArray:
        """Samples at which contacts were found."""
        return np.flatnonzero(np.diff(self.contact.astype(int), prepend=0) > 0)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ContactDetector:
    """Detector of contacts by a short memory; made by `ContactDetector.fit`.

    ``d = r - mean(r, 50 to 300 ms ago)`` is divided by its standard deviation, which
    depends on the motion, and its Mahalanobis distance over all joints by the threshold
    of the stated rate of false alarms.

    Parameters
    ----------
    joints : tuple of str
    spread : ResidualSpread
        Standard deviations of the differences by the state of the motion.
    limit : float
        Distance at which a contact begins.
    false_alarms : float, [1/h]
        Stated rate.
    memory : tuple of float, [s]
        Ages of the newest and the oldest sample of the mean.
    hours : float
        Duration in hours of the logs that it was fitted to.
    in_a_row : int
        Samples that have to be beyond the threshold, one after the other.
    """

    joints: tuple[str, ...]
    spread: ResidualSpread
    limit: float
    false_alarms: float
    memory: tuple[float, float] = MEMORY
    hours: float = 0.0
    in_a_row: int = 1

    def __repr__(self) -> str:
        return (
            f"ContactDetector({len(self.joints)} joints, {self.false_alarms:g} false "
            f"alarms an hour, from {self.hours * 60:.1f} min)"
        )

    @classmethod
    def fit(
        cls,
        logs: Recording | Sequence[Recording],
        *,
        free: Sequence[ArrayLike] | None = None,
        false_alarms: float = 1.0,
        memory: tuple[float, float] = MEMORY,
        in_a_row: int | None = None,
    ) -> "ContactDetector":
        """Return the detector whose thresholds are learned from these logs.

        Values that a log repeats, because the robot was read faster than it answers,
        change nothing: means and alarms go by time.

        Parameters
        ----------
        logs : Recording or sequence of Recording
            Their `torque` is torque from outside (`MomentumObserver.along`), or, of an
            arm that holds its pose, measured torque.  Velocity, acceleration and the
            model's torque (`torque_command`) make the threshold depend on the motion;
            each is used if all logs have it.
        free : sequence of array_like of bool, shape (samples,), optional
            Samples of each log at which nothing touched the arm; by default all.
        false_alarms : float, [1/h]
            Rate to state.  If logs are shorter than an hour, it is extrapolated: the
            distances' largest values are taken to fall off exponentially.
        memory : tuple of float, [s]
        in_a_row : int, optional
            Samples that have to be beyond the threshold, one after the other: a robot
            that now and then repeats a sample, or sends a wrong one, is not touched.
            By default 3 for torque of an observer, in which a wrong sample spoils two
            steps, and 1 for measured torque.

        Raises
        ------
        ProblemError
            If logs have other joints or no torque, or too little of them is free.
        """
        logs = several(logs)
        if not logs:
            raise ProblemError("no log, expected one in which nothing touches the arm")
        newest, oldest = memory
        if not 0.0 <= newest < oldest:
            raise ProblemError(
                f"the memory is {memory} s, expected two ages such as 0.05, 0.3"
            )
        if not 0.0 < false_alarms < np.inf:
            raise ProblemError(
                f"{false_alarms} false alarms an hour, expected a number above 0"
            )
        if in_a_row is not None and not (
            isinstance(in_a_row, int | np.integer) and in_a_row >= 1
        ):
            raise ProblemError(
                f"in_a_row is {in_a_row}, expected a whole number of samples, 1 or more"
            )
        joints = logs[0].joints
        flags = [np.ones(len(log), dtype=bool) for log in logs]
        if free is not None:
            flags = [np.asarray(f, dtype=bool) for f in free]
        if [len(f) for f in flags] != [len(log) for log in logs]:
            raise ProblemError("expected free samples of each log, as many as it has")
        used = signals_of(logs[0])
        for log in logs:
            used = used.shared(signals_of(log.of(joints)))
        parts = [
            free_part(log.of(joints), flag, used, memory)
            for log, flag in zip(logs, flags, strict=True)
        ]
        row = in_a_row or (OF_OBSERVER if used.expected else 1)
        spread, limit, hours = fitted_spread(parts, false_alarms, used, oldest, row)
        return cls(joints, spread, limit, false_alarms, memory, hours, row)

    def c(self, *, name: str = "robot", rate: float = 1000.0) -> Export:
        """Return the detector as C without allocation: a source and a header.

        Parameters
        ----------
        name : str
            Prefix of the functions.  The source includes `name`.h, so save it as
            `name`.c.
        rate : float, [Hz]
            Most samples a second, for which the memory has room.

        Raises
        ------
        ProblemError
            If the rate is too low for the memory.
        """
        values = DetectorValues(
            self.joints,
            self.spread,
            self.limit,
            self.false_alarms,
            self.memory,
            self.hours,
            self.in_a_row,
        )
        return detector_c(values, name, rate)

    @property
    def covariance(self) -> Matrix:
        """Covariance of the change without a contact, at rest, shape (joints, joints).

        [(N m)^2]
        """
        return self.spread.covariance

    def start(self, time: float) -> ContactState:
        """Return the state before the first sample, which has the given time.

        Raises
        ------
        ProblemError
            If the time is not finite.
        """
        _require_time(time)
        n = len(self.joints)
        still = np.zeros(n)
        width = len(self.spread.signals.row(n, still, still, still, still))
        none = np.zeros(0)
        rows = np.zeros((0, width))
        mean = np.full(width, np.nan)
        recent = np.zeros(self.in_a_row)
        return ContactState(time, False, 0.0, still, time, none, rows, mean, recent)

    def step(
        self,
        state: ContactState,
        time: float,
        torque: ArrayLike,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        expected: ArrayLike | None = None,
    ) -> ContactState:
        """Return the state after another sample.

        Parameters
        ----------
        state : ContactState
        time : float, [s]
        torque, velocity, acceleration, expected : array_like, shape (joints,)
            As in the logs of `fit`: torque from outside, motion, the model's torque.

        Raises
        ------
        ProblemError
            If a channel is missing that `fit` had, or the time goes back or is not
            finite.
        """
        n = len(self.joints)
        row = self.spread.signals.row(n, torque, velocity, acceleration, expected)
        return self._next(state, time, row)

    def along(self, log: Recording) -> Contacts:
        """Return the contacts of a log, as `step` finds them sample by sample.

        Raises
        ------
        ProblemError
            If a channel is missing that `fit` had.
        RecordingError
            If a joint is missing.
        """
        require_type(log, Recording, "log")
        log = log.of(self.joints)
        part, known = compared(log, self.spread.signals, self.memory)
        n = len(self.joints)
        change = (part.rows - part.means)[:, :n] * known[:, None]
        each = np.where(known, self.spread.distances(part), 0.0) / self.limit
        distance = least_of_row(each, self.in_a_row)
        deviations = self.spread.deviations(part.rows, part.means, part.states)
        threshold = np.where(known[:, None], self._alone(deviations), np.inf)
        return Contacts(log.time, distance > 1.0, distance, change, threshold)

    def thresholds(self, state: ContactState) -> Vector:
        """Return the change of each joint's torque alone that is found in this state.

        It is found if it lasts `in_a_row` samples.

        Returns
        -------
        ndarray, shape (joints,), [N m or N]
            Infinite as long as there is no mean to compare with.
        """
        if np.isnan(state.mean).any() or not len(state.rows):
            return np.full(len(self.joints), np.inf)
        return self._alone(self._deviations(state.rows, state.mean))

    def _alone(self, deviations: Array) -> Array:
        return self.limit * deviations / np.sqrt(np.diag(self.spread.weights))

    def _deviations(self, rows: Matrix, mean: Vector) -> Vector:
        states = window_states(rows, len(self.joints))
        found: Vector = self.spread.deviations(rows[-1:], mean[None], states[None])[0]
        return found

    def _next(self, state: ContactState, time: float, row: Vector) -> ContactState:
        if state.rows.size and not time >= state.time:
            raise ProblemError(
                f"time goes from {state.time:g} to {time:g} s, expected a clock that "
                "does not go back; begin again with `start`"
            )
        _require_time(time)
        newest, oldest = self.memory
        keep = state.times >= time - oldest - SLACK
        times = np.append(state.times[keep], time)
        rows = np.vstack([state.rows[keep], row])
        before = times <= time - newest + SLACK
        n, full = len(self.joints), time >= state.begun + oldest
        if not (full and before.any()):
            change, distance, mean = np.zeros(n), 0.0, np.full_like(row, np.nan)
        else:
            mean = rows[before].mean(axis=0)
            change = row[:n] - mean[:n]
            scaled = change / self._deviations(rows, mean)
            square = float(scaled @ self.spread.weights @ scaled)
            distance = float(np.sqrt(square)) / self.limit
        recent = np.append(state.recent[1:], distance)
        least = float(recent.min())
        return ContactState(
            time, least > 1.0, least, change, state.begun, times, rows, mean, recent
        )


def _require_time(time: float) -> None:
    # After a start without a time, no memory would ever be full: no contact is found.
    if not np.isfinite(time):
        raise ProblemError(f"the time is {time}, expected seconds")
