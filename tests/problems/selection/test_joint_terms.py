"""Terms joint by joint: what helps a joint stays, what does not is taken back."""

import re
from dataclasses import replace

import numpy as np
import pytest
from logged import URDF, moved, write_arm

from consistent_id import (
    DriveTerms,
    TorqueModel,
    draft_problem,
    load_problem,
    simulate_torque,
)
from consistent_id.cli import main
from consistent_id.problems.selection import model_selection
from consistent_id.problems.selection.band import (
    SAMPLES_PER_PARAMETER,
    explained_edge,
    least_band,
    narrowed,
)
from consistent_id.problems.selection.choice import (
    ModelMove,
    nearest_stribeck,
    setter,
    stribeck_moves,
    stribeck_passed,
    stribeck_velocities,
    term_moves,
    velocity_scale,
    with_drive,
    without,
)
from consistent_id.problems.selection.evaluation import _drive
from consistent_id.problems.selection.fits import Gain, HeldOut, gain, joint_gains
from consistent_id.problems.selection.forward_search import (
    State,
    _clear,
    proposals,
    without_needless_terms,
)
from consistent_id.problems.selection.gates import (
    LEAST_HELP,
    PLAIN,
    believable,
    better,
    clear,
    enough,
)
from consistent_id.problems.selection.setup import beginning
from consistent_id.robot import load_urdf


@pytest.mark.parametrize(
    ("share", "error", "won", "said"),
    [
        (0.10, 0.04, 1.0, True),
        (0.10, 0.06, 1.0, False),  # less than two standard errors
        (PLAIN, 0.30, 1.0, True),  # uneven, but large
        (0.10, 0.01, 0.5, False),  # on half of the blocks
        (0.9 * LEAST_HELP, 0.001, 1.0, False),
    ],
)
def test_a_term_is_believed_by_size_blocks_and_standard_error(share, error, won, said):
    assert believable(Gain(share, error, won)) is said


def test_what_clearly_helps_a_joint_and_harms_all_is_not_taken(begun):
    plain = begun.plain
    choice = with_drive(plain.choice, [0], setter(rotor_inertia=True))
    move = ModelMove("rotor_inertia", "rotor_inertia", plain.choice, choice)
    after = replace(plain, errors=HeldOut(plain.errors.squares * [0.5, 1.0]))
    gains = [Gain(share, 0.01, 1.0) for share in (0.02, -0.02)]
    said = [_clear(begun.evaluator, plain, (move, gain, after)) for gain in gains]
    assert said == [True, False]


@pytest.mark.parametrize(
    ("share", "error", "won", "said"),
    [
        (0.30, 0.10, 1.0, True),
        (0.30, 0.20, 1.0, False),  # by chance
        (0.10, 0.02, 1.0, False),  # sure, but small
        (0.30, 0.10, 0.5, False),
    ],
)
def test_a_clear_help_is_large_and_sure(share, error, won, said):
    assert clear(Gain(share, error, won)) is said
    assert better(Gain(share, error, won)) is (won > 0.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "error", "said"),
    [(0.07, 0.006, True), (0.04, 0.001, False), (0.08, 0.05, False)],
)
def test_a_delay_has_to_bring_twice_its_error_and_five_per_cent(
    begun, share, error, said
):
    choice = begun.plain.choice
    late = ModelMove("delay", "late", choice, replace(choice, delay=0.01))
    assert enough(late, Gain(share, error, 1.0)) is said


def test_a_delay_that_later_terms_make_needless_is_taken_back(begun):
    evaluator, plain = begun.evaluator, begun.plain
    late = evaluator.evaluated(replace(plain.choice, delay=0.01))
    states = list(without_needless_terms(evaluator, plain, State(late), begun.scope))
    assert states[-1].current.choice.delay == 0.0


