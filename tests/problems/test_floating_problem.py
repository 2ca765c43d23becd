"""Problem files of robots on a moving base, and of tools behind a wrench sensor."""

import json
from dataclasses import replace

import numpy as np
import pytest
from quadrupeds import CORNERS, FEET, FOOT, quadruped_text
from some_fast import some_fast
from walking import walk, write_csv

import consistent_id as ci
from consistent_id.cli import main
from consistent_id.estimation.uncertainties.beyond_noise import parameter_shifts
from consistent_id.problems.log_check import check_problem
from consistent_id.problems.problem_estimates import variant_regressions
from consistent_id.problems.study import Study, run_study
from consistent_id.regression.rows.wrench_sensor import driftless_regression

BOX = ci.InertialParameters.from_central(2.0, [0.05, 0.02, 0.1], 0.02 * np.eye(3))
HEAD = """
name = "walker"
[model]
mjcf = "quadruped.xml"
base = "floating"
[constraints]
masses = "free"
known_links = {legs}
[data]
recordings = [
  {{ file = "training.csv", role = "training", rows = [50, 3950] }},
  {{ file = "validation.csv", role = "validation", rows = [50, 3950] }},
]
[data.columns]
torque = "tau_{{joint}}"
[data.preparation]
motion_cutoff = 30.0
torque_cutoff = 30.0
"""
UNIT = """
[data.base]
angular_velocity = ["gyro_x", "gyro_y", "gyro_z"]
acceleration = ["acc_x", "acc_y", "acc_z"]
"""
POSE = """
[data.base]
position = ["place_x", "place_y", "place_z"]
orientation = ["quat_w", "quat_x", "quat_y", "quat_z"]
order = "wxyz"
"""
CONTACTS = "".join(
    f'[[data.contacts]]\nframe = "{foot}"\nclosed = "contact_{foot}"\n'
    f"point = {list(FOOT)}\n"
    for foot in FEET
)
WRENCHES = "".join(
    f'[[data.wrenches]]\nframe = "{foot}"\npoint = {list(FOOT)}\naxes = "base"\n'
    f'values = ["{foot}_fx", "{foot}_fy", "{foot}_fz"]\n'
    for foot in FEET
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A robot, and two logs of it with a box on its trunk."""
    folder = tmp_path_factory.mktemp("walker")
    (folder / "quadruped.xml").write_text(quadruped_text(hips=CORNERS))
    robot = ci.robot.load_mjcf(folder / "quadruped.xml", base="floating")
    truth = robot.nominal.copy()
    truth[:10] += BOX.vector
    rng = np.random.default_rng(0)
    for seed, name in enumerate(("training", "validation")):
        log = walk(robot, truth, seed=seed)
        for column in log:
            if column.startswith("tau"):
                log[column] = log[column] + 0.05 * rng.normal(size=len(log["time"]))
        write_csv(folder / f"{name}.csv", log)
    return folder


def problem(folder, *parts, name="problem.toml"):
    robot = ci.robot.load_mjcf(folder / "quadruped.xml", base="floating")
    legs = list(robot.link_names[1:])
    text = "".join((HEAD.format(legs=legs), *parts)).replace("'", '"')
    (folder / name).write_text(text)
    return ci.load_problem(folder / name)


def trunk_of(found):
    return ci.InertialParameters(found.links[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    "parts",
    [(UNIT, CONTACTS), (POSE, CONTACTS), (UNIT, WRENCHES)],
    ids=["IMU", "pose", "forces"],
)
def test_a_trunk_is_found_from_a_problem_file(folder, parts):
    study = Study(problem(folder, *parts, name="one.toml"))
    robot = study.problem.model.robot
    expected = robot.links[0].nominal + BOX
    trunk = trunk_of(study.constrained)
    # Noise of 0.05 N m; filters and differences err by less than that.
    assert trunk.mass == pytest.approx(expected.mass, rel=0.01)
    assert np.linalg.norm(trunk.com - expected.com) < 3e-3
    moments, right = (
        np.linalg.eigvalsh(body.central_inertia) for body in (trunk, expected)
    )
    assert moments == pytest.approx(right, rel=0.05)


@pytest.mark.slow
def test_a_standing_robot_has_a_verdict_and_a_report(folder, tmp_path):
    study = run_study(problem(folder, UNIT, CONTACTS, name="whole.toml"))
    assert study.verdict.usable
    # Contact forces hide nothing but themselves: each foot is lifted once.
    assert len(study.base) == len(ci.regression.base_parameters(study.problem.model))
    assert study.recommended.held_out_error < 0.05
    page = ci.write_report(study, tmp_path / "report.html").read_text()
    assert "base.fz (RMS error" in page and "a_knee" in page
    assert study.diagnosis.by_themselves


@pytest.mark.slow
def test_rows_without_contact_forces_have_honest_standard_errors(folder):
    """Of 94 base parameters the deviations, in standard errors, are about one."""
    study = Study(problem(folder, UNIT, CONTACTS, name="errors.toml"))
    robot = study.problem.model.robot
    truth = robot.nominal.copy()
    truth[:10] += BOX.vector
    found = ci.least_squares(study.problem.model, study.regression, base=study.base)
    off = found.base_values - study.base.projection @ truth
    ratio = np.sqrt(np.mean((off / found.standard_errors) ** 2))
    assert 0.6 < ratio < 1.6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((), r"no \[data.base\] says how it moves"),
        (("[data.base]\n",), "angular_velocity and acceleration"),
        ((UNIT + "order = 'zyxw'\n",), "order"),
        ((UNIT.replace("gyro_x", "gyro"), CONTACTS), "no column 'gyro'"),
        ((UNIT.replace('"gyro_x", ', ""), CONTACTS), "2 columns, expected 3"),
        ((UNIT, CONTACTS.replace("a_calf", "a_claf", 1)), "a_claf"),
    ],
)
def test_faults_are_named(folder, parts, message):
    with pytest.raises(ci.ConsistentIdError, match=message):
        _ = Study(problem(folder, *parts, name="faulty.toml")).constrained


@pytest.mark.slow
def test_a_fixed_base_does_not_move(folder):
    (folder / "hanging.xml").write_text(quadruped_text(joint=""))
    text = HEAD.format(legs=[]).replace('base = "floating"', "") + UNIT
    (folder / "fixed.toml").write_text(text.replace("quadruped", "hanging"))
    with pytest.raises(ci.ProblemError, match=r"\[data.base\] is of a base that float"):
        ci.load_problem(folder / "fixed.toml")


WRIST = """
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
recordings = [
  { file = "training.csv", role = "training" },
  { file = "validation.csv", role = "validation" },
]
[[data.wrenches]]
frame = "link3"
values = ["fx", "fy", "fz", "nx", "ny", "nz"]
on_robot = false
[data.preparation]
motion_cutoff = 30.0
torque_cutoff = 30.0
"""
GRIPPER = ci.InertialParameters.from_central(1.3, [0.02, 0, 0.08], 4e-3 * np.eye(3))
BIAS = np.array([3.0, -2.0, 5.0, 0.1, -0.2, 0.05])


@pytest.fixture(scope="module")
def wrist(tmp_path_factory):
    """An arm that carries a tool on a wrench sensor whose sign is the other one."""
    folder = tmp_path_factory.mktemp("wrist")
    (folder / "problem.toml").write_text(WRIST)
    rows = [ci.DHRow(-np.pi / 2, 0), ci.DHRow(0, 0.4), ci.DHRow(-np.pi / 2, 0.3)]
    arm, model = ci.from_modified_dh("wrist", rows), ci.regression.tool_model("gripper")
    rng = np.random.default_rng(0)
    for name in ("training", "validation"):
        tones = 0.3 * rng.normal(size=(2, 3, 3))
        path = ci.recordings.FourierTrajectory(
            arm.joint_names,
            ci.recordings.harmonics_of(0.2, 3),
            np.zeros(3),
            *tones,
            duration=10,
        )
        log, still = path.recording(rate=200.0), np.zeros((2001, 0))
        moved = ci.regression.sensor_motion(arm, log, "link3")
        truth = np.append(GRIPPER.vector, BIAS)
        acting = -model.predict(truth, still, still, still, base=moved)
        acting += rng.normal(size=acting.shape) * ([0.2] * 3 + [0.02] * 3)
        names = ("fx", "fy", "fz", "nx", "ny", "nz")
        columns = {"time": log.time}
        columns |= {f"q_{j}": log.position[:, i] for i, j in enumerate(arm.joint_names)}
        columns |= {name: acting[:, i] for i, name in enumerate(names)}
        write_csv(folder / f"{name}.csv", columns)
    return ci.load_problem(folder)


@pytest.mark.slow
def test_what_hangs_on_a_wrist_is_found_from_a_problem_file(wrist, tmp_path):
    study = run_study(wrist)
    tool = ci.InertialParameters(study.constrained.links[0])
    assert study.verdict.word == "use"
    assert tool.mass == pytest.approx(GRIPPER.mass, rel=5e-3)
    assert np.linalg.norm(tool.com - GRIPPER.com) < 1e-3
    found = study.constrained.parameters[10:]
    assert found == pytest.approx(BIAS, abs=0.05)
    page = ci.write_report(study, tmp_path / "report.html").read_text()
    assert "base.fz (RMS error" in page


@pytest.mark.slow
def test_a_tools_datasheet_is_its_own(wrist, tmp_path):
    text = WRIST + "[links.gripper]\nmass = 1.25\n"
    (wrist.folder / "known.toml").write_text(text)
    known = ci.load_problem(wrist.folder / "known.toml")
    study = Study(replace(known, source=None))
    assert study.constrained.links[0][0] == pytest.approx(1.25)
    missing = WRIST.replace('frame = "link3"', 'frame = "link2"', 1)
    (wrist.folder / "other.toml").write_text(missing)
    with pytest.raises(ci.ProblemError, match=r"no .*wrenches.* names its columns"):
        ci.load_problem(wrist.folder / "other.toml")


@pytest.mark.slow
def test_the_verdict_says_when_a_trunk_is_told_with_its_legs_alone(folder):
    """Masses of legs regroup with the trunk's: the total is determined, no part is."""
    known = Study(problem(folder, UNIT, CONTACTS, name="known.toml"))
    text = (folder / "known.toml").read_text()
    lines = [x for x in text.splitlines() if not x.startswith("known_links")]
    (folder / "nothing.toml").write_text("\n".join(lines))
    nothing = Study(ci.load_problem(folder / "nothing.toml"))
    kinds = [
        {reason.kind for reason in study.verdict_on(study.constrained).reasons}
        for study in (known, nothing)
    ]
    assert "trunk" not in kinds[0] and "trunk" in kinds[1]
    total = nothing.constrained.links[:, 0].sum()
    robot = known.problem.model.robot
    expected = sum(link.nominal.mass for link in robot.links) + BOX.mass
    assert total == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
def test_below_which_speed_joints_rest_is_estimated_from_training(folder):
    """Validation is masked by what training shows; friction bears 1 N m at rest."""
    for name in ("training", "validation"):
        rows = np.genfromtxt(folder / f"{name}.csv", delimiter=",", names=True)
        log = {column: rows[column] for column in rows.dtype.names}
        for column in [c for c in log if c.startswith("tau_")]:
            rate = np.gradient(log[column.replace("tau_", "q_")], log["time"])
            log[column] = log[column] + 1.0 * (abs(rate) < 0.05)
        write_csv(folder / f"sticks_{name}.csv", log)
    problem(folder, UNIT, CONTACTS, name="sticks.toml")
    text = (folder / "sticks.toml").read_text().replace('file = "', 'file = "sticks_')
    (folder / "sticks.toml").write_text(text)
    plain = ci.load_problem(folder / "sticks.toml")
    asked = text.replace(
        "motion_cutoff", 'least_joint_speed = "estimated"\nmotion_cutoff'
    )
    (folder / "asked.toml").write_text(asked)
    found = ci.load_problem(folder / "asked.toml")
    rests = ci.estimation.rest_speed(
        plain.model,
        plain.training,
        constraints=plain.constraints,
        reach=ci.signals.rest_guard(30.0),
    )
    assert 0.02 < rests.speed < 0.2
    for role in ("training", "validation"):
        (one,), (other,) = getattr(plain, role), getattr(found, role)
        expected = ci.signals.without_rests(
            one, rests.speed, reach=rests.reach
        ).torque_known
        assert np.array_equal(other.torque_known, expected)


def _drifting(wrist, folder, rate=0.0):
    """The problem of the wrist whose two logs have biases of their own [N, N m]."""
    for name, sign in (("training", 1.0), ("validation", -1.0)):
        lines = (wrist.folder / f"{name}.csv").read_text().splitlines()
        header, rows = lines[0].split(","), np.loadtxt(lines[1:], delimiter=",")
        since = rows[:, :1] - rows[0, 0]
        own = sign * np.array([4.0, 3.0, -2.0, 0.2, 0.1, -0.3])
        places = [header.index(n) for n in ("fx", "fy", "fz", "nx", "ny", "nz")]
        rows[:, places] += own * (1.0 + rate * since)
        write_csv(
            folder / f"{name}.csv",
            {n: rows[:, k] for k, n in enumerate(header)},
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drift", "rate"), some_fast([("recordings", 0.0), ("linear", 0.3)])
)
def test_a_sensor_whose_bias_drifts_tells_the_tool_all_the_same(
    wrist, tmp_path, drift, rate
):
    _drifting(wrist, tmp_path, rate)
    text = WRIST.replace('tool = "gripper"', f'tool = "gripper"\ndrift = "{drift}"')
    (tmp_path / "problem.toml").write_text(text)
    study = Study(ci.load_problem(tmp_path))
    tool = ci.InertialParameters(study.constrained.links[0])
    assert study.verdict.usable
    assert tool.mass == pytest.approx(GRIPPER.mass, rel=5e-3)
    assert np.linalg.norm(tool.com - GRIPPER.com) < 1e-3
    # What is held out is predicted up to noise, its own bias being taken out of it.
    assert study.recommended.held_out_error < 0.05
    # Segments are those of the whole, and biases cost what they tell.
    again = driftless_regression(study.problem.model, study.training, drift)
    assert study.regression.counts == again.counts
    for one, other in zip(study.regression.factors, again.factors, strict=True):
        assert np.allclose(one.T @ one, other.T @ other, rtol=1e-9, atol=1e-9)
    plain = ci.build_regression(study.problem.model, study.training)
    errors = [ci.least_squares(study.problem.model, r) for r in (plain, again)]
    assert errors[1].standard_errors[0] > 1.05 * errors[0].standard_errors[0]


@pytest.mark.slow
def test_a_bias_that_drifts_and_is_not_there_is_refused(wrist, tmp_path):
    keys = 'tool = "gripper"\nbias = false\ndrift = "linear"'
    (tmp_path / "problem.toml").write_text(WRIST.replace('tool = "gripper"', keys))
    with pytest.raises(ci.ProblemError, match="leave one of them out"):
        ci.load_problem(tmp_path)


@pytest.mark.slow
def test_what_takes_all_recordings_at_once_is_not_streamed(wrist, folder, tmp_path):
    keys = 'tool = "gripper"\ndrift = "linear"'
    (tmp_path / "problem.toml").write_text(WRIST.replace('tool = "gripper"', keys))
    speed = problem(
        folder, 'least_joint_speed = "estimated"\n', UNIT, CONTACTS, name="other.toml"
    )
    for one, why in (
        (ci.load_problem(tmp_path), "drift"),
        (speed, "least_joint_speed"),
    ):
        with pytest.raises(ci.ProblemError, match=f"streamed: .*{why}"):
            ci.fleet.stream_regression(one)


@pytest.mark.slow
def test_logs_of_sensors_and_of_feet_that_slip_are_streamed_whole(wrist, folder):
    # Below 0.1 m/s are three samples only: the filter leaves nothing of them.
    slip = problem(folder, "most_slip = 1.0\n", UNIT, CONTACTS, name="other.toml")
    for one in (wrist, slip):
        streamed = ci.fleet.stream_regression(one)
        whole = ci.build_regression(one.model, one.training)
        for mine, other in zip(streamed.factors, whole.factors, strict=True):
            np.testing.assert_allclose(
                mine, other, rtol=0, atol=1e-9 * abs(other).max()
            )


@pytest.mark.slow
def test_feet_that_are_said_to_be_balls_are_found_to_be_points(folder):
    """Their radius is 5 mm too large by the file; its error moves the trunk."""
    turned = UNIT + 'orientation = ["quat_w", "quat_x", "quat_y", "quat_z"]\n'
    balls = CONTACTS.replace("point =", "radius = 0.005\npoint =")
    parts = turned + 'order = "wxyz"\n', balls
    problem(folder, *parts, name="balls.toml")
    text = (folder / "balls.toml").read_text()
    text = text.replace("motion_cutoff", 'contact_radius = "estimated"\nmotion_cutoff')
    (folder / "balls.toml").write_text(text)
    found = ci.load_problem(folder / "balls.toml")
    feet = found.found_in_training.feet
    assert 0.0 < feet.standard_error < 5e-4
    assert abs(feet.offset + 0.005) < 4.0 * feet.standard_error + 5e-5
    for role in ("training", "validation"):
        (log,) = getattr(found, role)
        radii = [flags.radius for flags in log.contacts]
        assert radii == pytest.approx([0.005 + feet.offset] * 4, abs=1e-12)
    (variant,) = variant_regressions(found, found.training)
    whole = ci.build_regression(found.model, found.training)
    shifts = parameter_shifts(found.model, whole, [variant], found.constraints)
    assert (shifts.variance[:10] > 0.0).all()
    assert not shifts.variance[10:].any()  # legs are known


@pytest.mark.slow
def test_torque_that_is_stamped_early_is_found_corrected_and_named(folder):
    loaded = problem(folder, UNIT, CONTACTS, name="stamps.toml")
    assert loaded.found_in_training.delay is None
    text = (folder / "stamps.toml").read_text()
    text = text.replace("motion", 'delays = { torque = "estimated" }\nmotion', 1)
    (folder / "stamps.toml").write_text(text)
    found = ci.load_problem(folder / "stamps.toml")
    early = 2e-3  # s
    raw = loaded.read("training.csv")
    moved = ci.estimation.without_torque_delay(raw, early)
    found.keep({"training.csv": moved})
    delay = found.found_in_training.delay
    assert delay.significant
    assert delay.seconds == pytest.approx(-early, abs=2.0 * delay.half_width)
    (note,) = [f for f in check_problem(found).findings if f.kind == "lag"]
    assert note.severity == "note" and "earlier" in note.statement
    (variant,) = variant_regressions(found, found.training)
    whole = ci.build_regression(found.model, found.training)
    shifts = parameter_shifts(found.model, whole, [variant], found.constraints)
    assert (shifts.variance[:10] > 0.0).any()


@pytest.mark.slow
def test_the_trunk_of_the_shipped_walker_is_found_without_force_sensors():
    study = Study(ci.load_problem("problems/walker"))
    expected = study.problem.model.robot.links[0].nominal + BOX  # as it was simulated
    trunk = trunk_of(study.constrained)
    assert trunk.mass == pytest.approx(expected.mass, rel=1e-3)
    assert np.linalg.norm(trunk.com - expected.com) < 1e-3
    drives = study.constrained.parameters[study.problem.model.layout.inertial_size :]
    np.testing.assert_allclose(drives, 0.2, rtol=0, atol=0.02)  # N m s/rad


@pytest.mark.slow
def test_the_shipped_walker_has_a_verdict_by_command(capsys):
    assert main(["compare", "problems/walker", "--dry-run", "--json", "--quiet"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["verdict"] == "use" and not record["findings"]
    # Noise of 0.05 N m beside torques of up to 40.
    assert record["held_out_error"] < 0.01
