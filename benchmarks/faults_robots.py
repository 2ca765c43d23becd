"""Five robots for `faults.py`, known to the last parameter, that no threshold knows.

Their torque has what default models lack: friction that falls with speed near
standstill (Stribeck), friction that grows with the transmitted load, rotor inertias.
The URDF that a user gets has the true masses, and centres of mass and inertias that are
a designer's: near, and not right.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import consistent_id as ci

RATE = 100.0  # Hz
DURATION = 24.0  # s
QUANTUM = 2 * np.pi / 2**18  # rad or m, of the encoders
DRIVE = ci.DriveTerms(
    viscous=True,
    coulomb="tanh",
    velocity_scale=0.01,
    offset=True,
    rotor_inertia=True,
    stribeck_velocity=0.08,
    load_friction=True,
)


@dataclass(frozen=True)
class Part:
    """A moving link and the joint that moves it, as a URDF states them."""

    name: str
    parent: str
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    kind: str = "revolute"
    reach: float = 2.0  # rad or m, to either side
    speed: float = 3.0  # rad/s or m/s
    effort: float = 200.0  # N m or N
    mass: float = 1.0
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    size: tuple[float, float, float] = (0.1, 0.1, 0.1)  # m, of a box of that mass

    @property
    def inertia(self) -> np.ndarray:
        """Central inertia of the box, shape (3, 3), [kg m^2]."""
        x, y, z = np.square(self.size)
        return self.mass / 12.0 * np.diag([y + z, x + z, x + y])


@dataclass(frozen=True)
class Robot:
    """A robot as it is, by its parts."""

    name: str
    parts: tuple[Part, ...]

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints: those of the parts, with ``_joint``."""
        return tuple(f"{part.name}_joint" for part in self.parts)


def robots() -> dict[str, Robot]:
    """Return the five robots by name."""
    found = (
        arm("two_links", [("y", 0.4, 6.0), ("y", 0.35, 3.0)]),
        arm("rx60_like", [("z", 0.24, 15.0), ("y", 0.29, 8.6), ("y", 0.31, 3.6)]),
        arm(
            "ur10_like",
            [
                ("z", 0.13, 7.8),
                ("y", 0.61, 12.9),
                ("y", 0.57, 3.9),
                ("y", 0.16, 2.0),
                ("z", 0.12, 2.0),
                ("y", 0.09, 0.4),
            ],
        ),
        arm(
            "seven_joints",
            [
                ("z", 0.33, 4.5),
                ("y", 0.10, 4.2),
                ("z", 0.30, 3.2),
                ("y", 0.10, 3.3),
                ("z", 0.30, 2.6),
                ("y", 0.09, 1.7),
                ("z", 0.10, 1.0),
            ],
        ),
        _tree(),
    )
    return {robot.name: robot for robot in found}


