"""Model selection: from a problem's training data to a model and its file."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from time import process_time
from typing import Any

from consistent_id._support.executors import single_threaded
from consistent_id._support.files import LARGEST_PROBLEM, read_input
from consistent_id._support.progress import stages
from consistent_id._support.run import note_stop
from consistent_id._support.tables import Table, brief
from consistent_id.errors import ProblemError
from consistent_id.estimation.verdict import percent
from consistent_id.problems.file import PreparationTable, ProblemTable
from consistent_id.problems.kept_text import (
    bare_key,
    changed_tables,
    rewritten,
    toml_text,
)
from consistent_id.problems.loading import problem_of
from consistent_id.problems.problem import Problem
from consistent_id.problems.selection.band import (
    explained_edge,
    least_band,
    narrowed,
    prediction_band,
    thinning,
)
from consistent_id.problems.selection.choice import (
    Choice,
    applied,
    data_of,
    joint_widths,
)
from consistent_id.problems.selection.evaluation import Evaluator
from consistent_id.problems.selection.fading import closer_models
from consistent_id.problems.selection.forward_search import (
    Scope,
    State,
    Step,
    better_models,
)
from consistent_id.problems.selection.setup import KINDS, Beginning, beginning
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import own_rate

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
            "stribeck_value",
            "velocity_scale",
        ),
        "drive",
    ),
}

_STAGES = 12  # as many moves as a bar has room for
_ROOM = 2.0  # samples that are kept, over those that the cut-offs need
_WORTH = 4  # decimation steps from which on decimation saves enough time
_NARROWINGS = 3  # of the band, at the most
_SAME_BAND = (
    2 / 3
)  # of a band: an edge above it does not narrow it, because logs are short
_FAST = 0.2  # of the sampling rate: a band that wide is limited by it


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ModelSelection:
    """A model chosen by blocked cross-validation of the constrained fit.

    Parameters
    ----------
    problem : Problem
        The problem before the selection.
    start, choice : Choice
        The plain model, and the chosen one.
    steps : tuple of Step
        Steps from the plain model to the chosen one, in their order.
    band : float, [Hz]
        Frequency up to which torque was predicted.
    plain, expected : float
        Torque error on left-out blocks over the torque, with the plain model and with
        the chosen one.
    fits : int
        Number of constrained fits.
    seconds : float
        Processor time.
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
        """Return a problem file's content with the chosen model.

        Parameters
        ----------
        table : ProblemTable
            A table of the same robot.
        """
        return applied(table, self.choice, self.problem.model.robot)

    def chosen(self) -> Problem:
        """Return the problem with the chosen model.

        Logs are not read again.
        """
        problem = self.problem
        file = problem.source or problem.folder / "problem.toml"
        changed = problem_of(self.table_of_problem, file)
        changed._read.update(problem._read)
        return changed

    def table(self) -> Table:
        """Return a table of each step's gain, for people."""
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
            f"The model selected from the training data of {self.problem.name}",
            ("choice", "takes off", "+-", "of blocks", "may stand for"),
            tuple(rows),
            tuple(self._sentences()),
        )

    def _sentences(self) -> Iterator[str]:
        yield (
            f"error on blocks left out, all joints: {100 * self.plain:.2f} % of the "
            f"torque with the plain model, {100 * self.expected:.2f} % with this one, "
            f"up to {self.band:g} Hz"
        )
        yield (
            "takes off: share of the squared error on blocks left out, all joints "
            "with equal weight; +-: its standard error; of blocks: share of the "
            "blocks on which the error falls"
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
        """Return the reasons for values of the file, by the paths of their keys."""
        reasons: dict[str, list[str]] = {}
        for step in self.steps:
            reasons.setdefault(_TABLES[step.move.kind], []).append(_reason(step))
        reasons.setdefault("drive", ["No other drive term reduces the error enough."])
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
            for (
                key
            ) in joint.stated:  # written even if false, because other joints have it
                found[f"joints.{bare_key(name)}.{key}"] = ""
        return found

    def text(self) -> str:
        """Return the problem file, with comments that give the reasons.

        The author's text stays as it is, except for tables that change.
        """
        table = self.table_of_problem
        fresh = toml_text(table, self.comments())
        source = self.problem.source
        if source is None:
            return fresh
        written = read_input(source, ProblemError, LARGEST_PROBLEM).decode()
        changed = changed_tables(self.problem.table, table, _CHOSEN)
        return rewritten(written, fresh, changed, table)


def _reason(step: Step) -> str:
    brought = step.gain
    text = (
        f"{step.move.label}: {100 * brought.share:.1f} +- {100 * brought.error:.1f} %, "
        f"on {100 * brought.won:.0f} % of the blocks"
    )
    if step.stands_for:
        text += f"; may stand for {', '.join(step.stands_for)}"
    return text + "."


@single_threaded
def select_model(
    problem: Problem,
    *,
    fixed: Collection[str] = (),
    band: float | None = None,
    progress: bool = False,
) -> ModelSelection:
    """Choose drive terms, masses, cut-offs and rows by blocked cross-validation.

    Only the training recordings are read.  The search begins with a plain model, not
    with that of the file.  Each step makes the move that predicts left-out blocks best,
    until no move gains enough.

    Parameters
    ----------
    problem : Problem
        A problem with recordings.
    fixed : collection of str
        Settings that stay as in the file; see `KINDS`.
    band : float, optional, [Hz]
        Frequency up to which torque is predicted.  The default is twenty times the band
        of the velocity, or less: the frequency up to which the plain model explains a
        tenth of the torque's power.
    progress : bool
        Whether to show the progress of the search on the standard error.

    Returns
    -------
    ModelSelection
        If the search was interrupted, the best choice so far.

    Raises
    ------
    ProblemError
        If the problem has no recordings, or a kind is unknown.
    RecordingError
        If there is too little motion to leave blocks out.
    """
    started = process_time()
    data = data_of(problem.table)
    unknown = sorted(set(fixed) - set(KINDS))
    if unknown:
        raise ProblemError(
            f"fixed: {', '.join(unknown)} unknown; expected some of {', '.join(KINDS)}"
        )
    raws = problem.logs("training")
    if band is None:
        begun = _begun(problem, raws, fixed)
    else:
        begun = beginning(problem, raws, fixed, band)
    band = begun.evaluator.setting.band
    evaluator, state, interrupted = _searched(begun, progress)
    rate = min(own_rate(raw) for raw in raws)
    choice = _thinned(state.current.choice, data.preparation, rate)
    return ModelSelection(
        problem=problem,
        start=begun.plain.choice,
        choice=choice,
        steps=state.steps,
        band=band,
        plain=begun.evaluator.expected(begun.plain),
        expected=evaluator.expected(state.current),
        fits=evaluator.fits,
        seconds=process_time() - started,
        notes=_notes(choice, begun.scope, band, rate, interrupted),
    )


def _begun(
    problem: Problem, raws: tuple[Recording, ...], fixed: Collection[str]
) -> Beginning:
    """Return a beginning in the band in which the plain model explains some torque."""
    begun = beginning(problem, raws, fixed, prediction_band(raws))
    joints = len(begun.evaluator.setting.bodies.torque_joints)
    seconds = sum(raw.duration for raw in raws)
    least = least_band(seconds, joints, begun.parameters)
    for _ in range(_NARROWINGS):
        samples = begun.evaluator.samples(begun.plain.choice.motion_cutoff)
        band = begun.evaluator.setting.band
        narrower = narrowed(
            band, explained_edge(samples.parts, begun.plain.fits), least
        )
        if narrower > _SAME_BAND * band:
            break
        begun = beginning(problem, raws, fixed, narrower)
    return begun


def _searched(begun: Beginning, progress: bool) -> tuple[Evaluator, State, bool]:
    """Return the last state, its evaluator, and whether the search was interrupted."""
    evaluator, state = begun.evaluator, State(begun.plain)
    try:
        with stages(_STAGES, progress) as begin:
            for evaluator, state in _models(begun):
                made = state.steps[-1].move.label if state.steps else "plain model"
                left_out = evaluator.expected(state.current)
                begin(f"model: {made}, left-out error {percent(left_out)}")
    except KeyboardInterrupt as cause:
        note_stop(cause)
        return evaluator, state, True
    return evaluator, state, False


def _models(begun: Beginning) -> Iterator[tuple[Evaluator, State]]:
    """Yield better and better models, each with an evaluator that knows its terms."""
    evaluator, state = begun.evaluator, State(begun.plain)
    for state in better_models(evaluator, begun.plain, begun.scope):
        yield evaluator, state
    yield from closer_models(evaluator, begun.plain, state, begun.scope)


def _thinned(choice: Choice, preparation: PreparationTable, rate: float) -> Choice:
    """Return a choice that skips needless samples of a fast log."""
    if preparation.decimate > 1:
        return replace(choice, decimate=preparation.decimate)
    if choice.motion_cutoff is None or choice.torque_cutoff is None:
        return choice
    highest = max(choice.motion_cutoff, choice.torque_cutoff)
    factor = thinning(_ROOM * highest, rate)
    return choice if factor < _WORTH else replace(choice, decimate=factor)


def _notes(
    choice: Choice, scope: Scope, band: float, rate: float, interrupted: bool
) -> tuple[str, ...]:
    """Return notes on the choice for its reader."""
    notes = [
        "these errors are a little too small, because the same blocks selected the "
        "model: expect a few per cent more on a motion not seen"
    ]
    if interrupted:
        notes.append("interrupted: this is the best choice so far")
    if "motion_cutoff" not in scope.fixed and choice.motion_cutoff is not None:
        notes += _edge("motion_cutoff", "Hz", choice.motion_cutoff, scope.cutoffs)
    if "velocity_scale" not in scope.fixed:
        for each in scope.widths:
            value = joint_widths(choice)[each.joints[0]]
            notes += _edge("velocity_scale", "rad/s or m/s", value, each.scales)
    if band > _FAST * rate:
        notes.append(
            f"the motion is fast for {rate:.4g} samples a second: torque above "
            f"{band:g} Hz is not predicted"
        )
    if any(d.load_friction for d in choice.drive) and choice.masses != "datasheet":
        notes.append(
            "the load of load_friction is that of the model's masses, which the data "
            "contradict"
        )
    return tuple(notes)


def _edge(
    name: str, unit: str, value: float, tried: tuple[float, ...]
) -> tuple[str, ...]:
    """Warn of a value at the edge of those that were tried."""
    if len(tried) > 1 and value in (tried[0], tried[-1]):
        ends = f"{tried[0]:g} to {tried[-1]:g} {unit}"
        return (f"{name} = {value:g} is at the edge of the values tried, {ends}",)
    return ()
