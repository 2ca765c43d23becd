"""A load behind a wrist sensor, weighed from logs with it and without."""

import numpy as np
import pytest
from walking import write_csv

import consistent_id as ci
from consistent_id.service import check_gains, controller_text, weigh_load

PROBLEM = """
name = "wrist"
[model]
modified_dh = [
  { alpha_deg = -90, a = 0.0 },
  { alpha_deg = 0, a = 0.4 },
  { alpha_deg = -90, a = 0.3 },
]
[wrist_sensor]
frame = "link3"
tool = "gripper"
[data]
recordings = [ { file = "bare.csv", role = "training" } ]
[[data.wrenches]]
frame = "link3"
values = ["fx", "fy", "fz", "nx", "ny", "nz"]
[data.preparation]
motion_cutoff = 20.0
torque_cutoff = 20.0
"""
ARM = ci.from_modified_dh(
    "wrist", [ci.DHRow(-np.pi / 2, 0), ci.DHRow(0, 0.4), ci.DHRow(-np.pi / 2, 0.3)]
)
GRIPPER = ci.InertialParameters.from_central(1.3, [0.02, 0, 0.08], 4e-3 * np.eye(3))
LOAD = ci.InertialParameters.from_central(
    2.0, [0.03, -0.02, 0.15], np.diag([0.01, 0.012, 0.008])
)
BIAS = np.array([3.0, -2.0, 5.0, 0.1, -0.2, 0.05])


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    """An arm with a gripper on a wrist sensor, and logs without and with a load."""
    folder = tmp_path_factory.mktemp("wrist")
    (folder / "problem.toml").write_text(PROBLEM)
    model = ci.regression.tool_model("gripper")
    rng = np.random.default_rng(0)
    for name, load in (("bare", 0.0 * LOAD.vector), ("loaded", LOAD.vector)):
        tones = 0.3 * rng.normal(size=(2, 3, 3))
        path = ci.recordings.FourierTrajectory(
            ARM.joint_names,
            ci.recordings.harmonics_of(0.2, 3),
            np.zeros(3),
            *tones,
            duration=10,
        )
        log = path.recording(rate=100.0)
        still = np.zeros((len(log), 0))
        moved = ci.regression.sensor_motion(ARM, log, "link3")
        truth = np.concatenate([GRIPPER.vector + load, BIAS])
        shown = model.predict(truth, still, still, still, base=moved)
        shown += rng.normal(size=shown.shape) * ([0.2] * 3 + [0.02] * 3)
        columns = {"time": log.time}
        columns |= {f"q_{j}": log.position[:, i] for i, j in enumerate(ARM.joint_names)}
        names = ("fx", "fy", "fz", "nx", "ny", "nz")
        columns |= {name: shown[:, i] for i, name in enumerate(names)}
        write_csv(folder / f"{name}.csv", columns)
    return ci.load_problem(folder)


@pytest.mark.slow
def test_a_sensor_shows_the_load_s_ten_parameters(problem):
    found = weigh_load(problem, problem.folder / "loaded.csv", tool=[0.0, 0.0, 0.1])
    assert found.verdict.word == "use"
    free, errors = found.payload.free.vector, found.payload.standard_errors
    assert abs(free[0] - LOAD.mass) < 5e-3
    z = (free - LOAD.vector) / errors
    assert 0.2 < np.sqrt(np.mean(z**2)) < 2.0
    assert (found.in_flange.frame, found.in_tool.frame) == ("link3", "tool")
    np.testing.assert_allclose(found.in_flange.body.com, LOAD.com, atol=1e-3)
    np.testing.assert_allclose(
        found.in_tool.body.com, LOAD.com - [0.0, 0.0, 0.1], atol=1e-3
    )
    assert "sensor is assumed to be calibrated" in found.payload.condition
    text = controller_text(found.for_controller, "mjcf")
    assert "to put into the body link3" in text


@pytest.mark.slow
def test_a_mass_from_a_scale_is_kept_and_compared(problem):
    loaded = problem.folder / "loaded.csv"
    found = weigh_load(problem, loaded, known_mass=2.0)
    assert found.in_flange.body.mass == pytest.approx(2.0)
    assert found.gains is None and found.verdict.word == "use"
    wrong = weigh_load(problem, loaded, known_mass=2.1)
    assert "mass contradicts the scale" in [r.kind for r in wrong.verdict.grounds]


def test_frames_gains_and_drifting_sensors_are_refused(problem):
    loaded = problem.folder / "loaded.csv"
    with pytest.raises(ci.ProblemError, match="in its own frame, 'link3'"):
        weigh_load(problem, loaded, link="link2")
    with pytest.raises(ci.ProblemError, match="there are no gains of currents"):
        check_gains(problem, loaded, known_mass=2.0)
    drifting = PROBLEM.replace('tool = "gripper"', 'tool = "gripper"\ndrift = "linear"')
    (problem.folder / "drifting.toml").write_text(drifting)
    with pytest.raises(ci.ProblemError, match=r"drift = 'linear'.*cannot be compared"):
        weigh_load(ci.load_problem(problem.folder / "drifting.toml"), loaded)
