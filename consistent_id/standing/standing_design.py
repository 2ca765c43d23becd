"""The search for a trunk's path that identifies its ten parameters best, its files."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.files import together, write_atomically
from consistent_id._support.run import noted_interrupts
from consistent_id._support.tables import Table, brief
from consistent_id.errors import InfeasibleError, NotExcitedError, ProblemError
from consistent_id.motion.files.robot_formats import message_of
from consistent_id.motion.files.trajectory_file import csv_of
from consistent_id.recordings.recording import Recording
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.contact_free import (
    contact_free_model,
    contact_free_regression,
)
from consistent_id.report.plot import draw_figure
from consistent_id.robot.inertia import INERTIAL_NAMES, InertialParameters
from consistent_id.robot.parameters import did_you_mean
from consistent_id.standing.forces_and_limits import (
    StandingLimits,
    StandingMotion,
    nominal_of,
    standing_motion,
)
from consistent_id.standing.stance import Stance, joint_motion
from consistent_id.standing.trunk_path import (
    COORDINATES,
    HIGHEST,
    NOTHING_FOUND,
    Tried,
    TrunkPath,
    searched_tones,
)

REST = 0.03
"""rad/s or m/s, below which a joint's torque is not used: at rest, dry friction has any
value that balances it (`without_rests`; benchmarks/quadruped.py: with such joints the
moments of G1's torso are 6 % off, without them 1 %).
"""

_THIN = 0.01  # m; no trunk is thinner, whatever a file says


CHECK_RATE = 500.0
"""Hz, at which limits of the final motion are looked at."""

_CORRELATED = 0.1, 0.35  # s, of noise on real robots

_PER_PERIOD = 4  # samples per period of the fastest sinusoid in the search
_TRIES = 10  # times that a candidate's amplitude is put right
_USED = 0.88, 0.99  # share of the tightest limit that a candidate uses

_UNITS = ("kg", *["kg m"] * 3, *["kg m^2"] * 6)
NAMES = ("standing.csv", "standing.yaml", "standing.png", "standing.json")


@brief
@dataclass(frozen=True, slots=True, eq=False)
class StandingDesign:
    """A motion on feet that was searched for.

    Attributes
    ----------
    stance : Stance
    model : TorqueModel
    limits : StandingLimits
    path : TrunkPath
    link : str
        The trunk: the body that is not known.
    errors : ndarray, shape (10,)
        Standard errors of its parameters for torque noise of 1 N m, all other bodies
        being known: of `INERTIAL_NAMES`.
    first : float
        How many times larger the `relative_size` of the errors was on the best random
        path.
    checked : StandingMotion
        At `CHECK_RATE`.
    candidates : int
        Paths that were tried.
    seconds : float
        Processor time.
    cut_short : str
        The reason why the search ended before all candidates were tried; empty without.
    """

    stance: Stance
    model: TorqueModel
    limits: StandingLimits
    path: TrunkPath
    link: str
    errors: Vector
    first: float
    checked: StandingMotion
    candidates: int
    seconds: float
    cut_short: str = ""

    def recording(self, rate: float) -> Recording:
        """Return the joints' motion at a rate [Hz]."""
        time = np.linspace(0, self.path.duration, round(self.path.duration * rate) + 1)
        moved = joint_motion(self.stance, self.path.motion(time, self._gravity))
        names = self.stance.robot.joint_names
        return Recording(names, time, moved.q, moved.dq, moved.ddq, name="standing")

    @property
    def _gravity(self) -> Vector:
        return np.asarray(self.stance.robot.gravity)


@single_threaded
def design_standing(
    stance: Stance,
    model: TorqueModel,
    limits: StandingLimits | None = None,
    *,
    link: str | None = None,
    duration: float = 20.0,
    candidates: int = 320,
    seed: int = 0,
    time_limit: float = np.inf,
    tell: Callable[[int, float], None] | None = None,
) -> StandingDesign:
    """Search for the motion of a trunk over standing feet that identifies it best.

    The search minimises the root mean square of the standard errors of the trunk's ten
    parameters, relative to its own size (`relative_size`; A-optimality), of paths that
    are as large as their limits allow; see `searched_tones`.

    Parameters
    ----------
    stance : Stance
    model : TorqueModel
        Model whose drive terms are unknown beside the trunk.
    limits : StandingLimits, optional
    link : str, optional
        The body that is not known, such as a torso above the base; by default the base.
    duration : float, [s]
    candidates : int
        How many paths are tried.
    seed : int
    time_limit : float, [s]
        Processor time after which the search ends with the best path so far; without
        any, it goes on for as long again.  An interrupt and a SIGTERM end it in the
        same way, at once.
    tell : callable, optional
        Given how many candidates were tried, and the least size of errors so far.

    Raises
    ------
    InfeasibleError
        If the robot cannot stand in the pose, or not move in it.
    KeyboardInterrupt
        If the user ended the search before any path was found.
    """
    started = process_time()
    chosen = StandingLimits() if limits is None else limits
    samples = int(_PER_PERIOD * HIGHEST * duration)
    time = duration * (np.arange(samples) + 0.5) / samples
    number = link_number(stance, link)
    _require_stance(stance, chosen, duration)

    trial = _Trial(stance, model, chosen, time, number)

    def used() -> float:
        return process_time() - started

    found = NOTHING_FOUND
    with noted_interrupts(keeps_results=True) as interrupted:
        for found in searched_tones(trial.tried, duration, candidates, seed):
            if tell is not None:
                tell(found.count, found.best.error)
            allowed = time_limit * (1 if found.best.path is not None else 2)
            if interrupted() or used() > allowed:
                break
        stopped = interrupted()
    cut_short = ""
    if found.count < candidates:
        cut_short = "an interrupt" if stopped else f"the time limit of {time_limit:g} s"
    if found.best.path is None and stopped:
        raise KeyboardInterrupt
    if found.best.path is None:
        ended = ""
        if cut_short:
            ended = (
                f"{2 * time_limit:g} s, twice the time limit, ended the search after "
                f"{found.count} of {candidates} paths: "
            )
        raise InfeasibleError(
            f"{ended}none of {found.count} paths of the trunk keeps its limits; allow "
            "more velocity or friction, "
            "choose a pose further from stretched legs, or a longer duration"
        )
    motion, path = _checked(stance, chosen, found.best.path)
    return StandingDesign(
        stance=stance,
        model=model,
        limits=chosen,
        path=path,
        link=stance.robot.link_names[number],
        errors=trunk_errors(stance, model, motion, CHECK_RATE, link),
        first=found.first / found.best.error,
        checked=motion,
        candidates=found.count,
        seconds=used(),
        cut_short=cut_short,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """The trial of paths of the trunk, at some times.

    Parameters
    ----------
    time : ndarray, shape (samples,), [s]
    number : int
        The link that is not known.
    """

    stance: Stance
    model: TorqueModel
    limits: StandingLimits
    time: Vector
    number: int

    def tried(self, path: TrunkPath) -> Tried:
        """Return a candidate that uses its limits, and its error."""
        for _ in range(_TRIES):
            motion = standing_motion(self.stance, self.limits, path, self.time)
            share = motion.largest
            if _USED[0] <= share <= _USED[1]:
                break
            path = path.scaled(0.5 if not share < 50.0 else 0.95 / share**0.9)
        if not motion.largest <= _USED[1]:
            return Tried(None, np.inf)
        try:
            factor = trunk_factor(self.stance, self.model, motion, self.number)
        except NotExcitedError:
            return Tried(None, np.inf)
        errors = np.linalg.norm(np.linalg.inv(factor), axis=1)
        nominal = nominal_of(self.stance.robot).reshape(-1, 10)[self.number]
        return Tried(path, relative_size(errors, InertialParameters(nominal)))


def _require_stance(stance: Stance, limits: StandingLimits, duration: float) -> None:
    """Refuse a pose in which the robot cannot even stand still."""
    path = TrunkPath(np.ones(1), np.zeros((2, 1, 6)), duration)
    motion = standing_motion(stance, limits, path, np.array([0.5 * duration]))
    if motion.largest > 1.0:
        if motion.joints.singular:
            raise InfeasibleError(
                "a leg is stretched in this pose, and cannot follow the trunk; bend "
                "the knees: --stance JOINT=POSITION ..."
            )
        worst = max(motion.uses, key=lambda use: use.share)
        raise InfeasibleError(
            f"the robot cannot stand still in this pose: {worst.what} of {worst.of} is "
            f"{worst.share:.0%} of its limit; choose another pose or friction: "
            "--stance, --friction"
        )


def _checked(
    stance: Stance, limits: StandingLimits, path: TrunkPath
) -> tuple[StandingMotion, TrunkPath]:
    """Look at a path densely, and make it smaller as long as that is too much."""
    time = np.linspace(0.0, path.duration, round(path.duration * CHECK_RATE) + 1)
    while True:
        motion = standing_motion(stance, limits, path, time)
        if motion.largest <= 1.0:
            return motion, path
        path = path.scaled(0.98)


def trunk_errors(
    stance: Stance,
    model: TorqueModel,
    motion: StandingMotion,
    rate: float,
    link: str | None = None,
) -> Vector:
    """Return standard errors of the trunk's ten parameters, shape (10,).

    Of `INERTIAL_NAMES`, for torque noise of 1 N m that is white at a rate [Hz]; drive
    terms are unknown, bodies of the other links known.  Rows are those that no force of
    the ground enters, without joints slower than `REST`.  The trunk is a link of the
    robot, by default the base.

    Parameters
    ----------
    stance : Stance
    model : TorqueModel
    motion : StandingMotion
    rate : float, [Hz]
    link : str, optional
        The trunk; by default the base.

    Raises
    ------
    NotExcitedError
        If the motion does not determine all ten.
    """
    factor = trunk_factor(stance, model, motion, link_number(stance, link))
    share = len(motion.time) / (rate * (motion.time[-1] - motion.time[0]))
    inverse = np.linalg.inv(factor)
    return np.asarray(np.sqrt(share) * np.linalg.norm(inverse, axis=1))


def link_number(stance: Stance, link: str | None) -> int:
    """Return which link is to be identified, by default the base."""
    names = stance.robot.link_names
    if link is not None and link not in names:
        near = did_you_mean(link, names)
        raise ProblemError(f"no link {link!r} to identify; {near}")
    return 0 if link is None else names.index(link)


def relative_size(errors: Vector, trunk: InertialParameters) -> float:
    """Return the root mean square of a body's ten errors, relative to its own size.

    With ``m s_i^2 = J_ii``, of its mass and pseudo-inertia, units are ``m``, ``m s_i``
    of first moments, and ``sqrt(I_ii I_jj)`` of moments, ``I_ii = m (s_j^2 + s_k^2)``.
    """
    m = trunk.mass
    squares = np.diagonal(trunk.pseudo_inertia)[:3] / m
    squares = np.maximum(squares, _THIN**2)
    d = np.sqrt(m * (squares.sum() - squares))
    moments = [d[i] * d[j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
    units = np.array([m, *(m * np.sqrt(squares)), *moments])
    return float(np.sqrt(np.mean((errors / units) ** 2)))


def trunk_factor(
    stance: Stance, model: TorqueModel, motion: StandingMotion, number: int
) -> Array:
    """Return the triangle of the trunk's columns, those of drives taken out of them."""
    n, moved = len(motion.time), motion.joints
    log = Recording(
        stance.robot.joint_names,
        motion.time,
        moved.q,
        moved.dq,
        moved.ddq,
        np.zeros_like(moved.q),
        base=motion.trunk.base,
        contacts=stance.contacts(n),
        torque_known=abs(moved.dq) > REST,
    )
    free = contact_free_model(model)
    (R,) = contact_free_regression(free, log).factors
    drives = np.arange(10 * len(stance.robot.links), len(model.layout))
    columns = R[:, np.append(drives, 10 * number + np.arange(10))]
    triangle = np.asarray(np.linalg.qr(columns, mode="r"))[-10:, -10:]
    sizes = abs(np.diagonal(triangle))
    if len(triangle) < 10 or not sizes.min() > 1e-9 * sizes.max():
        raise NotExcitedError("the trunk's path does not show its ten parameters")
    return np.asarray(triangle)


def standing_tables(design: StandingDesign) -> list[Table]:
    """Return what was found, for people."""
    robot, checked = design.stance.robot, design.checked
    trunk = design.link
    samples = len(checked.time)
    how = (
        f"checked at {samples} times, {CHECK_RATE:g} a second; between them nothing is "
        "proven, and bodies are not kept apart",
        "forces on the ground: one choice that keeps their limits; a controller may "
        "distribute the weight otherwise",
        f"joints that stand still: {', '.join(_still(design)) or 'none'}",
    )
    uses = tuple(
        (use.what, use.of, f"{100 * use.share:.0f} %", f"{use.time:.2f} s")
        for use in checked.uses
    )
    errors = tuple(
        (f"{trunk}.{name}", f"{error:.3g}", unit)
        for name, error, unit in zip(INERTIAL_NAMES, design.errors, _UNITS, strict=True)
    )
    of = (
        f"of {robot.name} on {', '.join(foot.frame for foot in design.stance.feet)}, "
        f"{design.path.duration:g} s"
    )
    least, most = (np.sqrt(length * CHECK_RATE) for length in _CORRELATED)
    told = (
        "other bodies known, friction unknown; other noise in proportion; on real "
        f"robots it is correlated over {_CORRELATED[0]:g} to {_CORRELATED[1]:g} s, and "
        f"errors are {least:.0f} to {most:.0f} times as large",
        f"the best of {design.candidates} paths, {design.first:.1f} times better than "
        f"the best of the first, random ones; {design.seconds:.0f} s of the processor",
    )
    ended: tuple[str, ...] = ()
    if design.cut_short:
        ended = (
            f"{design.cut_short} ended the search; a longer search may find a "
            "better motion",
        )
    return [
        Table(f"Motion {of}", ("limit", "of", "used", "at"), uses, (*ended, *how)),
        Table(
            "Standard errors of the trunk, per N m of white torque noise at "
            f"{CHECK_RATE:g} Hz",
            ("parameter", "error", "unit"),
            errors,
            told,
        ),
    ]


def standing_record(design: StandingDesign) -> dict[str, Any]:
    """Return all there is to know of a motion on feet, as plain values."""
    path = design.path
    return {
        "robot": design.stance.robot.name,
        "feet": [foot.frame for foot in design.stance.feet],
        "pose": dict(
            zip(
                design.stance.robot.joint_names,
                design.stance.pose.tolist(),
                strict=True,
            )
        ),
        "duration_s": path.duration,
        "ramp_s": path.ramp,
        "frequencies_hz": path.frequencies.tolist(),
        "coordinates": list(COORDINATES),
        "sine": path.coefficients[0].tolist(),
        "cosine": path.coefficients[1].tolist(),
        "uses": [
            {"limit": u.what, "of": u.of, "share": u.share, "time_s": u.time}
            for u in design.checked.uses
        ],
        "checked": f"{len(design.checked.time)} samples, not proven between them",
        "link": design.link,
        "errors_per_newton_metre": dict(
            zip(INERTIAL_NAMES, design.errors.tolist(), strict=True)
        ),
        "error_rate_hz": CHECK_RATE,
        "candidates": design.candidates,
        "cut_short": design.cut_short,
        "seconds": design.seconds,
    }


def write_standing(design: StandingDesign, folder: Path, rate: float) -> list[Path]:
    """Write joints' samples (CSV, ROS), figure and record; return the files.

    Parameters
    ----------
    design : StandingDesign
    folder : Path
    rate : float, [Hz]
        Rate of the samples.
    """
    samples = design.recording(rate)
    table, message, picture, record = (folder / name for name in NAMES)
    text = json.dumps(standing_record(design), indent=1, allow_nan=False)
    with together():
        written = [
            write_atomically(table, csv_of(samples)),
            write_atomically(message, message_of(samples)),
            write_atomically(record, text + "\n"),
        ]
        written[2:2] = draw_figure(lambda: standing_figure(design), picture)
    return written


def standing_figure(design: StandingDesign) -> Any:
    """Return a Matplotlib figure: the trunk's way, torques, forces of the ground."""
    from matplotlib.figure import Figure

    checked, path = design.checked, design.path
    time = checked.time
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    figure.suptitle(f"{design.stance.robot.name}: motion on its feet")
    places, turns, torques, forces = figure.subplots(4, 1, sharex=True)
    y = path.evaluate(time)[0]
    for k, name in enumerate(COORDINATES):
        axis = places if k < 3 else turns
        axis.plot(time, y[:, k], lw=1.0, label=name)
    places.set_ylabel("trunk [m]")
    turns.set_ylabel("trunk [rad]")
    torques.plot(time, checked.ground.torque, lw=0.7)
    torques.set_ylabel("torque [N m]")
    pressed = checked.ground.forces[..., 2]
    first = 0
    for foot in design.stance.feet:
        own = pressed[:, first : first + len(foot.points)].sum(axis=1)
        forces.plot(time, own, lw=0.9, label=foot.frame)
        first += len(foot.points)
    forces.set_ylabel("ground [N]")
    forces.set_xlabel("time [s]")
    for axis in (places, turns, forces):
        axis.legend(fontsize=7, ncols=6, loc="upper right")
    for axis in (places, turns, torques, forces):
        axis.grid(alpha=0.3)
    return figure


def _still(design: StandingDesign) -> list[str]:
    moved = np.ptp(design.checked.joints.q, axis=0) > 0.0
    names = design.stance.robot.joint_names
    return [name for name, moves in zip(names, moved, strict=True) if not moves]
