"""Moves from a choice, with what screening promises of each."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from consistent_id.errors import ConsistentIdError
from consistent_id.problems.selection.evaluation import Evaluated, Evaluator
from consistent_id.problems.selection.held_out import HeldOut, gain
from consistent_id.problems.selection.moves import (
    Move,
    coupling_moves,
    mass_move,
    row_moves,
    scale_moves,
    term_moves,
    velocity_scale,
    with_drive,
)
from consistent_id.problems.selection.screening import torque_delay
from consistent_id.problems.selection.superset import couplings_between

LEAST_HELP = 0.025
"""Share of a joint's own squared error that a term takes away where it helps."""

_DELAYS = 4  # first-order steps of a delay, at the most


@dataclass(frozen=True, slots=True)
class Scope:
    """What may be chosen: kinds of moves, and the values to try.

    Parameters
    ----------
    fixed : frozenset of str
        Kinds that are not to be changed, such as ``"masses"``.
    scales : tuple of float
        Widths of friction's change of sign.
    cutoffs : tuple of float, [Hz]
        Of the motion, ascending.
    """

    fixed: frozenset[str]
    scales: tuple[float, ...]
    cutoffs: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Proposal:
    """A move, and the gain that screening promises; None where it cannot tell."""

    move: Move
    hoped: float | None


def proposals(
    evaluator: Evaluator, current: Evaluated, scope: Scope
) -> Iterator[Proposal]:
    """Yield moves with the gain that screening promises."""
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
) -> Iterator[Move]:
    """Yield the moves other than drive terms, masses and rows."""
    choice, setting = current.choice, evaluator.setting
    if "velocity_scale" not in scope.fixed:
        yield from scale_moves(choice, scope.scales)
    if "coupling" not in scope.fixed:
        names = setting.bodies.robot.joint_names
        pairs = couplings_between(setting.bodies, velocity_scale(choice))
        yield from coupling_moves(choice, names, pairs)
    if "motion_cutoff" not in scope.fixed:
        for cutoff in scope.cutoffs:
            if cutoff != choice.motion_cutoff:
                after = replace(choice, motion_cutoff=cutoff)
                yield Move(
                    "motion_cutoff", f"motion_cutoff = {cutoff:g}", choice, after
                )
    if "delay" not in scope.fixed:
        delay = _delay(evaluator, current)
        if delay != choice.delay:
            after = replace(choice, delay=delay)
            yield Move("delay", f"torque late by {1e3 * delay:.3g} ms", choice, after)


def _delay(evaluator: Evaluator, current: Evaluated) -> float:
    """Return the delay at which torque seems to be late no more [s], to two digits."""
    setting, candidate = evaluator.setting, current.fits.candidate
    choice = current.choice
    for _ in range(_DELAYS):
        factors = evaluator.factors(choice)
        late = torque_delay(candidate, factors, setting.base, setting.sigma)
        delay = float(f"{choice.delay + late:.2g}")
        if delay == choice.delay:
            break
        choice = replace(choice, delay=delay)
    return choice.delay


def _of_terms(
    evaluator: Evaluator, current: Evaluated, baseline: HeldOut, scope: Scope
) -> Iterator[Proposal]:
    """Yield drive terms: for all joints, for those that they help, for the best."""
    choice, bodies = current.choice, evaluator.setting.bodies
    names = bodies.robot.joint_names
    measured = [names.index(name) for name in bodies.torque_joints]
    loaded = [names.index(name) for name in evaluator.setting.loaded]
    sloped = [names.index(name) for name in evaluator.setting.sloped]
    before = baseline.squares.sum(axis=0)
    total = max(float(before.sum()), 1e-300)
    for term in term_moves(choice, measured, loaded, sloped):
        if term.kind in scope.fixed:
            continue
        everywhere = with_drive(choice, term.lacking, term.change)
        after = evaluator.screened(everywhere, current).squares.sum(axis=0)
        brought = dict(zip(measured, before - after, strict=True))
        own = dict(zip(measured, before, strict=True))
        helped = tuple(j for j in term.lacking if brought[j] > LEAST_HELP * own[j])
        best = max(term.lacking, key=lambda j: brought[j])
        for joints in dict.fromkeys((term.lacking, helped, (best,))):
            if joints:
                everyone = joints == tuple(measured)
                where = ", ".join(names[j] for j in joints)
                move = Move(
                    term.kind,
                    f"{term.label} of {'all joints' if everyone else where}",
                    choice,
                    with_drive(choice, joints, term.change),
                )
                yield Proposal(move, sum(brought[j] for j in joints) / total)
