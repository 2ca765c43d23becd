"""Runs of a robot with a load beside those of its problem, and where the load is."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from consistent_id.errors import ProblemError, RecordingError
from consistent_id.problems.draft_rows import clock_of
from consistent_id.problems.file import PreparationTable, RecordingTable
from consistent_id.problems.problem import Problem
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import own_rate
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.kinematics import fixed_place
from consistent_id.robot.loaders.urdf_in_place import rotation_of
from consistent_id.robot.model import FixedFrame, RobotModel

Recordings = tuple[Recording, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Flange:
    """The frame that carries a load.

    Parameters
    ----------
    carrier : int
        Number of the moving link that it is fixed to.
    frame : FixedFrame
        Its place there.
    """

    carrier: int
    frame: FixedFrame


@dataclass(frozen=True, slots=True, eq=False)
class LoadedRuns:
    """Logs of a robot with a load, beside the recordings of its problem.

    Parameters
    ----------
    problem : Problem
    loaded : tuple of Path
    rows : sequence of int, optional
        The first and the last row of these logs that count, from 1.
    omit : tuple of int
        Broken rows of these logs, from 1.
    """

    problem: Problem
    loaded: tuple[Path, ...]
    rows: Sequence[int] | None
    omit: tuple[int, ...]

    @property
    def stated_gains(self) -> dict[str, float]:
        """The gains that the problem states, by joint; one where it states none."""
        joints, data = self.problem.recorded_joints, self.problem.table.data
        stated = 1.0 if data is None else data.torque_gain
        each = [stated] * len(joints) if isinstance(stated, float | int) else stated
        return dict(zip(joints, each, strict=True))

    @property
    def model(self) -> TorqueModel:
        """The problem's model, with offsets in place of asymmetric dry friction.

        In motion they are equal.  At rest dry friction has any value between its two
        levels: an offset is their middle, where `AsymmetricCoulomb` is zero, so that
        poses would show a load that is not there.  A model whose constraints name the
        two levels stays as it is, and so does one of terms that keywords cannot choose.
        """
        model = self.problem.model
        if not any(terms.asymmetric for terms in model.terms):
            return model
        try:
            changed = replace(
                model,
                drive=tuple(
                    DriveTerms(terms=terms.terms, asymmetric=False, offset=True)
                    if terms.asymmetric
                    else terms
                    for terms in model.terms
                ),
            )
            for constraint in self.problem.constraints:
                constraint.lower(changed)
        except ProblemError:
            return model
        return changed

    def read(self, factors: Mapping[str, float]) -> tuple[Recordings, Recordings]:
        """Return the prepared recordings with the load, and without it.

        Those without it are the problem's training and validation recordings: no model
        is judged here, and the more there is of the robot, the better is the load.

        Parameters
        ----------
        factors : mapping of str to float
            Factors of the gains of joints; others keep theirs.
        """
        problem, data = self.problem, self.problem.table.data
        if data is None:
            raise ProblemError(
                f"problem {problem.name!r} has no recordings of the robot without the "
                "load; add a [data] table, or give logs beside a robot's file"
            )
        added = [
            RecordingTable(
                file=str(file.resolve()),
                role="validation",
                rows=None if self.rows is None else list(self.rows),
                omit=list(self.omit),
            )
            for file in self.loaded
        ]
        gains = [g * factors.get(j, 1.0) for j, g in self.stated_gains.items()]
        # They are added to the validation recordings, so that they are prepared with
        # what was found in the training recordings.
        preparation = data.preparation
        raws = [self._cut(self._raw(one.file)) for one in added]
        _require_samples(raws, preparation)
        if raws:
            # Poses that were recorded one after another have gaps between them.
            clock = clock_of(raws, preparation.max_gap)
            resample = preparation.resample or clock.resample
            preparation = msgspec.structs.replace(
                preparation, max_gap=clock.max_gap, resample=resample
            )
        changed = msgspec.structs.replace(
            data,
            preparation=preparation,
            recordings=[*data.recordings, *added],
            torque_gain=gains if factors else data.torque_gain,
        )
        both = replace(
            problem, table=msgspec.structs.replace(problem.table, data=changed)
        )
        first = len(problem.validation)
        return both.validation[first:], (*both.training, *both.validation[:first])

    def _raw(self, file: str) -> Recording:
        """Return a log with the load as it was read."""
        try:
            return self.problem.read(file, omit=self.omit)
        except RecordingError as error:
            # `--omit` and `--rows` are about the logs without the load.
            said, options = map(_about_loaded, (str(error), error.options))
            raise RecordingError(
                said, options=options, replaces=error.replaces
            ) from error

    def _cut(self, raw: Recording) -> Recording:
        """Return the rows of a log that count."""
        if self.rows is None:
            return raw
        first, last = (
            row - sum(omitted < row for omitted in self.omit) for row in self.rows
        )
        span = slice(max(first - 1, 0), last)
        # Rows that are not there are refused where the logs are prepared.
        return raw.samples(span) if len(raw.time[span]) > 1 else raw


def _about_loaded(text: str) -> str:
    """Return advice on a log's rows as advice on those of the logs with the load.

    Examples
    --------
    >>> _about_loaded("leave it out: --omit 3 (omit = [3] of read_recording)")
    'leave it out: --loaded-omit 3 (omit = [3])'
    """
    text = re.sub(r"--(omit|rows)\b", r"--loaded-\1", text)
    return re.sub(
        r"(omit = \[[\d, ]+\]) of read_recording( and \[\[data\.recordings\]\])?",
        r"\1",
        text,
    )


def _require_samples(raws: Sequence[Recording], table: PreparationTable) -> None:
    """Refuse tables with a row for each pose, which no filter can take."""
    cutoffs = (table.motion_cutoff or 0.0, table.torque_cutoff or 0.0)
    for raw in raws:
        if (rate := own_rate(raw)) <= 2.0 * max(cutoffs):
            raise ProblemError(
                f"{raw.name} has {rate:.3g} samples a second, and logs without the "
                f"load are filtered at {max(cutoffs):g} Hz; expected more than twice "
                "that. A row for each pose is not enough: record each pose for a "
                "second or more"
            )


def require_arm(problem: Problem, known_mass: float | None) -> None:
    """Refuse problems whose payload is no body on a link of an arm, or on a sensor."""
    sensor = problem.table.wrist_sensor
    if sensor is not None and sensor.drift != "none":
        raise ProblemError(
            f"problem {problem.name!r}: the bias of the wrist sensor drifts (drift = "
            f"{sensor.drift!r}), so that logs with a load and without it cannot be "
            "compared; record both within minutes, and leave drift out"
        )
    if sensor is None and problem.model.robot.floating:
        raise ProblemError(
            f"the base of {problem.model.robot.name!r} floats; a payload is estimated "
            "on robots whose base stands still. Identify the robot with the load and "
            "without it, and compare the two estimates of the link that carries it"
        )
    if known_mass is not None and not (known_mass > 0.0 and np.isfinite(known_mass)):
        raise ProblemError(f"the known mass is {known_mass}, expected more than 0 kg")


def flange_of(problem: Problem, link: str | None) -> Flange:
    """Return the frame that carries the load.

    By default it is the problem's ``payload.link``, or the last link's of a chain.  On
    a wrist sensor it is the sensor's frame, and no other.
    """
    if (sensor := problem.table.wrist_sensor) is not None:
        if link not in (None, sensor.frame):
            raise ProblemError(
                f"link {link!r}: the wrist sensor measures a load in its own frame, "
                f"{sensor.frame!r}; give the place of another frame as the tool"
            )
        return Flange(0, FixedFrame(sensor.frame, np.eye(3), np.zeros(3)))
    robot, stated = problem.model.robot, problem.table.payload
    if link is None and stated is not None:
        link = stated.link
    if link is None:
        parents = {joint.parent for joint in robot.joints}
        tips = [k for k in range(len(robot.link_names)) if k not in parents]
        if len(tips) > 1:
            found = ", ".join(robot.link_names[k] for k in tips)
            raise ProblemError(
                f"the robot ends in {found}; name the link that carries the load "
                "(--link, link=)"
            )
        link = robot.link_names[tips[0]]
    place = fixed_place(robot, link)
    if place.link < 0:
        raise ProblemError(
            f"{link!r} does not move; name a link or frame that the load moves with: "
            f"{', '.join(robot.link_names)}"
        )
    return Flange(place.link, FixedFrame(link, place.rotation, place.translation))


def tool_of(
    robot: RobotModel, flange: Flange, tool: str | Sequence[float] | None
) -> FixedFrame:
    """Return the place of the tool's frame in the carrier."""
    if tool is None:
        return flange.frame
    if isinstance(tool, str):
        place = fixed_place(robot, tool)
        if place.link != flange.carrier:
            raise ProblemError(
                f"the tool's frame {tool!r} is not fixed to "
                f"{robot.link_names[flange.carrier]!r}, which carries the load; name a "
                "frame that is, or its place: x,y,z or x,y,z,roll,pitch,yaw"
            )
        return FixedFrame(tool, place.rotation, place.translation)
    numbers = np.asarray(tool, dtype=np.float64)
    if numbers.shape not in ((3,), (6,)) or not np.isfinite(numbers).all():
        raise ProblemError(
            f"the tool's place is {list(tool)}; expected x, y, z [m], or these and "
            "roll, pitch, yaw [rad]"
        )
    rotation = rotation_of(numbers[3:].tolist()) if len(numbers) == 6 else np.eye(3)
    frame = flange.frame
    return FixedFrame(
        "tool",
        frame.rotation @ rotation,
        frame.rotation @ numbers[:3] + frame.translation,
    )


def loaded_files(
    loaded: str | Path | Sequence[str | Path], rows: Sequence[int] | None
) -> tuple[Path, ...]:
    """Return the logs with the load.

    Raises
    ------
    ProblemError
        If there is none, one is not there, or there are not two rows.
    """
    files = [loaded] if isinstance(loaded, str | Path) else loaded
    if not isinstance(files, list | tuple) or not all(
        isinstance(file, str | Path) for file in files
    ):
        raise ProblemError(
            f"logs with the load: a {type(loaded).__name__}, expected the path of a "
            "file, or a list of them; a data frame or an array is written first, as by "
            "to_csv"
        )
    if not files:
        raise ProblemError("no log with the load, expected at least one")
    for file in files:
        if not Path(file).is_file():
            raise ProblemError(f"{file}: no such file, expected a log with the load")
    if rows is not None and len(rows) != 2:
        raise ProblemError(
            f"rows with the load: {list(rows)}, expected the first and the last"
        )
    return tuple(map(Path, files))
