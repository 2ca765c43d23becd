"""The six rows of a wrench sensor, along the motion of the arm that carries it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, IntArray, Matrix
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.recordings.beside import BaseMotion
from consistent_id.regression.casadi_rows import fill_bodies
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.newton_euler import (
    FreeMotion,
    JointGeometry,
    JointMotion,
    Vec,
    add,
    floats,
    joint_geometry,
    joint_motions,
    link_states,
    matrix_rows,
    matvec,
    matvec_transposed,
)
from consistent_id.regression.newton_euler import (
    Matrix as Rows,
)
from consistent_id.regression.regressor import CHUNK, TorqueModel
from consistent_id.regression.rows.wrench_sensor import carried_base
from consistent_id.robot.kinematics import frame_in_link
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import ParameterLayout


class _FramePlace(NamedTuple):
    """A frame that is fixed to a link, of its number, and where it is there."""

    link: int
    rotation: Rows
    translation: Vec


@brief
@dataclass(frozen=True, slots=True, eq=False)
class SensorRows:
    """The rows of a wrench sensor for its tool, by the motion of the arm's joints.

    A motion that is designed for these rows determines the tool's ten parameters and
    the sensor's bias: see `design_trajectory`.

    Parameters
    ----------
    tool : TorqueModel
        Model of the tool behind the sensor: `tool_model`.
    arm : RobotModel
        Up to the sensor, with a fixed base.
    frame : str
        The sensor's: a link of the arm, or one that is fixed to it.

    Raises
    ------
    ProblemError
        If the tool is no free body, or the arm's base floats.
    ModelError
        If the arm does not move the frame.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> from consistent_id.regression import tool_model
    >>> arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(-np.pi / 2, 0)])
    >>> rows = SensorRows(tool_model("gripper"), arm, "link2")
    >>> rows.regressor([[0.1, 0.2]], [[0, 0]], [[0, 0]]).shape
    (6, 16, 1)
    """

    tool: TorqueModel
    arm: RobotModel
    frame: str

    def __post_init__(self) -> None:
        body = self.tool.robot
        if not body.floating or len(body) or len(body.links) != 1:
            raise ProblemError(
                f"{body.name!r} is no body on a sensor; build it with tool_model"
            )
        if self.arm.floating:
            raise ProblemError(
                f"robot {self.arm.name!r}: its base floats, so the sensor's motion "
                "does not follow from its joints; load it with a fixed base"
            )
        frame_in_link(self.arm, self.frame, (0.0, 0.0, 0.0))  # refuses what is still

    @property
    def robot(self) -> RobotModel:
        """The arm, whose joints move."""
        return self.arm

    @property
    def terms(self) -> tuple[DriveTerms, ...]:
        """None: joints do not weigh on a sensor behind them."""
        return (DriveTerms(),) * len(self.arm)

    @property
    def layout(self) -> ParameterLayout:
        """The tool's ten parameters, and the sensor's biases."""
        return self.tool.layout

    @property
    def torque_joints(self) -> tuple[str, ...]:
        """Names of the six rows."""
        return self.tool.torque_joints

    @property
    def fingerprint(self) -> str:
        """The tool's, as of regressions of recordings."""
        return self.tool.fingerprint

    def regressor(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        base: BaseMotion | None = None,
    ) -> Array:
        """Return the regressor, shape (6, parameters, samples): see `TorqueModel`."""
        none, moved = self._carried(q, dq, ddq)
        return self.tool.regressor(none, none, none, base=moved)

    def chunks(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        size: int = CHUNK,
        *,
        base: BaseMotion | None = None,
    ) -> Iterator[tuple[slice, Array]]:
        """Yield ``(samples, regressor)`` piece by piece."""
        none, moved = self._carried(q, dq, ddq)
        yield from self.tool.chunks(none, none, none, size, base=moved)

    def kept_chunks(
        self,
        kept: Sequence[IntArray],
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        size: int = CHUNK,
        *,
        base: BaseMotion | None = None,
    ) -> Iterator[tuple[slice, Sequence[Matrix]]]:
        """Yield ``(samples, rows)`` of some columns, piece by piece."""
        none, moved = self._carried(q, dq, ddq)
        yield from self.tool.kept_chunks(kept, none, none, none, size, base=moved)

    def _carried(
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike
    ) -> tuple[Matrix, BaseMotion]:
        """Return the joints that a tool does not have, and how its frame moves."""
        moved = carried_base(self.arm, q, dq, ddq, self.frame)
        return np.zeros((len(np.asarray(q)), 0)), moved

    def casadi(self) -> Any:
        """Return the regressor as a CasADi function of one sample of the arm."""
        import casadi as ca

        arm, tool, n = self.arm, self.tool, len(self.arm)
        q, dq, ddq = (ca.SX.sym(name, n) for name in ("q", "dq", "ddq"))
        scalars = [ca.vertsplit(x) for x in (q, dq, ddq)]
        motion = joint_motions(arm, scalars, lambda x: (ca.sin(x), ca.cos(x)))
        k, rotation, point = frame_in_link(arm, self.frame, (0.0, 0.0, 0.0))
        place = _FramePlace(k, matrix_rows(rotation), floats(point))
        moved = _frame_as_base(joint_geometry(arm), floats(arm.gravity), motion, place)
        Y = ca.SX(len(self.torque_joints), len(self.layout))
        fill_bodies(Y, tool, [moved])
        for column, name in enumerate(tool.biased_rows, start=-6):
            Y[self.torque_joints.index(name), len(self.layout) + column] = 1.0
        return ca.Function("rows", [q, dq, ddq], [Y], ["q", "dq", "ddq"], ["Y"])


def _frame_as_base(
    joints: Sequence[JointGeometry],
    gravity: Vec,
    motion: Sequence[JointMotion | FreeMotion],
    place: _FramePlace,
) -> FreeMotion:
    """Return the motion of a link's frame, as that of a free base there."""
    link = next(islice(link_states(joints, gravity, motion), place.link, None))
    a = add(link.a, matvec(link.W, place.translation))
    w, dw, a = (matvec_transposed(place.rotation, x) for x in (link.w, link.dw, a))
    return FreeMotion(w, dw, a, (0, 1, 2, 3, 4, 5))
