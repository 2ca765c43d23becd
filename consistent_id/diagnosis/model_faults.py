"""Models whose numbers no robot has: other units, or inertials that stand for none."""

import numpy as np

from consistent_id.diagnosis.findings import LogFinding
from consistent_id.robot.model import RobotModel

_FAR = 50.0  # m between neighbouring joints, which no robot has
_HEAVY = 2.3e4  # kg/m^3: osmium, the densest metal
_EQUAL = 1e-9  # relative, to which made-up inertials are alike


def model_findings(robot: RobotModel) -> list[LogFinding]:
    """Judge a model by itself."""
    return _lengths(robot) or _masses(robot) or _placeholders(robot)


def _lengths(robot: RobotModel) -> list[LogFinding]:
    farthest = max(float(np.linalg.norm(j.translation)) for j in robot.joints)
    if farthest < _FAR:
        return []
    return [
        LogFinding(
            "units",
            "fault",
            "model",
            f"two joints of the model are {farthest:.4g} m apart: its lengths are in "
            "millimetres",
            "divide lengths by 1000, and inertias by 1e6",
            farthest / _FAR,
        )
    ]


def _masses(robot: RobotModel) -> list[LogFinding]:
    """Find links that are denser than any metal."""
    dense = []
    for link in robot.links:
        body = link.nominal
        if body is None or body.mass <= 0.0:
            return []
        # A box of this mass and these moments; a shell or a frame is less dense.
        central = np.linalg.eigvalsh(body.central_inertia)
        sides = 12.0 * (central.sum() / 2.0 - central) / body.mass
        if (sides <= 0.0).any():
            return []
        dense.append(body.mass / float(np.sqrt(np.prod(sides))))
    if min(dense) < _HEAVY or len(dense) < 2 or min(dense) > 1e3 * _HEAVY:
        return []
    return [
        LogFinding(
            "units",
            "fault",
            "model",
            f"bodies with the masses and inertias of the model's links are denser than "
            f"{_HEAVY:.3g} kg/m^3, the densest metal: its masses are in grams",
            "divide masses and inertias by 1000",
            min(dense) / _HEAVY,
        )
    ]


def placeholders(robot: RobotModel) -> bool:
    """Return whether all links have the same inertials, which are made up then."""
    bodies = [link.nominal for link in robot.links]
    known = [body for body in bodies if body is not None]
    if len(known) < max(len(bodies), 2):
        return False
    masses = np.array([body.mass for body in known])
    central = np.array([body.central_inertia for body in known])
    alike = np.ptp(masses) <= _EQUAL * masses.max()
    return bool(alike and np.ptp(central, axis=0).max() <= _EQUAL * central.max())


def _placeholders(robot: RobotModel) -> list[LogFinding]:
    if not placeholders(robot):
        return []
    return [
        LogFinding(
            "placeholder inertials",
            "warning",
            "model",
            f"all {len(robot)} links of the model have the same mass and inertia: they "
            "are placeholders",
            'masses = "free" (--masses free), or those of the datasheet',
            2.0,
        )
    ]
