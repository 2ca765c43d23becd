"""Measured pages state the problem files that they were measured with: today's."""

import re
import subprocess
import sys
from datetime import date
from pathlib import Path

import pytest

HERE = Path(__file__).parent.parent
sys.path.insert(0, str(HERE / "benchmarks"))

from pages import (  # noqa: E402
    digest,
    digests_on,
    machine,
    measured,
    measurements,
    processor,
    stamp,
    stamp_page,
    written_to,
)

REAL = {"ur10e", "kuka_kr300", "staubli_tx40", "tiago"}
TABLE = {"ur10e/payload.toml", "rx60", "unitree_go2", "unitree_z1"}
PAGES = {
    "accuracy.md": REAL | {"ur10e/payload.toml"},
    "coverage.md": REAL,
    "model-selection.md": REAL,
    "robots-table.md": {*REAL, *TABLE},
}


@pytest.mark.parametrize("page", sorted(p.name for p in (HERE / "docs").glob("*.md")))
def test_pages_are_of_the_problem_files_beside_them(page):
    found = digests_on((HERE / "docs" / page).read_text())
    assert found.keys() >= PAGES.get(page, set())
    for problem, stated in found.items():
        assert set(stated) == {digest(problem)}, (
            f"{problem} has changed since docs/{page} was measured: measure it again"
        )


WITHOUT = {
    "clean-recordings.md": "simulated arms and recordings, from their robots' files",
    "excite-my-robot.md": "a range of friction over torque at full speed",
    "glossary.md": "names a script only",
    "large-logs-and-fleets.md": "seconds and bytes, of simulated fleets and streams",
    "rx60-story.md": "a published study done again: its problem is the paper's",
}
"""Pages that name a script which reads problem files, and why they state none."""

TEXTS = {page.name: page.read_text() for page in sorted((HERE / "docs").glob("*.md"))}
DIGESTED = [name for name, text in TEXTS.items() if digests_on(text)]


@pytest.mark.parametrize("page", DIGESTED)
def test_a_page_s_date_stands_with_its_digests(page):
    text = TEXTS[page]
    dated = re.findall(r"on (\S+) \([^)]*\)\s+with problem files", text)
    assert len(dated) == text.count("problem files\n`") > 0
    assert all(date(2026, 1, 1) < date.fromisoformat(day) for day in dated)


def test_pages_of_scripts_that_read_problem_files_state_them():
    scripts = (HERE / "benchmarks").glob("*.py")
    reading = {s.name for s in scripts if "load_problem(" in s.read_text()}
    measured_pages = {
        name
        for name, text in TEXTS.items()
        if reading & set(re.findall(r"benchmarks/(\w+\.py)", text))
    }
    assert {*PAGES} <= {*DIGESTED}
    assert measured_pages - {*DIGESTED} == {*WITHOUT}


PRINTING = """
import argparse, sys
sys.path.insert(0, sys.argv.pop(1))
from pages import add_write, shown_on
parser = argparse.ArgumentParser()
parser.add_argument("--first", type=int)
parser.add_argument("--what")
add_write(parser)
options = parser.parse_args()
with shown_on(options.write):
    print(f"{options.first} logs\\n| a |\\n|---|\\n| {options.what} |")
"""


@pytest.mark.slow
def test_a_command_that_prints_writes_between_its_own_marks(tmp_path):
    script, page = tmp_path / "printing.py", tmp_path / "page.md"
    script.write_text(PRINTING)
    marks = "{0}<!-- printing first {1} what {2}: begin -->\nold\n"
    marks += "{0}<!-- printing first {1} what {2}: end -->\n"
    text = marks.format("", 1, "one word") + "- item\n\n" + marks.format("  ", 2, "b")
    page.write_text(text)
    for given in (("1", "one word"), ("2", "b")):
        words = [str(HERE / "benchmarks"), "--first", given[0], "--what", given[1]]
        command = [sys.executable, str(script), *words, "--write", str(page)]
        found = subprocess.run(command, check=True, capture_output=True, text=True)
        assert f"| {given[1]} |" in found.stdout  # printed, too
    shown = page.read_text()
    assert "old" not in shown
    said = 'Measured by `python benchmarks/printing.py --first 1 --what "one word"`{}:'
    assert f"{said.format(stamp())}\n\n```none\n1 logs\n```\n\n| a |" in shown
    assert "\n  | a |\n  |---|\n  | b |\n  <!-- printing first 2 what b: end" in shown
    last = subprocess.run(
        [*command[:-1], str(HERE / "README.md")], capture_output=True, text=True
    )
    assert "no marks <!-- printing first 2 what b: begin -->" in last.stderr


