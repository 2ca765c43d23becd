"""A robot and its load: the load is a separate body on a joint that stands still.

Along a motion of the loaded robot the load's ten columns are those of the link that
carries it; along one of the bare robot they are zero.  Regressions of both kinds of
motion are therefore those of the bare model, with ten columns more, and add.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector
from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.sets import ConicSet, SemidefiniteBlock
from consistent_id.errors import ModelError, NotExcitedError
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.linear import smallest_solution, split_at_gap
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_structure import random_rows
from consistent_id.regression.segments import merged
from consistent_id.regression.torque_along import measured_torque, predicted_torque
from consistent_id.robot.inertia import (
    InertialParameters,
    inertial_vector,
    pseudo_inertia,
)
from consistent_id.robot.model import Joint, Link
from consistent_id.robot.parameters import did_you_mean

_THIN = 1e-2  # least second moment of a likely load about its centre, over the largest
_RADIUS = 0.01  # m; its least size
_FARTHEST = 1.0  # m; beyond, a centre is that of a mass which is nearly zero by chance


@dataclass(frozen=True, slots=True, eq=False)
class LoadedRobot:
    """The torque models of a robot without and with a load.

    Parameters
    ----------
    model : TorqueModel
        Model of the loaded robot: the load is its last link, on a joint that stands
        still and has no row.
    carrier : int
        Link that carries the load, in whose frame the load's parameters are.
    base : BaseParameters
        Base parameters of motions with and without the load.
    """

    bare: TorqueModel
    model: TorqueModel
    carrier: int
    base: BaseParameters

    @property
    def load(self) -> str:
        """Name of the load."""
        return self.model.robot.link_names[-1]

    @property
    def place(self) -> IntArray:
        """Index of each parameter of the bare robot among those of the loaded one."""
        inertial, p = self.bare.layout.inertial_size, len(self.bare.layout)
        return np.array([*range(inertial), *range(inertial + 10, p + 10)])

    @property
    def load_slice(self) -> slice:
        """Indices of the load's ten parameters."""
        return self.model.layout.link_slice(len(self.model.robot.links) - 1)

    def torque_model(self, *, loaded: bool) -> TorqueModel:
        """Return the bare model; load friction includes the load.

        The load's nominal parameters are used, if they are known.
        """
        reference, load = self.bare.load_reference, self.model.robot.links[-1].nominal
        if not loaded or reference is None or load is None:
            return self.bare
        both = reference.copy()
        both[self.bare.layout.link_slice(self.carrier)] += load.vector
        return replace(self.bare, load_reference=both)

    def regression(
        self, unloaded: Sequence[Recording], loaded: Sequence[Recording]
    ) -> Regression:
        """Return one regression of motions without and with the load.

        Either may be missing.

        Raises
        ------
        NotExcitedError
            If there is no motion at all.
        """
        parts = [
            self._extended(runs, k == 1)
            for k, runs in enumerate((unloaded, loaded))
            if runs
        ]
        if not parts:
            raise NotExcitedError("there is no motion, neither with a load nor without")
        return merged(parts)

    def _extended(self, runs: Sequence[Recording], loaded: bool) -> Regression:
        regression = build_regression(self.torque_model(loaded=loaded), runs)
        wider = self._wider(loaded)
        noise = regression.noise
        if noise is not None:
            noise = noise.through(lambda _, N: np.asarray(N @ wider))
        return replace(
            regression,
            layout=self.model.layout,
            factors=tuple(
                np.hstack([factor[:, :-1] @ wider, factor[:, -1:]])
                for factor in regression.factors
            ),
            noise=noise,
            fingerprint=self.model.fingerprint,
        )

    def _wider(self, loaded: bool) -> Matrix:
        """Return the map from columns of the bare model to those of the loaded one."""
        wider = np.zeros((len(self.bare.layout), len(self.model.layout)))
        wider[range(len(wider)), self.place] = 1.0
        if loaded:
            carrier = self.bare.layout.link_slice(self.carrier)
            wider[range(carrier.start, carrier.stop), self.load_slice] = np.eye(10)
        return wider

    def parameters(self, x: Vector, *, loaded: bool) -> Array:
        """Return the bare model's parameters, the load in its carrier or left out."""
        bare = x[self.place]
        if loaded:
            bare[self.bare.layout.link_slice(self.carrier)] += x[self.load_slice]
        return bare

    def predict(self, x: Vector, recording: Recording, *, loaded: bool) -> Array:
        """Return torques along a motion, shape (samples, torque joints), [N m or N].

        Raises
        ------
        ProblemError
            If the recording has no velocity or acceleration.
        """
        bare = self.parameters(x, loaded=loaded)
        return predicted_torque(self.torque_model(loaded=loaded), bare, recording)

    def residuals(
        self, x: Vector, unloaded: Sequence[Recording], loaded: Sequence[Recording]
    ) -> Array:
        """Return ``prediction - torque``, shape (torque joints, samples)."""
        parts = []
        for k, runs in enumerate((unloaded, loaded)):
            for log in runs:
                torque = measured_torque(self.bare, log)
                parts.append(self.predict(x, log, loaded=k == 1) - torque)
        return np.vstack(parts).T

    def misfits(
        self,
        unloaded: Sequence[Recording],
        loaded: Sequence[Recording],
        sigma: Sequence[float] | Vector,
    ) -> Vector:
        """Return the squared misfits of least squares with the load on each link.

        Shape (links,): sums over all rows, each joint's divided by its `sigma`.
        """
        still, carrying = (
            [F / s for F, s in zip(regression.factors, sigma, strict=True)]
            for regression in (
                build_regression(self.torque_model(loaded=False), unloaded),
                build_regression(self.torque_model(loaded=True), loaded),
            )
        )
        bare, torque = np.split(np.vstack([*still, *carrying]), [-1], axis=1)
        found = []
        for link in range(len(self.bare.robot.links)):
            load = bare[:, self.bare.layout.link_slice(link)].copy()
            load[: sum(map(len, still))] = 0.0
            wide = np.hstack([bare, load])
            misfit = wide @ smallest_solution(wide, torque) - torque
            found.append(float(np.sum(misfit**2)))
        return np.array(found)

    def with_nominal(self, load: InertialParameters) -> "LoadedRobot":
        """Return the same with another nominal load."""
        robot, reference = self.model.robot, self.model.load_reference
        links = (*robot.links[:-1], replace(robot.links[-1], nominal=load))
        if reference is not None:
            reference = np.append(reference[:-10], load.vector)
        model = replace(
            self.model, robot=replace(robot, links=links), load_reference=reference
        )
        base = replace(self.base, fingerprint=model.fingerprint)
        return replace(self, model=model, base=base)


