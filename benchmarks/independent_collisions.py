"""Designed motions among bodies, checked for collisions by code that shares none.

``python benchmarks/independent_collisions.py [ROBOT ...] [--scenes floor wall boxes]
[--work UNITS] [--periodic] [--write PAGE]``: robots of `example-robot-data`, which
comes with Pinocchio, each on a floor, beside a wall and between boxes, 20 mm apart.
Each line has the numbers of samples at 1 kHz, of pairs of bodies and of touches.
Motions begin and end at rest, or are periodic; then their run-in and run-out are
checked, too.

Pinocchio reads the complete robot from its URDF, with all links and joints, and coal
compares the meshes themselves, not hulls.  Joints that follow others are moved as the
file says; joints that a motion does not command stand at positions drawn anew for every
sample, the ends of their ranges among them.
"""

import argparse
import csv
import logging
import time
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
from pages import add_write, shown_on

from consistent_id._support.run import current_run, running

_ALWAYS = 0.95  # share of random poses; meshes that touch in more overlap by design
_POSES = 100
_STATED = 1e3  # rad or m; Pinocchio's limits of joints without any are larger


class Obstacle(NamedTuple):
    """A box in the frame of the robot's base: size and centre, both in m."""

    name: str
    size: tuple[float, float, float]
    centre: tuple[float, float, float]


class Touch(NamedTuple):
    """Two bodies that touch in a motion, at some samples."""

    first: str
    second: str
    samples: int
    first_time: float


