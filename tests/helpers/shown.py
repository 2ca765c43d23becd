"""Whether values show themselves in a few lines, and which types were looked at."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass

MOST_LINES, MOST_CHARACTERS = 30, 15_000
DEPTH, ITEMS = 4, 50

SHOWN_IN = {
    "docs/collisions.md": {"Box", "Cylinder"},
    "docs/constraints.md": {
        "CentreOfMassIn",
        "EqualMotors",
        "Penalty",
        "Polytope",
        "RegularisationPath",
        "RotorInertias",
    },
    "docs/control.md": {"ControlModel"},
    "docs/drives.md": {"GearCoupling"},
    "docs/excite-my-robot.md": {
        "Aim",
        "ExcitationDesign",
        "PathForm",
        "PredictedAccuracy",
        "ValidationPath",
    },
    "docs/exports.md": {"Export", "PDGains"},
    "docs/following.md": {
        "LoadChange",
        "LoadWatch",
        "OnlineEstimate",
        "OnlineState",
        "Reason",
    },
    "docs/from-log-to-regression.md": {
        "BaseColumns",
        "ContactColumns",
        "CutoffChoice",
        "Delay",
        "LogFinding",
        "MotionNoise",
        "WrenchColumns",
    },
    "docs/lint.md": {"LintFinding"},
    "docs/motor-currents.md": {"DriveGains"},
    "docs/payload.md": {"Payload"},
    "docs/quadruped-trunk.md": {"FixedParameters"},
    "docs/repair.md": {"LinkRepair", "NearestInertia", "Repair"},
    "docs/report.md": {"Study"},
    "docs/robots.md": {"Finding"},
    "docs/rx60-story.md": {"ErrorBudget"},
    "docs/servos.md": {"JointServo", "ServoFit", "ServoLog"},
    "docs/ten-lines.md": {"Statement"},
    "docs/touch.md": {"ContactDetector", "MomentumObserver"},
    "docs/tutorial.md": {
        "Bootstrap",
        "ConsistentIntervals",
        "Diagnosis",
        "Uncertainty",
    },
    "docs/wrist-sensor.md": {"Wrench"},
    "docs/writing-tasks.md": {
        "IdentifiedExperiment",
        "Reproduction",
        "SynchronisedLog",
        "TaskPath",
        "Writer",
    },
    "tests/rollout/test_problem_rollout.py": {
        "ProblemRollout",
        "Refined",
        "Replay",
        "Rollout",
    },
    "tests/standing/test_standing.py": {
        "GroundForces",
        "Stance",
        "StandingDesign",
        "StandingFoot",
        "StandingLimits",
        "StandingMotion",
        "TrunkPath",
    },
    "tests/fleet/test_fleet.py": {"Fleet", "FleetRobot"},
    "tests/service/test_weighing.py": {"WeighedLoad"},
    "tests/service/test_gain_check.py": {"GainCheck"},
}
"""Public types whose values a page's Python or a test makes, and looks at."""


def reached(*values, depth=DEPTH):
    """Return the package's values among these, in their fields and containers."""
    found = {}
    waiting = [(value, depth) for value in values]
    while waiting:
        value, left = waiting.pop()
        kind = type(value)
        if isinstance(value, Mapping):
            waiting += [(one, left) for one in list(value.values())[:ITEMS]]
        elif isinstance(value, list | tuple | set | frozenset) and not hasattr(
            kind, "_fields"
        ):
            waiting += [(one, left) for one in list(value)[:ITEMS]]
        elif is_shown(kind) and id(value) not in found:
            found[id(value)] = value
            if left and is_dataclass(kind):
                parts = [getattr(value, f.name, None) for f in fields(value)]
                waiting += [(part, left - 1) for part in parts]
    return list(found.values())


def assert_reached(place, *values):
    """Values have few lines; those that `SHOWN_IN` has for a place are among them."""
    names = assert_shown(reached(*values))
    missing = SHOWN_IN.get(place, set()) - names
    assert not missing, f"{place} has no {missing} any more, of {names}"


def is_shown(kind):
    """Whether a type is a value of the package; a private one is shown by none."""
    home = str(getattr(kind, "__module__", ""))
    value = is_dataclass(kind) or (issubclass(kind, tuple) and hasattr(kind, "_fields"))
    private = str(getattr(kind, "__name__", "_")).startswith("_")
    return home.startswith("consistent_id.") and value and not private


def assert_shown(values, public=()):
    """Values have few lines, public ones tables; return the names of their types."""
    for value in values:
        kind, text = type(value), repr(value)
        lines = len(text.splitlines())
        assert lines <= MOST_LINES, f"{kind} prints {lines} lines"
        assert len(text) < MOST_CHARACTERS, f"{kind} prints {len(text)} characters"
        if kind in public or hasattr(kind, "_repr_html_"):
            assert "<t" in value._repr_html_(), kind
    return {type(value).__name__ for value in values}
