"""Compiled code gives NumPy's numbers, is used when it pays, and is never needed."""

import os
import stat
import subprocess
import sys

import numpy as np
import pytest
from compiled_code import needs_compiler, without
from published_robots import FILES
from robots import random_robot, random_states
from some_fast import some_fast

from consistent_id.recordings.base_motion import BaseMotion
from consistent_id.recordings.recording import Recording
from consistent_id.regression.compiled import compiler, entries, sines
from consistent_id.regression.compiled.straight_line import LANES, Tape
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.regression import build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_names import BASE_ROWS
from consistent_id.robot.loaders.urdf import load_urdf

DRIVE = DriveTerms(viscous=True, coulomb="sign", offset=True, rotor_inertia=True)
ROBOTS = [(6, True, 4), (7, False, 3), (1, False, 1)]


def case(joints=4, tree=False, seed=2, samples=200, drive=DRIVE):
    rng = np.random.default_rng(seed)
    _, robot = random_robot(rng, joints, tree=tree)
    return TorqueModel(robot, drive), random_states(rng, joints, samples), rng


def files(folder):
    return sorted(path.name for path in folder.glob("*"))


@needs_compiler
@pytest.mark.parametrize(("joints", "tree", "seed"), ROBOTS)
@pytest.mark.parametrize("samples", some_fast([LANES + 1, LANES, 100]))
def test_compiled_regressor_has_the_bits_of_numpys(
    joints, tree, seed, samples, monkeypatch, cache
):
    model, states, _ = case(joints, tree, seed, samples)
    truth = without(monkeypatch, lambda: model.regressor(*states))
    assert not cache.exists()
    for _ in range(3):  # by NumPy, and by what was compiled
        np.testing.assert_array_equal(model.regressor(*states), truth)
    assert len(files(cache)) == 1
    assert entries._recursion.cache_info().currsize == 1


@needs_compiler
@pytest.mark.skipif(not FILES, reason="example-robot-data is missing")
def test_compiled_rows_of_a_floating_base_have_the_bits_of_numpys(monkeypatch, cache):
    path = next(path for path in FILES if path.stem == "go2")
    robot = load_urdf(path, base="floating")
    model = TorqueModel(robot, torque_joints=(*BASE_ROWS, *robot.joint_names))
    rng = np.random.default_rng(0)
    states = random_states(rng, len(robot), 100)
    base = BaseMotion(*rng.normal(size=(3, 100, 3)))
    truth = without(monkeypatch, lambda: model.regressor(*states, base=base))
    for _ in range(3):
        np.testing.assert_array_equal(model.regressor(*states, base=base), truth)
    assert len(files(cache)) == 1


@needs_compiler
@pytest.mark.parametrize(("joints", "tree", "seed"), some_fast(ROBOTS[::-1]))
def test_factors_are_the_same_with_and_without(joints, tree, seed, monkeypatch):
    model, states, rng = case(joints, tree, seed, samples=9000)
    torque = rng.normal(size=states[0].shape)
    time = 0.01 * np.arange(len(torque))
    log = Recording(model.robot.joint_names, time, *states, torque)
    truth = without(monkeypatch, lambda: build_regression(model, log))
    for _ in range(3):
        found = build_regression(model, log)
        for one, other in zip(found.factors, truth.factors, strict=True):
            # Rows of columns that others give are arbitrary; their product is not.
            product = other.T @ other
            error = abs(one.T @ one - product).max()
            assert error <= 1e-13 * abs(product).max()


@needs_compiler
def test_what_was_compiled_is_loaded_and_not_compiled_again(monkeypatch, cache):
    model, states, _ = case()
    for _ in range(3):
        truth = model.regressor(*states)
    (name,) = files(cache)
    written = (cache / name).stat().st_mtime_ns
    entries._recursion.cache_clear()
    monkeypatch.setattr(compiler, "_compiler", lambda: None)
    np.testing.assert_array_equal(model.regressor(*states), truth)
    (recursion,) = [entries._recursion(*key) for key in [_key(model, states)]]
    assert recursion.found is not None
    assert (cache / name).stat().st_mtime_ns == written


def _key(model, states):
    """What `_recursion` is asked for."""
    seen = []
    real = entries._recursion

    def noted(*key):
        seen.append(key)
        return real(*key)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(entries, "_recursion", noted)
        model.regressor(*states)
    return seen[0]


