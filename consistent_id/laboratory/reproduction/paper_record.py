"""A reproduced study as plain numbers for JSON, and as files."""

from pathlib import Path
from typing import Any

from consistent_id._support.files import (
    require_writable,
    together,
    write_atomically,
    write_json,
)
from consistent_id.laboratory.reproduction.experiments import Reproduction
from consistent_id.laboratory.reproduction.inertia_errors import InertiaTable
from consistent_id.laboratory.reproduction.paper_page import html_page, markdown_tables
from consistent_id.laboratory.reproduction.paper_study import PaperStudy
from consistent_id.laboratory.reproduction.paper_verification import Verification

_FORMAT = "consistent_id reproduction 1"


def reproduction_record(study: PaperStudy) -> dict[str, Any]:
    """Return what was found as plain numbers and text."""
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
        "with_friction": {n: _done(d) for n, d in study.with_friction.items()},
        "without_friction": {n: _done(d) for n, d in study.without_friction.items()},
        "causes": _causes(study),
        "assumptions": _assumptions(study),
        "designs": {
            one.name: {
                name: design.trajectory.to_dict()
                for name, design in one.designs.items()
            }
            for one in study.sets
        },
        "inertia": [_inertia(table) for table in study.inertia],
        "verification": {
            "with_friction": _verification(study.verification),
            "without_friction": _verification(study.verification_without_friction),
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


def _done(done: Reproduction) -> dict[str, Any]:
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


def _causes(study: PaperStudy) -> dict[str, Any]:
    budget = study.error_analysis.budget
    return {
        "joints": list(budget.joints),
        "scatter": {cause: budget.scatter(cause).tolist() for cause in budget.causes},
        "scatter_of_all": budget.scatter().tolist(),
        "foretold": study.error_analysis.planned.scatter().tolist(),
        "noise": budget.noise_scatter.tolist(),
        "parts": budget.parts.tolist(),
    }


def _assumptions(study: PaperStudy) -> dict[str, Any]:
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


def _inertia(table: InertiaTable) -> dict[str, Any]:
    return {
        "method": table.method,
        "links": list(table.links),
        "true": table.true.tolist(),
        "mean": table.mean.tolist(),
        "standard_deviation": table.standard_deviation.tolist(),
        "told": table.identifiable.tolist(),
        "bodies": list(table.bodies),
    }


def _verification(found: Verification) -> dict[str, Any]:
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
