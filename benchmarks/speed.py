"""How fast it is: ratios to Pinocchio and stacked least squares, measured in one run.

``python benchmarks/speed.py [--quick] [--write docs/benchmarks.md]``
"""

import argparse
import importlib.metadata
import json
import os
import platform
import statistics
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from pages import measured
from threadpoolctl import threadpool_limits

import consistent_id as ci
from consistent_id.constraints.cones import certificate
from consistent_id.constraints.cones.least_norm import solve_least_norm
from consistent_id.estimation import best_fit
from consistent_id.estimation.best_fit import REFERENCE
from consistent_id.estimation.constrained_fit import (
    DEFAULT_CONSTRAINTS,
)
from consistent_id.regression.segments import merged

DRIVE = ci.DriveTerms(viscous=True, coulomb="sign", offset=True, rotor_inertia=True)


def arm() -> ci.TorqueModel:
    """Return a 7-joint arm with the Panda's Denavit-Hartenberg parameters."""
    q = np.pi / 2
    rows = [(0, 0, 0.333), (-q, 0, 0), (q, 0, 0.316), (q, 0.0825, 0)]
    rows += [(-q, -0.0825, 0.384), (q, 0, 0), (q, 0.088, 0)]
    table = [ci.DHRow(alpha, a, d) for alpha, a, d in rows]
    robot = ci.from_modified_dh("arm", table)
    sheets = {
        name: ci.robot.Datasheet(mass=m)
        for name, m in zip(robot.link_names, (4, 4, 3, 3, 3, 2, 1), strict=True)
    }
    return ci.TorqueModel(robot.with_datasheet(sheets), DRIVE)


def truth(model: ci.TorqueModel) -> np.ndarray:
    """Return bodies of the datasheet's masses, and friction."""
    links = []
    for k, link in enumerate(model.robot.links):
        com = 0.1 * np.array([np.sin(k), np.cos(k), np.sin(2 * k)])
        inertia = link.datasheet.mass * np.diag([0.02, 0.03, 0.025])
        body = ci.InertialParameters.from_central(link.datasheet.mass, com, inertia)
        links.append(body.vector)
    return np.concatenate([*links, np.tile([2.0, 1.0, 0.1, 0.3], 7)])


def log(model: ci.TorqueModel, samples: int) -> ci.Recording:
    """Return a smooth motion with noisy torque."""
    time = np.arange(samples) / 1000.0
    rate = np.array([1.1, 1.7, 2.3, 2.9, 3.1, 3.7, 4.3])
    angle = np.outer(time, rate) + np.arange(7)
    q, dq, ddq = np.sin(angle), rate * np.cos(angle), -(rate**2) * np.sin(angle)
    motion = ci.Recording(model.robot.joint_names, time, q, dq, ddq)
    rng = np.random.default_rng(0)
    return ci.simulate_torque(model, truth(model), motion, noise=0.5, rng=rng)


def ours(model: ci.TorqueModel, data: ci.Recording) -> dict[str, float]:
    """Time the regressor alone, then regressor and compression."""
    started = process_time()
    for _ in model.chunks(data.position, data.velocity, data.acceleration):
        pass
    regressor = process_time() - started
    started = process_time()
    regression = ci.build_regression(model, data)
    total = process_time() - started
    free = ci.least_squares(model, regression)
    residual = float(np.linalg.norm(regression.residual_rms(free.parameters)))
    return {"regressor": regressor, "total": total, "residual": residual}


