"""An answer is printed first; its files are written after it, whoever reads."""

import argparse
import os
import shlex
import subprocess
import sys

import pytest

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
