"""FIGAROH on a real robot's rows; started by `table_rivals.py`, in the peers' Python.

``python real.py columns FOLDER`` writes FIGAROH's regressor of each ``motion*.npz``,
with its columns of friction, rotor inertia and offset.  ``python real.py fit FOLDER``
reads these columns again, now filtered like the torque, and writes the torque that its
stages predict.
"""

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

TERMS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


def loaded(folder: Path) -> Any:
    """Return the robot with the joints that the problem has, in their order."""
    import pinocchio as pin

    model = pin.buildModelFromUrdf(str(folder / "robot.urdf"))
    joints = np.load(folder / "joints.npy").tolist()
    still = [k for k, name in enumerate(model.names) if k and name not in joints]
    model = pin.buildReducedModel(model, still, pin.neutral(model))
    gravity = np.load(folder / "gravity.npy")
    model.gravity.linear = gravity
    if list(model.names)[1:] != joints:
        raise SystemExit(
            f"Pinocchio's joints are {list(model.names)[1:]}, not {joints}"
        )
    return model


def columns(folder: Path) -> None:
    """Write FIGAROH's regressor of each motion, shape (joints, samples, columns)."""
    from figaroh.tools.regressor import build_regressor_basic

    model = loaded(folder)
    robot = SimpleNamespace(model=model, data=model.createData())
    config = dict.fromkeys(
        ("is_joint_torques", "has_friction", "has_actuator_inertia"), True
    )
    config |= {"has_joint_offset": True, "act_idxv": list(range(model.nv))}
    for file in sorted(folder.glob("motion*.npz")):
        log = np.load(file)
        W = build_regressor_basic(robot, log["q"], log["dq"], log["ddq"], config)
        np.save(file.with_suffix(".npy"), W.reshape(model.nv, len(log["q"]), -1))


def fit(folder: Path) -> None:
    """Write the torque of held-out rows that FIGAROH's stages predict."""
    from figaroh.identification.physical_consistency import project_robot_p10_lmi
    from figaroh.identification.reconstruction import reconstruct_full_parameters
    from figaroh.tools.qrdecomposition import double_QR
    from figaroh.tools.regressor import build_regressor_reduced, get_index_eliminate

    model = loaded(folder)
    rows = np.load(folder / "rows.npz")
    W, tau, held = rows["W"], rows["tau"], rows["held"]
    joints = list(model.names)[1:]
    names = [f"{term}_{joint}" for joint in joints for term in TERMS]
    names += [
        f"{kind}_{joint}" for kind in ("fv", "fs", "ia", "off") for joint in joints
    ]
    names += [f"more_{k}" for k in range(W.shape[1] - len(names))]  # coupled joints
    left_out, kept = get_index_eliminate(W, dict.fromkeys(names, 0.0))
    reduced = build_regressor_reduced(W, left_out)
    base, _, _, values = double_QR(tau, reduced, kept)
    values = np.asarray(values, dtype=float)
    places = [int(np.argmin(abs(W - column[:, None]).sum(0))) for column in base.T]
    predicted = {"base parameters": held[:, places] @ values}
    R = np.linalg.qr(np.column_stack([base, W]), mode="r")
    r = base.shape[1]
    M = np.linalg.solve(R[:r, :r], R[:r, r:])  # base = M standard parameters
    nominal = [link.toDynamicParameters() for link in model.inertias.tolist()[1:]]
    start = np.concatenate([*nominal, np.zeros(W.shape[1] - 10 * model.nv)])
    full = reconstruct_full_parameters((M, values, names), theta0=start)
    x = np.array(full.theta_r)
    links = dict(zip(joints, x[: 10 * model.nv].reshape(-1, 10), strict=True))
    consistent, _ = project_robot_p10_lmi(links)
    x[: 10 * model.nv] = np.concatenate([consistent[joint] for joint in joints])
    predicted["consistent links by its LMI"] = held @ x
    np.savez(folder / "predicted.npz", **predicted)


if __name__ == "__main__":
    {"columns": columns, "fit": fit}[sys.argv[1]](Path(sys.argv[2]))