def test_a_column_that_is_nothing_beside_the_torque_gets_no_coefficient():
    rng = np.random.default_rng(1)
    A, b = rng.normal(size=(2, 9, 3)), rng.normal(size=(2, 9))
    A[:, :, 1] *= 1e-200  # as of a Stribeck term far from rest
    y = _drive(A, b, np.array([True, False, True]))
    assert np.isfinite(y).all()
    assert (y[:, 1] == 0.0).all()
    alone = _drive(A[:, :, [0, 2]], b, np.array([True, True]))
    np.testing.assert_allclose(y[:, [0, 2]], alone, rtol=1e-9)


def test_gains_of_joints_are_those_of_their_own_errors():
    rng = np.random.default_rng(0)
    before = rng.uniform(1.0, 2.0, (14, 3))
    after = before * [1.0, 0.5, 1.2]
    found = joint_gains(HeldOut(before), HeldOut(after))
    assert [g.share for g in found] == pytest.approx([0.0, 0.5, -0.2])
    assert [g.won for g in found] == [0.0, 1.0, 0.0]
    alone = gain(HeldOut(before[:, 1:2]), HeldOut(after[:, 1:2]))
    assert found[1] == alone


def test_another_width_keeps_the_velocity_at_which_friction_fades():
    assert nearest_stribeck(0.1, 0.02) == pytest.approx(0.1)
    assert nearest_stribeck(0.1, 0.05) == pytest.approx(0.125, rel=0.05)
    assert nearest_stribeck(5.0, 0.02) == max(stribeck_velocities(0.02))


def test_other_velocities_at_which_friction_fades_are_for_joints_that_have_one(begun):
    choice = begun.plain.choice
    assert list(stribeck_moves(choice)) == []
    first = stribeck_velocities(velocity_scale(choice))[0]

    def fading(table):
        return type(table)(**(dict_of(table) | {"stribeck_velocity": first}))

    having = with_drive(choice, [1], fading)
    moves = list(stribeck_moves(having))
    tried = {move.after.drive[1].stribeck_velocity for move in moves}
    assert tried == set(stribeck_velocities(velocity_scale(choice))) - {first}
    assert all(move.after.drive[0] == choice.drive[0] for move in moves)


def test_a_stribeck_term_is_offered_to_joints_that_pass_twice_its_velocity(begun):
    choice = begun.plain.choice
    first, *_, last = stribeck_velocities(velocity_scale(choice))
    speeds = np.array([2.0 * first, 1.999 * last])
    offered = {
        move.label: move.lacking
        for move in term_moves(choice, [0, 1], [], [], speeds)
        if move.kind == "stribeck_velocity"
    }
    assert offered[f"stribeck_velocity = {first:g}"] == (0, 1)
    assert f"stribeck_velocity = {last:g}" not in offered
    assert 1 in set().union(*offered.values())
    # At twice its velocity the term is 2 % of what it is at rest.
    terms = DriveTerms(coulomb="sign", stribeck_velocity=last)
    still, twice = (np.array([v]) for v in (0.0, 2.0 * last))
    assert terms.columns(still, twice, still)[-1] == pytest.approx(0.018, abs=5e-4)


def test_a_velocity_that_a_move_leaves_alone_needs_no_motion(begun):
    choice = begun.plain.choice
    slow, fast = stribeck_velocities(velocity_scale(choice))[:2]
    having = with_drive(choice, [1], setter(stribeck_velocity=slow))
    moves = {m.label: m for m in stribeck_moves(having)}
    raised = moves[f"stribeck_velocity = {fast:g} where there is one"]
    assert stribeck_passed(raised, np.array([0.0, 2.0 * fast]))
    assert not stribeck_passed(raised, np.array([9.0, 1.999 * fast]))
    spring = with_drive(having, [1], setter(spring=True))
    assert stribeck_passed(ModelMove("spring", "", having, spring), np.zeros(2))


