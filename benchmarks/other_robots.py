"""What is said of a log that belongs to another robot than the model.

``python benchmarks/other_robots.py [--write docs/what-the-robot-shows.md]``: logs
of published arms, as `clean_simulations` draws them, are checked with the models of
arms of as many joints.  Nothing is selected, columns are named by the model's joints.
"""

import argparse
import tempfile
from pathlib import Path

import clean_simulations as clean
import pandas as pd
from pages import written_to
from threadpoolctl import threadpool_limits

import consistent_id as ci
from consistent_id.problems.log_check import check_problem

GROUPS = (("ur3", "ur5", "ur10", "kinova", "kuka", "tx40"), ("panda", "xarm7", "z1"))
RIGHT = "another robot"


def said(arm: str, log: ci.Recording, folder: Path) -> tuple[str, str]:
    """Return the verdict on a log by an arm's model, and its first reason."""
    robot = ci.load_robot(clean.arm_file(arm), tip=clean.ARMS[arm][1])
    table = {"time": log.time} | {
        f"{name}_{joint}": values[:, j]
        for name, values in (("q", log.position), ("tau", log.torque))
        for j, joint in enumerate(robot.joint_names)
    }
    file = folder / "log.parquet"
    pd.DataFrame(table).to_parquet(file)
    draft = ci.draft_problem(
        clean.arm_file(arm), file, tip=clean.ARMS[arm][1], select=False
    )
    problem = draft.problem(folder)
    found = check_problem(problem)
    if found.faults:
        return "do not use", found.faults[0].kind
    try:
        verdict = ci.run_study(problem).verdict
    except ci.ConsistentIdError as refusal:
        return "refused", type(refusal).__name__
    if found.suspicious:
        return verdict.word, found.suspicious[0].kind
    return verdict.word, next((r.kind for r in verdict.grounds), "-")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seed", type=int, default=3000)
    parser.add_argument("--write", type=Path, help="page to write the table to")
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as where, threadpool_limits(1):
        for group in GROUPS:
            for own in group:
                seeds = range(options.seed, options.seed + len(clean.ARMS))
                seed = next(s for s in seeds if clean.arm_of(s) == own)
                log = clean.clean_log(seed)
                for arm in group:
                    rows.append((own, arm, *said(arm, log, Path(where))))
                    print(*rows[-1], flush=True)
    wrong = [row for row in rows if row[0] != row[1]]
    named = sum(row[3] == RIGHT for row in wrong)
    used = sum(row[2] == "use" for row in wrong)
    accused = sum(row[3] == RIGHT for row in rows if row[0] == row[1])
    with written_to(options.write, "other robots"):
        print(
            f"Of {len(wrong)} logs of another arm, {named} are said to be another "
            f"robot's first, {used} are `use`. Of {len(rows) - len(wrong)} right ones, "
            f"{accused} are said to be another robot's.\n"
        )
        print(
            "| log of | model of | verdict | first reason |",
            "|---|---|---|---|",
            sep="\n",
        )
        for row in rows:
            print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
