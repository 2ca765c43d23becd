"""Forward selection: make the move with the largest gain, until none gains enough."""

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf

from consistent_id.errors import ConsistentIdError
from consistent_id.problems.selection.choice import (
    REMOVABLE,
    ModelMove,
    Widths,
    coupling_moves,
    cutoff_moves,
    delay_moves,
    has_term,
    joint_widths,
    mass_move,
    removals,
    row_moves,
    scale_moves,
    setter,
    size_of,
    stribeck_moves,
    stribeck_passed,
    term_moves,
    with_drive,
    without,
)
from consistent_id.problems.selection.evaluation import (
    Evaluated,
    Evaluator,
    fitting_delay,
)
from consistent_id.problems.selection.fits import Gain, HeldOut, gain, joint_gains
from consistent_id.problems.selection.gates import (
    LEAST_COST,
    LEAST_GAIN,
    LEAST_HELP,
    LEAST_ROW_GAIN,
    believable,
    better,
    clear,
    enough,
)
from consistent_id.problems.selection.superset import couplings_between

_TRIED = 4  # moves, of those that screening ranks first, that are fitted in full
_HOPELESS = 0.3  # of the needed gain: moves with a smaller predicted gain are not tried
_HOPEFUL_MASK = 0.5  # of a mask's gain that screening must predict
_ALIKE = 0.8  # share of the best gain at which the simpler of two moves is preferred
_REPLACED = 0.5  # of its gain that a rival keeps beside the move, if not equivalent
_ROUNDS = 20
_PRUNINGS = 3  # rounds of taking terms out, joint by joint, and of searching on

_Tried = tuple[ModelMove, Gain, Evaluated]


@dataclass(frozen=True, slots=True)
class Scope:
    """The scope of a search: kinds of moves, and the values to try.

    Parameters
    ----------
    fixed : frozenset of str
        Kinds that must not change, such as ``"masses"``.
    widths : tuple of Widths
        Widths of friction's change of sign, by kind of joint.
    cutoffs : tuple of float, [Hz]
        Cut-offs of the motion, ascending.
    everywhere : bool
        Whether a drive term is also tried for all joints without it, and not only for
        joints that it helps.
    """

    fixed: frozenset[str]
    widths: tuple[Widths, ...]
    cutoffs: tuple[float, ...]
    everywhere: bool = True


@dataclass(frozen=True, slots=True)
class Proposal:
    """A move, and the gain that screening predicts; None if it cannot predict one."""

    move: ModelMove
    hoped: float | None


