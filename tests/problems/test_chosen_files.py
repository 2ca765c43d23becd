"""The repository's files of real arms hold the model that their data choose."""

import os

import msgspec
import pytest

from consistent_id import load_problem
from consistent_id.problems import select_model

pytestmark = pytest.mark.slow
NEEDS_DATA = pytest.mark.skipif(
    "CONSISTENT_ID_DATASETS" not in os.environ,
    reason="CONSISTENT_ID_DATASETS does not name the folder of recordings",
)
NAMES = [
    "kuka_kr300",
    *(
        pytest.param(name, marks=NEEDS_DATA)
        for name in ("ur10e", "staubli_tx40", "tiago")
    ),
]


def parted(table):
    """Return a file's content without the torque's delay, and the delay [s]."""
    change = msgspec.structs.replace
    preparation = table.data.preparation
    delay = preparation.delays.get("torque", 0.0)
    data = change(table.data, preparation=change(preparation, delays={}))
    return change(table, data=data), delay


@pytest.mark.parametrize("name", NAMES)
def test_the_file_says_what_its_training_data_choose(name):
    problem = load_problem(f"problems/{name}")
    selection = select_model(problem)
    stated, delay = parted(problem.table)
    chosen, found = parted(selection.table_of_problem)
    assert stated == chosen
    # A delay is a continuous value; rounding differs from machine to machine.
    assert found == pytest.approx(delay, abs=2e-4)


@NEEDS_DATA
def test_the_loaded_robot_has_the_drives_of_the_bare_one():
    bare = load_problem("problems/ur10e").table
    loaded = load_problem("problems/ur10e/payload.toml").table
    assert loaded.drive == bare.drive
    assert loaded.joints == bare.joints
    assert loaded.data.preparation == bare.data.preparation