@pytest.mark.slow
def test_a_stamp_is_that_of_a_command_with_its_arguments(tmp_path):
    page = tmp_path / "page.md"
    old = " on 2026-01-02 (commit abcdef12; machine not noted)"
    text = "`python benchmarks/slack.py --first 1`{} and "
    text += "`python benchmarks/slack.py --first 2 --write docs/page.md`{}.\n"
    page.write_text(text.format(old, old))
    stamp_page(page, "slack.py", "--first 2", stamp())
    assert page.read_text() == text.format(old, stamp())


def test_a_digest_is_that_of_settings_and_of_the_model(tmp_path):
    folder = tmp_path / "arm"
    folder.mkdir()
    file, model = folder / "problem.toml", folder / "robot.urdf"
    file.write_text('name = "arm"\n[drive]\nviscous = true\n')
    model.write_text("<robot/>")
    first = digest("arm", tmp_path)
    file.write_text('# A comment.\nname = "other"\n[drive]\nviscous = true\n')
    assert digest("arm", tmp_path) == first
    assert digest("arm/problem.toml", tmp_path) == first
    file.write_text('name = "arm"\n[drive]\nviscous = false\n')
    second = digest("arm", tmp_path)
    model.write_text("<robot></robot>")
    assert len({first, second, digest("arm", tmp_path)}) == 3


@pytest.mark.slow
def test_what_is_written_is_read_back(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text("Before.\n\n<!-- table: begin -->\n<!-- table: end -->\n\nAfter.\n")
    script = str(HERE / "benchmarks" / "slack.py")
    monkeypatch.setattr(sys, "argv", [script])
    with written_to(page, "table", sorted(REAL)):
        print("| a |")
    text = page.read_text()
    assert digests_on(text) == {name: [digest(name)] for name in REAL}
    assert f"`python benchmarks/slack.py`{stamp()} with" in text
    assert "| a |" in text
    assert digests_on(measured(script="slack.py")) == {}


def test_every_measured_page_states_command_day_commit_and_machine():
    every = measurements()
    assert {one.page.stem for one in every} >= {"accuracy", "benchmarks", "faults"}
    for one in every:
        stamped = re.fullmatch(
            r"on (\S+) \(commit [0-9a-f]{7,}\+?; (.+)\)", one.stamped
        )
        assert stamped, (
            f"{one.page.name} does not say when and where {one.script} "
            f"{one.arguments} was run; "
            f"python benchmarks/pages.py {one.page.stem} runs it and says so"
        )
        assert date.fromisoformat(stamped[1]) <= date.today()
        assert (HERE / "benchmarks" / one.script).is_file()
        assert stamped[2] != "machine not noted"


IN_SENTENCES = {
    ("clean-recordings.md", "clean_simulations.py"): "how many logs were accused: none",
    ("collisions.md", "independent_collisions.py"): "periodic motions do not touch",
    ("quadruped-trunk.md", "quadruped.py"): "18 lines of three logs; two tables of it",
    ("quadruped-trunk.md", "quadruped_intervals.py"): "sums of three runs in one table",
    ("rollout.md", "rollout_delays.py"): "how many delays are in their intervals",
    ("rollout.md", "rollout_rivals.py"): "two errors, of minutes each",
}
"""Commands whose figures stand in sentences, or in a table of several runs."""


def test_every_measured_table_is_written_by_its_command():
    printing = {(one.page.name, one.script) for one in measurements() if not one.writes}
    assert printing == IN_SENTENCES.keys()


def test_a_processor_s_name_has_no_brackets():
    info = "cpu MHz\t: 2300\nmodel name\t: Intel(R) Xeon(R) Processor\nflags\t: fpu\n"
    assert processor(info) == "Intel Xeon Processor"
    assert processor("Processor\t: ARMv8") == ""


@pytest.mark.slow
def test_a_stamp_replaces_that_of_the_command_before(tmp_path):
    page = tmp_path / "page.md"
    old = "`python benchmarks/table.py`{} and `python\nbenchmarks/slack.py --deep`.\n"
    page.write_text(old.format(" on 2026-01-02 (commit abcdef12)"))
    stamp_page(page, "table.py", "", stamp())
    assert page.read_text() == old.format(stamp())
    assert stamp().startswith(f" on {date.today()} (commit ") and machine() in stamp()
    first, second = measurements(tmp_path)
    assert (first.script, f" {first.stamped}") == ("table.py", stamp())
    assert (second.script, second.arguments, second.stamped) == (
        "slack.py",
        "--deep",
        "",
    )
    assert second.words()[-3:] == ["--deep", "--write", str(page)]
