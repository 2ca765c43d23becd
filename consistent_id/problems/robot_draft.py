"""A problem file for a robot that has no log yet: what motion to record first."""

from dataclasses import dataclass
from pathlib import Path

from consistent_id.errors import ProblemError
from consistent_id.problems.excitation_tables import ExcitationTable
from consistent_id.problems.file import ConstraintsTable, ModelTable, ProblemTable
from consistent_id.problems.model import DEFAULT_DRIVE
from consistent_id.problems.paths import as_named
from consistent_id.problems.problem import Problem, problem_of
from consistent_id.problems.toml_text import toml_text
from consistent_id.robot.chains import Selection
from consistent_id.robot.loaders import load_robot
from consistent_id.robot.loaders.robot_file import is_mjcf

ROBOT_ENDINGS = (".urdf", ".xml", ".mjcf")
"""Of files that hold a robot."""

_COMMENTS = {
    "drive": "GUESS: viscous friction, Coulomb friction, a constant offset.\n"
    "rotor_inertia = true adds the rotors of geared motors.",
    "drive.velocity_scale": "GUESS [rad/s or m/s]: width of the sign change",
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
    selection : Selection
        The part of the robot that moves.
    """

    model: Path
    excitation: ExcitationTable
    selection: Selection

    @property
    def name(self) -> str:
        """The problem's name: the robot's file, in letters that a name may have."""
        stem = self.model.stem
        kept = "".join(c if c.isascii() and c.isalnum() else "-" for c in stem)
        return kept.strip("-") or "problem"

    def table(self, folder: Path) -> ProblemTable:
        """Return the content of the problem file, for a file in a folder."""
        mjcf = is_mjcf(self.model)
        model = as_named(self.model, folder)
        return ProblemTable(
            name=self.name,
            model=ModelTable(
                urdf=None if mjcf else model,
                mjcf=model if mjcf else None,
                base=self.selection.base,
                tip=self.selection.tip,
            ),
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
    excitation : ExcitationTable, optional
    selection : Selection, optional

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
