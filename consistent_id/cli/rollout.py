"""``consistent-id rollout PROBLEM``: its options, and what it prints."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from consistent_id.cli.answers import Answer, shows_progress, tables_answer
from consistent_id.cli.options import ACCEPT, OUTPUT, TIME_LIMIT, Option, add_command
from consistent_id.cli.source import SOURCE, STATED, announce, each, opened, study_of

if TYPE_CHECKING:
    from consistent_id.rollout.problem_rollout import ProblemRollout

_MORE = """For logs of command, position and gains ([data.gains]).  MuJoCo replays the
commands of the validation logs through an estimate, and through other files of the
robot.  By default settings are chosen and the estimate is refined (--choose --refine);
--stated replays the one that identify recommends, with the same verdict.  With --output
FOLDER the estimate, rollout.json and a page are written.  MuJoCo is the extra mjcf."""
_EXAMPLES = """
consistent-id rollout problems/unitree_go2
consistent-id rollout problems/unitree_go2 --against shipped.xml --stated
consistent-id rollout problems/unitree_z1 --output results/z1
"""


def add_rollout(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_rollout,
        *SOURCE,
        Option(
            "--against FILE ...",
            "MJCF or URDF files of the robot, to be replayed beside it",
        ),
        Option(
            "--refine",
            "refine the weighted constrained estimate on rollouts of the training "
            "logs, unless that predicts worse, and replay that one",
        ),
        Option(
            "--choose",
            "choose delay, cut-off, shape of friction and equal motors on the training "
            "logs",
        ),
        Option(
            "--stated",
            "replay the estimate that identify recommends for the problem as it is "
            "stated",
        ),
        Option(
            "--form FORMAT",
            "fit friction with the terms that a format supports (mjcf, mjlab, "
            "isaaclab, urdf), and print how much the error rises",
        ),
        *OUTPUT,
        ACCEPT,
        TIME_LIMIT,
        *STATED,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_rollout(options: argparse.Namespace) -> int:
    """Replay; return the exit code."""
    return each(options, _rollout)


def _rollout(options: argparse.Namespace) -> Answer:
    if not options.log:
        announce(options)
    from consistent_id._support.files import require_writable
    from consistent_id.rollout.problem_rollout import rollout_of

    source = opened(options)
    if options.output is not None and not options.dry_run:
        require_writable(options.output, ["rollout.json", "rollout.html"])
    study = study_of(options, source)
    chosen = options.refine or options.choose or options.form or options.stated
    done = rollout_of(
        study,
        against=options.against,
        refine=options.refine or not chosen,
        choose=options.choose or not chosen,
        form=options.form,
        progress=shows_progress(options),
    )

    def write() -> list[Path]:
        return [] if options.output is None else _written(done, options.output)

    usable = done.estimate.verdict.usable
    tables = source.noted([*done.tables(), *source.tables()])
    answer = tables_answer(tables, done.to_dict(), usable=usable, write=write)
    return answer._replace(text=answer.text + _next(done, options))


def _next(done: "ProblemRollout", options: argparse.Namespace) -> str:
    """Return the command that exports the replayed estimate with its written problem.

    Without chosen settings no problem is written, and what the options state of it is
    in no file.
    """
    folder, kept = options.output, done.settings is not None and done.form is None
    if folder is None or options.dry_run or not (kept and done.estimate.verdict.usable):
        return ""
    import shlex

    words = ["consistent-id", "export", str(folder / "problem.toml")]
    words += ["--estimate", str(_estimate_file(done, folder))]
    words += ["--format", "mjcf", "--output", str(folder / "robot.xml")]
    return f"\n\nnext: {shlex.join(words)}"


def _estimate_file(done: "ProblemRollout", folder: Path) -> Path:
    return folder / f"{done.estimate.method.replace(' ', '_')}.json"


def _written(done: "ProblemRollout", folder: Path) -> list[Path]:
    from consistent_id._support.files import write_atomically, write_json
    from consistent_id.problems.kept_text import toml_text, write_problem
    from consistent_id.problems.paths import moved
    from consistent_id.rollout.rollout_page import rollout_html

    name = done.problem.name
    head = "# consistent-id: the problem, with the settings of a rollout.\n\n"
    paths = [
        done.estimate.save(_estimate_file(done, folder)),
        write_json(folder / "rollout.json", done.to_dict()),
        write_atomically(folder / "rollout.html", rollout_html(done.rollout, name)),
    ]
    if done.settings is not None:
        text = head + toml_text(
            moved(done.problem.table, done.problem.folder, folder), {}
        )
        paths.append(write_problem(text, folder / "problem.toml"))
    return paths
