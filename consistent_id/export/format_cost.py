"""The torque error of an exported file: it is read back, and predicts recordings.

Its users load it, and so does this: source in Python is run, CasADi's function is
loaded, C is compiled, and MJCF with tendons is compiled by MuJoCo.  Other formats hold
values that are read, see `read_contents`.
"""

import ctypes
import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import ModelError
from consistent_id.estimation.estimate import Estimate, torque_errors
from consistent_id.estimation.torque_error import stacked_of_kinds
from consistent_id.export.export_formats import exported, known_format
from consistent_id.export.file_values import parameters_in_file, read_contents
from consistent_id.recordings.recording import Recording
from consistent_id.regression.drive.laws import direction
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.chains import FLOATING, Selection

FileTorque = Callable[[Matrix, Matrix, Matrix], Matrix]
"""``(q, dq, ddq) -> tau``, each of shape (samples, joints)."""

_PATIENCE = 60.0  # s, for a compiler
_SUFFIXES = {"mjcf": "xml", "numpy": "py"}


@dataclass(frozen=True, slots=True)
class FormatCost:
    """Torque error of a file, beside that of the estimate in it.

    Parameters
    ----------
    error, own : float
        Relative torque errors over the recordings: of the file, of the estimate.
    recordings : tuple of str
        Names of the recordings.
    held_out : bool
        Whether the estimate that was exported for it was not fitted to them.
    read_back : bool
        Whether the file was read back; otherwise the error is that of the estimate
        without the terms that the format does not have.
    """

    error: float
    own: float
    recordings: tuple[str, ...]
    held_out: bool
    read_back: bool

    def __str__(self) -> str:
        kind = "held-out error" if self.held_out else "error on its own data,"
        how = "read back" if self.read_back else "by the terms that it has"
        return (
            f"{kind} of the file, {how}: {100.0 * self.error:.2g} %; of the estimate: "
            f"{100.0 * self.own:.2g} % (all joints, {', '.join(self.recordings)})"
        )


def format_cost(
    estimate: Estimate,
    form: str,
    recordings: Sequence[Recording],
    *,
    selection: Selection,
    source: Path | None = None,
    held_out: bool = True,
) -> FormatCost:
    """Export an estimate, read the file back and return its torque error.

    Friction that a format has as one Coulomb level changes its sign as the estimate's
    does.

    Parameters
    ----------
    estimate : Estimate
        Fitted to other recordings, or the error is too small.
    recordings : sequence of Recording
        With torque; prepared as for a comparison.
    selection : Selection
        Joints of the source that are the robot's.
    source : Path, optional
        See `exported`.
    held_out : bool
        Whether the estimate was not fitted to the recordings.

    Raises
    ------
    ProblemError, ModelError
        If the format cannot express the robot, or its file is refused.
    """
    known, robot = known_format(form), estimate.model.robot
    if source is None:
        selection = Selection(
            base=FLOATING if robot.floating else None,
            joints=None if robot.floating else robot.joint_names,
        )
    # The bodies and drive terms of mjlab's robot are in the MJCF file.
    form = "mjcf" if form == "mjlab" else form
    with TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        place = Path(folder)
        export = exported(
            estimate, form, source=source, folder=place, allow_refused=True
        )
        file = place / f"robot.{_SUFFIXES.get(form, form)}"
        file.write_bytes(export.content)
        read = read_contents(form, file, estimate, selection)
        torque = file_torque(form, file, estimate) if read is None else None
        own = [e.stacked for log in recordings for e in torque_errors([estimate], log)]
        if torque is None:
            x = parameters_in_file(estimate, known.holds, read)
            left = replace(estimate, parameters=x)
            errors = [
                e.stacked for log in recordings for e in torque_errors([left], log)
            ]
        else:
            errors = [error_by(torque, estimate.model, log) for log in recordings]
    names = tuple(dict.fromkeys(log.name for log in recordings))
    loaded = read is not None or torque is not None
    return FormatCost(_mean(errors), _mean(own), names, held_out, loaded)


def error_by(torque: FileTorque, model: TorqueModel, recording: Recording) -> float:
    """Return the relative error of the torque that a function computes.

    It is that of `TorqueError.stacked`.

    Parameters
    ----------
    recording : Recording
        With torque, which is not zero throughout.
    """
    motion, joints = motion_of(model, recording, None), model.robot.joint_names
    rows, along = [joints.index(name) for name in model.torque_joints], motion.along
    tau = torque(along.q, along.dq, along.ddq)[:, rows]
    wrong = motion.torque - motion.through(tau)
    squares = [
        np.sum(values**2, axis=0, where=motion.counted)
        for values in (wrong, motion.torque)
    ]
    return stacked_of_kinds(model, *squares)


