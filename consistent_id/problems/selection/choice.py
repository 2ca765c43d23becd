"""Choices of a model, and the moves that change one.

A choice consists of drive terms, masses, cut-offs, rows and a delay.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import ProblemError
from consistent_id.problems.file import (
    CouplingTable,
    DataTable,
    DriveTable,
    JointTable,
    LinkTable,
    ProblemTable,
)
from consistent_id.problems.parameter_tables import exceptions
from consistent_id.problems.stated_model import DEFAULT_DRIVE
from consistent_id.robot.model import RobotModel

Masses = Literal["datasheet", "bounds", "free"]

BOUNDS = (0.5, 2.0)
"""Bounds of a bounded mass over the model's.  A designer's estimate of a casting, a
motor and its cables is right within a factor of two.
"""

TERMS = ("rotor_inertia", "load_friction", "drag", "spring", "friction_slope")
"""Drive terms that are there or not."""

STRIBECK = (2.5, 5.0, 10.0, 20.0)
"""Stribeck velocities to try, over the width of friction's change of sign."""

STRIBECK_PASSED = 2.0
"""Least top speed of a joint over its Stribeck velocity.  There the term has fallen to
exp(-4), 2 %.  In slower motion it does not end, so it is one more curve through the
speeds of the log, with Coulomb friction, viscous friction and drag; nothing in the log
shows where these lead at higher speeds.
"""

LEAST_SPEEDS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
"""Shares of top speed to try as thresholds below which rows are left out."""

FEWEST_LEFT_OUT = 0.01
"""Least share of the rows that a mask must leave out to be worth trying."""

LEAST_KEPT = 0.5
"""Least share of the rows that must stay."""

_EVERYWHERE = ("rotor_inertia", "load_friction", "drag", "stribeck_velocity")

_WITHOUT: dict[str, dict[str, object]] = {
    **{name: {name: False} for name in TERMS},
    "stribeck_velocity": {"stribeck_velocity": None},
    "asymmetric": {"asymmetric": False, "offset": True},
}

REMOVABLE = tuple(_WITHOUT)
"""Kinds of drive terms that may be removed again, joint by joint."""


@dataclass(frozen=True, slots=True)
class Choice:
    """One model of a robot and its log.

    Parameters
    ----------
    drive : tuple of DriveTable
        One table for each joint, in the robot's order; empty without torque.
    masses : {"datasheet", "bounds", "free"}
    motion_cutoff, torque_cutoff : float, optional, [Hz]
    least_speed : float, optional
        Share of top speed below which rows are left out.
    delay : float, [s]
        Delay of the torque.
    decimate : int
        Step between samples that are kept.
    """

    drive: tuple[DriveTable, ...]
    couplings: tuple[CouplingTable, ...] = ()
    masses: Masses = "datasheet"
    motion_cutoff: float | None = None
    torque_cutoff: float | None = None
    least_speed: float | None = None
    delay: float = 0.0
    decimate: int = 1


def data_of(table: ProblemTable) -> DataTable:
    """Return a problem file's table of recordings.

    Raises
    ------
    ProblemError
        If it has none.
    """
    if table.data is None:
        raise ProblemError(
            f"problem {table.name!r} has no recordings; a model is chosen from those "
            "for training: add a [data] table"
        )
    return table.data


def applied(table: ProblemTable, choice: Choice, robot: RobotModel) -> ProblemTable:
    """Return a problem file's content with another choice.

    Parameters
    ----------
    table : ProblemTable
        A table with recordings.
    robot : RobotModel
        The file's robot.
    """
    replace = msgspec.structs.replace
    data = data_of(table)
    common, joints = _joint_tables(table, choice, robot)
    preparation = data.preparation
    if preparation.method == "butterworth":
        preparation = replace(preparation, motion_cutoff=choice.motion_cutoff)
    delays = preparation.delays | {"torque": choice.delay}
    if not choice.delay:
        del delays["torque"]
    preparation = replace(
        preparation,
        torque_cutoff=choice.torque_cutoff,
        least_speed=choice.least_speed,
        delays=delays,
        decimate=choice.decimate,
    )
    return replace(
        table,
        drive=common,
        joints=joints,
        couplings=list(choice.couplings),
        links=_link_tables(table, choice, robot),
        constraints=replace(
            table.constraints,
            masses=choice.masses,
            shared_motors=bool(choice.couplings),
        ),
        data=replace(data, preparation=preparation),
    )