@pytest.mark.slow
def test_no_width_of_friction_moves_a_stribeck_velocity_past_the_motion(begun):
    evaluator, plain = begun.evaluator, begun.plain
    speeds = evaluator.samples(plain.choice.motion_cutoff).top_speeds
    wide = with_drive(plain.choice, [0, 1], setter(velocity_scale=0.11 * speeds.min()))
    velocity = stribeck_velocities(velocity_scale(wide))[0]
    current = evaluator.evaluated(
        with_drive(wide, [0, 1], setter(stribeck_velocity=velocity))
    )
    scales = (0.1 * speeds.min(), speeds.max())
    widths = begun.scope.widths[0]._replace(scales=scales)
    scope = replace(begun.scope, widths=(widths,), fixed=frozenset({"delay"}))
    tried = [p.move for p in proposals(evaluator, current, scope)]
    found = {velocity_scale(m.after) for m in tried if m.kind == "velocity_scale"}
    assert found == {scales[0]}
    assert not any(m.kind == "stribeck_value" for m in tried)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stated", "kept"),
    [
        ('coulomb = "tanh"\nstribeck_velocity = 0.137\n', "stribeck_velocity"),
        ('coulomb = "sign"\n', "velocity_scale"),
    ],
)
def test_kept_laws_have_their_columns_in_all_models(tmp_path, stated, kept):
    """A stated velocity is none of those that are tried, and a sign has no width."""
    folder = tmp_path / "problem"
    made = ["--cutoff", "10", "--output", str(folder), "--no-select"]
    assert main(["init", *map(str, write_arm(tmp_path)), *made]) == 0
    file = folder / "problem.toml"
    text = file.read_text().replace('coulomb = "tanh"\n', stated)
    if kept == "velocity_scale":
        text = re.sub("velocity_scale = .*\n", "", text)
    file.write_text(text)
    problem = load_problem(folder)
    found = beginning(problem, problem.logs("training"), (kept,), 10.0)
    evaluator, current = found.evaluator, found.plain
    moves = [p.move.after for p in proposals(evaluator, current, found.scope)]
    for choice in (current.choice, *moves):
        places = [joint.places for joint in evaluator.factors(choice).joints]
        for key in evaluator.candidate(choice).keys:
            assert any(key in own for own in places), (choice, key)
    first = getattr(current.choice.drive[0], kept)
    assert first == (0.137 if kept == "stribeck_velocity" else None)
    assert {getattr(choice.drive[0], kept) for choice in moves} == {first}


def dict_of(table):
    return {name: getattr(table, name) for name in table.__struct_fields__}


def test_terms_that_help_no_joint_are_taken_back(begun):
    evaluator, plain = begun.evaluator, begun.plain

    def more(table):
        return type(table)(**(dict_of(table) | {"load_friction": True, "spring": True}))

    richer = evaluator.evaluated(with_drive(plain.choice, [0, 1], more))
    states = list(without_needless_terms(evaluator, plain, State(richer), begun.scope))
    assert states[-1].current.choice == plain.choice
    assert all(step.gain.share > -0.0125 for step in states[-1].steps)


def test_a_term_of_the_plain_model_stays(begun):
    evaluator, plain = begun.evaluator, begun.plain

    def more(table):
        return type(table)(**(dict_of(table) | {"drag": True}))

    richer = evaluator.evaluated(with_drive(plain.choice, [0, 1], more))
    assert (
        list(without_needless_terms(evaluator, richer, State(richer), begun.scope))
        == []
    )


def test_a_fixed_kind_of_term_stays(begun):
    evaluator, plain = begun.evaluator, begun.plain

    def more(table):
        return type(table)(**(dict_of(table) | {"drag": True}))

    richer = evaluator.evaluated(with_drive(plain.choice, [0, 1], more))
    fixed = replace(begun.scope, fixed=frozenset({"drag"}))
    assert list(without_needless_terms(evaluator, plain, State(richer), fixed)) == []
    assert without(richer.choice, "drag", [0, 1]) == plain.choice


