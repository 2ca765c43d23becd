"""What designs among bodies reach: five robots with their own meshes, each in a scene.

``python benchmarks/excitation_scene.py [ROBOT ...] [--write docs/collisions.md]``:
20 mm apart, 90 % of the limits, 10 s, five harmonics, one process; with the scene and
without it.  The table takes the place of the page's.
"""

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from excitation_cases import EXAMPLES

import consistent_id as ci
from consistent_id.motion.collisions.scene import Scene
from consistent_id.motion.collisions.scene_building import scene_from_urdf

WORK = 14.0  # units; about as many seconds of an idle processor
CLEARANCE = 0.02  # m
BEGIN, END = "<!-- designs among bodies -->\n", "<!-- end of the table -->\n"
HEAD = """| robot | scene | objective | condition, free | in scene | errors \
| proven [mm] | CPU [s] |
|---|---|---|---:|---:|---:|---:|---:|
"""


@dataclass(frozen=True)
class Cell:
    """A robot, and what stands around it.

    Parameters
    ----------
    urdf, tip : str
    around : str
        In words.
    bodies : tuple of Body
    standing : tuple of str
        Links that may touch the floor, which the robot stands on.
    """

    urdf: str
    tip: str
    around: str
    bodies: tuple[ci.motion.Body, ...]
    standing: tuple[str, ...]


def wall(x: float) -> ci.motion.Body:
    return ci.motion.Body(
        "wall", ci.motion.Box((0.1, 4.0, 4.0)), None, None, [x, 0.0, 0.0]
    )


def post(x: float, y: float) -> ci.motion.Body:
    return ci.motion.Body(
        "post", ci.motion.Cylinder(0.05, 2.0), None, None, [x, y, 0.0]
    )


CELLS = {
    "Panda": Cell(
        "panda_description/urdf/panda.urdf",
        "panda_link8",
        "floor",
        (),
        ("panda_link0", "panda_link1"),
    ),
    "UR10": Cell(
        "ur_description/urdf/ur10_joint_limited_robot.urdf",
        "tool0",
        "floor, wall behind",
        (wall(-0.8),),
        ("base_link", "shoulder_link"),
    ),
    "UR5": Cell(
        "ur_description/urdf/ur5_joint_limited_robot.urdf",
        "tool0",
        "floor, post",
        (post(0.5, 0.3),),
        ("base_link", "shoulder_link"),
    ),
    "Kinova": Cell(
        "kinova_description/robots/kinova.urdf",
        "j2s6s200_link_6",
        "floor, wall behind",
        (wall(-0.7),),
        ("j2s6s200_link_base", "j2s6s200_link_1"),
    ),
    "Z1": Cell(
        "z1_description/urdf/z1.urdf",
        "link06",
        "floor, post",
        (post(0.4, 0.3),),
        ("link00", "link01"),
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=[], help=", ".join(CELLS))
    parser.add_argument("--write", type=Path, help="page whose table is replaced")
    options = parser.parse_args()
    lines = []
    for name in options.names or CELLS:
        for objective in ("D", "condition"):
            lines.append(measured(name, CELLS[name], objective))
            print(lines[-1], end="", flush=True)
    if options.write is not None:
        text = options.write.read_text(encoding="utf-8")
        before, _, rest = text.partition(BEGIN)
        _, _, after = rest.partition(END)
        table = f"{before}{BEGIN}{HEAD}{''.join(lines)}{END}{after}"
        options.write.write_text(table, encoding="utf-8")


def measured(name: str, cell: Cell, objective: str) -> str:
    """Return the line of a robot in its scene, beside itself without."""
    file = EXAMPLES / cell.urdf
    robot = ci.robot.load_urdf(file, tip=cell.tip)
    scene = scene_from_urdf(
        file,
        robot,
        ground=0.0,
        added=cell.bodies,
        clearance=CLEARANCE,
        allowed=[("ground", link) for link in cell.standing],
    )
    free, _ = designed(robot, objective, None)
    among, seconds = designed(robot, objective, scene)
    errors = np.log(among.accuracy.standard_errors() / free.accuracy.standard_errors())
    apart = among.proof.clearance
    proven = 1e3 * apart.proven if apart is not None else np.nan
    return (
        f"| {name} | {cell.around} | {objective} | {free.condition.value:.3g} "
        f"| {among.condition.value:.3g} | {np.exp(errors.mean()):.2f} | {proven:.1f} "
        f"| {seconds:.1f} |\n"
    )


def designed(
    robot: ci.RobotModel, objective: str, scene: Scene | None
) -> tuple[ci.ExcitationDesign, float]:
    """Return a design and its processor time [s]."""
    began = time.process_time()
    limits = ci.motion_limits(robot, effort=np.inf).within(0.9)
    design = ci.design_trajectory(
        robot,
        ci.PathForm(10.0, 5),
        ci.Aim(objective, refine=None),
        limits=limits,
        scene=scene,
        starts=2,
        workers=1,
        time_limit=WORK,
    )
    return design, time.process_time() - began


if __name__ == "__main__":
    main()
