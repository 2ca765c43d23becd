"""The measured parts of docs/rx60-story.md, and its pictures.

``python benchmarks/story.py [--write docs/rx60-story.md]``: a full
``consistent-id reproduce problems/rx60``.  Between ``<!-- measured: NAME -->`` and
``<!-- end -->`` the page is written anew; the rest is kept.
"""

import argparse
import re
from pathlib import Path

import numpy as np

from consistent_id import load_problem
from consistent_id._support.tables import Table
from consistent_id.laboratory.reproduction import PaperStudy, reproduce
from consistent_id.laboratory.reproduction import paper_tables as part
from consistent_id.laboratory.reproduction.paper_report import sections_of
from consistent_id.laboratory.reproduction.paper_study import (
    REPEATED,
    TASKS,
    WITHIN_LIMITS,
    WITHIN_USED,
)
from consistent_id.laboratory.reproduction.paper_tables import inertia_table

DPI = 90
SHOWN = ("alpha1", "alpha2", "alpha5", "alpha6", "alpha8", "alpha11", "alpha12")


def blocks(study: PaperStudy) -> dict[str, str]:
    """Return the measured parts by name."""
    return {
        "spread": _plain(part.spread_table(study)),
        "found": _found(study),
        "excitation": _excitation(study),
        "causes": _plain(_only(part.cause_table(study), SHOWN)),
        "drawn": _plain(part.drawn_table(study)),
        "tempo": _plain(part.tempo_table(study)),
        "exciting": _exciting(study),
        "shrunk": _plain(part.shrunk_table(study)),
        "constraints": _plain(_only(part.constraints_table(study), SHOWN)),
        "inertia": _plain(_only(inertia_table(study, study.inertia[2]), ("link2",))),
        "verification": _verification(study),
    }


def _found(study: PaperStudy) -> str:
    place, done = study.place.most_scattered, study.tasks
    lines = ["| alpha5 | mean | standard deviation |", "|---|---:|---:|"]
    mean, deviation = study.report.mean[place], study.report.standard_deviation[place]
    lines.append(f"| the paper | {mean:.4f} | {deviation:.4f} |")
    lines += [
        f"| again: {table.method} | {table.mean[place]:.4f} | "
        f"{table.standard_deviation[place]:.4f} |"
        for table in done.tables
    ]
    lines.append(f"| true in the laboratory | {done.truth[place]:.4f} | |")
    return "\n".join(lines)


def _excitation(study: PaperStudy) -> str:
    names = [e.name for e in study.tasks.experiments]
    lines = [
        "| moved along | " + " | ".join(names) + " |",
        "|---|" + "---:|" * len(names),
    ]
    for name, done in study.with_friction.items():
        numbers = (f"{e.excitation.condition:.1f}" for e in done.experiments)
        lines.append(f"| {name} | " + " | ".join(numbers) + " |")
    return "\n".join(lines)


def _exciting(study: PaperStudy) -> str:
    header = ("parameter", TASKS, WITHIN_USED, WITHIN_LIMITS, REPEATED, "its RMS error")
    rows = []
    for method in (0, 2):
        for name in SHOWN:
            i = study.tasks.names.index(name)
            row = [name if method == 0 else f"{name}, friction in the model"]
            for which in (TASKS, WITHIN_USED, WITHIN_LIMITS, REPEATED):
                done = study.with_friction[which]
                row.append(f"{done.scatter(done.tables[method])[i]:.4f}")
            errors = done.errors(done.tables[method])[:, i]
            row.append(f"{np.sqrt((errors**2).mean()):.4f}")
            rows.append(tuple(row))
    return _plain(Table("", header, tuple(rows)))


def _verification(study: PaperStudy) -> str:
    found, rows = study.verification, []
    for one, errors in zip(found.predictors, found.mean_squared_errors, strict=True):
        if one.source in (TASKS, WITHIN_LIMITS, "the laboratory"):
            cells = (f"{e:.4f}" if e < 1.0 else f"{e:.1f}" for e in errors.ravel())
            rows.append((one.source, one.method, *cells))
    printed = (f"{value:.4f}" for value in study.spread.printed.ravel())
    rows.insert(0, ("the paper", "as printed", *printed))
    header = ("moved along", "method")
    header += tuple(f"{m}, {j}" for m in (1, 2, 3) for j in found.joints)
    return _plain(Table("", header, tuple(rows)))


def _only(table: Table, names: tuple[str, ...]) -> Table:
    rows = tuple(row for row in table.rows if row[0] in names)
    return Table(table.title, table.header, rows)


def _plain(table: Table) -> str:
    return table.markdown().split("\n", 2)[2].strip()


def pictures(study: PaperStudy, folder: Path) -> list[Path]:
    """Draw every figure of the study."""
    drawn = []
    for section in sections_of(study):
        for name, _, draw in section.figures:
            figure = draw(study)
            for axis in figure.axes:
                axis.set_axisbelow(True)
                axis.grid(alpha=0.3)
            drawn.append(folder / f"rx60-{name}.png")
            figure.savefig(drawn[-1], dpi=DPI)
    return drawn


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, help="page to write the figures into")
    options = parser.parse_args()
    study = reproduce(load_problem("problems/rx60"), progress=print)
    measured = blocks(study)
    if not options.write:
        print("\n\n".join(f"{name}\n\n{text}" for name, text in measured.items()))
        return
    page = options.write.read_text()
    for name, text in measured.items():
        mark = f"<!-- measured: {name} -->"
        old = re.compile(re.escape(mark) + r".*?<!-- end -->", re.DOTALL)
        new = f"{mark}\n\n{text}\n\n<!-- end -->"
        page = old.sub(lambda _, new=new: new, page)
    options.write.write_text(page)
    pictures(study, options.write.parent)


if __name__ == "__main__":
    main()
