"""An answer is printed first; its files are written after it, whoever reads."""

import argparse

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
    with pytest.raises(BrokenPipeError):
        show(argparse.Namespace(json=False, quiet=False), Answer(0, "", None, write))
    assert written == ["figure.png"]


def test_control_characters_of_files_do_not_reach_the_terminal(capsys):
    from argparse import Namespace

    from consistent_id.cli.answers import print_text

    print_text(Namespace(quiet=False), "a\x1b[2Jb\tc\nd\x7f")
    assert capsys.readouterr().out == "a?[2Jb\tc\nd?\n"
