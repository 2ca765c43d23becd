"""How many faults the data detective finds, and how often it cries wolf.

``python benchmarks/detective.py [--clean 200] [--faulty 20] [--write docs/detective.md]
`` simulates logs of known robots (those of the problem folders; all but RX-60 need
``CONSISTENT_ID_DATASETS``), with noise, friction and encoders, puts one fault into
each, and counts.
"""

import argparse
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

import consistent_id as ci
from consistent_id.diagnosis import diagnose

ROBOTS = ("ur10e", "kuka_kr300", "staubli_tx40", "rx60")
RATE = 200.0
DURATION = 20.0
Fault = Callable[[ci.Recording, np.random.Generator], ci.Recording]


@dataclass(frozen=True)
class Case:
    """A simulated log and its robot."""

    model: ci.TorqueModel
    log: ci.Recording


def robot(name: str) -> ci.TorqueModel:
    """Return a problem's torque model, all joints with torque."""
    problem = ci.load_problem(f"problems/{name}")
    drive = ci.DriveTerms(
        viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True
    )
    return ci.TorqueModel(problem.model.robot, drive)


def clean(model: ci.TorqueModel, rng: np.random.Generator) -> Case:
    """Return a log of a robot that has the datasheet's masses, but other bodies."""
    robot = model.robot
    n = len(robot)
    bodies = ci.scaling.reference_bodies(robot).reshape(n, 10).copy()
    for body in bodies:
        body[1:4] *= rng.uniform(0.8, 1.0)
        com = body[1:4] / body[0]
        central = ci.InertialParameters(body).central_inertia
        central = abs(np.diag(central)).max() * np.eye(3) * rng.uniform(0.7, 1.3)
        body[:] = ci.InertialParameters.from_central(body[0], com, central).vector
    motion = random_motion(model, rng)
    bare = np.append(bodies.ravel(), np.zeros(len(model.layout) - 10 * n))
    size = np.sqrt(np.mean(model.predict(bare, *states(motion)) ** 2, axis=0))
    drive = []
    for j in range(n):
        speed = np.sqrt(np.mean(motion.velocity[:, j] ** 2))
        share = rng.uniform(0.1, 0.4, 2) * size[j]
        drive += [share[0] / speed, share[1], 0.02 * size[j] * rng.normal()]
    truth = np.append(bodies.ravel(), drive)
    noise = rng.uniform(0.01, 0.05) * np.maximum(size, 1e-3)
    log = ci.simulate_torque(model, truth, motion, noise=noise, rng=rng)
    quantum = 2 * np.pi / 2**17
    seen = np.round(log.position / quantum) * quantum
    return Case(model, replace(log, position=seen, acceleration=None))