def stacked(model: ci.TorqueModel, data: ci.Recording) -> dict[str, float]:
    """Stack the regressor from a Pinocchio loop, and call numpy.linalg.lstsq."""
    import pinocchio as pin

    reference = pin.Model()
    for k, joint in enumerate(model.robot.joints):
        place = pin.SE3(np.array(joint.rotation), np.array(joint.translation))
        reference.addJoint(k, pin.JointModelRZ(), place, joint.name)
    scratch = reference.createData()
    n, p = 7, len(model.layout)
    started = process_time()
    W = np.zeros((len(data), n, p))
    for s in range(len(data)):
        q, dq, ddq = data.position[s], data.velocity[s], data.acceleration[s]
        W[s, :, :70] = pin.computeJointTorqueRegressor(reference, scratch, q, dq, ddq)
    for j in range(n):
        dq, ddq = data.velocity[:, j], data.acceleration[:, j]
        columns = (dq, np.sign(dq), np.ones_like(dq), ddq)
        for i, column in enumerate(columns):
            W[:, j, 70 + 4 * j + i] = column
    regressor = process_time() - started
    started = process_time()
    rows, tau = W.reshape(-1, p), data.torque.reshape(-1)
    x = np.linalg.lstsq(rows, tau, rcond=1e-10)[0]
    solve = process_time() - started
    rest = (rows @ x - tau).reshape(-1, n)
    residual = float(np.linalg.norm(np.sqrt(np.mean(rest**2, axis=0))))
    total = regressor + solve
    return {"regressor": regressor, "total": total, "residual": residual}


CASES: dict[str, Callable[[ci.TorqueModel, ci.Recording], dict[str, float]]] = {
    "ours": ours,
    "stacked": stacked,
}


def run_case(name: str, samples: int) -> dict[str, float]:
    """Run one case in a process of its own, so that its peak memory is its own."""
    call = [sys.executable, __file__, "--case", name, str(samples)]
    # Pinned: threads make problems of this size slower for all of them.
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(call, capture_output=True, env=environment, check=True)
    return json.loads(done.stdout)


def case(name: str, samples: int) -> None:
    """Measure one case here and print it."""
    model = arm()
    data = log(model, samples)
    if name == "ours":
        ours(model, data.samples(slice(0, 5000)))  # imports and the row structure
    before = memory("VmRSS", forget_peak=True)
    figures = CASES[name](model, data)
    print(json.dumps(figures | {"extra_mb": memory("VmHWM") - before}))


def memory(entry: str, forget_peak: bool = False) -> float:
    """Return resident memory (or its peak) in MB, as Linux tells it."""
    if forget_peak:
        Path("/proc/self/clear_refs").write_text("5")
    status = Path("/proc/self/status").read_text()
    (line,) = [row for row in status.splitlines() if row.startswith(entry)]
    return int(line.split()[1]) / 1024


def compression_table(sizes: list[int], stacked_sizes: list[int], runs: int) -> str:
    """Microseconds per sample and memory beyond the recording itself."""
    lines = [
        "| what | samples | regressor, us/sample | in all, us/sample | memory, MB |",
        "|---|---:|---:|---:|---:|",
    ]
    residuals: dict[int, float] = {}
    totals: dict[tuple[str, int], float] = {}
    for name, chosen in (("ours", sizes), ("stacked", stacked_sizes)):
        for samples in chosen:
            results = [run_case(name, samples) for _ in range(runs)]
            middle = {k: statistics.median(r[k] for r in results) for k in results[0]}
            expected = residuals.setdefault(samples, middle["residual"])
            if abs(middle["residual"] / expected - 1.0) > 1e-9:
                raise SystemExit(f"{name} at {samples}: the residuals differ")
            totals[name, samples] = middle["total"]
            label = "consistent_id" if name == "ours" else "Pinocchio loop + lstsq"
            lines.append(
                f"| {label} | {samples:,} | {1e6 * middle['regressor'] / samples:.2f} "
                f"| {1e6 * middle['total'] / samples:.2f} | {middle['extra_mb']:.0f} |"
            )
    common = max(set(sizes) & set(stacked_sizes))
    ratio = totals["stacked", common] / totals["ours", common]
    lines += [
        "",
        f"At {common:,} samples the stacked way takes {ratio:.1f} times as long.",
    ]
    return "\n".join(lines)


