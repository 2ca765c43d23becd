"""The ways in which a choice may be changed, one at a time."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.problems.file import CouplingTable, DriveTable
from consistent_id.problems.model import DEFAULT_DRIVE
from consistent_id.problems.selection.choice import Choice, Masses

TERMS = ("rotor_inertia", "load_friction", "drag", "spring", "friction_slope")
"""Drive terms that are there or not."""

STRIBECK = (3.0, 10.0)
"""Velocities at which friction at rest fades, over the width of the sign's change."""

LEAST_SPEEDS = (0.02, 0.05, 0.1, 0.2)
"""Shares of top speed below which rows may be left out."""

FEWEST_LEFT_OUT = 0.01
"""Share of the rows that a mask has to leave out, to be worth trying."""

LEAST_KEPT = 0.5
"""Share of the rows that has to stay."""


@dataclass(frozen=True, slots=True)
class Move:
    """One change of a choice.

    Parameters
    ----------
    kind : str
        What is changed, such as ``"load_friction"``.
    label : str
        For people.
    before, after : Choice
    """

    kind: str
    label: str
    before: Choice
    after: Choice


def stribeck_velocities(scale: float) -> tuple[float, ...]:
    """Return velocities at which friction at rest may fade."""
    return tuple(float(f"{ratio * scale:.2g}") for ratio in STRIBECK)


def with_drive(
    choice: Choice, places: Iterable[int], change: Callable[[DriveTable], DriveTable]
) -> Choice:
    """Return a choice with some joints' drive changed."""
    drive = list(choice.drive)
    for place in places:
        drive[place] = change(drive[place])
    return replace(choice, drive=tuple(drive))


def setter(**values: object) -> Callable[[DriveTable], DriveTable]:
    """Return what sets keys of a drive table."""

    def change(table: DriveTable) -> DriveTable:
        return msgspec.structs.replace(table, **values)

    return change


@dataclass(frozen=True, slots=True)
class TermMove:
    """A drive term that may be given to joints that lack it, all or some of them."""

    kind: str
    label: str
    lacking: tuple[int, ...]
    change: Callable[[DriveTable], DriveTable]


def term_moves(
    choice: Choice,
    measured: Sequence[int],
    loaded: Sequence[int],
    sloped: Sequence[int],
) -> Iterator[TermMove]:
    """Yield drive terms that some joints lack.

    Parameters
    ----------
    measured, loaded, sloped : sequence of int
        Places of joints with torque, of those whose load is known, and of those whose
        friction may vary with position.
    """
    special = {"load_friction": loaded, "friction_slope": sloped}
    for name in TERMS:
        able = special.get(name, measured)
        lacking = tuple(j for j in able if not getattr(choice.drive[j], name))
        if lacking:
            yield TermMove(name, name, lacking, setter(**{name: True}))
    symmetric = tuple(j for j in measured if not choice.drive[j].asymmetric)
    if symmetric:
        change = setter(asymmetric=True, offset=False)
        yield TermMove("asymmetric", "asymmetric", symmetric, change)
    plain = tuple(j for j in measured if choice.drive[j].stribeck_velocity is None)
    for velocity in stribeck_velocities(velocity_scale(choice)) if plain else ():
        label = f"stribeck_velocity = {velocity:g}"
        change = setter(stribeck_velocity=velocity)
        yield TermMove("stribeck_velocity", label, plain, change)


def velocity_scale(choice: Choice) -> float:
    """Return the width of friction's change of sign, [rad/s or m/s]."""
    scales = (d.velocity_scale for d in choice.drive if d.velocity_scale is not None)
    return float(next(scales, DEFAULT_DRIVE.velocity_scale))


def scale_moves(choice: Choice, scales: Sequence[float]) -> Iterator[Move]:
    """Yield other widths of friction's change of sign."""
    for scale in scales:
        if scale == velocity_scale(choice):
            continue

        def change(table: DriveTable, scale: float = scale) -> DriveTable:
            if table.velocity_scale is None:
                return table
            values: dict[str, object] = {"velocity_scale": scale}
            if table.stribeck_velocity is not None:
                ratio = table.stribeck_velocity / table.velocity_scale
                values["stribeck_velocity"] = float(f"{ratio * scale:.2g}")
            return setter(**values)(table)

        after = with_drive(choice, range(len(choice.drive)), change)
        couplings = tuple(
            msgspec.structs.replace(c, velocity_scale=scale) for c in choice.couplings
        )
        yield Move(
            "velocity_scale",
            f"velocity_scale = {scale:g}",
            choice,
            replace(after, couplings=couplings),
        )


def row_moves(choice: Choice, speed: Vector) -> Iterator[Move]:
    """Yield shares of top speed below which rows are left out.

    Parameters
    ----------
    speed : ndarray, shape (samples,)
        Of all rows; a mask leaves out a few of them, and not most.
    """
    now = choice.least_speed or 0.0
    kept = float(np.mean(speed >= now))
    for share in LEAST_SPEEDS:
        left = float(np.mean(speed >= share))
        if share > now and LEAST_KEPT <= left <= (1.0 - FEWEST_LEFT_OUT) * kept:
            after = replace(choice, least_speed=share)
            yield Move("least_speed", f"least_speed = {share:g}", choice, after)


def mass_move(choice: Choice, masses: Masses) -> Move:
    """Return the move to other masses."""
    after = replace(choice, masses=masses)
    return Move("masses", f'masses = "{masses}"', choice, after)


def coupling_moves(
    choice: Choice, names: Sequence[str], pairs: Sequence[CouplingTable]
) -> Iterator[Move]:
    """Yield couplings of neighbours; their joints need a rotor of their own."""
    used = {c.first for c in choice.couplings}
    for pair in pairs:
        if pair.first in used:
            continue
        joints = [names.index(name) for name in (pair.first, pair.second)]
        scale = velocity_scale(choice)
        after = with_drive(choice, joints, setter(rotor_inertia=True))
        pair = msgspec.structs.replace(pair, velocity_scale=scale)
        after = replace(after, couplings=(*choice.couplings, pair))
        label = f"coupling of {pair.first} and {pair.second}"
        yield Move("coupling", label, choice, after)


def removals(choice: Choice, made: Move) -> Iterator[Move]:
    """Yield the move that takes back what another one gave, if it still stands."""
    if made.kind not in _WITHOUT:
        return
    was = made.before.drive
    places = [
        place
        for place, (before, after) in enumerate(zip(was, made.after.drive, strict=True))
        if before != after and choice.drive[place] != before
    ]
    coupled = {name for c in choice.couplings for name in (c.first, c.second)}
    if made.kind == "rotor_inertia" and coupled:
        return
    after = with_drive(choice, places, setter(**_WITHOUT[made.kind]))
    if after != choice:
        yield Move(made.kind, f"without {made.label}", choice, after)


_WITHOUT: dict[str, dict[str, object]] = {
    **{name: {name: False} for name in TERMS},
    "stribeck_velocity": {"stribeck_velocity": None},
    "asymmetric": {"asymmetric": False, "offset": True},
}