def _joint_tables(
    table: ProblemTable, choice: Choice, robot: RobotModel
) -> tuple[DriveTable, dict[str, JointTable]]:
    """Return the drive that most joints have, and tables of the others."""
    measured = data_of(table).torque_joints
    names = robot.joint_names
    by_joint = dict(zip(names, choice.drive, strict=True))
    counted = Counter(by_joint[name] for name in names if name in (measured or names))
    common = counted.most_common(1)[0][0]
    joints = {}
    for name in names:
        known = table.joints.get(name)
        motor = (
            {}
            if known is None
            else {"gear_ratio": known.gear_ratio, "motor_inertia": known.motor_inertia}
        )
        own = (
            {}
            if measured and name not in measured
            else exceptions(by_joint[name], common)
        )
        if own or any(v is not None for v in motor.values()):
            joints[name] = JointTable(**own, **motor)
    return common, joints


def _link_tables(
    table: ProblemTable, choice: Choice, robot: RobotModel
) -> Mapping[str, LinkTable]:
    """Return tables of links, with bounds of masses if the choice has them."""
    if choice.masses != "bounds":
        return table.links
    links = dict(table.links)
    for link in robot.links:
        sheet = link.datasheet
        if sheet.mass_bounds is None and sheet.mass is not None:
            low, high = (float(f"{ratio * sheet.mass:.4g}") for ratio in BOUNDS)
            links[link.name] = msgspec.structs.replace(
                links.get(link.name, LinkTable()), mass_bounds=(low, high)
            )
    return links


@dataclass(frozen=True, slots=True)
class ModelMove:
    """One change of a choice.

    Parameters
    ----------
    kind : str
        The changed setting, such as ``"load_friction"``.
    label : str
        Name of the change for people.
    before, after : Choice
    """

    kind: str
    label: str
    before: Choice
    after: Choice


def size_of(move: ModelMove) -> float:
    """Return the size of a move: among similar gains the smallest change is made.

    A term that every drive has is simplest for all joints, a spring for one joint.
    """
    if move.kind == "masses":
        return {"bounds": 100.0, "free": 200.0}[move.after.masses]
    if move.kind in ("spring", "asymmetric", "coupling", *_EVERYWHERE):
        pairs = zip(move.before.drive, move.after.drive, strict=True)
        changed = sum(a != b for a, b in pairs)
        return float(-changed if move.kind in _EVERYWHERE else changed)
    if move.kind == "least_speed":
        return move.after.least_speed or 0.0
    return -100.0  # another value of an existing setting


def stribeck_velocities(scale: float) -> tuple[float, ...]:
    """Return Stribeck velocities to try."""
    return tuple(float(f"{ratio * scale:.2g}") for ratio in STRIBECK)


def nearest_stribeck(velocity: float, scale: float) -> float:
    """Return the Stribeck velocity to try that is nearest to a given one."""
    return min(stribeck_velocities(scale), key=lambda v: abs(np.log(v / velocity)))


def with_drive(
    choice: Choice, places: Iterable[int], change: Callable[[DriveTable], DriveTable]
) -> Choice:
    """Return a choice with some joints' drive changed."""
    drive = list(choice.drive)
    for place in places:
        drive[place] = change(drive[place])
    return replace(choice, drive=tuple(drive))


def setter(**values: object) -> Callable[[DriveTable], DriveTable]:
    """Return a function that sets keys of a drive table."""

    def change(table: DriveTable) -> DriveTable:
        return msgspec.structs.replace(table, **values)

    return change


