"""What a model's bodies imply: gains of currents, and the joints that a log has.

No log contains the torque per ampere.  A model with masses implies it, although its
bodies are not quite the robot's.  With the regressor ``Y_j`` of a joint, its current
``i_j``, and friction and rotor ``F_j f_j`` in amperes,

    minimise  sum_j ||(g_j Y_j b + F_j f_j - i_j) / s_j||^2 + ||(b - b0) / w||^2

over the bodies ``b``, the inverse gains ``g_j = 1 / K_j`` and ``f_j``; ``s_j`` is the
residual of least squares with bodies free, times the root of the number of samples over
which it is correlated, and ``w`` are the usual errors of nominal bodies ``b0``
(`USUAL_WIDTHS`).  The links couple the joints, so the motion determines the ratios of
the gains, and the nominal bodies little more than their common scale.

A robot's file often has more joints than the log: a gripper, a rail, a second arm, a
torso.  Of all joints in a row with the log's number, those come first whose nominal
torque, with the other joints at rest, explains most of the log's (`LogRowsOfJoints`).
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.singular import lstsq, pinv
from consistent_id._support.tables import Table
from consistent_id.errors import ConsistentIdError, RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import (
    differentiated,
    low_passed,
    resampled,
    split_at_gaps,
)
from consistent_id.recordings.signals.clocks import own_rate
from consistent_id.regression.correlation_lengths import correlation_lengths
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import NORMAL
from consistent_id.robot.model import RobotModel
from consistent_id.robot.scaling import (
    USUAL_WIDTHS,
    LinkScales,
    body_sizes,
    link_scales,
    reference_bodies,
)

FORMAT = "consistent_id model gains 1"
"""Key ``format`` of the JSON record."""

_ASSUMED = ("masses", "centres_of_mass", "second_moments")
_CUTOFF = 3.0  # Hz; most of gravity is below, most noise of accelerations above
_KEPT = 5.0  # samples kept per period of the cut-off
_CREEP = 0.05  # rad/s, width of the sign change of friction
_GAP = 5.0  # sampling periods
_FAR, _ENOUGH = 2.0, 3  # gains this far from 1, on this many joints, are proposed
_LEAST = 1e-6  # N m per unit: less is in no unit of torque or current
_SURE = 0.2
"""Relative standard error above which a gain is poorly known; usual errors of nominal
bodies alone make 5 to 10 %."""
_ROUNDS = 50  # most rounds of Gauss and Newton
_SETTLED = 1e-4  # relative change of the gains that ends them
_LARGEST = 0.5  # relative change of a gain in one round, at most
_TRAVEL = 0.1  # rad or m, of some joint at least: in a resting arm, drift and touch
# explain the torque better than gravity
_EXACT = 1e-9  # residual over current below which nothing is noise
_MOST_ROWS = 12  # rows of joints that are compared
_ALIKE = 0.02  # share of the torque within which rows explain a log equally well

Row = tuple[str, ...]
"""Names of joints that follow one another from a link of the robot on."""


@dataclass(frozen=True, slots=True)
class NominalGains:
    """Gains that the model implies, one per joint; see `nominal_gains`.

    Parameters
    ----------
    joints : tuple of str
    values, errors : ndarray, shape (joints,)
        Torque per unit of the column, and standard errors.  The value of a poorly known
        gain is that of the nearest joint with a known one, and its error is infinite.
    known : tuple of bool
        Whether a gain has a standard error of at most 20 %.
    """

    joints: tuple[str, ...]
    values: Vector
    errors: Vector
    known: tuple[bool, ...]

    @property
    def far(self) -> bool:
        """Whether the known gains, of three joints at least, are all far from 1.

        Of units that no drive has, a wrong clock or position is the cause.
        """
        known = self.values[list(self.known)]
        if abs(known).min() < _LEAST:
            return False
        beyond = ((known > _FAR).all(), (known < 1.0 / _FAR).all())
        return len(known) >= _ENOUGH and any(beyond)

    @property
    def option(self) -> str:
        """The option that states these gains, filled in."""
        # Without exponents: a shell's option takes -1.2e+03 for another option.
        values = (
            np.format_float_positional(v, 3, fractional=False, trim="-")
            for v in self.values
        )
        return f"--torque-gain {' '.join(values)} --gain-source model"

    @property
    def sentence(self) -> str:
        """The assumption behind the gains, and their standard errors."""
        errors = ", ".join(
            f"{j} {100 * e / abs(v):.0f} %"
            for j, v, e, k in zip(
                self.joints, self.values, self.errors, self.known, strict=True
            )
            if k
        )
        poor = [j for j, k in zip(self.joints, self.known, strict=True) if not k]
        known = self.values[list(self.known)]
        sign = "; all are negative, so the columns are reversed" * bool(
            (known < 0.0).all()
        )
        rest = f"; {', '.join(poor)}: unknown, as the nearest joint's" if poor else ""
        mass, centre, moment = (f"{100 * width:g} %" for width in USUAL_WIDTHS)
        return (
            f"If the model's masses are right to {mass}, centres of mass to {centre} "
            f"and second moments to {moment} of the links' size, which this log cannot "
            f"show, it implies these gains (standard errors {errors}{rest}{sign})"
        )

    def table(self) -> Table:
        """Return gains with 95 % intervals, and the option that states them."""
        rows = [
            (joint, f"{value:.4g}", f"{NORMAL * error:.2g}")
            if known
            else (joint, "unknown", "-")
            for joint, value, error, known in zip(
                self.joints, self.values, self.errors, self.known, strict=True
            )
        ]
        notes = (self.sentence, self.option)
        title = "Gains that the model's bodies imply: an assumption"
        return Table(title, ("joint", "gain", "95 % +-"), tuple(rows), notes)

    def to_dict(self) -> dict[str, Any]:
        """Return gains with half of their 95 % intervals; None where unknown."""
        return {
            "format": FORMAT,
            "gains": {
                joint: {
                    "gain": value if known else None,
                    "half_interval": NORMAL * error if known else None,
                }
                for joint, value, error, known in zip(
                    self.joints,
                    self.values.tolist(),
                    self.errors.tolist(),
                    self.known,
                    strict=True,
                )
            },
            "assumed": dict(zip(_ASSUMED, USUAL_WIDTHS, strict=True)),
            "option": self.option,
        }


def nominal_gains(robot: RobotModel, *logs: Recording) -> NominalGains | None:
    """Return the gains with which the logs' torque is that of the nominal bodies.

    Parameters
    ----------
    robot : RobotModel
        With nominal masses.
    logs : Recording
        The logs as recorded, with gains of 1.

    Returns
    -------
    NominalGains or None
        None, if the model has no masses, no joint moves, or no gain is known.
    """
    each = [found for log in logs if (found := _fits(robot, log)) is not None]
    if not each:
        return None
    fits = [
        _GainRows(np.vstack([f.rows for f in one])) for one in zip(*each, strict=True)
    ]
    inverse, deviation = _with_bodies(fits, _nominal(robot))
    with np.errstate(divide="ignore"):
        values, errors = 1.0 / inverse, deviation / inverse**2
        known = np.isfinite(errors) & (deviation <= _SURE * abs(inverse))
    if not known.any():
        return None
    places = np.flatnonzero(known)
    nearest = [places[np.argmin(abs(places - j))] for j in range(len(values))]
    return NominalGains(
        robot.joint_names,
        values[nearest],
        np.where(known, errors, np.inf),
        tuple(bool(k) for k in known),
    )


def implied_gains(
    robot: RobotModel, logs: Sequence[Recording], source: str
) -> NominalGains:
    """Return the gains that the model's bodies imply for some logs.

    Parameters
    ----------
    logs : sequence of Recording
        The logs as recorded, with gains of 1.
    source : str
        The robot's file or the problem, for the message.

    Raises
    ------
    RecordingError
        If the bodies imply none.
    """
    found = nominal_gains(robot, *logs)
    if found is None:
        raise RecordingError(
            f"{source} implies no gains for {', '.join(log.name for log in logs)}: "
            "masses and torques or currents are needed, and joints that move against "
            "gravity; or weigh a known load: --loaded LOG --known-mass KG"
        )
    return found


def torque_shares(robot: RobotModel, log: Recording) -> Vector | None:
    """Return the share of each joint's torque that its nominal bodies explain.

    With a gain, friction and a rotor of its own.  None as in `nominal_gains`.
    """
    fits = _fits(robot, log)
    if fits is None:
        return None
    shares, bodies = [], _nominal(robot)
    for fit in fits:
        torque, current = fit.bodies @ bodies, fit.current
        whole = float(torque @ torque) * float(current @ current)
        shares.append(float(torque @ current) ** 2 / whole if whole > 0.0 else 0.0)
    return np.array(shares)


def _widths(robot: RobotModel) -> Vector:
    """Return usual errors of the model's bodies."""
    return LinkScales(link_scales(robot).mass, body_sizes(robot)).widths(USUAL_WIDTHS)


