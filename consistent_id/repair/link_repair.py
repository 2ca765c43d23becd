"""The faults of a file's links, and their repairs."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from consistent_id._support.files import write_atomically
from consistent_id._support.tables import Table, brief
from consistent_id.errors import ModelError

Status = Literal["consistent", "repaired", "doubtful", "refused"]


@dataclass(frozen=True, slots=True)
class Suggestion:
    """A likely intended inertial.

    Parameters
    ----------
    cause : str
        The assumed mistake, or the proposal if no known mistake explains it.
    mass : float, [kg]
    inertia : tuple of float, [kg m^2]
        ``ixx, ixy, ixz, iyy, iyz, izz``.
    cost : float
        Minus a logarithm of odds; differences count.
    """

    cause: str
    mass: float
    inertia: tuple[float, ...]
    cost: float


@brief
@dataclass(frozen=True, slots=True)
class LinkRepair:
    """The fault of a link, and its repair.

    Parameters
    ----------
    line : int
        Line of its ``<inertial>``.
    status : {"consistent", "repaired", "doubtful", "refused"}
        Refused: it cannot be repaired without inventing values, or has several likely
        causes.  Doubtful: it is consistent, and not changed, but far from the link's
        shapes or its twins.
    fault : str
        Empty if there is none.
    remedy : str
        The repair, the values that the user must state, or remaining reasons for
        simulators to refuse it.
    mass : float or None, [kg]
        Afterwards.
    before, after : tuple of float, [kg m^2]
        Principal moments of inertia, empty where there is none to be read.
    change : float
        Relative change of the second moments of mass; see `nearest_inertia`.
    warning : str
        Reason to check the repaired inertia.
    suggestions : tuple of Suggestion
        Likely intended inertials, the likeliest first.
    """

    link: str
    line: int
    status: Status
    fault: str = ""
    remedy: str = ""
    mass: float | None = None
    before: tuple[float, ...] = ()
    after: tuple[float, ...] = ()
    change: float = 0.0
    warning: str = ""
    suggestions: tuple[Suggestion, ...] = ()


@brief
@dataclass(frozen=True, slots=True)
class Repair:
    """A repaired file, and a record of each of its links.

    Parameters
    ----------
    source : Path
    original, content : bytes
        The same ones, if nothing was to be repaired.
    links : tuple of LinkRepair
        All that have an ``<inertial>``, in the file's order.
    """

    source: Path
    original: bytes
    content: bytes
    links: tuple[LinkRepair, ...]

    @property
    def repaired(self) -> tuple[LinkRepair, ...]:
        """Links that were changed."""
        return tuple(link for link in self.links if link.status == "repaired")

    @property
    def doubtful(self) -> tuple[LinkRepair, ...]:
        """Links that are consistent, but probably not as intended."""
        return tuple(link for link in self.links if link.status == "doubtful")

    @property
    def refused(self) -> tuple[LinkRepair, ...]:
        """Links that cannot be repaired without inventing values."""
        return tuple(link for link in self.links if link.status == "refused")

    def save(self, path: str | Path) -> Path:
        """Write the repaired file.

        Raises
        ------
        ModelError
            If some link could not be repaired.
        """
        if self.refused:
            link = self.refused[0]
            raise ModelError(
                f"{self.source}, line {link.line}: link {link.link!r}: {link.fault}; "
                f"{link.remedy}"
            )
        return write_atomically(path, self.content)


@dataclass(frozen=True, slots=True)
class RepairOptions:
    """The user's statements beside the file.

    Parameters
    ----------
    masses : mapping of str to float, [kg]
        By link, in place of the file's.
    density : float, optional, [kg/m^3]
        Density of a ball that replaces a missing or unreadable inertia.
    thickness : float, [m]
        Least standard deviation of mass along each axis of a link with mass.
    choices : mapping of str to int
        The number of a link's suggestion, counted from 1; 0 is the nearest inertia.
    """

    masses: Mapping[str, float]
    density: float | None = None
    thickness: float = 0.0
    choices: Mapping[str, int] = field(default_factory=dict)


def repair_table(repair: Repair) -> Table:
    """Return a table of faulty links and their repairs."""
    wrong = [link for link in repair.links if link.status != "consistent"]
    advised = [link for link in repair.links if link not in wrong and link.remedy]
    count = len(repair.links)
    notes = [
        f"{len(repair.repaired)} of {count} inertials repaired, "
        f"{len(repair.refused)} need more information"
        if wrong
        else f"nothing to repair: {count} inertials are physically consistent"
    ]
    for link in repair.links:
        notes += [_said(link)] if link in wrong else []
        notes += [f"{link.link}: {link.warning}"] if link.warning else []
        if link.status in ("refused", "doubtful"):
            notes += _suggested(link)
    for remedy in dict.fromkeys(link.remedy for link in advised):
        names = [link.link for link in advised if link.remedy == remedy]
        notes.append(f"{', '.join(names)}: {remedy}")
    return Table(
        f"{repair.source}",
        ("link", "line", "status", "moments now [kg m^2]", "change"),
        tuple(_row(link) for link in wrong),
        tuple(notes),
    )


def _suggested(link: LinkRepair) -> list[str]:
    """Return the suggestions for a link, with the numbers by which to choose them."""
    return [
        f"{link.link}={k}: {one.cause}: mass {one.mass:.6g}, inertia "
        f"{' '.join(f'{value:.6g}' for value in one.inertia)}"
        + (f" ({np.exp(-one.cost):.2g} times as likely)" if k > 1 else "")
        for k, one in enumerate(link.suggestions, start=1)
    ]


def _said(link: LinkRepair) -> str:
    """Return what is wrong with a link, and what was done or is needed."""
    done = f"{link.status}: {link.remedy}" if link.remedy else link.status
    return (
        f"{link.link}: {link.fault}; {done}" if link.fault else f"{link.link}: {done}"
    )


def _row(link: LinkRepair) -> tuple[str, ...]:
    refused = link.status in ("refused", "doubtful")
    return (
        link.link,
        str(link.line),
        link.status,
        "-" if refused else _moments(link.after),
        "-" if refused or not np.isfinite(link.change) else f"{link.change:.2g}",
    )


def _moments(moments: tuple[float, ...]) -> str:
    return " ".join(f"{moment:.4g}" for moment in moments) or "-"


def repair_record(repair: Repair) -> dict[str, Any]:
    """Return a repair as plain numbers and text, ready for JSON."""
    return {
        "format": "consistent_id repair 1",
        "source": str(repair.source),
        "unchanged": repair.content == repair.original,
        "links": [
            asdict(link) | {"change": link.change if np.isfinite(link.change) else None}
            for link in repair.links
        ],
    }
