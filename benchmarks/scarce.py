"""How estimates hold up when data are scarce: held-out torque error on a real robot.

``python benchmarks/scarce.py [--write docs/scarce-data.md]``, with recordings in
``CONSISTENT_ID_DATASETS``.  The first part of the training motion is all there is.
"""

import argparse
import statistics
from pathlib import Path

import consistent_id as ci

SHARES = (1.0, 0.3, 0.1, 0.03, 0.01)
STARTS = 5
METHODS = (
    "least squares",
    "weighted least squares",
    "bounded",
    "constrained",
    "weighted constrained",
)


def parts(log: ci.Recording, share: float) -> list[ci.Recording]:
    """Return up to five runs of the recording, spread evenly, each of this share."""
    length = max(round(share * len(log)), 20)
    room = len(log) - length
    starts = sorted({round(i * room / (STARTS - 1)) for i in range(STARTS)})
    return [log.samples(slice(start, start + length)) for start in starts]


def errors(problem: ci.Problem, share: float) -> dict[str, dict[str, float]]:
    """Return the median held-out error, and bodies, of each method over the parts."""
    (log,) = problem.training
    base = ci.base_parameters(problem.model)
    stacked: dict[str, list[float]] = {name: [] for name in METHODS}
    bodies: dict[str, list[float]] = {name: [] for name in METHODS}
    for part in parts(log, share):
        estimates = ci.identify(problem, [part], base=base)
        for report in ci.compare(estimates, problem.validation).reports:
            name = report.estimate.method
            if name in stacked:
                held_out = [error.stacked for error in report.validation]
                stacked[name].append(statistics.mean(held_out))
                bodies[name].append(sum(report.consistent_links))
    return {
        name: {
            "error": statistics.median(stacked[name]),
            "worst": max(stacked[name]),
            "bodies": min(bodies[name]),
        }
        for name in METHODS
    }


def page() -> str:
    """Measure and return the page as Markdown."""
    problem = ci.load_problem("problems/ur10e")
    (log,) = problem.training
    links = len(problem.model.robot)
    lines = [
        "# When data are scarce",
        "",
        "Measured by `python benchmarks/scarce.py`: UR10e, parts of `30sec_12harm` to",
        "learn from, `50sec_12harm` and `20sec_8harm` to judge by. Stacked torque",
        "error, mean of the two; median (worst) over up to five parts of the training",
        "motion; settings are those of `problems/ur10e`, the same for all. The whole",
        f"has {len(log)} samples at 100 Hz.",
        "",
        "| share of the data | " + " | ".join(METHODS) + " |",
        "|---|" + "---:|" * len(METHODS),
    ]
    fewest = dict.fromkeys(METHODS, float(links))
    for share in SHARES:
        found = errors(problem, share)
        cells = [f"{v['error']:.1%} ({v['worst']:.1%})" for v in found.values()]
        lines.append(f"| {share:.0%} | " + " | ".join(cells) + " |")
        for name, values in found.items():
            fewest[name] = min(fewest[name], values["bodies"])
    cells = [f"{fewest[name]:.0f} of {links}" for name in METHODS]
    lines.append("| fewest links that are bodies | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, help="file to write the page to")
    options = parser.parse_args()
    text = page()
    print(text)
    if options.write:
        options.write.write_text(text)


if __name__ == "__main__":
    main()
