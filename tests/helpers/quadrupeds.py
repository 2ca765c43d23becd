"""A robot with a trunk and four legs of three joints, and logs of it on its feet."""

import numpy as np

from consistent_id import Recording, TorqueModel
from consistent_id.recordings import BaseMotion, ContactFlags, Wrench
from consistent_id.regression import contact_jacobian

FEET = tuple(f"{leg}_calf" for leg in "abcd")
FOOT = (0.0, 0.0, -0.2)  # in the calf's frame

BODY = """
<inertial pos="0.1 0 0" mass="{mass}" diaginertia="0.02 0.03 0.04"/>
"""

QUADRUPED = f"""
<mujoco>
  <worldbody>
    <body name="trunk" pos="0 0 0.4" quat="0 0 0 1">{{joint}}
      {BODY.format(mass=7)}
      {{legs}}
    </body>
  </worldbody>
</mujoco>
"""

LEG = f"""
<body name="{{0}}_hip" pos="{{1}} {{2}} 0">{BODY.format(mass=1)}
  <joint name="{{0}}_roll" axis="1 0 0"/>
  <body name="{{0}}_thigh" pos="0 0.05 0">{BODY.format(mass=1)}
    <joint name="{{0}}_pitch" axis="0 1 0"/>
    <body name="{{0}}_calf" pos="0 0 -0.2">{BODY.format(mass=0.3)}
      <joint name="{{0}}_knee" axis="0 1 0"/>
    </body>
  </body>
</body>
"""


ROW = ((0.2, -3), (0.2, -1), (0.2, 1), (0.2, 3))
CORNERS = ((0.2, -0.1), (0.2, 0.1), (-0.2, -0.1), (-0.2, 0.1))


def quadruped_text(joint="<freejoint/>", *, hips=ROW):
    """MJCF of the robot, its trunk hanging on a joint or none, hips where said [m]."""
    places = zip("abcd", hips, strict=True)
    legs = "".join(LEG.format(name, *place) for name, place in places)
    return QUADRUPED.format(joint=joint, legs=legs)


def standing(robot, closed, *, noise=0.0, seed=0, radius=0.0):
    """A recording of random states, on the feet that `closed` says, (samples, feet).

    Forces at the feet are any that balance the base's rows; of points they are logged.
    A foot is a point, or a ball of a radius [m] about it that touches level ground, the
    base being level: its contact transmits no moment, so that at least three feet must
    be closed.
    """
    rng = np.random.default_rng(seed)
    samples, n = len(closed), len(robot)
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, samples, n))
    w, dw, a = rng.uniform(-1.0, 1.0, (3, samples, 3))
    level = np.tile(np.eye(3), (samples, 1, 1)) if radius else None
    base = BaseMotion(w, dw, a + np.array([0.0, 0.0, 9.81]), level)
    forces = TorqueModel(robot).predict(robot.nominal, q, dq, ddq, base=base)
    whole = [contact_jacobian(robot, q, frame=foot, point=FOOT) for foot in FEET]
    arm = np.array([[0, -radius, 0], [radius, 0, 0], [0, 0, 0]])  # w x (0, 0, -radius)
    jacobians = [J[:, :3] + arm @ J[:, 3:] for J in whole]
    pushes = np.concatenate(jacobians, axis=1) * np.repeat(closed, 3, axis=1)[..., None]
    balance = np.linalg.pinv(np.swapaxes(pushes[:, :, :6], 1, 2))
    acting = np.einsum("nfr,nr->nf", balance, forces[:, :6])
    acting *= np.repeat(closed, 3, axis=1)
    assert np.allclose(
        np.einsum("nfr,nf->nr", pushes, acting)[:, :6], forces[:, :6], atol=1e-9
    )
    torque = (forces - np.einsum("nfr,nf->nr", pushes, acting))[:, 6:]
    torque = torque + noise * rng.normal(size=torque.shape)
    still = np.zeros((samples, 3))
    return Recording(
        robot.joint_names,
        0.01 * np.arange(samples),
        q,
        dq,
        ddq,
        torque,
        base=base,
        wrenches=()
        if radius
        else tuple(
            Wrench(foot, np.hstack([f, still]), FOOT, axes="base")
            for foot, f in zip(FEET, np.split(acting, 4, axis=1), strict=True)
        ),
        contacts=tuple(
            ContactFlags(foot, closed[:, i], FOOT, radius=radius)
            for i, foot in enumerate(FEET)
        ),
    )
