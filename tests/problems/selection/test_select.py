import re

import numpy as np
import pytest

from consistent_id import (
    DriveTerms,
    ProblemError,
    TorqueModel,
    draft_problem,
    load_problem,
    simulate_torque,
)
from consistent_id.cli import main
from consistent_id.problems import select_model
from consistent_id.problems.file import problem_table
from consistent_id.problems.selection import model_selection
from consistent_id.robot import load_urdf
from tests.helpers.logged import URDF, moved

PLAIN = {"viscous": True, "coulomb": "tanh", "velocity_scale": 0.02, "offset": True}
SIZES = {
    "viscous": 2.0,
    "coulomb": 3.0,
    "offset": 0.5,
    "rotor_inertia": 0.8,
    "spring": 6.0,
    "load_friction": 0.15,
    "stribeck": 2.0,
}


def written(folder, *, late=0, masses=1.0, **terms):
    """Write a robot, and a log of one with other drive terms and masses.

    `late` is in samples; `masses` are the file's over the robot's.
    """
    urdf, log = folder / "arm.urdf", folder / "log.csv"
    urdf.write_text(URDF)
    model = TorqueModel(load_urdf(urdf), DriveTerms(**PLAIN, **terms))
    motion = moved(TorqueModel(model.robot, DriveTerms(**PLAIN)))
    exact = moved(TorqueModel(model.robot, DriveTerms(**PLAIN)))
    dq = np.gradient(exact.position, exact.time, axis=0)
    states = type(exact)(
        exact.joints,
        exact.time,
        exact.position,
        dq,
        np.gradient(dq, exact.time, axis=0),
    )
    drive = [SIZES[name] for _, name in model.layout.drive]
    truth = np.append(model.robot.nominal, drive)
    recorded = simulate_torque(
        model, truth, states, noise=0.1, rng=np.random.default_rng(1)
    )
    torque = np.roll(recorded.torque, late, axis=0)
    table = np.column_stack([motion.time, motion.position, torque])
    header = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow"
    np.savetxt(log, table, "%.9g", ",", header=header, comments="")
    if masses != 1.0:
        scaled = re.sub(
            r'mass value="(\d+)"',
            lambda m: f'mass value="{masses * float(m[1])}"',
            URDF,
        )
        urdf.write_text(scaled)
    return urdf, log


def selected(folder, **truth):
    return draft_problem(*written(folder, **truth)).selection


def kinds(selection):
    return [step.move.kind for step in selection.steps]


@pytest.mark.slow
def test_a_robot_of_the_plain_model_gets_no_further_term(tmp_path):
    chosen = selected(tmp_path)
    assert set(kinds(chosen)) <= {"velocity_scale", "motion_cutoff"}
    assert chosen.choice.masses == "datasheet"
    assert chosen.choice.least_speed is None
    assert chosen.choice.couplings == ()


@pytest.mark.slow
@pytest.mark.parametrize("term", ["rotor_inertia", "load_friction", "spring"])
def test_a_term_that_the_robot_has_is_found(tmp_path, term):
    chosen = selected(tmp_path, **{term: True})
    assert term in kinds(chosen)
    having = [getattr(drive, term) for drive in chosen.choice.drive]
    assert any(having) if term == "spring" else all(having)
    others = set(kinds(chosen)) - {term, "velocity_scale", "motion_cutoff"}
    assert others == set()
    assert chosen.expected < 0.5 * chosen.plain


@pytest.mark.slow
def test_masses_that_the_data_contradict_are_given_up(tmp_path):
    assert selected(tmp_path, masses=4.0).choice.masses != "datasheet"


@pytest.mark.slow
def test_a_torque_that_is_late_is_seen(tmp_path):
    chosen = selected(tmp_path, late=3)
    assert chosen.choice.delay == pytest.approx(0.03, abs=0.006)


@pytest.mark.slow
def test_what_is_fixed_stays_as_the_file_has_it(tmp_path):
    urdf, log = written(tmp_path, masses=4.0, rotor_inertia=True)
    draft = draft_problem(
        urdf, log, masses="datasheet", drive=["viscous", "coulomb"], cutoff=12.0
    )
    choice = draft.selection.choice
    assert choice.masses == "datasheet"
    assert choice.motion_cutoff == 12.0
    drive = choice.drive[0]
    assert drive.viscous and drive.coulomb == "tanh"
    assert not (drive.offset or drive.rotor_inertia)


@pytest.mark.slow
def test_rows_for_validation_have_no_say(tmp_path):
    urdf, log = written(tmp_path, rotor_inertia=True)
    before = draft_problem(urdf, log)
    lines = log.read_text().splitlines()
    start = before.validation[0] + 200  # behind filters that the split itself uses
    rng = np.random.default_rng(5)
    for k in range(start, len(lines)):
        *motion, _, _ = lines[k].split(",")
        noise = [f"{value:.3f}" for value in 50.0 * rng.normal(size=2)]
        lines[k] = ",".join([*motion, *noise])
    log.write_text("\n".join(lines) + "\n")
    after = draft_problem(urdf, log)
    assert after.selection.choice == before.selection.choice
    gains = [
        [step.gain.share for step in draft.selection.steps] for draft in (before, after)
    ]
    np.testing.assert_array_equal(*gains)


