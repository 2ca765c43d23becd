"""README's and the pages' Python runs as it stands; .ci/run runs README's commands."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
PAGES = {
    page.name: re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
    for page in sorted((ROOT / "docs").glob("*.md"))
}


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


@pytest.mark.parametrize("page", [name for name, blocks in PAGES.items() if blocks])
def test_the_python_of_the_pages_runs(page, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    names = {}  # later blocks of a page go on where the first ended
    for block in PAGES[page]:
        exec(compile(block, page, "exec"), names)
    assert capsys.readouterr().out


def test_every_page_is_in_the_index():
    index = (ROOT / "docs" / "index.md").read_text()
    for page in PAGES:
        assert page == "index.md" or f"({page})" in index
