"""The problem that a motion is designed for: a problem file's, or that of a robot."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.errors import ModelError, ProblemError
from consistent_id.estimation.estimate import Estimate
from consistent_id.problems.file import read_problem_table
from consistent_id.problems.found_logs import selection_of
from consistent_id.problems.loading import problem_files, problem_of, stated_problem
from consistent_id.problems.overrides import overridden
from consistent_id.problems.parameter_tables import ConstraintsTable
from consistent_id.problems.paths import require_own_names
from consistent_id.problems.problem import Problem
from consistent_id.problems.robot_draft import ROBOT_ENDINGS, robot_draft
from consistent_id.problems.statement import Statement
from consistent_id.problems.task_tables import ExcitationTable, SceneTable
from consistent_id.regression.base import base_parameters, require_same_model
from consistent_id.regression.given_regression import load_regression
from consistent_id.regression.regression import Regression
from consistent_id.robot.chains import FLOATING
from consistent_id.robot.loaders import load_robot
from consistent_id.robot.model import RobotModel

_LIMITS = (
    "velocity",
    "acceleration",
    "jerk",
    "effort",
    "effort_rate",
    "effort_rms",
    "current",
    "torque_constant",
    "friction_share",
    "share",
)
OPEN = "open"
"""Word for the parameters that an earlier estimate does not determine."""
_OPEN_ORIGINS = ("loose", "prior", "convention")
_SCENE = ("ground", "clearance", "planning_scene", "allowed")


def is_robot(path: Path) -> bool:
    """Return whether a path names a robot's file, not a problem's."""
    return path.suffix.lower() in ROBOT_ENDINGS


def problem_to_excite(
    path: Path, changes: Mapping[str, Any], stated: Statement | None = None
) -> Problem:
    """Return the problem of a file, with changes to its ``[excitation]`` table.

    Masses do not affect the design: a problem file may require datasheet masses that no
    link has.

    Parameters
    ----------
    path : Path
        A problem file or its folder, or a URDF or MJCF file.
    changes : mapping of str to value
        Keys of ``[excitation]``, of its limits and its scene; None changes nothing.
    stated : Statement, optional
        Statement about the robot.

    Raises
    ------
    ProblemError
        If the robot's base floats.
    """
    stated = Statement() if stated is None else stated
    if is_robot(path):
        asked = changed(ExcitationTable(), changes)
        try:
            draft = robot_draft(path, asked, stated)
        except ModelError:
            _require_stated_base(path, stated)
            raise
        return _with_fixed_base(draft.problem(), path)
    return _with_fixed_base(_problem_of_file(path, changes, stated), path)


def _require_stated_base(path: Path, stated: Statement) -> None:
    """Refuse a robot that only floats because nobody states a base that stands still.

    The loader also proposes a base that floats, which no motion can be designed for.
    """
    if stated.base is not None:
        return
    part = asdict(selection_of(stated)) | {"base": FLOATING}
    try:
        robot = load_robot(path, gravity=stated.gravity, **part)
    except ModelError:
        return
    if robot.floating and len(robot):
        raise _floating_base(path, robot)


def _with_fixed_base(problem: Problem, path: Path) -> Problem:
    if problem.moving.floating:
        raise _floating_base(path, problem.moving)
    return problem


def _floating_base(path: Path, robot: RobotModel) -> ProblemError:
    said = f"{path}: the base floats, but motions are designed for a fixed base"
    if not is_robot(path):  # its recordings may have a base that moves
        return ProblemError(
            f"{said}: name the robot's file in place of the problem, with --base LINK "
            "for a link that stands still or hangs, or with --standing (excite) for a "
            "robot on its feet"
        )
    base = shlex.quote(robot.link_names[0])
    return ProblemError(
        f"{said}: --base {base} if this link stands still or hangs, or excite ROBOT "
        "--standing if the robot stands on its feet",
        options=f"--base {base}",
    )


def _problem_of_file(
    path: Path, changes: Mapping[str, Any], stated: Statement
) -> Problem:
    """Return the problem of a problem file, with changes to its table."""
    (file,) = problem_files(path)
    table = overridden(read_problem_table(file), stated, file).table
    excitation = changed(table.excitation, changes)
    if table.data is None and not _has_masses(table.links):
        require_own_names(table, file)
        free = ConstraintsTable(masses="free")
        table = msgspec.structs.replace(table, constraints=free, excitation=excitation)
        return replace(problem_of(table, file), source=file)
    problem = stated_problem(file, stated).problem
    table = msgspec.structs.replace(problem.table, excitation=excitation)
    return replace(problem, table=table)


def estimated_parameters(problem: Problem, files: Sequence[Path]) -> Matrix | None:
    """Return the parameters of estimates of a problem's torque model.

    Parameters
    ----------
    files : sequence of Path
        Written by `Estimate.save` or ``identify``.

    Returns
    -------
    ndarray, shape (files, parameters), or None without files

    Raises
    ------
    ProblemError
        If one is not an estimate, or of another torque model.
    """
    if not files:
        return None
    model = problem.model
    base = base_parameters(model)
    return np.array([Estimate.load(f, model, base).parameters for f in files])


def earlier_recordings(
    problem: Problem, files: Sequence[Path]
) -> tuple[Regression, ...]:
    """Return regressions of a problem's torque model from files.

    Parameters
    ----------
    files : sequence of Path
        Written by `save_regression` or ``compress``.

    Raises
    ------
    ProblemError
        If one is not a regression, or of another torque model.
    """
    found = []
    for file in files:
        try:
            regression = load_regression(file)
            require_same_model(
                problem.model, regression, base_parameters(problem.model)
            )
        except ProblemError as cause:
            raise ProblemError(
                f"earlier recordings {file}: {cause}. consistent-id compress PROBLEM "
                "writes them, for the same robot and drive terms; an estimate does "
                "not contain the information of its data"
            ) from None
        found.append(regression)
    return tuple(found)


def with_open_parameters(problem: Problem, files: Sequence[Path]) -> Problem:
    """Return the problem with estimates' open parameters instead of the word "open".

    A parameter is open if, in one of the estimates, the data bound it only loosely, or
    a prior or a convention determined it.

    Raises
    ------
    ProblemError
        If there is no estimate, or nothing is open.
    """
    excitation = problem.table.excitation
    if OPEN not in excitation.interest:
        return problem
    if not files:
        raise ProblemError(
            f"interest {OPEN!r} needs an estimate with open parameters: give "
            "--parameters delivered.json"
        )
    base = base_parameters(problem.model)
    left: dict[str, None] = {}
    for file in files:
        found = Estimate.load(file, problem.model, base)
        names = zip(problem.model.layout.names, found.origins, strict=True)
        left |= {name: None for name, origin in names if origin in _OPEN_ORIGINS}
    if not left:
        raise ProblemError(
            f"{', '.join(map(str, files))}: the data determine all parameters; nothing "
            "is open. Leave --for out"
        )
    words = [word for word in excitation.interest if word != OPEN]
    excitation = msgspec.structs.replace(excitation, interest=[*words, *left])
    table = msgspec.structs.replace(problem.table, excitation=excitation)
    return replace(problem, table=table)


def changed(table: ExcitationTable, changes: Mapping[str, Any]) -> ExcitationTable:
    """Return the table with the changes that are not None."""
    given = {key: value for key, value in changes.items() if value is not None}
    limits = {key: given.pop(key) for key in _LIMITS if key in given}
    scene = {key: given.pop(key) for key in _SCENE if key in given}
    if limits:
        given["limits"] = msgspec.structs.replace(table.limits, **limits)
    if scene:
        given["scene"] = msgspec.structs.replace(table.scene or SceneTable(), **scene)
    return msgspec.structs.replace(table, **given)


def _has_masses(links: Mapping[str, Any]) -> bool:
    return any(link.mass is not None for link in links.values())
