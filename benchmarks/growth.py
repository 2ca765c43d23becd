"""How cost grows with joints and with constraints: fitted exponents.

``python benchmarks/growth.py [--joints 2 5 10 20 29 40] [--limb 7] [--samples 20000]
[--constraints 10 30 100 300 1000] [--write docs/large-logs-and-fleets.md]``.  Processor
seconds, one thread, the least of `--runs`.  A limb hangs on a base that is fixed; a
chain is one limb.  The humanoid has legs of 6 joints and, on a waist of 3, arms of 7,
hangs on a force sensor by its pelvis, and has six drive terms for each joint.  Base
parameters are those of a robot that nothing is known of.  The estimate starts from a
new regression and base parameters, and ends with certificate and audit.  Constraints
are relations of five parameters each, besides consistency, masses and signs, of an arm
of 7 joints.
"""

import argparse
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import TypeVar

import numpy as np
from pages import written_to
from threadpoolctl import threadpool_limits

import consistent_id as ci
from consistent_id.regression.row_names import BASE_ROWS

DRIVE = ci.DriveTerms(viscous=True, coulomb="sign", offset=True, rotor_inertia=True)
HUMANOID = ci.DriveTerms(
    viscous=True,
    drag=True,
    coulomb="sign",
    offset=True,
    rotor_inertia=True,
    spring=True,
)
DRIVEN = {  # typical coefficients
    "viscous": 2.0,
    "drag": 0.2,
    "coulomb": 1.0,
    "offset": 0.1,
    "rotor_inertia": 0.3,
    "spring": 0.5,
}
_T = TypeVar("_T")


def least(call: Callable[[], _T], runs: int) -> tuple[float, _T]:
    """Return the least processor seconds of some runs, and what the last returned."""
    times = []
    for _ in range(runs):
        started = process_time()
        value = call()
        times.append(process_time() - started)
    return min(times), value


def tree(joints: int, limb: int) -> ci.TorqueModel:
    """Return limbs of so many joints each on a fixed base."""
    robot = robot_of([-1 if k % limb == 0 else k - 1 for k in range(joints)])
    return ci.TorqueModel(robot, DRIVE)


def humanoid() -> ci.TorqueModel:
    """Return 30 bodies and 29 joints: legs, a waist, and arms on the waist."""
    legs = [-1, 0, 1, 2, 3, 4, -1, 6, 7, 8, 9, 10]
    waist, arms = [-1, 12, 13], [14, *range(15, 21), 14, *range(22, 28)]
    robot = robot_of([*legs, *waist, *arms], "floating")
    rows = (*BASE_ROWS, *robot.joint_names)
    return ci.TorqueModel(robot, HUMANOID, torque_joints=rows, wrench_bias=True)


def robot_of(parents: Sequence[int], base: str | None = None) -> ci.RobotModel:
    """Return links on these parents, -1 the base, about axes that take turns."""
    rng = np.random.default_rng(len(parents))
    text = f'<robot name="tree">{_link("base", rng)}'
    for k, carrier in enumerate(parents):
        parent = "base" if carrier < 0 else f"link{carrier}"
        axis = ("0 0 1", "0 1 0", "1 0 0")[k % 3]
        at = " ".join(f"{x:.3f}" for x in rng.uniform(-0.3, 0.3, 3))
        text += (
            f'{_link(f"link{k}", rng)}<joint name="j{k}" type="continuous">'
            f'<parent link="{parent}"/><child link="link{k}"/>'
            f'<origin xyz="{at}" rpy="{at}"/><axis xyz="{axis}"/></joint>'
        )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "tree.urdf")
        file.write_text(text + "</robot>")
        return ci.robot.load_urdf(file, base=base)


def _link(name: str, rng: np.random.Generator) -> str:
    com = " ".join(f"{x:.3f}" for x in rng.uniform(-0.1, 0.1, 3))
    mass = rng.uniform(1.0, 4.0)
    xx, yy, zz = mass * np.array([0.02, 0.03, 0.025])
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass:.3f}"/>'
        f'<inertia ixx="{xx:.5f}" iyy="{yy:.5f}" izz="{zz:.5f}" ixy="0" ixz="0" '
        'iyz="0"/></inertial></link>'
    )


def log(model: ci.TorqueModel, samples: int) -> ci.Recording:
    """Return an exciting motion with noisy torque."""
    n, floats = len(model.robot), model.robot.floating
    rng = np.random.default_rng(0)
    time = np.arange(samples) / 1000.0
    q, dq, ddq = waves(rng, time, n)
    base = None
    if floats:  # it is shaken, nearly upright
        _, w, dw = waves(rng, time, 3)
        base = ci.recordings.BaseMotion(
            w / 10, dw / 10, waves(rng, time, 3)[0] + [0.0, 0.0, 9.81]
        )
    x = np.zeros(len(model.layout))
    x[: model.layout.inertial_size] = model.robot.nominal
    for i, (_, term) in enumerate(model.layout.drive, start=model.layout.inertial_size):
        x[i] = DRIVEN.get(term, 0.0)
    torque = model.predict(x, q, dq, ddq, base=base)
    torque = torque + 0.1 * rng.normal(size=torque.shape)
    forces = torque[:, : torque.shape[1] - n]
    wrenches = (ci.recordings.Wrench("base", forces),) if floats else ()
    return ci.Recording(
        model.robot.joint_names,
        time,
        q,
        dq,
        ddq,
        torque[:, torque.shape[1] - n :],
        base=base,
        wrenches=wrenches,
    )


