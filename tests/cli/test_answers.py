"""An answer is printed first; its files are written after it, whoever reads."""

import argparse
import os
import re
import shlex
import subprocess
import sys

import pytest
from logged import HEAD, write_arm
from schemas import FOLDER, parsed

from consistent_id.cli import main
from consistent_id.cli.answers import Answer, show


@pytest.mark.parametrize("json", [False, True])
def test_files_are_written_after_the_answer(capsys, tmp_path, json):
    printed_before = []

    def write():
        printed_before.append(capsys.readouterr().out)
        return [tmp_path / "figure.png"]

    options = argparse.Namespace(json=json, quiet=False)
    assert show(options, Answer(1, "verdict", ["record"], write)) == 1
    assert printed_before == ['[\n "record"\n]\n' if json else "verdict\n"]
    after = capsys.readouterr().out
    assert after == ("" if json else f"\nwritten: {tmp_path / 'figure.png'}\n")


def test_files_are_written_even_if_the_reader_has_gone(monkeypatch):
    def closed(*_, **__):
        raise BrokenPipeError

    written = []

    def write():
        written.append("figure.png")
        return written

    monkeypatch.setattr("builtins.print", closed)
    monkeypatch.setattr("consistent_id.cli.answers.lead_nowhere", lambda _: None)
    options = argparse.Namespace(json=False, quiet=False)
    assert show(options, Answer(1, "", None, write)) == 1  # not 0: do not use
    assert written == ["figure.png"]


TOOL = [sys.executable, "-m", "consistent_id", "lint"]
BROKEN = """<robot name="arm"><link name="base"/><link name="rod"><inertial>
<mass value="-1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
</link><joint name="j" type="continuous">
<parent link="base"/><child link="rod"/></joint></robot>
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="a shell of Unix closes the streams")
@pytest.mark.parametrize(
    "closing", ["{} >&-", "{} 2>&-", "{} >&- 2>&-", "({}; echo $? >code) | true"]
)
def test_the_exit_code_does_not_depend_on_who_reads(tmp_path, closing):
    (tmp_path / "arm.urdf").write_text(BROKEN)
    command = shlex.join([*TOOL, "arm.urdf"])
    # Until the reader has gone, nothing is written.
    script = closing.format(command if "|" not in closing else f"sleep 0.2; {command}")
    run = subprocess.run(
        ["sh", "-c", script], cwd=tmp_path, stderr=subprocess.PIPE, timeout=60
    )
    code = tmp_path / "code"
    found = int(code.read_text()) if code.exists() else run.returncode
    assert found == 1
    assert b"bug" not in run.stderr and b"BrokenPipe" not in run.stderr


def test_control_characters_of_files_do_not_reach_the_terminal(capsys):
    from argparse import Namespace

    from consistent_id.cli.answers import print_text

    print_text(Namespace(quiet=False), "a\x1b[2Jb\tc\nd\x7f")
    assert capsys.readouterr().out == "a?[2Jb\tc\nd?\n"


SOURCE = ("arm.urdf", "log.csv", "--no-select")
KEPT = {  # what each prints that has no test of its own with its schema
    "demo": ("demo-1", ["--dry-run"]),
    "help": ("help-1", ["misfit"]),
    "completion": ("completion-1", ["bash"]),
    "init": ("draft-1", [*SOURCE, "--dry-run"]),
    "info": ("tables-1", SOURCE),
    "report": ("report-1", SOURCE),
    "export": ("export-1", [*SOURCE, "--format", "urdf", "--output", "o.urdf"]),
    "compress": ("compression-1", ["problem.toml", "--output", "r.json", "--dry-run"]),
    "identify": ("streamed-1", ["problem.toml", "--streamed"]),
    "select": ("selection-1", ["problem.toml", "--dry-run"]),
}
LONG = ("identify", "select", "report", "export")
DATA = """columns = { torque = "tau_{joint}" }
recordings = [{ file = "log.csv", role = "training" }]
preparation = { motion_cutoff = 10.0, torque_cutoff = 10.0 }
"""


@pytest.mark.parametrize(
    "command",
    [pytest.param(c, marks=[pytest.mark.slow] if c in LONG else []) for c in KEPT],
)
def test_json_is_of_the_schema_that_agents_read(command, tmp_path, capsys, monkeypatch):
    write_arm(tmp_path)
    (tmp_path / "problem.toml").write_text(HEAD + DATA)
    monkeypatch.chdir(tmp_path)
    schema, words = KEPT[command]
    assert main([command, *words, "--json", "--quiet"]) == 0
    record = parsed(capsys.readouterr().out, schema)
    if command == "export":
        page = (tmp_path / record["readme"]).read_text()
        assert record["readme"] == "o.urdf.README.md" and "# o.urdf: URDF" in page
        assert (
            record["torque_error"]["read_back"] and record["torque_error"]["held_out"]
        )
    if command not in ("info", "export"):
        assert record["format"] == f"consistent_id {schema.replace('-', ' ')}"


def test_every_command_has_a_schema_and_every_schema_is_on_the_page():
    page = (FOLDER.parent / "for-agents.md").read_text()
    table = page.split("| command | `format` | exit code 1 if |")[1].split("\n\n")[0]
    rows = table.strip().splitlines()[1:]
    assert all("](schemas/" in row for row in rows)
    named = set(re.findall(r"\(schemas/([\w-]+)\.json\)", page))
    assert named == {file.stem for file in FOLDER.glob("*.json")}