def _nominal(robot: RobotModel) -> Vector:
    """Return the model's bodies in units of their usual errors."""
    return reference_bodies(robot).ravel() / _widths(robot)


def _fits(robot: RobotModel, log: Recording) -> "list[_GainRows] | None":
    """Return the rows of each joint of smoothed motion, or None."""
    masses = [link.nominal.mass for link in robot.links if link.nominal is not None]
    if log.torque is None or len(masses) < len(robot.links) or not any(masses):
        return None
    if np.ptp(log.position, axis=0).max() < _TRAVEL:
        return None
    try:
        rate = own_rate(log)
        part = max(split_at_gaps(log, _GAP / rate), key=len)
        cutoff = min(_CUTOFF, 0.2 * rate)
        smooth = low_passed(resampled(part, rate), motion_cutoff=cutoff)
        motion = differentiated(low_passed(smooth, torque_cutoff=cutoff))
    except (ConsistentIdError, ValueError):
        return None
    every = max(int(rate / (_KEPT * cutoff)), 1)
    fits = _joint_fits(robot, motion, _widths(robot), every)
    return fits if all(np.isfinite(f.rows).all() for f in fits) else None


class _GainRows(NamedTuple):
    """A joint's rows without friction and rotor, compressed: bodies, then the current.

    Divided by the noise; bodies are in units of their usual errors.
    """

    rows: Matrix

    @property
    def bodies(self) -> Matrix:
        return self.rows[:, :-1]

    @property
    def current(self) -> Vector:
        return np.asarray(self.rows[:, -1])


