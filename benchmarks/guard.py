"""Whether a hot path has become twice as slow, on any machine.

``python benchmarks/guard.py`` times each path beside a reference that never changes,
NumPy and LAPACK on fixed arrays, in the same process and taking turns with it.  It ends
with 1 if a ratio of processor seconds is more than twice the one written down here.
``--only NAME`` does one path, ``--update`` prints ratios to write down.
"""

import argparse
import sys
from collections.abc import Callable
from time import process_time

import numpy as np
from scipy.linalg.lapack import dgeqrf
from speed import arm, log, truth
from threadpoolctl import threadpool_limits

import consistent_id as ci
from consistent_id.regression.mass_matrix import mass_matrices, random_poses

SLOWER = 2.0  # ratios scatter by a third between machines and loads
RUNS = 7  # turns; the least of each counts
SAMPLES = 30_000
CUTOFF = 10.0  # Hz, of filtered torque

EXPECTED = {
    "regressor": 4.2,
    "regressor and compression": 16.5,
    "regression of filtered torque": 17.0,
    "prediction": 2.9,
    "mass matrices": 1.45,
    "base parameters": 0.3,
    "least squares": 0.68,
    "constrained estimate": 6.0,
}
"""Processor seconds over those of the reference, by `--update`."""


def reference() -> None:
    """Do what hot paths do: long sums of short arrays, and QR of tall matrices."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-0.9, 0.9, (2, 4096))
    for _ in range(1000):
        y = x * y + x
        y -= x
    rows = np.asfortranarray(rng.normal(size=(4096, 48)))
    for _ in range(3):
        dgeqrf(rows)


def paths() -> dict[str, Callable[[], object]]:
    """Return hot paths by name, prepared."""
    model = arm()
    data = log(model, SAMPLES)
    state = data.position, data.velocity, data.acceleration
    parameters = truth(model)
    regression = ci.build_regression(model, data)
    base = ci.regression.base_parameters(model)
    poses = random_poses(model, 10_000, 0)

    def regressor() -> None:
        for _ in model.chunks(*state):
            pass

    def compressed() -> None:
        ci.build_regression(model, data)

    def filtered() -> None:
        smooth = ci.signals.low_passed(data, torque_cutoff=CUTOFF)
        ci.build_regression(model, smooth)

    def masses() -> None:
        mass_matrices(model, parameters, poses)

    return {
        "regressor": regressor,
        "regressor and compression": compressed,
        "regression of filtered torque": filtered,
        "prediction": lambda: model.predict(parameters, *state),
        "mass matrices": masses,
        "base parameters": lambda: ci.regression.base_parameters(model),
        "least squares": lambda: ci.least_squares(model, regression, base=base),
        "constrained estimate": lambda: ci.constrained_least_squares(
            model, regression, base=base
        ),
    }


def ratio(path: Callable[[], object]) -> float:
    """Return processor seconds over those of the reference."""
    for _ in range(3):
        path()  # imports and caches
    times = np.empty((RUNS, 2))
    for run in times:
        for i, call in enumerate((reference, path)):
            started = process_time()
            call()
            run[i] = process_time() - started
    least = times.min(axis=0)
    return float(least[1] / least[0])


def main() -> int:
    """Compare all ratios with those written down."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=EXPECTED)
    parser.add_argument("--update", action="store_true")
    options = parser.parse_args()
    slow = []
    with threadpool_limits(1, user_api="blas"):
        for name, path in paths().items():
            if options.only not in (None, name):
                continue
            found, expected = ratio(path), EXPECTED[name]
            if options.update:
                print(f'    "{name}": {found:.2g},')
                continue
            print(f"{name:28} {found:7.2f} of the reference, expected {expected:.2f}")
            if found > SLOWER * expected:
                slow.append(name)
    if slow and not options.update:
        print(f"more than {SLOWER:g} times as slow: {', '.join(slow)}", file=sys.stderr)
    return 1 if slow and not options.update else 0


if __name__ == "__main__":
    sys.exit(main())
