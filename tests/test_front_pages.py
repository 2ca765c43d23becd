"""Pages for people in a hurry, for agents and for publishing say what the code does."""

import re
import shlex
import tomllib
from pathlib import Path

import pytest

import consistent_id
from consistent_id.cli import tool
from consistent_id.cli.tool import tool_parser

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
AGENTS = (DOCS / "for-agents.md").read_text()
LLMS = (DOCS / "llms.txt").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
FACES = ["README.md", "CODE_OF_CONDUCT.md", "CONTRIBUTING.md", "SECURITY.md"]
WITH_COMMANDS = [
    "README.md",
    "docs/start.md",
    "docs/faq.md",
    "docs/for-agents.md",
    "docs/install.md",
    "docs/ros2.md",
]
COMMAND = re.compile(r"(?:^\$ |^    |`)(consistent-id [a-z]+ [^`\n]+)", re.MULTILINE)
CODE = re.compile(r"^\| (\d+) \| ([^|]+?) \|", re.MULTILINE)


def commands():
    """Return every whole command that these pages show, with its page."""
    return [
        (page, command)
        for page in WITH_COMMANDS
        for command in COMMAND.findall((ROOT / page).read_text())
    ]


@pytest.mark.parametrize(("page", "command"), commands())
def test_a_command_that_is_shown_is_understood(page, command):
    words = shlex.split(command)[1:]
    assert tool_parser(words[0]).parse_args(words).command == words[0]


def test_commands_were_found_on_each_page():
    shown = [page for page, _ in commands()]
    assert {page: shown.count(page) for page in WITH_COMMANDS} == {
        "README.md": 4,
        "docs/start.md": 8,
        "docs/faq.md": 1,
        "docs/for-agents.md": 8,
        "docs/install.md": 1,
        "docs/ros2.md": 5,
    }


@pytest.mark.parametrize("page", FACES)
def test_links_of_the_front_lead_to_files(page):
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", (ROOT / page).read_text())
    missing = [link for link in links if not (ROOT / link).exists()]
    assert not missing


def test_a_start_is_one_command_for_each_of_five():
    table = (DOCS / "start.md").read_text().split("|---|---|---|\n")[1].split("\n\n")[0]
    rows = [row.split(" | ") for row in table.splitlines()]
    names = ("torques", "currents", "commands only", "nothing yet", "a load")
    for (have, command, _), name in zip(rows, names, strict=True):
        assert have.startswith(f"| {name}")
        assert len(COMMAND.findall(command)) == 1


def test_exit_codes_are_those_of_the_tool():
    told = dict(CODE.findall(AGENTS))
    assert list(told) == ["0", "1", "2", "3", "70", "130", "143"]
    for text in (tool.__doc__, LLMS):
        flat = " ".join(text.split())
        missing = [c for c, words in told.items() if f"{c} {words[:7]}" not in flat]
        assert missing == []


def test_agents_read_of_every_command_and_of_formats_that_exist():
    table = AGENTS.split("| command | `format` | exit code 1 if |")[1].split("\n\n")[0]
    told = re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)
    assert sorted(told) == sorted(tool._COMMANDS)
    sources = [f.read_text() for f in (ROOT / "consistent_id").rglob("*.py")]
    code = "\n".join(sources)
    formats = re.findall(r"`(consistent_id \w+ \d+)`", table)
    assert len(formats) == 22
    assert [f for f in formats if f'"{f}"' not in code] == []
    assert all(re.search(rf"\b{name}\b", LLMS) for name in told)


@pytest.mark.slow
def test_the_keys_of_a_verdict_are_those_that_agents_read():
    study = consistent_id.run_study(consistent_id.load_problem(ROOT / "problems/rx60"))
    answer = study.answer()
    table = AGENTS.split("| key | value |")[1].split("\n\n")[0]
    told = set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE))
    assert told == set(answer) - {"held_out_recordings", "recommended"}
    expected = set(answer["expected_error"])
    assert expected <= set(re.findall(r"`(\w+)`", table))
    parameter = next(iter(study.delivered.to_dict()["parameters"].values()))
    assert set(parameter) == {
        "value",
        "standard_error",
        "half_interval",
        "unit",
        "origin",
    }


def test_every_page_of_llms_txt_exists():
    links = re.findall(r"\]\(([^)]+)\)", LLMS)
    assert len(links) > 10
    assert [link for link in links if not (DOCS / link).is_file()] == []


