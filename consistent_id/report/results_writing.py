"""The results folder of a study: its record, files, tables, figures and their index."""

import hashlib
from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from time import time_ns
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from consistent_id._support.files import (
    content_of,
    relative_path,
    require_writable,
    write_atomically,
    write_json,
)
from consistent_id._support.run import kept_going
from consistent_id._support.tables import Table
from consistent_id.estimation.method import Method
from consistent_id.recordings.log_formats import files_of
from consistent_id.report.results import (
    DELIVERED,
    FORMAT,
    INDEX,
    PROBLEM,
    REPORT,
    DriveRecord,
    FileRecord,
    Index,
    ModelForm,
    ModelRecord,
    TableRecord,
    digest,
    file_of,
)

if TYPE_CHECKING:
    from consistent_id.comparison.comparison import EstimateReport
    from consistent_id.estimation.torque_error import TorqueError
    from consistent_id.problems.opening import Opened
    from consistent_id.problems.problem import Problem
    from consistent_id.problems.published import PublishedReport
    from consistent_id.problems.study import Study

_MARK = "<!-- consistent-id: tables of a comparison -->"
_SETTLED = 2_000_000_000  # ns: the coarsest step of time stamps, that of FAT
_FIXED = (PROBLEM, DELIVERED, "comparison.md", "comparison.json", REPORT, INDEX)


def require_place(folder: Path) -> None:
    """Refuse, before the work, a folder in which results could not be written.

    Raises
    ------
    ProblemError
        With the file that is in the way.
    """
    names = [*_FIXED, *(file_of(method) for method in Method)]
    pictures = folder.glob("torque_*.svg") if folder.is_dir() else ()
    require_writable(folder, [*names, *(path.name for path in pictures)])


def write_results(
    opened: "Opened",
    study: "Study",
    folder: Path,
    *,
    page: str,
    tables: Mapping[str, list[Table]],
) -> list[Path]:
    """Write a study: problem, estimates, tables, figures, report, index.

    Parameters
    ----------
    opened : Opened
        Where the problem comes from.
    study : Study
        The study.
    folder : Path
    page : str
        The report.
    tables : mapping of str to list of Table
        Tables that each command of `PRINTED` prints; see `tables_of`.
    """
    from consistent_id.problems.kept_text import write_problem

    file = folder / PROBLEM
    if study.problem.source is None or study.problem.source.resolve() != file.resolve():
        write_problem(opened.text(folder, study.accepted), file)
    paths = [
        file,
        *_estimates(study, folder),
        *_comparison(study, tables["compare"], folder),
        write_atomically(folder / REPORT, page),
    ]
    index = _index(study, folder, tables, paths)
    return [*paths, write_json(folder / INDEX, msgspec.to_builtins(index))]


def _index(
    study: "Study",
    folder: Path,
    tables: Mapping[str, list[Table]],
    written: Sequence[Path],
) -> Index:
    """Return the content of ``results.json``."""
    from consistent_id import __version__
    from consistent_id.diagnosis.findings import diagnosis_record

    problem, found = study.problem, study.diagnosis
    every = (part for file in problem.files.values() for part in files_of(file))
    inputs = {file for file in every if file.is_file()}
    return Index(
        format=FORMAT,
        version=__version__,
        problem=problem.name,
        seed=study.seed,
        accepted=list(study.accepted),
        answer=study.answer(),
        findings={} if found is None else diagnosis_record(found),
        tables={
            name: [TableRecord(t.title, t.header, t.rows, t.notes) for t in printed]
            for name, printed in tables.items()
        },
        inputs={relative_path(file, folder): _input(file) for file in sorted(inputs)},
        files={path.name: _written(path) for path in written},
        model=_model(problem),
        drives=_drives(problem),
    )


def _input(path: Path) -> FileRecord:
    status = path.stat()
    stamps = (status.st_mtime_ns, status.st_ctime_ns)
    if time_ns() - max(stamps) < _SETTLED:
        stamps = (0, 0)
    return FileRecord(digest(path), status.st_size, *stamps)


def _written(path: Path) -> FileRecord:
    content = content_of(path)
    return FileRecord(hashlib.sha256(content).hexdigest(), len(content))


