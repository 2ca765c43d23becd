"""A problem file for a robot that has no log yet: what motion to record first."""

from dataclasses import dataclass
from pathlib import Path

from consistent_id.errors import ProblemError
from consistent_id.problems.constraint_tables import ConstraintsTable
from consistent_id.problems.draft_text import DRIVE_COMMENTS
from consistent_id.problems.excitation_tables import ExcitationTable
from consistent_id.problems.file import ProblemTable
from consistent_id.problems.loading import problem_of
from consistent_id.problems.model import DEFAULT_DRIVE, model_table
from consistent_id.problems.problem import Problem
from consistent_id.problems.toml_text import problem_name, toml_text
from consistent_id.robot.chains import Selection
from consistent_id.robot.loaders import load_robot

ROBOT_ENDINGS = (".urdf", ".xml", ".mjcf")
"""Of files that hold a robot."""

_COMMENTS = {
    **DRIVE_COMMENTS,
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
    selection : Selection
        The part of the robot that moves.
    """

    model: Path
    excitation: ExcitationTable
    selection: Selection

    @property
    def name(self) -> str:
        """The problem's name: the robot's file, in letters that a name may have."""
        return problem_name(self.model)

    def table(self, folder: Path) -> ProblemTable:
        """Return the content of the problem file, for a file in a folder."""
        part = self.selection
        return ProblemTable(
            name=self.name,
            model=model_table(self.model, folder, base=part.base, tip=part.tip),
            drive=DEFAULT_DRIVE,
            constraints=ConstraintsTable(masses="free"),
            excitation=self.excitation,
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
    selection: Selection | None = None,
) -> RobotDraft:
    """Draft the problem of a robot that has no log yet.

    Parameters
    ----------
    model : str or Path
        URDF or MJCF.

    Raises
    ------
    ModelError
        If the robot cannot be read.
    ProblemError
        If the file is of another kind.
    """
    model, selection = Path(model), Selection() if selection is None else selection
    if model.suffix.lower() not in ROBOT_ENDINGS:
        raise ProblemError(
            f"{model}: expected a robot's file, {', '.join(ROBOT_ENDINGS)}"
        )
    load_robot(model, base=selection.base, tip=selection.tip)
    return RobotDraft(model, excitation or ExcitationTable(), selection)
