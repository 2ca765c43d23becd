"""A reproduced study in sections, as an HTML page, as Markdown, and as JSON.

A section has text, tables and figures; sections stand in the order of reading.
"""

import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from consistent_id._support.files import (
    require_writable,
    together,
    write_atomically,
    write_json,
)
from consistent_id._support.tables import Table
from consistent_id.laboratory.reproduction import paper_figures as figures
from consistent_id.laboratory.reproduction.error_analysis import Verification
from consistent_id.laboratory.reproduction.experiments import InertiaTable, Reproduction
from consistent_id.laboratory.reproduction.paper_study import PaperStudy
from consistent_id.laboratory.reproduction.paper_tables import (
    cause_table,
    constraints_table,
    deviations_table,
    drawn_table,
    excitation_table,
    experiments_table,
    inertia_table,
    printed_deviation,
    shrinking_table,
    shrunk_table,
    spread_table,
    tempo_table,
    verification_table,
)
from consistent_id.problems.published import published_table
from consistent_id.report.markup import Html, joined, paragraphs, table_html, tag
from consistent_id.report.page import document
from consistent_id.report.report_content import Section

Drawing = Callable[[PaperStudy], Any]

_INK = "#123456"  # stands for the page's own text colour until the SVG is written

_FORMAT = "consistent_id reproduction 1"


@dataclass(frozen=True, slots=True)
class PaperSection:
    """A part of a study.

    Parameters
    ----------
    name : str
        For links.
    text : tuple of str
        Paragraphs.
    figures : tuple of (str, str, callable)
        Name, caption, and what draws it from the study.
    """

    name: str
    title: str
    text: tuple[str, ...]
    tables: tuple[Table, ...] = ()
    figures: tuple[tuple[str, str, Drawing], ...] = ()


def sections_of(study: PaperStudy) -> tuple[PaperSection, ...]:
    """Return all sections of a study."""
    return (
        _printed(study),
        _experiments(study),
        _inertia(study),
        _causes(study),
        _assumptions(study),
        _exciting(study),
        _verification(study),
    )


def _printed(study: PaperStudy) -> PaperSection:
    table = published_table(study.problem)
    most = study.tasks.names[study.place.most_scattered]
    deviation = printed_deviation(study)[study.place.most_scattered]
    mean = study.report.mean[study.place.most_scattered]
    return PaperSection(
        "printed",
        "What the paper printed",
        (
            f"Of its parameters {most} scatters most: {mean:.4f} with a standard "
            f"deviation of {deviation:.4f} over {len(table.experiments)} experiments.",
            *table.notes,
        ),
        (spread_table(study),),
    )


def _experiments(study: PaperStudy) -> PaperSection:
    done = study.tasks
    laboratory = study.problem.table.laboratory
    seed = "" if laboratory is None else f" Seed {laboratory.seed}."
    return PaperSection(
        "experiments",
        "The experiments done again",
        (
            "A physically consistent robot, the nearest to the printed mean, follows "
            "the tasks of the problem file in a simulated laboratory, with friction. "
            "Each experiment is identified from its logs alone." + seed,
        ),
        (
            excitation_table(study),
            *(experiments_table(table) for table in done.tables),
            deviations_table(done),
        ),
        (
            (
                "vectors",
                "The parameter that scatters most, experiment by experiment.",
                figures.vectors_figure,
            ),
        ),
    )


def _inertia(study: PaperStudy) -> PaperSection:
    return PaperSection(
        "inertia",
        "Inertias with their uncertainty",
        ("What the paper's table of inertias lacks: the uncertainty of each entry.",),
        tuple(inertia_table(study, table) for table in study.inertia),
    )


def _causes(study: PaperStudy) -> PaperSection:
    budget, place = study.error_analysis.budget, study.place.most_scattered
    most, planned = study.tasks.names[place], study.error_analysis.planned
    found = study.tasks.scatter(study.tasks.tables[0])[place]
    causes = ", ".join(f"{c} {budget.scatter(c)[place]:.4f}" for c in budget.causes)
    return PaperSection(
        "causes",
        "Where the scatter comes from",
        (
            "Least squares is linear in torque: torque that the model lacks moves the "
            "estimate by the pseudo-inverse times that torque.",
            f"{most}: found {found:.4f}, all causes together "
            f"{budget.scatter()[place]:.4f}, predicted from the planned motions before "
            f"anything is performed {planned.scatter()[place]:.4f}; by cause: "
            f"{causes}; noise alone predicts {budget.noise_scatter[place]:.4f}.",
        ),
        (cause_table(study),),
        (
            (
                "scatter",
                "Scatter of each parameter: printed, found, and by noise alone.",
                figures.scatter_figure,
            ),
            (
                "budget",
                "The error in each experiment, by cause and joint.",
                figures.budget_figure,
            ),
        ),
    )


