"""A load as the controllers of arms take it: one function for each vendor's form.

=========  =========================  ===========================  ====================
vendor     centre of mass             inertia                      frame
=========  =========================  ===========================  ====================
UR         m                          about the centre of mass     tool flange
Franka     m                          about the centre of mass     flange
KUKA       mm                         principal, ``A, B, C``       flange
ABB        mm                         principal, quaternion        tool (payload)
URDF       m                          about the centre of mass     parent link
MJCF       m                          about the centre of mass     parent body
=========  =========================  ===========================  ====================

Where the inertia is open, the load is sent as a point mass: the data do not support
another value.
"""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.tables import brief
from consistent_id.errors import ModelError, ProblemError
from consistent_id.export.export_formats import comment_text
from consistent_id.robot.inertia import InertialParameters, principal_inertia
from consistent_id.robot.model import FixedFrame
from consistent_id.robot.parameters import did_you_mean

_DIGITS = ".9g"
_TRIANGLE = 1e-7  # of it, by which the others' sum exceeds it: more than digits lose
_MARK = "consistent-id: load of {name} in the frame {frame}, {state}"
_LONGEST = 32  # characters of a name, as in RAPID

RAPID_WORDS = frozenset(
    """
    alias and backward case connect const default div do else elseif endfor endfunc
    endif endmodule endproc endrecord endtest endtrap endwhile error exit false for from
    func goto if inout local mod module nostepin not noview or pers proc raise readonly
    record retry return step sysmodule task test then to trap true trynext undo var
    viewonly while with xor
    load load0 loaddata loadsession gripload mechunitload tool0 tooldata unload wobj0
    wobjdata
    """.split()
)
"""Reserved words of RAPID, and its own names that a load might be given."""


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ControllerLoad:
    """A load to send to a controller.

    Parameters
    ----------
    name : str
        Name of the load; letters, digits and underscores.
    body : InertialParameters
        Physically consistent, in the frame of the flange.
    flange : FixedFrame
        Its place in the moving link that carries it, by which `link` is named.
    link : str
        That moving link.
    tool : FixedFrame
        Place of the tool's frame in that of the flange.
    inertia_open : bool
        Whether the load is sent as a point mass.
    evidence : str
        Verdict and interval of the mass, for the files' marks.

    Raises
    ------
    ModelError
        If the name is not a letter followed by at most 31 letters, digits and
        underscores, or if the body has no mass or is not physically consistent.
    """

    name: str
    body: InertialParameters
    flange: FixedFrame
    link: str
    tool: FixedFrame
    inertia_open: bool = False
    evidence: str = ""

    def __post_init__(self) -> None:
        require_load_name(self.name)
        if not (self.body.mass > 0.0 and self.body.is_consistent(1e-9)):
            raise ModelError(
                f"load {self.name!r}: mass {self.body.mass:.4g} kg, consistent: "
                f"{self.body.is_consistent(1e-9)}; expected a positive mass and a "
                "physically consistent body, as identify_payload estimates"
            )

    @property
    def inertia(self) -> Matrix:
        """Inertia about the centre of mass in the flange's axes, [kg m^2]."""
        return np.zeros((3, 3)) if self.inertia_open else self.body.central_inertia

    @property
    def in_tool(self) -> InertialParameters:
        """The body in the frame of the tool."""
        rotation = self.tool.rotation.T
        return self.body.transformed(rotation, -rotation @ self.tool.translation)

    @property
    def mark(self) -> str:
        """The words by which a file is known as this tool's."""
        state = "a point mass" if self.inertia_open else "inertia about its centre"
        mark = _MARK.format(name=self.name, frame=self.flange.name, state=state)
        return " ".join("; ".join(filter(None, (mark, self.evidence))).split())


def require_load_name(name: str) -> None:
    """Refuse a name of a load that a controller's file cannot contain.

    Raises
    ------
    ModelError
        If it is not a letter followed by at most 31 letters, digits and underscores.
    """
    if not re.fullmatch(rf"[A-Za-z][A-Za-z0-9_]{{0,{_LONGEST - 1}}}", name):
        raise ModelError(
            f"name of the load is {name!r}; expected a letter, then at most "
            f"{_LONGEST - 1} letters, digits and underscores, such as box_2"
        )


