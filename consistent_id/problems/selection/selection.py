"""What a selection chose, why, and the problem file that says so."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from consistent_id._support.inputs import LARGEST_PROBLEM, read_input
from consistent_id._support.tables import Table
from consistent_id.errors import ProblemError
from consistent_id.problems.file import ProblemTable
from consistent_id.problems.kept_text import changed_tables, rewritten
from consistent_id.problems.loading import problem_of
from consistent_id.problems.problem import Problem
from consistent_id.problems.selection.choice import Choice, applied
from consistent_id.problems.selection.search import Step
from consistent_id.problems.toml_text import bare_key, toml_text


@dataclass(frozen=True, slots=True, eq=False)
class ModelSelection:
    """A model chosen by blocked cross-validation of the constrained fit.

    Parameters
    ----------
    problem : Problem
        As it was given.
    start, choice : Choice
        The plain model, and the one that was chosen.
    steps : tuple of Step
        From the plain model to it, in the order in which they were made.
    band : float, [Hz]
        Up to which torque was predicted.
    plain, expected : float
        Torque error on left-out blocks over the torque, with the plain model and with
        the chosen one.
    fits : int
        Constrained fits that it took.
    seconds : float
        Of the processor.
    notes : tuple of str
    """

    problem: Problem
    start: Choice
    choice: Choice
    steps: tuple[Step, ...]
    band: float
    plain: float
    expected: float
    fits: int
    seconds: float
    notes: tuple[str, ...] = ()

    @property
    def table_of_problem(self) -> ProblemTable:
        """The problem file's content with the chosen model."""
        return self.applied(self.problem.table)

    def applied(self, table: ProblemTable) -> ProblemTable:
        """Return a problem file's content, with the chosen model in place of its own.

        Parameters
        ----------
        table : ProblemTable
            Of the same robot.
        """
        return applied(table, self.choice, self.problem.model.robot)

    def chosen(self) -> Problem:
        """Return the problem with the chosen model.

        Logs that have been read are not read again.
        """
        problem = self.problem
        file = problem.source or problem.folder / "problem.toml"
        changed = problem_of(self.table_of_problem, file)
        changed._read.update(problem._read)
        return changed

    def table(self) -> Table:
        """Return what each choice brought, for people."""
        rows = [("plain model", "", "", "", "")]
        for step in self.steps:
            brought = step.gain
            rows.append(
                (
                    step.move.label,
                    f"{100 * brought.share:.1f} %",
                    f"{100 * brought.error:.1f} %",
                    f"{100 * brought.won:.0f} %",
                    "; ".join(step.stands_for) or "-",
                )
            )
        return Table(
            f"The model that the training data of {self.problem.name} ask for",
            ("choice", "takes off", "+-", "of blocks", "may stand for"),
            tuple(rows),
            tuple(self._sentences()),
        )

    def _sentences(self) -> Iterator[str]:
        yield (
            f"error on blocks left out: {100 * self.plain:.2f} % of the torque with "
            f"the plain model, {100 * self.expected:.2f} % with this one, up to "
            f"{self.band:g} Hz"
        )
        yield (
            "takes off: share of the squared error on blocks left out, joints counting "
            "alike; +-: its standard error; of blocks: on which it is less"
        )
        cutoff = self.choice.motion_cutoff
        if cutoff is not None:
            yield f"cut-off of motion {cutoff:g} Hz, of torque {self.band:g} Hz"
        yield from self.notes

    def to_dict(self) -> dict[str, Any]:
        """Return the figures, for JSON."""
        return {
            "band_hz": self.band,
            "plain": self.plain,
            "expected": self.expected,
            "fits": self.fits,
            "cpu_seconds": self.seconds,
            "steps": [
                {
                    "kind": step.move.kind,
                    "choice": step.move.label,
                    "share": step.gain.share,
                    "standard_error": step.gain.error,
                    "blocks_won": step.gain.won,
                    "may_stand_for": list(step.stands_for),
                }
                for step in self.steps
            ],
            "notes": list(self.notes),
        }

    def comments(self) -> dict[str, str]:
        """Return why keys of the file are as they are, by their paths."""
        reasons: dict[str, list[str]] = {}
        for step in self.steps:
            reasons.setdefault(_TABLES[step.move.kind], []).append(_reason(step))
        reasons.setdefault("drive", ["No drive term beyond these brings enough."])
        reasons.setdefault("data.preparation", []).append(
            f"Torque is predicted up to {self.band:g} Hz."
        )
        head = (
            "Chosen by consistent-id select; shares are of the squared error on blocks "
            "left out."
        )
        found = {path: "\n".join([head, *texts]) for path, texts in reasons.items()}
        table = self.table_of_problem
        for name, joint in table.joints.items():
            for key in joint.stated:  # said even if false: other joints have it
                found[f"joints.{bare_key(name)}.{key}"] = ""
        return found

    def text(self) -> str:
        """Return the problem file, with comments that say why.

        What its author wrote stays as it is, but for the tables that change.
        """
        table = self.table_of_problem
        fresh = toml_text(table, self.comments())
        source = self.problem.source
        if source is None:
            return fresh
        written = read_input(source, ProblemError, LARGEST_PROBLEM).decode()
        changed = changed_tables(self.problem.table, table, _CHOSEN)
        return rewritten(written, fresh, changed, table)


_CHOSEN = ("links", "drive", "joints", "couplings", "constraints", "data.preparation")

_TABLES = {
    "coupling": "couplings",
    "masses": "constraints",
    "motion_cutoff": "data.preparation",
    "least_speed": "data.preparation",
    "delay": "data.preparation",
    **dict.fromkeys(
        (
            "rotor_inertia",
            "load_friction",
            "drag",
            "spring",
            "friction_slope",
            "asymmetric",
            "stribeck_velocity",
            "velocity_scale",
        ),
        "drive",
    ),
}


def _reason(step: Step) -> str:
    brought = step.gain
    text = (
        f"{step.move.label}: {100 * brought.share:.1f} +- {100 * brought.error:.1f} %, "
        f"on {100 * brought.won:.0f} % of the blocks"
    )
    if step.stands_for:
        text += f"; may stand for {', '.join(step.stands_for)}"
    return text + "."
