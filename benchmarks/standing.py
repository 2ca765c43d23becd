"""A trunk told by a designed motion on its feet, and by one made by hand.

``CONSISTENT_ID_DATASETS=... python benchmarks/standing.py`` takes some six minutes of a
processor.  Both move Go2's trunk for twenty seconds in MuJoCo, as in
benchmarks/quadruped.py, with contact, friction, noise, and a box on the trunk that no
model knows; legs are known.  The motion by hand is that benchmark's: three sinusoids of
each coordinate.  To each log torque noise of several levels is added, many times.
Samples next to touch-down and lift-off are left out, and joints at rest.
"""

import argparse
from dataclasses import replace

import numpy as np
from quadruped import DRIVE, SIGNS, moving_rows, trunk_errors
from standing_robots import StandingRobot, quadruped
from standing_simulation import SETTLE, prepared, simulated

import consistent_id as ci
from consistent_id.excitation.standing.feet_and_pose import (
    standing_feet,
    standing_pose,
)
from consistent_id.excitation.standing.stance import Stance
from consistent_id.excitation.standing.standing_design import (
    StandingDesign,
    design_standing,
)
from consistent_id.excitation.standing.standing_limits import StandingLimits
from consistent_id.robot.inertia import INERTIAL_NAMES

SECONDS = 20.0
VELOCITY, EFFORT = 4.0, 23.0  # rad/s, N m: of Go2's hips
NOISE = 0.0, 1.0  # N m, over the simulation's own of 0.05


class Sway:
    """A designed path as the simulation takes one: places and rotation vectors."""

    def __init__(self, path) -> None:
        self.path = path

    def at(self, t: float) -> np.ndarray:
        """Return place and turn at a time, the first second standing still."""
        t = float(np.clip(t - SETTLE, 0.0, self.path.duration))
        motion = self.path.motion(np.array([t]), np.zeros(3))
        return np.concatenate([motion.place[0], _vector(motion.base.rotation[0])])


def _vector(R: np.ndarray) -> np.ndarray:
    """Return the rotation vector of a rotation by less than half a turn."""
    vee = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = np.linalg.norm(vee) / 2
    angle = np.arctan2(sine, (np.trace(R) - 1) / 2)
    return vee / 2 * (angle / sine if sine > 0 else 1.0)


def designed(standing: StandingRobot, candidates: int) -> StandingDesign:
    robot, path = standing.nominal, standing.path
    feet = standing_feet(robot, path)
    stance = Stance(robot, feet, standing_pose(robot, path, feet))
    drive = ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02)
    return design_standing(
        stance,
        ci.TorqueModel(robot, drive),
        StandingLimits(velocity=VELOCITY, effort=EFFORT),
        duration=SECONDS,
        candidates=candidates,
        tell=lambda done, error: print(f"  {done} paths: {error:.4f}", flush=True),
    )


def trunks(
    robot: StandingRobot, raw: ci.Recording, noise: float, draws: int
) -> np.ndarray:
    """Return errors of the trunk's ten parameters, shape (draws, 10)."""
    model = ci.contact_free_model(ci.TorqueModel(robot.nominal, DRIVE))
    constraints = [*SIGNS, ci.FixedParameters(robot.known())]
    base = ci.contact_free_base(model, raw.contacts)
    rng, errors = np.random.default_rng(0), []
    for _ in range(draws if noise else 1):
        torque = raw.torque + noise * rng.normal(size=raw.torque.shape)
        whole = prepared(replace(raw, torque=torque), robot.cutoff)
        log = ci.without_impacts(whole, ci.impact_guard(robot.cutoff))
        moving = moving_rows(model, log, constraints, robot.cutoff).log
        regression = ci.contact_free_regression(model, moving)
        found = ci.constrained_least_squares(
            model, regression, constraints=constraints, base=base
        )
        errors.append(found.links[robot.number] - robot.true_trunk.vector)
        said = trunk_errors(found.links[robot.number], robot)
        print(f"  {noise:g} N m: {regression.counts[0]} rows, {said}", flush=True)
    return np.array(errors)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=6, help="of noise, each level")
    parser.add_argument("--candidates", type=int, default=320)
    options = parser.parse_args()
    robot = quadruped()
    design = designed(robot, options.candidates)
    print(f"designed in {design.seconds:.0f} CPU s")
    for use in design.checked.uses:
        print(f"  {use.what} of {use.of}: {use.share:.0%} at {use.time:.2f} s")
    sizes = {}
    for name, plan in (("by hand", None), ("designed", Sway(design.path))):
        raw = simulated(robot, 0, SECONDS, plan=plan)
        for noise in NOISE:
            print(f"{name}:")
            errors = trunks(robot, raw, noise, options.draws)
            sizes[name, noise] = np.sqrt(np.mean(np.square(errors), axis=0))
    for noise in NOISE:
        ratios = sizes["by hand", noise] / sizes["designed", noise]
        said = ", ".join(
            f"{name} {ratio:.2f}"
            for name, ratio in zip(INERTIAL_NAMES, ratios, strict=True)
        )
        print(
            f"{noise:g} N m added: errors by hand over errors of the design {said}; "
            f"geometric mean {np.exp(np.mean(np.log(ratios))):.2f}"
        )


if __name__ == "__main__":
    main()