class CompleteRobot:
    """All links of a URDF, with obstacles, and the pairs of them to compare.

    Not compared: bodies that no joint of the motion moves against each other; links
    that a joint connects directly, or over links without a shape; meshes that touch in
    95 % of random poses.

    Parameters
    ----------
    path : Path
    moving : iterable of str
        Joints that motions command.
    obstacles : iterable of Obstacle
    locked : mapping of str to float
        Positions of joints that stand still.
    """

    def __init__(
        self,
        path: Path,
        moving: Iterable[str],
        obstacles: Iterable[Obstacle] = (),
        locked: Mapping[str, float] | None = None,
    ) -> None:
        self._locked, self.moving = dict(locked or {}), frozenset(moving)
        folders = [str(folder) for folder in path.resolve().parents]
        self.model = pin.buildModelFromUrdf(str(path))
        self.geometry = pin.buildGeomFromUrdf(
            self.model, str(path), pin.GeometryType.COLLISION, package_dirs=folders
        )
        self._tree = ElementTree.parse(path).getroot()
        self._followers = _followers(self._tree)
        self._boxes = []
        for box in obstacles:
            place = pin.SE3(np.eye(3), np.array(box.centre))
            one = pin.GeometryObject(box.name, 0, 0, place, coal.Box(*box.size))
            self._boxes.append(self.geometry.addGeometryObject(one))
        self._data = self.model.createData()
        for pair in self._pairs():
            self.geometry.addCollisionPair(pin.CollisionPair(*pair))
        self._leave_out_overlaps()

    @property
    def pairs(self) -> int:
        """Number of pairs that are compared."""
        return len(self.geometry.collisionPairs)

    def touches(self, motion: Path, seed: int = 0) -> list[Touch]:
        """Return the bodies that touch in a file of samples.

        Parameters
        ----------
        motion : Path
            CSV with a column ``time`` and columns ``q_JOINT`` of positions.
        """
        with motion.open(newline="") as file:
            rows = list(csv.DictReader(file))
        rng = np.random.default_rng(seed)
        found: dict[tuple[str, str], list[float]] = {}
        data = pin.GeometryData(self.geometry)
        for number, row in enumerate(rows):
            known = {
                column.removeprefix("q_"): float(value)
                for column, value in row.items()
                if column.startswith("q_")
            }
            if not self.moving <= known.keys():
                raise ValueError(f"{motion}: expected the columns q_JOINT of a motion")
            q = self.posture(known, rng, ("lower", "upper", "any")[number % 3])
            for pair in self._colliding(q, data):
                found.setdefault(pair, []).append(float(row["time"]))
        return [Touch(*two, len(at), at[0]) for two, at in sorted(found.items())]

    def posture(
        self, known: Mapping[str, float], rng: np.random.Generator, others: str = "any"
    ) -> np.ndarray:
        """Return a configuration of all joints, the unknown ones as `others` says."""
        model = self.model
        lower = np.where(
            abs(model.lowerPositionLimit) < 1e3, model.lowerPositionLimit, -np.pi
        )
        upper = np.where(
            abs(model.upperPositionLimit) < 1e3, model.upperPositionLimit, np.pi
        )
        values: dict[str, float] = {}
        for k, name in enumerate(model.names):
            if k == 0:
                continue
            i = model.joints[k].idx_q
            span = {"lower": lower[i], "upper": upper[i]}
            drawn = span.get(others, rng.uniform(lower[i], upper[i]))
            values[name] = known.get(name, self._locked.get(name, float(drawn)))
        for name, (leader, ratio, offset) in self._followers.items():
            if name in values and leader in values:
                values[name] = ratio * values[leader] + offset
        q = pin.neutral(model)
        for k, name in enumerate(model.names):
            if k == 0:
                continue
            joint = model.joints[k]
            if joint.nq == 2:  # continuous: cosine and sine
                q[joint.idx_q : joint.idx_q + 2] = (
                    np.cos(values[name]),
                    np.sin(values[name]),
                )
            else:
                q[joint.idx_q] = values[name]
        return q

    def _pairs(self) -> Iterable[tuple[int, int]]:
        objects = list(self.geometry.geometryObjects)
        links = [self._link(one) for one in objects]
        shaped = {link for link in links if link}
        for i in range(len(objects)):
            for j in range(i + 1, len(objects)):
                joints = objects[i].parentJoint, objects[j].parentJoint
                if not self._commanded(*joints):
                    continue
                if (
                    links[i]
                    and links[j]
                    and not self._apart(links[i], links[j], shaped)
                ):
                    continue
                yield i, j

    def _commanded(self, first: int, second: int) -> bool:
        """Return whether the motion moves two bodies against each other."""
        one, other = (set(self.model.supports[k]) - {0} for k in (first, second))
        between = {self.model.names[k] for k in one ^ other}
        leaders = {self._followers[name][0] for name in between & {*self._followers}}
        return bool((between | leaders) & self.moving)

    def _link(self, one: "pin.GeometryObject") -> str:
        if one.name in {self.geometry.geometryObjects[k].name for k in self._boxes}:
            return ""
        return self.model.frames[one.parentFrame].name

    def _apart(self, first: str, second: str, shaped: set[str]) -> bool:
        """Return whether a link with a shape is between two others in the file."""
        parents = {
            joint.find("child").get("link"): joint.find("parent").get("link")
            for joint in self._tree.findall("joint")
        }

        def way(link: str) -> list[str]:
            found = [link]
            while found[-1] in parents:
                found.append(parents[found[-1]])
            return found

        one, other = way(first), way(second)
        meet = next(link for link in one if link in other)
        inner = [*one[: one.index(meet)], meet, *other[: other.index(meet)]]
        return any(link in shaped for link in inner if link not in (first, second))

    def _leave_out_overlaps(self) -> None:
        rng = np.random.default_rng(1)
        data = pin.GeometryData(self.geometry)
        count: dict[tuple[str, str], int] = {}
        for _ in range(_POSES):
            for pair in self._colliding(self.posture({}, rng), data):
                count[pair] = count.get(pair, 0) + 1
        self.overlapping = [p for p, n in count.items() if n > _ALWAYS * _POSES]
        objects = self.geometry.geometryObjects
        kept = [
            pair
            for pair in self.geometry.collisionPairs
            if (objects[pair.first].name, objects[pair.second].name)
            not in self.overlapping
        ]
        self.geometry.removeAllCollisionPairs()
        for pair in kept:
            self.geometry.addCollisionPair(pair)

    def _colliding(
        self, q: np.ndarray, data: "pin.GeometryData"
    ) -> list[tuple[str, str]]:
        pin.computeCollisions(self.model, self._data, self.geometry, data, q, False)
        objects = self.geometry.geometryObjects
        return [
            (objects[pair.first].name, objects[pair.second].name)
            for pair, result in zip(
                self.geometry.collisionPairs, data.collisionResults, strict=True
            )
            if result.isCollision()
        ]


def _followers(root: ElementTree.Element) -> dict[str, tuple[str, float, float]]:
    found = {}
    for joint in root.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            found[joint.get("name")] = (
                mimic.get("joint"),
                float(mimic.get("multiplier", "1")),
                float(mimic.get("offset", "0")),
            )
    return found


ROBOTS: dict[str, tuple[str, str | None]] = {
    "Panda": ("panda_description/urdf/panda.urdf", None),
    "Panda to link8": ("panda_description/urdf/panda.urdf", "panda_link8"),
    "UR3": ("ur_description/urdf/ur3_joint_limited_robot.urdf", None),
    "UR5": ("ur_description/urdf/ur5_joint_limited_robot.urdf", None),
    "UR10": ("ur_description/urdf/ur10_joint_limited_robot.urdf", None),
    "UR5 and gripper": ("ur_description/urdf/ur5_gripper.urdf", "wrist_3_link"),
    "Kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_link_6"),
    "Z1": ("z1_description/urdf/z1.urdf", None),
    "xArm7": ("xarm_description/urdf/xarm7.urdf", None),
    "SO-101": ("so_arm_description/urdf/so101.urdf", None),
    "Talos' arm": ("talos_data/robots/talos_left_arm.urdf", "arm_left_7_link"),
    "TIAGo": ("tiago_description/robots/tiago_no_hand.urdf", "arm_7_link"),
}
"""File and tip; joints behind a tip are not commanded."""

