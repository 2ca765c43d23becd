"""The torque that an exported file computes, once it is loaded as its users load it.

Source in Python is run, CasADi's function is loaded, C is compiled, and MJCF with
tendons is compiled by MuJoCo.  Other formats hold values that are read, see
`read_contents`.
"""

import ctypes
import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import ModelError
from consistent_id.estimation.estimate import Estimate
from consistent_id.regression.drive.laws import direction
from consistent_id.regression.regressor import TorqueModel

FileTorque = Callable[[Matrix, Matrix, Matrix], Matrix]
"""``(q, dq, ddq) -> tau``, each of shape (samples, joints)."""

_PATIENCE = 60.0  # s, for a compiler


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
