"""Robots from a file, URDF or MJCF."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from numpy.typing import ArrayLike

from consistent_id.robot.chains import Selection
from consistent_id.robot.loaders.urdf_lint import read_bytes
from consistent_id.robot.loaders.xml import XmlFault, parse
from consistent_id.robot.model import STANDARD_GRAVITY, RobotModel

_ROOTS = {"robot": False, "mujoco": True}  # root element -> whether the file is MJCF
_MJCF_SUFFIXES = (".xml", ".mjcf")


def load_robot(
    path: str | Path,
    *,
    gravity: ArrayLike | None = None,
    base: str | None = None,
    tip: str | None = None,
    joints: Sequence[str] | None = None,
    locked: Mapping[str, float] | None = None,
) -> RobotModel:
    """Load a robot from a URDF or an MJCF file.

    The root element decides: ``<robot>`` is URDF, ``<mujoco>`` is MJCF.  If it is
    neither, or the text is not XML, the suffix decides: ``.xml`` and ``.mjcf`` are
    MJCF, all others are URDF.

    Parameters
    ----------
    path : str or Path
    gravity : array_like, shape (3,), [m/s^2], optional
        In the frame of the root link or the world; by default that of the MJCF file,
        and (0, 0, -9.81) of a URDF, which states none.
    base, tip, joints, locked
        The joints that move; see `load_urdf`.

    Returns
    -------
    RobotModel

    Raises
    ------
    ModelError
        If the file cannot be read or does not describe a robot; see `load_urdf` and
        `load_mjcf`.

    See Also
    --------
    load_urdf, load_mjcf : The two formats by themselves.

    Examples
    --------
    >>> import consistent_id as ci
    >>> ci.load_robot("problems/kuka_kr300/robot.urdf").joint_names
    ('joint_1', 'joint_2', 'joint_3', 'joint_4', 'joint_5', 'joint_6')
    """
    from consistent_id.robot.loaders.mjcf import load_mjcf
    from consistent_id.robot.loaders.urdf import load_urdf

    selection = Selection(base, tip, joints, locked)
    if is_mjcf(Path(path)):
        return load_mjcf(path, gravity=gravity, **asdict(selection))
    gravity = STANDARD_GRAVITY if gravity is None else gravity
    return load_urdf(path, gravity=gravity, **asdict(selection))


def is_mjcf(path: Path) -> bool:
    """Return whether a file is MJCF rather than URDF.

    Raises
    ------
    ModelError
        If the file cannot be read.
    """
    by_suffix = path.suffix.lower() in _MJCF_SUFFIXES
    try:
        return _ROOTS.get(parse(read_bytes(path)).tag, by_suffix)
    except XmlFault:
        return by_suffix
