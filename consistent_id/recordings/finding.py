"""One thing that is wrong with a recording, or worth knowing."""

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
