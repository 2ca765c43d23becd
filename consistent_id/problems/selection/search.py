"""Forward selection: the move that brings most is made, until none brings enough."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from consistent_id.errors import ConsistentIdError
from consistent_id.problems.selection.evaluation import Evaluated, Evaluator
from consistent_id.problems.selection.held_out import Gain, gain
from consistent_id.problems.selection.moves import Move, mass_move, removals
from consistent_id.problems.selection.proposals import Proposal, Scope, proposals

LEAST_GAIN = 0.025
"""Share of the squared error that a move has to take away."""

SMALL_GAIN = 0.05
"""A gain below this has to exceed its standard error as well.  A larger one need not:
with few blocks, true terms whose gain is uneven would be thrown out."""

LEAST_ROW_GAIN = 0.10
"""The same of a mask: what it leaves out is no longer explained at all."""

LEAST_COUPLING_GAIN = 0.10
"""The same of a coupling: it says how the robot is built, and brings three terms."""

LEAST_WON = 0.6
"""Share of the blocks on which a move has to lower the error."""

LEAST_WON_BY_VALUES = 0.5
"""The same of another value of what the model has already, such as a cut-off: it makes
the model no larger, and the value before it has no better claim."""

CONTRADICTION = 3.0
"""Standard errors by which data have to contradict the masses that a model states: they
are knowledge, unlike a friction law, and free ones stand in for springs and zeros."""

LEAST_COST = 0.0125
"""Share of the squared error that a term has to be worth to stay, beside later ones."""

_LEAST = {"least_speed": LEAST_ROW_GAIN, "coupling": LEAST_COUPLING_GAIN}

_TRIED = 4  # moves, of those that screening ranks first, that are fitted in full
_HOPELESS = 0.3  # of the gain that is needed: what screening promises less is not tried
_HOPEFUL_MASK = 0.5  # of a mask's gain that screening has to promise
_ALIKE = 0.8  # share of the best gain at which the simpler of two moves is preferred
_REPLACED = 0.5  # of its gain that a rival keeps beside the move, if it says more
_ROUNDS = 20


@dataclass(frozen=True, slots=True)
class Step:
    """A move that was made.

    Parameters
    ----------
    gain : Gain
        Of a term that was taken back, negative: what that costs.
    error : float
        Root-mean-square error on the blocks after it, in units of the plain model's.
    rivals : mapping of str to Gain
        Other moves that were fitted in full instead, by their labels.
    stands_for : tuple of str
        Rivals that brought half as much or more, and bring little beside it: data do
        not tell them apart well.
    """

    move: Move
    gain: Gain
    error: float
    rivals: dict[str, Gain]
    stands_for: tuple[str, ...] = ()


_Tried = tuple[Move, Gain, Evaluated]


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """How far a search has come."""

    current: Evaluated
    steps: tuple[Step, ...] = ()


def search(evaluator: Evaluator, start: Evaluated, scope: Scope) -> Iterator[State]:
    """Yield better and better choices, from the start on."""
    state = State(start)
    yield state
    for _ in range(_ROUNDS):
        offered = list(proposals(evaluator, state.current, scope))
        state = replace(state, steps=_with_stand_ins(state.steps, offered))
        found = _best_move(evaluator, state.current, offered)
        if found is None:
            break
        step, current = found
        state = State(current, (*state.steps, step))
        yield state
    yield from _pruned(evaluator, state)


def _best_move(
    evaluator: Evaluator, current: Evaluated, offered: Sequence[Proposal]
) -> tuple[Step, Evaluated] | None:
    """Return the move that brings most, if one brings enough."""
    tried = _tried(evaluator, current, _worth_trying(offered))
    if any(t[0].kind == "masses" and _enough(t[0], t[1]) for t in tried):
        bounded = mass_move(current.choice, "bounds")
        tried = _without_tight_bounds(tried, _tried(evaluator, current, [bounded]))
    enough = [t for t in tried if _enough(t[0], t[1])]
    if not enough:
        return None
    # Rows first: what other moves bring can be compared on the rows that stay.
    enough = [t for t in enough if t[0].kind == "least_speed"] or enough
    best = max(brought.share for _, brought, _ in enough)
    alike = [t for t in enough if t[1].share >= _ALIKE * best]
    move, brought, after = min(alike, key=lambda t: _size(t[0], current))
    rivals = {m.label: g for m, g, _ in tried if m != move}
    return Step(move, brought, after.error, rivals), after


def _without_tight_bounds(tried: list[_Tried], bounded: list[_Tried]) -> list[_Tried]:
    """Return moves with bounded masses in place of free ones, or without them.

    Bounds that cost as much as a move has to bring exclude what the masses are.
    """
    free = next(t for t in tried if t[0].kind == "masses")
    for move in bounded:
        if gain(move[2].errors, free[2].errors).share < LEAST_GAIN:
            return [*(t for t in tried if t is not free), move]
    return tried


def _tried(
    evaluator: Evaluator, current: Evaluated, moves: Sequence[Move]
) -> list[_Tried]:
    """Fit moves in full; a model that cannot be fitted is none."""
    found: list[_Tried] = []
    evaluator.evaluate_ahead([move.after for move in moves])
    for move in moves:
        try:
            after = evaluator.evaluated(move.after)
        except ConsistentIdError:
            continue
        before = evaluator.seen_on(current, move.after)
        found.append((move, gain(before, after.errors), after))
    return found


def _worth_trying(offered: Sequence[Proposal]) -> list[Move]:
    """Return moves that screening ranks first, hopeful masks, and other masses."""
    told = [(p.hoped, p.move) for p in offered if p.hoped is not None]
    masks = [
        move
        for hoped, move in told
        if move.kind == "least_speed" and hoped >= _HOPEFUL_MASK * LEAST_ROW_GAIN
    ]
    others = [pair for pair in told if pair[1].kind != "least_speed"]
    ranked = sorted(others, key=lambda pair: pair[0], reverse=True)[:_TRIED]
    hopeful = [move for hoped, move in ranked if hoped >= _HOPELESS * LEAST_GAIN]
    return hopeful + masks + [p.move for p in offered if p.hoped is None]


def _enough(move: Move, brought: Gain) -> bool:
    least = _LEAST.get(move.kind, LEAST_GAIN)
    least = max(least, min(brought.error, SMALL_GAIN))
    if move.kind == "masses":
        least = max(least, CONTRADICTION * brought.error)
    won = LEAST_WON_BY_VALUES if move.kind in _VALUES else LEAST_WON
    return brought.share >= least and brought.won >= won


_VALUES = ("velocity_scale", "motion_cutoff", "delay")
_EVERYWHERE = ("rotor_inertia", "load_friction", "drag", "stribeck_velocity")


def _size(move: Move, current: Evaluated) -> float:
    """Return how much a move changes: of like gains the smallest change is made.

    What every drive has is simplest for all joints; a spring, where there is one.
    """
    if move.kind == "masses":
        return {"bounds": 100.0, "free": 200.0}[move.after.masses]
    if move.kind in ("spring", "asymmetric", "coupling", *_EVERYWHERE):
        pairs = zip(current.choice.drive, move.after.drive, strict=True)
        changed = sum(a != b for a, b in pairs)
        return float(-changed if move.kind in _EVERYWHERE else changed)
    if move.kind == "least_speed":
        return move.after.least_speed or 0.0
    return -100.0  # another value of what is there already


def _with_stand_ins(
    steps: tuple[Step, ...], offered: Sequence[Proposal]
) -> tuple[Step, ...]:
    """Say of the last step which of its rivals bring little beside it."""
    if not steps:
        return steps
    last = steps[-1]
    left = {p.move.label: p.hoped for p in offered if p.hoped is not None}
    alike = tuple(
        label
        for label, brought in last.rivals.items()
        if brought.share >= 0.5 * last.gain.share
        and left.get(label, brought.share) < _REPLACED * LEAST_GAIN
    )
    return (*steps[:-1], replace(last, stands_for=alike))


def _pruned(evaluator: Evaluator, state: State) -> Iterator[State]:
    """Yield states with terms taken back that later ones have made needless."""
    for step in state.steps[:-1]:
        for move in removals(state.current.choice, step.move):
            try:
                after = evaluator.evaluated(move.after)
            except ConsistentIdError:
                continue
            cost = gain(state.current.errors, after.errors)
            if cost.share > -LEAST_COST:
                taken = Step(move, cost, after.error, {})
                state = State(after, (*state.steps, taken))
                yield state
