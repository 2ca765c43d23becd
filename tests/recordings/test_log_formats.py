"""The table of log formats is what is read, what is said and what is documented."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from consistent_id import RecordingError, read_recording
from consistent_id.recordings.log_formats import LOG_FORMATS, log_format

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("known", LOG_FORMATS, ids=lambda known: known.name)
def test_a_format_is_found_by_its_suffixes_and_has_what_its_entry_says(known):
    for suffix in known.suffixes:
        assert log_format(Path(f"log{suffix}")) is known
        assert log_format(Path(f"log{suffix.upper()}")) is known
    reader = import_module(f"consistent_id.recordings.readers.{known.module}")
    arrays = known.holds == "arrays"
    assert hasattr(reader, "read_arrays" if arrays else "read_messages")
    assert hasattr(reader, "array_names") == known.lists_names


@pytest.mark.parametrize("known", LOG_FORMATS, ids=lambda known: known.name)
def test_every_format_is_documented(known):
    documented = " ".join((read_recording.__doc__ or "").split())
    assert known.name in documented
    assert known.name in " ".join((ROOT / "README.md").read_text().split())
    table = (ROOT / "docs" / "problem-file.md").read_text()
    for suffix in known.suffixes:
        assert f"``{suffix}``" in documented
        assert f"`{suffix}`" in table
    if known.extra:
        assert f"`consistent-id[{known.extra}]`" in table


def test_a_suffix_belongs_to_one_format_and_an_unknown_one_is_answered_with_all():
    suffixes = [suffix for known in LOG_FORMATS for suffix in known.suffixes]
    assert len(set(suffixes)) == len(suffixes)
    with pytest.raises(RecordingError) as refusal:
        log_format(Path("log.xyz"))
    assert all(suffix in str(refusal.value) for suffix in suffixes)


@pytest.mark.slow
def test_the_table_imports_no_array_library():
    code = "import sys, consistent_id.recordings.log_formats; print(*sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "consistent_id.recordings.log_formats" in found.stdout.split()
    assert "numpy" not in found.stdout.split()