def _joint_fits(
    robot: RobotModel, motion: Recording, widths: Vector, every: int
) -> list[_GainRows]:
    """Return the rows of each joint of every so many samples."""
    q, dq, ddq = (
        np.asarray(channel)[::every]
        for channel in (motion.position, motion.velocity, motion.acceleration)
    )
    measured = np.asarray(motion.torque)[::every]
    regressor = TorqueModel(robot).regressor(q, dq, ddq)
    fits = []
    for j, current in enumerate(measured.T):
        bodies = regressor[j].T * widths
        friction = np.column_stack(
            [dq[:, j], np.tanh(dq[:, j] / _CREEP), ddq[:, j], np.ones(len(dq))]
        )
        noise = _noise(np.column_stack([friction, bodies]), current)
        whole = np.column_stack([friction, bodies, current]) / noise
        compressed = np.asarray(np.linalg.qr(whole, mode="r"))
        first = friction.shape[1]
        fits.append(_GainRows(compressed[first:, first:]))
    return fits


def _noise(columns: Matrix, current: Vector) -> float:
    """Return the residual's deviation, of as many samples as are independent."""
    scale = np.linalg.norm(columns, axis=0)
    columns = columns / np.where(scale > 0.0, scale, 1.0)
    solution = lstsq(columns, current, 1e-9)
    residual = current - columns @ solution
    length = float(correlation_lengths([residual[:, None]])[0])
    least = _EXACT * float(np.linalg.norm(current)) or 1.0
    return float(max(np.sqrt(length / len(current)) * np.linalg.norm(residual), least))


def _with_bodies(fits: list[_GainRows], nominal: Vector) -> tuple[Vector, Vector]:
    """Return inverse gains and their standard errors, with bodies near the nominal.

    Parameters
    ----------
    nominal : ndarray, shape (10 links,)
        In units of the bodies' usual errors.
    """
    bodies, inverse = _start(fits, nominal)
    width, joints = len(nominal), len(fits)
    prior = np.hstack([np.eye(width), np.zeros((width, joints))])
    for _ in range(_ROUNDS):
        blocks, left = [prior], [nominal - bodies]
        for j, (fit, g) in enumerate(zip(fits, inverse, strict=True)):
            torque = fit.bodies @ bodies
            of_gains = np.zeros((len(torque), joints))
            of_gains[:, j] = torque
            blocks.append(np.hstack([g * fit.bodies, of_gains]))
            left.append(fit.current - g * torque)
        slopes = np.vstack(blocks)
        scale = np.linalg.norm(slopes, axis=0)
        scale[scale == 0.0] = 1.0
        scaled = lstsq(slopes / scale, np.concatenate(left), 1e-12)
        step = np.asarray(scaled) / scale
        most = _LARGEST * abs(inverse)
        change = np.clip(step[width:], -most, most)
        bodies, inverse = bodies + step[:width], inverse + change
        if (abs(change) <= _SETTLED * abs(inverse)).all():
            break
    triangle = np.asarray(np.linalg.qr(slopes / scale, mode="r"))[width:, width:]
    spread = pinv(triangle, rcond=1e-12)
    deviation = np.linalg.norm(spread, axis=1) / scale[width:]
    unseen = np.diag(triangle) == 0.0
    return inverse, np.where(unseen, np.inf, deviation)


