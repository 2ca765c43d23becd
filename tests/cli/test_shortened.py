"""By default an answer fits a terminal; nothing is lost with --verbose."""

import re
from pathlib import Path

from consistent_id.cli import main
from consistent_id.cli.answers import COLUMNS, LINES, files_written, shortened

RX60 = "problems/rx60"


def test_no_line_is_too_wide_and_no_word_is_lost():
    text = "  " + " ".join(f"word{i}" for i in range(60))
    lines = shortened(text).splitlines()
    assert max(map(len, lines)) <= COLUMNS
    assert " ".join(lines).split() == text.split()
    assert all(line.startswith("    ") for line in lines[1:])


def test_files_that_were_written_are_named_however_long_the_answer_is():
    text = "\n".join([*map(str, range(99)), "written: a.urdf"])
    lines = shortened(text).splitlines()
    assert len(lines) == LINES
    assert lines[-1] == "written: a.urdf"
    assert lines[-2].startswith("(76 more lines")


def test_no_heading_is_shown_without_its_lines():
    first = [str(i) for i in range(LINES - 3)]
    text = "\n".join([*first, "", "heading", *(f"  {i}" for i in range(9))])
    lines = shortened(text).splitlines()
    assert lines[:-1] == first
    assert lines[-1].startswith("(11 more lines")
    # A paragraph of one line is no heading.
    alone = "\n".join([*first, "", "a line", "", *(f"  {i}" for i in range(9))])
    assert shortened(alone).splitlines()[-2] == "a line"


def test_what_fits_is_left_as_it_is():
    text = "\n".join(map(str, range(LINES)))
    assert shortened(text) == text


def test_a_command_is_short_unless_told(capsys):
    assert main(["info", RX60]) == 0
    brief = capsys.readouterr().out.splitlines()
    assert main(["info", RX60, "--verbose"]) == 0
    whole = capsys.readouterr().out.splitlines()
    assert len(brief) <= LINES
    assert brief[0] == whole[0]


def test_files_of_one_folder_are_named_by_it():
    folder = Path("results") / "rx60"
    one, other = folder / "a.png", folder / "b.png"
    assert files_written([one]) == f"written: {one}"
    assert files_written([one, other]) == f"written in {folder}: a.png, b.png"
    apart = files_written([one, Path("c.png")])
    assert apart == f"written: {one}, c.png"
    many = files_written([folder / f"torque_training_{k}.png" for k in range(8)])
    assert max(map(len, many.splitlines())) <= 100
    assert many.count("torque") == 8
    names = [*(f"torque_training_{k}.png" for k in range(30)), "report.html", "r.json"]
    short = files_written([folder / name for name in names], whole=False)
    assert len(short.splitlines()) == 2 and max(map(len, short.splitlines())) <= 100
    assert short.endswith("report.html, r.json")
    # All are named or counted.
    (left,) = re.findall(r"(\d+) more", short)
    assert short.count("torque") + int(left) == 30
