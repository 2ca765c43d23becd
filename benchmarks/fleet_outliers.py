"""How often robots of a fleet are named wrongly as outliers, and rightly.

``python benchmarks/fleet_outliers.py [--fleets 100] [--write PAGE]``

Robots of 12 shared parameters differ along three directions, by no more than noise
(scatter 0), somewhat more, or much more than noise.  One robot in each second fleet
differs ten times as much.  From here comes `LEVEL` in ``fleet/fleet_result.py``.
"""

import argparse

import numpy as np
from pages import add_write, shown_on

from consistent_id.fleet.fleet_result import LEVEL, find_outliers

_PARAMETERS, _DIRECTIONS, _ROWS = 12, 3, 120


def factor(rng: np.random.Generator, x: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return the triangular factor of a robot's rows, noise being one."""
    A = rng.normal(size=(_ROWS, len(x))) * sizes
    torque = A @ x + rng.normal(size=_ROWS)
    return np.asarray(np.linalg.qr(np.column_stack([A, torque]), mode="r"))


def shares(robots: int, scatter: float, fleets: int) -> tuple[float, float]:
    """Return the share of fleets with a false name, and of outliers named."""
    false = right = 0
    rng = np.random.default_rng(robots)
    for _ in range(fleets):
        x = rng.normal(size=_PARAMETERS)
        sizes = 10 ** rng.uniform(-1, 1, _PARAMETERS)
        along = rng.normal(size=(_PARAMETERS, _DIRECTIONS)) / _DIRECTIONS

        def robot(size, x=x, sizes=sizes, along=along):
            return factor(rng, x + size * along @ rng.normal(size=_DIRECTIONS), sizes)

        fleet = [robot(scatter) for _ in range(robots)]
        false += find_outliers(fleet).named.any()
        fleet[0] = robot(10.0 * max(scatter, 0.1))
        right += find_outliers(fleet).named[0]
    return false / fleets, right / fleets


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleets", type=int, default=100)
    add_write(parser)
    options = parser.parse_args()
    with shown_on(options.write):
        report(options.fleets)


def report(fleets: int) -> None:
    """Print the table."""
    print(f"level {LEVEL:g}, {fleets} fleets in each row")
    print("| robots | scatter | fleets with a false name | outliers named |")
    print("|---:|---:|---:|---:|")
    for robots in (4, 5, 8, 12, 30, 100):
        for scatter in (0.0, 0.1, 1.0):
            false, right = shares(robots, scatter, fleets)
            row = f"{robots} | {scatter:g} | {100 * false:.0f} % | {100 * right:.0f} %"
            print(f"| {row} |", flush=True)


if __name__ == "__main__":
    main()
