"""``consistent-id export PROBLEM``: its options, and what it prints."""

import argparse
import sys
import textwrap
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from consistent_id.cli.answers import Answer
from consistent_id.cli.options import ACCEPT, WRITES, Option, add_command
from consistent_id.cli.source import SOURCE, STATED, each, opened, stored, study_of
from consistent_id.estimation.verdict import percent
from consistent_id.export.export_formats import EXPORT_FORMATS

if TYPE_CHECKING:
    from consistent_id.estimation.estimate import Estimate
    from consistent_id.estimation.verdict import Verdict
    from consistent_id.problems.problem import Problem
    from consistent_id.problems.study import Study
    from consistent_id.recordings.recording import Recording
    from consistent_id.recordings.signals import PDGains
    from consistent_id.report.results import Results

_FORMATS = ", ".join(known.content for known in EXPORT_FORMATS)
_MORE = textwrap.fill(
    f"The formats are {_FORMATS}. In the problem's own URDF only numbers change. What "
    "a format cannot express is printed. Exit code 1: do not use the estimate; nothing "
    "was written.",
    80,
)
_NOTHING = "nothing was written"
_EXAMPLES = """
consistent-id export problems/ur10e --format urdf --output ur10e.urdf
consistent-id export problems/rx60 --format c --output rx60.c
consistent-id export problems/rx60 --format json --output rx60.json --dry-run
"""


