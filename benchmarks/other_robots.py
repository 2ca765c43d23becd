"""What is said of a log that belongs to another robot than the model.

``python benchmarks/other_robots.py [--only ARM ...] [--write PAGE]``: a log of each of
ten published arms, as `clean_simulations` draws them, is checked with the models of all
ten.  Arms of seven joints are cut off behind the sixth.  Nothing is selected, columns
are named by the model's joints.
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

ARMS = {
    **{arm: {} for arm in ("ur3", "ur5", "ur10", "kuka", "tx40", "so101")},
    "kinova": {"tip": "j2s6s200_link_6"},
    "panda": {"tip": "panda_link6"},
    "xarm7": {"tip": "link6"},
    "z1": {"tip": "link06"},
}
"""Ten arms of six joints, and where they end."""
RIGHT = "another robot"


def said(arm: str, log: ci.Recording, folder: Path) -> tuple[str, str]:
    """Return the verdict on a log by an arm's model, and its first reason."""
    robot = ci.load_robot(clean.arm_file(arm), **ARMS[arm])
    table = {"time": log.time} | {
        f"{name}_{joint}": values[:, j]
        for name, values in (("q", log.position), ("tau", log.torque))
        for j, joint in enumerate(robot.joint_names)
    }
    file = folder / "log.parquet"
    pd.DataFrame(table).to_parquet(file)
    draft = ci.draft_problem(clean.arm_file(arm), file, **ARMS[arm], select=False)
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
    parser.add_argument("--seed", type=int, default=3000, help="seed of the first log")
    parser.add_argument("--only", nargs="+", choices=ARMS, help="logs of these arms")
    parser.add_argument("--write", type=Path, help="page to write the table to")
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as where, threadpool_limits(1):
        for k, own in enumerate(ARMS):
            if own not in (options.only or ARMS):
                continue
            robot = ci.load_robot(clean.arm_file(own), **ARMS[own])
            log = clean.clean_log(options.seed + k, robot)
            for arm in ARMS:
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
