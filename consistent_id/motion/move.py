"""A motion that a robot can play: from rest, through a trajectory, to rest."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, BoolArray, Vector, checked, freeze
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.motion.bernstein import PolynomialPath
from consistent_id.recordings.joint_paths import FourierTrajectory, sampled
from consistent_id.recordings.recording import Recording

_ORDERS = ("position", "velocity", "acceleration")
_SAME = 1e-9  # share of the duration by which two times may differ
_ROUNDING = 1e-9  # jump of any joint that is rounding
_JUMP = 1e-6  # share of its bound by which a derivative may jump


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """A run-in from rest, a trajectory, a run-out to rest; a joint path itself.

    Position, velocity and acceleration are continuous; the jerk and higher derivatives
    may jump between pieces, so their bounds are valid piece by piece.

    Parameters
    ----------
    run_in : tuple of PolynomialPath
        None, if the trajectory begins at rest in the required pose.
    trajectory : FourierTrajectory
        The part that excites.
    run_out : tuple of PolynomialPath

    Raises
    ------
    ProblemError
        If pieces do not follow each other, or the motion does not begin or end at rest.

    Examples
    --------
    >>> there_and_back = [[0.4], [-0.1]]  # 0.4 cos wt - 0.1 cos 2wt: rests at 0
    >>> swing = FourierTrajectory(
    ...     ("elbow",), [0.5, 1.0], [0.0], [[0.0], [0.0]], there_and_back, duration=2.0
    ... )
    >>> move = Move((), swing, ())
    >>> move.evaluate([0.0, 1.0], derivatives=0)[0, :, 0].round(9).tolist()
    [0.3, -0.5]
    >>> move.excites([0.0, 1.0, 2.0, 2.1]).tolist()
    [True, True, True, False]
    """

    run_in: tuple[PolynomialPath, ...]
    trajectory: FourierTrajectory
    run_out: tuple[PolynomialPath, ...]

    def __post_init__(self) -> None:
        freeze(self, run_in=tuple(self.run_in), run_out=tuple(self.run_out))
        for number, piece in enumerate(self.pieces, 1):
            if piece.joints != self.joints:
                raise ProblemError(
                    f"move: piece {number} moves joints {piece.joints}, the trajectory "
                    f"{self.joints}; expected the same, in the same order"
                )
        still = np.zeros_like(self._state(0, at_end=False))
        self._check(still, self._state(0, at_end=False), "start", orders=(1, 2))
        for number in range(len(self.pieces) - 1):
            self._check_junction(number)
        self._check(self._state(-1, at_end=True), still, "end", orders=(1, 2))

    def _state(self, number: int, *, at_end: bool) -> Array:
        piece = self.pieces[number]
        return piece.evaluate([end_of(piece) if at_end else piece.start])[:, 0]

    def _check_junction(self, number: int) -> None:
        before, after = self.pieces[number], self.pieces[number + 1]
        slack = _SAME * (abs(end_of(before)) + self.duration)
        if abs(after.start - end_of(before)) > slack:
            raise ProblemError(
                f"move: piece {number + 1} ends at {end_of(before):.9g} s, the next "
                f"begins at {after.start:.9g} s; expected the same time"
            )
        where = f"junction at {after.start:.6g} s"
        first = self._state(number, at_end=True)
        second = self._state(number + 1, at_end=False)
        self._check(first, second, where, orders=(0, 1, 2))

    def _check(
        self, before: Array, after: Array, where: str, orders: tuple[int, ...]
    ) -> None:
        for k in orders:
            allowed = _JUMP * self.derivative_bound(k) + _ROUNDING
            off = abs(after[k] - before[k])
            if (off > allowed).any():
                j = int(np.argmax(off / allowed))
                raise ProblemError(
                    f"move: {_ORDERS[k]} of joint {self.joints[j]!r} jumps from "
                    f"{before[k, j]:.6g} to {after[k, j]:.6g} at its {where}; expected "
                    "continuous motion from rest to rest. Call move_along"
                )

    @property
    def pieces(self) -> tuple[PolynomialPath | FourierTrajectory, ...]:
        """Run-in, trajectory and run-out, in the order of time."""
        return (*self.run_in, self.trajectory, *self.run_out)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.trajectory.joints

    @property
    def start(self) -> float:
        """Start time [s]."""
        return self.pieces[0].start

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return end_of(self.pieces[-1]) - self.start

    @property
    def window(self) -> tuple[float, float]:
        """Begin and end of the exciting part [s]; see `trimmed`."""
        return self.trajectory.start, end_of(self.trajectory)

    def excites(self, time: ArrayLike) -> BoolArray:
        """Return which samples belong to the exciting part, shape (samples,)."""
        t, (begin, end) = checked(time, (None,), "time"), self.window
        return np.asarray((t >= begin) & (t <= end))

    def evaluate(self, time: ArrayLike, derivatives: int = 2) -> Array:
        """Return position and derivatives, shape (derivatives + 1, samples, joints).

        At a junction, those of the later piece.  Before the start and after the end the
        robot rests.

        Parameters
        ----------
        time : array_like, shape (samples,), [s]
        derivatives : int
            Highest one.
        """
        given = checked(time, (None,), "time")
        t = np.clip(given, self.start, end_of(self.pieces[-1]))
        begins = np.array([piece.start for piece in self.pieces[1:]])
        numbers = np.searchsorted(begins, t, side="right")
        values = np.empty((derivatives + 1, len(t), len(self.joints)))
        for number, piece in enumerate(self.pieces):
            mine = numbers == number
            values[:, mine] = piece.evaluate(t[mine], derivatives)
        values[1:, t != given] = 0.0
        return values

    def derivative_bound(self, order: int) -> Vector:
        """Return a bound of each joint's derivative over all pieces."""
        bounds = [piece.derivative_bound(order) for piece in self.pieces]
        return np.asarray(np.max(bounds, axis=0))

    def recording(self, rate: float, name: str = "move") -> Recording:
        """Sample position, velocity and acceleration; see `paths.sampled`.

        Parameters
        ----------
        rate : float, [Hz]
        name : str
        """
        return sampled(self, rate, name)


def end_of(piece: PolynomialPath | FourierTrajectory) -> float:
    """Return the end time of a piece [s]."""
    return piece.start + piece.duration
