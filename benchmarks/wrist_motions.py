"""A tool on a wrench sensor: told at rest, by random motion, by a designed motion.

``CONSISTENT_ID_DATASETS=... python benchmarks/wrist_motions.py [--write
docs/wrist-sensor.md]`` takes a minute of a processor.  A UR10e of the recordings'
folder and a Z1 of `example-robot-data`, which comes with Pinocchio, carry a tool that
nobody knows for ten seconds, each motion within the same limits.  Logged are the
encoders, at 200 Hz, and the sensor's wrench with a constant bias; both have white
noise.  Derivatives are those of low-passed positions.  Of random motions and of random
poses there are several, with some draws of noise each.
"""

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from sysconfig import get_paths

import numpy as np

import consistent_id as ci
from consistent_id.excitation.aims import base_for
from consistent_id.excitation.search_problem import search_problem
from consistent_id.motion.collisions.scene_building import scene_from_urdf
from consistent_id.robot.inertia import INERTIAL_NAMES

SECONDS, RATE, CUTOFF = 10.0, 200.0, 20.0  # s, Hz, Hz
ENCODER = 2e-5  # rad
NOISE = np.array([0.2] * 3 + [0.02] * 3)  # N, N m
BIAS = np.array([3.0, -2.0, 5.0, 0.1, -0.2, 0.05])
TOOL = ci.InertialParameters.from_central(
    1.3, [0.02, -0.01, 0.08], [[4e-3, 1e-4, 0], [1e-4, 3e-3, 2e-4], [0, 2e-4, 2e-3]]
)
POSES = 12  # at rest, an equal time each; none is lost on the way
UNITS = ("kg", *["kg m"] * 3, *["kg m^2"] * 6)
BEGIN, END = "<!-- wrist motions: begin -->\n", "<!-- wrist motions: end -->"


@dataclass(frozen=True, slots=True)
class Case:
    """An arm up to its sensor, its scene, and its acceleration limit [rad/s^2]."""

    name: str
    file: Path
    tip: str
    acceleration: float
    ground: float | None = None


def cases() -> Iterator[Case]:
    """Yield the arms that are there."""
    folder = os.environ.get("CONSISTENT_ID_DATASETS")
    if folder is not None:
        yield Case("UR10e", Path(folder) / "ur10e/ur10e.urdf", "tool0", 5.0)
    robots = "cmeel.prefix/share/example-robot-data/robots/z1_description/urdf/z1.urdf"
    z1 = Path(get_paths()["purelib"]) / robots
    yield Case("Z1", z1, "link06", 8.0, ground=0.0)


def designed(case: Case, time_limit: float) -> ci.ExcitationDesign:
    arm = ci.robot.load_urdf(case.file, tip=case.tip)
    rows = ci.regression.SensorRows(ci.regression.tool_model("tool"), arm, case.tip)
    scene = None
    if case.ground is not None:
        scene = scene_from_urdf(case.file, arm, ground=case.ground, clearance=0.01)
    return ci.design_trajectory(
        arm,
        ci.PathForm(SECONDS, 7),
        ci.Aim(noise=NOISE, interest=["tool"], correlation_time=0.0, rate=RATE),
        limits=ci.motion_limits(arm, acceleration=case.acceleration).within(0.9),
        scene=scene,
        sensor=rows,
        starts=2,
        workers=1,
        time_limit=time_limit,
    )


def randoms(
    design: ci.ExcitationDesign, count: int
) -> list[ci.recordings.FourierTrajectory]:
    """Return random paths of the same form within the same limits."""
    base = base_for(design.measured, design.aim.interest)
    guards = design.demands.guards
    of = design.measured, base, design.form, design.aim, design.limits
    problem = replace(search_problem(*of).guarded(guards), seed=1)
    return [problem.basis.trajectory(problem.random(k)) for k in range(count)]


