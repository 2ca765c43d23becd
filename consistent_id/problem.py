"""An identification problem: robot, data, assumptions, as one value."""

import os
import string
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import msgspec
import numpy as np

from consistent_id.chains import Selection, selected
from consistent_id.constraints import Constraint, lowered
from consistent_id.errors import ProblemError
from consistent_id.friction import DriveTerms, GearCoupling
from consistent_id.loaders import (
    DHRow,
    from_classical_dh,
    from_modified_dh,
    load_mjcf,
    load_urdf,
)
from consistent_id.model import STANDARD_GRAVITY, Datasheet, JointLimits, RobotModel
from consistent_id.parameters import did_you_mean
from consistent_id.preparation import check_preparation, prepared
from consistent_id.priors import Penalty, PointToSet, Prior
from consistent_id.problem_constraints import constraints_of
from consistent_id.problem_file import (
    ColumnsTable,
    CouplingTable,
    DataTable,
    DHTable,
    DriveTable,
    LinkTable,
    PriorTable,
    ProblemTable,
    RecordingTable,
    read_problem_table,
)
from consistent_id.readers import Columns, read_recording
from consistent_id.recording import Recording
from consistent_id.regressor import TorqueModel
from consistent_id.signals import trimmed
from consistent_id.sinusoids import Sinusoid, SinusoidalMotion


@dataclass(frozen=True)
class Problem:
    """A problem read from its folder; recordings are read when asked for.

    Parameters
    ----------
    folder : Path
    table : ProblemTable
        The file's content.
    model : TorqueModel
    constraints : tuple of Constraint
    prior : PointToSet or Penalty
    """

    folder: Path
    table: ProblemTable
    model: TorqueModel
    constraints: tuple[Constraint, ...]
    prior: Prior

    @property
    def name(self) -> str:
        """The problem's name."""
        return self.table.name

    def file(self, path: str) -> Path:
        """Return a path of the file: from its folder, with ``${NAME}`` replaced."""
        return self.folder / _expanded(path, self.name)

    @cached_property
    def training(self) -> tuple[Recording, ...]:
        """Prepared recordings to learn from."""
        return self._recordings("training")

    @cached_property
    def validation(self) -> tuple[Recording, ...]:
        """Prepared recordings to judge by."""
        return self._recordings("validation")

    def motion(self, name: str) -> Recording:
        """Return a motion of the file, sampled, without torque."""
        if name not in self.table.motions:
            near = did_you_mean(name, self.table.motions)
            raise ProblemError(f"problem {self.name!r}: no motion {name!r}; {near}")
        table = self.table.motions[name]
        joints = tuple(
            tuple(
                Sinusoid(
                    *_ends(term.amplitude), term.frequency, np.radians(term.phase_deg)
                )
                for term in terms
            )
            for terms in table.joints
        )
        motion = SinusoidalMotion(table.duration, table.rate, joints)
        return motion.recording(self.model.robot.joint_names, name=name)

    def logs(self, role: str) -> tuple[Recording, ...]:
        """Return recordings as they were logged, cut to their rows.

        Parameters
        ----------
        role : {"training", "validation"}
        """
        return tuple(
            trimmed(raw, *span) if np.isfinite(span[0]) else raw
            for raw, span in self._logged(role)
        )

    def prepare(self, recording: Recording) -> Recording:
        """Prepare a recording as the file asks; the longest part if it has gaps."""
        data = self._data()
        parts = prepared(recording, data.preparation, -np.inf, np.inf)
        return max(parts, key=len)

    def _data(self) -> DataTable:
        data = self.table.data
        if data is None:
            raise ProblemError(
                f"problem {self.name!r} has no recordings; add a [data] table"
            )
        return data

    def _recordings(self, role: str) -> tuple[Recording, ...]:
        return tuple(
            part
            for raw, (start, stop) in self._logged(role)
            for part in prepared(raw, self._data().preparation, start, stop)
        )

    def _logged(self, role: str) -> Iterator[tuple[Recording, tuple[float, float]]]:
        """Yield recordings as logged, and the times between which they count."""
        data = self._data()
        folder = self.folder / _expanded(data.folder, self.name)
        for entry in data.recordings:
            if entry.role == role:
                raw = _read(folder, entry, data, self.model.robot)
                yield raw, _span(raw, entry)


def load_problem(path: str | Path) -> Problem:
    """Load a problem from its folder, or from the file itself.

    Raises
    ------
    ProblemError
        If the file does not fit; with the path of the faulty key.
    ModelError
        If the robot cannot be built.
    """
    path = Path(path)
    file = path / "problem.toml" if path.is_dir() else path
    table = read_problem_table(file)
    robot = _robot(table, file.parent)
    robot = robot.with_datasheet(
        {name: _datasheet(robot, name, link) for name, link in table.links.items()}
    )
    for name in table.joints:
        if name not in robot.joint_names:
            near = did_you_mean(name, robot.joint_names)
            raise ProblemError(f"{file}: [joints.{name}]: no such joint; {near}")
    drive = tuple(
        _drive(table.joints.get(name, table.drive)) for name in robot.joint_names
    )
    couplings = tuple(_coupling(coupling) for coupling in table.couplings)
    measured = () if table.data is None else tuple(table.data.torque_joints)
    model = TorqueModel(robot, drive, couplings, measured)
    if table.data is not None:
        columns = table.data.columns or ColumnsTable()
        check_preparation(table.data.preparation, columns)
    constraints = constraints_of(table.constraints, file.parent, table.joints)
    lowered(constraints, model)  # a name that is wrong is found here, not after hours
    return Problem(
        folder=file.parent,
        table=table,
        model=model,
        constraints=constraints,
        prior=_prior(table.prior, file),
    )


