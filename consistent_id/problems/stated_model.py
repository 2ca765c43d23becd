"""The robot and its torque model, as a problem file describes them.

The robot's file also draws shapes of links and states nominal drives.
"""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from consistent_id.errors import ConsistentIdError, ProblemError
from consistent_id.problems.file import (
    CouplingTable,
    DHTable,
    DriveTable,
    JointTable,
    LinkTable,
    ModelTable,
    ProblemTable,
)
from consistent_id.problems.parameter_tables import ConstraintsTable
from consistent_id.problems.paths import as_named, expanded, require_there
from consistent_id.problems.problem import Problem
from consistent_id.problems.statement import Statement
from consistent_id.problems.task_tables import ExcitationTable, SceneTable
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.drive.gear_coupling import GearCoupling
from consistent_id.regression.loads import unloaded_joints
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.wrench_sensor import tool_model
from consistent_id.robot.chains import Selection, selected
from consistent_id.robot.loaders.robot_file import is_mjcf
from consistent_id.robot.loaders.xml import Element
from consistent_id.robot.model import (
    STANDARD_GRAVITY,
    Datasheet,
    JointLimits,
    RobotModel,
)
from consistent_id.robot.parameters import did_you_mean
from consistent_id.robot.solids import DrawnDrive, DrawnParts

if TYPE_CHECKING:
    from consistent_id.motion.collisions.bodies import Body
    from consistent_id.robot.loaders.dh import DHRow
    from consistent_id.robot.loaders.mjcf_spec import CompiledFile

_LIMBS = 2  # an arm is one limb; what stands, walks or flies has several
_JOINTS = 3  # of a limb: fingers and wheels have fewer


def drawn_parts(problem: Problem) -> DrawnParts:
    """Return shapes and drives of the robot's file; a fault if it cannot be read.

    The robot itself needs neither shapes nor nominal drives; they are evidence.
    """
    model, scene = problem.table.model, problem.table.excitation.scene
    packages = [] if scene is None else [problem.file(p) for p in scene.packages]
    try:
        if model.urdf is not None:
            return _of_urdf(problem.file(model.urdf), problem.model.robot, packages)
        if model.mjcf is not None:
            return _of_mjcf(problem.file(model.mjcf), problem.model.robot)
    except ConsistentIdError as cause:
        return DrawnParts(fault=str(cause))
    return DrawnParts()


def drawn_drives(problem: Problem) -> dict[str, DrawnDrive]:
    """Return the drives that the robot's file states, of joints by name.

    Raises
    ------
    ModelError
        If the file cannot be read.
    """
    from consistent_id.motion.collisions.urdf_bodies import urdf_root

    model = problem.table.model
    if model.urdf is not None:
        return _urdf_drives(urdf_root(problem.file(model.urdf)))
    if model.mjcf is not None:
        compiled = _compiled(problem.file(model.mjcf)).model
        return _mjcf_drives(compiled, problem.moving)
    return {}


def _of_urdf(file: Path, robot: RobotModel, packages: list[Path]) -> DrawnParts:
    from consistent_id.motion.collisions.urdf_bodies import urdf_shapes

    shapes = urdf_shapes(file, packages)
    unread = {link.name for link in shapes.unread} | {name for name, _ in shapes.bare}
    reach = dict(_reaches(robot, shapes.bodies, unread))
    return DrawnParts(reach, _urdf_drives(shapes.root))


def _urdf_drives(root: Element) -> dict[str, DrawnDrive]:
    drives = {}
    for joint in root.all("joint"):
        stated = joint.child("dynamics")
        if stated is not None:
            drives[joint.name] = DrawnDrive(
                _number(stated, "damping"), _number(stated, "friction")
            )
    return drives


def _number(element: Element, name: str) -> float:
    """Return a value that is not negative; zero for none, or if it is no number."""
    try:
        value = float(element.attributes.get(name, "0"))
    except ValueError:
        return 0.0
    return value if 0.0 <= value < np.inf else 0.0


