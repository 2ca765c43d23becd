"""What compiled code saves, and after how many samples it has paid for itself.

``python benchmarks/compiled.py [--samples 200000] [--chunk 4072]``.  Processor seconds,
one thread, the least of several runs; look at the ratios.  ``--chunk`` concerns the
regressor alone.
"""

import argparse
import os
import tempfile
from collections.abc import Callable
from time import process_time, thread_time

from speed import arm, log

import consistent_id as ci
from consistent_id.regression.compiled import compiler, entries
from consistent_id.regression.regressor import CHUNK


def least(call: Callable[[], object], runs: int = 5) -> float:
    """Return processor seconds."""
    times = []
    for _ in range(runs):
        started = process_time()
        call()
        times.append(process_time() - started)
    return min(times)


def measured(samples: int, chunk: int) -> str:
    """Return a table, after checking that a compiler was at hand."""
    os.environ[compiler.SWITCH] = "0"
    model = arm()
    data = log(model, samples)
    state = data.position, data.velocity, data.acceleration

    def regressor() -> None:
        for _ in model.chunks(*state, chunk):
            pass

    calls = {
        "regressor": regressor,
        "regressor and compression": lambda: ci.build_regression(model, data),
    }
    for call in calls.values():
        call()  # imports, and the structure of rows
    by_numpy = {name: least(call) for name, call in calls.items()}
    os.environ[compiler.SWITCH] = "1"
    entries.LOOK_AFTER = entries.COMPILE_AFTER = 1
    paid = {"compile": 0.0, "load": 0.0}
    for step in paid:
        entries._recursion.cache_clear()
        short = [x[:100] for x in state]
        children, started = os.times().children_user, thread_time()
        for _ in range(3 if step == "compile" else 1):
            model.regressor(*short)
        paid[step] = thread_time() - started + os.times().children_user - children
    if not any(r.found for r in [_recursion(model, short)]):
        raise SystemExit("there is no compiler here that works")
    for call in calls.values():
        call()
        call()
    by_code = {name: least(call) for name, call in calls.items()}
    lines = [
        "| what | NumPy, us/sample | compiled, us/sample | ratio |",
        "|---|--:|--:|--:|",
    ]
    for name in calls:
        a, b = 1e6 * by_numpy[name] / samples, 1e6 * by_code[name] / samples
        lines.append(f"| {name} | {a:.2f} | {b:.2f} | {a / b:.2f} |")
    saved = (by_numpy["regressor"] - by_code["regressor"]) / samples
    for step, cost in paid.items():
        lines.append(
            f"\nTo {step}: {1e3 * cost:.0f} ms, as much as it saves in "
            f"{cost / saved:,.0f} samples."
        )
    return "\n".join(lines)


def _recursion(model: ci.TorqueModel, state: list) -> entries._Recursion:
    """Return what is known of the model's recursion."""
    seen = []
    kernel = entries._Recursion.kernel

    def noted(self: entries._Recursion, samples: int) -> object:
        seen.append(self)
        return kernel(self, samples)

    entries._Recursion.kernel = noted
    try:
        model.regressor(*state)
    finally:
        entries._Recursion.kernel = kernel
    return seen[0]


def main() -> None:
    """Measure with a folder of compiled files of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--chunk", type=int, default=CHUNK)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = folder
        print(measured(options.samples, options.chunk))


if __name__ == "__main__":
    main()