def test_version_and_authors_are_stated_alike():
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {consistent_id.__version__}\n" in citation
    assert PROJECT["version"] == consistent_id.__version__
    (author,) = PROJECT["authors"]
    assert f"- name: {author['name']}\n" in citation
    assert author["name"] in (DOCS / "conf.py").read_text()
    assert PROJECT["license"] == re.search(r"license: (.*)", citation)[1]


def test_the_changelog_has_the_version_below_what_is_unreleased():
    changes = (ROOT / "CHANGELOG.md").read_text()
    titles = re.findall(r"^## (.*)$", changes, re.MULTILINE)
    version, day = titles[1].split(" - ")
    assert (titles[0], version) == ("Unreleased", consistent_id.__version__)
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\ndate-released: {day}\n" in citation


def test_what_is_unreleased_can_be_read():
    changes = (ROOT / "CHANGELOG.md").read_text()
    above, *groups = re.split("^### .*$", changes.split("\n## ")[1], flags=re.M)
    assert above == "Unreleased\n\n"
    entries = [line for group in groups for line in group.splitlines() if line]
    assert [line for line in entries if len(line) > 200] == []
    assert len(entries) <= 150  # more cannot be read: lines about one thing are one


def test_placeholders_of_addresses_stand_in_one_place():
    (root,) = {url.split("/consistent_id")[0] for url in PROJECT["urls"].values()}
    pages = [
        *DOCS.glob("*.md"),
        *DOCS.glob("*.txt"),
        *ROOT.glob("*.md"),
        ROOT / "CITATION.cff",
    ]
    assert [page.name for page in pages if root in page.read_text()] == []


CONDA_NAMES = {"pin": "pinocchio"}


def test_the_conda_recipe_has_version_and_floors_of_the_package():
    recipe = (ROOT / "conda" / "recipe.yaml").read_text()
    assert f'version: "{PROJECT["version"]}"\n' in recipe
    assert f'python_min: "{PROJECT["requires-python"].removeprefix(">=")}"\n' in recipe
    run = recipe.split("  run:\n")[1].split("\n\n")[0]
    stated = re.findall(r"- (\S+ >=\S+)", run)[1:]
    names = [re.split("(?=>=)", one) for one in PROJECT["dependencies"]]
    assert stated == [f"{CONDA_NAMES.get(name, name)} {floor}" for name, floor in names]


def test_the_page_about_installation_has_every_optional_part():
    table = (DOCS / "install.md").read_text().split("| part | you need it for |")[1]
    parts = re.findall(r"^\| `(\w+)` \|", table.split("\n\n")[0], re.MULTILINE)
    assert sorted(parts) == sorted(PROJECT["optional-dependencies"].keys() - {"docs"})


def test_every_picture_of_the_pages_is_in_the_gallery_or_on_a_page_that_it_names():
    shown = re.compile(r"\]\(([\w-]+\.(?:png|svg))\)")
    gallery = (DOCS / "gallery.md").read_text()
    pages = re.findall(r"\]\(([\w-]+\.md)\)", gallery)
    drawn = {
        name for page in pages for name in shown.findall((DOCS / page).read_text())
    }
    assert drawn >= {path.name for path in [*DOCS.glob("*.png"), *DOCS.glob("*.svg")]}


@pytest.mark.slow
@pytest.mark.parametrize("option", ["--accept", "--time-limit", "--executor", "--seed"])
def test_options_that_commands_share_are_listed_with_these_commands(option):
    table = (DOCS / "shell.md").read_text().split("| option | of | does |")[1]
    rows = re.findall(r"^\|([^|\n]*)\|([^|]+)\|", table.split("\n\n")[0], re.M)
    listed, last = [], ""
    for names, commands in rows:
        last = names.strip() or last  # an empty cell goes on with the option above it
        if option in last:
            listed += re.findall(r"`(\w+)`", commands)
    having = [
        name
        for name in tool._COMMANDS
        for parsers in [tool_parser(name)._subparsers._group_actions[0].choices]
        if option in parsers[name]._option_string_actions
    ]
    assert sorted(listed) == sorted(having)


def test_every_command_has_a_page_with_its_help():
    pages = {page.stem: page.read_text() for page in (DOCS / "commands").glob("*.md")}
    assert sorted(pages) == sorted(tool._COMMANDS)
    assert all(f"```{{shell-help}} {name}\n" in text for name, text in pages.items())
    table = (DOCS / "shell.md").read_text().split("| command | does |")[1]
    named = re.findall(r"`(\w+) ?[^`]*`", table.split("\n\n")[0])
    assert [name for name in pages if name not in named] == []