def waves(
    rng: np.random.Generator, time: np.ndarray, channels: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return sums of three sinusoids, and their two derivatives."""
    rates = rng.uniform(1.0, 5.0, (3, channels))
    phase = rng.uniform(0.0, 6.0, (3, channels))
    angle = time[:, None, None] * rates + phase
    return (
        np.sin(angle).sum(axis=1) / 2.0,
        (rates * np.cos(angle)).sum(axis=1) / 2.0,
        -(rates**2 * np.sin(angle)).sum(axis=1) / 2.0,
    )


def measured(
    model: ci.TorqueModel, name: str, samples: int, runs: int
) -> tuple[dict[str, float], str]:
    """Return processor seconds of each stage, and a row of the table."""
    data = log(model, samples)
    ci.build_regression(model, data)  # imports, and the structure of rows
    compress, regression = least(lambda: ci.build_regression(model, data), runs)
    find, _ = least(lambda: ci.regression.base_parameters(replace(model)), runs)
    base = ci.regression.base_parameters(model)
    solve, estimate = least(lambda: solved(model, regression, base), runs)
    times = {"compression": compress, "base parameters": find, "estimate": solve}
    per_sample, size = 1e6 * compress / samples, len(model.layout)
    return times, (
        f"| {name} | {size} | {len(base)} | {per_sample:.2f} | {1e3 * find:.0f} "
        f"| {1e3 * solve:.0f} | {estimate.certificate.verdict} |"
    )


def solved(
    model: ci.TorqueModel,
    regression: ci.Regression,
    base: ci.regression.BaseParameters,
    more: Sequence[ci.constraints.LinearRelation] = (),
) -> ci.Estimate:
    """Return the constrained estimate of a regression as if it were just made."""
    constraints = (
        ci.PhysicalConsistency(),
        ci.FixedMasses(),
        ci.NonNegativeDrive(),
        *more,
    )
    return ci.constrained_least_squares(
        model, replace(regression), base=base, constraints=constraints
    )


def constrained(number: int, samples: int, runs: int) -> tuple[float, str]:
    """Return processor seconds with so many constraints more, and a row."""
    model = tree(7, 7)
    regression = ci.build_regression(model, log(model, samples))
    base, rng = ci.regression.base_parameters(model), np.random.default_rng(number)
    x = np.zeros(len(model.layout))
    x[:70] = np.ravel(model.robot.nominal)
    relations = []
    for _ in range(number):
        terms = {i: float(rng.normal()) for i in rng.permutation(70)[:5].tolist()}
        value = sum(c * x[i] for i, c in terms.items())
        size = sum(abs(c * x[i]) for i, c in terms.items())
        named = {model.layout.names[i]: c for i, c in terms.items()}
        relations.append(
            ci.constraints.LinearRelation(
                named, value - 0.02 * size, value + 0.02 * size
            )
        )
    taken, estimate = least(lambda: solved(model, regression, base, relations), runs)
    return taken, f"| {number} | {1e3 * taken:.0f} | {estimate.certificate.verdict} |"


def page(given: argparse.Namespace) -> str:
    """Return the tables and the exponents."""
    lines = [
        f"Trees of limbs of {given.limb} joints, and a humanoid, {given.samples}",
        f"samples; processor time on one thread, the least of {given.runs} runs. The",
        "estimate includes its certificate and its audit.",
        "",
        "| joints | parameters | base | regression [us/sample] | base parameters [ms] "
        "| estimate [ms] | verdict |",
        "|--:|--:|--:|--:|--:|--:|---|",
    ]
    found = []
    for joints in given.joints:
        model = tree(joints, given.limb)
        times, row = measured(model, str(joints), given.samples, given.runs)
        found.append(times)
        lines.append(row)
    _, row = measured(humanoid(), "29, humanoid", given.samples, given.runs)
    lines += [row, ""]
    for stage in found[0]:
        exponent = _exponent(given.joints, [one[stage] for one in found])
        lines.append(f"- {stage}: grows as joints^{exponent:.2f}")
    lines += [
        "",
        "More constraints, relations of five parameters each, on an arm of 7 joints:",
        "",
        "| relations | estimate [ms] | verdict |",
        "|--:|--:|---|",
    ]
    taken = [constrained(n, given.samples, given.runs) for n in given.constraints]
    lines += [row for _, row in taken]
    exponent = _exponent(given.constraints, [seconds for seconds, _ in taken])
    return "\n".join([*lines, "", f"- estimate: grows as relations^{exponent:.2f}"])


def main() -> None:
    """Print the tables, or renew them in a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--joints", type=int, nargs="+", default=[2, 5, 10, 20, 29, 40])
    parser.add_argument("--limb", type=int, default=7, help="its joints (default: 7)")
    parser.add_argument("--samples", type=int, default=20_000)
    parser.add_argument(
        "--constraints", type=int, nargs="+", default=[10, 30, 100, 300, 1000]
    )
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--write", type=Path, help="page whose part is renewed")
    given = parser.parse_args()
    with written_to(given.write, "growth"), threadpool_limits(1):
        print(page(given))


def _exponent(sizes: Sequence[int], times: Sequence[float]) -> float:
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


if __name__ == "__main__":
    main()
