"""What the data detective says: findings, with evidence and advice."""

from dataclasses import dataclass
from typing import Literal

Severity = Literal["fault", "warning", "note"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong, or worth knowing.

    Parameters
    ----------
    kind : str
        Class of the fault, such as ``"torque sign"``.
    severity : {"fault", "warning", "note"}
        A fault makes estimates wrong; a warning makes them worse; a note explains.
    where : str
        Joint, pair of joints, or recording; ``"all joints"``.
    statement : str
        What was seen, with figures and units.
    advice : str
        What to do.
    score : float
        Evidence, one at the threshold and larger beyond it.
    recording : str
        In which it was seen.
    """

    kind: str
    severity: Severity
    where: str
    statement: str
    advice: str
    score: float = 1.0
    recording: str = ""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """All findings, the gravest first.

    Parameters
    ----------
    findings : tuple of Finding
    recordings : tuple of str
        Names of those that were looked at.
    """

    findings: tuple[Finding, ...]
    recordings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        order = {"fault": 0, "warning": 1, "note": 2}
        ranked = sorted(self.findings, key=lambda f: (order[f.severity], -f.score))
        object.__setattr__(self, "findings", tuple(ranked))

    @property
    def faults(self) -> tuple[Finding, ...]:
        """The findings that make estimates wrong."""
        return tuple(f for f in self.findings if f.severity == "fault")

    @property
    def suspicious(self) -> tuple[Finding, ...]:
        """Faults and warnings: the findings that are no mere notes."""
        return tuple(f for f in self.findings if f.severity != "note")

    def of(self, kind: str) -> tuple[Finding, ...]:
        """Return the findings of one kind."""
        return tuple(f for f in self.findings if f.kind == kind)