def states(motion: ci.Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position, velocity and acceleration."""
    return motion.position, motion.velocity, motion.acceleration


def random_motion(model: ci.TorqueModel, rng: np.random.Generator) -> ci.Recording:
    """Return five harmonics per joint within half of the limits."""
    joints = model.robot.joints
    time = np.arange(round(RATE * DURATION)) / RATE
    omega = 2 * np.pi / 10.0 * np.arange(1, 6)
    channels = []
    for joint in joints:
        low, high = joint.limits.lower, joint.limits.upper
        low = max(low, -2.0) if np.isfinite(low) else -2.0
        high = min(high, 2.0) if np.isfinite(high) else 2.0
        a, b = rng.normal(size=(2, 5)) / np.arange(1, 6)
        angle = omega[:, None] * time
        q = a @ np.sin(angle) + b @ np.cos(angle)
        scale = 0.5 * (high - low) / np.ptp(q)
        dq = (a * omega) @ np.cos(angle) - (b * omega) @ np.sin(angle)
        ddq = -(a * omega**2) @ np.sin(angle) - (b * omega**2) @ np.cos(angle)
        middle = (low + high) / 2 - scale * (q.max() + q.min()) / 2
        channels.append((middle + scale * q, scale * dq, scale * ddq))
    q, dq, ddq = (np.column_stack(c) for c in zip(*channels, strict=True))
    return ci.Recording(model.robot.joint_names, time, q, dq, ddq)


def prepared(log: ci.Recording) -> ci.Recording:
    """Filter and differentiate, as a user would."""
    smooth = ci.low_passed(log, motion_cutoff=8.0, torque_cutoff=8.0)
    return ci.decimated(ci.differentiated(smooth), 5)


def _pair(rng: np.random.Generator, n: int) -> tuple[int, int]:
    i, j = rng.choice(n, 2, replace=False)
    return int(i), int(j)


def _swapped(values: np.ndarray, i: int, j: int) -> np.ndarray:
    values = values.copy()
    values[:, [i, j]] = values[:, [j, i]]
    return values


def milliseconds(log: ci.Recording, rng: np.random.Generator) -> ci.Recording:
    return replace(log, time=log.time * 1e3)


def microseconds(log: ci.Recording, rng: np.random.Generator) -> ci.Recording:
    return replace(log, time=log.time * 1e6)


def degrees(log: ci.Recording, rng: np.random.Generator) -> ci.Recording:
    return replace(
        log, position=np.degrees(log.position), velocity=np.degrees(log.velocity)
    )


def degrees_of_position(log: ci.Recording, rng: np.random.Generator) -> ci.Recording:
    return replace(log, position=np.degrees(log.position))


def reversed_torque(log: ci.Recording, rng: np.random.Generator) -> ci.Recording:
    torque = log.torque.copy()
    torque[:, rng.integers(torque.shape[1])] *= -1.0
    return replace(log, torque=torque)


def swapped_torque(log: ci.Recording, rng: np.random.Generator) -> ci.Recording:
    pair = _pair(rng, log.torque.shape[1])
    return replace(log, torque=_swapped(log.torque, *pair))


def swapped_motion(log: ci.Recording, rng: np.random.Generator) -> ci.Recording:
    pair = _pair(rng, log.torque.shape[1])
    return replace(
        log,
        position=_swapped(log.position, *pair),
        velocity=_swapped(log.velocity, *pair),
    )


def swapped_velocity(log: ci.Recording, rng: np.random.Generator) -> ci.Recording:
    pair = _pair(rng, log.torque.shape[1])
    return replace(log, velocity=_swapped(log.velocity, *pair))


def kilonewtons(log: ci.Recording, rng: np.random.Generator) -> ci.Recording:
    return replace(log, torque=log.torque / 1e3)


def quarter_turn(log: ci.Recording, rng: np.random.Generator) -> ci.Recording:
    return _moved(log, rng, rng.choice([-1, 1]) * np.pi / 2)


def small_offset(log: ci.Recording, rng: np.random.Generator) -> ci.Recording:
    return _moved(log, rng, rng.choice([-1, 1]) * np.radians(rng.uniform(4.0, 10.0)))


def _moved(log: ci.Recording, rng: np.random.Generator, angle: float) -> ci.Recording:
    # Not of the first joint, which turns about gravity, nor of the last, whose body
    # may as well be turned.
    position = log.position.copy()
    position[:, int(rng.integers(1, max(position.shape[1] - 2, 2)))] += angle
    return replace(log, position=position)


def lag(log: ci.Recording, rng: np.random.Generator) -> ci.Recording:
    shift = int(rng.integers(8, 20))
    torque = np.roll(log.torque, shift, axis=0)
    return replace(log, torque=torque).samples(slice(shift, None))


def saturated(log: ci.Recording, rng: np.random.Generator) -> ci.Recording:
    torque = log.torque.copy()
    j = int(rng.integers(torque.shape[1]))
    limit = 0.7 * abs(torque[:, j]).max()
    torque[:, j] = np.clip(torque[:, j], -limit, limit)
    return replace(log, torque=torque)


def resting(log: ci.Recording, rng: np.random.Generator) -> ci.Recording:
    n = len(log)
    still = np.full((n, log.position.shape[1]), log.position[-1])
    time = np.append(log.time, log.time + log.duration + 1 / RATE)
    return ci.Recording(
        log.joints,
        time,
        np.vstack([log.position, still]),
        np.vstack([log.velocity, 0 * log.velocity]),
        torque=np.vstack([log.torque, np.tile(log.torque[-1], (n, 1))]),
    )


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
    "half of it at rest": ("standstill", resting),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clean", type=int, default=200)
    parser.add_argument("--faulty", type=int, default=20, help="of each class")
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    models = [robot(name) for name in options.robots]
    alarms: Counter[str] = Counter()
    for seed in tqdm(range(options.clean), "clean"):
        rng = np.random.default_rng(seed)
        case = clean(models[seed % len(models)], rng)
        found = diagnose(case.model, case.log, prepare=prepared)
        wrong = [f for f in found.findings if f.severity != "note"]
        alarms["any"] += bool(wrong)
        for f in wrong:
            alarms[f.kind] += 1
            name = options.robots[seed % len(models)]
            tqdm.write(f"{seed} {name}: {f.kind} {f.where} {f.statement[:150]}")
    lines = [
        "# What the data detective finds",
        "",
        "Measured by `python benchmarks/detective.py`: simulated logs of",
        f"{', '.join(options.robots)}, {DURATION:g} s at {RATE:g} Hz, other bodies of",
        "the datasheet's masses, friction, torque noise of 1 to 5 %, 17-bit encoders.",
        "",
        f"False alarms on {options.clean} clean logs: {alarms['any']}.",
        "",
        "| fault | logs | found | found as that fault |",
        "|---|---:|---:|---:|",
    ]
    for label, (kind, inject) in FAULTS.items():
        hits = right = 0
        for seed in tqdm(range(options.faulty), label):
            rng = np.random.default_rng(10_000 + seed)
            case = clean(models[seed % len(models)], rng)
            log = inject(case.log, rng)
            found = diagnose(case.model, log, prepare=prepared)
            seen = [f.kind for f in found.findings if f.severity != "note"]
            hits += bool(seen)
            right += kind in seen
            if kind not in seen:
                name = options.robots[seed % len(models)]
                tqdm.write(f"{label} {seed} {name}: {seen}")
        lines.append(
            f"| {label} | {options.faulty} | {hits / options.faulty:.0%} "
            f"| {right / options.faulty:.0%} |"
        )
    text = "\n".join(lines) + "\n"
    print(text)
    if options.write:
        options.write.write_text(text)


if __name__ == "__main__":
    main()
