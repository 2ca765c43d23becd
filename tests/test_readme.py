"""README's and the pages' Python runs as it stands; .ci/run runs README's commands."""

import importlib
import re
from operator import attrgetter
from pathlib import Path

import pytest

import consistent_id
from consistent_id._support.face import ROOMS, homes

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
DOCS = ROOT / "docs"
PACKAGE = "consistent_id"
TEXTS = {
    page.relative_to(DOCS).with_suffix("").as_posix(): page.read_text()
    for page in sorted(DOCS.rglob("*.md"))
}
# A block of Python, and what it prints if the page shows that.
BLOCK = re.compile(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", re.DOTALL)
PAGES = {name: BLOCK.findall(text) for name, text in TEXTS.items()}
# Pages that design a motion: which local optimum a search finds depends on the rounding
# of the machine, so their numbers are compared roughly, or by their order of magnitude.
SEARCHED = {"tutorial": 0.5, "excite-my-robot": 3.0}
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]\d+)?")


def test_the_python_of_the_readme_runs_and_finds_consistent_links(capsys):
    names = {}
    for block in re.findall(r"```python\n(.*?)```", README, re.DOTALL):
        exec(compile(block, "README.md", "exec"), names)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("least squares")
    assert lines[1] == "constrained use (True, True, True)"
    # Designs: each objective brings what it aims at.
    least = [[float(n) for n in NUMBER.findall(line)][:2] for line in lines[2:4]]
    assert [line.split()[0] for line in lines[2:4]] == ["D", "condition"]
    assert least[0][0] < least[1][0] and least[1][1] < least[0][1]


def test_there_are_three_commands_to_run_and_one_to_test():
    commands = re.findall(r"```sh\n(.*?)\n```", README, re.DOTALL)
    ends = (
        "consistent-id compare problems/rx60",
        "consistent-id compare problems/kuka_kr300",
        "--validate problems/kuka_kr300/FF_B.parquet",
        "pytest",
    )
    assert all("\n" not in command for command in commands)
    for command, end in zip(commands, ends, strict=True):
        assert command.endswith(end)


@pytest.mark.slow
@pytest.mark.parametrize("page", [name for name, blocks in PAGES.items() if blocks])
def test_the_python_of_the_pages_runs(page, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    names, printed = {}, ""  # later blocks of a page go on where the first ended
    for block, shown in PAGES[page]:
        exec(compile(block, page, "exec"), names)
        out = capsys.readouterr().out
        printed += out
        if shown:
            assert_alike(out, shown, rel=SEARCHED.get(page, 0.1))
    assert printed


def assert_alike(out, shown, *, rel):
    """The same words, and numbers as near as another machine's rounding leaves them."""
    assert NUMBER.sub("#", out) == NUMBER.sub("#", shown)
    for mine, theirs in zip(NUMBER.findall(out), NUMBER.findall(shown), strict=True):
        last = 10.0 ** -len(theirs.partition(".")[2])
        assert float(mine) == pytest.approx(float(theirs), rel=rel, abs=2.0 * last)


STUBS = {path.parent.name for path in (ROOT / PACKAGE).glob("*/__init__.pyi")}
UNLISTED = {"consistent_id.laboratory", "consistent_id.rollout"}  # page by page


def test_every_page_is_in_the_index_once():
    tables = re.findall(r"```\{toctree\}\n---\n.*?---\n(.*?)```", TEXTS["index"], re.S)
    listed = [name for table in tables for name in table.split()]
    assert sorted(listed) == sorted(name for name in TEXTS if name != "index")
    assert all(f"({name}.md)" in TEXTS["index"] for name in listed)


def test_every_public_name_is_documented_once():
    pages = "".join(text for name, text in TEXTS.items() if name.startswith("api/"))
    blocks = re.findall(r"```\{public\}([^\n]*)\n(.*?)```", pages, re.DOTALL)
    listed = {}
    for module, names in blocks:
        listed.setdefault(module.strip() or "consistent_id", []).extend(names.split())
    assert sorted(listed.pop("consistent_id")) == sorted(consistent_id.__all__)
    assert set(listed) >= {f"consistent_id.{room}" for room in ROOMS} - UNLISTED
    for module, names in listed.items():
        assert len(names) == len(set(names)), module
        if module.removeprefix("consistent_id.") in STUBS:
            public = set(homes(module)) - set(consistent_id.__all__)
            assert set(names) == public, module


def in_code(text):
    """Words of a page that stand in code: fenced, indented or between backticks."""
    fences = re.findall(r"^```.*?^```", text, re.DOTALL | re.MULTILINE)
    rest = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    indented = re.findall(r"^    .*$", rest, re.MULTILINE)
    inline = [code for part in rest.split("\n\n") for code in part.split("`")[1::2]]
    code = "\n".join([*fences, *indented, *inline])
    return set(re.findall(r"\w+", code))


def test_every_public_name_stands_in_a_page_that_uses_it():
    """Pages of the reference list all names; a reader meets them in others."""
    texts = [text for name, text in TEXTS.items() if not name.startswith("api/")]
    used = set().union(*map(in_code, [README, *texts]))
    owners = ["consistent_id", *(f"consistent_id.{room}" for room in ROOMS)]
    owners += [f"consistent_id.laboratory.{p}" for p in ("rehearsal", "reproduction")]
    names = {name for o in owners for name in importlib.import_module(o).__all__}
    assert len(names) > 300
    assert sorted(names - used) == []


def test_every_key_that_is_cited_is_in_the_references():
    known = set(re.findall(r"^\| (\w+) \|", TEXTS["references"], re.MULTILINE))
    sources = [file.read_text() for file in (ROOT / "consistent_id").rglob("*.py")]
    cited = re.findall(
        r"\[([A-Z][A-Za-z]+\d{4})\]", "".join([*sources, *TEXTS.values()])
    )
    assert set(cited) <= known


def test_what_the_glossary_names_exists():
    places = [row.split("|")[3] for row in TEXTS["glossary"].split("\n") if "|" in row]
    named = [name for place in places for name in re.findall(r"`(.+?)`", place)]
    assert len(named) > 30
    for name in named:
        if "/" in name:
            assert any((root / name).exists() for root in (ROOT, ROOT / PACKAGE)), name
        else:
            attrgetter(name)(consistent_id)
