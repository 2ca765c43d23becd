"""Estimates that no data stand behind: any parameters, with a verdict."""

import numpy as np
from robots import random_body

from consistent_id import DriveTerms, Estimate, TorqueModel
from consistent_id.estimation import Certificate
from consistent_id.regression import GearCoupling
from consistent_id.regression.base import BaseParameters

FRICTION = DriveTerms(viscous=True, coulomb="sign")
EVERY_TERM = (
    DriveTerms(
        viscous=True,
        coulomb="tanh",
        velocity_scale=0.1,
        offset=True,
        rotor_inertia=True,
        spring=True,
    ),
    DriveTerms(coulomb="tanh", velocity_scale=0.2, asymmetric=True),
    DriveTerms(
        viscous=True,
        coulomb="tanh",
        velocity_scale=0.3,
        stribeck_velocity=0.5,
        load_friction=True,
        rotor_inertia=True,
    ),
    DriveTerms(coulomb="sign", offset=True),
    DriveTerms(),
)


def estimate_of(model, links, drive=(), verdict="certified"):
    """An estimate with these bodies and drive parameters."""
    bodies = np.concatenate([body.vector for body in links])
    x = np.concatenate(
        [bodies, np.broadcast_to(drive, len(model.layout) - len(bodies))]
    )
    every = tuple(range(len(x)))
    return Estimate(
        method="made up",
        model=model,
        base=BaseParameters(model.layout, every, (), np.zeros((len(every), 0))),
        parameters=x,
        base_covariance=None,
        origins=("data",) * len(x),
        undetermined=(),
        sigma=np.zeros(len(model.torque_joints)),
        certificate=Certificate(verdict, "made up"),
    )


def random_estimate(rng, robot, drive=None, couplings=()):
    """An estimate of random bodies and positive drive parameters."""
    terms = DriveTerms() if drive is None else drive
    model = TorqueModel(robot, terms, couplings)
    size = len(model.layout) - model.layout.inertial_size
    bodies = [random_body(rng) for _ in range(len(robot))]
    return estimate_of(model, bodies, rng.uniform(0.1, 2.0, size))


def coupling(robot):
    """Coupled gears of two of the robot's three or more joints, of one kind."""
    slides = [joint.kind == "prismatic" for joint in robot.joints]
    kind = slides.count(True) > 1
    alike = [
        name for name, s in zip(robot.joint_names, slides, strict=True) if s == kind
    ]
    return GearCoupling(
        *alike[:2],
        viscous=True,
        coulomb="tanh",
        velocity_scale=0.2,
        rotor_inertia=True,
    )


def rigid(estimate, states):
    """Torque of the bodies alone, shape (samples, joints)."""
    links = estimate.links.ravel()
    return TorqueModel(estimate.model.robot).predict(links, *states)