@pytest.mark.slow
def test_a_joint_without_drag_is_given_none(tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(URDF)
    robot = load_urdf(urdf)
    common = {"viscous": True, "coulomb": "tanh", "velocity_scale": 0.02}
    common["offset"] = True
    drive = (DriveTerms(**common, drag=True), DriveTerms(**common))
    model = TorqueModel(robot, drive)
    motion = moved(TorqueModel(robot, DriveTerms(**common)))
    x = [*robot.nominal, 2.0, 3.0, 0.5, 1.5, 1.0, 1.5, -0.3]
    assert len(x) == len(model.layout)
    still = replace(motion, torque=None, torque_filter=None)
    log = simulate_torque(
        model, np.array(x), still, noise=0.1, rng=np.random.default_rng(1)
    )
    chosen = draft_problem(urdf, replace(log, velocity=None, acceleration=None))
    assert [drive.drag for drive in chosen.selection.choice.drive] == [True, False]


def test_the_edge_is_where_the_model_explains_a_part(begun):
    evaluator, plain = begun.evaluator, begun.plain
    parts = evaluator.samples(plain.choice.motion_cutoff).parts
    model, x = plain.fits.candidate.model, plain.fits.parameters.mean(axis=0)
    rng = np.random.default_rng(3)
    noisy = []
    for part in parts:
        told = part.motion.along.predicted(model, x)
        n, step = len(told), float(np.median(np.diff(part.time)))
        noise = np.fft.rfft(rng.normal(size=told.shape), axis=0)
        noise[np.fft.rfftfreq(n, step) < 4.0] = 0.0
        noise = np.fft.irfft(noise, n, axis=0)
        # Above 4 Hz, nine tenths of the torque's power and more are noise.
        noisy.append(replace(part, torque=told + 10.0 * told.std(axis=0) * noise))
    assert explained_edge(noisy, plain.fits) == pytest.approx(4.0, abs=0.5)


def test_a_band_is_narrowed_and_never_widened():
    assert narrowed(250.0, 14.03) == 14.0
    assert narrowed(8.0, 14.0) == 8.0


def test_a_band_is_narrowed_to_ten_samples_for_each_parameter_and_no_further():
    least = least_band(44.5, 6, 54)
    # A band of B has 2 B independent samples a second.
    assert 2.0 * least * 44.5 * 6 == pytest.approx(SAMPLES_PER_PARAMETER * 54)
    assert narrowed(9.0, 0.5, least) == 1.0
    assert narrowed(9.0, 4.0, least) == 4.0
    assert narrowed(0.7, 0.5, least) == 0.7  # narrow from the start: never widened


def test_a_search_begins_in_no_band_that_has_too_few_samples(begun, monkeypatch):
    problem, bodies = begun.evaluator.setting.table, begun.evaluator.setting.bodies
    assert problem.constraints.bodies != "model"
    joints = len(bodies.torque_joints)
    # The plain model has friction, viscous and dry, and an offset at each joint.
    assert begun.parameters == len(begun.evaluator.setting.base) + 3 * joints
    raws = tuple(log.raw for log in begun.evaluator.setting.logs)
    seconds = sum(raw.duration for raw in raws)
    tried = []

    def beginning(_problem, _raws, _fixed, band):
        tried.append(band)
        setting = replace(begun.evaluator.setting, band=band)
        return replace(begun, evaluator=replace(begun.evaluator, setting=setting))

    monkeypatch.setattr(model_selection, "beginning", beginning)
    monkeypatch.setattr(model_selection, "prediction_band", lambda _: 40.0)
    monkeypatch.setattr(model_selection, "explained_edge", lambda *_: 0.01)
    model_selection._begun(None, raws, ())
    kept = 2.0 * tried[-1] * seconds * joints / begun.parameters
    assert tried[0] == 40.0 and len(tried) == 2
    assert kept == pytest.approx(SAMPLES_PER_PARAMETER, rel=0.05)  # two digits
