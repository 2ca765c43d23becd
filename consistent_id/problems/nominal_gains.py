"""Gains between currents and torque, if the model's own bodies are right.

No log contains the torque per ampere.  A model with masses implies it: along the logged
motion, ``current = tau / K + rotor + friction``, with the torque ``tau`` of the nominal
bodies, and terms of acceleration and speed.
"""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import ConsistentIdError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import (
    differentiated,
    low_passed,
    resampled,
    split_at_gaps,
)
from consistent_id.recordings.signals.clocks import own_rate
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import RobotModel
from consistent_id.robot.scaling import reference_bodies

_CUTOFF = 3.0  # Hz; most of gravity is below, most noise of accelerations above
_CREEP = 0.05  # rad/s, width of the sign change of friction
_GAP = 5.0  # sampling periods
_BLOCKS = 8  # blocks that are left out in turn, for standard errors
_FAR, _ENOUGH = (
    2.0,
    3,
)  # gains are proposed if they differ from 1 by this factor, on this many joints
_SURE = 0.1  # relative standard error above which a gain is poorly known


@dataclass(frozen=True, slots=True)
class NominalGains:
    """Gains that the model implies, one per joint; see `nominal_gains`.

    Parameters
    ----------
    joints : tuple of str
    values, errors : ndarray, shape (joints,)
        Torque per unit of the column, and standard errors.  The value of a poorly known
        gain is the median size of the others.
    known : tuple of bool
        Whether a gain has a standard error of at most 10 %.
    """

    joints: tuple[str, ...]
    values: Vector
    errors: Vector
    known: tuple[bool, ...]

    @property
    def far(self) -> bool:
        """Whether the known gains, of three joints at least, are all far from 1."""
        known = self.values[list(self.known)]
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
        rest = f"; {', '.join(poor)}: unknown, the median of the others" if poor else ""
        return (
            "If the bodies of the model are right, which this log cannot show, it "
            f"implies these gains (standard errors {errors}{rest})"
        )


def nominal_gains(robot: RobotModel, log: Recording) -> NominalGains | None:
    """Return the gains with which a log's torque is that of the nominal bodies.

    Parameters
    ----------
    robot : RobotModel
        With nominal masses.
    log : Recording
        The log as recorded, with gains of 1.

    Returns
    -------
    NominalGains or None
        None, if the model has no masses, or no gain is known.
    """
    if log.torque is None or any(link.nominal is None for link in robot.links):
        return None
    try:
        rate = own_rate(log)
        part = max(split_at_gaps(log, _GAP / rate), key=len)
        cutoff = min(_CUTOFF, 0.2 * rate)
        smooth = low_passed(resampled(part, rate), motion_cutoff=cutoff)
        motion = differentiated(low_passed(smooth, torque_cutoff=cutoff))
    except (ConsistentIdError, ValueError):
        return None
    q, dq, ddq = motion.position, motion.velocity, motion.acceleration
    bodies = reference_bodies(robot).ravel()
    torque = TorqueModel(robot).rigid_torque(bodies, (q, dq, ddq))
    measured = np.asarray(motion.torque)
    pairs = [
        _gain(torque[:, j], np.asarray(dq)[:, j], np.asarray(ddq)[:, j], tau)
        for j, tau in enumerate(measured.T)
    ]
    values, errors = np.array(pairs).T
    known = np.isfinite(errors) & (errors <= _SURE * abs(values))
    if not known.any():
        return None
    usual = float(np.median(values[known]))
    return NominalGains(
        robot.joint_names,
        np.where(known, values, usual),
        errors,
        tuple(bool(k) for k in known),
    )


def _gain(
    torque: Vector, speed: Vector, acceleration: Vector, measured: Vector
) -> tuple[float, float]:
    """Return a joint's gain, and its standard error from leaving out blocks."""
    rotor, offset = acceleration, np.ones_like(speed)
    friction = np.column_stack([speed, np.tanh(speed / _CREEP)])
    columns = np.column_stack([torque, friction, rotor, offset])
    blocks = np.arange(len(torque)) * _BLOCKS // len(torque)
    whole = _slope(columns, measured)
    parts = [
        _slope(columns[blocks != k], measured[blocks != k]) for k in range(_BLOCKS)
    ]
    spread = np.sqrt((_BLOCKS - 1) / _BLOCKS * np.sum((np.array(parts) - whole) ** 2))
    if whole == 0.0 or not np.isfinite(whole):
        return 1.0, np.inf
    return 1.0 / whole, float(spread) / whole**2


def _slope(columns: Matrix, measured: Vector) -> float:
    scale = np.linalg.norm(columns, axis=0)
    if not scale.all():
        return 0.0
    solution, *_ = np.linalg.lstsq(columns / scale, measured, rcond=1e-8)
    return float(solution[0] / scale[0])