def ur_script(load: ControllerLoad) -> str:
    """Return ``set_target_payload(m, cog, inertia)`` of URScript.

    ``inertia`` is ``[Ixx, Iyy, Izz, Ixy, Ixz, Iyz]`` [kg m^2], with its origin in the
    centre of gravity and the axes of the tool flange; ``cog`` is the offset from the
    tool mount [m].  Source: [URScript]_, ``set_target_payload``.
    """
    com, entries = _list(load.body.com), _list(_six(load.inertia))
    return (
        f"# {load.mark}\n"
        f"set_target_payload({_text(load.body.mass)}, {com}, {entries})\n"
    )


def ros2_call(load: ControllerLoad) -> str:
    """Return a shell script that calls the ROS 2 service ``ur_msgs/srv/SetPayload``.

    The service of ``ur_robot_driver`` has three forms: ``payload``, a
    ``geometry_msgs/Inertia``; ``mass``, ``center_of_gravity`` and ``ixx, iyy, izz, ixy,
    ixz, iyz``, as in URScript; and the first two of these alone.  The script asks
    ``ros2 interface show`` which one there is.  Source: [UrMsgs]_.
    """
    mass = _text(load.body.mass)
    place = "{{x: {}, y: {}, z: {}}}".format(*map(_text, load.body.com))
    entries = ", ".join(
        f"{n}: {_text(v)}" for n, v in zip(_SIX, _six(load.inertia), strict=True)
    )
    older = f"mass: {mass}, center_of_gravity: {place}"
    return (
        f"#!/bin/sh\n# {load.mark}\nset -e\n"
        "form=$(ros2 interface show ur_msgs/srv/SetPayload)\n"
        'case "$form" in\n'
        f'*Inertia*) load="{{payload: {{m: {mass}, com: {place}, {entries}}}}}" ;;\n'
        f'*ixx*) load="{{{older}, {entries}}}" ;;\n'
        f'*) load="{{{older}}}" ;;  # it has no inertia\n'
        "esac\n"
        "ros2 service call /io_and_status_controller/set_payload "
        'ur_msgs/srv/SetPayload "$load"\n'
    )


def franka_set_load(load: ControllerLoad) -> str:
    """Return the call of ``franka::Robot::setLoad(m, F_x_Cload, I_load)``.

    The centre of mass is in the flange frame [m], the inertia about the centre of mass
    [kg m^2], column by column.  Source: [LibFranka]_, ``robot.h``, ``robot_state.h``.
    """
    com = ", ".join(map(_text, load.body.com))
    entries = ", ".join(map(_text, load.inertia.T.ravel()))
    return (
        f"// {load.mark}\n"
        f"robot.setLoad({_text(load.body.mass)}, {{{{{com}}}}}, {{{{{entries}}}}});\n"
    )


def franka_ros2_call(load: ControllerLoad) -> str:
    """Return a shell script that calls the ROS 2 service ``franka_msgs/srv/SetLoad``.

    Quantities are those of `franka_set_load`.  Source: [FrankaMsgs]_.
    """
    com, entries = _list(load.body.com), _list(load.inertia.T.ravel())
    return (
        f"#!/bin/sh\n# {load.mark}\nset -e\n"
        "ros2 service call /service_server/set_load franka_msgs/srv/SetLoad \\\n"
        f'  "{{mass: {_text(load.body.mass)}, center_of_mass: {com}, '
        f'load_inertia: {entries}}}"\n'
    )


def franka_end_effector(load: ControllerLoad) -> str:
    """Return ``endeffector-config.json`` of a Franka end effector.

    ``centerOfMass`` [m] is in the flange frame, ``inertia`` about it (9 entries, column
    by column), ``transformation`` (16 entries, column by column) places the tool's
    frame in that of the flange.  Source: [FrankaEndEffector]_.
    """
    placed = np.eye(4)
    placed[:3, :3], placed[:3, 3] = load.tool.rotation, load.tool.translation
    content = {
        "id": load.name.replace("_", "-"),
        "name": load.name,
        "color": "#7d9db8",
        "mass": load.body.mass,
        "centerOfMass": load.body.com.tolist(),
        "transformation": placed.T.ravel().tolist(),
        "inertia": load.inertia.T.ravel().tolist(),
    }
    return json.dumps(content, indent=1) + "\n"


