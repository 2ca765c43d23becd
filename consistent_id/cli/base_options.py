"""Options for a floating base and its contacts, where the log does not tell them."""

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from consistent_id.cli.option import Group, Option

if TYPE_CHECKING:
    from consistent_id.problems.floating.hints import BaseHints


def _names(text: str) -> str | tuple[str, ...]:
    """Read one array's name, or columns' names with commas between them."""
    return tuple(text.split(",")) if "," in text else text


_ROLES = {
    "angular_velocity": "gyroscope, rad/s: gx,gy,gz or an array",
    "acceleration": "accelerometer, m/s^2 with gravity: ax,ay,az or an array",
    "base_position": "place of the base in the world, m: x,y,z or an array",
    "orientation": "quaternion of the base: four columns or an array",
}
BASE_COLUMNS = Group(
    "a base that floats (--base floating), guessed from the log unless given",
    (
        *(
            Option(f"--{role.replace('_', '-')} NAMES", meaning, _names)
            for role, meaning in _ROLES.items()
        ),
        Option(
            "--quaternion",
            "where its real part stands: last (ROS, Isaac Gym) or first (MuJoCo)",
            choices=("xyzw", "wxyz"),
        ),
        Option("--imu FRAME", "of the robot's file, where the unit is"),
        Option(
            "--contact FRAME=COLUMN ...",
            "flag of a foot, or FRAME=always; none: it touches nothing",
        ),
    ),
)


def base_hints(options: argparse.Namespace) -> "BaseHints":
    """Return what the options say of the base's columns."""
    from consistent_id.problems.floating.hints import BaseHints

    return BaseHints(
        angular_velocity=options.angular_velocity,
        acceleration=options.acceleration,
        position=options.base_position,
        orientation=options.orientation,
        order=options.quaternion,
        imu=options.imu,
        contacts=_contacts(options.contact),
    )


def given_base_options(options: argparse.Namespace) -> list[str]:
    """Return those of the options that were given."""
    names = (*_ROLES, "quaternion", "imu", "contact")
    return [name for name in names if getattr(options, name)]


def _contacts(words: Sequence[str]) -> dict[str, str] | None:
    from consistent_id.errors import ProblemError

    if not words:
        return None
    if list(words) == ["none"]:
        return {}
    pairs = [word.partition("=") for word in words]
    for word, (frame, equals, column) in zip(words, pairs, strict=True):
        if not (frame and equals and column):
            raise ProblemError(
                f"--contact {word}: expected FRAME=COLUMN, FRAME=always, or none alone"
            )
    return {frame: column for frame, _, column in pairs}
