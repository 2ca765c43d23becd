"""A reproduced study in sections: text, tables and figures, in the order of reading."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from consistent_id._support.tables import Table
from consistent_id.laboratory.reproduction import paper_figures as figures
from consistent_id.laboratory.reproduction import section_tables as part
from consistent_id.laboratory.reproduction.experiment_tables import (
    deviations_table,
    experiments_table,
    inertia_table,
    verification_table,
)
from consistent_id.laboratory.reproduction.paper_study import PaperStudy
from consistent_id.problems.published import published_table

Drawing = Callable[[PaperStudy], Any]


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
    deviation = part.printed_deviation(study)[study.place.most_scattered]
    mean = study.report.mean[study.place.most_scattered]
    return PaperSection(
        "printed",
        "What the paper printed",
        (
            f"Of its parameters {most} scatters most: {mean:.4f} with a standard "
            f"deviation of {deviation:.4f} over {len(table.experiments)} experiments.",
            *table.notes,
        ),
        (part.spread_table(study),),
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
            part.excitation_table(study),
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
        (part.cause_table(study),),
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
        (part.drawn_table(study), part.tempo_table(study)),
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
        part.shrinking_table(
            study, 0, study.with_friction, "Exciting motions, friction not in the model"
        ),
        part.shrinking_table(
            study, 2, study.with_friction, "Exciting motions, friction in the model"
        ),
        part.shrinking_table(
            study, 0, study.without_friction, "Exciting motions, a robot without it"
        ),
        part.shrunk_table(study),
        part.constraints_table(study),
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
