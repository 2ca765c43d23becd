"""What the shell commands do, as functions that return values and write files."""

import json
from dataclasses import replace
from pathlib import Path

from consistent_id._support.files import require_writable, write_atomically
from consistent_id._support.tables import Table
from consistent_id.comparison.parameter_uncertainty import Uncertainty, uncertainty
from consistent_id.diagnosis import Diagnosis, diagnose
from consistent_id.diagnosis.diagnosis_table import diagnosis_table
from consistent_id.estimation.estimate import Estimate
from consistent_id.problems.folder import toml_files
from consistent_id.problems.problem import Problem
from consistent_id.problems.study import Study, excitation_of, identify, run_study
from consistent_id.problems.study import recordings_of as study_recordings
from consistent_id.recordings.readers import Columns, read_recording
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import differentiated, low_passed, resampled
from consistent_id.regression.base import base_parameters
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.regression import build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.segments import segment_regressions
from consistent_id.report.figures import motion_figure, save_figure, torque_figure
from consistent_id.report.study_record import study_record
from consistent_id.report.summary import (
    excitation_table,
    study_tables,
    uncertainty_table,
)
from consistent_id.robot.loaders import load_mjcf, load_urdf

_DRAWN = ("least squares", "constrained")


def info(problem: Problem) -> list[Table]:
    """Return what a problem consists of: robot, datasheet, base parameters."""
    robot, model = problem.model.robot, problem.model
    base = base_parameters(model)
    links = Table(
        f"Robot {robot.name}: {len(robot)} joints, gravity {robot.gravity} m/s^2",
        ("joint", "kind", "moves", "datasheet mass [kg]", "drive terms"),
        tuple(
            (
                joint.name,
                joint.kind,
                link.name,
                "-" if link.datasheet.mass is None else f"{link.datasheet.mass:g}",
                ", ".join(terms.names) or "none",
            )
            for joint, link, terms in zip(
                robot.joints, robot.links, model.terms, strict=True
            )
        ),
        tuple(
            f"coupled gears: {coupling.label}, {', '.join(coupling.names)}"
            for coupling in model.couplings
        ),
    )
    here = [file.name for file in toml_files(problem.folder)]
    if len(here) > 1:
        note = f"problem files of this folder: {', '.join(here)}"
        links = replace(links, notes=(*links.notes, note))
    groups = Table(
        f"Base parameters: {len(base)} of {len(model.layout)} (structural rank)",
        ("leading parameter", "grouping"),
        tuple(zip(base.names, base.groupings, strict=True)),
        (f"without effect on torque: {', '.join(base.without_effect) or 'none'}",),
    )
    return [links, groups]


def uncertainty_of(
    problem: Problem, *, seed: int = 0, progress: bool = False
) -> tuple[Uncertainty, Table]:
    """Say how sure the problem's constrained estimate is of each parameter."""
    training, _ = study_recordings(problem)
    found = uncertainty(
        problem.model,
        segment_regressions(problem.model, training),
        constraints=problem.constraints,
        prior=problem.prior,
        seed=seed,
        progress=progress,
    )
    return found, uncertainty_table(found)


def check_problem(problem: Problem) -> tuple[Diagnosis, Table]:
    """Look for what is wrong with a problem's recordings."""
    roles = [problem.logs(role) for role in ("training", "validation")]
    names = [log.name for logs in roles for log in logs]
    training, validation = ([_told_apart(log, names) for log in logs] for logs in roles)
    found = diagnose(
        problem.model,
        training,
        validation,
        prepare=problem.prepare,
        constraints=problem.constraints,
    )
    return found, diagnosis_table(found)


def _told_apart(log: Recording, names: list[str]) -> Recording:
    """Name a log by its times too if another part of its file is looked at."""
    if names.count(log.name) == 1:
        return log
    span = f"{log.time[0]:.4g} to {log.time[-1]:.4g} s"
    return replace(log, name=f"{log.name} ({span})")


def check_log(
    model: Path, log: Path, columns: Columns, *, cutoff: float = 10.0
) -> tuple[Diagnosis, Table]:
    """Look for what is wrong with a log of a robot that has no problem file.

    Parameters
    ----------
    model : Path
        URDF or MJCF.
    log : Path
    columns : Columns
        Its `torque_joints` are the model's, too.
    cutoff : float, [Hz]
        Of the filter before differentiation.
    """
    load = load_mjcf if model.suffix.lower() in (".xml", ".mjcf") else load_urdf
    drive = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True)
    torque_model = TorqueModel(
        load(model), drive, torque_joints=tuple(columns.torque_joints)
    )
    recording = read_recording(log, torque_model.robot.joint_names, columns)

    def prepare(raw: Recording) -> Recording:
        smooth = low_passed(
            resampled(raw, raw.rate), motion_cutoff=cutoff, torque_cutoff=cutoff
        )
        return differentiated(smooth)

    found = diagnose(torque_model, recording, prepare=prepare)
    return found, diagnosis_table(found)


def identify_problem(
    problem: Problem, output: Path | None = None
) -> tuple[tuple[Estimate, ...], list[Table]]:
    """Identify a problem's parameters; write one JSON file per estimate if asked."""
    training, _ = study_recordings(problem)
    base = base_parameters(problem.model)
    estimates = identify(problem, training, base=base)
    excitation = excitation_of(build_regression(problem.model, training), base)
    tables = [excitation_table(excitation, training)]
    tables += [estimate.table() for estimate in estimates]
    if output is not None:
        for estimate in estimates:
            estimate.save(output / f"{estimate.method.replace(' ', '_')}.json")
    return estimates, tables


def compare_problem(
    problem: Problem, output: Path | None = None, *, progress: bool = False
) -> tuple[Study, list[Table], list[Path]]:
    """Work a problem through and compare its estimates.

    Parameters
    ----------
    problem : Problem
    output : Path, optional
        Folder for ``comparison.md``, ``comparison.json`` and figures.
    progress : bool
        Show how far it is, on the standard error.

    Returns
    -------
    study : Study
    tables : list of Table
    written : list of Path
    """
    if output is not None:
        require_writable(output)
    study = run_study(problem, progress=progress)
    tables = study_tables(study)
    written = []
    if output is not None:
        text = "\n".join(
            [f"# {problem.name}", "", *(table.markdown() for table in tables)]
        )
        record = json.dumps(study_record(study), indent=1, allow_nan=False)
        written.append(write_atomically(output / "comparison.md", text))
        written.append(write_atomically(output / "comparison.json", record + "\n"))
        written += _figures(study, output)
    return study, tables, written


def _figures(study: Study, output: Path) -> list[Path]:
    drawn = [e for e in study.estimates if e.method in _DRAWN]
    paths = []
    if study.published is not None:
        motion = motion_figure(study.problem.model.robot, study.published.motion)
        paths.append(save_figure(motion, output / "motion.png"))
    for role, recordings in (
        ("training", study.training),
        ("validation", study.validation),
    ):
        for i, recording in enumerate(recordings, start=1):
            figure = torque_figure(recording, drawn)
            paths.append(save_figure(figure, output / f"torque_{role}_{i}.png"))
    return paths
