"""A motion on feet for people and for the robot: tables, samples, figure, record."""

import json
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.files import together, write_atomically
from consistent_id._support.tables import Table
from consistent_id.excitation.used_limits import least_moved_of
from consistent_id.motion.files.robot_formats import message_of
from consistent_id.motion.files.trajectory_file import csv_of
from consistent_id.report.plot import draw_figure
from consistent_id.robot.inertia import INERTIAL_NAMES
from consistent_id.standing.standing_design import CHECK_RATE, StandingDesign
from consistent_id.standing.trunk_path import COORDINATES

_TURN = 2.0 * np.pi  # rad
_CORRELATED = 0.1, 0.35  # s, of noise on real robots

_UNITS = ("kg", *["kg m"] * 3, *["kg m^2"] * 6)
NAMES = ("standing.csv", "standing.yaml", "standing.png", "standing.json")


def standing_tables(design: StandingDesign) -> list[Table]:
    """Return what was found, for people."""
    robot, checked = design.stance.robot, design.checked
    trunk = design.link
    samples = len(checked.time)
    how = (
        _least_moved(design),
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
        "least_moved": _least_moved(design),
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


def _least_moved(design: StandingDesign) -> str:
    """Return which of the joints that move hardly do, or which moves least.

    The range of a joint without an end is a turn.
    """
    robot = design.stance.robot
    moved = np.ptp(design.checked.joints.q, axis=0)
    limits = [joint.limits for joint in robot.driven]
    width = np.array([its.upper - its.lower for its in limits])
    shares = moved / np.where(np.isfinite(width) & (width > 0.0), width, _TURN)
    moving = moved > 0.0
    return least_moved_of(list(compress(robot.joint_names, moving)), shares[moving])


def _still(design: StandingDesign) -> list[str]:
    moved = np.ptp(design.checked.joints.q, axis=0) > 0.0
    names = design.stance.robot.joint_names
    return [name for name, moves in zip(names, moved, strict=True) if not moves]
