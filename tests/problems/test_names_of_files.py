"""Names of files that are no single line become comments, and nothing else."""

import os
import tomllib

import pytest
from logged import write_arm

from consistent_id.cli import main


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no such names")
def test_a_line_break_in_a_files_name_does_not_become_toml(tmp_path, capsys):
    urdf, log = write_arm(tmp_path)
    odd_model = urdf.rename(tmp_path / "arm\nseed = 1\n.urdf")
    odd_log = log.rename(tmp_path / "log\nname = 'other'\n.csv")
    out = tmp_path / "problem.toml"
    assert main(["init", str(odd_model), str(odd_log), "--output", str(out)]) == 0
    found = tomllib.loads(out.read_text())
    assert found["name"] != "other"
    assert "seed" not in found
    assert "seed = 1" in found["model"]["urdf"]
    assert "name = 'other'" in found["data"]["recordings"][0]["file"]
    capsys.readouterr()