def _drives(problem: "Problem") -> DriveRecord | None:
    if problem.gains is None:
        return None
    gains = problem.gains.of(len(problem.model.robot.joint_names))
    limit, stiffness = (
        [v if isfinite(v) else None for v in values.tolist()]
        for values in (gains.torque_limit, gains.stiffness)
    )
    return DriveRecord(
        gains.kp.tolist(),
        gains.kd.tolist(),
        limit,
        stiffness,
        problem.delay_of_commands,
    )


def _model(problem: "Problem") -> ModelRecord | None:
    """Return the robot's file; None of a robot in a table."""
    forms: tuple[ModelForm, ...] = ("urdf", "mjcf")
    for form in forms:
        if (file := problem.model_files[form]) is not None:
            return ModelRecord(form, file.name, file.read_bytes().decode("latin-1"))
    return None


def _estimates(study: "Study", folder: Path) -> list[Path]:
    """Write the delivered estimate, and each one after its method."""
    paths = [study.delivered.save(folder / DELIVERED)]
    for report in study.comparison.reports:
        name = file_of(report.estimate.method)
        paths.append(report.with_verdict.save(folder / name))
    return paths


def _comparison(study: "Study", tables: Sequence[Table], folder: Path) -> list[Path]:
    """Write the tables, all figures, and pictures of torque."""
    head = [_MARK, "", f"# {study.problem.name}", ""]
    text = "\n".join([*head, *(table.markdown() for table in tables)])
    return [
        write_atomically(folder / "comparison.md", text),
        write_json(folder / "comparison.json", study_record(study)),
        *_pictures(study, folder),
    ]


def _pictures(study: "Study", folder: Path) -> list[Path]:
    """Draw the torque of least squares and of the recommended estimate."""
    from consistent_id.report.plot import motion_figure, torque_figure, write_figure

    methods = (Method.LEAST_SQUARES, study.recommendation.method)
    shown = [e for e in study.estimates if e.method in methods]
    paths = []
    if study.published is not None:
        with kept_going("figure motion.svg"):
            motion = motion_figure(study.problem.model.robot, study.published.motion)
            paths.append(write_figure(motion, folder / "motion.svg"))
    for role in ("training", "validation"):
        for i, recording in enumerate(getattr(study, role), start=1):
            name = f"torque_{role}_{i}.svg"
            with kept_going(f"figure {name}"):
                figure = torque_figure(shown, recording)
                paths.append(write_figure(figure, folder / name))
    return paths


def tables_of(name: str, opened: "Opened", study: "Study") -> list[Table]:
    """Return the text that a command prints about a study."""
    from consistent_id.diagnosis.findings import diagnosis_table
    from consistent_id.problems.loading import problem_tables
    from consistent_id.report.parameters_section import uncertainty_table
    from consistent_id.report.summary import identified_tables, study_tables

    if name == "uncertainty":
        return [uncertainty_table(study.uncertainty)]
    if name == "info":
        return opened.noted([*problem_tables(study.problem), *opened.tables()])
    if name == "check":
        found = study.diagnosis
        own = [] if found is None else [diagnosis_table(found), *opened.tables()]
        return opened.noted(own) if own else []
    if name == "identify":
        return opened.noted(identified_tables(opened, study))
    return opened.noted(study_tables(study))


def study_record(study: "Study") -> dict[str, Any]:
    """Return a study as plain numbers and text, ready for JSON."""
    return {
        "format": "consistent_id study 1",
        "problem": study.problem.name,
        "source": study.problem.table.source,
        **study.answer(),
        "recommendation": _recommendation_record(study),
        "excitation": _excitation_record(study),
        "constraint_costs": [
            {
                "constraint": cost.name,
                "misfit_increase": cost.increase,
                "rms_with": cost.rms_with.tolist(),
                "rms_without": cost.rms_without.tolist(),
                "verdict": cost.verdict,
            }
            for cost in study.costs
        ],
        "regularisation_path": _path_record(study),
        "slacks": {method: c.to_dict() for method, c in study.slacks.items()},
        "shadow_prices": [
            {
                "constraint": price.label,
                "price": price.price,
                "cost": _number(price.cost),
                "verdict": price.verdict,
            }
            for price in study.prices
        ],
        "estimates": [_report_record(r) for r in study.comparison.reports],
        "delivered": study.delivered.to_dict(),
        "published": (
            None if study.published is None else _published_record(study.published)
        ),
    }


