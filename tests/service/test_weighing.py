"""Loads weighed from the logs of a user, in Python and in the shell."""

import json
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import carrying
import msgspec
import numpy as np
import pinocchio as pin
import pytest
from carrying import FLANGE, LOAD, write_log, write_robot
from schemas import parsed
from shown import assert_reached

from consistent_id import (
    ModelError,
    ProblemError,
    RecordingError,
    draft_problem,
    load_problem,
)
from consistent_id.cli import main
from consistent_id.constraints import FixedParameters
from consistent_id.service import weigh_load
from consistent_id.service.load_quantities import reasons_of_mass
from consistent_id.service.loaded_runs import LoadedRuns
from consistent_id.service.weighing import _of_assumed_gains

PLAIN = {"select": False, "cutoff": 8.0}
WORDS = ["--no-select", "--cutoff", "8"]
CENTRAL = LOAD.central_inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
TRUTH = np.concatenate([[LOAD.mass], LOAD.com, CENTRAL])
GAINS = np.array([1.0, 1.1, 0.9, 1.0])


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The robot, and logs without and with the load."""
    folder = tmp_path_factory.mktemp("carrying")
    return {
        "robot": write_robot(folder),
        "empty": write_log(folder / "empty.csv", None),
        "again": write_log(folder / "again.csv", None, seed=2),
        "loaded": write_log(folder / "loaded.csv", LOAD, seed=1),
    }


@pytest.fixture(scope="module")
def problem(files):
    return draft_problem(files["robot"], files["empty"], **PLAIN).problem()


@pytest.fixture(scope="module")
def found(problem, files):
    return weigh_load(problem, files["loaded"], link="flange", tool="tcp")


@pytest.mark.slow
def test_a_load_is_weighed_in_the_frame_of_the_flange(found):
    assert_reached("tests/service/test_weighing.py", found)
    flange = found.in_flange
    assert found.verdict.word == "use"
    assert flange.frame == "flange"
    assert abs(flange.body.mass - LOAD.mass) < 0.03
    assert np.linalg.norm(flange.body.com - LOAD.com) < 3e-3
    # Ten intervals of 95 %, of one log: all ten contain the truth in most cases.
    inside = (flange.low < TRUTH) & (flange.high > TRUTH)
    assert inside.sum() >= 9
    assert (flange.high - flange.low < 0.3 * np.maximum(abs(TRUTH), 0.1)).all()
    assert found.payload.body.is_consistent()
    assert not found.inertia_open


@pytest.mark.slow
def test_the_tool_s_frame_is_that_of_the_file(found):
    turned = pin.SE3(pin.rpy.rpyToMatrix(0, 0, np.pi / 2), np.array([0, 0, 0.2]))
    expected = turned.actInv(found.in_flange.body.com)
    np.testing.assert_allclose(found.in_tool.body.com, expected, atol=1e-12)
    controller = found.for_controller
    np.testing.assert_allclose(controller.in_tool.com, expected, atol=1e-12)
    assert (controller.link, controller.flange.name) == ("link3", "flange")
    place = pin.SE3(controller.flange.rotation, controller.flange.translation)
    np.testing.assert_allclose(place.homogeneous, FLANGE.homogeneous, atol=1e-12)


@pytest.mark.slow
def test_a_tool_s_place_is_given_in_the_frame_of_the_flange(problem, files, found):
    place = [0.0, 0.0, 0.2, 0.0, 0.0, np.pi / 2]
    other = weigh_load(problem, files["loaded"], link="flange", tool=place)
    np.testing.assert_allclose(
        other.in_tool.values, found.in_tool.values, rtol=1e-9, atol=1e-12
    )
    assert other.in_tool.frame == "tool"


@pytest.fixture(scope="module")
def still_files(tmp_path_factory):
    """The robot, and logs of poses at rest without and with the load."""
    folder = tmp_path_factory.mktemp("still")
    logs = [
        write_log(folder / f"{name}.csv", load, still=True, seed=seed)
        for seed, (name, load) in enumerate({"empty": None, "loaded": LOAD}.items())
    ]
    return write_robot(folder), *logs


@pytest.fixture(scope="module")
def still(still_files):
    robot, empty, loaded = still_files
    problem = draft_problem(robot, empty, select=False, cutoff=2.0).problem()
    return weigh_load(problem, loaded, link="flange")


@pytest.mark.slow
def test_poses_at_rest_show_mass_and_centre_of_mass_alone(still):
    assert still.inertia_open
    assert [r.kind for r in still.verdict.grounds] == ["inertia is open"]
    body = still.in_flange.body
    assert abs(body.mass - LOAD.mass) < 0.05
    assert np.linalg.norm(body.com - LOAD.com) < 5e-3
    assert not still.for_controller.inertia.any()


@pytest.mark.slow
def test_without_a_load_none_is_seen(problem, files):
    found = weigh_load(problem, files["again"], link="flange")
    assert found.verdict.word == "do not use"
    assert "no load is seen" in [r.kind for r in found.verdict.grounds]
    with pytest.raises(ProblemError, match="no load is seen: the mass is"):
        found.for_controller  # noqa: B018
    overlooked = weigh_load(
        problem,
        files["again"],
        accepted=["no load is seen", "inertia is open", "misfit"],
    )
    assert overlooked.verdict.word == "use"
    with pytest.raises(ProblemError, match="no load is seen: the mass is"):
        overlooked.for_controller  # noqa: B018


@pytest.mark.slow
def test_arms_of_vertical_axes_do_not_show_the_height_of_the_centre(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(carrying, "_AXES", ("0 0 1",) * 4)
    logs = [
        write_log(tmp_path / f"{name}.csv", load, seed=seed)
        for seed, (name, load) in enumerate({"empty": None, "loaded": LOAD}.items())
    ]
    problem = draft_problem(write_robot(tmp_path), logs[0], **PLAIN).problem()
    found = weigh_load(problem, logs[1], link="flange")
    assert found.verdict.word == "do not use"
    (ground,) = [r for r in found.verdict.grounds if r.kind.startswith("centre of")]
    assert "along x of the frame flange" in ground.statement  # it is vertical


@pytest.mark.slow
def test_a_stated_mass_is_kept_and_a_right_one_contradicts_nothing(problem, files):
    found = weigh_load(problem, files["loaded"], link="flange", known_mass=2.0)
    assert found.in_flange.body.mass == pytest.approx(2.0, rel=1e-6)
    stated = weigh_load(problem, files["loaded"], link="flange", known_mass=LOAD.mass)
    assert stated.in_flange.body.mass == pytest.approx(LOAD.mass, rel=1e-6)
    kinds = {r.kind for r in stated.verdict.reasons}
    assert "mass contradicts the scale" not in kinds


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scale", "kinds"), [(3.0, ()), (2.0, ("mass contradicts the scale",))]
)
def test_the_scale_s_mass_is_compared_with_that_of_the_torques(found, scale, kinds):
    assert tuple(r.kind for r in reasons_of_mass(found.payload, scale)) == kinds


def test_a_mass_of_a_wide_interval_is_used_with_care(found):
    covariance = found.payload.covariance.copy()
    covariance[0, 0] = (0.2 * LOAD.mass) ** 2
    (reason,) = reasons_of_mass(replace(found.payload, covariance=covariance), None)
    assert (reason.kind, reason.word) == ("mass is uncertain", "use with care")


@pytest.mark.parametrize("name", ["a\nrm", "2nd", "", "a" * 33, "a-b"])
def test_a_name_that_files_cannot_hold_is_refused(problem, files, name):
    with pytest.raises(ModelError, match="name of the load is"):
        weigh_load(problem, files["loaded"], name=name)


def test_files_say_verdict_and_interval_of_the_mass(found):
    assert "; use (accepted: nothing); mass 3" in found.for_controller.mark


@pytest.mark.slow
def test_a_known_mass_shows_and_corrects_gains_that_are_off(files, tmp_path):
    empty = write_log(tmp_path / "empty.csv", None, gains=GAINS)
    loaded = write_log(tmp_path / "loaded.csv", LOAD, gains=GAINS, seed=1)
    problem = draft_problem(files["robot"], empty, **PLAIN).problem()
    wrong = weigh_load(problem, loaded, link="flange")
    assert wrong.in_flange.high[0] < LOAD.mass or wrong.in_flange.low[0] > LOAD.mass
    found = weigh_load(problem, loaded, link="flange", known_mass=LOAD.mass)
    assert found.corrected
    assert "gains are off" in [r.kind for r in found.verdict.grounds]
    # Joints that gravity loads; j0 turns about the vertical.
    np.testing.assert_allclose(found.gains.gains[1:], GAINS[1:], rtol=0.03)
    assert found.in_flange.body.mass == pytest.approx(LOAD.mass, rel=1e-6)
    assert np.linalg.norm(found.in_flange.body.com - LOAD.com) < 3e-3
    assert found.in_flange.low[0] < LOAD.mass < found.in_flange.high[0]


@pytest.mark.slow
def test_right_gains_are_left_alone(problem, files):
    found = weigh_load(problem, files["loaded"], known_mass=LOAD.mass)
    assert not found.corrected
    assert "gains are off" not in [r.kind for r in found.verdict.reasons]
    assert len(found.tables()) == 3


@pytest.mark.slow
def test_gains_of_the_models_bodies_are_doubted_until_a_known_mass_tests_them(files):
    stated = {**PLAIN, "torque_gain": [1.0] * 4, "gain_source": "model"}
    assumed = draft_problem(files["robot"], files["empty"], **stated).problem()
    weighed = weigh_load(assumed, files["loaded"], link="flange")
    (reason,) = weighed.verdict.grounds
    assert (weighed.verdict.word, reason.kind) == ("use with care", "assumed gains")
    assert "--gain-errors" in reason.advice
    tested = weigh_load(assumed, files["loaded"], link="flange", known_mass=LOAD.mass)
    assert "assumed gains" not in {r.kind for r in tested.verdict.reasons}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("column", "gain", "doubted"),
    [
        ("current_{joint}", [1.0] * 4, True),
        ("current_{joint}", 1.0, True),
        ("current_{joint}", [1.0, 1.0, 2.0, 1.0], False),
        ("tau_{joint}", 1.0, False),
    ],
)
def test_currents_with_the_gain_1_are_doubted(problem, column, gain, doubted):
    data = problem.table.data
    columns = msgspec.structs.replace(data.columns, torque=column)
    data = msgspec.structs.replace(data, columns=columns, torque_gain=gain)
    stated = replace(problem, table=msgspec.structs.replace(problem.table, data=data))
    reasons = list(_of_assumed_gains(stated, SimpleNamespace(gains=None), 0.0))
    assert [reason.kind for reason in reasons] == ["assumed gains"] * doubted
    assert all("consistent-id gains" in reason.advice for reason in reasons)
    tested = SimpleNamespace(gains="of a known mass")
    assert not list(_of_assumed_gains(stated, tested, 0.0))


def test_frames_that_make_no_sense_are_refused(problem, files):
    loaded = files["loaded"]
    with pytest.raises(ModelError, match="no link named"):
        weigh_load(problem, loaded, link="hand")
    with pytest.raises(ProblemError, match=r"'base' does not move"):
        weigh_load(problem, loaded, link="base")
    with pytest.raises(ProblemError, match="is not fixed to 'link1'"):
        weigh_load(problem, loaded, link="link1", tool="tcp")
    with pytest.raises(ProblemError, match=r"expected x, y, z \[m\]"):
        weigh_load(problem, loaded, tool=[0.1, 0.2])
    with pytest.raises(ProblemError, match=r"nowhere\.csv: no such file"):
        weigh_load(problem, "nowhere.csv")
    with pytest.raises(ProblemError, match="expected at least one"):
        weigh_load(problem, [])
    with pytest.raises(ProblemError, match="expected more than 0 kg"):
        weigh_load(problem, loaded, known_mass=-1.0)
    with pytest.raises(ProblemError, match="the first and the last"):
        weigh_load(problem, loaded, rows=[1, 2, 3])
    with pytest.raises(ProblemError, match="has no recordings"):
        weigh_load(load_problem("problems/rx60"), loaded)


@pytest.mark.slow
def test_rows_are_those_of_the_logs_with_the_load(problem, files):
    whole = weigh_load(problem, files["loaded"], link="flange")
    quarter = weigh_load(problem, files["loaded"], link="flange", rows=(1, 250))
    # Half of the variance is that of the log without the load: (1 + 4) / 2 times.
    widths = [w.in_flange.high[0] - w.in_flange.low[0] for w in (whole, quarter)]
    assert widths[1] > 1.3 * widths[0]


@pytest.mark.slow
def test_the_shell_writes_what_controllers_take(files, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["payload", files["robot"], files["empty"], "--loaded", files["loaded"]]
    words += [*WORDS, "--link", "flange", "--tool", "0,0,0.2", "--output", out]
    assert main([*map(str, words), "--controller", "ur", "mjcf"]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("use: payload\n")
    assert "The load in the frame flange" in shown and "frame tool" in shown
    written = {file.name for file in out.iterdir()}
    assert written == {"payload.script", "payload.xml", "payload.json"}
    record = json.loads((out / "payload.json").read_text())
    mass = record["frames"]["flange"]["m"]
    assert mass["low"] < LOAD.mass < mass["high"]
    assert record["verdict"] == "use" and record["consistent"]
    assert main([*map(str, words), "--controller", "kuka"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "has payload.script, payload.xml of an earlier run: delete them" in said
    again = json.loads((out / "payload.json").read_text())
    assert again["files_of_earlier_runs"] == ["payload.script", "payload.xml"]
    assert main([*map(str, words), "--json", "--dry-run"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == record["frames"]
    (out / "load_data.dat").write_text("; consistent-id: mine\n")
    assert main([*map(str, words), "--controller", "kuka"]) == 2  # an edited file


@pytest.mark.parametrize("name", ["2nd", "record"])
def test_the_shell_refuses_a_name_before_it_reads_logs(tmp_path, capsys, name):
    words = ["payload", "no.urdf", "no.csv", "--loaded", "no.csv", "--name", name]
    assert main([*words, "--output", str(tmp_path / "out")]) == 2
    assert f"name of the load is {name!r}" in capsys.readouterr().err


@pytest.mark.slow
def test_the_shell_writes_nothing_of_a_load_that_is_not_seen(files, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["payload", files["robot"], files["empty"], "--loaded", files["again"]]
    assert main([*map(str, [*words, *WORDS]), "--output", str(out)]) == 1
    assert "no load is seen" in capsys.readouterr().out
    assert not out.exists()


@pytest.mark.slow
def test_a_folder_of_results_stands_for_the_robot(files, tmp_path, capsys):
    out = tmp_path / "robot"
    words = ["identify", files["robot"], files["empty"], *WORDS, "--output", out]
    assert main(list(map(str, words))) == 0
    capsys.readouterr()
    loaded = ["--loaded", str(files["loaded"]), "--link", "flange", "--json"]
    assert main(["payload", str(out), *loaded]) == 0
    mass = parsed(capsys.readouterr().out)["frames"]["flange"]["m"]
    assert mass["low"] < LOAD.mass < mass["high"]


@pytest.mark.slow
@pytest.mark.skipif(
    "CONSISTENT_ID_DATASETS" not in os.environ,
    reason="CONSISTENT_ID_DATASETS does not name the folder of recordings",
)
def test_the_ur10e_s_known_mass_shows_that_the_authors_gains_are_off():
    problem = load_problem("problems/ur10e")
    folder = Path(os.environ["CONSISTENT_ID_DATASETS"], "ur10e", "payload")
    log = folder / "ur-20_02_19_14harm50secLoad.parquet"
    settings = {"rows": (308, 5071), "link": "tool0"}
    stated = weigh_load(problem, log, **settings)
    assert stated.in_flange.high[0] < 2.6  # it weighs 2.805 kg
    assert "assumed to be exact" in stated.payload.condition
    found = weigh_load(problem, log, known_mass=2.805, **settings)
    assert found.corrected
    (ground,) = [r for r in found.verdict.grounds if r.kind == "gains are off"]
    assert "5 of 6 joints" in ground.statement
    assert found.in_flange.low[0] < 2.805 < found.in_flange.high[0]
    # Gains that were identified with the other loaded log, as payload.toml has them.
    other = np.array([11.86, 12.22, 10.04, 10.63, 10.37, 10.44])
    authors = np.array(problem.table.data.torque_gain)
    gains = found.gains.gains * authors
    np.testing.assert_allclose(gains, other, rtol=0.05)
    # The other loaded log, in which the load is turned by half a turn.
    weighed = weigh_load(
        load_problem("problems/ur10e", torque_gain=gains.tolist()),
        folder / "ur-20_02_19_15harm50secLoad.parquet",
        rows=(330, 5000),
        omit=(1, 2),
        link="tool0",
        gain_errors=found.gains.relative_errors,
    ).in_flange
    assert weighed.low[0] < 2.805 < weighed.high[0]
    assert weighed.body.mass == pytest.approx(2.805, rel=0.01)
    turned = found.in_flange.body.com * [-1.0, -1.0, 1.0]
    np.testing.assert_allclose(weighed.body.com, turned, atol=0.01)


@pytest.mark.slow
def test_a_load_on_another_link_is_not_weighed(problem, files, found):
    wrong = weigh_load(problem, files["loaded"], link="link2")
    assert wrong.verdict.word == "do not use"
    (ground,) = [r for r in wrong.verdict.grounds if r.kind.startswith("not attached")]
    assert "with the load on link3 instead of link2" in ground.statement
    assert "--link link3" in ground.advice
    with pytest.raises(ProblemError, match="not attached to this link"):
        wrong.for_controller  # noqa: B018
    assert "not attached to this link" not in [r.kind for r in found.verdict.reasons]


def test_drafts_and_data_frames_are_refused_with_the_call_to_make(problem, files):
    draft = draft_problem(files["robot"], files["empty"], **PLAIN)
    with pytest.raises(ProblemError, match=r"a Draft, expected a Problem; .*problem\("):
        weigh_load(draft, files["loaded"])
    with pytest.raises(ProblemError, match="load_problem"):
        weigh_load(str(files["robot"]), files["loaded"])
    with pytest.raises(ProblemError, match="a dict, expected the path of a file"):
        weigh_load(problem, {"time": [0.0, 0.1]})


def test_a_broken_row_of_a_loaded_log_is_left_out_by_its_own_option(
    problem, files, tmp_path
):
    header, first, second, *rest = files["loaded"].read_text().splitlines()
    broken = ",".join(["x", *second.split(",")[1:]])
    log = tmp_path / "broken.csv"
    log.write_text("\n".join([header, first, broken, *rest]))
    with pytest.raises(RecordingError) as raised:
        weigh_load(problem, log, link="flange")
    assert raised.value.options == "--loaded-omit 2"
    assert "--loaded-omit 2 (omit = [2])" in str(raised.value)
    assert " --omit" not in str(raised.value)


@pytest.mark.slow
def test_misfits_of_links_are_those_of_least_squares(problem, files, found):
    """The misfit of the load's own link is the sum over samples of its fit."""
    robot, runs = found.payload.robot, LoadedRuns(problem, (files["loaded"],), None, ())
    loaded, unloaded = runs.read({})
    residuals = robot.residuals(
        found.payload.least_squares.parameters, unloaded, loaded
    )
    sigma = np.sqrt(np.mean(residuals**2, axis=1))
    misfits = robot.misfits(unloaded, loaded, sigma)
    # Weights of the fit are those of effective samples: nearly, not just, the same.
    assert misfits[robot.carrier] == pytest.approx(residuals.size, rel=1e-2)
    assert misfits.argmin() == robot.carrier


