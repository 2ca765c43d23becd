"""What spoilt recordings show of their faults, beside whether verdicts found these.

``python benchmarks/faults_evidence.py --verdicts FILE [--results FILE] [--write
docs/faults-real.md]`` takes the logs of `faults_real`, whose ``--results`` is FILE.
Each is fitted with its fault and without it: with the same model, which is not
selected, and with the noise of the log without it, whose correlation counts.  The drop
of the sum of squares is what a test sees that knows which fault to undo, of which joint
and by how much: the square of its standard errors.  Bodies are pulled to those of the
file by usual errors of nominal ones (5 % of masses, 15 and 30 % of the link's size), or
they are free; the larger of the two drops counts.
"""

import argparse
import json
import os
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from clean_recordings import Robot, completed, draft_of
from faults_arms import RECORDINGS, arms
from faults_real import SPOILS, UNKNOWN, Log, Outcome, kept
from pages import written_to
from threadpoolctl import threadpool_limits

import consistent_id as ci
from consistent_id.diagnosis.explain import SAMPLES, thinned
from consistent_id.diagnosis.factor_logs import FactorLogs, least_costs
from consistent_id.problems.log_check import named_logs

BOUNDS = {
    (-np.inf, 9.0): "less than 3 standard errors, or the log is explained worse",
    (9.0, 25.0): "3 to 5 standard errors",
    (25.0, 100.0): "5 to 10 standard errors",
    (100.0, np.inf): "more than 10 standard errors",
}
"""Squares of standard errors, in words."""

ANSWERS = ("refused", "named", "estimated well", "care", "silently wrong")


def factor_logs(robot: Robot, folder: Path, label: str) -> FactorLogs:
    """Return the rows of a spoilt recording, prepared as a draft prepares it.

    Velocities are computed from positions: faults of the clock have no others.
    """
    import pandas as pd

    source = folder / robot.name
    table = pd.read_parquet(source / f"{RECORDINGS[robot.name][0]}.parquet")
    joints = sum(c[0] == "q" and c[1:].isdigit() for c in table)
    columns = {c: table[c].to_numpy(float) for c in table if not c.startswith("dq")}
    log = Log(columns, (source / robot.model).read_text(), joints)
    torque = robot.columns.get("torque", "tau{number}").removesuffix("{number}")
    spoilt = SPOILS[label][1](log, torque)
    named = {k: v for k, v in robot.columns.items() if k != "velocity"}
    own = replace(robot, columns=named)
    with tempfile.TemporaryDirectory() as where:
        into = Path(where)
        (into / robot.name).mkdir()
        (into / robot.name / robot.model).write_text(spoilt.urdf)
        file = into / robot.name / "log.parquet"
        pd.DataFrame(spoilt.columns).to_parquet(file)
        (into / "read").mkdir()
        read = completed(own, file, into, into / "read")
        problem = draft_of(own, into, read, select=False).problem()
        training, _ = named_logs(problem)
        joint_names = problem.model.robot.joint_names
        logs = [problem.prepare(log.of(joint_names)) for log in training]
    return FactorLogs.of(problem.model, [thinned(log, SAMPLES) for log in logs])


def evidence(right: FactorLogs, wrong: FactorLogs) -> float:
    """Return what undoing the fault explains, in squared noise."""
    pairs = (least_costs(replace(logs, noise=right.noise)) for logs in (wrong, right))
    return float(np.max(np.subtract(*pairs)))


def measured(file: Path | None) -> dict[str, float]:
    """Measure all spoilt logs; those that no draft can prepare are left out."""
    found: dict[str, float] = {}
    if file and file.exists():
        found = dict(map(json.loads, file.read_text().splitlines()))
    with tempfile.TemporaryDirectory() as where, threadpool_limits(1):
        folder = Path(where)
        for robot in arms(Path(os.environ["CONSISTENT_ID_DATASETS"]), folder):
            right = None
            for label in SPOILS:
                name = f"{robot.name}/{label}"
                if name in found or name in UNKNOWN or label == "whole":
                    continue
                right = right or factor_logs(robot, folder, "whole")
                try:
                    found[name] = evidence(right, factor_logs(robot, folder, label))
                except ci.ConsistentIdError:
                    found[name] = np.inf  # what cannot be read is no right log
                if file:
                    with file.open("a") as stream:
                        print(json.dumps([name, found[name]]), file=stream)
    return found


def main() -> None:
    """Print a table of what was found, by evidence, and what was not."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--verdicts", type=Path, required=True, metavar="FILE")
    parser.add_argument("--results", type=Path, help="lines of JSON, to resume from")
    parser.add_argument("--write", type=Path, help="page whose part is renewed")
    given = parser.parse_args()
    found, outcomes = measured(given.results), kept(given.verdicts)
    harmful = sorted((n for n in found if _harms(outcomes, n)), key=found.__getitem__)
    with written_to(given.write, "evidence"):
        print("| undoing the fault explains | logs |", *(f"{a} |" for a in ANSWERS))
        print("|---|---:|" + "---:|" * len(ANSWERS))
        for (low, high), said in BOUNDS.items():
            names = [n for n, value in found.items() if low <= value < high]
            answers = [_answer(outcomes, name) for name in names]
            cells = [answers.count(answer) for answer in ANSWERS]
            print(f"| {said} | {len(names)} |", *(f"{n} |" for n in cells))
        print("\n| harmful `use with care` | undoing it explains |\n|---|---:|")
        for name in harmful:
            arm, _, fault = name.partition("/")
            print(f"| {arm}: {fault} | {found[name]:.0f} |")


def _answer(outcomes: dict[str, Outcome], name: str) -> str:
    said = outcomes[name].answer(outcomes[f"{name.partition('/')[0]}/whole"].error)
    return said.removesuffix(", wrong cause").lower()


def _harms(outcomes: dict[str, Outcome], name: str) -> bool:
    found, whole = outcomes[name], outcomes[f"{name.partition('/')[0]}/whole"]
    return found.said == "use with care" and found.harmful(whole.error)


if __name__ == "__main__":
    main()
