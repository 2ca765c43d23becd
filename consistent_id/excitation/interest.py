"""Parameters of interest: a motion is for them; others are unknown, or known."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from consistent_id.errors import ProblemError
from consistent_id.regression.base import (
    BaseParameters,
    base_of_some,
    base_parameters,
)
from consistent_id.regression.row_structure import RowModel
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import ParameterLayout, did_you_mean

PAYLOAD = ("payload", "tool")
"""Words for the ten parameters of the last link's load."""


def parameters_named(layout: ParameterLayout, words: Sequence[str]) -> tuple[int, ...]:
    """Return the indices of parameters, in ascending order.

    Parameters
    ----------
    layout : ParameterLayout
    words : sequence of str
        Names of parameters (``"elbow.viscous"``), or of links and joints for all their
        parameters; ``*`` stands for any letters.

    Raises
    ------
    ProblemError
        If a word names nothing.

    Examples
    --------
    >>> layout = ParameterLayout(("arm",), (("elbow", "viscous"),), ("N m s/rad",))
    >>> parameters_named(layout, ["elbow", "arm.I*z"])
    (7, 8, 9, 10)
    """
    found: set[int] = set()
    for word in words:
        named = _named(layout, word)
        if not named:
            owners = dict.fromkeys(n.rpartition(".")[0] for n in layout.names)
            near = did_you_mean(word, [*owners, *layout.names])
            raise ProblemError(
                f"interest: no parameter, link or joint {word!r}; {near}"
            )
        found |= named
    return tuple(sorted(found))


def interest_names(robot: RobotModel, words: Sequence[str]) -> tuple[str, ...]:
    """Return names of parameters, links and joints in place of words for a load.

    A load, such as a payload or a tool, adds to the ten parameters of the link that
    carries it: ``"payload"`` and ``"tool"`` stand for those of each last link, and a
    link that is fixed to a moving one, such as ``"tool0"``, for those of the moving
    one. A link or joint with such a name has precedence.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.5)])
    >>> interest_names(arm, ["payload", "joint1"])
    ('link2.*', 'joint1')
    """
    own = {*robot.link_names, *robot.joint_names}
    parents = {joint.parent for joint in robot.joints}
    last = [name for k, name in enumerate(robot.link_names) if k not in parents]
    fixed = {frame.name: link.name for link in robot.links for frame in link.merged}
    names: list[str] = []
    for word in words:
        if word in own:
            names.append(word)
        elif word in fixed:
            names.append(f"{fixed[word]}.*")
        elif word in PAYLOAD:
            names += [f"{name}.*" for name in last]
        else:
            names.append(word)
    return tuple(names)


def base_for(
    model: RowModel, words: Sequence[str], *, known: bool = False
) -> BaseParameters:
    """Return base parameters of which some contain only those of interest.

    Parameters
    ----------
    model : TorqueModel or SensorRows
    words : sequence of str
    known : bool
        Whether all other parameters are known: base parameters are then those of
        interest alone.

    Raises
    ------
    ProblemError
        If a word names nothing, or nothing of interest can be separated from the
        others.
    """
    named = parameters_named(model.layout, words)
    base = base_of_some(model, named) if known else base_parameters(model, last=named)
    if words and not places_of_interest(base, words):
        raise ProblemError(
            f"interest: no motion separates {', '.join(words)} from the other "
            f"parameters; name more of them, such as the links before and after"
        )
    return base


def places_of_interest(base: BaseParameters, words: Sequence[str]) -> tuple[int, ...]:
    """Return base parameters that are led by one of interest; none without words."""
    named = set(parameters_named(base.layout, words))
    return tuple(k for k, i in enumerate(base.independent) if i in named)


def is_named(layout: ParameterLayout, word: str) -> bool:
    """Return whether a word names a parameter, or a link or joint that has some."""
    return bool(_named(layout, word))


def _named(layout: ParameterLayout, word: str) -> set[int]:
    return {
        i
        for i, name in enumerate(layout.names)
        if _fits(name, word) or _fits(name.rpartition(".")[0], word)
    }


def _fits(name: str, word: str) -> bool:
    return name == word or fnmatchcase(name, word)