def _reaches(
    robot: RobotModel, bodies: "tuple[Body, ...]", unread: set[str]
) -> Iterator[tuple[str, float]]:
    """Yield links and their farthest points, those of merged links included."""
    for link in robot.links:
        places = {link.name: (np.eye(3), np.zeros(3))}
        places |= {f.name: (f.rotation, f.translation) for f in link.merged}
        if unread & set(places):
            continue
        reach = [
            float(np.linalg.norm(R @ _middle(body) + t)) + body.shape.ball[1]
            for body in bodies
            if body.frame in places
            for R, t in (places[body.frame],)
        ]
        if reach and np.isfinite(max(reach)):
            yield link.name, max(reach)


def _middle(body: "Body") -> Any:
    turn = np.eye(3) if body.rotation is None else np.asarray(body.rotation)
    origin = np.zeros(3) if body.translation is None else np.asarray(body.translation)
    return turn @ np.asarray(body.shape.ball[0]) + origin


def _of_mjcf(file: Path, robot: RobotModel) -> DrawnParts:
    """Return shapes of bodies without merged links, and the joints' drives.

    Shapes that do not contain the body's own mass do not show the whole body.
    """
    _, compiled, blind = _compiled(file)
    reach = {}
    names = {compiled.body(b).name: b for b in range(compiled.nbody)}
    for link in robot.links:
        if link.merged or link.name in blind or link.name not in names:
            continue
        b = names[link.name]
        first = int(compiled.body_jntadr[b])
        origin = compiled.jnt_pos[first] if first >= 0 else np.zeros(3)
        far = [
            float(np.linalg.norm(compiled.geom_pos[g] - origin))
            + float(compiled.geom_rbound[g])
            for g in range(compiled.ngeom)
            if compiled.geom_bodyid[g] == b
        ]
        mass, extent = float(compiled.body_mass[b]), 0.0
        if mass > 0.0:
            spread = float(compiled.body_inertia[b].sum()) / (2.0 * mass)
            centre = float(np.linalg.norm(compiled.body_ipos[b] - origin))
            extent = centre + np.sqrt(spread)
        if far and extent <= max(far) < np.inf:
            reach[link.name] = max(far)
    return DrawnParts(reach, _mjcf_drives(compiled, robot))


def _compiled(file: Path) -> "CompiledFile":
    """Return MuJoCo's model of a file."""
    from consistent_id.export.mjcf_bodies import require_mujoco
    from consistent_id.robot.loaders.mjcf_spec import compiled_file

    return compiled_file(file, require_mujoco())


def _mjcf_drives(compiled: Any, robot: RobotModel) -> dict[str, DrawnDrive]:
    joints = {compiled.joint(j).name: j for j in range(compiled.njnt)}
    drives = {}
    for joint in robot.joint_names:
        if joint in joints:
            k = int(compiled.jnt_dofadr[joints[joint]])
            drives[joint] = DrawnDrive(
                float(compiled.dof_damping[k]),
                float(compiled.dof_frictionloss[k]),
                float(compiled.dof_armature[k]),
            )
    return drives


DEFAULT_DRIVE = DriveTable(
    viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True
)
"""Default drive terms of a robot; the scale in rad/s or m/s."""


def torque_model(table: ProblemTable, file: Path) -> TorqueModel:
    """Return the robot of a problem file, with its datasheet and drive terms.

    Raises
    ------
    ProblemError
        If a named joint does not exist.
    ModelError
        If the robot cannot be built.
    """
    robot = robot_of(table, file.parent)
    if table.wrist_sensor is None:  # else the datasheet is that of the tool behind it
        robot = described(robot, table)
    for name in table.joints:
        if name not in robot.joint_names:
            near = did_you_mean(name, robot.joint_names)
            raise ProblemError(f"{file}: [joints.{name}]: no such joint; {near}")
    return drive_of(table, robot)