@dataclass(frozen=True, slots=True)
class TermMove:
    """A drive term that all or some of the joints without it may get."""

    kind: str
    label: str
    lacking: tuple[int, ...]
    change: Callable[[DriveTable], DriveTable]


def term_moves(
    choice: Choice,
    measured: Sequence[int],
    loaded: Sequence[int],
    sloped: Sequence[int],
    speeds: Vector,
) -> Iterator[TermMove]:
    """Yield drive terms that some joints lack.

    Parameters
    ----------
    measured, loaded, sloped : sequence of int
        Places of the joints with torque, of the joints with a known load, and of the
        joints whose friction may vary with position.
    speeds : ndarray, shape (joints,), [rad/s or m/s]
        Top speed of each joint of the robot.
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
    for own in _stribeck_tried(choice):
        for velocity in dict.fromkeys(own[j] for j in plain):
            least = STRIBECK_PASSED * velocity
            same = (j for j in plain if own[j] == velocity and speeds[j] >= least)
            if passing := tuple(same):
                label = f"stribeck_velocity = {velocity:g}"
                change = setter(stribeck_velocity=velocity)
                yield TermMove("stribeck_velocity", label, passing, change)


def _stribeck_tried(choice: Choice) -> list[tuple[float, ...]]:
    """Return the Stribeck velocities to try, each of every joint."""
    widths = joint_widths(choice)
    return list(zip(*map(stribeck_velocities, widths), strict=True))


def velocity_scale(choice: Choice) -> float:
    """Return the width of friction's change of sign of the first joint with friction.

    In rad/s or m/s; that of all joints, unless some turn and others slide.
    """
    scales = (d.velocity_scale for d in choice.drive if d.velocity_scale is not None)
    return float(next(scales, DEFAULT_DRIVE.velocity_scale))


def joint_widths(choice: Choice) -> tuple[float, ...]:
    """Return the width of friction's change of sign of each joint, [rad/s or m/s]."""
    usual = velocity_scale(choice)
    return tuple(float(drive.velocity_scale or usual) for drive in choice.drive)


class Widths(NamedTuple):
    """Widths of friction's change of sign to try for joints of one kind.

    Parameters
    ----------
    joints : tuple of int
    names : tuple of str
        Of these joints.
    scales : tuple of float, [rad/s or m/s]
    which : str
        The end of a move's label, such as ``" of sliding joints"``.
    """

    joints: tuple[int, ...]
    names: tuple[str, ...]
    scales: tuple[float, ...]
    which: str = ""


def scale_moves(
    choice: Choice, widths: Widths, fading: Sequence[float] = ()
) -> Iterator[ModelMove]:
    """Yield other widths of friction's change of sign.

    Stribeck velocities become the nearest that are tried with a width, if they are not
    among those of `fading`.
    """
    for scale in widths.scales:
        after = choice
        for j in widths.joints:
            own = partial(_with_width, width=scale, fading=fading)
            after = with_drive(after, [j], own)
        couplings = tuple(
            msgspec.structs.replace(c, velocity_scale=scale)
            if c.first in widths.names
            else c
            for c in choice.couplings
        )
        after = replace(after, couplings=couplings)
        if after != choice:
            label = f"velocity_scale = {scale:g}{widths.which}"
            yield ModelMove("velocity_scale", label, choice, after)


def _with_width(table: DriveTable, width: float, fading: Sequence[float]) -> DriveTable:
    """Return a joint's drive with another width of friction, if it has one."""
    if table.velocity_scale is None:
        return table
    values: dict[str, object] = {"velocity_scale": width}
    velocity = table.stribeck_velocity
    if velocity is not None and velocity not in fading:
        values["stribeck_velocity"] = nearest_stribeck(velocity, width)
    return setter(**values)(table)


