"""What long commands say before they work."""

import shlex
from pathlib import Path

import pytest

from consistent_id.cli import main
from consistent_id.errors import ProblemError

PROBLEMS = Path(__file__).parents[2] / "problems"
KUKA = f"{PROBLEMS}/kuka_kr300/robot.urdf {PROBLEMS}/kuka_kr300/FF_A.csv"


@pytest.mark.parametrize(
    ("command", "work", "said"),
    [
        (
            f"rollout {PROBLEMS}/unitree_z1",
            "problems.opening.open_problem",
            "reading unitree_z1 ...",
        ),
        (
            f"rehearse {PROBLEMS}/ur10e",
            "excitation.sources.problem_to_excite",
            "reading ur10e ...",
        ),
        (f"init {KUKA}", "problems.drafting.drafted", "reading robot.urdf, FF_A.csv"),
        (
            f"servo {KUKA}",
            "robot.loaders.robot_file.load_robot",
            "reading robot.urdf, FF_A.csv ...",
        ),
    ],
)
def test_a_command_says_what_it_reads_before_it_works(
    command, work, said, monkeypatch, capsys, tmp_path
):
    """Nothing is printed in their first seconds otherwise."""

    def stopped(*given, **named):
        raise ProblemError("work begins here")

    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(f"consistent_id.{work}", stopped)
    assert main(shlex.split(command)) == 2
    err = capsys.readouterr().err
    assert err.startswith(said) and "work begins here" in err
    assert main(shlex.split(f"{command} --quiet")) == 2
    assert said not in capsys.readouterr().err
