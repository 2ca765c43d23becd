"""An identification problem: robot, data, assumptions, as one value."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from consistent_id._support.given_values import require_type
from consistent_id._support.tables import Table, brief
from consistent_id.constraints import Constraint
from consistent_id.constraints.priors import Prior
from consistent_id.errors import ProblemError
from consistent_id.problems.file import (
    DataTable,
    MotionTable,
    ProblemTable,
    RecordingTable,
    TrackTable,
)
from consistent_id.problems.log_entries import (
    FoundDrives,
    columns_of,
    found_drives,
    gains_of_drives,
    motion_of_joints,
    span_of,
    with_torque,
)
from consistent_id.problems.paths import expanded, require_there
from consistent_id.recordings.joint_paths import Sinusoid, SinusoidalMotion
from consistent_id.recordings.recording import Recording
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import did_you_mean


def sampled_motion(table: MotionTable, joints: Sequence[str], name: str) -> Recording:
    """Return the recording of a motion, without torque."""
    terms = tuple(
        tuple(
            Sinusoid(*_ends(term.amplitude), term.frequency, np.radians(term.phase_deg))
            for term in of_joint
        )
        for of_joint in table.joints
    )
    motion = SinusoidalMotion(table.duration, table.rate, terms)
    return motion.recording(tuple(joints), name=name)


def _ends(amplitude: float | Sequence[float]) -> tuple[float, float]:
    if isinstance(amplitude, Sequence):
        return amplitude[0], amplitude[1]
    return amplitude, amplitude


if TYPE_CHECKING:
    from consistent_id.estimation.delayed_commands import CommandDelay
    from consistent_id.problems.preparation import Log
    from consistent_id.problems.robot_preparation import FoundInTraining
    from consistent_id.recordings.signals.drive_torque import DriveCalibration, PDGains
    from consistent_id.recordings.signals.tracks import Track


@brief
@dataclass(frozen=True)
class Problem:
    """A problem read from its folder; recordings are read when needed.

    Parameters
    ----------
    folder : Path
    table : ProblemTable
        The file's content.
    model : TorqueModel
    constraints : tuple of Constraint
    prior : PointToSet or Penalty
    source : Path, optional
        The file of the problem; None for a draft.
    arm : RobotModel, optional
        The arm that carries a wrench sensor, if the model is that of its tool.

    Examples
    --------
    >>> import consistent_id as ci
    >>> problem = ci.load_problem("problems/rx60")
    >>> problem.model.robot.joint_names
    ('joint1', 'joint2', 'joint3')
    >>> problem.constraints[0]
    PhysicalConsistency(margin=1e-06, share=0.0)
    """

    folder: Path
    table: ProblemTable
    model: TorqueModel
    constraints: tuple[Constraint, ...]
    prior: Prior
    source: Path | None = None
    arm: RobotModel | None = None

    def __repr__(self) -> str:
        robot = self.model.robot
        return (
            f"Problem({self.name!r}: robot {robot.name!r} with {len(robot)} joints, "
            f"{len(self.model.layout)} parameters, {self._recorded()})"
        )

    def _repr_html_(self) -> str:
        terms = {", ".join(t.names) or "none" for t in self.model.terms}
        rows = (
            ("robot", self.model.robot.name),
            ("joints", ", ".join(self.model.robot.joint_names)),
            ("drive terms", "; ".join(sorted(terms))),
            ("constraints", ", ".join(type(c).__name__ for c in self.constraints)),
            ("prior", repr(self.prior)),
            ("data", self._recorded()),
        )
        note = (self.table.description,) if self.table.description else ()
        return Table(f"Problem {self.name}", ("what", "which"), rows, note).html()

    def _recorded(self) -> str:
        if self.table.data is None:
            return "simulated data" if self.has_data else "no data"
        roles = [entry.role for entry in self.table.data.recordings]
        training, validation = roles.count("training"), roles.count("validation")
        return f"{training} training recordings, {validation} validation recordings"

    @property
    def name(self) -> str:
        """The problem's name."""
        return self.table.name

    @property
    def model_files(self) -> dict[str, Path | None]:
        """Files of the robot, by format: ``urdf``, ``mjcf``."""
        model = self.table.model
        return {
            form: None if name is None else self.file(name)
            for form, name in (("urdf", model.urdf), ("mjcf", model.mjcf))
        }

    @property
    def moving(self) -> RobotModel:
        """The moving robot: the arm, if the model is that of its tool."""
        return self.model.robot if self.arm is None else self.arm

    @property
    def recorded_joints(self) -> tuple[str, ...]:
        """Joints of the recordings: the robot's, or its carrying arm's."""
        return self.moving.joint_names

    def file(self, path: str) -> Path:
        """Return a path of the file, from its folder and with ``${NAME}`` replaced."""
        return self.folder / expanded(path, self.table)

    @cached_property
    def training(self) -> tuple[Recording, ...]:
        """Prepared training recordings."""
        return self._recordings("training")

    @cached_property
    def validation(self) -> tuple[Recording, ...]:
        """Prepared validation recordings."""
        return self._recordings("validation")

    def motion(self, name: str) -> Recording:
        """Return a motion of the file, sampled, without torque."""
        if name not in self.table.motions:
            near = did_you_mean(name, self.table.motions)
            raise ProblemError(f"problem {self.name!r}: no motion {name!r}; {near}")
        return sampled_motion(self.table.motions[name], self.recorded_joints, name)

    def logs(self, role: str) -> tuple[Recording, ...]:
        """Return recordings as they were logged, cut to their rows.

        Parameters
        ----------
        role : {"training", "validation"}
        """
        return tuple(log.cut(*span) for log, span in self._logged(role))

    @property
    def has_data(self) -> bool:
        """Whether there are training data, recorded or simulated."""
        table = self.table
        simulated = table.simulation is not None and table.published is not None
        return table.data is not None or simulated

    @property
    def missing(self) -> tuple[str, ...]:
        """Recordings of the file that are missing."""
        return tuple(f for f in self._log_files if not self._path(f).exists())

    @property
    def files(self) -> dict[str, Path]:
        """All files of the problem, by their names in it."""
        found = {} if self.source is None else {self.source.name: self.source}
        found |= {p.name: p for p in self.model_files.values() if p is not None}
        return found | {file: self._path(file) for file in self._log_files}

    @property
    def _log_files(self) -> tuple[str, ...]:
        data = self.table.data
        if data is None:
            return ()
        files = [entry.file for entry in data.recordings]
        return (*files, *(o.file for entry in data.recordings for o in entry.tracks))

    def read(self, file: str | Path, *, omit: Sequence[int] = ()) -> Recording:
        """Read a log as the problem's own recordings are read; each log once.

        Parameters
        ----------
        file : str or Path
            The log; relative paths start in the folder of the recordings.
        omit : sequence of int
            Broken rows to leave out, counted from 1.
        """
        from consistent_id.recordings.readers.recording_file import read_recording

        data, path = self._data(), self._path(file)
        if (path, *omit) not in self._read:
            raw = read_recording(
                self.log_file(file),
                self.recorded_joints,
                columns_of(data, path),
                torque_gain=data.torque_gain,
                topic=data.topic,
                omit=omit,
                duplicates=data.duplicates,
                missing=data.missing,
            )
            self._read[path, *omit] = self._of_joints(raw)
        return self._read[path, *omit]

    def keep(self, read: Mapping[str, Recording]) -> None:
        """Keep logs that have been read already, by their names in the file."""
        self._read.update({(self._path(name),): raw for name, raw in read.items()})

    @cached_property
    def drives(self) -> FoundDrives:
        """Gains and calibration of PD-controlled joints, as stated or found."""
        data = self.table.data
        equal = self.table.constraints.equal_motors
        return found_drives(data, self.model, self.constraints, self._calibrated, equal)

    @property
    def gains(self) -> "PDGains | None":
        """Gains of PD-controlled joints, as stated or found; None without them."""
        return self.drives.gains

    @property
    def command_delay(self) -> "CommandDelay | None":
        """The delay of commands, found in the training data; None if not required."""
        return self.drives.delay

    @property
    def delay_of_commands(self) -> float:
        """The delay of commands [s]: stated, or estimated from the data."""
        return self.drives.calibration.delay

    def prepare(self, recording: Recording) -> Recording:
        """Prepare a recording as the file states; the longest part if it has gaps."""
        from consistent_id.problems.preparation import Log

        data = self._data()
        return max(Log(recording, data.preparation, self._then()).prepared(), key=len)

    def _track(self, entry: TrackTable) -> "Track":
        from consistent_id.recordings.readers.recording_file import read_track

        found = read_track(
            self._path(entry.file),
            self.recorded_joints,
            entry.channel,
            entry.column,
            time=entry.time,
            torque_gain=self._data().torque_gain,
        )
        still = Recording(found.joints, found.time, np.zeros_like(found.values))
        channel: dict[str, Any] = {found.channel: found.values}
        moved = self._of_joints(replace(still, **channel))
        return replace(found, values=getattr(moved, found.channel))

    def _of_joints(self, raw: Recording) -> Recording:
        data = self._data()
        return motion_of_joints(
            raw,
            wraps=data.wraps,
            scale=data.position_scale,
            offset=data.position_offset,
            coupled=data.coupled,
        )

    def log_file(self, file: str | Path) -> Path:
        """Return the path of a log of the problem.

        Raises
        ------
        ProblemError
            If it is not there, and the problem file names a source.
        """
        return require_there(self._path(file), self.table)

    def _path(self, file: str | Path) -> Path:
        return self.folder / expanded(self._data().folder, self.table) / file

    def _data(self) -> DataTable:
        data = self.table.data
        if data is None:
            raise ProblemError(
                f"problem {self.name!r} has no recordings; add a [data] table"
            )
        return data

    def _recordings(self, role: str) -> tuple[Recording, ...]:
        return self.found_in_training.applied(self._parts(role))

    def _parts(self, role: str) -> list[Recording]:
        return [p for log, span in self._logged(role) for p in log.prepared(*span)]

    @cached_property
    def found_in_training(self) -> "FoundInTraining":
        """Values that the preparation estimates from the training data."""
        from consistent_id.problems.robot_preparation import FoundInTraining

        return FoundInTraining.of(self.table, self.model, self._parts, self.constraints)

    def _logged(self, role: str) -> Iterator[tuple["Log", tuple[float, float]]]:
        """Yield logs, and the times between which they are used."""
        for entry in self._data().recordings:
            if entry.role == role:
                read = self.read(entry.file, omit=entry.omit)
                yield self._shared_log(entry), span_of(read, entry)

    def _log(
        self,
        entry: RecordingTable,
        raw: Recording | None = None,
        calibration: "DriveCalibration | None" = None,
    ) -> "Log":
        """Return an entry's log, joined with its tracks; see `_raw`."""
        from consistent_id.problems.preparation import Log, joined

        raw = self._raw(entry) if raw is None else raw
        for other in entry.tracks:
            raw = joined(raw, self._track(other), other.delay)
        return Log(raw, self._data().preparation, self._then(calibration))

    def _then(
        self, calibration: "DriveCalibration | None" = None
    ) -> Callable[[Recording], Recording] | None:
        """Return the function that completes a prepared part and needs the robot."""
        from consistent_id.problems.robot_preparation import with_robot

        robot, soft = self.model.robot, None
        if self.table.data is not None and self.table.data.gains is not None:
            known = self.drives.calibration if calibration is None else calibration
            soft = known.of(len(robot)).compliance
        return with_robot(self.table, robot, self.arm, soft)

    def _shared_log(self, entry: RecordingTable) -> "Log":
        """Return an entry's log; entries of the same log share it."""
        key = (entry.file, *entry.omit, *entry.tracks)
        if key not in self._logs:
            self._logs[key] = self._log(entry)
        return self._logs[key]

    def _raw(
        self, entry: RecordingTable, calibration: "DriveCalibration | None" = None
    ) -> Recording:
        """Return an entry's log; with the problem's calibration or another."""
        raw = self.read(entry.file, omit=entry.omit)
        data = self.table.data
        stated = None if data is None else gains_of_drives(data)
        if stated is None:
            return raw
        known = self.drives.calibration if calibration is None else calibration
        return with_torque(raw, stated, known)

    def _calibrated(self, calibration: "DriveCalibration") -> list[Recording]:
        """Return the prepared training recordings of another calibration."""
        return [
            part
            for entry in self._data().recordings
            if entry.role == "training"
            for raw in [self._raw(entry, calibration)]
            for span in [span_of(raw, entry)]
            for part in self._log(entry, raw, calibration).prepared(*span)
        ]

    @cached_property
    def _read(self) -> dict[tuple[Path | int, ...], Recording]:
        return {}

    @cached_property
    def _logs(self) -> dict[tuple[object, ...], "Log"]:
        return {}


def require_problem(value: object, function: str) -> None:
    """Refuse what is not a problem, such as a draft or the path of a problem file.

    Raises
    ------
    ProblemError
        With the call that makes a problem of it.

    Examples
    --------
    >>> require_problem("problems/rx60", "run_study")
    Traceback (most recent call last):
    consistent_id.errors.ProblemError: run_study: a str, expected a Problem; ...
    """
    hint = ""
    if isinstance(known := getattr(value, "problem", None), Problem):
        hint = f"its problem is {known.name!r}, the attribute `problem`"
    elif callable(known):
        hint = "its method `problem()` returns one"
    require_type(value, Problem, function, hint)
