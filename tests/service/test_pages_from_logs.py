"""The pages' blocks that begin with a user's logs, run on logs of a simulated arm."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from carrying import JOINTS, LOAD, write_log, write_robot

import consistent_id as ci
from consistent_id.cli import main

DOCS = Path(__file__).parents[2] / "docs"
FREE = ("free_1", "free_2", "free_3", "free_4")


def blocks(page):
    """Blocks of Python of a page that open results: they are indented, not fenced."""
    found = re.findall(r"(?:^(?:    .*)?\n)+", (DOCS / page).read_text(), re.MULTILINE)
    python = [block for block in found if "open_results" in block]
    assert python
    return [re.sub(r"^    ", "", block, flags=re.MULTILINE) for block in python]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder in which the pages' first command has run."""
    folder = tmp_path_factory.mktemp("user")
    write_robot(folder)
    for seed, name in enumerate(("log", *FREE, "empty")):
        write_log(folder / f"{name}.csv", None, seed=seed)
    write_log(folder / "loaded.csv", LOAD, seed=9)
    words = ["identify", folder / "robot.urdf", folder / "log.csv", "--no-select"]
    words += ["--cutoff", "8", "--quiet", "--output", folder / "results" / "robot"]
    assert main(list(map(str, words))) == 0
    return folder


@pytest.mark.slow
def test_the_page_of_touches_goes_from_logs_to_c(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    (block,) = blocks("touch.md")
    names = {}
    exec(block, names)
    assert "ContactDetector(4 joints, 1 false alarms an hour" in capsys.readouterr().out
    assert (folder / "arm_contact.h").exists()
    if shutil.which("gcc"):
        subprocess.run(
            ["gcc", "-std=c99", "-Werror", "-c", "arm_contact.c"], check=True
        )
    # Logs without a contact have no alarm; those with a push have.
    log = names["logs"][0]
    observer, detector = names["observer"], names["detector"]
    assert not len(detector.along(observer.along(log)).starts)
    torque = np.array(log.torque)
    torque[600:, 1] -= 8.0 * np.median(
        detector.along(observer.along(log)).threshold[600:, 1]
    )
    pushed = ci.Recording(
        JOINTS, log.time, log.position, velocity=log.velocity, torque=torque
    )
    (first, *_) = detector.along(observer.along(pushed)).starts
    assert 600 <= first <= 606


@pytest.mark.slow
def test_the_page_of_following_goes_from_logs_to_a_controller(folder, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "service.csv").write_bytes((folder / "loaded.csv").read_bytes())
    (block,) = blocks("following.md")
    names = {}
    exec(block, names)
    assert names["state"].change.loaded
    assert names["control"].joints == JOINTS
    followed = names["online"].delivered(names["state"])
    again = type(followed).load(folder / "today.json", followed.model, followed.base)
    np.testing.assert_allclose(again.parameters, followed.parameters, rtol=1e-12)


@pytest.mark.slow
def test_the_page_of_control_goes_from_a_log_to_torque(folder, monkeypatch):
    monkeypatch.chdir(folder)
    names = {"q": np.full(4, 0.2), "dq": np.full(4, 0.1)}
    (block,) = blocks("control.md")
    exec(block, names)
    assert names["torque"].shape == (4,)
    assert np.isfinite(names["torque"]).all()
