"""README's and the pages' Python runs as it stands; .ci/run runs README's commands."""

import importlib
import re
import sys
from operator import attrgetter
from pathlib import Path

import pytest
from shown import assert_reached

import consistent_id
from consistent_id._support.face import ROOMS, homes

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "benchmarks"))

from accuracy import BEGIN, END, short  # noqa: E402

README = (ROOT / "README.md").read_text()
DOCS = ROOT / "docs"
PACKAGE = "consistent_id"
TEXTS = {
    page.relative_to(DOCS).with_suffix("").as_posix(): page.read_text()
    for page in sorted(DOCS.rglob("*.md"))
    if page.parent.name != "paper"  # a journal's, no page of the documentation
}
# A block of Python, and what it prints if the page shows that.
BLOCK = re.compile(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", re.DOTALL)
PAGES = {name: BLOCK.findall(text) for name, text in TEXTS.items()}
# Pages that design a motion: which local optimum a search finds depends on the rounding
# of the machine, so their numbers are compared roughly, or by their order of magnitude.
SEARCHED = {"tutorial": 0.5, "excite-my-robot": 3.0}
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]\d+)?")


@pytest.mark.slow
def test_the_python_of_the_readme_goes_from_two_files_to_a_consistent_robot(
    capsys, tmp_path, monkeypatch
):
    (block,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len([line for line in block.splitlines() if line]) <= 10
    (tmp_path / "problems").symlink_to(ROOT / "problems")
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "README.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert any(re.search(r"least squares +do not use +0 of 6", line) for line in lines)
    assert lines[-1].startswith("use with care: constrained, held-out error 4.3 %")
    written = consistent_id.load_robot(tmp_path / "identified.urdf")
    assert all(link.nominal.is_consistent() for link in written.links)


def test_the_readme_is_short_and_has_one_picture():
    assert len(README.splitlines()) <= 120
    (picture,) = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", README)
    assert (ROOT / picture).read_bytes().startswith(b"\x89PNG")


def test_commands_to_run_and_to_test():
    blocks = re.findall(r"```sh\n(.*?)\n```", README, re.DOTALL)
    commands = [line for block in blocks for line in block.splitlines()]
    ends = ("compare problems/rx60", "compare problems/kuka_kr300", "pytest")
    assert len(blocks) == 2
    for command, end in zip(commands, ends, strict=True):
        assert command.endswith(end)


def test_the_table_is_that_of_the_measured_page():
    long = re.search(r"(\| held-out recording .*?)\n\n", TEXTS["accuracy"], re.DOTALL)
    shown = README.split(BEGIN)[1].split(END)[0].strip()
    assert shown == short(long[1])
    assert shown.count("\n") == 7  # head and six recordings


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
    assert_reached(f"docs/{page}.md", *names.values())


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
