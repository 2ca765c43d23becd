"""Faults of an experiment: motion that shows little, a robot that is not its URDF's."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from faults_experiment import Experiment, Fault, logged, strong_joint
from faults_robots import DURATION, RATE, Motion, Robot, times, urdf

import consistent_id as ci


def held(share: float) -> Fault:
    """Let the robot stand still for a share of the log."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        stop = (1.0 - share) * DURATION
        q, dq, ddq = case.motion.states(np.minimum(times(), stop))
        moves = (times() < stop)[:, None]
        states = ci.Recording(case.robot.joints, times(), q, moves * dq, moves * ddq)
        return replace(case, log=logged(case, states, rng))

    return fault


def moved(change: Callable[[Motion, int], Motion]) -> Fault:
    """Move otherwise; `change` gets the motion and a joint."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        other = replace(case, motion=change(case.motion, strong_joint(case, rng)))
        states = other.motion.at(case.robot.joints, times())
        return replace(other, log=logged(other, states, rng))

    return fault


def one_still(motion: Motion, j: int) -> Motion:
    amplitude = motion.amplitude.copy()
    amplitude[j] = 0.0
    return replace(motion, amplitude=amplitude)


def periodic(motion: Motion, j: int) -> Motion:
    """Return a motion that repeats every 6 s: the standard experiment."""
    step = 1.0 / 6.0
    frequency = np.maximum(np.round(motion.frequency / step), 1.0) * step
    return replace(motion, frequency=frequency)


def short(seconds: float) -> Fault:
    return lambda case, rng: replace(
        case, log=case.log.samples(slice(0, round(seconds * RATE)))
    )


def drawn(change: Callable[[Robot, np.random.Generator], Robot]) -> Fault:
    """Give the user another URDF."""
    return lambda case, rng: replace(case, text=urdf(change(case.drawn, rng)))


def real(change: Callable[[Robot, np.random.Generator], Robot]) -> Fault:
    """Let the robot be another than its URDF says."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        robot = change(case.robot, rng)
        bodies = [
            ci.InertialParameters.from_central(p.mass, p.com, p.inertia).vector
            for p in robot.parts
        ]
        x = case.parameters.copy()
        x[: case.model.layout.inertial_size] = np.concatenate(bodies)
        other = replace(case, robot=robot, parameters=x)
        states = case.motion.at(case.robot.joints, times())
        return replace(other, log=logged(other, states, rng))

    return fault


def parts(change: Callable[..., dict[str, object]]) -> Callable[..., Robot]:
    """Change every part by what `change` returns for it."""
    return lambda robot, rng: replace(
        robot, parts=tuple(replace(p, **change(p, rng)) for p in robot.parts)
    )


def one_part(change: Callable[..., dict[str, object]]) -> Callable[..., Robot]:
    """Change the part in the middle."""

    def of(robot: Robot, rng: np.random.Generator) -> Robot:
        k = len(robot.parts) // 2
        changed = replace(robot.parts[k], **change(robot.parts[k], rng))
        return replace(robot, parts=(*robot.parts[:k], changed, *robot.parts[k + 1 :]))

    return of


def leaning(degrees_: float) -> Fault:
    """Mount the robot leaning; its URDF says upright."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        angle = np.radians(degrees_)
        gravity = 9.81 * np.array([np.sin(angle), 0.0, -np.cos(angle)])
        model = replace(case.model, robot=replace(case.model.robot, gravity=gravity))
        other = replace(case, model=model)
        states = case.motion.at(case.robot.joints, times())
        return replace(other, log=logged(other, states, rng))

    return fault


def robot_has(torque_of: Callable[..., np.ndarray]) -> Fault:
    """Give the robot a torque that no model knows."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        size, j = np.std(case.log.torque, axis=0), strong_joint(case, rng)
        other = replace(case, besides=lambda motion: torque_of(motion, size, j))
        states = case.motion.at(case.robot.joints, times())
        return replace(other, log=logged(other, states, rng))

    return fault


def spring(log: ci.Recording, size: np.ndarray, j: int) -> np.ndarray:
    torque = np.zeros_like(log.position)
    torque[:, j] = 1.5 * size[j] * np.sin(2.0 * log.position[:, j])
    return torque


def coupled(log: ci.Recording, size: np.ndarray, j: int) -> np.ndarray:
    """Friction of a motor that turns with the sum of two joints."""
    torque = np.zeros_like(log.position)
    k = j - 1 if j else 1
    speed = log.velocity[:, j] + log.velocity[:, k]
    torque[:, [j, k]] = (size[j] * np.tanh(speed / 0.02))[:, None]
    return torque


def placeholders(part: object, rng: np.random.Generator) -> dict[str, object]:
    return {"mass": 1.0, "com": (0.0, 0.0, 0.0), "size": (0.346, 0.346, 0.346)}


def units(length: float, gram: float) -> Fault:
    return lambda case, rng: replace(
        case, text=urdf(case.drawn, length=length, gram=gram)
    )
