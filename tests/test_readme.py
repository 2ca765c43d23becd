"""README's Python runs as it stands; its shell commands are run by .ci/run."""

import re
from pathlib import Path

README = (Path(__file__).parent.parent / "README.md").read_text()


def test_the_python_example_runs_and_tells_bodies_from_least_squares(capsys):
    (block,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    exec(compile(block, "README.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("least squares")
    assert lines[1] == "constrained certified (True, True, True)"


def test_there_is_one_command_to_run_and_one_to_test():
    commands = re.findall(r"```sh\n(.*?)\n```", README, re.DOTALL)
    assert len(commands) == 2
    assert all("\n" not in command for command in commands)
    assert commands[0].endswith("consistent-id compare problems/rx60")
    assert commands[1].endswith("pytest")