@needs_compiler
def test_a_damaged_file_is_never_loaded(cache):
    model, states, _ = case()
    for _ in range(3):
        truth = model.regressor(*states)
    (name,) = files(cache)
    whole = (cache / name).read_bytes()
    # A new file: half of one that this process has loaded would pull the rug out.
    (cache / "half").write_bytes(whole[: len(whole) // 2])
    (cache / "half").rename(cache / name)
    entries._recursion.cache_clear()
    for _ in range(3):
        np.testing.assert_array_equal(model.regressor(*states), truth)
    assert (cache / name).read_bytes() == whole  # compiled again


@needs_compiler
@pytest.mark.parametrize("mode", [0o770, 0o707])
def test_a_folder_that_others_can_write_to_is_not_used(cache, mode):
    cache.mkdir(parents=True)
    cache.chmod(mode)
    model, states, _ = case()
    for _ in range(3):
        model.regressor(*states)
    assert files(cache) == []
    assert stat.S_IMODE(cache.stat().st_mode) == mode


@needs_compiler
def test_a_link_to_another_folder_is_not_used(cache, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    cache.parent.mkdir(parents=True)
    cache.symlink_to(elsewhere)
    model, states, _ = case()
    for _ in range(3):
        model.regressor(*states)
    assert files(elsewhere) == []


@needs_compiler
def test_code_that_computes_something_else_is_not_used(monkeypatch):
    model, states, _ = case()
    truth = without(monkeypatch, lambda: model.regressor(*states))
    right = Tape.source
    monkeypatch.setattr(Tape, "source", lambda *a: right(*a).replace("+ t", "- t"))
    for _ in range(3):
        np.testing.assert_array_equal(model.regressor(*states), truth)


@pytest.mark.parametrize("broken", ["/bin/false", "/no/such/compiler", None])
def test_without_a_compiler_that_works_numpy_goes_on_in_silence(
    broken, monkeypatch, cache
):
    model, states, _ = case()
    truth = without(monkeypatch, lambda: model.regressor(*states))
    monkeypatch.setattr(compiler, "_compiler", lambda: broken)
    for _ in range(3):
        np.testing.assert_array_equal(model.regressor(*states), truth)
    assert files(cache) == []


def test_a_short_recording_does_not_wait_for_a_compiler(monkeypatch, cache):
    monkeypatch.setattr(entries, "COMPILE_AFTER", 1000)
    model, states, _ = case(samples=400)
    model.regressor(*states)
    model.regressor(*states)
    assert files(cache) == []


@needs_compiler
def test_two_threads_compile_once(monkeypatch, cache):
    from concurrent.futures import ThreadPoolExecutor

    calls = []
    real = entries.compiled

    def counted(*arguments):
        calls.append(arguments)
        return real(*arguments)

    monkeypatch.setattr(entries, "compiled", counted)
    model, states, _ = case(joints=7, samples=300)
    truth = without(monkeypatch, lambda: model.regressor(*states))
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: model.regressor(*states), range(12)))
    for one in found:
        np.testing.assert_array_equal(one, truth)
    assert len(calls) == 1


def test_the_switch_turns_it_off_in_a_new_process(cache):
    code = (
        "import numpy as np\n"
        "from consistent_id import DHRow, TorqueModel, from_modified_dh\n"
        "from consistent_id.regression.compiled import entries\n"
        "entries.LOOK_AFTER = entries.COMPILE_AFTER = 1\n"
        "model = TorqueModel(from_modified_dh('arm', [DHRow(0, 0)]))\n"
        "for _ in range(3): model.regressor(*np.ones((3, 20, 1)))\n"
    )
    environment = os.environ | {compiler.SWITCH: "0"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)
    assert not cache.exists()


@needs_compiler
def test_only_the_youngest_files_are_kept(monkeypatch, cache):
    monkeypatch.setattr(compiler, "_KEPT", 2)
    for joints in (1, 2, 3):
        model, states, _ = case(joints)
        for _ in range(3):
            model.regressor(*states)
    assert len(files(cache)) == 2


@needs_compiler
def test_friction_that_depends_on_the_load_has_the_same_bits(monkeypatch):
    drive = DriveTerms(coulomb="sign", load_friction=True)
    rng = np.random.default_rng(3)
    _, robot = random_robot(rng, 4)
    reference = np.tile([2.0, 0.1, 0.2, 0.3, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0], 4)
    model = TorqueModel(robot, drive, load_reference=reference)
    states = random_states(rng, 4, 100)
    truth = without(monkeypatch, lambda: model.regressor(*states))
    for _ in range(3):
        np.testing.assert_array_equal(model.regressor(*states), truth)


def test_a_tape_writes_each_operation_once_and_none_that_nobody_needs():
    tape = Tape()
    x, y = tape.input(0), tape.input(1)
    unused = x - y
    again = (x * y) + (y * x)
    source = tape.source("f", [again, 2.5])
    assert source.count(" * ") == 1
    assert f"t{unused.place}" not in source
    assert (2.5).hex() in source


def test_a_robot_too_large_to_compile_in_time_is_left_to_numpy(monkeypatch, cache):
    monkeypatch.setattr(entries, "_LARGEST", 50)
    model, states, _ = case(joints=4)
    for _ in range(3):
        model.regressor(*states)
    assert files(cache) == []


@needs_compiler
def test_a_regressor_of_many_samples_is_that_of_numpy(monkeypatch):
    model, states, _ = case(joints=7, samples=sines.LEAST)
    truth = without(monkeypatch, lambda: model.regressor(*states))
    for _ in range(3):
        found = model.regressor(*states)
        np.testing.assert_allclose(found, truth, rtol=0, atol=1e-13 * abs(truth).max())
