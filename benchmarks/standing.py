"""A trunk told by a designed motion on its feet, and by one made by hand.

``CONSISTENT_ID_DATASETS=... python benchmarks/standing.py [--robot humanoid] [--write
PAGE]`` takes some six minutes of a processor, of the humanoid fifteen.  Both motions
take Go2's trunk, or G1's torso, twenty seconds over the feet in MuJoCo, as in
benchmarks/quadruped.py, with contact, friction, noise, and a box on the trunk that no
model knows; other bodies and rotors are known.  The motion by hand is that benchmark's:
three sinusoids of each coordinate.  Controllers of joints add the torque that the model
without the box asks for.  To each log torque noise of several levels is added, many
times.  Samples next to touch-down and lift-off are left out, and joints at rest.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from pages import add_write, shown_on
from quadruped import DRIVE, SIGNS, trunk_errors
from standing_robots import ROBOTS, StandingRobot
from standing_simulation import RATE, SETTLE, prepared, simulated

import consistent_id as ci
from consistent_id.robot.inertia import INERTIAL_NAMES
from consistent_id.standing.forces_and_limits import (
    StandingMotion,
    standing_motion,
)
from consistent_id.standing.standing_design import REST, relative_size
from consistent_id.standing.standing_design import trunk_errors as predicted_errors

SECONDS = 20.0
LIMITS = {  # rad/s, N m: of Go2's hips; G1's file has its own
    "quadruped": ci.standing.StandingLimits(velocity=4.0, effort=23.0),
    "humanoid": ci.standing.StandingLimits(),
}
TITLES = {"quadruped": "Go2 on four feet", "humanoid": "G1's torso on two soles"}
WAYS = "by hand", "designed"
NOISE = 0.0, 1.0  # N m, over the simulation's own of 0.05


class Played:
    """A path as the simulation takes one: places and rotation vectors."""

    def __init__(self, path: ci.standing.TrunkPath, joints: int) -> None:
        self.path, self.still = path, np.zeros(joints)

    def at(self, t: float) -> np.ndarray:
        """Return place and turn at a time, the first second standing still."""
        t = float(np.clip(t - SETTLE, 0.0, self.path.duration))
        motion = self.path.motion(np.array([t]), np.zeros(3))
        turn = _vector(motion.base.rotation[0])
        return np.concatenate([motion.place[0], turn, self.still])


def by_hand(robot: StandingRobot, seed: int = 0) -> ci.standing.TrunkPath:
    """Return three sinusoids of each coordinate, near those of a robot's sway."""
    rng, sway = np.random.default_rng(seed), robot.sway
    tones = len(sway.frequencies)
    around = rng.uniform(0.85, 1.15, (tones, 6))
    phases = rng.uniform(0, 2 * np.pi, (tones, 6))
    sizes = np.repeat(np.array([sway.places, sway.turns]).T, 3, axis=1)
    coefficients = np.zeros((2, tones, 6, 6))
    own = np.arange(6)
    coefficients[0][:, own, own] = sizes * np.cos(phases)
    coefficients[1][:, own, own] = sizes * np.sin(phases)
    frequencies = (np.array(sway.frequencies)[:, None] * around).ravel()
    return ci.standing.TrunkPath(frequencies, coefficients.reshape(2, -1, 6), SECONDS)


def _vector(R: np.ndarray) -> np.ndarray:
    """Return the rotation vector of a rotation by less than half a turn."""
    vee = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = np.linalg.norm(vee) / 2
    angle = np.arctan2(sine, (np.trace(R) - 1) / 2)
    return vee / 2 * (angle / sine if sine > 0 else 1.0)


def designed(
    standing: StandingRobot, limits: ci.standing.StandingLimits, candidates: int
) -> ci.standing.StandingDesign:
    robot, path = standing.nominal, standing.path
    feet = ci.standing.standing_feet(robot, path)
    stance = ci.standing.Stance(
        robot, feet, ci.standing.standing_pose(robot, path, feet, standing.pose)
    )
    drive = ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02)
    return ci.standing.design_standing(
        stance,
        ci.TorqueModel(robot, drive),
        limits,
        link=standing.trunk,
        duration=SECONDS,
        candidates=candidates,
        tell=lambda done, error: told(f"  {done} paths: {error:.4f}"),
    )


def trunk_error_sizes(
    design: ci.standing.StandingDesign, motion: StandingMotion
) -> str:
    """Return predicted errors for noise of 1 N m at the log's rate."""
    errors = predicted_errors(design.stance, design.model, motion, RATE, design.link)
    return ", ".join(f"{error:.2g}" for error in errors)