def motion_errors(
    rows: ci.regression.SensorRows, path: ci.recordings.FourierTrajectory, draws: int
) -> np.ndarray:
    """Return errors of the tool's ten parameters, shape (draws, 10)."""
    log, rng, errors = path.recording(rate=RATE), np.random.default_rng(0), []
    clean = _shown(rows, log)
    for _ in range(draws):
        q = log.position + ENCODER * rng.normal(size=log.position.shape)
        wrench = ci.recordings.Wrench(
            rows.frame, clean + NOISE * rng.normal(size=clean.shape)
        )
        raw = ci.Recording(log.joints, log.time, q, wrenches=(wrench,))
        smooth = ci.low_passed(raw, motion_cutoff=CUTOFF, torque_cutoff=CUTOFF)
        one = ci.differentiated(smooth).samples(slice(20, -20))
        errors.append(_fitted(rows, one) - TOOL.vector)
    return np.array(errors)


def rest_errors(rows: ci.regression.SensorRows, seed: int, draws: int) -> np.ndarray:
    """Return the same of poses at rest; NaN where these tell nothing."""
    rng, errors = np.random.default_rng(seed), []
    q = rng.uniform(-np.pi, np.pi, (POSES, len(rows.arm)))
    still = ci.Recording(rows.arm.joint_names, np.arange(float(POSES)), q)
    clean = _shown(rows, still)
    spread = NOISE / np.sqrt(SECONDS * RATE / POSES)
    for _ in range(draws):
        shown = clean + spread * rng.normal(size=clean.shape)
        log = ci.regression.static_poses(rows.arm, q, shown, frame=rows.frame)
        off = _fitted(rows, log) - TOOL.vector
        off[4:] = np.nan
        errors.append(off)
    return np.array(errors)


def _shown(rows: ci.regression.SensorRows, log: ci.Recording) -> np.ndarray:
    """Return what the sensor shows without noise."""
    none, moved = (
        np.zeros((len(log), 0)),
        ci.regression.sensor_motion(rows.arm, log, rows.frame),
    )
    truth = np.append(TOOL.vector, BIAS)
    return rows.tool.predict(truth, none, none, none, base=moved)


def _fitted(rows: ci.regression.SensorRows, log: ci.Recording) -> np.ndarray:
    found = ci.regression.sensor_regression(rows.tool, rows.arm, log, frame=rows.frame)
    fit = ci.least_squares(rows.tool, found.weighted(NOISE))
    return np.array(fit.parameters[:10])


def _rms(errors: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean(np.square(errors), axis=0)))


def table(case: Case, time_limit: float, paths: int, draws: int) -> str:
    """Return errors of an arm's tool, parameter by parameter."""
    design = designed(case, time_limit)
    rows = design.sensor
    best = _rms(motion_errors(rows, design.trajectory, draws))
    chance = np.median(
        [_rms(motion_errors(rows, path, draws)) for path in randoms(design, paths)],
        axis=0,
    )
    rest = np.median([_rms(rest_errors(rows, k, draws)) for k in range(paths)], axis=0)
    gain = np.exp(np.mean(np.log(chance / best)))
    lines = [
        f"{case.name}, {SECONDS:g} s; all limits proven: {design.proof.holds}; random "
        f"over design, geometric mean: {gain:.1f}",
        "",
        "| parameter | is | at rest | random motion | design |",
        "|---|---:|---:|---:|---:|",
    ]
    columns = zip(INERTIAL_NAMES, UNITS, TOOL.vector, rest, chance, best, strict=True)
    for name, unit, true, *errors in columns:
        cells = " | ".join(
            "none" if np.isnan(error) else f"{error:.2g}" for error in errors
        )
        lines.append(f"| {name} [{unit}] | {true:.3g} | {cells} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--time-limit", type=float, default=10.0, help="of a search")
    parser.add_argument("--paths", type=int, default=5, help="random motions")
    parser.add_argument("--draws", type=int, default=8, help="of noise")
    parser.add_argument("--write", type=Path, help="page whose table is replaced")
    options = parser.parse_args()
    found = []
    for case in cases():
        how = options.time_limit, options.paths, options.draws
        found.append(table(case, *how))
        print(found[-1], flush=True)
    if options.write is not None:
        text = options.write.read_text(encoding="utf-8")
        before, _, rest = text.partition(BEGIN)
        _, _, after = rest.partition(END)
        page = f"{before}{BEGIN}{chr(10).join(found)}{END}{after}"
        options.write.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
