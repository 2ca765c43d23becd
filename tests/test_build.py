"""The wheel and the source archive have what users need, and are built alike twice."""

import os
import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

pytest.importorskip("hatchling", reason="the build backend, of the part dev")
pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent
BUILD = """
import os, sys
from hatchling.build import build_sdist, build_wheel
os.umask(int(sys.argv[2], 8))
build_wheel(sys.argv[1])
build_sdist(sys.argv[1])
"""


def build(source: Path, folder: Path, umask: str) -> list[Path]:
    """Build both files offline; return the source archive and the wheel."""
    subprocess.run(
        [sys.executable, "-c", BUILD, str(folder), umask],
        cwd=source,
        env=os.environ | {"SOURCE_DATE_EPOCH": "1790000000"},
        check=True,
        capture_output=True,
        timeout=300,
    )
    wheel, archive = sorted(folder.iterdir())
    return [archive, wheel]


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Both files of this tree."""
    archive, wheel = build(ROOT, tmp_path_factory.mktemp("first"), "022")
    assert archive.name.endswith(".tar.gz") and wheel.name.endswith("-any.whl")
    return archive, wheel


@pytest.fixture(scope="module")
def unpacked(built, tmp_path_factory):
    """The folder that the source archive holds."""
    folder = tmp_path_factory.mktemp("unpacked")
    with tarfile.open(built[0]) as archive:
        archive.extractall(folder, filter="data")
    (tree,) = folder.iterdir()
    return tree


def files(folder: str, pattern: str = "**/*") -> set[str]:
    """Return files of this tree, without what Python and its tools leave behind."""
    found = (path for path in (ROOT / folder).glob(pattern) if path.is_file())
    return {
        str(path.relative_to(ROOT))
        for path in found
        if not {"__pycache__", ".mypy_cache", ".ruff_cache"} & {*path.parts}
    }


@pytest.fixture(scope="module")
def in_wheel(built):
    with zipfile.ZipFile(built[1]) as wheel:
        return {name: wheel.read(name) for name in wheel.namelist()}


def test_the_wheel_has_the_package_its_pages_schemas_and_problems(in_wheel):
    package = files("consistent_id")
    shipped = {
        name: name.replace("docs/", "consistent_id/_docs/", 1)
        for name in (
            *files("docs", "*.md"),
            *files("docs/schemas"),
            "docs/llms.txt",
        )
    } | {name: f"consistent_id/_{name}" for name in files("problems")}
    assert "consistent_id/py.typed" in package
    assert "problems/kuka_kr300/LICENSE" in shipped
    about = "consistent_id-[^/]+.dist-info/"
    wanted = {*package, *shipped.values()}
    assert wanted <= {*in_wheel}
    assert all(re.match(about, name) for name in {*in_wheel} - wanted)
    for name, place in shipped.items():
        assert in_wheel[place] == (ROOT / name).read_bytes()
    assert {name for name in in_wheel if re.fullmatch(about + ".*LICENSE", name)}


def test_an_installed_wheel_prints_pages_and_schemas_without_the_tree(
    built, tmp_path, in_wheel
):
    with zipfile.ZipFile(built[1]) as wheel:
        wheel.extractall(tmp_path)
    script = (
        "import sys, consistent_id\n"
        "assert consistent_id.__file__.startswith(sys.argv.pop(1))\n"
        "from consistent_id.cli import main\n"
        "sys.exit(max(main(['help', topic]) for topic in sys.argv[1:]))"
    )
    found = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path), "llms.txt", "schemas", "lint-1"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        check=True,
        capture_output=True,
        text=True,
        timeout=60,
    )
    listed = Path(found.stdout.split("Files: ")[1].splitlines()[0])
    assert listed == tmp_path / "consistent_id" / "_docs" / "schemas"
    assert found.stdout.startswith("# consistent_id\n")
    assert '"$id": "lint-1.json"' in found.stdout


def test_the_archive_has_all_that_the_front_page_needs(unpacked):
    page = (unpacked / "README.md").read_text()
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page)
    assert "problems/kuka_kr300/LICENSE" in links
    for name in (*links, "problems/kuka_kr300/FF_A.csv", "problems/rx60/problem.toml"):
        assert (unpacked / name).exists(), name
    run = ("pyproject.toml", "conftest.py", ".ci/run", "tests/helpers/schemas.py")
    whole = ("problems", "tests", "docs", "benchmarks", "examples", "conda")
    for name in (*run, "LICENSE", *(n for folder in whole for n in files(folder))):
        if "build/" not in name and "results/" not in name:
            assert (unpacked / name).is_file(), name


def test_the_archive_has_every_file_that_git_tracks(unpacked):
    listed = subprocess.run(
        ["git", "-C", str(ROOT), "ls-files", "-z"], capture_output=True, text=True
    )
    if listed.returncode:
        pytest.skip("not in a repository")
    tracked = {name for name in listed.stdout.split("\0") if (ROOT / name).is_file()}
    archived = {
        str(path.relative_to(unpacked))
        for path in unpacked.rglob("*")
        if path.is_file()
    }
    assert len(tracked) > 1000
    assert tracked - archived == set()


def test_what_is_built_from_the_archive_is_equal_to_the_byte(built, unpacked, tmp_path):
    again = build(unpacked, tmp_path, "077")
    assert [file.name for file in again] == [file.name for file in built]
    for first, second in zip(built, again, strict=True):
        assert first.read_bytes() == second.read_bytes(), first.name
