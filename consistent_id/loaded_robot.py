"""A robot and what it carries: the load as a body of its own, on a joint that stands.

Along a motion of the loaded robot the load's ten columns are those of the link that
carries it; along one of the bare robot they are zero.  Regressions of both kinds of
motion are therefore those of the bare model, with ten columns more, and add.
"""

from dataclasses import dataclass, replace

import numpy as np

from consistent_id._arrays import Array, IntArray, Matrix, Vector
from consistent_id.base import BaseParameters, independent_columns, random_regressor
from consistent_id.conic import ConicSet, SemidefiniteBlock
from consistent_id.constraints import Constraint
from consistent_id.errors import ModelError, ProblemError
from consistent_id.friction import DriveTerms
from consistent_id.inertia import InertialParameters
from consistent_id.model import Joint, Link
from consistent_id.parameters import did_you_mean
from consistent_id.regression import Regression
from consistent_id.regressor import TorqueModel


@dataclass(frozen=True, slots=True, eq=False)
class LoadedRobot:
    """The torque models of a robot without and with a load.

    Parameters
    ----------
    bare : TorqueModel
    model : TorqueModel
        Of the loaded robot: the load is its last link, on a joint that stands still and
        has no row.
    carrier : int
        Link that carries the load, in whose frame the load's parameters are.
    base : BaseParameters
        Of a motion without, and one with the load.
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
        """Where each parameter of the bare robot stands among those of the loaded."""
        inertial, p = self.bare.layout.inertial_size, len(self.bare.layout)
        return np.array([*range(inertial), *range(inertial + 10, p + 10)])

    @property
    def load_slice(self) -> slice:
        """Where the load's ten parameters stand."""
        return self.model.layout.link_slice(len(self.model.robot) - 1)

    def regression(
        self, unloaded: Regression | None, loaded: Regression | None
    ) -> Regression:
        """Return one regression of motions without and with the load.

        Both are of the bare model; either may be missing.

        Raises
        ------
        ProblemError
            If both are missing, or of another model.
        """
        given = [(r, k) for k, r in enumerate((unloaded, loaded)) if r is not None]
        if not given:
            raise ProblemError("there is no motion, neither with a load nor without")
        first, *rest = [self._extended(r, k == 1) for r, k in given]
        return first if not rest else first + rest[0]

    def _extended(self, regression: Regression, loaded: bool) -> Regression:
        if regression.fingerprint != self.bare.fingerprint:
            raise ProblemError(
                "the regression is of another torque model; build it with the model "
                "of the robot without its load"
            )
        factors = []
        for factor in regression.factors:
            wide = np.zeros((len(factor), len(self.model.layout) + 1))
            wide[:, [*self.place, -1]] = factor
            if loaded:
                carrier = self.bare.layout.link_slice(self.carrier)
                wide[:, self.load_slice] = factor[:, carrier]
            factors.append(wide)
        return Regression(
            layout=self.model.layout,
            joints=regression.joints,
            factors=tuple(factors),
            counts=regression.counts,
            sigma=regression.sigma,
            fingerprint=self.model.fingerprint,
        )

    def parameters(self, x: Vector, *, loaded: bool) -> Array:
        """Return the bare model's parameters, the load in its carrier or left out."""
        bare = x[self.place]
        if loaded:
            bare[self.bare.layout.link_slice(self.carrier)] += x[self.load_slice]
        return bare

    def with_nominal(self, load: InertialParameters) -> "LoadedRobot":
        """Return the same with another nominal load."""
        robot = self.model.robot
        links = (*robot.links[:-1], replace(robot.links[-1], nominal=load))
        model = replace(self.model, robot=replace(robot, links=links))
        return replace(self, model=model)


def loaded_robot(
    model: TorqueModel, load: Link, *, carrier: str | None = None
) -> LoadedRobot:
    """Return a robot with a load fixed to one of its links.

    Parameters
    ----------
    model : TorqueModel
        Of the bare robot.
    load : Link
        Name, and what is known of it, in the frame of the link that carries it.
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


@dataclass(frozen=True, slots=True, eq=False)
class OfBareRobot:
    """A constraint on the robot without its load, among the loaded one's parameters."""

    constraint: Constraint
    robot: LoadedRobot

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return the bare robot's set; whatever the load is."""
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
    """A constraint on all links, of which that on the load's body alone is kept."""

    constraint: Constraint
    load: str

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return the load's blocks."""
        every = self.constraint.lower(model)
        blocks = [block for block in every.blocks if block.label == self.load]
        return ConicSet.semidefinite(blocks, len(model.layout))


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
    # A rank does not tell a regressor from its triangular factor, nor does K.
    parts = []
    for seed in (0, 1):
        W = np.concatenate(list(random_regressor(robot.bare, seed=seed)), axis=1).T
        wide = np.zeros((len(W), len(robot.model.layout)))
        wide[:, robot.place] = W
        if seed == 1:
            carrier = robot.bare.layout.link_slice(robot.carrier)
            wide[:, robot.load_slice] = W[:, carrier]
        parts.append(wide)
    split = independent_columns(np.vstack(parts))
    return BaseParameters(
        robot.model.layout, *split, fingerprint=robot.model.fingerprint
    )