def _start(fits: list[_GainRows], nominal: Vector) -> tuple[Vector, Vector]:
    """Return bodies and inverse gains of least squares on ``Y b - K i``, in N m.

    This is linear in both, so its minimum is the only one, of any sign; noise makes its
    gains too small.
    """
    width, joints = len(nominal), len(fits)
    blocks = [np.hstack([np.eye(width), np.zeros((width, joints))])]
    right = [nominal]
    for j, fit in enumerate(fits):
        torque, current = np.linalg.norm(fit.bodies @ nominal), fit.current
        usual = float(torque / np.linalg.norm(current)) if current.any() else 0.0
        of_gains = np.zeros((len(current), joints))
        of_gains[:, j] = -current
        blocks.append(np.hstack([fit.bodies, of_gains]) / (usual or 1.0))
        right.append(np.zeros(len(current)))
    whole = np.vstack(blocks)
    scale = np.linalg.norm(whole, axis=0)
    scale[scale == 0.0] = 1.0
    found = lstsq(whole / scale, np.concatenate(right), 1e-12)
    gains = found[width:] / scale[width:]
    inverse = 1.0 / np.where(gains == 0.0, np.inf, gains)
    return found[:width] / scale[:width], inverse


@contextmanager
def _without_notes() -> Iterator[None]:
    """Do not repeat notes on the robot's file for each robot that is tried."""
    logger = logging.getLogger("consistent_id")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def joint_rows(robot: RobotModel, number: int) -> tuple[Row, ...]:
    """Return the rows of so many joints, those that begin near the base first.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 1), DHRow(0, 1)])
    >>> joint_rows(arm, 2)
    (('joint1', 'joint2'), ('joint2', 'joint3'))
    """
    driven = set(robot.joint_names)
    paths = list[Row]()
    for joint in robot.joints:
        before = paths[joint.parent] if joint.parent >= 0 else ()
        paths.append((*before, joint.name) if joint.name in driven else before)
    ends = [path for path in dict.fromkeys(paths) if len(path) >= number > 0]
    found = [(len(path) - number, path[len(path) - number :]) for path in ends]
    return tuple(dict.fromkeys(row for _, row in sorted(found, key=lambda at: at[0])))


@dataclass(frozen=True)
class LogRowsOfJoints(Mapping[int, Sequence[Row]]):
    """By number of joints, the rows that may be a log's, the likeliest first.

    All others explain the log as well as the first.

    Parameters
    ----------
    robot : RobotModel
    read : callable
        From joints at rest to the robot without them and the log, as they are read.
    """

    robot: RobotModel
    read: Callable[[Sequence[str]], tuple[RobotModel, Recording]]
    _found: dict[int, tuple[Row, ...]] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.robot.joint_names) - 1

    def __iter__(self) -> Iterator[int]:
        return iter(range(1, len(self.robot.joint_names)))

    def __getitem__(self, number: int) -> tuple[Row, ...]:
        if number not in self._found:
            rows = joint_rows(self.robot, number)
            if not rows:
                raise KeyError(number)
            self._found[number] = rows[:1] if len(rows) == 1 else self._compared(rows)
        return self._found[number]

    def _compared(self, rows: Sequence[Row]) -> tuple[Row, ...]:
        shares = np.array([self._share(row) for row in rows[:_MOST_ROWS]])
        if not (shares > 0.0).any():
            return tuple(rows[:1])
        order = np.argsort(-shares, kind="stable")
        alike = shares[order] >= shares[order[0]] - _ALIKE
        return tuple(rows[k] for k in order[alike])

    def _share(self, row: Row) -> float:
        """Return the share of the torque that the nominal robot explains."""
        rest = [name for name in self.robot.joint_names if name not in row]
        try:
            with _without_notes():
                shares = torque_shares(*self.read(rest))
        except ConsistentIdError:
            return 0.0
        return 0.0 if shares is None else float(np.mean(shares))
