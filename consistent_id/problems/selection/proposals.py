"""Moves from one model to the next, with the gains that screening predicts."""

from collections.abc import Iterator
from dataclasses import dataclass

from consistent_id.problems.selection.choice import (
    ModelMove,
    coupling_moves,
    cutoff_moves,
    delay_moves,
    mass_move,
    row_moves,
    scale_moves,
    stribeck_moves,
    stribeck_passed,
    term_moves,
    velocity_scale,
    with_drive,
)
from consistent_id.problems.selection.evaluation import (
    Evaluated,
    Evaluator,
    fitting_delay,
)
from consistent_id.problems.selection.fits import Gain, HeldOut, gain, joint_gains
from consistent_id.problems.selection.superset import couplings_between

LEAST_HELP = 0.025
"""Least relative decrease of a joint's own squared error by a term that helps it."""

LEAST_WON = 0.6
"""Least share of the blocks on which a move lowers the error."""

SURE = 2.0
"""Standard errors by which a term must help a joint, if its gain is small."""

PLAIN = 0.25
"""Gain in a joint's own squared error from which a term is kept for the joint, even if
the gain is uneven over the blocks.
"""


@dataclass(frozen=True, slots=True)
class Scope:
    """The scope of a search: kinds of moves, and the values to try.

    Parameters
    ----------
    fixed : frozenset of str
        Kinds that must not change, such as ``"masses"``.
    scales : tuple of float
        Widths of friction's change of sign.
    cutoffs : tuple of float, [Hz]
        Cut-offs of the motion, ascending.
    everywhere : bool
        Whether a drive term is also tried for all joints without it, and not only for
        joints that it helps.
    """

    fixed: frozenset[str]
    scales: tuple[float, ...]
    cutoffs: tuple[float, ...]
    everywhere: bool = True


@dataclass(frozen=True, slots=True)
class Proposal:
    """A move, and the gain that screening predicts; None if it cannot predict one."""

    move: ModelMove
    hoped: float | None


def believable(brought: Gain) -> bool:
    """Return whether a term helps a joint, from its own errors on blocks left out.

    The gain must be `LEAST_HELP` of the joint's squared error, on most blocks, and
    `SURE` standard errors or `PLAIN`.
    """
    sure = brought.share >= min(SURE * brought.error, PLAIN)
    return sure and brought.share >= LEAST_HELP and brought.won >= LEAST_WON


def proposals(evaluator: Evaluator, current: Evaluated, scope: Scope) -> list[Proposal]:
    """Return moves with the gain that screening predicts."""
    choice = current.choice
    shapes = _shape_moves(evaluator, current, scope)
    cutoffs = list[ModelMove]()
    if "motion_cutoff" not in scope.fixed:
        cutoffs = list(cutoff_moves(choice, scope.cutoffs))
    # Moves that need other rows take longest: another process may screen them.
    far = [m for m in shapes if m.kind == "velocity_scale"] + cutoffs
    far_errors = evaluator.screened_beside([m.after for m in far], current)
    baseline = evaluator.screened(choice, current)
    found = list(_of_terms(evaluator, current, baseline, scope))
    if "masses" not in scope.fixed:
        if choice.masses != "free":
            found.append(Proposal(mass_move(choice, "free"), None))
    if "least_speed" not in scope.fixed:
        speed = evaluator.samples(choice.motion_cutoff).speed
        for move in row_moves(choice, speed):
            before = evaluator.seen_on(current, move.after)
            masked = evaluator.screened(move.after, current)
            found.append(Proposal(move, gain(before, masked).share))
    delays = list[ModelMove]()
    if "delay" not in scope.fixed:
        delays = list(delay_moves(choice, fitting_delay(evaluator, current)))
    others = [*shapes, *_coupling_moves(evaluator, current, scope), *cutoffs, *delays]
    near = [m.after for m in others if m not in far]
    errors = dict(zip(near, evaluator.screened_all(near, current), strict=True))
    errors |= zip((m.after for m in far), far_errors(), strict=True)
    for move in others:
        after = errors[move.after]
        if after is not None:
            found.append(Proposal(move, gain(baseline, after).share))
    return found


def _shape_moves(
    evaluator: Evaluator, current: Evaluated, scope: Scope
) -> list[ModelMove]:
    """Return moves to other shapes of friction near rest."""
    choice = current.choice
    shapes = list[ModelMove]()
    if "velocity_scale" not in scope.fixed:
        shapes += scale_moves(choice, scope.scales)
    if "stribeck_velocity" not in scope.fixed:
        shapes += stribeck_moves(choice)
    speeds = evaluator.samples(choice.motion_cutoff).top_speeds
    return [move for move in shapes if stribeck_passed(move, speeds)]


def _coupling_moves(
    evaluator: Evaluator, current: Evaluated, scope: Scope
) -> Iterator[ModelMove]:
    """Yield moves to models with coupled gears."""
    choice, bodies = current.choice, evaluator.setting.bodies
    if "coupling" not in scope.fixed:
        names = bodies.robot.joint_names
        pairs = couplings_between(bodies, velocity_scale(choice))
        yield from coupling_moves(choice, names, pairs)


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
