"""README's road in an empty folder: no step needs an option that helps it along."""

import json

import pytest
from logged import write_arm
from shared_studies import shared_within

from consistent_id.cli import main

pytestmark = pytest.mark.slow
studies = shared_within("module")
ANSWER = (
    *("verdict", "method", "held_out_error", "reasons"),
    *("recommended", "expected_error", "findings"),
)


def steps(model, log):
    """Commands of the road from a robot and a log, in their order."""
    return [
        ["init", model, log],
        ["info", "problem.toml"],
        ["identify", model, log, "--output", "results/robot"],
        ["check", model, log],
        ["identify", model, log, "--output", "results/robot"],
        ["report", "results/robot"],
        ["export", "results/robot", "--format", "urdf", "--output", "new.urdf"],
        ["export", "results/robot", "--format", "mjcf", "--output", "new.xml"],
        ["compare", "results/robot"],
        ["check", "results/robot"],
        ["info", "results/robot"],
        ["identify", "results/robot"],
        ["compare", "problem.toml"],
        ["lint", "new.urdf"],
        ["excite", model, "--acceleration", "5", "--time-limit", "0.5"],
        ["excite", model, "--acceleration", "4", "--time-limit", "0.5"],
        ["info", f"results/{model.partition('.')[0]}"],
    ]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """An empty folder with a robot and a log, and their names."""
    monkeypatch.delenv("CONSISTENT_ID_DATASETS", raising=False)
    files = write_arm(tmp_path)
    monkeypatch.chdir(tmp_path)
    return [str(file).rpartition("/")[2] for file in files]


def test_the_road_from_a_robot_and_a_log_needs_no_further_option(
    place, capsys, studies
):
    for words in steps(*place):
        code = main([*words, "--quiet"])
        out, err = capsys.readouterr()
        assert (code, out) == (0, ""), (words, err)
        assert "computed again" not in err, words


def said(capsys, *words):
    capsys.readouterr()
    main([*words, "--json", "--quiet"])
    out = capsys.readouterr()
    assert out.out, out.err
    return json.loads(out.out)


def test_figures_are_equal_on_all_of_the_road(place, capsys, studies):
    model, log = place
    first = said(capsys, "identify", model, log, "--output", "results/robot")
    expected = {key: first[key] for key in ANSWER}
    assert main(["init", model, log, "--quiet"]) == 0
    out = ["--format", "json", "--output", "robot.json", "--dry-run"]
    page = ["--output", "page.html"]
    # From the same start, from its problem file, from its results.
    for start in ([model, log], ["problem.toml"], ["results/robot"]):
        for command, more in (
            ("identify", ["--dry-run"]),
            ("compare", ["--dry-run"]),
            ("report", page),
            ("export", out),
        ):
            found = said(capsys, command, *start, *more)
            assert {k: found[k] for k in ANSWER} == expected, (command, start)
        assert said(capsys, "check", *start)["findings"] == expected["findings"]


def test_a_rehearsal_and_a_rollout_end_the_road(tmp_path, monkeypatch, capsys, studies):
    pytest.importorskip("mujoco")
    from commanded_leg import write_leg

    folder = tmp_path / "leg"
    folder.mkdir()
    write_leg(folder)
    monkeypatch.chdir(tmp_path)
    assert main(["identify", "leg", "--output", "results/leg", "--quiet"]) == 0
    first = said(capsys, "identify", "results/leg")
    found = said(capsys, "rollout", "results/leg", "--stated")
    assert {k: found[k] for k in ANSWER} == {k: first[k] for k in ANSWER}
    write_arm(tmp_path)
    capsys.readouterr()
    call = ["rehearse", "arm.urdf", "--acceleration", "5", "--time-limit", "0.5"]
    assert main([*call, "--robots", "1", "--quiet"]) in (0, 1)  # 1: not come true