def model_table(
    model: Path,
    folder: Path,
    stated: Statement,
    *,
    locked: Mapping[str, float] | None = None,
) -> ModelTable:
    """Return the table that names a robot's file, for a problem file in a folder.

    Parameters
    ----------
    locked : mapping of str to float, optional
        Locked joints; by default the stated ones.
    """
    mjcf, path = is_mjcf(model), as_named(model, folder)
    gravity = stated.gravity
    return ModelTable(
        urdf=None if mjcf else path,
        mjcf=path if mjcf else None,
        base=stated.base,
        tip=stated.tip,
        locked=dict((stated.locked if locked is None else locked) or {}),
        gravity=None if gravity is None else (gravity[0], gravity[1], gravity[2]),
    )


def excitation_table(
    stated: Statement, folder: Path, table: ExcitationTable | None = None
) -> ExcitationTable:
    """Return a table with the stated folders of packages."""
    table = ExcitationTable() if table is None else table
    if not stated.package_dirs:
        return table
    packages = [as_named(Path(package), folder) for package in stated.package_dirs]
    scene = msgspec.structs.replace(table.scene or SceneTable(), packages=packages)
    return msgspec.structs.replace(table, scene=scene)


def described(robot: RobotModel, table: ProblemTable) -> RobotModel:
    """Return a robot whose datasheet is completed by that of a problem file.

    If a link carries a load, both are one body without a datasheet.
    """
    sheets = {name: _datasheet(robot, name, link) for name, link in table.links.items()}
    if table.payload is not None:
        sheets[table.payload.link] = Datasheet()
    return robot.with_datasheet(sheets)


def drive_of(table: ProblemTable, robot: RobotModel) -> TorqueModel:
    """Return the torque model of a robot with a problem file's drive terms."""
    drive = _drive(table, robot)
    couplings = tuple(coupling_of(coupling) for coupling in table.couplings)
    measured = () if table.data is None else tuple(table.data.torque_joints)
    return TorqueModel(robot, drive, couplings, measured)


def behind_sensor(table: ProblemTable, model: TorqueModel) -> TorqueModel:
    """Return the model of the tool behind a robot's wrench sensor, if requested.

    Raises
    ------
    ProblemError
        If the sensor has no columns, or a drift without a bias.
    """
    sensor = table.wrist_sensor
    if sensor is None:
        return model
    wrenches = [] if table.data is None else table.data.wrenches
    if table.data is not None and sensor.frame not in {w.frame for w in wrenches}:
        raise ProblemError(
            f"[wrist_sensor] is at {sensor.frame!r}, but no [[data.wrenches]] names "
            f'its columns; add one with frame = "{sensor.frame}"'
        )
    if sensor.drift != "none" and not sensor.bias:
        raise ProblemError(
            f"[wrist_sensor] bias = false says that the sensor has none, drift = "
            f'"{sensor.drift}" that each recording has its own; leave one of them out'
        )
    one = sensor.bias and sensor.drift == "none"  # else each recording has its own
    tool = tool_model(sensor.tool, bias=one, gravity=model.robot.gravity)
    return replace(tool, robot=described(tool.robot, table))


def assumed(table: ProblemTable, model: TorqueModel) -> ConstraintsTable:
    """Return the constraints of a file; a tool without a datasheet has any mass."""
    stated = table.constraints
    known = any(link.datasheet.mass is not None for link in model.robot.links)
    if table.wrist_sensor is None or known or stated.masses != "datasheet":
        return stated
    return msgspec.structs.replace(stated, masses="free")


def _drive(table: ProblemTable, robot: RobotModel) -> tuple[DriveTerms, ...]:
    """Return the terms of each joint.

    A joint without a measured torque has no terms.  A joint that carries nothing has no
    load friction, unless its own table has it.
    """
    measured = () if table.data is None else table.data.torque_joints
    idle = unloaded_joints(robot) if table.drive.load_friction else ()
    found = []
    for name in robot.joint_names:
        own = table.joints.get(name, JointTable())
        if name in idle and "load_friction" not in own.stated:
            own = msgspec.structs.replace(own, load_friction=False)
        silent = bool(measured) and name not in measured
        found.append(DriveTerms() if silent else own.over(table.drive).terms)
    return tuple(found)