def solve_table(repeats: int, samples: int = 20_000, replicates: int = 200) -> str:
    """Constrained estimate from a regression, its parts, and what repeats them."""
    model = arm()
    recording = log(model, samples)
    segments = ci.regression.segment_regressions(model, recording)
    regression = merged(segments)
    base = ci.regression.base_parameters(model)
    scaled = best_fit.best_fit(model, regression, DEFAULT_CONSTRAINTS, base=base).scaled
    centre = scaled.centre

    def again() -> None:
        certificate.solve_certified(scaled.problem, centre, reference=REFERENCE)

    calls: dict[str, tuple[Callable[[], object], float | None]] = {
        "one cone programme, Clarabel with its matrices": (
            lambda: solve_least_norm(scaled.problem),
            20.0,
        ),
        "the same through CVXPY": (
            lambda: ci.estimation.to_cvxpy(model, regression, base=base).solve(),
            None,
        ),
        "re-solve with its certificate": (again, 20.0),
        "whole estimate": (
            lambda: ci.constrained_least_squares(model, regression, base=base),
            80.0,
        ),
        f"bootstrap of {replicates} constrained estimates": (
            lambda: ci.comparison.bootstrap(
                model, segments, base=base, replicates=replicates
            ),
            5000.0,
        ),
        "consistent intervals of all parameters": (
            lambda: ci.comparison.consistent_intervals(model, regression, base=base),
            None,
        ),
    }
    lines = ["| what | ms | target |", "|---|---:|---:|"]
    for name, (call, target) in calls.items():
        call()
        times = []
        for _ in range(repeats):
            started = perf_counter()
            call()
            times.append(1e3 * (perf_counter() - started))
        wanted = "" if target is None else f"{target:.0f}"
        lines.append(f"| {name} | {statistics.median(times):.1f} | {wanted} |")
    resampled = ci.comparison.bootstrap(
        model, segments, base=base, replicates=replicates
    )
    estimate = ci.constrained_least_squares(model, regression, base=base)
    return "\n".join(
        [
            *lines,
            "",
            f"7 joints, {len(model.layout)} parameters, {len(base)} base parameters;",
            f"medians of {repeats}. Estimate: {estimate.certificate.verdict}; of the",
            f"bootstrap's {len(resampled.estimates)}, {resampled.certified} certified.",
        ]
    )


def startup_table() -> str:
    """Wall time of an import and of the shell tool's help."""
    calls = {
        "`import consistent_id`": [sys.executable, "-c", "import consistent_id"],
        "`consistent-id --help`": [
            sys.executable,
            "-c",
            "import sys; from consistent_id.cli import main; main(['--help'])",
        ],
    }
    lines = ["| what | s | target |", "|---|---:|---:|"]
    for (name, call), target in zip(calls.items(), (0.5, 0.3), strict=True):
        times = []
        for _ in range(5):
            started = perf_counter()
            subprocess.run(call, capture_output=True, check=True)
            times.append(perf_counter() - started)
        lines.append(f"| {name} | {statistics.median(times):.2f} | {target} |")
    return "\n".join(lines)


def page(quick: bool) -> str:
    """Measure everything and return it as Markdown."""
    sizes = [20_000, 100_000] if quick else [100_000, 1_000_000]
    runs = 1 if quick else 3
    versions = ", ".join(
        f"{name} {importlib.metadata.version(name)}"
        for name in ("numpy", "scipy", "pin", "cvxpy-base", "clarabel")
    )
    with threadpool_limits(1, user_api="blas"):
        solve = solve_table(3 if quick else 10)
    return f"""# How fast it is

{measured(script="speed.py")} in one run, with Python
{platform.python_version()}, {versions}.
BLAS runs in one thread throughout.
Medians of {runs} run(s) in processes of their own; other machines differ, so read the
ratios.

## Regressor and compression, 7 joints, 98 parameters

{compression_table(sizes, [20_000, 100_000], runs)}

Time is the processor's; memory is the peak beyond the recording itself. Targets: at
most 2.5 us per sample in all at a million samples, and memory that does not grow with
them. Stacking a million samples would take 5.5 GB for the matrix alone and was not run.

## Constrained estimate from a regression

{solve}

## Start-up

{startup_table()}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small sizes, one run")
    parser.add_argument("--write", type=Path, help="file to write the page to")
    parser.add_argument("--case", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.case:
        case(options.case[0], int(options.case[1]))
        return
    text = page(options.quick)
    print(text)
    if options.write:
        # `commands.py` writes the rest of the page.
        _, mark, commands = options.write.read_text().partition("\n## Commands\n")
        options.write.write_text(text + mark + commands)


if __name__ == "__main__":
    main()
