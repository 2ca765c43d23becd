"""Rules for robot descriptions of any format, one function each."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.tables import brief
from consistent_id.regression.newton_euler import (
    floats,
    joint_geometry,
    joint_motions,
    torque_parts,
)
from consistent_id.repair.causes import NEAREST
from consistent_id.repair.file_evidence import FileEvidence
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.model import JointLimits, RobotModel

Severity = Literal["error", "warning"]

RULES = {
    "structure": "The file describes one tree of links and joints, in numbers",
    "inconsistent-inertia": "Some body has this mass and inertia",
    "probable-mistake": "The inertia fits the link's shapes and its twins",
    "centre-of-mass": "The centre of mass is within the link's shapes, or near them",
    "radius-of-gyration": "The mass is within the link's shapes, or near its joints",
    "point-mass": "A link that moves has an inertia, as simulators demand",
    "vanishing-mass": "A joint moves something that has mass",
    "placeholder-inertia": "Links of different masses have different inertias",
    "twins-differ": "Links on the left and on the right are alike",
    "gravity-torque": "The joints can hold the robot against gravity",
}


@brief
@dataclass(frozen=True, slots=True, order=True)
class LintFinding:
    """A fault that a simulator refuses, or accepts and should not.

    Parameters
    ----------
    line : int
        Counted from 1.
    rule : str
        An entry of `RULES`.
    severity : {"error", "warning"}
        An error: some simulator refuses it, or it cannot be loaded.
    sentence : str
    """

    line: int
    rule: str
    severity: Severity
    sentence: str

    def __str__(self) -> str:
        return f"line {self.line}: {self.severity}: {self.sentence} [{self.rule}]"


@dataclass(frozen=True, slots=True, eq=False)
class DescribedLink:
    """A link with mass, in its own frame.

    Parameters
    ----------
    mass : float, [kg]
    com : ndarray, shape (3,), [m]
    inertia : ndarray, shape (3, 3), [kg m^2]
        About the centre of mass.
    reach : float or None, [m]
        From the centre of mass to the farthest point of its shapes, or more.
    joints : float, [m]
        From the centre of mass to the farthest of the joints at this link, or between
        this joint and the one before.
    outside : float
        From its shapes to the centre of mass, over the length of the shapes.
    """

    name: str
    line: int
    mass: float
    com: Vector
    inertia: Matrix
    reach: float | None
    joints: float
    outside: float = 0.0

    @property
    def radius(self) -> float:
        """Radius of gyration about the centre of mass, [m]."""
        return float(np.sqrt(max(np.trace(self.inertia), 0.0) / (2.0 * self.mass)))


@dataclass(frozen=True, slots=True, eq=False)
class DescribedRobot:
    """Links with mass, the robot if it can be loaded, and lines of joints by name."""

    links: tuple[DescribedLink, ...]
    robot: RobotModel | None
    joint_lines: Mapping[str, int]


_OUTSIDE = 1.0  # lengths of the shapes; some are only a part of the body
_BEYOND_SHAPES = 1.0  # radius of gyration over the reach: no body inside has more
_BEYOND_JOINTS = 3.0  # relative to the distance to the joints, a rough bound
_THIN = 100.0  # [kg/m^3]; axes may cross, but few links are as thin as this
_POINT = 1e-6  # [m]; smaller bodies have no extent
_VANISHING = 1e-5  # of the robot's mass
_SAME_MASS = 0.01  # relative
_SAME_DIGITS = 1e-9  # relative
_TWIN_MASS = 0.02  # relative; cables and castings differ by so much
_TWIN_MOMENTS = 0.1  # relative
_POSTURES = 400
_SIDES = (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"))
_LETTER = re.compile(r"(?<![A-Za-z])([FRBHMfrbhm]?)([LRlr])(?=[_./-]|[A-Z][a-z]|$)")


def all_findings(robot: DescribedRobot) -> Iterator[LintFinding]:
    """Yield the findings of every rule of this module."""
    for link in robot.links:
        yield from _centre(link)
        yield from _radius(link)
    yield from _placeholders(robot)
    yield from _twins(robot)
    if robot.robot is not None:
        yield from _vanishing(robot, robot.robot)
        yield from _gravity(robot, robot.robot)


def _centre(link: DescribedLink) -> Iterator[LintFinding]:
    if link.outside > _OUTSIDE:
        yield _warning(
            link,
            "centre-of-mass",
            f"the centre of mass is {link.outside:.3g} times the length of its shapes "
            "away from them; check that it is in m, in the link's frame",
        )


def _radius(link: DescribedLink) -> Iterator[LintFinding]:
    ball = float(np.cbrt(3.0 * link.mass / (4.0 * np.pi * _THIN)))
    reach, factor = max(link.joints, ball), _BEYOND_JOINTS
    what = "its joints, or a ball of 100 kg/m^3, are within"
    if link.reach is not None:
        reach, factor, what = link.reach, _BEYOND_SHAPES, "its shapes reach"
    if reach > 0.0 and link.radius > factor * reach:
        yield _warning(
            link,
            "radius-of-gyration",
            f"radius of gyration is {link.radius:.3g} m, but {what} {reach:.3g} m of "
            "its centre of mass",
        )


def _placeholders(robot: DescribedRobot) -> Iterator[LintFinding]:
    for k, link in enumerate(robot.links):
        size = float(abs(link.inertia).max())
        same = [
            other.name
            for other in robot.links[:k]
            if abs(other.inertia - link.inertia).max() <= _SAME_DIGITS * size
            and abs(other.mass - link.mass) > _SAME_MASS * max(link.mass, other.mass)
        ]
        if same and size > link.mass * _POINT**2:
            yield _warning(
                link,
                "placeholder-inertia",
                f"the inertia is that of {same[0]!r}, but the mass differs",
            )


def _twins(robot: DescribedRobot) -> Iterator[LintFinding]:
    links = {link.name: link for link in robot.links}
    for link in robot.links:
        other = links.get(mirrored_name(link.name))
        if other is None or other.line >= link.line:
            continue
        if abs(link.mass - other.mass) > _TWIN_MASS * max(link.mass, other.mass):
            sentence = (
                f"mass is {link.mass:g} kg, that of {other.name!r} {other.mass:g}"
            )
            yield _warning(link, "twins-differ", sentence)
            continue
        mine, its = _moments(link), _moments(other)
        if abs(mine - its).max() > _TWIN_MOMENTS * max(abs(mine).max(), abs(its).max()):
            yield _warning(
                link,
                "twins-differ",
                f"principal moments are {_words(mine)} kg m^2, those of "
                f"{other.name!r} {_words(its)}",
            )


def mirrored_name(name: str) -> str:
    """Return the name with its first word for a side changed to the other side.

    Examples
    --------
    >>> mirrored_name("left_knee"), mirrored_name("FL_hip"), mirrored_name("tool")
    ('right_knee', 'FR_hip', '')
    """
    for left, right in _SIDES:
        for one, other in ((left, right), (right, left)):
            if one in name:
                return name.replace(one, other, 1)
    found = _LETTER.search(name)
    if found is None:
        return ""
    other = {"L": "R", "R": "L", "l": "r", "r": "l"}[found[2]]
    return name[: found.start(2)] + other + name[found.end(2) :]


def _vanishing(described: DescribedRobot, robot: RobotModel) -> Iterator[LintFinding]:
    bodies = [link.nominal or InertialParameters(np.zeros(10)) for link in robot.links]
    masses = [body.mass for body in bodies]
    total = sum(masses)
    parents = {joint.parent for joint in robot.joints}
    for k, (joint, mass) in enumerate(zip(robot.joints, masses, strict=True)):
        line = described.joint_lines.get(joint.name, 1)
        what = f"joint {joint.name!r} moves link {robot.links[k].name!r} of {mass:g} kg"
        if mass <= _VANISHING * total:
            last = k not in parents
            yield LintFinding(
                line,
                "vanishing-mass",
                "error" if last else "warning",
                f"{what}; {'nothing resists it' if last else 'simulators want mass'}",
            )
            continue
        inertia = bodies[k].central_inertia
        if abs(inertia).max() <= mass * _POINT**2:
            sentence = f"{what}, all in one point; MuJoCo refuses that"
            yield LintFinding(line, "point-mass", "error", sentence)


def _gravity(described: DescribedRobot, robot: RobotModel) -> Iterator[LintFinding]:
    efforts = np.array([joint.limits.effort for joint in robot.driven])
    q = _postures(robot)
    if robot.nominal is None:
        return
    torque = abs(_torque_at_rest(robot, robot.nominal, q))
    for k, joint in enumerate(robot.driven):
        worst = float(torque[:, k].max(initial=0.0))
        if 0.0 < efforts[k] < worst:
            unit = "N" if joint.kind == "prismatic" else "N m"
            yield LintFinding(
                described.joint_lines.get(joint.name, 1),
                "gravity-torque",
                "warning",
                f"joint {joint.name!r}: gravity needs {worst:.3g} {unit} in some "
                f"posture, and the effort limit is {efforts[k]:g} {unit}",
            )


def _torque_at_rest(robot: RobotModel, nominal: Vector, q: Array) -> Array:
    """Return the torque of gravity on all bodies, shape of `q`, [N m or N].

    By the recursion itself: no friction, no regressor, and so none of the modules that
    a `TorqueModel` needs.
    """
    still = [0.0] * len(robot)
    state: list[Any] = [np.ascontiguousarray(q.T), still, still]
    motion = joint_motions(robot, state, lambda x: (np.sin(x), np.cos(x)))
    geometry, gravity = joint_geometry(robot), floats(robot.gravity)
    torque = np.zeros_like(q)
    bodies = nominal.reshape(-1, 10).tolist()
    for j, _, values in torque_parts(geometry, gravity, motion, bodies):
        torque[:, j] += values
    return torque


def _postures(robot: RobotModel) -> np.ndarray:
    """Return postures within the limits, shape (postures, joints), the same always."""
    rng = np.random.default_rng(0)
    draws = rng.uniform(size=(_POSTURES, len(robot)))
    lower, upper = np.array([_range(joint.limits) for joint in robot.driven]).T
    return np.asarray(lower + (upper - lower) * draws)


def _range(limits: JointLimits) -> Vector:
    stated = np.array([limits.lower, limits.upper])
    return stated if np.isfinite(stated).all() else np.array([-np.pi, np.pi])


def _warning(link: DescribedLink, rule: str, sentence: str) -> LintFinding:
    return LintFinding(link.line, rule, "warning", f"link {link.name!r}: {sentence}")


def _moments(link: DescribedLink) -> Vector:
    return np.asarray(np.linalg.eigvalsh(link.inertia), dtype=np.float64)


def _words(moments: Vector) -> str:
    return ", ".join(f"{moment:.4g}" for moment in moments)


def probable_mistakes(
    known: FileEvidence, lines: Mapping[str, int], advice: str = ""
) -> Iterator[LintFinding]:
    """Yield what the search for a cause finds, of each link that states an inertia.

    Parameters
    ----------
    lines : mapping of str to int
        Where each link states it.
    advice : str
        Ends each sentence.
    """
    for name, statement in known.statements.items():
        found = known.explained(name, statement.mass, fixed=False)
        cause = found.suggestions[0].cause if found.suggestions else ""
        sentence = found.doubt
        if not statement.consistent and cause not in ("", NEAREST):
            sentence = f"probably {cause}"
        if sentence:
            where = f"link {name!r}: {sentence}{advice}"
            yield LintFinding(lines.get(name, 1), "probable-mistake", "warning", where)