def robot_of(table: ProblemTable, folder: Path) -> RobotModel:
    """Return the robot that a problem file names or describes, without its datasheet.

    Raises
    ------
    ProblemError
        If it names none, or several.
    ModelError
        If the robot cannot be built.
    """
    model = table.model
    forms = ("urdf", "mjcf", "modified_dh", "classical_dh")
    given = [form for form in forms if getattr(model, form)]
    if len(given) != 1:
        seen = f"has {' and '.join(given)}" if given else "has none"
        raise ProblemError(
            f"problem {table.name!r}: [model] needs one of {', '.join(forms)}, {seen}"
        )
    selection = Selection(model.base, model.tip, model.joints, model.locked)
    gravity = STANDARD_GRAVITY if model.gravity is None else model.gravity
    if model.urdf is not None:
        file = require_there(folder / expanded(model.urdf, table), table)
        from consistent_id.robot.loaders.urdf import load_urdf

        return load_urdf(file, gravity=gravity, **asdict(selection))
    if model.mjcf is not None:
        file = require_there(folder / expanded(model.mjcf, table), table)
        from consistent_id.robot.loaders.mjcf import load_mjcf

        return load_mjcf(file, gravity=model.gravity, **asdict(selection))
    from consistent_id.robot.loaders.dh import from_classical_dh, from_modified_dh

    rows = [_dh_row(row) for row in model.modified_dh or model.classical_dh]
    build = from_modified_dh if model.modified_dh else from_classical_dh
    return selected(build(table.name, rows, gravity=gravity), selection)


def _dh_row(row: DHTable) -> "DHRow":
    from consistent_id.robot.loaders.dh import DHRow

    limits = JointLimits(
        -np.inf if row.lower is None else row.lower,
        np.inf if row.upper is None else row.upper,
        row.velocity or np.inf,
        row.effort or np.inf,
    )
    alpha, theta = np.radians(row.alpha_deg), np.radians(row.theta_deg)
    return DHRow(float(alpha), row.a, row.d, float(theta), row.kind, limits)


def _datasheet(robot: RobotModel, name: str, table: LinkTable) -> Datasheet:
    """Datasheet of the model, with values replaced by those of the file."""
    known = {link.name: link.datasheet for link in robot.links}.get(name, Datasheet())
    return datasheet_of(table, known)


def datasheet_of(table: LinkTable, known: Datasheet = Datasheet()) -> Datasheet:  # noqa: B008  frozen
    """Return the datasheet of a body, updated by the values of a table."""
    bounds = table.mass_bounds
    return Datasheet(
        mass=known.mass if table.mass is None else table.mass,
        mass_bounds=known.mass_bounds if bounds is None else (bounds[0], bounds[1]),
        com=known.com if table.com is None else np.array(table.com),
        com_box=known.com_box if table.com_box is None else np.array(table.com_box),
    )


def coupling_of(table: CouplingTable) -> GearCoupling:
    """Return the coupling that a table states."""
    return GearCoupling(**msgspec.structs.asdict(table))


def base_question(robot: RobotModel) -> tuple[str, ...]:
    """Return a question to the user if a fixed base is doubtful, else nothing.

    This is so if several chains of at least three joints hang on the fixed root: legs
    of a robot that walks, or arms of one that stands on a pillar.
    """
    if robot.floating:
        return ()
    length = [1] * len(robot.joints)
    for k in range(len(robot.joints) - 1, -1, -1):
        parent = robot.joints[k].parent
        if parent >= 0:
            length[parent] = max(length[parent], length[k] + 1)
    limbs = [
        joint.name
        for joint, joints in zip(robot.joints, length, strict=True)
        if joint.parent < 0 and joints >= _JOINTS
    ]
    if len(limbs) < _LIMBS:
        return ()
    return (
        f"the base is assumed to be fixed, though it has {len(limbs)} limbs "
        f"(beginning with {', '.join(limbs)}); if it moves, or stands on them, set "
        f"base = 'floating'",
    )
