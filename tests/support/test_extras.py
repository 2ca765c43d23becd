"""Without an optional library the rest works, and a message says how to install it."""

import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import consistent_id as ci
from consistent_id.motion.files import write_trajectory
from consistent_id.recordings import FourierTrajectory
from consistent_id.recordings.log_formats import LOG_FORMATS
from consistent_id.report.plot import draw_figure

ROOT = Path(__file__).parent.parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
LINE = FourierTrajectory(("elbow",), [0.5], [0.1], [[0.2]], [[0.0]], 2.0)


@pytest.fixture
def without(monkeypatch):
    """Return a function after which a library is as if not installed."""
    return lambda library: monkeypatch.setitem(sys.modules, library, None)


@pytest.mark.parametrize(
    "known", [f for f in LOG_FORMATS if f.library], ids=lambda f: f.name
)
def test_a_log_of_an_optional_format_names_what_reads_it(known, without):
    without(known.library)
    assert known.extra in PROJECT["optional-dependencies"]
    with pytest.raises(ci.RecordingError) as raised:
        known.reader("log")
    assert f"pip install 'consistent-id[{known.extra}]'" in str(raised.value)


def test_csv_is_the_same_without_pyarrow(tmp_path, without):
    rows = np.random.default_rng(3).normal(size=(50, 2))
    time = np.arange(50) / 7
    file = tmp_path / "log.csv"
    text = "\n".join(",".join(map(repr, r)) for r in np.c_[time, rows].tolist())
    file.write_text(f"time,q1,tau1\n{text}\n")
    columns = ci.Columns(position="q{number}", torque="tau{number}")
    fast = ci.read_recording(file, ["elbow"], columns)
    without("pyarrow")
    slow = ci.read_recording(file, ["elbow"], columns)
    for log in (fast, slow):
        np.testing.assert_array_equal(np.c_[log.position, log.torque], rows)
        np.testing.assert_array_equal(log.time, time)


def test_a_trajectory_in_parquet_names_what_writes_it(tmp_path, without):
    without("pyarrow")
    with pytest.raises(ci.ProblemError, match=r"consistent-id\[parquet\]"):
        write_trajectory(LINE, tmp_path / "line.parquet", rate=10.0)
    assert not (tmp_path / "line.parquet").exists()


def test_without_matplotlib_a_design_has_no_picture_and_says_so(
    tmp_path, without, caplog
):
    without("matplotlib")
    drawn = draw_figure(lambda: pytest.fail("drawn"), tmp_path / "excitation.png")
    assert drawn == []
    assert "excitation.png is not drawn" in caplog.text
    assert "pip install 'consistent-id[plots]'" in caplog.text


def test_plotting_without_matplotlib_names_what_draws(without):
    from consistent_id.estimation.estimate_plot import axes_for

    without("matplotlib.pyplot")
    with pytest.raises(ci.ProblemError, match=r"needs matplotlib.*\[plots\]"):
        axes_for(None, (1, 1), "one row")


OPTIONAL = ("pyarrow", "matplotlib", "pandas", "mujoco", "scs", "osqp", "h5py")
COMMAND = f"""
import sys
sys.modules.update(dict.fromkeys({OPTIONAL!r}))
from consistent_id.cli import main
sys.exit(main(["compare", "problems/rx60", "--output", sys.argv[1]]))
"""


@pytest.mark.slow
def test_the_first_command_of_the_readme_needs_no_optional_library(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, str(tmp_path / "rx60")],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("use: constrained")
    assert "consistent-id[" not in done.stderr
