"""Simulated logs of known robots, clean and each with one fault, for `detective.py`.

Robots are those of the problem folders: their geometry and masses, bodies otherwise
drawn at random, friction, torque noise, encoders that flicker.  Where a robot has no
usable torque for a joint, the log has nonsense in its place.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

import consistent_id as ci
from consistent_id.robot.scaling import reference_bodies

RATE = 200.0
DURATION = 20.0
PERIOD = 10.0
QUANTUM = 2 * np.pi / 2**17
_OF_SPEED = 0.9  # share of a joint's speed limit that a motion may take


@dataclass(frozen=True)
class Motion:
    """Five harmonics per joint: coefficients of sine and cosine, and a middle."""

    sine: np.ndarray
    cosine: np.ndarray
    middle: np.ndarray

    def at(self, joints: tuple[str, ...], time: np.ndarray) -> ci.Recording:
        """Return positions and their derivatives."""
        omega = 2 * np.pi / PERIOD * np.arange(1, 6)
        s, c = np.sin(omega[:, None] * time), np.cos(omega[:, None] * time)
        a, b = self.sine, self.cosine
        q = self.middle[:, None] + a @ s + b @ c
        dq = (a * omega) @ c - (b * omega) @ s
        ddq = -(a * omega**2) @ s - (b * omega**2) @ c
        return ci.Recording(joints, time, q.T, dq.T, ddq.T)


@dataclass(frozen=True)
class Case:
    """A robot that is known, how it moves, and what is logged of it."""

    model: ci.TorqueModel
    truth: np.ndarray
    motion: Motion
    noise: np.ndarray
    log: ci.Recording
    validation: tuple[ci.Recording, ...] = ()

    @property
    def rows(self) -> list[int]:
        """Places of the joints that have a torque."""
        names = self.model.robot.joint_names
        return [names.index(name) for name in self.model.torque_joints]


Fault = Callable[[Case, np.random.Generator], Case]


def robot(name: str) -> ci.TorqueModel:
    """Return a problem's robot, with its torques that are usable."""
    problem = ci.load_problem(f"problems/{name}")
    drive = ci.DriveTerms(
        viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True
    )
    measured = problem.model.torque_joints
    names = problem.model.robot.joint_names
    terms = tuple(drive if n in measured else ci.DriveTerms() for n in names)
    return ci.TorqueModel(problem.model.robot, terms, torque_joints=measured)


def clean(model: ci.TorqueModel, rng: np.random.Generator) -> Case:
    """Return a log of a robot that has the datasheet's masses, but other bodies."""
    robot = model.robot
    bodies = reference_bodies(robot).reshape(len(robot), 10).copy()
    for body in bodies:
        body[1:4] *= rng.uniform(0.8, 1.0)
        com = body[1:4] / body[0]
        central = ci.InertialParameters(body).central_inertia
        central = abs(np.diag(central)).max() * np.eye(3) * rng.uniform(0.7, 1.3)
        body[:] = ci.InertialParameters.from_central(body[0], com, central).vector
    motion = random_motion(model, rng)
    states = motion.at(robot.joint_names, times())
    bare = ci.simulate_torque(ci.TorqueModel(robot), bodies.ravel(), states)
    size = np.sqrt(np.mean(bare.torque**2, axis=0))
    speed = np.sqrt(np.mean(states.velocity**2, axis=0))
    drive = []
    for j, terms in enumerate(model.terms):
        share = rng.uniform(0.1, 0.4, 2) * size[j]
        friction = [share[0] / speed[j], share[1], 0.02 * size[j] * rng.normal()]
        drive += friction if terms.names else []
    truth = np.append(bodies.ravel(), drive)
    noise = rng.uniform(0.01, 0.05) * size
    case = Case(model, truth, motion, noise, states)
    return replace(case, log=logged(case, times(), rng))


def times(duration: float = DURATION, start: float = 0.0) -> np.ndarray:
    """Return the stamps of a log [s]."""
    return start + np.arange(round(RATE * duration)) / RATE


