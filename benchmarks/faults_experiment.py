"""Experiments on the robots of `faults_robots`, without a fault.

A fault changes what the user has: the URDF or the log.  What the robot does on another
motion, which no user sees, stays true.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from faults_robots import (
    DRIVE,
    QUANTUM,
    Motion,
    Robot,
    as_drawn,
    random_motion,
    times,
    urdf,
)

import consistent_id as ci


@dataclass(frozen=True)
class Experiment:
    """What a user has, and what only the laboratory knows.

    Parameters
    ----------
    robot : Robot
        As it is.
    drawn : Robot
        As its URDF says.
    model : TorqueModel
        The truth, with its `parameters`.
    motion : Motion
    noise : ndarray, shape (joints,), [N m or N]
    text : str
        The URDF.
    log : Recording
        Position, velocity and torque, as logged.
    besides : callable, optional
        Torque that no model knows, from a motion.
    reads : ndarray, shape (joints,), [rad or m]
        What encoders read where the URDF's zero is: of all logs of the robot.
    """

    robot: Robot
    drawn: Robot
    model: ci.TorqueModel
    parameters: np.ndarray
    motion: Motion
    noise: np.ndarray
    text: str
    log: ci.Recording
    besides: Callable[[ci.Recording], np.ndarray] | None = None
    reads: np.ndarray | float = 0.0

    def hidden(self, rng: np.random.Generator) -> ci.Recording:
        """Return another motion, as encoders read it, with its true torque.

        A zero is a convention between the encoder and the model: what parameters take
        over predicts torque as well.
        """
        motion = random_motion(self.robot, rng).at(self.robot.joints, times(12.0))
        log = self.true_torque(motion)
        return replace(log, position=log.position + self.reads)

    def true_torque(self, motion: ci.Recording) -> ci.Recording:
        """Return a motion with the torque that it takes."""
        log = ci.simulate_torque(self.model, self.parameters, motion)
        if self.besides is None:
            return log
        return replace(log, torque=log.torque + self.besides(motion))


Fault = Callable[[Experiment, np.random.Generator], Experiment]


def experiment(robot: Robot, rng: np.random.Generator, load_urdf) -> Experiment:  # type: ignore[no-untyped-def]
    """Return an experiment without a fault.

    `load_urdf` is from URDF text to a robot model.
    """
    model = ci.TorqueModel(load_urdf(urdf(robot)), DRIVE)
    motion = random_motion(robot, rng)
    states = motion.at(robot.joints, times())
    rigid = ci.TorqueModel(model.robot)
    bodies = np.asarray(model.robot.nominal)
    size = np.std(ci.simulate_torque(rigid, bodies, states).torque, axis=0)
    speed = np.std(states.velocity, axis=0)
    quick = np.std(states.acceleration, axis=0)
    drive = []
    for j, terms in enumerate(model.terms):
        share = size[j] * rng.uniform(0.5, 1.0)
        values = {
            "viscous": 0.2 * share / speed[j],
            "coulomb": 0.12 * share,
            "stribeck": 0.03 * share,
            "load_friction": 0.01,
            "offset": 0.02 * share * rng.normal(),
            "rotor_inertia": 0.03 * share / quick[j],
        }
        drive += [values[name] for name in terms.names]
    parameters = np.append(bodies, drive)
    noise = rng.uniform(0.005, 0.02) * np.maximum(size, 1e-3)
    drawn = as_drawn(robot, rng)
    bare = Experiment(
        robot, drawn, model, parameters, motion, noise, urdf(drawn), states
    )
    return replace(bare, log=logged(bare, states, rng))


def logged(
    case: Experiment, states: ci.Recording, rng: np.random.Generator
) -> ci.Recording:
    """Return what is logged along a motion: encoders' steps, noisy torque."""
    log = case.true_torque(states)
    torque = log.torque + case.noise * rng.normal(size=log.torque.shape)
    seen = np.round(states.position / QUANTUM) * QUANTUM
    speed = np.std(states.velocity, axis=0)
    velocity = states.velocity + 0.003 * speed * rng.normal(size=seen.shape)
    return replace(
        log, position=seen, velocity=velocity, acceleration=None, torque=torque
    )


def with_channels(case: Experiment, **channels: np.ndarray) -> Experiment:
    if len(channels.get("time", case.log.time)) != len(case.log):
        return replace(case, log=ci.Recording(case.log.joints, **channels))
    return replace(case, log=replace(case.log, **channels))


def strong_joint(case: Experiment, rng: np.random.Generator) -> int:
    """Return a joint whose torque is not small beside the others'."""
    size = np.std(case.log.torque, axis=0)
    return int(rng.choice(np.flatnonzero(size >= 0.02 * size.max())))


def turning_pair(case: Experiment, rng: np.random.Generator) -> list[int]:
    turning = [j for j, p in enumerate(case.robot.parts) if p.kind == "revolute"]
    return [int(j) for j in rng.choice(turning, 2, replace=False)]


def turning(case: Experiment) -> np.ndarray:
    return np.array([part.kind == "revolute" for part in case.robot.parts])
