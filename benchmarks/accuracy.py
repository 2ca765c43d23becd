"""Held-out torque error on four real robots, settings as their problem files have them.

``python benchmarks/accuracy.py [--write docs/accuracy.md --readme README.md]``, with
recordings in ``CONSISTENT_ID_DATASETS``.  Settings were chosen on training data.
"""

import argparse
from pathlib import Path
from time import perf_counter

import blocks
import numpy as np
import pairs
from pages import measured

import consistent_id as ci
from consistent_id.estimation.method import Method

PROBLEMS = ("ur10e", "ur10e/payload.toml", "kuka_kr300", "staubli_tx40", "tiago")
SHOWN = {
    Method.LEAST_SQUARES: "least squares",
    Method.WEIGHTED_LEAST_SQUARES: "weighted",
    Method.HUBER: "Huber",
    Method.BOX_CONSTRAINED: "QP",
    Method.CONSTRAINED: "constrained",
    Method.WEIGHTED_CONSTRAINED: "weighted constrained",
    Method.CROSS_VALIDATED: "cross-validated prior",
}
BEGIN, END = "<!-- accuracy: begin -->", "<!-- accuracy: end -->"


def rows(file: str) -> tuple[list[str], list[str]]:
    """Return one problem's summary rows, and its rows joint by joint."""
    started = perf_counter()
    study = ci.run_study(ci.load_problem(f"problems/{file}"))
    seconds = perf_counter() - started
    name = study.problem.name
    reports = {r.estimate.method: r for r in study.comparison.reports}
    summary, detail = [], []
    for i, recording in enumerate(study.validation):
        stacked = [f"{reports[m].validation[i].stacked:.2%}" for m in SHOWN]
        label = f"{name}, {Path(recording.name).stem}"
        summary.append(f"| {label} | {' | '.join(stacked)} |")
        for method, label in SHOWN.items():
            error = reports[method].validation[i]
            joints = ", ".join(f"{share:.1%}" for share in error.relative)
            detail.append(
                f"| {Path(recording.name).stem} | {label} | {error.stacked:.2%} "
                f"| {joints} |"
            )
    links = len(study.problem.model.robot)
    consistent = [f"{sum(reports[m].consistent_links)} of {links}" for m in SHOWN]
    verdicts = [reports[m].verdict.word for m in SHOWN]
    summary.append(f"| consistent links | {' | '.join(consistent)} |")
    summary.append(f"| verdict | {' | '.join(verdicts)} |")
    summary.append(f"| expected from training | {' | '.join(expected(study))} |")
    title = [
        f"## {name}",
        "",
        f"The whole study takes {seconds:.0f} s.",
        "",
        f"Recommended from the training data: {study.recommendation.method}; "
        + foretold(study),
        "",
        "| recording | method | all joints | per joint, over the RMS torque |",
        "|---|---|---:|---|",
    ]
    return summary, [*title, *detail, ""]


def expected(study: ci.Study) -> list[str]:
    """Return the error that each candidate expects; the recommended one's is bold."""
    found = study.recommendation
    errors = dict(zip(found.candidates, found.error, strict=True))
    cells = [f"{errors[m]:.2%}" if m in errors else "-" for m in SHOWN]
    chosen = list(SHOWN).index(Method(found.method))
    cells[chosen] = f"**{cells[chosen]}**"
    return cells


def foretold(study: ci.Study) -> str:
    """Return the error expected of the recommended method, and the errors found."""
    expected = study.recommendation.expected
    if expected is None:
        return "no error is expected."
    measured = [error.stacked for error in study.recommended.validation]
    ratios = ", ".join(f"{error / expected.error:.2f}" for error in measured)
    return (
        f"expected {expected.error:.2%}, 80 % range {expected.low:.2%} to "
        f"{expected.high:.2%}; held-out error over the expected one: {ratios}."
    )


def across_recordings(every: pairs.Pairs, held_out: blocks.Blocks) -> list[str]:
    """Return summary rows of the UR10e's pairs and of the TX40's blocks."""
    errors = {method: every.held_out(method) for method in SHOWN}
    number = len(errors[Method.CONSTRAINED])
    shown = {
        f"ur10e, median of {number} pairs": [np.median(e) for e in errors.values()],
        f"ur10e, worst of {number} pairs": [np.max(e) for e in errors.values()],
        f"staubli_tx40, {blocks.COUNT} blocks": [held_out.overall[m] for m in SHOWN],
    }
    return [
        f"| {label} | {' | '.join(f'{share:.2%}' for share in shares)} |"
        for label, shares in shown.items()
    ]


def short(table: str) -> str:
    """Return README's table: of each recording, least squares and the recommended.

    The recommended estimate is the one whose expected error is bold.
    """
    lines = [
        "| robot, held-out recording | least squares | recommended | consistent links "
        "| verdict |",
        "|---|---:|---:|---:|---|",
    ]
    found: list[list[str]] = []
    facts = {"consistent links": [""], "verdict": [""]}
    for line in table.splitlines()[2:]:
        label, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        if label in facts:
            facts[label] = cells
        elif label == "expected from training":
            best = next(i for i, cell in enumerate(cells) if cell.startswith("**"))
            links, verdict = facts["consistent links"], facts["verdict"]
            lines += [
                f"| {name} | {errors[0]} | {errors[best]} "
                f"| {links[best]} ({links[0].split()[0]}) | {verdict[best]} |"
                for name, *errors in found
            ]
            found = []
        else:
            found.append([label, *cells])
    return "\n".join(lines)


def measure() -> tuple[str, str]:
    """Return the summary table, and the page."""
    header = [
        "| held-out recording | " + " | ".join(SHOWN.values()) + " |",
        "|---|" + "---:|" * len(SHOWN),
    ]
    summaries, details = [], []
    for name in PROBLEMS:
        summary, detail = rows(name)
        summaries += summary
        details += detail
    every, held_out = pairs.measure(), blocks.measure()
    summaries += across_recordings(every, held_out)
    details += pairs.section(every, SHOWN) + blocks.section(held_out, SHOWN)
    table = "\n".join([*header, *summaries])
    page = "\n".join(
        [
            "# Accuracy on real robots",
            "",
            f"{measured(PROBLEMS, script='accuracy.py')}.",
            "",
            "Each method is trained on the training recordings of the problem",
            "folders. Its error on the validation recordings is",
            "`||tau - prediction|| / ||tau||`, all joints.",
            "Settings are those of the problem files, chosen on training data. The",
            "row `expected from training` is the error on blocks of the training",
            "data that were left out, for the estimates that can be recommended.",
            "The recommended estimate is bold.",
            "",
            table,
            "",
            *details,
        ]
    )
    return table, page.rstrip() + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, help="file to write the page to")
    parser.add_argument("--readme", type=Path, help="file with a place for the table")
    options = parser.parse_args()
    table, page = measure()
    print(page)
    if options.write:
        options.write.write_text(page)
    if options.readme:
        text = options.readme.read_text()
        before, rest = text.split(BEGIN)
        _, after = rest.split(END)
        options.readme.write_text(f"{before}{BEGIN}\n{short(table)}\n{END}{after}")


if __name__ == "__main__":
    main()