def random_motion(model: ci.TorqueModel, rng: np.random.Generator) -> Motion:
    """Return a motion within half of the limits of position, and those of speed."""
    sine, cosine, middle = [], [], []
    rates = 2 * np.pi / PERIOD * np.arange(1, 6)
    angle = rates[:, None] * times(PERIOD)
    for joint in model.robot.joints:
        low, high = joint.limits.lower, joint.limits.upper
        low = max(low, -2.0) if np.isfinite(low) else -2.0
        high = min(high, 2.0) if np.isfinite(high) else 2.0
        a, b = rng.normal(size=(2, 5)) / np.arange(1, 6)
        q = a @ np.sin(angle) + b @ np.cos(angle)
        dq = (rates * a) @ np.cos(angle) - (rates * b) @ np.sin(angle)
        fastest = _OF_SPEED * joint.limits.velocity / np.abs(dq).max()
        scale = min(0.5 * (high - low) / np.ptp(q), fastest)
        sine.append(scale * a)
        cosine.append(scale * b)
        middle.append((low + high) / 2 - scale * (q.max() + q.min()) / 2)
    return Motion(np.array(sine), np.array(cosine), np.array(middle))


def logged(case: Case, time: np.ndarray, rng: np.random.Generator) -> ci.Recording:
    """Return what is logged: flickering encoders, noisy torque, nonsense besides."""
    model = case.model
    states = case.motion.at(model.robot.joint_names, time)
    log = ci.simulate_torque(model, case.truth, states, noise=case.noise, rng=rng)
    flicker = rng.uniform(-0.5, 0.5, log.position.shape)
    seen = np.round(log.position / QUANTUM + flicker) * QUANTUM
    torque = log.torque.copy()
    dead = np.setdiff1d(range(torque.shape[1]), case.rows)
    torque[:, dead] = rng.integers(2) * rng.normal(size=(len(time), len(dead)))
    return replace(log, position=seen, acceleration=None, torque=torque)


def prepared(log: ci.Recording) -> ci.Recording:
    """Filter, differentiate and thin out, as a user would."""
    smooth = ci.low_passed(log, motion_cutoff=8.0, torque_cutoff=8.0)
    return ci.differentiated(smooth).samples(slice(None, None, 5))


def milliseconds(case: Case, rng: np.random.Generator) -> Case:
    return _with(case, time=case.log.time * 1e3)


def microseconds(case: Case, rng: np.random.Generator) -> Case:
    return _with(case, time=case.log.time * 1e6)


def degrees(case: Case, rng: np.random.Generator) -> Case:
    unit = _degrees(case)
    return _with(
        case, position=case.log.position * unit, velocity=case.log.velocity * unit
    )


def degrees_of_position(case: Case, rng: np.random.Generator) -> Case:
    return _with(case, position=case.log.position * _degrees(case))


def reversed_torque(case: Case, rng: np.random.Generator) -> Case:
    torque = case.log.torque.copy()
    torque[:, rng.choice(case.rows)] *= -1.0
    return _with(case, torque=torque)


def swapped_torque(case: Case, rng: np.random.Generator) -> Case:
    pair = rng.choice(case.rows, 2, replace=False)
    return _with(case, torque=_swapped(case.log.torque, pair))


def swapped_motion(case: Case, rng: np.random.Generator) -> Case:
    pair = rng.choice(case.rows, 2, replace=False)
    return _with(
        case,
        position=_swapped(case.log.position, pair),
        velocity=_swapped(case.log.velocity, pair),
    )


def swapped_velocity(case: Case, rng: np.random.Generator) -> Case:
    pair = rng.choice(len(case.model.robot), 2, replace=False)
    return _with(case, velocity=_swapped(case.log.velocity, pair))


def kilonewtons(case: Case, rng: np.random.Generator) -> Case:
    return _with(case, torque=case.log.torque / 1e3)


def quarter_turn(case: Case, rng: np.random.Generator) -> Case:
    return _moved(case, rng, rng.choice([-1, 1]) * np.pi / 2)


def small_offset(case: Case, rng: np.random.Generator) -> Case:
    angle = np.radians(rng.uniform(4.0, 10.0))
    return _moved(case, rng, rng.choice([-1, 1]) * angle)


def lag(case: Case, rng: np.random.Generator) -> Case:
    shift = int(rng.integers(8, 20))
    late = _with(case, torque=np.roll(case.log.torque, shift, axis=0))
    return replace(late, log=late.log.samples(slice(shift, None)))


def saturated(case: Case, rng: np.random.Generator) -> Case:
    torque = case.log.torque.copy()
    j = rng.choice(case.rows)
    limit = 0.7 * abs(torque[:, j]).max()
    torque[:, j] = np.clip(torque[:, j], -limit, limit)
    return _with(case, torque=torque)