@dataclass(frozen=True, slots=True)
class Step:
    """A move that was made.

    Parameters
    ----------
    gain : Gain
        The gain; negative for a term that was removed, as a cost.
    error : float
        Root-mean-square error on the blocks after the move, over the plain model's.
    rivals : mapping of str to Gain
        Other moves that were fitted in full, by their labels.
    stands_for : tuple of str
        Rivals with half the gain or more that gain little beside this move: the data
        hardly distinguish them.
    later : tuple of ModelMove
        Other promising moves, which were not fitted because rows are chosen first.
    """

    move: ModelMove
    gain: Gain
    error: float
    rivals: dict[str, Gain]
    stands_for: tuple[str, ...] = ()
    later: tuple[ModelMove, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """The present state of a search."""

    current: Evaluated
    steps: tuple[Step, ...] = ()


def better_models(
    evaluator: Evaluator, start: Evaluated, scope: Scope
) -> Iterator[State]:
    """Yield better and better choices, from the start on.

    Terms are given to all joints or to some, then removed from joints that do not need
    them.  After that, springs are tried with other bodies, and terms that others had
    hidden may be given to single joints.
    """
    yield State(start)
    state = yield from _forward(evaluator, State(start), scope)
    state = yield from _pruned(evaluator, state)
    for _ in range(_PRUNINGS):
        before = state.current.choice
        state = yield from without_needless_terms(evaluator, start, state, scope)
        state = yield from _with_springs(evaluator, state, scope)
        if state.current.choice == before:
            break
        one_by_one = replace(scope, everywhere=False)
        state = yield from _forward(evaluator, state, one_by_one)


def joint_by_joint(
    evaluator: Evaluator, start: Evaluated, state: State, scope: Scope
) -> Iterator[State]:
    """Yield states without needless terms, and with others, of single joints."""
    state = yield from without_needless_terms(evaluator, start, state, scope)
    state = yield from _with_springs(evaluator, state, scope)
    yield from _forward(evaluator, state, replace(scope, everywhere=False))


_Search = Generator[State, None, State]


def _forward(evaluator: Evaluator, state: State, scope: Scope) -> _Search:
    """Yield states; each makes the move with the largest gain on the one before."""
    for _ in range(_ROUNDS):
        offered = list(proposals(evaluator, state.current, scope))
        steps = _with_stand_ins(evaluator, state.steps, offered)
        state = replace(state, steps=steps)
        found = _best_move(evaluator, state.current, offered)
        if found is None:
            break
        step, current = found
        state = State(current, (*state.steps, step))
        yield state
    return state


def _best_move(
    evaluator: Evaluator, current: Evaluated, offered: Sequence[Proposal]
) -> tuple[Step, Evaluated] | None:
    """Return the move with the largest gain, if it is large enough."""
    moves = _worth_trying(offered)
    # Rows first: gains of other moves are compared on the remaining rows.
    tried = _tried(evaluator, current, [m for m in moves if m.kind == "least_speed"])
    later: list[ModelMove] = []
    if any(enough(t[0], t[1]) for t in tried):
        later = [m for m in moves if m.kind != "least_speed"]
    else:
        tried = _tried(evaluator, current, moves)
    if any(t[0].kind == "masses" and enough(t[0], t[1]) for t in tried):
        bounded = mass_move(current.choice, "bounds")
        tried = _without_tight_bounds(tried, _tried(evaluator, current, [bounded]))
    large = [t for t in tried if enough(t[0], t[1]) or _clear(evaluator, current, t)]
    if not large:
        return None
    best = max(brought.share for _, brought, _ in large)
    alike = [t for t in large if t[1].share >= _ALIKE * best]
    move, brought, after = min(alike, key=lambda t: size_of(t[0]))
    rivals = {m.label: g for m, g, _ in tried if m != move}
    return Step(move, brought, after.error, rivals, later=tuple(later)), after


def _clear(evaluator: Evaluator, current: Evaluated, tried: _Tried) -> bool:
    """Return whether a term or width clearly helps each joint that gets it."""
    move, brought, after = tried
    if move.kind not in (*REMOVABLE, "velocity_scale") or brought.share <= 0.0:
        return False
    bodies = evaluator.setting.bodies
    rows = {name: row for row, name in enumerate(bodies.torque_joints)}
    gains = joint_gains(current.errors, after.errors)
    drives = zip(
        bodies.robot.joint_names, move.before.drive, move.after.drive, strict=True
    )
    return all(clear(gains[rows[name]]) for name, old, new in drives if old != new)


def _without_tight_bounds(tried: list[_Tried], bounded: list[_Tried]) -> list[_Tried]:
    """Return moves with bounded masses in place of free ones, or without them.

    Bounds that cost as much as the least gain of a move exclude the true masses.
    """
    free = next(t for t in tried if t[0].kind == "masses")
    for move in bounded:
        if gain(move[2].errors, free[2].errors).share < LEAST_GAIN:
            return [*(t for t in tried if t is not free), move]
    return tried


def _tried(
    evaluator: Evaluator, current: Evaluated, moves: Sequence[ModelMove]
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


def _worth_trying(offered: Sequence[Proposal]) -> list[ModelMove]:
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


def _with_stand_ins(
    evaluator: Evaluator, steps: tuple[Step, ...], offered: Sequence[Proposal]
) -> tuple[Step, ...]:
    """Name the last step's rivals that gain little beside it."""
    if not steps:
        return steps
    last = steps[-1]
    left = {p.move.label: p.hoped for p in offered if p.hoped is not None}
    little = _REPLACED * LEAST_GAIN
    replaced = [m for m in last.later if left.get(m.label, inf) < little]
    before = evaluator.evaluated(last.move.before)
    late = {m.label: g for m, g, _ in _tried(evaluator, before, replaced)}
    alike = tuple(
        label
        for label, brought in {**late, **last.rivals}.items()
        if brought.share >= 0.5 * last.gain.share
        and left.get(label, brought.share) < little
    )
    return (*steps[:-1], replace(last, stands_for=alike))


def _pruned(evaluator: Evaluator, state: State) -> _Search:
    """Yield states without terms that later terms have made needless."""
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
    return state


def _with_springs(evaluator: Evaluator, state: State, scope: Scope) -> _Search:
    """Yield the state with springs of joints that these help.

    Bodies that were fitted without a spring have most of its torque in their first
    moments.  So screening, which keeps them, hardly sees it, and models are fitted:
    with springs of all joints, of those that are better, and of those that surely are.
    """
    choice, bodies = state.current.choice, evaluator.setting.bodies
    names = bodies.robot.joint_names
    rows = {names.index(name): row for row, name in enumerate(bodies.torque_joints)}
    joints = [j for j in rows if not choice.drive[j].spring]
    if "spring" in scope.fixed:
        return state
    for helps in (better, believable):
        after = with_drive(choice, joints, setter(spring=True))
        try:
            errors = evaluator.evaluated(after).errors
        except ConsistentIdError:
            return state
        gains = joint_gains(state.current.errors, errors)
        joints = [j for j in joints if helps(gains[rows[j]])]
    if not joints:
        return state
    label = f"spring of {', '.join(names[j] for j in joints)}"
    after = with_drive(choice, joints, setter(spring=True))
    move = ModelMove("spring", label, choice, after)
    for tried in _tried(evaluator, state.current, [move]):
        if enough(move, tried[1]) or _clear(evaluator, state.current, tried):
            made = Step(move, tried[1], tried[2].error, {})
            state = State(tried[2], (*state.steps, made))
            yield state
    return state


def without_needless_terms(
    evaluator: Evaluator, start: Evaluated, state: State, scope: Scope
) -> _Search:
    """Yield states without the terms that some joints do not need.

    A term that was given to all joints stays where it reduces the joint's own error;
    see `believable`.  The terms of the plain model stay.

    Parameters
    ----------
    start : Evaluated
        The plain model.
    """
    for kind in REMOVABLE:
        if kind in scope.fixed:
            continue
        needless = _needless(evaluator, start, state.current, kind)
        names = evaluator.setting.bodies.robot.joint_names
        choice = without(state.current.choice, kind, needless)
        if choice == state.current.choice:
            continue
        try:
            after = evaluator.evaluated(choice)
        except ConsistentIdError:
            continue
        cost = gain(state.current.errors, after.errors)
        if cost.share > -LEAST_COST:
            label = f"without {kind} of {', '.join(names[j] for j in needless)}"
            move = ModelMove(kind, label, state.current.choice, choice)
            taken = Step(move, cost, after.error, {})
            state = State(after, (*state.steps, taken))
            yield state
    if "delay" not in scope.fixed:
        state = yield from _without_delay(evaluator, start, state)
    return state


def _without_delay(evaluator: Evaluator, start: Evaluated, state: State) -> _Search:
    """Yield the state without a delay that later terms have made needless."""
    choice = replace(state.current.choice, delay=start.choice.delay)
    if choice != state.current.choice:
        after = evaluator.evaluated(choice)
        made = ModelMove("delay", "torque late", choice, state.current.choice)
        if not enough(made, gain(after.errors, state.current.errors)):
            cost = gain(state.current.errors, after.errors)
            move = ModelMove("delay", "torque not late", state.current.choice, choice)
            taken = Step(move, cost, after.error, {})
            state = State(after, (*state.steps, taken))
            yield state
    return state


def _needless(
    evaluator: Evaluator, start: Evaluated, current: Evaluated, kind: str
) -> tuple[int, ...]:
    """Return the joints that a kind of term does not help, with fixed bodies."""
    choice, bodies = current.choice, evaluator.setting.bodies
    names = bodies.robot.joint_names
    coupled = {name for c in choice.couplings for name in (c.first, c.second)}
    able = [
        (row, j)
        for row, j in enumerate(names.index(name) for name in bodies.torque_joints)
        if has_term(choice.drive[j], kind)
        and not has_term(start.choice.drive[j], kind)
        and not (kind == "rotor_inertia" and names[j] in coupled)
    ]
    if not able:
        return ()
    fewer = without(choice, kind, [j for _, j in able])
    base = evaluator.screened(choice, current)
    gains = joint_gains(evaluator.screened(fewer, current), base)
    return tuple(j for row, j in able if not believable(gains[row]))


def proposals(
    evaluator: Evaluator, current: Evaluated, scope: Scope
) -> Iterator[Proposal]:
    """Yield moves with the gain that screening predicts."""
    choice = current.choice
    baseline = evaluator.screened(choice, current)
    yield from _of_terms(evaluator, current, baseline, scope)
    if "masses" not in scope.fixed:
        if choice.masses != "free":
            yield Proposal(mass_move(choice, "free"), None)
    if "least_speed" not in scope.fixed:
        speed = evaluator.samples(choice.motion_cutoff).speed
        for move in row_moves(choice, speed):
            before = evaluator.seen_on(current, move.after)
            after = evaluator.screened(move.after, current)
            yield Proposal(move, gain(before, after).share)
    for move in _other_moves(evaluator, current, scope):
        try:
            after = evaluator.screened(move.after, current)
        except ConsistentIdError:
            continue
        yield Proposal(move, gain(baseline, after).share)


def _other_moves(
    evaluator: Evaluator, current: Evaluated, scope: Scope
) -> Iterator[ModelMove]:
    """Yield the moves other than drive terms, masses and rows."""
    choice, setting = current.choice, evaluator.setting
    shapes = list[ModelMove]()
    known = setting.fading
    if "stribeck_velocity" in scope.fixed:
        known += tuple(filter(None, (d.stribeck_velocity for d in choice.drive)))
    if "velocity_scale" not in scope.fixed:
        for widths in scope.widths:
            shapes += scale_moves(choice, widths, known)
    if "stribeck_velocity" not in scope.fixed and not setting.fading:
        shapes += stribeck_moves(choice)
    speeds = evaluator.samples(choice.motion_cutoff).top_speeds
    yield from (move for move in shapes if stribeck_passed(move, speeds))
    if "coupling" not in scope.fixed:
        names = setting.bodies.robot.joint_names
        pairs = couplings_between(setting.bodies, joint_widths(choice))
        yield from coupling_moves(choice, names, pairs)
    if "motion_cutoff" not in scope.fixed:
        yield from cutoff_moves(choice, scope.cutoffs)
    if "delay" not in scope.fixed:
        yield from delay_moves(choice, fitting_delay(evaluator, current))


def _of_terms(
    evaluator: Evaluator, current: Evaluated, baseline: HeldOut, scope: Scope
) -> Iterator[Proposal]:
    """Yield drive terms for all joints, for joints that they help, and for the best."""
    choice, bodies = current.choice, evaluator.setting.bodies
    names = bodies.robot.joint_names
    measured = [names.index(name) for name in bodies.torque_joints]
    loaded = [names.index(name) for name in evaluator.setting.loaded]
    sloped = [names.index(name) for name in evaluator.setting.sloped]
    before = baseline.squares.sum(axis=0)
    total = max(float(before.sum()), 1e-300)
    speeds = evaluator.samples(choice.motion_cutoff).top_speeds
    for term in term_moves(choice, measured, loaded, sloped, speeds):
        if term.kind in scope.fixed:
            continue
        everywhere = with_drive(choice, term.lacking, term.change)
        after = evaluator.screened(everywhere, current)
        gains = dict(zip(measured, joint_gains(baseline, after), strict=True))
        lost = before - after.squares.sum(axis=0)
        brought = dict(zip(measured, lost, strict=True))
        if scope.everywhere:
            helped = tuple(j for j in term.lacking if gains[j].share > LEAST_HELP)
            best = max(term.lacking, key=lambda j: brought[j])
            offered = [term.lacking, helped, (best,)]
        else:
            helped = tuple(j for j in term.lacking if believable(gains[j]))
            offered = [helped, helped[:1]]
        for joints in dict.fromkeys(offered):
            if joints:
                everyone = joints == tuple(measured)
                where = ", ".join(names[j] for j in joints)
                move = ModelMove(
                    term.kind,
                    f"{term.label} of {'all joints' if everyone else where}",
                    choice,
                    with_drive(choice, joints, term.change),
                )
                yield Proposal(move, sum(brought[j] for j in joints) / total)
