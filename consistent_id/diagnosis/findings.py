"""The findings of a diagnosis, with evidence and advice, and their table."""

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

from consistent_id._support.tables import Table, brief
from consistent_id.recordings.recording import LogFinding, Severity

__all__ = ["Diagnosis", "FoundUnit", "LogFinding", "Severity"]

_LOOKED_FOR = (
    "clocks, units, signs, exchanged channels, gains, joint zero offsets, lags, dead, "
    "noisy and saturated channels, the kind of torque, gravity, masses, contact, "
    "rests, joints that did not move, and validation rows that are training rows"
)
_OF_SIGNALS = (
    "clocks, jumps, dead, noisy and saturated channels, limits of travel, and "
    "validation rows that are training rows"
)


class FoundUnit(NamedTuple):
    """A unit of a clock or of positions that is not the assumed one.

    Parameters
    ----------
    finding : LogFinding
    options : str
        That state the unit, with ``COUNTS`` for those of a turn if they are open; empty
        if several units are likely.
    """

    finding: LogFinding
    options: str


@brief
@dataclass(frozen=True, slots=True)
class Diagnosis:
    """All findings, the gravest first.

    Parameters
    ----------
    findings : tuple of LogFinding
    recordings : tuple of str
        Names of the recordings that were examined.
    by_themselves : bool
        Whether each channel was only examined by itself, without the faults that show
        in torque and motion together.
    """

    findings: tuple[LogFinding, ...]
    recordings: tuple[str, ...] = ()
    by_themselves: bool = False

    def __post_init__(self) -> None:
        order = {"fault": 0, "warning": 1, "note": 2}
        ranked = sorted(self.findings, key=lambda f: (order[f.severity], -f.score))
        object.__setattr__(self, "findings", tuple(ranked))

    @property
    def faults(self) -> tuple[LogFinding, ...]:
        """The findings that make estimates wrong."""
        return tuple(f for f in self.findings if f.severity == "fault")

    @property
    def suspicious(self) -> tuple[LogFinding, ...]:
        """Faults and warnings, without notes."""
        return tuple(f for f in self.findings if f.severity != "note")

    def of(self, kind: str) -> tuple[LogFinding, ...]:
        """Return the findings of one kind."""
        return tuple(f for f in self.findings if f.kind == kind)


def diagnosis_table(found: Diagnosis) -> Table:
    """Return a table of the findings, the gravest first, with advice on each."""
    where = f" in {', '.join(found.recordings)}" if found.recordings else ""
    several = len(found.recordings) > 1
    sentences = tuple(_sentence(f, several=several) for f in found.findings)
    what = "What was found" if found.suspicious else "Nothing suspicious was found"
    return Table(
        f"{what}{where}",
        ("severity", "kind", "where", "recording"),
        tuple((f.severity, f.kind, f.where, f.recording) for f in found.findings),
        sentences if found.suspicious else (*sentences, _looked_for(found)),
    )


def _looked_for(found: Diagnosis) -> str:
    if not found.by_themselves:
        return f"looked for: {_LOOKED_FOR}"
    return (
        f"looked for: {_OF_SIGNALS}; not for signs, gains and exchanged channels, "
        "which can only be found for a robot on a fixed base, and for lags only with "
        'delays = { torque = "estimated" } in [data.preparation]'
    )


def _sentence(finding: LogFinding, *, several: bool) -> str:
    """Return a finding as a sentence; with advice, unless it is a note."""
    named = [finding.recording] if several and finding.recording else []
    where = ", ".join(dict.fromkeys([*named, finding.where]))
    text = f"{finding.kind} ({where}): {finding.statement}"
    return text if finding.severity == "note" else f"{text}. To do: {finding.advice}"


def diagnosis_record(found: Diagnosis) -> dict[str, Any]:
    """Return the findings as numbers and text, ready for JSON."""
    return {
        "format": "consistent_id diagnosis 1",
        "recordings": list(found.recordings),
        "findings": [asdict(f) for f in found.findings],
    }