def _mean(errors: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else 0.0


def file_torque(form: str, file: Path, estimate: Estimate) -> FileTorque | None:
    """Return the torque of a file that `exported` wrote; None if it is not computed.

    C needs a compiler: that of the environment variable ``CC``, or ``cc``.

    Raises
    ------
    ModelError
        If there is no compiler, or it fails.
    """
    robot = estimate.model.robot
    if robot.floating:
        return None
    if form == "numpy":
        return _of_python(file)
    if form == "casadi":
        return _of_casadi(file)
    if form == "c":
        return _of_c(file, len(robot))
    return _of_tendons(file, estimate.model) if form == "mjcf" else None


def _of_python(file: Path) -> FileTorque:
    names: dict[str, Any] = {"__name__": "exported"}
    exec(compile(file.read_text(encoding="utf-8"), str(file), "exec"), names)
    torque: FileTorque = names["inverse_dynamics"]
    return torque


def _of_casadi(file: Path) -> FileTorque:
    import casadi as ca

    dynamics = ca.Function.load(str(file))

    def torque(q: Matrix, dq: Matrix, ddq: Matrix) -> Matrix:
        tau, *_ = dynamics.map(len(q))(q.T, dq.T, ddq.T)
        return np.asarray(tau).T

    return torque


def _of_c(file: Path, joints: int) -> FileTorque:
    text = file.read_text(encoding="utf-8")
    (name,) = set(re.findall(r"void (\w+_inverse_dynamics)\(", text))
    function = getattr(_compiled_c(file), name)
    function.restype = None
    place = ctypes.POINTER(ctypes.c_double)
    function.argtypes = [place] * 4

    def torque(q: Matrix, dq: Matrix, ddq: Matrix) -> Matrix:
        tau = np.empty((len(q), joints))
        samples = [np.ascontiguousarray(x, dtype=float) for x in (q, dq, ddq)]
        for k, row in enumerate(tau):
            given = (*(x[k] for x in samples), row)
            function(*(values.ctypes.data_as(place) for values in given))
        return tau

    return torque


def _compiled_c(file: Path) -> ctypes.CDLL:
    """Compile a source, and load it."""
    stated = os.environ.get("CC", "cc")
    words = shlex.split(stated) or ["cc"]
    if shutil.which(words[0]) is None:
        raise ModelError(f"no C compiler {stated!r} (environment variable CC) is found")
    library = file.with_suffix(".shared")
    command = [*words, "-x", "c", "-shared", "-fPIC", "-o", str(library), str(file)]
    try:
        done = subprocess.run(
            [*command, "-lm"], capture_output=True, text=True, timeout=_PATIENCE
        )
        if done.returncode == 0:
            return ctypes.CDLL(str(library))
    except (subprocess.SubprocessError, OSError) as cause:
        raise ModelError(f"the C compiler {stated!r} failed: {cause}") from None
    seen = next((k for k in done.stderr.splitlines() if "error" in k), "no message")
    raise ModelError(f"the C compiler {stated!r} refuses the source: {seen}")


def _of_tendons(file: Path, model: TorqueModel) -> FileTorque | None:
    """Return the torque of MJCF whose tendons carry friction; None without any.

    MuJoCo computes the torque of bodies, rotors, dampers and springs.  It lets joints
    stick where the estimate's friction changes its direction smoothly; so friction is
    computed here, from the file's levels and the tendons' moment arms.
    """
    import mujoco

    from consistent_id.robot.loaders.mjcf import compiled_file

    compiled, robot = compiled_file(file), model.robot
    names = [joint.name for joint in robot.joints]
    if not compiled.ntendon or compiled.nv != len(names):
        return None
    places = [int(compiled.joint(name).dofadr[0]) for name in names]
    compiled.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, rates = mujoco.MjData(compiled), robot.joint_rates
    offsets = np.array([one.offset for one in robot.transmissions])

    def torque(q: Matrix, dq: Matrix, ddq: Matrix) -> Matrix:
        tau = np.empty_like(q)
        for k, speed in enumerate(dq):
            data.qpos[places] = rates @ q[k] + offsets
            data.qvel[places], data.qacc[places] = rates @ speed, rates @ ddq[k]
            mujoco.mj_inverse(compiled, data)
            smooth = rates.T @ data.qfrc_inverse[places]
            tau[k] = smooth + _dry_friction(compiled, data, model, speed)
        return tau

    return torque


def _dry_friction(compiled: Any, data: Any, model: TorqueModel, dq: Vector) -> Vector:
    """Return the friction of joints and tendons that has one level, shape (joints,)."""
    tendons = {compiled.tendon(t).name: t for t in range(compiled.ntendon)}
    tau = np.zeros(len(dq))
    for k, (joint, terms) in enumerate(
        zip(model.robot.driven, model.terms, strict=True)
    ):
        level = float(compiled.dof_frictionloss[compiled.joint(joint.name).dofadr[0]])
        t = tendons.get(f"{joint.name} friction")
        if t is not None and dq[k]:
            arm = abs(data.ten_velocity[t] / dq[k])
            level += float(compiled.tendon_frictionloss[t]) * arm
        if level:
            tau[k] = level * direction(dq[k], terms.velocity_scale)
    for coupling, ends in zip(model.couplings, model.coupled, strict=True):
        t = tendons.get(coupling.label)
        if t is not None and compiled.tendon_frictionloss[t]:
            way = direction(data.ten_velocity[t], coupling.velocity_scale)
            tau[list(ends)] += compiled.tendon_frictionloss[t] * way
    return tau
