"""The files that a study is written to."""

from collections.abc import Sequence
from pathlib import Path

from consistent_id._support.files import write_atomically, write_json
from consistent_id._support.tables import Table
from consistent_id.estimation.method import Method
from consistent_id.problems.study import Study
from consistent_id.report.figures import motion_figure, save_figure, torque_figures
from consistent_id.report.study_record import study_record

_MARK = "<!-- consistent-id: tables of a comparison -->"
_DRAWN = (Method.LEAST_SQUARES, Method.CONSTRAINED)


def write_comparison(study: Study, tables: Sequence[Table], folder: Path) -> list[Path]:
    """Write a study as ``comparison.md``, ``comparison.json`` and figures."""
    text = "\n".join(
        [
            _MARK,
            "",
            f"# {study.problem.name}",
            "",
            *(table.markdown() for table in tables),
        ]
    )
    return [
        write_atomically(folder / "comparison.md", text),
        write_json(folder / "comparison.json", study_record(study)),
        *_figures(study, folder),
    ]


def write_estimates(study: Study, folder: Path) -> list[Path]:
    """Write each estimate to a JSON file that is named after its method.

    The verdicts in the files are those of the comparison.  ``delivered.json`` is the
    recommended estimate, fitted again to all data.
    """
    paths = [study.delivered.save(folder / "delivered.json")]
    for report in study.comparison.reports:
        name = report.estimate.method.replace(" ", "_")
        paths.append(report.judged.save(folder / f"{name}.json"))
    return paths


def _figures(study: Study, folder: Path) -> list[Path]:
    drawn = [e for e in study.estimates if e.method in _DRAWN]
    paths = []
    if study.published is not None:
        motion = motion_figure(study.problem.model.robot, study.published.motion)
        paths.append(save_figure(motion, folder / "motion.png"))
    recordings = {
        f"torque_{role}_{i}.png": recording
        for role in ("training", "validation")
        for i, recording in enumerate(getattr(study, role), start=1)
    }
    figures = torque_figures(list(recordings.values()), drawn)
    for name, figure in zip(recordings, figures, strict=True):
        paths.append(save_figure(figure, folder / name))
    return paths