def trunks(
    robot: StandingRobot,
    raw: ci.Recording,
    noise: float,
    draws: int,
) -> np.ndarray:
    """Return errors of the trunk's ten parameters, shape (draws, 10)."""
    model = ci.regression.contact_free_model(ci.TorqueModel(robot.nominal, DRIVE))
    constraints = [*SIGNS, ci.constraints.FixedParameters(robot.known())]
    base = ci.regression.contact_free_base(model, raw.contacts)
    rng, errors = np.random.default_rng(0), []
    for _ in range(draws if noise else 1):
        torque = raw.torque + noise * rng.normal(size=raw.torque.shape)
        whole = prepared(replace(raw, torque=torque), robot.cutoff)
        log = ci.signals.without_impacts(whole, ci.signals.impact_guard(robot.cutoff))
        moving = ci.signals.without_rests(
            log, REST, reach=ci.signals.rest_guard(robot.cutoff)
        )
        regression = ci.regression.contact_free_regression(model, moving)
        found = ci.constrained_least_squares(
            model, regression, constraints=constraints, base=base
        )
        errors.append(found.links[robot.number] - robot.true_trunk.vector)
        said = trunk_errors(found.links[robot.number], robot)
        told(f"  {noise:g} N m: {regression.counts[0]} rows, {said}")
    return np.array(errors)


def compared(
    sizes: dict[tuple[str, float], np.ndarray],
    robot: StandingRobot,
    used: float,
    title: str,
) -> Iterator[str]:
    """Yield the lines of the table: errors with the most noise, and their ratios."""
    noise = max(NOISE)
    by_hand, design = (relative_size(sizes[n, noise], robot.true_trunk) for n in WAYS)
    ratios = sizes["by hand", noise] / sizes["designed", noise]
    named = dict(zip(INERTIAL_NAMES, ratios, strict=True))

    def some(*names: str) -> str:
        return ", ".join(f"{named[name]:.1f}" for name in names)

    yield f"| | {title}, noise of {noise:g} N m |\n|---|---:|"
    yield f"| errors by hand | {100.0 * by_hand:.1f} % |"
    yield f"| errors of the design | {100.0 * design:.1f} % |"
    yield f"| share of its tightest limit, by hand | {100.0 * used:.0f} % |"
    yield f"| by hand over design: mass | {some('m')} |"
    yield f"| hx, hy, hz | {some('hx', 'hy', 'hz')} |"
    yield f"| Ixx, Iyy, Izz | {some('Ixx', 'Iyy', 'Izz')} |"
    yield f"| Ixy, Ixz, Iyz | {some('Ixy', 'Ixz', 'Iyz')} |"
    mean = np.exp(np.mean(np.log(ratios)))
    yield f"| geometric mean of these ratios | {mean:.1f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=12, help="of noise, each level")
    parser.add_argument("--candidates", type=int, default=320)
    parser.add_argument("--robot", choices=list(ROBOTS), default="quadruped")
    add_write(parser)
    options = parser.parse_args()
    with shown_on(options.write):
        report(options)


def told(line: str) -> None:
    """Say how far the work is."""
    print(line, file=sys.stderr, flush=True)


def report(options: argparse.Namespace) -> None:
    """Print the table of both motions."""
    robot = ROBOTS[options.robot]()
    design = designed(robot, LIMITS[options.robot], options.candidates)
    told(f"designed in {design.seconds:.0f} CPU s")
    for use in design.checked.uses:
        told(f"  {use.what} of {use.of}: {use.share:.0%} at {use.time:.2f} s")
    sizes, used = {}, {}
    for name, path in (("by hand", by_hand(robot)), ("designed", design.path)):
        time = np.arange(int(SECONDS * RATE) + 1) / RATE
        motion = standing_motion(design.stance, design.limits, path, time)
        predicted = trunk_error_sizes(design, motion)
        used[name] = motion.largest
        told(f"{name}, predicted: {predicted}; largest use {motion.largest:.0%}")
        raw = simulated(
            robot,
            0,
            SECONDS,
            plan=Played(path, len(robot.nominal)),
            feedforward=motion.ground.torque,
        )
        for noise in NOISE:
            told(f"{name}:")
            errors = trunks(robot, raw, noise, options.draws)
            sizes[name, noise] = np.sqrt(np.mean(np.square(errors), axis=0))
    for line in compared(sizes, robot, used["by hand"], TITLES[options.robot]):
        print(line)


if __name__ == "__main__":
    main()
