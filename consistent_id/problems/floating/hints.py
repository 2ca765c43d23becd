"""What a user says of the columns of a floating base; the rest is guessed."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from consistent_id.errors import ProblemError
from consistent_id.recordings.readers.beside_columns import Names
from consistent_id.recordings.signals.base_signals import QuaternionOrder

ALWAYS = "always"
"""In place of a contact's column: the robot stands on that foot all the time."""


@dataclass(frozen=True, slots=True)
class BaseHints:
    """Columns of a floating base and its contacts, as far as they are known.

    Parameters
    ----------
    angular_velocity, acceleration, position, orientation : optional
        Names, as in `BaseColumns`.
    order : {"xyzw", "wxyz"}, optional
        Of the quaternion.
    imu : str, optional
        Frame of the robot in which the inertial measurement unit is.
    contacts : mapping of str to str, optional
        Columns by frame, or ``"always"``.  Empty: nothing is touched.  None: guessed.
    """

    angular_velocity: Names | None = None
    acceleration: Names | None = None
    position: Names | None = None
    orientation: Names | None = None
    order: QuaternionOrder | None = None
    imu: str | None = None
    contacts: Mapping[str, str] | None = field(default=None, hash=False)

    def __bool__(self) -> bool:
        return self != BaseHints()


def require_floating(hints: BaseHints, *, floating: bool) -> None:
    """Refuse hints of a base that does not move.

    Raises
    ------
    ProblemError
        With what to say in place of them.
    """
    if hints and not floating:
        raise ProblemError(
            "columns of the base or of contacts are given, but the base is taken for "
            "fixed; say --base floating (base = 'floating') too"
        )
