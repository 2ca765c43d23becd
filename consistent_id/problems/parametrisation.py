"""Published parametrisations: a model's torque in named combinations of parameters.

Papers write ``tau = Y alpha`` in combinations of their own, often with gravity's share
of a parameter under another name than its inertial share, and under assumptions such as
"the centre of mass lies on the axis".  Given the combinations, their regressor follows
from the robot's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector, chunks
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.errors import ProblemError
from consistent_id.recordings.recording import Recording, states
from consistent_id.regression.regression import triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.parameters import require_known

Effect = Literal["inertia", "gravity"]

_INCOMPLETE = 1e-9  # share of the regressor that combinations may fail to express


@dataclass(frozen=True, slots=True)
class Combination:
    """One named combination of parameters.

    Parameters
    ----------
    terms : mapping of str to float
        Coefficients of the model's parameters, by name.
    effect : {"inertia", "gravity"}
        Whether it stands for its parameters' share in inertial or in gravity torque.
    """

    name: str
    meaning: str
    unit: str
    terms: Mapping[str, float]
    effect: Effect = "inertia"


@dataclass(frozen=True, slots=True, eq=False)
class Parametrisation:
    """A robot's torque as ``Y(q, dq, ddq) alpha``, ``alpha = C x``.

    Parameters
    ----------
    zero : tuple of str
        Parameters that the parametrisation takes for zero.

    Raises
    ------
    ProblemError
        If a name is unknown, or the combinations do not express the model's torque.
    """

    model: TorqueModel
    combinations: tuple[Combination, ...]
    zero: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in self.zero:
            self.model.layout.index(name)
        rng = np.random.default_rng(0)
        state = rng.uniform(-2.0, 2.0, (3, 8, len(self.model.robot)))
        free = [i for i, name in enumerate(self.model.layout.names) if self._used(name)]
        full = self.model.regressor(*state)[:, free]
        mine = np.einsum(
            "jas,ap->jps", self.regressor(*state), self.matrix[:, free], optimize=True
        )
        missing = abs(full - mine).max(axis=(0, 2))
        if missing.max() > _INCOMPLETE * abs(full).max():
            worst = self.model.layout.names[free[int(missing.argmax())]]
            raise ProblemError(
                f"the combinations do not express the model's torque: {worst} has an "
                "effect that none of them carries. Complete them, or list it as zero"
            )

    def __len__(self) -> int:
        return len(self.combinations)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the combinations."""
        return tuple(c.name for c in self.combinations)

    @property
    def matrix(self) -> Matrix:
        """``C``, shape (combinations, parameters)."""
        C = np.zeros((len(self), len(self.model.layout)))
        for row, combination in zip(C, self.combinations, strict=True):
            for name, coefficient in combination.terms.items():
                row[self.model.layout.index(name)] = coefficient
        return C

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return ``Y``, shape (joints, combinations, samples)."""
        inertial, gravity = self._lifts()
        still = replace(self.model.robot, gravity=np.zeros(3))
        Y0 = replace(self.model, robot=still).regressor(q, dq, ddq)
        Yg = self.model.regressor(q, dq, ddq) - Y0
        return np.asarray(
            np.einsum("jps,pa->jas", Y0, inertial)
            + np.einsum("jps,pa->jas", Yg, gravity)
        )

    def factor(self, recording: Recording) -> Matrix:
        """Return the triangular factor of ``[Y, tau]`` along a recording.

        Without torque the last column is zero.
        """
        measured = recording.of(self.model.torque_joints).torque
        motion = states(recording.of(self.model.robot.joint_names))
        R = np.zeros((0, len(self) + 1))
        for part in chunks(len(recording), 4096):
            Y = self.regressor(*(values[part] for values in motion))
            tau = np.zeros((Y.shape[2], len(Y)))
            if measured is not None:
                tau = measured[part]
            rows = np.hstack([np.concatenate(list(Y), axis=1).T, tau.T.reshape(-1, 1)])
            R = triangle(np.asfortranarray(np.vstack([R, rows])))
        return R

    def places(self, names: Sequence[str]) -> list[int]:
        """Return the places of named combinations."""
        require_known(names, self.names, "no combination named")
        return [self.names.index(name) for name in names]

    def others(self, names: Sequence[str]) -> list[int]:
        """Return the places of all combinations but those named."""
        named = self.places(names)
        return [i for i in range(len(self)) if i not in named]

    def parameters(self, alpha: Vector, known: ConicSet) -> Vector:
        """Return the smallest parameters with these combinations and known values.

        `known` holds equalities, such as the datasheet's masses, met exactly; the
        combinations are met as nearly as their rounding allows.
        """
        start = np.linalg.lstsq(known.A_eq, known.b_eq, rcond=None)[0]
        _, s, Vt = np.linalg.svd(known.A_eq)
        rank = int((s > 1e-12 * s.max(initial=0.0)).sum())
        free = Vt[rank:].T
        rest = np.linalg.lstsq(
            self.matrix @ free, alpha - self.matrix @ start, rcond=1e-10
        )[0]
        return np.asarray(start + free @ rest)

    def _used(self, name: str) -> bool:
        return name not in self.zero

    def _lifts(self) -> tuple[Matrix, Matrix]:
        """Return maps to parameters: for the inertial and for the gravity share."""
        C = self.matrix
        unused = [self.model.layout.index(name) for name in self.zero]
        C[:, unused] = 0.0
        maps = []
        for effect in ("inertia", "gravity"):
            mine = np.array([c.effect == effect for c in self.combinations])
            lift = np.zeros(C.T.shape)
            if mine.any():
                lift[:, mine] = np.linalg.pinv(C[mine])
            maps.append(lift)
        return maps[0], maps[1]
