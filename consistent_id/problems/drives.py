"""What a problem file says of PD drives, and what its data say where it asks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.tables import Table
from consistent_id.constraints import Constraint
from consistent_id.estimation.command_delay import CommandDelay, command_delay
from consistent_id.estimation.drive_calibration import (
    UNKNOWNS,
    CalibrationFit,
    fit_calibration,
)
from consistent_id.estimation.joint_springs import JointSprings, joint_springs
from consistent_id.problems.file import DataTable, GainsTable
from consistent_id.problems.log_entries import gains_of_drives
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import DriveCalibration, PDGains
from consistent_id.regression.regressor import TorqueModel

Prepared = Callable[[DriveCalibration], Sequence[Recording]]


@dataclass(frozen=True, slots=True, eq=False)
class FoundDrives:
    """Gains and calibration of PD-controlled joints, as stated or found in the data.

    Parameters
    ----------
    gains : PDGains, optional
        What they really are: as stated, times the scale.
    delay : CommandDelay, optional
        The scan of the delay, if it is to be found.
    fit : CalibrationFit, optional
        If scales or biases are to be found, and the delay with them.
    springs : JointSprings, optional
        If springs between motors and links are to be found.
    """

    gains: PDGains | None = None
    calibration: DriveCalibration = DriveCalibration()  # noqa: RUF009  frozen
    delay: CommandDelay | None = None
    fit: CalibrationFit | None = None
    springs: JointSprings | None = None

    def tables(self) -> list[Table]:
        """Return what was found, for people; nothing if nothing was asked for."""
        found = (self.fit or self.delay, self.springs)
        return [one.table() for one in found if one is not None]


def found_drives(
    data: DataTable | None,
    model: TorqueModel,
    constraints: Sequence[Constraint],
    prepared: Prepared,
    groups: Sequence[Sequence[str]] = (),
) -> FoundDrives:
    """Return gains and calibration; what the file calls estimated, from the data.

    Parameters
    ----------
    prepared : callable
        From a calibration to the training recordings, prepared.
    groups : sequence of sequence of str
        Joints of equal motors.

    Raises
    ------
    ProblemError, RecordingError
        If the file or its recordings cannot be used.
    """
    gains = None if data is None else gains_of_drives(data)
    if data is None or data.gains is None or gains is None:
        return FoundDrives()
    asked = [name for name in UNKNOWNS if getattr(data.gains, name) == "estimated"]
    known, late, fit = _stated(data.gains), None, None
    if "delay" in asked:
        start = known
        late = command_delay(
            model,
            lambda delay: prepared(replace(start, delay=delay)),
            constraints=constraints,
        )
        known = replace(known, delay=late.seconds)
    if set(asked) - {"delay"}:
        fit = fit_calibration(
            model, prepared, asked, start=known, constraints=constraints
        )
        known = replace(fit.calibration, compliance=known.compliance)
    springs = None
    if data.gains.stiffness == "estimated":
        springs = joint_springs(
            model, prepared(known), groups=groups, constraints=constraints
        )
        known = replace(known, compliance=springs.compliance)
    return FoundDrives(known.gains(gains), known, late, fit, springs)


def _stated(table: GainsTable) -> DriveCalibration:
    """Return what is stated of drives and encoders; right ones where nothing is."""
    unstated = table.stiffness is None or table.stiffness == "estimated"
    return DriveCalibration(
        0.0 if table.delay == "estimated" else float(table.delay),
        np.array(1.0 if table.scale == "estimated" else table.scale),
        np.array(0.0 if table.encoder_bias == "estimated" else table.encoder_bias),
        1.0 / np.array(np.inf if unstated else table.stiffness),
    )