FLOOR = Obstacle("floor", (6.0, 6.0, 0.5), (0.0, 0.0, -0.25 - 0.03))


def around(scene: str, reach: float) -> list[Obstacle]:
    """Return the obstacles of a scene for a robot of some reach [m]."""
    near, high = 0.55 * reach, 0.4 * reach
    side = 0.3 * reach
    if scene == "wall":
        wall = Obstacle("wall", (0.1, 6.0, 6.0), (-0.5 * reach - 0.05, 0.0, 0.0))
        return [FLOOR, wall]
    if scene == "boxes":
        sizes = (side, side, side)
        return [
            FLOOR,
            Obstacle("box1", sizes, (near + side / 2.0, near, high / 2.0)),
            Obstacle("box2", sizes, (near, -near - side / 2.0, 1.5 * high)),
        ]
    return [FLOOR]


def problem_text(
    file: Path, tip: str | None, obstacles: Iterable[Obstacle], *, rest: bool = True
) -> str:
    """Return a problem file that designs a motion among obstacles."""
    bodies = "\n".join(
        f"[[excitation.scene.bodies]]\nname = {box.name!r}\n"
        f"position = {list(box.centre)}\nbox = {{ size = {list(box.size)} }}"
        for box in obstacles
    )
    end = "" if tip is None else f"tip = {tip!r}\n"
    return (
        f"name = 'case'\n[model]\nurdf = '{file}'\n{end}[drive]\nviscous = true\n"
        "coulomb = 'tanh'\nvelocity_scale = 0.02\n[constraints]\nmasses = 'free'\n"
        f"[excitation]\nharmonics = 4\nrest = {str(rest).lower()}\n"
        "[excitation.limits]\nvelocity = 1.5\n"
        f"acceleration = 6.0\n[excitation.scene]\n{bodies}\n"
    )


def measured(name: str, scene: str, work: float, *, rest: bool) -> str:
    """Design motions of a robot in a scene; return a line with their touches."""
    from consistent_id.excitation.playable import playable_design
    from consistent_id.excitation.sources import problem_to_excite
    from consistent_id.motion import write_trajectory
    from consistent_id.robot.kinematics import reach

    part, tip = ROBOTS[name]
    file = Path(pin.__file__).parents[4] / "share/example-robot-data/robots" / part
    began = time.process_time()
    with TemporaryDirectory() as folder:
        problem_file = Path(folder) / "problem.toml"
        problem_file.write_text(problem_text(file, tip, (), rest=rest))
        robot = problem_to_excite(problem_file, {}).moving
        last = robot.link_names[-1]
        boxes = around(scene, reach(robot, last, (0.0, 0.0, 0.1)))
        problem_file.write_text(problem_text(file, tip, boxes, rest=rest))
        problem = problem_to_excite(problem_file, {})
        try:
            playable = playable_design(problem, starts=1, workers=1, time_limit=work)
        except Exception as cause:  # a benchmark goes on with the next case
            return f"| {name} | {scene} | no design: {type(cause).__name__}: {cause} |"
        designed = time.process_time() - began
        complete = CompleteRobot(file, robot.joint_names, boxes)
        samples, touches = 0, []
        for motion, move in playable.moves.items():
            table = Path(folder) / f"{motion}.csv"
            write_trajectory(move, table, rate=1000.0)
            samples += len(table.read_text().splitlines()) - 1
            touches += [(motion, *touch) for touch in complete.touches(table)]
    kept = playable.design.demands.scene
    unchecked = 0 if kept is None else len(kept.unchecked)
    return (
        f"| {name} | {scene} | {', '.join(playable.moves)} | {samples} | "
        f"{complete.pairs} | {len(complete.overlapping)} | {unchecked} | "
        f"{len(touches)} | {designed:.0f} |"
        + "".join(f"\n    {touch}" for touch in touches)
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="*", default=list(ROBOTS))
    scenes = ["floor", "wall", "boxes"]
    parser.add_argument("--scenes", nargs="+", default=scenes, choices=scenes)
    parser.add_argument("--work", type=float, default=3.0)
    parser.add_argument("--periodic", action="store_true")
    add_write(parser)
    asked = parser.parse_args()
    logging.disable(logging.WARNING)
    with running(replace(current_run(), trust=True)), shown_on(asked.write):
        report(asked.robots, asked.scenes, asked.work, rest=not asked.periodic)


def report(
    robots: Iterable[str], scenes: Iterable[str], work: float, *, rest: bool
) -> None:
    """Print the table, a line as soon as it is known."""
    print(
        "| robot | scene | motions | samples | pairs | overlapping | unchecked "
        "| touches | CPU [s] |\n|---|---|---|---:|---:|---:|---:|---:|---:|"
    )
    for name in robots:
        for scene in scenes:
            print(measured(name, scene, work, rest=rest), flush=True)


if __name__ == "__main__":
    main()
