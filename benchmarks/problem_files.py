"""The models in the problem files of real arms, chosen anew from the training data.

``python benchmarks/problem_files.py``, with recordings in ``CONSISTENT_ID_DATASETS``.

Each file gets what ``consistent-id select problems/NAME`` chooses.  What its author
states stays: robot, columns, rows, gains, constraints, and comments about them.

``ur10e/payload.toml`` is of the same robot with a load.  It gets the model that was
chosen without the load, and drive gains identified with the known load from another
trajectory, which was recorded with it and without.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

import consistent_id as ci
from consistent_id.problems.kept_text import changed_tables, rewritten, toml_text
from consistent_id.problems.selection.choice import data_of

FOLDER = Path("problems")
NAMES = ("ur10e", "kuka_kr300", "staubli_tx40", "tiago")
PAYLOAD = FOLDER / "ur10e" / "payload.toml"
LOADED = "payload/ur-20_02_19_15harm50secLoad.parquet"
UNLOADED = "identification/ur-20_02_19_15harm50sec.parquet"
MASS = 2.805  # kg, of the load, as it was weighed
_BROKEN = range(1, 7)  # rows of both logs, of which one is garbage
_MOVING = 0.05  # rad/s
_PARTS = ("drive", "joints", "couplings", "data.preparation")


def write_chosen(name: str) -> ci.problems.ModelSelection:
    """Choose the model of a problem file, and write it."""
    file = FOLDER / name / "problem.toml"
    selection = ci.problems.select_model(ci.load_problem(file))
    file.write_text(selection.text())
    print(selection.table().text(), flush=True)
    return selection


def write_payload(selection: ci.problems.ModelSelection) -> None:
    """Write the loaded robot's file: the bare one's model, gains of the known load."""
    problem = ci.load_problem(PAYLOAD)
    table = selection.applied(problem.table)
    changed = changed_tables(problem.table, table, _PARTS)
    text = rewritten(PAYLOAD.read_text(), toml_text(table, {}), changed, table)
    found = gains_of(selection.chosen())
    values, errors = (
        ", ".join(f"{value:.2f}" for value in figures)
        for figures in (found.gains, found.standard_errors)
    )
    line = f"torque_gain = [{values}]  # +- {errors}"
    PAYLOAD.write_text(re.sub(r"(?m)^torque_gain = .*$", line, text))
    print(f"{PAYLOAD}: {line}")


def gains_of(problem: ci.Problem) -> ci.estimation.DriveGains:
    """Identify the drive gains with the known load, from the other trajectory."""
    loaded, unloaded = (_currents(problem, file) for file in (LOADED, UNLOADED))
    return ci.estimation.identify_gains(
        problem.model, loaded, unloaded, known={"load.m": MASS}
    )


def _currents(problem: ci.Problem, file: str) -> ci.Recording:
    """Return the part of a log in which the robot moves, with currents for torque."""
    log = problem.prepare(problem.read(file, omit=_BROKEN))
    moving = np.flatnonzero(abs(log.velocity).max(axis=1) > _MOVING)
    log = log.samples(slice(moving[0], moving[-1]))
    gains = np.asarray(data_of(problem.table).torque_gain)
    return ci.signals.altered(
        log, lambda whole: replace(whole, torque=whole.torque / gains)
    )


def main() -> None:
    chosen = {name: write_chosen(name) for name in NAMES}
    write_payload(chosen["ur10e"])


if __name__ == "__main__":
    main()