def _assumptions(study: PaperStudy) -> PaperSection:
    seeds = study.other_noise[:, 0, study.place.most_scattered]
    again = ", ".join(f"{value:.4f}" for value in seeds) or "none were drawn"
    return PaperSection(
        "assumptions",
        "What is assumed, and what of it matters",
        (
            "Assumed: friction, offsets, the controller's errors, the cameras' delay "
            "and noise, and where, how large and how fast the tasks are. Below they "
            "are drawn at random, and the error analysis is repeated for each draw.",
            f"The experiments again with other noise: {again}.",
        ),
        (drawn_table(study), tempo_table(study)),
        (
            (
                "tempo",
                "The scatter over guesses, and over the tempo of the tasks.",
                figures.assumptions_figure,
            ),
        ),
    )


def _exciting(study: PaperStudy) -> PaperSection:
    tables = [
        shrinking_table(
            study, 0, study.with_friction, "Exciting motions, friction not in the model"
        ),
        shrinking_table(
            study, 2, study.with_friction, "Exciting motions, friction in the model"
        ),
        shrinking_table(
            study, 0, study.without_friction, "Exciting motions, a robot without it"
        ),
        shrunk_table(study),
        constraints_table(study),
    ]
    return PaperSection(
        "exciting",
        "What exciting motions and constraints do",
        (
            "There are as many motions as experiments. Each is as long as the one that "
            "it replaces; designs have different seeds. Laboratory and noise are the "
            "same. One motion repeated has the same error each time: its scatter "
            "is small, but does not show this error.",
        ),
        tuple(tables),
        (
            (
                "exciting",
                "Scatter by what was moved along.",
                figures.exciting_figure,
            ),
        ),
    )


def _verification(study: PaperStudy) -> PaperSection:
    return PaperSection(
        "verification",
        "Verification",
        ("Performed and predicted motions; nothing was identified from them.",),
        (
            verification_table(
                study, study.verification, "Mean squared errors, a robot with friction"
            ),
            verification_table(
                study,
                study.verification_without_friction,
                "Mean squared errors, a robot without",
            ),
        ),
        (
            ("motion", "The verification motions.", figures.motions_figure),
            (
                "torque",
                "Measured and predicted torque along the first of them, and the "
                "residual.",
                figures.prediction_figure,
            ),
        ),
    )


def html_page(study: PaperStudy) -> str:
    """Return the study as one HTML page: no scripts, nothing fetched.

    Everything from the problem file is escaped.
    """
    title = f"{study.problem.name}: a paper's study done again"
    header = joined((tag("h1", title), tag("p", study.problem.table.source)))
    sections = [_report_section(section, study) for section in sections_of(study)]
    return document(title, header, sections)


def markdown_tables(study: PaperStudy) -> str:
    """Return text and tables as Markdown, without figures."""
    lines = ["<!-- consistent-id: tables of a study -->", ""]
    lines += [f"# {study.problem.name}: a paper's study done again", ""]
    for section in sections_of(study):
        lines += [f"## {section.title}", ""]
        lines += [f"{paragraph}\n" for paragraph in section.text]
        lines += [table.markdown() for table in section.tables]
    return "\n".join(lines)


def svg(figure: Any) -> str:
    """Return a figure as an SVG element whose ink is the text colour around it."""
    import matplotlib as mpl

    buffer = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "consistent_id"}):
        _dressed(figure)
        figure.savefig(buffer, format="svg", transparent=True)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    return text.replace(_INK, "currentColor")


def _dressed(figure: Any) -> None:
    """Give all text, ticks and edges the colour that stands for the page's own."""
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        text.set_color(_INK)
    for axis in figure.axes:
        axis.tick_params(colors=_INK, which="both")
        axis.set_axisbelow(True)
        axis.grid(alpha=0.25, color="#808080")
        for spine in axis.spines.values():
            spine.set_edgecolor(_INK)


def _report_section(section: PaperSection, study: PaperStudy) -> Section:
    figures = (
        tag(
            "figure", Html(svg(draw(study))), tag("figcaption", caption), class_="drawn"
        )
        for _, caption, draw in section.figures
    )
    tables = map(table_html, section.tables)
    body = joined((paragraphs(*section.text), *figures, *tables))
    return Section(section.name, section.title, body)