def kuka_load_data(load: ControllerLoad) -> str:
    """Return ``LOAD_DATA`` of KRL: mass, frame of the principal axes, moments.

    ``M`` [kg]; ``CM`` places the principal axes in the flange frame: ``X, Y, Z`` [mm]
    is the centre of mass, then ``A`` about ``z``, ``B`` about the new ``y``, ``C``
    about the new ``x`` [degrees]; ``J`` are the moments about these axes [kg m^2].
    Source: [KukaLoad]_.
    """
    moments, axes = principal_inertia(load.inertia)
    x, y, z = (_text(1e3 * value) for value in load.body.com)
    a, b, c = map(_text, turned_zyx(axes))
    jx, jy, jz = map(_text, moments)
    return (
        f"; {load.mark}\n"
        f"LOAD_DATA[1]={{M {_text(load.body.mass)},"
        f"CM {{X {x},Y {y},Z {z},A {a},B {b},C {c}}},"
        f"J {{X {jx},Y {jy},Z {jz}}}}}\n"
        "; of tool 1: change the index; it stands for everything on the flange, so\n"
        "; add what was there without the load\n"
    )


def abb_loaddata(load: ControllerLoad) -> str:
    """Return ``loaddata`` of RAPID: mass, centre of gravity, axes of moment, moments.

    ``cog`` [mm] and ``aom``, a quaternion whose real part is first, are in the tool's
    frame, as RAPID has them for a payload; ``ix, iy, iz`` [kg m^2] are the moments
    about these axes in the centre of gravity.  Source: [RapidLoaddata]_.
    """
    body = load.in_tool
    rotation = load.tool.rotation
    moments, axes = principal_inertia(rotation.T @ load.inertia @ rotation)
    cog = ",".join(_text(1e3 * value) for value in body.com)
    aom = ",".join(map(_text, quaternion_wxyz(axes)))
    rest = ",".join(map(_text, moments))
    return (
        f"! {load.mark}; here in the frame {_line(load.tool.name)}\n"
        f"PERS loaddata {load.name}:="
        f"[{_text(body.mass)},[{cog}],[{aom}],{rest}];\n"
        "! a line for a module of the task; the tool's own load is not in it\n"
    )


def urdf_body(load: ControllerLoad) -> str:
    """Return a link and a fixed joint, to put into the robot's URDF.

    The inertia is about the centre of mass, in the axes of the flange.
    """
    m, com = _text(load.body.mass), _spaced(load.body.com)
    entries = " ".join(
        f'{n}="{_text(v)}"' for n, v in zip(_SIX, _six(load.inertia), strict=True)
    )
    child, parent = quoteattr(load.name), quoteattr(load.flange.name)
    return (
        f"<!-- {comment_text(load.mark)} -->\n<robot name={child}>\n"
        f"  <link name={child}>\n    <inertial>\n"
        f'      <origin xyz="{com}" rpy="0 0 0"/>\n      <mass value="{m}"/>\n'
        f"      <inertia {entries}/>\n    </inertial>\n  </link>\n"
        f'  <joint name={quoteattr(load.name + "_mount")} type="fixed">\n'
        f"    <parent link={parent}/>\n    <child link={child}/>\n"
        '    <origin xyz="0 0 0" rpy="0 0 0"/>\n  </joint>\n</robot>\n'
    )


def mjcf_body(load: ControllerLoad) -> str:
    """Return a body of MuJoCo's, to put into the body that carries it.

    ``diaginertia`` are the principal moments about the centre of mass, ``quat`` turns
    the flange's axes to the principal ones.  MuJoCo refuses moments of which one
    exceeds the sum of the others, as rounding makes them for a plate; there the two
    smaller ones are raised, by 1e-7 of the largest together.  A point mass has none.
    """
    m, com = _text(load.body.mass), _spaced(load.body.com)
    moments, axes = principal_inertia(load.inertia)
    turned = _spaced(quaternion_wxyz(axes))
    form = f'quat="{turned}" diaginertia="{_spaced(_of_a_body(moments))}"'
    place = _spaced(load.flange.translation)
    quat = _spaced(quaternion_wxyz(load.flange.rotation))
    return (
        f"<!-- {comment_text(load.mark)} -->\n<mujoco>\n  <worldbody>\n"
        f"    <!-- to put into the body {comment_text(_line(load.link))} -->\n"
        f'    <body name={quoteattr(load.name)} pos="{place}" quat="{quat}">\n'
        f'      <inertial pos="{com}" mass="{m}" {form}/>\n'
        "    </body>\n  </worldbody>\n</mujoco>\n"
    )


def _of_a_body(moments: Vector) -> Vector:
    """Return principal moments of which the largest is less than the others' sum."""
    order = np.argsort(moments)
    largest = moments[order[2]]
    lack = (1.0 + _TRIANGLE) * largest - moments[order[:2]].sum()
    raised = moments.copy()
    raised[order[:2]] += max(lack, 0.0) / 2.0
    return raised


