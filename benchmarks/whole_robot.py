"""Factors of whole robots: of right logs of real arms, and of logs with a fault put in.

``python benchmarks/whole_robot.py [--only ur10e ...] [--write FILE]`` estimates the
speed of the clock, one gain of all torques, the gain and the zero of each joint and the
lean of the base beside the nominal bodies, from the logs of the problem files of five
real arms, with recordings in ``CONSISTENT_ID_DATASETS``.  A fault is put into all logs
of a robot as the diagnosis would take it out, with the opposite sign.

The gates of `consistent_id.diagnosis.factor_findings` are above the ratios of size and
standard error that right logs have here.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from time import process_time

import numpy as np
from pages import written_to
from threadpoolctl import threadpool_limits

import consistent_id as ci
from consistent_id.constraints import FixedMasses
from consistent_id.diagnosis.explain import SAMPLES, of_samples, thinned
from consistent_id.diagnosis.factor_findings import (
    FARTHEST,
    FoundFactor,
    factor_findings,
)
from consistent_id.diagnosis.factor_logs import FactorLogs, factors_of, joint_gains
from consistent_id.diagnosis.factor_rows import Factor
from consistent_id.diagnosis.whole_robot import whole_robot_factors

NAMES = ("ur10e", "kuka_kr300", "staubli_tx40", "tiago", "unitree_z1")
KINDS = ("clock", "masses or gain", "torque gain", "offset zero", "gravity")
FAULTS = {
    "right": ("", 0, 0.0),
    "clock 1.5 times as fast": ("clock", 0, float(np.log(1.5))),
    "clock at 0.7 times": ("clock", 0, float(np.log(0.7))),
    "torques 1.4 times": ("masses or gain", 0, float(np.log(1.4))),
    "torque of second joint 1.4 times": ("torque gain", 1, float(np.log(1.4))),
    "zero of second joint off by 12 degrees": (
        "offset zero",
        1,
        float(np.radians(12.0)),
    ),
    "base leans by 10 degrees": ("gravity", 0, float(np.radians(10.0))),
}
"""Label -> kind of a factor, its place among those of the kind, and its size."""


def logs_of(name: str) -> FactorLogs:
    """Return the training logs of a problem file, as the diagnosis examines them."""
    problem = ci.load_problem(Path("problems") / name)
    joints = problem.model.robot.joint_names
    logs = [
        thinned(of_samples(problem.prepare(log)).of(joints), SAMPLES)
        for log in problem.logs("training")
    ]
    known = any(isinstance(c, FixedMasses) for c in problem.constraints)
    return FactorLogs.of(problem.model, logs, masses_known=known)


def with_fault(logs: FactorLogs, kind: str, place: int, size: float) -> FactorLogs:
    """Put a factor into logs."""
    if not kind:
        return logs
    every = (*factors_of(logs.model), *joint_gains(logs.model))
    factor = [f for f in every if f.kind == kind][place]
    return logs.without(factor, -size)


def largest(found: Sequence[FoundFactor], kind: str) -> str:
    """Return the factor of a kind with the largest ratio, its error and the ratio.

    Factors that are too far from one, or from zero, to be reported do not count.
    """
    own = [f for f in found if f.factor.kind == kind and np.isfinite(f.error)]
    own = [f for f in own if abs(f.size) <= FARTHEST[kind]] or own
    if not own:
        return "-"
    most = max(own, key=lambda f: f.ratio)
    return f"{_size(most.factor, most.size, most.error)} ({most.ratio:.1f})"


def _size(factor: Factor, size: float, error: float) -> str:
    if factor.kind in ("clock", "masses or gain", "torque gain"):
        ratio = f"{np.exp(size):.2f} ± {np.exp(size) * error:.2f}"
        return f"{factor.where} {ratio}" if factor.kind == "torque gain" else ratio
    angle = f"{np.degrees(size):.1f} ± {np.degrees(error):.1f}°"
    return f"{factor.where} {angle}" if factor.kind == "offset zero" else angle


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", nargs="+", choices=NAMES, default=NAMES)
    parser.add_argument("--write", type=Path, help="page to write the table to")
    options = parser.parse_args()
    rows = []
    with threadpool_limits(1):
        for name in options.only:
            logs = logs_of(name)
            for label, fault in FAULTS.items():
                started = process_time()
                spoilt = with_fault(logs, *fault)
                found = whole_robot_factors(spoilt)
                said = ", ".join(
                    f"{f.kind} ({f.severity})"
                    for f in factor_findings(spoilt.model, found)
                )
                cells = [largest(found, kind) for kind in KINDS]
                rows.append((name, label, *cells, said or "-"))
                print(*rows[-1], f"{process_time() - started:.1f} s", sep=" | ")
    head = "| robot | log | clock | gain | gain of a joint | zero | lean | said |"
    with written_to(options.write, "factors", options.only):
        print(head, "|---" * 8 + "|", sep="\n")
        for row in rows:
            print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
