"""Standard errors of payloads, delays, instruments, Huber's loss and others hold."""

import importlib.util
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def methods():
    return _benchmark("coverage_methods")


def _benchmark(name):
    path = BENCHMARKS / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look there for their module
    sys.path.insert(0, str(BENCHMARKS))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(BENCHMARKS))
    return module


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["white", "AR(1) 0.9"])
@pytest.mark.parametrize(
    "name", ["payload", "delay", "instrumental variables", "Huber"]
)
def test_intervals_hold_the_truth_neither_too_rarely_nor_too_often(methods, name, kind):
    z = np.array(list(methods.METHODS[name](kind, 30)))
    held, error = methods.share(z)
    assert held > 0.93 - 3.0 * error
    assert held < 0.97 + 3.0 * error
    # Errors of the right size have a mean square of one; that of 30 sets is uncertain.
    assert 0.6 < np.mean(z**2) < 1.6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kind", "logs"),
    [
        ("zero of a joint", "white", 20),
        ("blocks of a motion", "white", 30),
        ("blocks of a motion", "pink", 30),
        ("radius of feet", "white", 20),
        ("robot on its feet", "AR(1) 0.9", 5),
        ("robot on its feet", "pink", 5),
        ("drive calibration", "pink", 30),
        ("spring of a gear", "pink", 30),
        ("drive gains", "AR(1) 0.9", 20),
        ("delay of commands", "white", 20),
        ("gain of a joint", "changing level", 20),
        ("clock, gain, lean", "white", 30),
        ("slope on nominal torque", "AR(1) 0.9", 20),
        ("fleet", "white", 10),
        ("design on a wrist sensor", "white", 30),
        ("design on feet", "white", 20),
    ],
)
def test_they_hold_for_robots_on_feet_blocks_and_designs(methods, name, kind, logs):
    z = np.array(list(methods.METHODS[name](kind, logs)))
    held, error = methods.share(z)
    error = max(error, np.sqrt(0.05 * 0.95 / z.size))  # if all of a few hold
    assert held > 0.93 - 3.0 * error
    assert held < 0.97 + 3.0 * error
    # One value of each log: a mean square of one, as far as so many normal values show.
    alone = chi2.ppf([0.001, 0.999], logs) / logs
    low, high = alone if z.shape[1] == 1 else (0.5, 1.7)
    assert low < np.mean(z**2) < high


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["white", "AR(1) 0.9", "pink"])
def test_they_hold_for_raw_logs_as_drafts_prepare_them(kind):
    logs = _benchmark("coverage_logs")
    found = list(logs.errors(logs.case("ur5", 20.0), kind, 12))
    for errors in zip(*found, strict=True):  # of least squares, and constrained
        inside = np.array([np.mean(abs(own) <= 1.0) for own in errors])
        error = inside.std(ddof=1) / np.sqrt(len(inside))
        assert 0.93 - 3.0 * error < inside.mean() < 0.97 + 3.0 * error


PRINTED = {
    "diagnosis/factor_findings.py": "clock, gain, lean",
    "diagnosis/torque_channel.py": "slope on nominal torque",
    "diagnosis/whole_robot.py": "gain of a joint",
    "estimation/delayed_commands.py": "delay of commands",
    "estimation/determination.py": "Raw logs",
    "estimation/drive_calibration.py": "drive calibration",
    "estimation/payload.py": "payload",
    "estimation/transmission_springs.py": "spring of a gear",
    "export/export_formats.py": "Raw logs",
    "fleet/fleet_result.py": "fleet",
    "problems/log_check.py": "radius of feet",
    "problems/nominal_gains.py": "model's bodies imply",
    "problems/selection/model_selection.py": "a choice of `select`",
    "report/residuals_section.py": "drift of a residual",
    "report/summary.py": "delay of commands",
    "rollout/delivered_parameters.py": "drives of a rollout",
    "rollout/servo_result.py": "Parameters of a [servo]",
    "service/gain_check.py": "drive gains",
    "service/load_quantities.py": "payload",
}
"""Files that print a figure with its error, and where it is measured or discussed."""


@pytest.mark.slow
def test_every_figure_with_an_error_is_measured_or_its_limits_are_said():
    package = BENCHMARKS.parent / "consistent_id"
    # With a value and its error around it, or as the header of a column.
    printed = re.compile(r"[}%] ?(\+-|±)|(\+-|±) ?[{\"m]|\"[^\"]*(\+-|±) ?\[kg")
    found = {
        file.relative_to(package).as_posix()
        for file in package.rglob("*.py")
        if any(
            printed.search(line)
            for line in file.read_text().splitlines()
            if "lstrip" not in line and "``" not in line
        )
    }
    assert found == {*PRINTED}
    page = (BENCHMARKS.parent / "docs" / "coverage.md").read_text()
    for where in PRINTED.values():
        assert where in page


def test_a_share_counts_what_lies_within_two_standard_errors(methods):
    z = np.array([[0.0, 1.9, -1.9, 2.0], [0.0, 0.0, 3.0, -3.0]])
    assert methods.share(z) == (pytest.approx(0.625), pytest.approx(0.125))
