"""What compiled code saves, and after how many samples it has paid for itself.

``python benchmarks/compiled.py [--samples 200000] [--runs 9] [--chunk 4072]
[--write docs/mathematics.md]``.  Processor seconds of the process; NumPy and compiled
code take turns, and the least of each counts, so that other work on the machine
concerns both.  Look at the ratios.  ``--chunk`` concerns the regressor alone.
"""

import argparse
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import process_time, thread_time

import numpy as np
from pages import written_to
from speed import arm, log, truth
from threadpoolctl import threadpool_limits

import consistent_id as ci
from consistent_id.regression.compiled import compiler, entries
from consistent_id.regression.mass_matrix import mass_matrices, random_poses
from consistent_id.regression.regressor import CHUNK


def in_turns(call: Callable[[], object], runs: int) -> tuple[float, float]:
    """Return processor seconds by NumPy and by compiled code, the least of each."""
    times = np.empty((runs, 2))
    for run in times:
        for i, switch in enumerate(("0", "1")):
            os.environ[compiler.SWITCH] = switch
            started = process_time()
            call()
            run[i] = process_time() - started
    by_numpy, by_code = times.min(axis=0).tolist()
    return by_numpy, by_code


def calls(model: ci.TorqueModel, samples: int, chunk: int) -> dict[str, Callable]:
    """Return what is measured, by name."""
    data = log(model, samples)
    state = data.position, data.velocity, data.acceleration
    parameters, poses = truth(model), random_poses(model, samples, 0)

    def regressor() -> None:
        for _ in model.chunks(*state, chunk):
            pass

    return {
        "regressor": regressor,
        "regressor and compression": lambda: ci.build_regression(
            model, data, noise=False
        ),
        "the same, and how noise is correlated": lambda: ci.build_regression(
            model, data
        ),
        "torque of known parameters": lambda: model.predict(parameters, *state),
        "mass matrices": lambda: mass_matrices(model, parameters, poses),
    }


def costs(model: ci.TorqueModel) -> dict[str, float]:
    """Return the processor seconds of compiling a robot's recursion, and of loading."""
    states = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 100, len(model.robot)))
    paid = {"compile": 0.0, "load": 0.0}
    for step in paid:
        entries._recursion.cache_clear()
        children, started = os.times().children_user, thread_time()
        for _ in range(3 if step == "compile" else 1):
            model.regressor(*states)
        paid[step] = thread_time() - started + os.times().children_user - children
    return paid


def measured(samples: int, runs: int, chunk: int) -> str:
    """Return a table, after checking that a compiler was at hand."""
    model = arm()
    entries.LOOK_AFTER = entries.COMPILE_AFTER = 1
    paid = costs(model)
    if compiler._compiler() is None or compiler._folder() is None:
        raise SystemExit("there is no compiler here that works")
    lines = [
        "| what | NumPy, us/sample | compiled, us/sample | ratio |",
        "|---|--:|--:|--:|",
    ]
    saved = 0.0
    for name, call in calls(model, samples, chunk).items():
        for _ in range(3):
            call()  # imports, the structure of rows, and code that is compiled
        a, b = (1e6 * each / samples for each in in_turns(call, runs))
        saved = saved or a - b
        lines.append(f"| {name} | {a:.2f} | {b:.2f} | {a / b:.2f} |")
    for step, cost in paid.items():
        lines.append(
            f"\nTo {step} a robot's recursion: {1e3 * cost:.0f} ms, as much as it "
            f"saves in {1e6 * cost / saved:,.0f} samples."
        )
    return "\n".join(lines)


def main() -> None:
    """Measure with a folder of compiled files of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--chunk", type=int, default=CHUNK)
    parser.add_argument("--write", type=Path, help="page whose part is renewed")
    options = parser.parse_args()
    with (
        written_to(options.write, "compiled"),
        tempfile.TemporaryDirectory() as folder,
        threadpool_limits(1),
    ):
        os.environ["XDG_CACHE_HOME"] = folder
        print(measured(options.samples, options.runs, options.chunk))


if __name__ == "__main__":
    main()