def dead(case: Case, rng: np.random.Generator) -> Case:
    torque = case.log.torque.copy()
    torque[:, rng.choice(case.rows)] = 0.0
    return _with(case, torque=torque)


def resting(case: Case, rng: np.random.Generator) -> Case:
    """Let the robot stay where it ended for as long as it moved."""
    log, motion = case.log, case.motion
    end = motion.at(log.joints, times()[-2:]).position[-1]
    held = replace(motion, sine=0 * motion.sine, cosine=0 * motion.cosine, middle=end)
    rest = logged(replace(case, motion=held), times(start=DURATION), rng)
    return _with(
        case,
        time=np.append(log.time, rest.time),
        position=np.vstack([log.position, rest.position]),
        velocity=np.vstack([log.velocity, rest.velocity]),
        torque=np.vstack([log.torque, rest.torque]),
    )


def still_joint(case: Case, rng: np.random.Generator) -> Case:
    """Hold one joint where it is; velocities have to come from its encoder."""
    moves = np.ones((len(case.model.robot), 1))
    moves[rng.choice(case.rows)] = 0.0
    motion = replace(
        case.motion, sine=moves * case.motion.sine, cosine=moves * case.motion.cosine
    )
    held = replace(case, motion=motion)
    return replace(held, log=replace(logged(held, times(), rng), velocity=None))


def reused(case: Case, rng: np.random.Generator) -> Case:
    """Validate with the last third of what was trained on."""
    return replace(
        case, validation=(case.log.samples(slice(-len(case.log) // 3, None)),)
    )


def repeated(case: Case, rng: np.random.Generator) -> Case:
    """Make two periods of one motion, one to learn from and one to judge by.

    The second is not sampled at the phases of the first.
    """
    late = PERIOD + rng.uniform(0.0, 1.0 / RATE)
    second = logged(case, times(PERIOD, late), rng)
    first = case.log.samples(slice(0, round(RATE * PERIOD)))
    return replace(case, log=first, validation=(replace(second, name="second period"),))


def another_motion(case: Case, rng: np.random.Generator) -> Case:
    """Add validation as it should be: the same robot, moving otherwise."""
    other = replace(case, motion=random_motion(case.model, rng))
    log = replace(logged(other, times(), rng), name="another motion")
    return replace(case, validation=(log,))


def _with(case: Case, **channels: np.ndarray) -> Case:
    if "time" in channels and len(channels["time"]) != len(case.log):
        return replace(case, log=ci.Recording(case.log.joints, **channels))
    return replace(case, log=replace(case.log, **channels))


def _swapped(values: np.ndarray, pair: np.ndarray) -> np.ndarray:
    values = values.copy()
    values[:, pair] = values[:, pair[::-1]]
    return values


def _degrees(case: Case) -> np.ndarray:
    turns = [joint.kind != "prismatic" for joint in case.model.robot.joints]
    return np.where(turns, np.degrees(1.0), 1.0)


def _moved(case: Case, rng: np.random.Generator, angle: float) -> Case:
    # Not of the first joint with torque, which turns about gravity, nor of the last,
    # whose body may as well be turned.
    position = case.log.position.copy()
    position[:, rng.choice(case.rows[1:-1])] += angle
    return _with(case, position=position)


FAULTS: dict[str, tuple[str, Fault]] = {
    "clock in ms": ("clock", milliseconds),
    "clock in us": ("clock", microseconds),
    "degrees": ("degrees", degrees),
    "degrees, velocity in radians": ("degrees", degrees_of_position),
    "torque reversed": ("torque sign", reversed_torque),
    "torque channels exchanged": ("channel order", swapped_torque),
    "position channels exchanged": ("channel order", swapped_motion),
    "velocity channels exchanged": ("channel order", swapped_velocity),
    "torque in kN m": ("torque unit", kilonewtons),
    "zero off by 90 degrees": ("offset zero", quarter_turn),
    "zero off by 4 to 10 degrees": ("offset zero", small_offset),
    "torque late by 40 to 100 ms": ("lag", lag),
    "saturated torque": ("saturation", saturated),
    "torque of one joint zero": ("dead channel", dead),
    "half of it at rest": ("standstill", resting),
    "one joint does not move": ("rank", still_joint),
    "validation rows are training rows": ("leak", reused),
}
"""Label -> the kind that it is to be found as, and what puts it into a case."""