@pytest.mark.slow
def test_a_log_for_validation_need_not_even_be_there(tmp_path):
    draft = draft_problem(*written(tmp_path), select=False)
    text = draft.text(tmp_path)
    head, _, tail = text.rpartition('file = "log.csv"')
    (tmp_path / "problem.toml").write_text(f'{head}file = "nowhere.csv"{tail}')
    problem = load_problem(tmp_path)
    assert problem.missing == ("nowhere.csv",)
    assert select_model(problem).choice.motion_cutoff is not None


@pytest.mark.slow
def test_the_text_holds_exactly_what_was_chosen_and_says_why(tmp_path):
    urdf, log = written(tmp_path, rotor_inertia=True)
    draft = draft_problem(urdf, log)
    text = draft.text(tmp_path)
    assert problem_table(text, tmp_path) == draft.table(tmp_path)
    assert "# rotor_inertia of all joints: " in text
    assert "rotor_inertia = true" in text
    (tmp_path / "problem.toml").write_text(text)
    selection = select_model(load_problem(tmp_path))
    assert selection.choice == draft.selection.choice
    assert problem_table(selection.text(), tmp_path) == selection.table_of_problem
    assert selection.chosen().model.fingerprint == draft.problem().model.fingerprint


@pytest.mark.slow
def test_without_torque_no_model_is_chosen(tmp_path):
    urdf, log = written(tmp_path)
    table = np.genfromtxt(log, delimiter=",", names=True)
    table["tau_elbow"] = 0.0
    columns = {name: table[name] for name in table.dtype.names}
    draft = draft_problem(urdf, columns)
    assert draft.selection is None
    assert any("torque of elbow is zero in all training" in n for n in draft.notes)


@pytest.mark.slow
def test_an_interrupted_search_says_so_and_keeps_the_best_so_far(tmp_path, monkeypatch):
    urdf, log = written(tmp_path, rotor_inertia=True, spring=True)
    problem = draft_problem(urdf, log, select=False).problem()
    search = model_selection.better_models

    def interrupted(*arguments):
        states = search(*arguments)
        yield next(states)
        yield next(states)
        raise KeyboardInterrupt

    monkeypatch.setattr(model_selection, "better_models", interrupted)
    selection = select_model(problem)
    assert len(selection.steps) == 1
    assert "interrupted: this is the best choice so far" in selection.notes


@pytest.mark.slow
def test_what_cannot_be_chosen_is_refused(tmp_path):
    problem = draft_problem(*written(tmp_path), select=False, cutoff=10.0).problem()
    with pytest.raises(ProblemError, match="fixed: colour unknown; expected some of"):
        select_model(problem, fixed=["colour"])
    with pytest.raises(ProblemError, match="has no recordings"):
        select_model(load_problem("problems/rx60"))
    with pytest.raises(ProblemError, match="no drive term 'rotor'"):
        draft_problem(*written(tmp_path), drive=["rotor"])


@pytest.mark.slow
def test_the_command_writes_the_file_and_overwrites_none(tmp_path, capsys):
    urdf, log = written(tmp_path, rotor_inertia=True)
    draft = draft_problem(urdf, log, select=False)
    file = tmp_path / "problem.toml"
    file.write_text(draft.text(tmp_path))
    assert main(["select", str(file)]) == 0
    chosen = load_problem(tmp_path / "problem-selected.toml")
    assert chosen.table.drive.rotor_inertia
    assert "rotor_inertia of all joints" in capsys.readouterr().out
    selected = tmp_path / "problem-selected.toml"
    first = selected.read_text()
    assert main(["select", str(file)]) == 0  # nobody has edited what it wrote
    assert selected.read_text() == first
    selected.write_text(first.replace("name = ", "# mine\nname = "))
    assert main(["select", str(file)]) == 2
    assert "was edited since" in capsys.readouterr().err
    assert "# mine" in selected.read_text()
    elsewhere = tmp_path / "other" / "problem.toml"
    assert main(["select", str(file), "--output", str(elsewhere)]) == 2
    assert "is not in the folder of" in capsys.readouterr().err


@pytest.mark.slow
def test_the_first_line_says_how_the_plain_model_predicts(tmp_path, capsys):
    draft = draft_problem(*written(tmp_path, rotor_inertia=True), progress=True)
    said = re.search(
        r"model: plain model, left-out error ([\d.]+) %", capsys.readouterr().err
    )
    assert float(said[1]) == pytest.approx(100 * draft.selection.plain, rel=0.1)
