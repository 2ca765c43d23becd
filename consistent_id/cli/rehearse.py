"""``consistent-id rehearse PROBLEM | ROBOT``: its options, and what it prints."""

import argparse

from consistent_id.cli.answers import Answer, answered, shows_progress, tables_answer
from consistent_id.cli.motion_options import (
    MOTION,
    SEARCH,
    estimates,
    motion_changes,
    parameters,
)
from consistent_id.cli.options import Option, add_command, positive
from consistent_id.cli.source import PROBLEM_OR_ROBOT, ROBOT, announce, statement

_MORE = """The design that excite would make is played in MuJoCo by robots with known
parameters: dry friction, rotors, a controller with a wrong model, encoders, noise. Then
they are identified. The output says whether errors are as predicted, whether limits
were kept, and whether the identified model holds the robot against gravity. Needs
consistent-id[mjcf]. Exit code 1: one of these tests failed."""
_EXAMPLES = """
consistent-id rehearse problems/rx60
consistent-id rehearse robot.urdf --acceleration 5 --robots 5
consistent-id rehearse robot.urdf --rivals
consistent-id rehearse problems/arm --for open --parameters delivered.json
"""


def add_rehearse(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_rehearse,
        PROBLEM_OR_ROBOT,
        *ROBOT,
        MOTION,
        parameters("; simulated robots are near the first"),
        Option("--robots N", "number of simulated robots", int, default=3),
        Option("--seed N", "seed of these robots and of the search", int, default=0),
        *SEARCH,
        Option(
            "--currents SHARE",
            "robots log motor currents in 2048 steps to the largest, with torque "
            "constants known to this share, such as 0.05 (default: they log torque)",
            positive,
        ),
        Option(
            "--rivals",
            "also play the other objective's design, random paths and sinusoids",
        ),
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_rehearse(options: argparse.Namespace) -> int:
    """Rehearse; return the exit code."""
    return answered(options, _rehearse)


def _rehearse(options: argparse.Namespace) -> Answer:
    announce(options)
    from consistent_id.excitation.sources import (
        estimated_parameters,
        problem_to_excite,
        with_open_parameters,
    )
    from consistent_id.export.mjcf_bodies import require_mujoco
    from consistent_id.laboratory.rehearsal.dry_runs import dry_run

    require_mujoco()
    changes, stated = motion_changes(options), statement(options, "robot")
    problem = problem_to_excite(options.problem, changes, stated)
    known = estimates(options)
    problem = with_open_parameters(problem, known)
    found = dry_run(
        problem,
        parameters=estimated_parameters(problem, known),
        robots=options.robots,
        rivals=options.rivals,
        currents=options.currents,
        starts=options.starts,
        time_limit=options.time_limit,
        seed=options.seed,
        workers=options.workers,
        progress=shows_progress(options),
    )
    record = {"format": "consistent_id rehearsal 1", **found.to_dict()}
    return tables_answer(found.tables(), record, usable=found.came_true)
