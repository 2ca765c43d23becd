"""A problem file for a robot that has no log yet, with the motion to record first."""

from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec

from consistent_id.errors import ProblemError
from consistent_id.problems.draft import DRIVE_COMMENTS
from consistent_id.problems.file import ProblemTable
from consistent_id.problems.found_logs import selection_of
from consistent_id.problems.kept_text import problem_name, toml_text
from consistent_id.problems.loading import problem_of
from consistent_id.problems.parameter_tables import ConstraintsTable
from consistent_id.problems.problem import Problem
from consistent_id.problems.stated_model import (
    DEFAULT_DRIVE,
    excitation_table,
    model_table,
)
from consistent_id.problems.statement import Statement, declarations
from consistent_id.problems.task_tables import ExcitationTable
from consistent_id.robot.loaders import load_robot

ROBOT_ENDINGS = (".urdf", ".xml", ".mjcf")
"""Suffixes of robots' files."""

_DRIVE = msgspec.structs.replace(DEFAULT_DRIVE, rotor_inertia=True)
"""Drive terms that a motion must excite; the log will show which of them matter."""

_COMMENTS = {
    **DRIVE_COMMENTS,
    "drive": "GUESS: viscous friction, Coulomb friction, a constant offset, and the\n"
    "rotors of geared motors.",
    "constraints.masses": '"datasheet" if the masses of the file are the robot\'s',
    "excitation": "What to move: consistent-id excite. Without harmonics, several\n"
    "numbers of them are tried.",
    "excitation.duration": "s",
    "excitation.objective": '"D": least standard errors; or "condition", "A", "E"',
    "excitation.noise": "N m or N; of each joint's torque",
    "excitation.limits": "In place of the robot file's; lengths in m, angles in rad.",
    "excitation.scene": "Bodies that must not touch; lengths in m.",
}


@dataclass(frozen=True, slots=True)
class RobotDraft:
    """The content of a problem file for a robot without a log.

    Parameters
    ----------
    model : Path
        URDF or MJCF.
    excitation : ExcitationTable
    stated : Statement
        The statement about the robot.
    """

    model: Path
    excitation: ExcitationTable
    stated: Statement

    @property
    def name(self) -> str:
        """The problem's name: the robot's file, in letters that a name may have."""
        return problem_name(self.model)

    def table(self, folder: Path) -> ProblemTable:
        """Return the content of the problem file, for a file in a folder."""
        return ProblemTable(
            name=self.name,
            model=model_table(self.model, folder, self.stated),
            drive=_DRIVE,
            constraints=ConstraintsTable(masses="free"),
            excitation=excitation_table(self.stated, folder, self.excitation),
        )

    def problem(self, folder: Path | None = None) -> Problem:
        """Return the problem itself, without a file of its own."""
        folder = Path.cwd() if folder is None else folder
        return problem_of(self.table(folder), folder / "problem.toml")

    def text(self, folder: Path) -> str:
        """Return the text of the problem file, for a file in a folder."""
        head = (
            f"# Drafted from {self.model.name}. A comment that begins with GUESS\n"
            "# marks what it does not state: check it. When the robot has moved, add\n"
            "# its log as a [data] table; consistent-id init ROBOT LOG writes one.\n\n"
        )
        shown = dict.fromkeys(("duration", "objective"), "")
        comments = {f"excitation.{key}": text for key, text in shown.items()}
        return head + toml_text(self.table(folder), comments | _COMMENTS)


def robot_draft(
    model: str | Path,
    excitation: ExcitationTable | None = None,
    stated: Statement | None = None,
) -> RobotDraft:
    """Draft the problem of a robot that has no log yet.

    Parameters
    ----------
    model : str or Path
        URDF or MJCF.
    excitation : ExcitationTable, optional
    stated : Statement, optional
        The statement about the robot.

    Raises
    ------
    ModelError
        If the robot cannot be read.
    ProblemError
        If the file is of another kind, or something of a log is stated.
    """
    model, stated = Path(model), stated or Statement()
    if model.suffix.lower() not in ROBOT_ENDINGS:
        raise ProblemError(
            f"{model}: expected a robot's file, {', '.join(ROBOT_ENDINGS)}"
        )
    if others := stated.of_part("log", "base", "model", "selection"):
        option = declarations()[others[0]].option
        raise ProblemError(
            f"{option} describes a log; name the log after the robot: "
            f"consistent-id init {model} LOG {option} ..."
        )
    part = asdict(selection_of(stated))
    load_robot(model, gravity=stated.gravity, **part)
    return RobotDraft(model, excitation or ExcitationTable(), stated)