def _recommendation_record(study: "Study") -> dict[str, Any]:
    chosen = study.recommendation
    expected = chosen.expected
    held_out = zip(study.recommended.validation, study.expected_held_out, strict=True)
    return {
        "method": chosen.method,
        "expected_error": None if expected is None else expected.error,
        "expected_range": None if expected is None else [expected.low, expected.high],
        "expected_on": [
            {"recording": error.recording, **forecast.to_dict()}
            for error, forecast in held_out
            if forecast is not None
        ],
        "left_out_errors": {
            method: _number(error)
            for method, error in zip(chosen.candidates, chosen.error, strict=True)
        },
    }


def _excitation_record(study: "Study") -> dict[str, Any]:
    return {
        "structural_rank": study.excitation.structural_rank,
        "data_rank": study.excitation.data_rank,
        "condition_numbers": [
            {
                "value": _number(c.value),
                "basis": c.basis,
                "column_scaling": c.scaling,
            }
            for c in study.excitation.condition
        ],
        "undetermined": list(study.excitation.undetermined),
    }


def _path_record(study: "Study") -> dict[str, Any]:
    path = study.path
    return {
        "distance": path.distance,
        "weights": path.weights.tolist(),
        "errors": path.errors.tolist(),
        "misfits": path.misfits.tolist(),
        "distances": [_number(d) for d in path.distances],
        "chosen": float(path.weights[path.best]),
    }


def _report_record(report: "EstimateReport") -> dict[str, Any]:
    return report.with_verdict.to_dict() | {
        "training": [_error_record(e) for e in report.training],
        "validation": [_error_record(e) for e in report.validation],
        "consistent_links": list(report.consistent_links),
        "base_feasibility": {
            "answer": report.base_feasibility.answer,
            "summary": report.base_feasibility.summary,
            "depth": _number(report.base_feasibility.proof.margin),
            "bound": _number(report.base_feasibility.proof.bound),
            "nearest_torque_change": _to_nearest(report),
        },
        "links": [
            {
                "link": link.link,
                "least_eigenvalue": link.least_eigenvalue,
                "edge": link.edge,
            }
            for link in report.links
        ],
        "least_mass_eigenvalue": report.least_mass_eigenvalue,
        "distance_to_nominal": report.distance_to_nominal.tolist(),
    }


def _to_nearest(report: "EstimateReport") -> float | None:
    nearest = report.base_feasibility.nearest
    return None if nearest is None else nearest.torque_change


def _error_record(error: "TorqueError") -> dict[str, Any]:
    return {
        "recording": error.recording,
        "rms": error.rms.tolist(),
        "relative": [_number(share) for share in error.relative],
        "mse": error.mse.tolist(),
        "stacked": _number(error.stacked),
    }


def _published_record(report: "PublishedReport") -> dict[str, Any]:
    return {
        "parameters": list(report.parametrisation.names),
        "mean": report.mean.tolist(),
        "standard_deviation": report.standard_deviation.tolist(),
        "largest_differences": report.largest_differences,
        "central_inertia": {k: v.tolist() for k, v in report.central_inertia.items()},
        "ranks": [
            {
                "columns": list(rank.columns),
                "rank": rank.rank,
                "singular_values": rank.singular_values.tolist(),
                "null_directions": list(rank.null_directions),
            }
            for rank in (report.all_columns, report.free_columns)
        ],
        "vectors": [
            {
                "name": v.name,
                "answer": v.feasibility.answer,
                "summary": v.feasibility.summary,
                "depth": _number(v.feasibility.proof.margin),
                "bound": _number(v.feasibility.proof.bound),
                "nearest": v.nearest.to_dict(),
                "torque_change": v.torque_change.tolist(),
            }
            for v in report.vectors
        ],
    }


def _number(value: float) -> float | None:
    """Return a number that JSON can represent, or None."""
    return float(value) if np.isfinite(value) else None