def stribeck_moves(choice: Choice) -> Iterator[ModelMove]:
    """Yield other Stribeck velocities, if a joint has that term."""
    places = [j for j, d in enumerate(choice.drive) if d.stribeck_velocity is not None]
    for own in _stribeck_tried(choice):
        after = choice
        for j in places:
            after = with_drive(after, [j], setter(stribeck_velocity=own[j]))
        if after != choice:
            shown = " or ".join(dict.fromkeys(f"{own[j]:g}" for j in places))
            label = f"stribeck_velocity = {shown} where there is one"
            yield ModelMove("stribeck_value", label, choice, after)


def stribeck_passed(move: ModelMove, speeds: Vector) -> bool:
    """Return whether joints pass the Stribeck velocities that a move gives them.

    Parameters
    ----------
    speeds : ndarray, shape (joints,), [rad/s or m/s]
        Top speed of each joint of the robot.
    """
    for before, after, top in zip(
        move.before.drive, move.after.drive, speeds, strict=True
    ):
        velocity = after.stribeck_velocity
        if velocity is not None and velocity != before.stribeck_velocity:
            if top < STRIBECK_PASSED * velocity:
                return False
    return True


def row_moves(choice: Choice, speed: Vector) -> Iterator[ModelMove]:
    """Yield shares of top speed below which rows are left out.

    Parameters
    ----------
    speed : ndarray, shape (samples,)
        Speed at each row. A mask leaves out some of the rows, but not most.
    """
    now = choice.least_speed or 0.0
    kept = float(np.mean(speed >= now))
    for share in LEAST_SPEEDS:
        left = float(np.mean(speed >= share))
        if share > now and LEAST_KEPT <= left <= (1.0 - FEWEST_LEFT_OUT) * kept:
            after = replace(choice, least_speed=share)
            yield ModelMove("least_speed", f"least_speed = {share:g}", choice, after)


def mass_move(choice: Choice, masses: Masses) -> ModelMove:
    """Return the move to other masses."""
    after = replace(choice, masses=masses)
    return ModelMove("masses", f'masses = "{masses}"', choice, after)


def cutoff_moves(choice: Choice, cutoffs: Sequence[float]) -> Iterator[ModelMove]:
    """Yield other cut-offs of the motion."""
    for cutoff in cutoffs:
        if cutoff != choice.motion_cutoff:
            after = replace(choice, motion_cutoff=cutoff)
            label = f"motion_cutoff = {cutoff:g}"
            yield ModelMove("motion_cutoff", label, choice, after)


def delay_moves(choice: Choice, delay: float) -> Iterator[ModelMove]:
    """Yield another delay of the torque, if it is another."""
    if delay != choice.delay:
        late = f"{'late' if delay >= 0.0 else 'early'} by {1e3 * abs(delay):.3g} ms"
        after = replace(choice, delay=delay)
        yield ModelMove("delay", f"torque {late}", choice, after)


def coupling_moves(
    choice: Choice, names: Sequence[str], pairs: Sequence[CouplingTable]
) -> Iterator[ModelMove]:
    """Yield couplings of neighbours; their joints need rotor inertias of their own."""
    used = {c.first for c in choice.couplings}
    for pair in pairs:
        if pair.first in used:
            continue
        joints = [names.index(name) for name in (pair.first, pair.second)]
        after = with_drive(choice, joints, setter(rotor_inertia=True))
        after = replace(after, couplings=(*choice.couplings, pair))
        label = f"coupling of {pair.first} and {pair.second}"
        yield ModelMove("coupling", label, choice, after)


def removals(choice: Choice, made: ModelMove) -> Iterator[ModelMove]:
    """Yield the move that undoes another one, if its effect is still there."""
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
    after = without(choice, made.kind, places)
    if after != choice:
        yield ModelMove(made.kind, f"without {made.label}", choice, after)


def without(choice: Choice, kind: str, places: Iterable[int]) -> Choice:
    """Return a choice without one kind of drive term on some joints."""
    return with_drive(choice, places, setter(**_WITHOUT[kind]))


def has_term(table: DriveTable, kind: str) -> bool:
    """Return whether a joint has a kind of drive term that may be removed again."""
    value = getattr(table, kind)
    return value is not None and value is not False