def _prior(table: PriorTable, file: Path) -> Prior:
    if table.weight is None:
        return PointToSet(table.slack, table.distance)
    if table.slack is not None:
        raise ProblemError(
            f"{file}: [prior] has both slack = {table.slack} and weight = "
            f"{table.weight}; give a slack or a weight, not both"
        )
    return Penalty(table.weight, table.distance)


def _robot(table: ProblemTable, folder: Path) -> RobotModel:
    model = table.model
    forms = ("urdf", "mjcf", "modified_dh", "classical_dh")
    given = [form for form in forms if getattr(model, form)]
    if len(given) != 1:
        seen = f"has {' and '.join(given)}" if given else "has none"
        raise ProblemError(
            f"problem {table.name!r}: [model] needs one of {', '.join(forms)}, {seen}"
        )
    selection = Selection(model.base, model.tip, model.joints, model.locked)
    gravity = STANDARD_GRAVITY if model.gravity is None else model.gravity
    if model.urdf is not None:
        file = folder / _expanded(model.urdf, table.name)
        return load_urdf(file, gravity=gravity, **asdict(selection))
    if model.mjcf is not None:
        file = folder / _expanded(model.mjcf, table.name)
        return load_mjcf(file, gravity=model.gravity, **asdict(selection))
    rows = [_dh_row(row) for row in model.modified_dh or model.classical_dh]
    build = from_modified_dh if model.modified_dh else from_classical_dh
    return selected(build(table.name, rows, gravity=gravity), selection)


def _dh_row(row: DHTable) -> DHRow:
    limits = JointLimits(
        -np.inf if row.lower is None else row.lower,
        np.inf if row.upper is None else row.upper,
        row.velocity or np.inf,
        row.effort or np.inf,
    )
    alpha, theta = np.radians(row.alpha_deg), np.radians(row.theta_deg)
    return DHRow(float(alpha), row.a, row.d, float(theta), row.kind, limits)


def _datasheet(robot: RobotModel, name: str, table: LinkTable) -> Datasheet:
    """Datasheet of the file over that of the model."""
    known = {link.name: link.datasheet for link in robot.links}.get(name, Datasheet())
    bounds = table.mass_bounds
    return Datasheet(
        mass=known.mass if table.mass is None else table.mass,
        mass_bounds=known.mass_bounds if bounds is None else (bounds[0], bounds[1]),
        com=known.com if table.com is None else np.array(table.com),
        com_box=known.com_box if table.com_box is None else np.array(table.com_box),
    )


def _drive(table: DriveTable) -> DriveTerms:
    return DriveTerms(
        viscous=table.viscous,
        coulomb=table.coulomb,
        velocity_scale=table.velocity_scale,
        offset=table.offset,
        rotor_inertia=table.rotor_inertia,
        spring=table.spring,
        asymmetric=table.asymmetric,
        stribeck_velocity=table.stribeck_velocity,
        stribeck_exponent=table.stribeck_exponent,
        load_friction=table.load_friction,
    )


def _coupling(table: CouplingTable) -> GearCoupling:
    return GearCoupling(
        table.first,
        table.second,
        table.viscous,
        table.coulomb,
        table.velocity_scale,
        table.rotor_inertia,
    )


def _expanded(path: str, problem: str) -> str:
    """Replace ``${NAME}`` by environment variables; a missing one is an error."""
    try:
        return string.Template(path).substitute(os.environ)
    except KeyError as missing:
        name = missing.args[0]
        raise ProblemError(
            f"problem {problem!r}: {path} needs the environment variable {name}, which "
            "is not set. Set it to the folder that holds the data"
        ) from None
    except ValueError as cause:
        raise ProblemError(f"problem {problem!r}: {path}: {cause}") from None


def _read(
    folder: Path, entry: RecordingTable, data: DataTable, robot: RobotModel
) -> Recording:
    return read_recording(
        folder / entry.file,
        robot.joint_names,
        None
        if data.columns is None
        else Columns(**msgspec.structs.asdict(data.columns)),
        torque_gain=data.torque_gain,
        topic=data.topic,
    )


def _span(raw: Recording, entry: RecordingTable) -> tuple[float, float]:
    """Return the times of the first and the last row that count."""
    if entry.rows is None:
        return -np.inf, np.inf
    first, last = entry.rows
    if not 1 <= first < last <= len(raw):
        raise ProblemError(
            f"{raw.name}: rows {first} to {last}, but the file has {len(raw)}"
        )
    return float(raw.time[first - 1]), float(raw.time[last - 1])


def _ends(amplitude: float | list[float]) -> tuple[float, float]:
    if isinstance(amplitude, list):
        return amplitude[0], amplitude[1]
    return amplitude, amplitude