@brief
class ControllerFormat(NamedTuple):
    """A form in which a controller or a program takes a load.

    Parameters
    ----------
    name : str
        By which users choose it.
    file : str
        Name of its file.
    text : callable
        From a `ControllerLoad` to the content.
    words : frozenset of str
        In lower case: names that it keeps for itself.
    """

    name: str
    file: str
    text: Callable[[ControllerLoad], str]
    words: frozenset[str] = frozenset()

    def require_name(self, name: str) -> None:
        """Refuse a load's name that is a word of its language.

        Raises
        ------
        ModelError
        """
        if name.lower() in self.words:
            raise ModelError(
                f"name of the load is {name!r}, a word of {self.name}'s language; "
                "choose another name, such as box, or other controllers"
            )


CONTROLLER_FORMATS = (
    ControllerFormat("ur", "payload.script", ur_script),
    ControllerFormat("ur-ros2", "set_payload.sh", ros2_call),
    ControllerFormat("franka", "set_load.cpp", franka_set_load),
    ControllerFormat("franka-ros2", "set_load.sh", franka_ros2_call),
    ControllerFormat(
        "franka-end-effector", "endeffector-config.json", franka_end_effector
    ),
    ControllerFormat("kuka", "load_data.dat", kuka_load_data),
    ControllerFormat("abb", "loaddata.mod", abb_loaddata, RAPID_WORDS),
    ControllerFormat("urdf", "payload.urdf", urdf_body),
    ControllerFormat("mjcf", "payload.xml", mjcf_body),
)
"""The forms, in the order in which they are listed."""


def controller_text(load: ControllerLoad, form: str) -> str:
    """Return a load in a vendor's form.

    Parameters
    ----------
    load : ControllerLoad
    form : str
        Name of an entry of `CONTROLLER_FORMATS`.

    Raises
    ------
    ProblemError
        If there is no such form.
    ModelError
        If the load's name is a word of this form's language.

    Examples
    --------
    >>> body = InertialParameters.from_central(2.0, [0, 0, 0.1], 0.01 * np.eye(3))
    >>> flange = FixedFrame("tool0", np.eye(3), [0, 0, 0])
    >>> load = ControllerLoad("box", body, flange, "wrist_3_link", flange)
    >>> print(controller_text(load, "ur").splitlines()[1])
    set_target_payload(2, [0, 0, 0.1], [0.01, 0.01, 0.01, 0, 0, 0])
    """
    known = {one.name: one for one in CONTROLLER_FORMATS}
    if form not in known:
        raise ProblemError(f"no controller {form!r}; {did_you_mean(form, known)}")
    known[form].require_name(load.name)
    return known[form].text(load)


def turned_zyx(rotation: Matrix) -> Vector:
    """Return ``A, B, C`` [degrees] of ``Rz(A) Ry(B) Rx(C)``.

    Examples
    --------
    >>> print(turned_zyx(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])))
    [90.  0.  0.]
    """
    R = rotation
    angles = [
        np.arctan2(R[1, 0], R[0, 0]),
        np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])),
        np.arctan2(R[2, 1], R[2, 2]),
    ]
    return np.asarray(np.degrees(angles) + 0.0)  # no negative zero


def quaternion_wxyz(rotation: Matrix) -> Vector:
    """Return a rotation's quaternion, its real part first and not negative.

    Parameters
    ----------
    rotation : ndarray, shape (3, 3)

    Examples
    --------
    >>> print(quaternion_wxyz(np.diag([1.0, -1.0, -1.0])))
    [0. 1. 0. 0.]
    """
    R = rotation
    K = np.empty((4, 4))  # four times the outer product of the quaternion, less one
    K[0, 0] = np.trace(R)
    K[1:, 1:] = R + R.T - np.trace(R) * np.eye(3)
    K[0, 1:] = K[1:, 0] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    found = np.linalg.eigh(K).eigenvectors[:, -1]
    first = found[np.flatnonzero(abs(found) > 1e-12)[0]]
    return np.asarray(found * np.sign(first) + 0.0)


_SIX = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def _six(matrix: Matrix) -> list[float]:
    """Return the entries of `_SIX`."""
    rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
    entries: list[float] = matrix[rows, columns].tolist()
    return entries


def _text(value: Any) -> str:
    return format(float(value) + 0.0, _DIGITS)


def _list(values: Any) -> str:
    return f"[{', '.join(map(_text, values))}]"


def _spaced(values: Any) -> str:
    return " ".join(map(_text, values))


def _line(text: str) -> str:
    return " ".join(text.split())