def add_export(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_export,
        *SOURCE,
        Option(
            "--format",
            "format of the file",
            choices=[known.name for known in EXPORT_FORMATS],
            required=True,
        ),
        Option(
            "--output FILE",
            "file to write; FILE-NAME for each of several problems",
            required=True,
        ),
        Option(
            "--estimate FILE",
            "an estimate that identify --output wrote (default: the one that identify "
            "delivers, estimated now)",
        ),
        Option(
            "--source FILE",
            "URDF or MJCF file that gets the estimate (default: the problem's)",
        ),
        ACCEPT,
        Option(
            "--copy-files",
            "copy the meshes and textures of an MJCF file beside the output",
        ),
        *WRITES,
        *STATED,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_export(options: argparse.Namespace) -> int:
    """Export an estimate; return the exit code."""
    return each(options, _export, file=True)


@dataclass(frozen=True)
class _Chosen:
    """An estimate to export, the verdict on it, and the notes beside it.

    Parameters
    ----------
    answer : dict
        The verdict for JSON; see `Study.answer`.
    stated : tuple of str
        Statements of the estimate's file that were not confirmed.
    source : Path, optional
        The robot's own file.
    gains : PDGains, optional
    delay : float, [s]
        The delay of commands.
    results : Results, optional
        Results that keep a copy of the robot's file as long as it is needed.
    """

    estimate: "Estimate"
    verdict: "Verdict"
    answer: dict[str, Any]
    stated: tuple[str, ...]
    source: Path | None
    gains: "PDGains | None"
    delay: float
    results: "Results | None" = None
    problem: "Problem | None" = None
    study: "Study | None" = None


def _export(options: argparse.Namespace) -> Answer:
    from consistent_id._support.files import require_writable_file
    from consistent_id.export.export_formats import exported
    from consistent_id.problems.problem_estimates import unmeasured_notes

    if not options.dry_run:
        require_writable_file(options.output)
    chosen = _chosen(options)
    verdict = chosen.verdict
    record = {
        **{"format": options.format, **chosen.answer, "notes": [], "written": None},
        **{"torque_error": None, "readme": None, "files": []},
    }
    if not verdict.usable:
        return _refused(verdict, record)
    figures = chosen.estimate.certificate.figures
    delay = figures.get("delay of commands", chosen.delay)
    source = options.source or chosen.source
    export = exported(
        replace(chosen.estimate, judged=verdict),
        options.format,
        source=source,
        folder=options.output.parent,
        copy_files=options.copy_files,
        gains=chosen.gains,
        delay=delay,
        **_logs_of_drives(chosen, options.format, delay),
    )
    written = None if options.dry_run else export.save(options.output)
    more = chosen.estimate.notes
    cost, errors = _torque_error(chosen, options.format, source)
    errors = [*unmeasured_notes(chosen.estimate.model), *errors]
    more = tuple(note for note in more if note not in errors)
    if written is not None:
        page = _Page(options.format, written, delay, None)
        if options.format == "mjcf" and export.side is not None:
            page = page._replace(drives=written.with_suffix(export.side.suffix))
        errors += _read_back(chosen, page)
        record["readme"] = _readme(chosen, page, (*errors, *export.notes))
        record["files"] = [*map(str, export.paths(written)), record["readme"]]
    beside = [*errors, *chosen.stated, *export.notes, *more]
    record |= {"format": export.format, "notes": beside}
    record |= {"written": written and str(written), "torque_error": cost}
    if more and not options.verbose:
        more = (f"{len(more)} notes on how it was estimated: --verbose prints them",)
    said = (*errors, *verdict.lines, *chosen.stated, *export.notes, *more)
    lines = (verdict.sentence, *(f"  {note}" for note in said))
    last = _NOTHING
    if written is not None:
        copies = {str(written.parent / name) for _, name in export.files}
        last = _written(record["files"], copies)
    return Answer(0, "\n".join([*lines, last]), record)


def _written(files: Sequence[str], copies: Collection[str]) -> str:
    """Return the line on files that were written, meshes and textures as a number."""
    said = f"written: {', '.join(file for file in files if file not in copies)}"
    if copies:
        said += f"; copied beside it: {len(copies)} of meshes and textures"
    return said


class _Page(NamedTuple):
    """A file that was written, the delay of commands [s], and a file that has it."""

    form: str
    written: Path
    delay: float
    drives: Path | None


def _logs_of_drives(chosen: _Chosen, form: str, delay: float) -> dict[str, Any]:
    """Return the commands that drives take beside that of position, and the logs.

    They are needed only where drives are written.  Positions are those of the logs
    themselves, torques those of prepared ones, as in fits.
    """
    if form != "mjcf" or delay == 0.0 or chosen.gains is None:
        return {}
    from consistent_id.errors import ConsistentIdError
    from consistent_id.problems.study import Study

    problem, logs = _logged(chosen)
    commands = tuple(
        name
        for name in ("velocity", "torque")
        if any(getattr(log, f"{name}_command") is not None for log in logs)
    )
    if problem is None:
        return {"commands": commands}
    try:
        study = chosen.study or Study(problem)
        all_of_them = [*problem.logs("training"), *study.training, *study.validation]
    except ConsistentIdError:  # as where errors are measured, which says why
        return {"commands": commands, "logs": logs}
    return {"commands": commands, "logs": [*logs, *all_of_them]}


def _logged(chosen: _Chosen) -> "tuple[Problem | None, Sequence[Recording]]":
    """Return the problem and the logs on which errors are measured.

    None if the logs of results are gone.
    """
    from consistent_id.errors import ConsistentIdError

    if chosen.results is None:
        return chosen.problem, [] if chosen.problem is None else _logs(chosen.problem)
    try:
        problem = chosen.results.problem
        return problem, _logs(problem)
    except ConsistentIdError:
        return None, ()


def _logs(problem: "Problem") -> "Sequence[Recording]":
    return problem.logs("validation") or problem.logs("training")


def _readme(chosen: _Chosen, page: _Page, said: Sequence[str]) -> str:
    """Write what users of a written file have to know; return the name of that file."""
    from consistent_id._support.files import write_atomically
    from consistent_id.export.actuator_config import readme

    form, written, delay, drives = page
    text = readme(
        chosen.estimate,
        form,
        written.name,
        tuple(said),
        delay=delay,
        drives=None if drives is None else drives.name,
    )
    beside_it = written.with_name(f"{written.name}{text.suffix}")
    return str(write_atomically(beside_it, text.content))


def _refused(verdict: "Verdict", record: dict[str, Any]) -> Answer:
    """Say why nothing is written, and how it would be."""
    kinds = " ".join(f"--accept {r.kind!r}" for r in verdict.grounds)
    lines = (verdict.sentence, *verdict.lines, f"{kinds} writes it anyway")
    print("\n".join(lines), file=sys.stderr)
    return Answer(1, _NOTHING, record)


def _torque_error(
    chosen: _Chosen, form: str, source: Path | None
) -> tuple[dict[str, Any] | None, list[str]]:
    """Return the torque error of a file, for JSON and as a sentence; a reason if none.

    An estimate that was fitted again to all recordings has none left that could judge
    it, so the one that was fitted to the training data goes through the same format.
    """
    from dataclasses import asdict

    from consistent_id.errors import ConsistentIdError
    from consistent_id.export.format_cost import format_cost
    from consistent_id.problems.study import Study
    from consistent_id.robot.chains import Selection

    try:
        problem, estimate = chosen.problem, chosen.estimate
        if problem is None and chosen.results is not None:
            problem, estimate = chosen.results.problem, chosen.results.recommended
        if problem is None:
            return None, []
        study = chosen.study or Study(problem)
        if chosen.study is not None and estimate is study.delivered:
            estimate = study.recommended.with_verdict
        unseen = study.unseen(estimate)
        model = problem.table.model
        cost = format_cost(
            estimate,
            form,
            unseen or study.validation or study.training,
            selection=Selection(model.base, model.tip, model.joints, model.locked),
            source=source,
            held_out=bool(unseen),
        )
    except (ConsistentIdError, OSError) as cause:
        return None, [f"the torque error of the file is not known: {cause}"]
    return asdict(cost), [str(cost)]


def _read_back(chosen: _Chosen, page: _Page) -> list[str]:
    """Return sentences on the rollout error of a file that was written."""
    from importlib.util import find_spec

    gains = chosen.gains
    if gains is None or find_spec("mujoco") is None:
        return []
    problem, logs = _logged(chosen)
    if problem is None:
        return []
    from consistent_id.rollout.commanded_motion import error_lines
    from consistent_id.rollout.replay_model import RobotFile

    joints, locked = problem.model.robot.joint_names, problem.table.model.locked
    form, written, delay, drives = page
    robot = RobotFile(written, joints, locked)
    return error_lines(form, robot, logs, gains, delay=delay, drives=drives)


def _chosen(options: argparse.Namespace) -> _Chosen:
    """Return the estimate that the options name, or that the study delivers."""
    from consistent_id.estimation.estimate import Estimate

    results = stored(options) if options.estimate is None else None
    if results is not None:
        drives, form = results.index.drives, results.index.model
        own = form is not None and form.form == options.format
        return _Chosen(
            results.delivered,
            results.verdict,
            results.answer,
            (),
            results.model_file if own else None,
            None if drives is None else drives.gains,
            0.0 if drives is None else drives.delay,
            results,
        )
    source = opened(options)
    study, problem = study_of(options, source), source.problem
    stated = source.notes
    if options.estimate is None:
        estimate, verdict, answer = study.delivered, study.verdict, study.answer()
    else:
        estimate = Estimate.load(options.estimate, problem.model, study.base)
        verdict = study.verdict_on(estimate)
        answer = study.answer(verdict)
        stated = (*stated, *_as_stated(study, estimate, verdict))
    # The file of the arm does not contain the tool behind a wrench sensor.
    files = problem.model_files if problem.arm is None else {}
    return _Chosen(
        estimate,
        verdict,
        answer,
        stated,
        files.get(options.format),
        problem.gains,
        problem.delay_of_commands,
        problem=problem,
        study=study,
    )


def _as_stated(
    study: "Study", estimate: "Estimate", verdict: "Verdict"
) -> tuple[str, ...]:
    """Return notes on a held-out error that no recording can confirm."""
    stated = estimate.judged
    if not study.validation or stated is None:
        return ()
    if not estimate.fitted_to:
        return (
            "the file does not name the recordings that it was fitted to: if these are "
            "among the validation recordings, the held-out error is too small",
        )
    if study.unseen(estimate) or stated.held_out is None:
        return ()
    if verdict.held_out != stated.held_out:
        said = f"the file states a held-out error of {percent(stated.held_out)}"
        return (f"{said}, which is too small for the estimate in it",)
    return (
        "held-out error as the file states it: the estimate was fitted to the "
        "validation recordings after its verdict",
    )
