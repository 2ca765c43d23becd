"""Whether an estimate may be exported, and the provenance that a file states."""

import re

from consistent_id.constraints.cones.certificate import Verdict
from consistent_id.constraints.link_condition import link_conditions
from consistent_id.errors import ProblemError
from consistent_id.estimation.estimate import Estimate
from consistent_id.robot.loaders.splice import Document, Edit

_COMMENT = re.compile(rb"\s*<!-- consistent-id: [^>]* -->")


def inconsistent_links(estimate: Estimate) -> tuple[str, ...]:
    """Return the names of links that are not physically consistent."""
    found = link_conditions(estimate.model, estimate.parameters)
    return tuple(link.link for link in found if not link.consistent)


def export_verdict(estimate: Estimate) -> Verdict:
    """Return the verdict: ``refused`` if a link is not physically consistent."""
    if inconsistent_links(estimate):
        return "refused"
    return estimate.certificate.verdict


def require_usable(estimate: Estimate, allow_refused: bool) -> None:
    """Refuse to export what no simulator should be given.

    Raises
    ------
    ProblemError
        If the estimate is refused and `allow_refused` is false.
    """
    if allow_refused or export_verdict(estimate) != "refused":
        return
    links = inconsistent_links(estimate)
    why = estimate.certificate.reason
    if links:
        why = f"not physically consistent: {', '.join(links)}"
    raise ProblemError(
        f"the estimate by {estimate.method!r} is refused ({why}); export a constrained "
        "one, or say allow_refused"
    )


def provenance(estimate: Estimate) -> str:
    """Return one line for a file's comment: method, robot, verdict."""
    return (
        f"consistent-id: robot {estimate.model.robot.name}, method {estimate.method}, "
        f"verdict {export_verdict(estimate)}"
    )


def comment_edit(document: Document, text: str) -> Edit:
    """Return the edit that puts a comment first, in place of an earlier one."""
    text = text.replace("--", "- -").replace(">", "")
    edit = document.insert(document.root, [[f"<!-- {text} -->"]])
    earlier = _COMMENT.match(document.data, edit.start)
    return edit if earlier is None else edit._replace(stop=earlier.end())
