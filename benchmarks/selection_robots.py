"""Simulated robots for `selection.py`, each with a truth that plain models lack.

Seed 1 was looked at when the selection was made; other seeds are other robots, motions
and noise of these kinds.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from faults_robots import (
    QUANTUM,
    RATE,
    Robot,
    as_drawn,
    loaded,
    random_motion,
    robots,
    times,
    urdf,
)

import consistent_id as ci

DURATION = 36.0  # s; the draft keeps the last 30 % for validation
_PLAIN = {"viscous": True, "coulomb": "tanh", "velocity_scale": 0.02, "offset": True}
_SIZES = {  # share of a joint's torque, over the size of the term's column
    "viscous": 0.15,
    "coulomb": 0.12,
    "coulomb_positive": 0.15,
    "coulomb_negative": 0.10,
    "offset": 0.03,
    "rotor_inertia": 0.10,
    "stribeck": 0.06,
    "spring": 0.30,
    "drag": 0.10,
}
_LOAD_FRICTION = 0.06
_NOISE, _COLOUR = 0.03, 0.9  # of the torque; correlation of neighbouring samples


@dataclass(frozen=True)
class Truth:
    """What a robot has besides bodies, viscous and Coulomb friction, and an offset.

    Parameters
    ----------
    robot : str
        See `faults_robots.robots`.
    terms : mapping of str to object
        Drive options of all joints.
    sprung : tuple of int
        Joints that have a spring.
    coupled : bool
        Whether the last two joints' gears are.
    placeholder : float, optional, [kg]
        Mass of every link in the URDF.
    late : float, [s]
        By which the torque is.
    by_joint : tuple of dict
        Drive options of each joint, in addition.
    """

    robot: str
    terms: dict[str, object]
    sprung: tuple[int, ...] = ()
    coupled: bool = False
    placeholder: float | None = None
    late: float = 0.0
    by_joint: tuple[dict[str, object], ...] = ()


TRUTHS = {
    "plain friction, rotors": Truth("ur10_like", {"rotor_inertia": True}),
    "placeholder masses": Truth(
        "seven_joints",
        {"rotor_inertia": True, "stribeck_velocity": 0.1, "load_friction": True},
        placeholder=1.0,
    ),
    "springs": Truth("rx60_like", {"rotor_inertia": True}, sprung=(1, 2)),
    "coupled wrist, late torque": Truth(
        "ur10_like", {"rotor_inertia": True}, coupled=True, late=0.008
    ),
    "drag, load friction": Truth(
        "seven_joints", {"rotor_inertia": True, "drag": True, "load_friction": True}
    ),
    "tree": Truth("tree", {"rotor_inertia": True, "load_friction": True}),
}


@dataclass(frozen=True)
class Case:
    """What a user has, and what only the laboratory knows."""

    text: str
    log: ci.Recording
    model: ci.TorqueModel
    parameters: np.ndarray
    hidden: ci.Recording


def case_of(truth: Truth, seed: int) -> Case:
    """Return a robot, its log, and another motion with its true torque."""
    robot = robots()[truth.robot]
    rng = np.random.default_rng([seed, 15])
    model = _true_model(robot, truth)
    states = random_motion(robot, rng).at(robot.joints, times(DURATION))
    x = _parameters(model, states, rng)
    log = ci.simulate_torque(model, x, states)
    late = np.round(truth.late * RATE * 10).astype(int)
    fine = np.arange(len(states) * 10) / (10 * RATE)
    torque = np.column_stack([np.interp(fine, log.time, t) for t in log.torque.T])
    torque = np.roll(torque, late, axis=0)[::10]
    torque += _noise(torque, rng)
    q = np.round(log.position / QUANTUM) * QUANTUM
    log = ci.Recording(robot.joints, log.time, q, torque=torque, name="log")
    motion = random_motion(robot, rng).at(robot.joints, times(15.0))
    hidden = ci.simulate_torque(model, x, motion)
    return Case(_drawn(robot, truth, rng), log, model, x, hidden)


def _true_model(robot: Robot, truth: Truth) -> ci.TorqueModel:
    terms = []
    for j in range(len(robot.parts)):
        spring = {"spring": True} if j in truth.sprung else {}
        own = truth.by_joint[j] if truth.by_joint else {}
        terms.append(ci.DriveTerms(**(_PLAIN | truth.terms | spring | own)))
    couplings = ()
    if truth.coupled:
        *_, first, second = robot.joints
        couplings = (
            ci.regression.GearCoupling(
                first,
                second,
                viscous=True,
                coulomb="tanh",
                velocity_scale=0.02,
                rotor_inertia=True,
            ),
        )
    return ci.TorqueModel(loaded(urdf(robot)), tuple(terms), couplings)


def _parameters(
    model: ci.TorqueModel, states: ci.Recording, rng: np.random.Generator
) -> np.ndarray:
    """Return the bodies of the URDF, and drive terms of usual size."""
    bodies = np.asarray(model.robot.nominal)
    rigid = ci.simulate_torque(ci.TorqueModel(model.robot), bodies, states).torque
    size = np.std(rigid, axis=0)
    size = np.maximum(size, 0.05 * size.max())
    Y = model.regressor(states.position, states.velocity, states.acceleration)
    names, x = model.robot.joint_names, [*bodies]
    for column, (owner, name) in enumerate(model.layout.drive, start=len(bodies)):
        plain = name.removeprefix("coupling_")
        rows = Y[:, column]
        joint = names.index(owner) if owner in names else len(names) - 1
        if plain == "load_friction":
            x.append(_LOAD_FRICTION * rng.uniform(0.7, 1.3))
            continue
        share = _SIZES[plain] * (0.5 if plain != name else 1.0) * size[joint]
        if plain == "offset":
            x.append(share * rng.normal())
            continue
        x.append(share * rng.uniform(0.7, 1.3) / np.std(rows[joint]))
    return np.array(x)


def _noise(torque: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return noise as real drives have it: neighbouring samples are alike."""
    noise = np.empty_like(torque)
    last = rng.normal(size=torque.shape[1])
    for k in range(len(torque)):
        last = _COLOUR * last + np.sqrt(1 - _COLOUR**2) * rng.normal(size=len(last))
        noise[k] = last
    return _NOISE * np.std(torque, axis=0) * noise


def _drawn(robot: Robot, truth: Truth, rng: np.random.Generator) -> str:
    drawn = as_drawn(robot, rng)
    if truth.placeholder is not None:
        parts = [replace(p, mass=truth.placeholder) for p in drawn.parts]
        drawn = replace(drawn, parts=tuple(parts))
    return urdf(drawn)


def written(case: Case, folder: Path) -> tuple[Path, Path]:
    """Write what a user has: a URDF and a CSV file."""
    model, log = folder / "robot.urdf", folder / "log.csv"
    model.write_text(case.text)
    names = [f"{c}_{joint}" for c in ("q", "tau") for joint in case.log.joints]
    rows = np.column_stack([case.log.time, case.log.position, case.log.torque])
    header = ",".join(["time", *names])
    np.savetxt(log, rows, "%.9g", ",", header=header, comments="")
    return model, log
