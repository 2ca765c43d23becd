"""Whether an estimate may be exported, and the provenance that a file states."""

import re

from consistent_id.errors import ProblemError
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.verdict import HELP
from consistent_id.robot.loaders.splice import Document, Edit
from consistent_id.robot.model import RobotModel

_COMMENT = re.compile(rb"\s*<!-- consistent-id: [^>]* -->")


def require_usable(estimate: Estimate, allow_refused: bool) -> None:
    """Refuse to export what no simulator should be given.

    Raises
    ------
    ProblemError
        If the verdict is ``do not use`` and `allow_refused` is false.
    """
    if allow_refused:
        return
    verdict = estimate.verdict
    if verdict.usable:
        return
    ground = verdict.grounds[0]
    raise ProblemError(
        f"{verdict.sentence}: {ground.statement}. {ground.advice}; or say "
        f"allow_refused (--accept {ground.kind!r} in the shell). See {HELP}"
    )


def require_fixed_base(robot: RobotModel, what: str) -> None:
    """Refuse to export dynamics that would leave out the six rows of the base.

    Raises
    ------
    ProblemError
        If the robot's base floats.
    """
    if robot.floating:
        raise ProblemError(
            f"{what} are of joints alone, but the base of {robot.name!r} floats; "
            "export URDF, MJCF, a Pinocchio model or JSON, which hold its body"
        )


def provenance(estimate: Estimate) -> str:
    """Return one line for a file's comment: method, robot, verdict."""
    verdict = estimate.verdict
    accepted = f", accepted: {', '.join(verdict.accepted)}" if verdict.accepted else ""
    return (
        f"consistent-id: robot {estimate.model.robot.name}, method {estimate.method}, "
        f"verdict: {verdict}{accepted}"
    )


def comment_edit(document: Document, text: str) -> Edit:
    """Return the edit that puts a comment first, in place of an earlier one."""
    text = text.replace("--", "- -").replace(">", "")
    edit = document.insert(document.root, [[f"<!-- {text} -->"]])
    earlier = _COMMENT.match(document.data, edit.start)
    return edit if earlier is None else edit._replace(stop=earlier.end())
