"""Simulated arms of solid links, their motion, and five kinds of noise."""

import numpy as np
from scipy import signal

import consistent_id as ci

KINDS = ("white", "AR(1) 0.9", "low-passed", "outliers", "unmodelled friction")
LEVEL = 0.05  # noise over the torque's standard deviation
RATE, DURATION = 100, 30.0  # Hz, s


def arm(joints: int) -> tuple[ci.TorqueModel, np.ndarray]:
    """Return a model of a serial arm and true parameters: solid, slender links."""
    rng = np.random.default_rng(joints)
    turns = (0.0, -np.pi / 2, 0.0, np.pi / 2, -np.pi / 2, np.pi / 2)
    rows = [
        ci.DHRow(turn, 0.0 if i == 0 else 0.4, 0.1)
        for i, turn in enumerate(turns[:joints])
    ]
    robot = ci.from_modified_dh(f"arm{joints}", rows)
    masses = 8.0 * 0.7 ** np.arange(joints)
    bodies = [
        ci.InertialParameters.from_central(
            m, rng.uniform(-0.2, 0.2, 3), m * np.diag([0.004, 0.02, 0.022])
        ).vector
        for m in masses
    ]
    names = [link.name for link in robot.links]
    sheets = {n: ci.robot.Datasheet(mass=m) for n, m in zip(names, masses, strict=True)}
    drive = ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.05)
    model = ci.TorqueModel(robot.with_datasheet(sheets), drive)
    friction = rng.uniform(0.5, 2.0, len(model.layout) - 10 * joints)
    return model, np.concatenate([*bodies, friction])


def motion(model: ci.TorqueModel) -> ci.Recording:
    """Return sums of sines of up to half a hertz, with exact derivatives."""
    rng = np.random.default_rng(0)
    n, time = len(model.robot), np.arange(round(RATE * DURATION)) / RATE
    rates = 2 * np.pi * np.arange(1, 6) / 10
    sizes = rng.normal(size=(n, 5)) / np.arange(1, 6)
    angles = np.outer(time, rates)[None] + rng.uniform(0, 6, (n, 1, 5))
    state = (np.sin(angles), rates * np.cos(angles), -(rates**2) * np.sin(angles))
    return ci.Recording(
        model.robot.joint_names,
        time,
        *(np.einsum("jtk,jk->tj", part, sizes) for part in state),
    )


def noise(kind: str, clean: ci.Recording, rng: np.random.Generator) -> np.ndarray:
    """Return noise of unit variance, shape (samples, joints)."""
    shape = clean.torque.shape
    white = rng.normal(size=(shape[0] + 400, shape[1]))
    if kind == "AR(1) 0.9":
        return signal.lfilter([np.sqrt(0.19)], [1.0, -0.9], white, axis=0)[400:]
    if kind == "low-passed":  # 5 Hz, fourth order, forwards and backwards
        slow = signal.filtfilt(*signal.butter(4, 0.1), white, axis=0)[200:-200]
        return slow / slow.std()
    white = white[400:]
    if kind == "outliers":
        return white + 20.0 * (rng.random(shape) < 0.01) * rng.choice((-1, 1), shape)
    if kind == "unmodelled friction":  # a Stribeck peak of five deviations
        v = clean.velocity
        return white + 5.0 * np.sign(v) * np.exp(-((v / 0.2) ** 2))
    return white
