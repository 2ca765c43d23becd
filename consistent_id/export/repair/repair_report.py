"""A repair, for people and for programs."""

from dataclasses import asdict
from typing import Any

import numpy as np

from consistent_id._support.tables import Table
from consistent_id.export.repair.link_repair import LinkRepair, Repair


def repair_table(repair: Repair) -> Table:
    """Return a table of the links that were wrong, and what was done."""
    wrong = [link for link in repair.links if link.status != "consistent"]
    advised = [link for link in repair.links if link not in wrong and link.remedy]
    count = len(repair.links)
    notes = [
        f"{len(repair.repaired)} of {count} inertials repaired, "
        f"{len(repair.refused)} cannot be without more information"
        if wrong
        else f"nothing to repair: {count} inertials are physically consistent"
    ]
    for link in repair.links:
        notes += [f"{link.link}: {link.warning}"] if link.warning else []
        if link.status in ("refused", "doubtful"):
            notes += _suggested(link)
    for remedy in dict.fromkeys(link.remedy for link in advised):
        names = [link.link for link in advised if link.remedy == remedy]
        notes.append(f"{', '.join(names)}: {remedy}")
    return Table(
        f"{repair.source}",
        ("link", "line", "wrong", "done", "moments now [kg m^2]", "change"),
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


def _row(link: LinkRepair) -> tuple[str, ...]:
    refused = link.status in ("refused", "doubtful")
    return (
        link.link,
        str(link.line),
        link.fault,
        f"{link.status}: {link.remedy}" if refused else link.remedy,
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
