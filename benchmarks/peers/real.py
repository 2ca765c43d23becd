"""FIGAROH on a real robot's rows; started by `table_rivals.py`, in the peers' Python.

``python real.py columns FOLDER`` writes FIGAROH's regressor of each ``motion*.npz``,
with its columns of friction, rotor inertia and offset.  ``python real.py fit FOLDER``
reads these columns again, now filtered like the torque, and writes the torque that its
stages predict, with their processor seconds and what the solvers said.
"""

import json
import sys
from itertools import product
from pathlib import Path
from time import process_time
from types import SimpleNamespace
from typing import Any

import numpy as np
from physical import Found, fitted, names_of, row_weights

GIVEN = (0.999, 1.001)
"""Ratios of masses that are given: equality leaves an interior-point solver no room."""

PRIORS = (1e-6, 1e-4, 1e-2, 1e-1, 1.0, 10.0, 100.0)
"""Weights of the prior among which hindsight chooses."""


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


class Stages:
    """FIGAROH's stages on the same rows.

    Parameters
    ----------
    folder : Path
        With ``rows.npz``: filtered rows and torque, joint by joint; `reference`, the
        bodies of the nominal robot; and the number of joints that have torque.
    """

    def __init__(self, folder: Path) -> None:
        with np.load(folder / "rows.npz") as rows:
            self.W, self.tau, self.held = rows["W"], rows["tau"], rows["held"]
            self.judged, bodies = rows["judged"], rows["reference"].ravel()
            self.rows = int(rows["joints"])  # rows of each sample
        self.joints: list[str] = np.load(folder / "joints.npy").tolist()
        drives = np.zeros(self.W.shape[1] - bodies.size)
        self.reference = np.concatenate([bodies, drives])
        self.bodies = bodies.size
        self.predicted: dict[str, np.ndarray] = {}
        self.about: dict[str, dict[str, Any]] = {}

    def state(self, stage: str, began: float, torque: Any, said: str = "") -> None:
        """Keep what a stage predicts, if it found something."""
        self.about[stage] = {"seconds": process_time() - began, "said": said}
        if torque is not None:
            self.predicted[stage] = torque

    def base(self) -> None:
        """Find base parameters, without and with weights."""
        from figaroh.tools.qrdecomposition import double_QR
        from figaroh.tools.regressor import build_regressor_reduced, get_index_eliminate

        began = process_time()
        named = dict.fromkeys(names_of(self.joints, self.W.shape[1]), 0.0)
        left_out, kept = get_index_eliminate(self.W, named)
        reduced = build_regressor_reduced(self.W, left_out)
        base, _, _, values = double_QR(self.tau, reduced, kept)
        self.columns, self.values = base, np.asarray(values, dtype=float)
        seconds = process_time() - began
        places = [int(np.argmin(abs(self.W - c[:, None]).sum(0))) for c in base.T]
        began = process_time() - seconds  # without the search for the columns
        held = self.held[:, places]
        self.state("base parameters", began, held @ self.values)
        self.weights = row_weights(self.tau - base @ self.values, self.rows)
        left, right = self.weights[:, None] * base, self.weights * self.tau
        weighted = np.linalg.solve(left.T @ left, left.T @ right)
        self.state("base parameters, weighted", began, held @ weighted)

    def projection(self) -> None:
        """Find the links nearest to the nominal ones, then project them by an LMI."""
        from figaroh.identification.physical_consistency import project_robot_p10_lmi
        from figaroh.identification.reconstruction import reconstruct_full_parameters

        began = process_time()
        R = np.linalg.qr(np.column_stack([self.columns, self.W]), mode="r")
        r = self.columns.shape[1]
        M = np.linalg.solve(R[:r, :r], R[:r, r:])  # base = M standard parameters
        names = names_of(self.joints, self.W.shape[1])
        full = reconstruct_full_parameters(
            (M, self.values, names), theta0=self.reference
        )
        x = np.array(full.theta_r)
        parts = x[: self.bodies].reshape(-1, 10)
        links = dict(zip(self.joints, parts, strict=True))
        consistent, _ = project_robot_p10_lmi(links)
        x[: self.bodies] = np.concatenate([consistent[j] for j in self.joints])
        self.state("consistent links by projection", began, self.held @ x)

    def below_zero(self, x: np.ndarray) -> str:
        """Return how many frictions and rotor inertias are negative, and of how many.

        Those of joints without torque, and of coupled joints, are not asked.
        """
        names = names_of(self.joints, len(x))
        asked = [
            x[k]
            for k, name in enumerate(names)
            if name[:3] in ("fv_", "fs_", "ia_") and self.W[:, k].any()
        ]
        return f"{sum(value < 0.0 for value in asked)} of {len(asked)}"

    def _fitted(self, weighted: bool, given: bool, prior: float = 1e-6) -> Found:
        return fitted(
            *(self.W, self.tau, self.joints, self.reference),
            weights=self.weights if weighted else None,
            masses=GIVEN if given else None,
            prior=prior,
        )

    def physical(self) -> None:
        """Fit the effort under LMIs: as it is, with weights, with masses given."""
        for stage, weighted, given in (
            ("physical_fit", False, False),
            ("physical_fit, weighted", True, False),
            ("physical_fit, weighted, masses given", True, True),
        ):
            began = process_time()
            found = self._fitted(weighted, given)
            x = found.parameters
            torque = None if x is None else self.held @ x
            self.state(stage, began, torque, said=found.said)
            if x is not None:
                self.about[stage]["below zero"] = self.below_zero(x)

    def hindsight(self) -> None:
        """Choose the settings of the direct fit by the very rows that judge it."""
        began, least, best = process_time(), np.inf, None
        chosen, below = "all rejected", "-"
        for settings in product((False, True), (False, True), PRIORS):
            x = self._fitted(*settings).parameters
            if x is None:
                continue
            torque = self.held @ x
            error = float(np.linalg.norm(self.judged - torque))
            if error < least:
                weighted, given, prior = settings
                words = ["weighted"] * weighted + ["masses given"] * given
                chosen = ", ".join([*words, f"prior {prior:g}"])
                least, best, below = error, torque, self.below_zero(x)
        stage = "physical_fit, best in hindsight"
        self.state(stage, began, best, said=chosen)
        self.about[stage]["below zero"] = below


def fit(folder: Path) -> None:
    """Write the torque of held-out rows that FIGAROH's stages predict."""
    stages = Stages(folder)
    stages.base()
    stages.projection()
    stages.physical()
    stages.hindsight()
    np.savez(folder / "predicted.npz", **stages.predicted)
    (folder / "about.json").write_text(json.dumps(stages.about))


if __name__ == "__main__":
    {"columns": columns, "fit": fit}[sys.argv[1]](Path(sys.argv[2]))