@pytest.mark.slow
def test_poses_show_the_load_although_friction_differs_by_direction(still_files):
    """The logs have an offset, which asymmetric dry friction equals in motion alone."""
    robot, empty, loaded = still_files
    problem, other = (
        draft_problem(
            robot, empty, select=False, cutoff=2.0, drive=("viscous", "coulomb", term)
        ).problem()
        for term in ("asymmetric", "offset")
    )
    assert all(term.asymmetric for term in problem.model.terms)
    found = weigh_load(problem, loaded, link="flange").in_flange
    expected = weigh_load(other, loaded, link="flange").in_flange
    np.testing.assert_allclose(found.values, expected.values, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.low[:4], expected.low[:4], rtol=1e-6)
    assert found.low[0] < LOAD.mass < found.high[0]
    # Models whose constraints name the two levels keep them.
    stated = FixedParameters({"j0.coulomb_positive": 0.9})
    kept = replace(problem, constraints=(*problem.constraints, stated))
    assert LoadedRuns(kept, (loaded,), None, ()).model is kept.model


@pytest.mark.slow
def test_poses_may_be_recorded_one_after_another(still_files, still, tmp_path):
    """Rests of two seconds, with gaps of the clock in place of the moves."""
    robot, empty, loaded = still_files
    head, *rows = loaded.read_text().splitlines()
    table = np.array([[float(word) for word in row.split(",")] for row in rows])
    rests = table[np.arange(len(table)) % (22 * 50) < 2 * 50]  # at 50 Hz
    file = tmp_path / "rests.csv"
    np.savetxt(file, rests, "%.9g", ",", header=head, comments="")
    problem = draft_problem(robot, empty, select=False, cutoff=2.0).problem()
    assert problem.table.data.preparation.max_gap is None
    found = weigh_load(problem, file, link="flange")
    assert abs(found.in_flange.body.mass - LOAD.mass) < 0.05
    assert np.linalg.norm(found.in_flange.body.com - LOAD.com) < 5e-3
    poses = tmp_path / "poses.csv"
    np.savetxt(poses, rests[::100], "%.9g", ",", header=head, comments="")
    with pytest.raises(ProblemError, match="A row for each pose is not enough"):
        weigh_load(problem, poses, link="flange")


@pytest.mark.slow
def test_stamps_of_loaded_logs_may_jitter(problem, files, found, tmp_path):
    head, *rows = files["loaded"].read_text().splitlines()
    table = np.array([[float(word) for word in row.split(",")] for row in rows])
    # A fifth of a step at most: the motion is that of the stamps, to 0.1 %.
    table[:, 0] += np.random.default_rng(0).uniform(-2e-3, 2e-3, len(table))
    file = tmp_path / "jitter.csv"
    np.savetxt(file, table, "%.9g", ",", header=head, comments="")
    assert problem.table.data.preparation.resample is None
    again = weigh_load(problem, file, link="flange").in_flange
    half = 0.5 * (found.in_flange.high[0] - found.in_flange.low[0])
    assert abs(again.body.mass - found.in_flange.body.mass) < half
    with pytest.raises(ProblemError, match="rows 90000 to 90100, but the file has"):
        weigh_load(problem, file, link="flange", rows=(90_000, 90_100))