def arm(name: str, table: Sequence[tuple[str, float, float]]) -> Robot:
    """Return a chain that stands up: an axis, a length [m] and a mass [kg] per link."""
    axes = {"y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    parts, below = [], 0.1
    for i, (axis, length, mass) in enumerate(table):
        width = 0.05 + 0.01 * mass
        parts.append(
            Part(
                f"link{i + 1}",
                "base" if i == 0 else f"link{i}",
                (0.02 * (i % 2), 0.0, below),
                axis=axes[axis],
                mass=mass,
                com=(0.02, -0.015, 0.45 * length),
                size=(width, 0.8 * width, length),
                effort=15.0 * sum(m for *_, m in table[i:]),
            )
        )
        below = length
    return Robot(name, tuple(parts))


def _tree() -> Robot:
    """Return a trunk that slides up, with two arms of two joints each."""
    trunk = Part(
        "trunk",
        "base",
        (0.0, 0.0, 0.4),
        kind="prismatic",
        reach=0.25,
        speed=0.6,
        effort=2000.0,
        mass=12.0,
        com=(0.02, 0.0, 0.2),
        size=(0.2, 0.25, 0.5),
    )
    parts = [trunk]
    for side, y in (("left", 0.2), ("right", -0.2)):
        upper = Part(
            f"{side}_upper",
            "trunk",
            (0.0, y, 0.35),
            axis=(0.0, 1.0, 0.0),
            mass=3.0,
            com=(0.15, 0.01, 0.02),
            size=(0.35, 0.07, 0.06),
            effort=150.0,
        )
        fore = Part(
            f"{side}_fore",
            upper.name,
            (0.33, 0.0, 0.0),
            rpy=(0.5, 0.0, 0.0),
            axis=(0.0, 0.0, 1.0),
            mass=1.6,
            com=(0.12, -0.01, 0.01),
            size=(0.3, 0.05, 0.05),
            effort=80.0,
        )
        parts += [upper, fore]
    return Robot("tree", tuple(parts))


def as_drawn(robot: Robot, rng: np.random.Generator) -> Robot:
    """Return the robot as its designer drew it: masses right, the rest near."""
    return replace(
        robot,
        parts=tuple(
            replace(
                part,
                com=tuple(np.multiply(part.com, rng.uniform(0.9, 1.1, 3)).tolist()),
                size=tuple(np.multiply(part.size, rng.uniform(0.85, 1.15, 3)).tolist()),
            )
            for part in robot.parts
        ),
    )


def urdf(robot: Robot, *, length: float = 1.0, gram: float = 1.0) -> str:
    """Return the robot as URDF; lengths and masses in other units on request.

    Parameters
    ----------
    robot : Robot
    length, gram : float
        By which the file's lengths and masses are multiplied: 1000 for mm or g.
    """
    lines = [f'<robot name="{robot.name}">', '  <link name="base"/>']
    for part, joint in zip(robot.parts, robot.joints, strict=True):
        i = (part.inertia * gram * length**2).tolist()
        scale = length if part.kind == "prismatic" else 1.0
        lines += [
            f'  <joint name="{joint}" type="{part.kind}">',
            f'    <parent link="{part.parent}"/><child link="{part.name}"/>',
            f'    <origin xyz="{_text(part.xyz, length)}" rpy="{_text(part.rpy)}"/>',
            f'    <axis xyz="{_text(part.axis)}"/>',
            f'    <limit lower="{-part.reach * scale}" upper="{part.reach * scale}"'
            f' velocity="{part.speed * scale}" effort="{part.effort}"/>',
            "  </joint>",
            f'  <link name="{part.name}"><inertial>',
            f'    <origin xyz="{_text(part.com, length)}"/>',
            f'    <mass value="{part.mass * gram!r}"/>',
            f'    <inertia ixx="{i[0][0]!r}" iyy="{i[1][1]!r}" izz="{i[2][2]!r}"'
            ' ixy="0" ixz="0" iyz="0"/>',
            "  </inertial></link>",
        ]
    return "\n".join([*lines, "</robot>", ""])


def _text(values: Sequence[float], scale: float = 1.0) -> str:
    return " ".join(repr(float(scale * v)) for v in values)


@dataclass(frozen=True)
class Motion:
    """Sums of sinusoids of frequencies that share no period, per joint."""

    frequency: np.ndarray  # (joints, terms) [Hz]
    amplitude: np.ndarray
    phase: np.ndarray
    middle: np.ndarray  # (joints,)

    def at(self, joints: tuple[str, ...], time: np.ndarray) -> ci.Recording:
        """Return positions and their derivatives."""
        return ci.Recording(joints, time, *self.states(time))

    def states(self, time: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return position, velocity and acceleration, each (samples, joints)."""
        omega = 2 * np.pi * self.frequency[..., None]
        angle = omega * time + self.phase[..., None]
        a = self.amplitude[..., None]
        q = self.middle[:, None] + (a * np.sin(angle)).sum(axis=1)
        dq = (a * omega * np.cos(angle)).sum(axis=1)
        ddq = -(a * omega**2 * np.sin(angle)).sum(axis=1)
        return q.T, dq.T, ddq.T


def random_motion(robot: Robot, rng: np.random.Generator) -> Motion:
    """Return a motion within 60 % of each joint's reach and speed."""
    shape = (len(robot.parts), 5)
    frequency = rng.uniform(0.05, 0.7, shape)
    amplitude = rng.uniform(0.3, 1.0, shape) / (0.2 + frequency)
    for j, part in enumerate(robot.parts):
        fast = 2 * np.pi * frequency[j] @ amplitude[j] / part.speed
        amplitude[j] *= 0.6 / max(amplitude[j].sum() / part.reach, fast)
    middle = np.array([0.15 * part.reach * rng.uniform(-1, 1) for part in robot.parts])
    return Motion(frequency, amplitude, rng.uniform(0, 2 * np.pi, shape), middle)


def loaded(text: str) -> ci.RobotModel:
    """Return the robot of a URDF's text."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.urdf"
        file.write_text(text)
        return ci.robot.load_urdf(file)


def times(duration: float = DURATION) -> np.ndarray:
    """Return the stamps of a log [s]."""
    return np.arange(round(RATE * duration)) / RATE
