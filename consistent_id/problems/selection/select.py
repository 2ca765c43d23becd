"""From a problem's training data to the model that they ask for."""

from collections.abc import Collection
from dataclasses import replace
from time import process_time

from consistent_id._support.interrupts import note_stop
from consistent_id._support.progress import stages
from consistent_id._support.threads import single_threaded
from consistent_id.errors import ProblemError
from consistent_id.problems.file import PreparationTable
from consistent_id.problems.problem import Problem
from consistent_id.problems.selection.band import prediction_band, thinning
from consistent_id.problems.selection.choice import Choice, data_of
from consistent_id.problems.selection.moves import velocity_scale
from consistent_id.problems.selection.proposals import Scope
from consistent_id.problems.selection.search import State, search
from consistent_id.problems.selection.selection import ModelSelection
from consistent_id.problems.selection.setup import KINDS, Beginning, beginning
from consistent_id.recordings.signals.clocks import own_rate

_STAGES = 12  # as many moves as a bar has room for
_ROOM = 2.0  # samples that are kept, over those that the cut-offs need
_WORTH = 4  # samples, of which one is kept, from which on leaving out is worth while
_FAST = 0.2  # of the sampling rate: a band that wide is cut off by it


@single_threaded
def select_model(
    problem: Problem,
    *,
    fixed: Collection[str] = (),
    band: float | None = None,
    progress: bool = False,
) -> ModelSelection:
    """Choose drive terms, masses, cut-offs and rows by blocked cross-validation.

    From the training recordings alone: those for validation are not read.  The search
    begins with a plain model, not with what the file says, and makes the move that
    predicts left-out blocks best, until none brings enough.

    Parameters
    ----------
    problem : Problem
        With recordings.
    fixed : collection of str
        What stays as the file has it; see `KINDS`.
    band : float, optional, [Hz]
        Up to which torque is to be predicted; by default twenty times the band of the
        velocity.
    progress : bool
        Whether to show on the standard error how far the search is.

    Returns
    -------
    ModelSelection
        Of a search that was interrupted, the best choice so far.

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
        band = prediction_band(raws)
    begun = beginning(problem, raws, fixed, band)
    state, interrupted = _searched(begun, progress)
    rate = min(own_rate(raw) for raw in raws)
    choice = _thinned(state.current.choice, data.preparation, rate)
    return ModelSelection(
        problem=problem,
        start=begun.plain.choice,
        choice=choice,
        steps=state.steps,
        band=band,
        plain=begun.evaluator.expected(begun.plain),
        expected=begun.evaluator.expected(state.current),
        fits=begun.evaluator.fits,
        seconds=process_time() - started,
        notes=_notes(choice, begun.scope, band, rate, interrupted),
    )


def _searched(begun: Beginning, progress: bool) -> tuple[State, bool]:
    """Return how far the search came, and whether it was interrupted."""
    state = State(begun.plain)
    try:
        with stages(_STAGES, progress) as begin:
            for state in search(begun.evaluator, begun.plain, begun.scope):
                made = state.steps[-1].move.label if state.steps else "plain model"
                begin(f"model: {made}")
    except KeyboardInterrupt as cause:
        note_stop(cause)
        return state, True
    return state, False


def _thinned(choice: Choice, preparation: PreparationTable, rate: float) -> Choice:
    """Return a choice that leaves needless samples of a fast log out."""
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
    """Return what a reader has to know of the choice."""
    notes = [
        "the errors are of the best of many models on the blocks that chose it: expect "
        "a few per cent more of a motion not seen"
    ]
    if interrupted:
        notes.append("interrupted: this is the best choice so far")
    if "motion_cutoff" not in scope.fixed and choice.motion_cutoff is not None:
        notes += _edge("motion_cutoff", "Hz", choice.motion_cutoff, scope.cutoffs)
    if "velocity_scale" not in scope.fixed:
        notes += _edge(
            "velocity_scale", "rad/s or m/s", velocity_scale(choice), scope.scales
        )
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
        return (f"{name} = {value:g} is at the edge of what was tried, {ends}",)
    return ()
