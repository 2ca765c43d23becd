"""How cost grows with joints and with constraints: fitted exponents.

``python benchmarks/growth.py [--joints 2 5 10 20 29 40] [--limb 7] [--samples 20000]
[--constraints 10 30 100 300 1000] [--write docs/large-logs-and-fleets.md]``.  Processor
seconds, one thread, the least of `--runs`. A limb hangs on a base that is fixed; a
chain is one limb. Base parameters are those of a robot that nothing is known of. The
estimate starts from a new regression and base parameters, and ends with certificate and
audit. Constraints are relations of five parameters each, besides consistency, masses
and signs, of an arm of 7 joints.
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

DRIVE = ci.DriveTerms(viscous=True, coulomb="sign", offset=True, rotor_inertia=True)
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
    """Return limbs of so many joints each, about axes that take turns."""
    rng = np.random.default_rng(joints)
    text = '<robot name="tree"><link name="base"/>'
    for k in range(joints):
        parent = "base" if k % limb == 0 else f"link{k - 1}"
        axis = ("0 0 1", "0 1 0", "1 0 0")[k % 3]
        at = " ".join(f"{x:.3f}" for x in rng.uniform(-0.3, 0.3, 3))
        com = " ".join(f"{x:.3f}" for x in rng.uniform(-0.1, 0.1, 3))
        mass = rng.uniform(1.0, 4.0)
        xx, yy, zz = mass * np.array([0.02, 0.03, 0.025])
        text += (
            f'<link name="link{k}"><inertial><origin xyz="{com}"/>'
            f'<mass value="{mass:.3f}"/><inertia ixx="{xx:.5f}" iyy="{yy:.5f}" '
            f'izz="{zz:.5f}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="j{k}" type="continuous"><parent link="{parent}"/>'
            f'<child link="link{k}"/><origin xyz="{at}" rpy="{at}"/>'
            f'<axis xyz="{axis}"/></joint>'
        )
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "tree.urdf")
        file.write_text(text + "</robot>")
        return ci.TorqueModel(ci.load_urdf(file), DRIVE)


def log(model: ci.TorqueModel, samples: int) -> ci.Recording:
    """Return an exciting motion with noisy torque."""
    n = len(model.robot)
    rng = np.random.default_rng(0)
    time = np.arange(samples) / 1000.0
    rates = rng.uniform(1.0, 5.0, (3, n))
    phase = rng.uniform(0.0, 6.0, (3, n))
    angle = time[:, None, None] * rates + phase
    q = np.sin(angle).sum(axis=1) / 2.0
    dq = (rates * np.cos(angle)).sum(axis=1) / 2.0
    ddq = -(rates**2 * np.sin(angle)).sum(axis=1) / 2.0
    links = [link.nominal.vector for link in model.robot.links]
    x = np.concatenate([*links, np.tile([2.0, 1.0, 0.1, 0.3], n)])
    motion = ci.Recording(model.robot.joint_names, time, q, dq, ddq)
    return ci.simulate_torque(model, x, motion, noise=0.1, rng=rng)


def measured(joints: int, limb: int, samples: int, runs: int) -> dict[str, float]:
    """Return processor seconds of each stage; print a row of the table."""
    model = tree(joints, limb)
    data = log(model, samples)
    ci.build_regression(model, data)  # imports, and the structure of rows
    compress, regression = least(lambda: ci.build_regression(model, data), runs)
    find, _ = least(lambda: ci.base_parameters(replace(model)), runs)
    base = ci.base_parameters(model)
    solve, estimate = least(lambda: solved(model, regression, base), runs)
    times = {"compression": compress, "base parameters": find, "estimate": solve}
    per_sample, size = 1e6 * compress / samples, len(model.layout)
    print(
        f"| {joints} | {size} | {len(base)} | {per_sample:.2f} | {1e3 * find:.0f} "
        f"| {1e3 * solve:.0f} | {estimate.certificate.verdict} |",
        flush=True,
    )
    return times


def solved(
    model: ci.TorqueModel,
    regression: ci.Regression,
    base: ci.BaseParameters,
    more: Sequence[ci.LinearRelation] = (),
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


def constrained(number: int, samples: int, runs: int) -> float:
    """Return processor seconds with so many constraints more; print a row."""
    model = tree(7, 7)
    regression = ci.build_regression(model, log(model, samples))
    base, rng = ci.base_parameters(model), np.random.default_rng(number)
    x = np.zeros(len(model.layout))
    x[:70] = np.ravel(model.robot.nominal)
    relations = []
    for _ in range(number):
        terms = {i: float(rng.normal()) for i in rng.permutation(70)[:5].tolist()}
        value = sum(c * x[i] for i, c in terms.items())
        size = sum(abs(c * x[i]) for i, c in terms.items())
        named = {model.layout.names[i]: c for i, c in terms.items()}
        relations.append(
            ci.LinearRelation(named, value - 0.02 * size, value + 0.02 * size)
        )
    taken, estimate = least(lambda: solved(model, regression, base, relations), runs)
    print(
        f"| {number} | {1e3 * taken:.0f} | {estimate.certificate.verdict} |", flush=True
    )
    return taken


def main() -> None:
    """Print the tables and the exponents."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--joints", type=int, nargs="+", default=[2, 5, 10, 20, 29, 40])
    parser.add_argument("--limb", type=int, default=7, help="its joints (default: 7)")
    parser.add_argument("--samples", type=int, default=20_000)
    parser.add_argument(
        "--constraints", type=int, nargs="+", default=[10, 30, 100, 300, 1000]
    )
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--write", type=Path, help="page with the tables")
    given = parser.parse_args()
    with written_to(given.write, "growth"):
        _print_tables(given)


def _print_tables(given: argparse.Namespace) -> None:
    print(f"Limbs of {given.limb} joints, {given.samples} samples:\n")
    print(
        "| joints | parameters | base | regression [us/sample] | base parameters [ms] "
        "| estimate [ms] | verdict |"
    )
    print("|--:|--:|--:|--:|--:|--:|---|")
    with threadpool_limits(1):
        found = [
            measured(joints, given.limb, given.samples, given.runs)
            for joints in given.joints
        ]
    for stage in found[0]:
        times = [one[stage] for one in found]
        print(f"\n{stage}: grows as joints^{_exponent(given.joints, times):.2f}")
    print("\n| relations | estimate [ms] | verdict |\n|--:|--:|---|")
    with threadpool_limits(1):
        taken = [
            constrained(number, given.samples, given.runs)
            for number in given.constraints
        ]
    print(f"\nestimate: grows as relations^{_exponent(given.constraints, taken):.2f}")


def _exponent(sizes: Sequence[int], times: Sequence[float]) -> float:
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


if __name__ == "__main__":
    main()
