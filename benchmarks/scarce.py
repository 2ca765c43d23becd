"""How estimates hold up when data are scarce: held-out torque error on real robots.

``python benchmarks/scarce.py [--write docs/scarce-data.md]``, with recordings in
``CONSISTENT_ID_DATASETS``.  A part of the training motion is used.
"""

import argparse
import statistics
import sys
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl

sys.path.insert(0, str(Path(__file__).parent))
from pages import measured

import consistent_id as ci
from consistent_id.comparison.comparison import EstimateReport
from consistent_id.estimation.method import Method

mpl.use("Agg")
from matplotlib import pyplot as plt

ROBOTS = ("ur10e", "kuka_kr300", "staubli_tx40", "tiago")
SHARES = (1.0, 0.3, 0.1, 0.03, 0.01)
STARTS = 5
FEWEST = 20  # samples
METHODS = {
    Method.LEAST_SQUARES: "least squares",
    Method.WEIGHTED_LEAST_SQUARES: "weighted least squares",
    Method.BOX_CONSTRAINED: "QP: masses and signs",
    Method.CONSTRAINED: "SDP",
    Method.CROSS_VALIDATED: "SDP + cross-validated prior",
}
CONSISTENT = (
    Method.CONSTRAINED,
    Method.WEIGHTED_CONSTRAINED,
    Method.CROSS_VALIDATED,
)


@dataclass(frozen=True)
class Cell:
    """One method with one share of the data, over several parts of the motion."""

    errors: tuple[float, ...]
    links: int
    certified: int

    @property
    def median(self) -> float:
        """The middle of the errors."""
        return statistics.median(self.errors)

    @property
    def text(self) -> str:
        """The median, and the worst."""
        return f"{_percent(self.median)} ({_percent(max(self.errors))})"


def _percent(share: float) -> str:
    return f"{share:.1%}" if share < 10.0 else f"{100 * share:.0e}%"


def parts(log: ci.Recording, share: float) -> list[ci.Recording]:
    """Return up to five runs of the recording, spread evenly, each of this share."""
    length = max(round(share * len(log)), FEWEST)
    room = len(log) - length
    starts = sorted({round(i * room / (STARTS - 1)) for i in range(STARTS)})
    return [log.samples(slice(start, start + length)) for start in starts]


def cells(problem: ci.Problem, share: float) -> dict[str, Cell]:
    """Return what each method makes of the parts."""
    (log,) = problem.training
    reports: dict[str, list[EstimateReport]] = {}
    for part in parts(log, share):
        estimates = ci.Study(problem, recordings=((part,), ())).estimates
        for report in ci.compare(estimates, problem.validation).reports:
            reports.setdefault(report.estimate.method, []).append(report)
    return {
        name: Cell(
            tuple(
                statistics.mean(e.stacked for e in report.validation)
                for report in found
            ),
            min(sum(report.consistent_links) for report in found),
            sum(r.estimate.certificate.verdict == "certified" for r in found),
        )
        for name, found in reports.items()
    }


def section(name: str, table: dict[float, dict[str, Cell]], links: int) -> list[str]:
    """Return one robot's table as Markdown."""
    lines = [
        f"## {name}",
        "",
        "| share of the data | " + " | ".join(METHODS.values()) + " |",
        "|---|" + "---:|" * len(METHODS),
    ]
    for share, row in table.items():
        texts = [row[method].text for method in METHODS]
        lines.append(f"| {share:.0%} | " + " | ".join(texts) + " |")
    fewest = [min(row[m].links for row in table.values()) for m in METHODS]
    bodies = " | ".join(f"{n} of {links}" for n in fewest)
    lines.append(f"| fewest consistent links | {bodies} |")
    return [*lines, ""]


def verdict_line(tables: dict[str, dict[float, dict[str, Cell]]]) -> str:
    """Return how many constrained estimates are certified."""
    counted = [
        (cell.certified, len(cell.errors))
        for table in tables.values()
        for row in table.values()
        for method, cell in row.items()
        if method in CONSISTENT
    ]
    certified, total = (sum(n) for n in zip(*counted, strict=True))
    return f"Of {total} consistent estimates, {certified} are certified."


def figure(tables: dict[str, dict[float, dict[str, Cell]]], path: Path) -> None:
    """Draw the medians over the share of the data, one panel for each robot."""
    colours = ("#999999", "#e69f00", "#56b4e9", "#d55e00", "#0072b2")
    drawing, axes = plt.subplots(1, len(tables), figsize=(11, 3.4), sharex=True)
    for axis, (name, table) in zip(axes, tables.items(), strict=True):
        shares = [100 * share for share in table]
        for (method, label), colour in zip(METHODS.items(), colours, strict=True):
            medians = [100 * row[method].median for row in table.values()]
            axis.loglog(shares, medians, "o-", ms=4, color=colour, label=label)
        axis.set_title(name, fontsize=10)
        axis.set_xlabel("share of the training data [%]")
        axis.set_ylim(top=min(axis.get_ylim()[1], 2000))
        axis.grid(alpha=0.3, which="both", lw=0.4)
    axes[0].set_ylabel("held-out torque error [%]")
    handles, labels = axes[0].get_legend_handles_labels()
    drawing.legend(
        handles, labels, loc="outside lower center", ncol=5, fontsize=8, frameon=False
    )
    drawing.set_layout_engine("constrained")
    drawing.savefig(path, dpi=110)
    plt.close(drawing)


def page(names: tuple[str, ...], picture: Path | None) -> str:
    """Measure and return the page as Markdown."""
    tables, lengths = {}, {}
    for name in names:
        problem = ci.load_problem(f"problems/{name}")
        tables[name] = {share: cells(problem, share) for share in SHARES}
        lengths[name] = len(problem.model.robot), len(problem.training[0])
    lines = [
        "# When data are scarce",
        "",
        f"{measured(names)}.",
        "",
        "A part of each robot's training",
        "motion is used for training. The error is the stacked torque error on its",
        "validation recordings, the mean over these recordings. The tables show the",
        f"median (worst) over up to {STARTS} parts, spread evenly; no part has fewer",
        f"than {FEWEST} samples. Settings are those of the problem folders, for all",
        "shares. The whole training data have",
        ", ".join(f"{n} samples ({name})" for name, (_, n) in lengths.items()) + ".",
        verdict_line(tables),
        "",
    ]
    if picture is not None:
        figure(tables, picture)
        lines += [f"![Held-out error over the share of data]({picture.name})", ""]
    for name, table in tables.items():
        lines += section(name, table, lengths[name][0])
    return "\n".join(lines).rstrip() + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("--write", type=Path, help="file to write the page to")
    options = parser.parse_args()
    picture = options.write and options.write.with_suffix(".png")
    text = page(tuple(options.robots), picture)
    print(text)
    if options.write:
        options.write.write_text(text)


if __name__ == "__main__":
    main()