def likely_body(vector: Vector) -> InertialParameters | None:
    """Return a body near the least-squares estimate of a load, if it may be one.

    Mass and centre of mass stay.  Second moments about the centre are raised where they
    are too small for a body: masses and second moments have different units, so that
    the size of one says nothing about the other.
    """
    mass = vector[0]
    if mass <= 0.0 or np.linalg.norm(vector[1:4]) > _FARTHEST * mass:
        return None
    J = pseudo_inertia(vector)
    of_centre = np.outer(J[:3, 3], J[:3, 3]) / mass
    values, axes = np.linalg.eigh(J[:3, :3] - of_centre)
    raised = np.maximum(values, max(_THIN * values[-1], mass * _RADIUS**2))
    J[:3, :3] = (axes * raised) @ axes.T + of_centre
    return InertialParameters(inertial_vector(J))


def loaded_robot(
    model: TorqueModel, load: Link, *, carrier: str | None = None
) -> LoadedRobot:
    """Return a robot with a load fixed to one of its links.

    Parameters
    ----------
    model : TorqueModel
        Model of the bare robot.
    load : Link
        Name and known parameters, in the frame of the link that carries it.
    carrier : str, optional
        Link that carries the load; by default the last one of a chain.
    """
    place = _carrier(model, carrier)
    robot = model.robot
    joint = Joint(
        f"{load.name} mount", "revolute", place, np.eye(3), np.zeros(3), np.eye(3)[2]
    )
    with_load = replace(
        robot, joints=(*robot.joints, joint), links=(*robot.links, load)
    )
    reference = model.load_reference
    if reference is not None:
        body = np.zeros(10) if load.nominal is None else load.nominal.vector
        reference = np.append(reference, body)
    wider = replace(
        model,
        robot=with_load,
        drive=(*model.terms, DriveTerms()),
        torque_joints=model.torque_joints,
        load_reference=reference,
    )
    without = LoadedRobot(model, wider, place, _no_base(wider))
    return replace(without, base=_base(without))


def _carrier(model: TorqueModel, name: str | None) -> int:
    names = model.robot.link_names
    if name is not None:
        if name not in names:
            near = did_you_mean(name, names)
            raise ModelError(f"no link named {name!r} carries a load; {near}")
        return names.index(name)
    parents = {joint.parent for joint in model.robot.joints}
    tips = [k for k in range(len(names)) if k not in parents]
    if len(tips) > 1:
        found = ", ".join(names[k] for k in tips)
        raise ModelError(f"the robot ends in {found}; name the carrier of the load")
    return tips[0]


def _no_base(model: TorqueModel) -> BaseParameters:
    every = tuple(range(len(model.layout)))
    return BaseParameters(model.layout, every, (), np.zeros((len(every), 0)))


def _base(robot: LoadedRobot) -> BaseParameters:
    """Return the base parameters of random motions without and with the load."""
    parts = []
    for seed in (0, 1):
        W = random_rows(robot.bare, seed=seed).stacked()
        wide = np.zeros((len(W), len(robot.model.layout)))
        wide[:, robot.place] = W
        if seed == 1:
            carrier = robot.bare.layout.link_slice(robot.carrier)
            wide[:, robot.load_slice] = W[:, carrier]
        parts.append(wide)
    layout = robot.model.layout
    split = split_at_gap(np.vstack(parts), layout.kinds).split
    return BaseParameters(
        robot.model.layout, *split, fingerprint=robot.model.fingerprint
    )


@dataclass(frozen=True, slots=True, eq=False)
class OfBareRobot:
    """A constraint on the robot without its load, among the loaded one's parameters."""

    constraint: Constraint
    robot: LoadedRobot

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return the bare robot's set, for any load."""
        place, size = self.robot.place, len(model.layout)
        bare = self.constraint.lower(self.robot.bare)

        def wide(A: Matrix) -> Matrix:
            rows = np.zeros((len(A), size))
            rows[:, place] = A
            return rows

        blocks = []
        for block in bare.blocks:
            k = len(block.scale)
            coefficients = np.zeros((size, k, k))
            coefficients[place] = block.coefficients
            blocks.append(
                SemidefiniteBlock(
                    block.label, coefficients, block.constant, block.scale
                )
            )
        return replace(
            bare, A_eq=wide(bare.A_eq), A_in=wide(bare.A_in), blocks=tuple(blocks)
        )


@dataclass(frozen=True, slots=True, eq=False)
class OfLoad:
    """A constraint on all links, reduced to its part on the load's body."""

    constraint: Constraint
    load: str

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return the load's blocks."""
        every = self.constraint.lower(model)
        blocks = [block for block in every.blocks if block.label == self.load]
        return ConicSet.semidefinite(blocks, len(model.layout))