def reproduction_record(study: PaperStudy) -> dict[str, Any]:
    """Return the results as plain numbers and text."""
    names = study.tasks.names
    return {
        "format": _FORMAT,
        "problem": study.problem.name,
        "source": study.problem.table.source,
        "certified": study.certified,
        "parameters": list(names),
        "scatters_most": names[study.place.most_scattered],
        "scatters_least": names[study.place.least_scattered],
        "printed": {
            "mean": study.report.mean.tolist(),
            "standard_deviation": study.report.standard_deviation.tolist(),
            "spread_n2m2": study.spread.vectors.tolist(),
            "spread_of_loudest_n2m2": study.spread.most_scattered.tolist(),
            "mean_squared_errors_n2m2": study.spread.printed.tolist(),
        },
        "truth": study.tasks.truth.tolist(),
        "with_friction": {
            n: _experiments_record(d) for n, d in study.with_friction.items()
        },
        "without_friction": {
            n: _experiments_record(d) for n, d in study.without_friction.items()
        },
        "causes": _causes_record(study),
        "assumptions": _assumptions_record(study),
        "designs": {
            one.name: {
                name: design.trajectory.to_dict()
                for name, design in one.designs.items()
            }
            for one in study.sets
        },
        "inertia": [_inertia_record(table) for table in study.inertia],
        "verification": {
            "with_friction": _verification_record(study.verification),
            "without_friction": _verification_record(
                study.verification_without_friction
            ),
        },
    }


def write_reproduction(study: PaperStudy, folder: Path) -> list[Path]:
    """Write page, tables and numbers into a folder; return the files."""
    require_writable(folder)
    with together():
        return [
            write_atomically(folder / "reproduction.html", html_page(study)),
            write_atomically(folder / "reproduction.md", markdown_tables(study)),
            write_json(folder / "reproduction.json", reproduction_record(study)),
        ]


def _experiments_record(done: Reproduction) -> dict[str, Any]:
    return {
        "experiments": [
            {
                "name": experiment.name,
                "duration_s": float(
                    experiment.log.wanted.time[-1] - experiment.log.wanted.time[0]
                ),
                "rank": experiment.excitation.rank,
                "condition_number": experiment.excitation.condition,
                "left_open": list(experiment.excitation.undetermined),
                "weakest": experiment.excitation.weakest,
            }
            for experiment in done.experiments
        ],
        "methods": {
            table.method: {
                "vectors": table.vectors.tolist(),
                "mean": table.mean.tolist(),
                "standard_deviation": table.standard_deviation.tolist(),
                "scatter": done.scatter(table).tolist(),
                "rms_error": ((done.errors(table) ** 2).mean(axis=0) ** 0.5).tolist(),
            }
            for table in done.tables
        },
    }


def _causes_record(study: PaperStudy) -> dict[str, Any]:
    budget = study.error_analysis.budget
    return {
        "joints": list(budget.joints),
        "scatter": {cause: budget.scatter(cause).tolist() for cause in budget.causes},
        "scatter_of_all": budget.scatter().tolist(),
        "foretold": study.error_analysis.planned.scatter().tolist(),
        "noise": budget.noise_scatter.tolist(),
        "parts": budget.parts.tolist(),
    }


def _assumptions_record(study: PaperStudy) -> dict[str, Any]:
    varied, tempo = study.error_analysis.varied, study.error_analysis.tempo
    place = study.place.most_scattered
    needed = tempo.needed(place, float(study.report.standard_deviation[place]))
    return {
        "other_noise": study.other_noise.tolist(),
        "friction_drawn": varied.friction.tolist(),
        "tasks_drawn": varied.tasks.tolist(),
        "both_drawn": varied.both.tolist(),
        "noise_tasks_drawn": varied.noise.tolist(),
        "refused": varied.refused,
        "times_smaller": {
            name: t.tolist() for name, t in study.error_analysis.shrunk.items()
        },
        "slowness": tempo.slowness.tolist(),
        "friction_allowed": tempo.allowed.tolist(),
        "scatter_by_slowness": tempo.scatter.tolist(),
        "noise_by_slowness": tempo.noise.tolist(),
        "slowness_needed": needed if needed < float("inf") else None,
    }


def _inertia_record(table: InertiaTable) -> dict[str, Any]:
    return {
        "method": table.method,
        "links": list(table.links),
        "true": table.true.tolist(),
        "mean": table.mean.tolist(),
        "standard_deviation": table.standard_deviation.tolist(),
        "told": table.identifiable.tolist(),
        "bodies": list(table.bodies),
    }


def _verification_record(found: Verification) -> dict[str, Any]:
    return {
        "unit": "(N m)^2",
        "joints": list(found.joints),
        "motions": [recording.name for recording in found.recordings],
        "rows": [
            {"moved_along": one.source, "method": one.method, "mean_squared": errors}
            for one, errors in zip(
                found.predictors, found.mean_squared_errors.tolist(), strict=True
            )
        ],
    }
