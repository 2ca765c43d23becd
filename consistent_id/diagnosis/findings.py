"""What the data detective says: findings, with evidence and advice."""

from dataclasses import dataclass

from consistent_id.recordings.finding import Finding, Severity

__all__ = ["Diagnosis", "Finding", "Severity"]


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """All findings, the gravest first.

    Parameters
    ----------
    findings : tuple of Finding
    recordings : tuple of str
        Names of those that were looked at.
    by_themselves : bool
        Whether channels were looked at by themselves alone: nothing was sought that
        only torque and motion together show.
    """

    findings: tuple[Finding, ...]
    recordings: tuple[str, ...] = ()
    by_themselves: bool = False

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
