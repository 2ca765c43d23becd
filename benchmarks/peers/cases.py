"""One way of identifying the robot of `run.py`; started by it, in the peers' Python.

``python cases.py NAME FOLDER`` prints its figures as JSON.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from time import process_time
from types import SimpleNamespace
from typing import Any

import numpy as np


def memory(entry: str, *, forget_peak: bool = False) -> float:
    """Return resident memory, or its peak, in MB, as Linux tells it."""
    if forget_peak:
        Path("/proc/self/clear_refs").write_text("5")
    status = Path("/proc/self/status").read_text()
    (line,) = [row for row in status.splitlines() if row.startswith(entry)]
    return int(line.split()[1]) / 1024


class Answer(SimpleNamespace):
    """Processor seconds of the regressor, and a function from a motion to torque."""


def _loaded(folder: Path) -> Any:
    import pinocchio as pin

    return pin.buildModelFromUrdf(str(folder / "robot.urdf"))


def _rows(model: Any, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    """Return the regressor, one Pinocchio call per sample, joint by joint."""
    import pinocchio as pin

    data, n = model.createData(), model.nv
    W = np.zeros((n, len(q), 10 * n))
    for s in range(len(q)):
        W[:, s] = pin.computeJointTorqueRegressor(model, data, q[s], dq[s], ddq[s])
    return W.reshape(-1, 10 * n)


def pinocchio(folder: Path, log: dict[str, np.ndarray]) -> Answer:
    """Stack the regressor of a loop, and call numpy.linalg.lstsq."""
    model = _loaded(folder)
    started = process_time()
    W = _rows(model, log["q"], log["dq"], log["ddq"])
    seconds = process_time() - started
    x = np.linalg.lstsq(W, log["tau"].T.ravel(), rcond=1e-9)[0]
    return Answer(regressor=seconds, predict=lambda *m: _rows(model, *m) @ x)


def cvxpy(folder: Path, log: dict[str, np.ndarray]) -> Answer:
    """Compress the same rows by QR; solve for consistent links."""
    import cvxpy as cp

    model = _loaded(folder)
    started = process_time()
    W = _rows(model, log["q"], log["dq"], log["ddq"])
    seconds = process_time() - started
    R = np.linalg.qr(np.column_stack([W, log["tau"].T.ravel()]), mode="r")
    x = cp.Variable(W.shape[1])
    links = []
    for k in range(model.nv):
        m, hx, hy, hz, xx, xy, yy, xz, yz, zz = (x[10 * k + i] for i in range(10))
        S = [[(yy + zz - xx) / 2, -xy, -xz], [-xy, (xx + zz - yy) / 2, -yz]]
        S += [[-xz, -yz, (xx + yy - zz) / 2]]
        h = (hx, hy, hz)
        J = cp.bmat([[*row, hi] for row, hi in zip(S, h, strict=True)] + [[*h, m]])
        links.append((J + J.T) / 2 >> 0)
    size = np.linalg.norm(R[:, -1])
    misfit = cp.norm((R[:, :-1] @ x - R[:, -1]) / size)
    cp.Problem(cp.Minimize(misfit), links).solve(cp.CLARABEL)
    found = x.value
    return Answer(regressor=seconds, predict=lambda *m: _rows(model, *m) @ found)


class FigarohFit(SimpleNamespace):
    """What FIGAROH finds: its regressor, base columns, base values, and seconds."""


def _figaroh_fit(model: Any, log: dict[str, np.ndarray]) -> FigarohFit:
    """FIGAROH's regressor, its base parameters by double QR, its least squares."""
    from figaroh.tools.qrdecomposition import double_QR
    from figaroh.tools.regressor import (
        build_regressor_basic,
        build_regressor_reduced,
        get_index_eliminate,
    )

    robot = SimpleNamespace(model=model, data=model.createData())
    config = {"is_joint_torques": True, "act_idxv": list(range(model.nv))}
    names = {f"p{i}": 0.0 for i in range(10 * model.nv)}

    def regressor(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        return np.asarray(build_regressor_basic(robot, q, dq, ddq, config))

    started = process_time()
    W = regressor(log["q"], log["dq"], log["ddq"])
    seconds = process_time() - started
    left_out, kept = get_index_eliminate(W, names)
    reduced = build_regressor_reduced(W, left_out)
    base, _, _, values = double_QR(log["tau"].T.ravel(), reduced, kept)
    return FigarohFit(
        regressor=regressor,
        W=W,
        base=base,
        values=np.asarray(values, dtype=float),
        seconds=seconds,
    )


def figaroh(folder: Path, log: dict[str, np.ndarray]) -> Answer:
    """FIGAROH to its base parameters."""
    fit = _figaroh_fit(_loaded(folder), log)

    def predict(*motion: np.ndarray) -> np.ndarray:
        # Its base columns are columns of the regressor: find which, untimed.
        columns = [int(np.argmin(abs(fit.W - c[:, None]).sum(0))) for c in fit.base.T]
        return np.asarray(fit.regressor(*motion)[:, columns] @ fit.values)

    return Answer(regressor=fit.seconds, predict=predict)


def figaroh_lmi(folder: Path, log: dict[str, np.ndarray]) -> Answer:
    """FIGAROH to consistent links: nearest to the URDF's, then projected by an LMI."""
    from figaroh.identification.physical_consistency import project_robot_p10_lmi
    from figaroh.identification.reconstruction import reconstruct_full_parameters

    model = _loaded(folder)
    fit = _figaroh_fit(model, log)
    R = np.linalg.qr(np.column_stack([fit.base, fit.W]), mode="r")
    r = fit.base.shape[1]
    M = np.linalg.solve(R[:r, :r], R[:r, r:])  # base = M standard parameters
    terms = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
    names = [f"{term}_{joint}" for joint in model.names[1:] for term in terms]
    nominal = [link.toDynamicParameters() for link in model.inertias.tolist()[1:]]
    full = reconstruct_full_parameters(
        (M, fit.values, names), theta0=np.concatenate(nominal)
    )
    links = np.asarray(full.theta_r).reshape(-1, 10)
    named = dict(zip(model.names[1:], links, strict=True))
    consistent, _ = project_robot_p10_lmi(named)
    x = np.concatenate([consistent[joint] for joint in model.names[1:]])
    return Answer(regressor=fit.seconds, predict=lambda *m: fit.regressor(*m) @ x)


def figaroh_physical(folder: Path, log: dict[str, np.ndarray]) -> Answer:
    """FIGAROH to consistent links by its direct fit under LMIs, the URDF's as prior."""
    from figaroh.tools.regressor import build_regressor_basic
    from physical import fitted

    model = _loaded(folder)
    robot = SimpleNamespace(model=model, data=model.createData())
    config = {"is_joint_torques": True, "act_idxv": list(range(model.nv))}
    nominal = [link.toDynamicParameters() for link in model.inertias.tolist()[1:]]
    started = process_time()
    W = np.asarray(build_regressor_basic(robot, *_motion(log), config))
    seconds = process_time() - started
    tau, joints = log["tau"].T.ravel(), list(model.names)[1:]
    found = fitted(W, tau, joints, np.concatenate(nominal))
    if found.parameters is None:
        raise SystemExit(f"rejected, {found.said}")
    x = found.parameters
    return Answer(
        regressor=seconds,
        predict=lambda *m: build_regressor_basic(robot, *m, config) @ x,
    )


def _motion(log: dict[str, np.ndarray]) -> tuple[np.ndarray, ...]:
    return log["q"], log["dq"], log["ddq"]


def idyntree(folder: Path, log: dict[str, np.ndarray]) -> Answer:
    """IDynTree's regressor of inverse dynamics in a loop, and lstsq."""
    import idyntree.bindings as idyn

    loader = idyn.ModelLoader()
    loader.loadModelFromFile(str(folder / "robot.urdf"))
    robot = idyn.KinDynComputations()
    robot.loadRobotModel(loader.model())
    n = robot.getNrOfDegreesOfFreedom()
    gravity = np.array([0.0, 0.0, -9.81])
    Y = idyn.MatrixDynSize(6 + n, 10 * robot.getNrOfLinks())

    def regressor(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        W = np.zeros((n, len(q), Y.cols()))
        for s in range(len(q)):
            robot.setRobotState(q[s], dq[s], gravity)
            robot.inverseDynamicsInertialParametersRegressor(np.zeros(6), ddq[s], Y)
            W[:, s] = Y.toNumPy()[6:]
        return W.reshape(-1, Y.cols())

    started = process_time()
    W = regressor(log["q"], log["dq"], log["ddq"])
    seconds = process_time() - started
    x = np.linalg.lstsq(W, log["tau"].T.ravel(), rcond=1e-9)[0]
    return Answer(regressor=seconds, predict=lambda *m: regressor(*m) @ x)


def ours(folder: Path, log: dict[str, np.ndarray]) -> Answer:
    """Stream, compress and solve for consistent links."""
    import consistent_id as ci

    model = ci.TorqueModel(ci.robot.load_urdf(folder / "robot.urdf"))
    time = np.arange(len(log["q"])) / 1000.0
    motion = log["q"], log["dq"], log["ddq"], log["tau"]
    recording = ci.Recording(model.robot.joint_names, time, *motion)
    started = process_time()
    for _ in model.chunks(*motion[:3]):
        pass
    seconds = process_time() - started
    regression = ci.build_regression(model, recording)
    estimate = ci.constrained_least_squares(
        model, regression, constraints=[ci.PhysicalConsistency()]
    )
    x = estimate.parameters
    return Answer(regressor=seconds, predict=lambda *m: model.predict(x, *m).T.ravel())


CASES: dict[str, Callable[[Path, dict[str, np.ndarray]], Answer]] = {
    "consistent_id, consistent links": ours,
    "Pinocchio loop + lstsq": pinocchio,
    "Pinocchio loop + CVXPY, consistent links": cvxpy,
    "FIGAROH 1.0.2, base parameters": figaroh,
    "FIGAROH 1.0.2, consistent links by projection": figaroh_lmi,
    "FIGAROH 1.0.2, consistent links by physical_fit": figaroh_physical,
    "iDynTree loop + lstsq": idyntree,
}


def main() -> None:
    name, folder = sys.argv[1], Path(sys.argv[2])
    log = dict(np.load(folder / "training.npz"))
    held = dict(np.load(folder / "held_out.npz"))
    few = {key: values[:500] for key, values in log.items()}
    CASES[name](folder, few)  # imports and compilation
    before = memory("VmRSS", forget_peak=True)
    started = process_time()
    answer = CASES[name](folder, log)
    total = process_time() - started
    extra = memory("VmHWM") - before
    tau = held["tau"].T.ravel()
    error = answer.predict(held["q"], held["dq"], held["ddq"]) - tau
    figures = {
        "regressor": answer.regressor,
        "total": total,
        "memory": extra,
        "error": float(np.linalg.norm(error) / np.linalg.norm(tau)),
    }
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
