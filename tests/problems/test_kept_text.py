"""A rewritten problem file keeps what its author wrote, and says what it has to say."""

from pathlib import Path

import msgspec
import pytest

from consistent_id.problems.file import problem_table
from consistent_id.problems.kept_text import changed_tables, rewritten, toml_text

FILE = Path("problem.toml")
TEXT = """\
# A robot of ours.
name = "arm"

# Where the robot is from.
[model]
urdf = "arm.urdf"   # without meshes
joints = [
    "shoulder",  # [1]
    "elbow",
]

# Found by hand.
[drive]
viscous = true  # oil
velocity_scale = 0.02
coulomb = "tanh"

[joints.elbow]
spring = true

[data]
folder = "logs"   # on the disk of the laboratory

# Stamps jitter.
[data.preparation]
resample = 100.0  # Hz; nominal
motion_cutoff = 9.0
torque_cutoff = 9.0

# Two days in May.
[[data.recordings]]
file = "a.csv"
role = "training"

# Another day.
[[data.recordings]]
file = "b.csv"
role = "validation"
# The end.
"""
PATHS = ("drive", "joints", "couplings", "data.preparation")


def changed(table, **changes):
    """Return a file's content with other values, by ``table__key``."""
    for path, value in changes.items():
        head, _, key = path.rpartition("__")
        if head == "":
            table = msgspec.structs.replace(table, **{key: value})
        elif head == "data__preparation":
            inner = msgspec.structs.replace(table.data.preparation, **{key: value})
            data = msgspec.structs.replace(table.data, preparation=inner)
            table = msgspec.structs.replace(table, data=data)
        else:
            inner = msgspec.structs.replace(getattr(table, head), **{key: value})
            table = msgspec.structs.replace(table, **{head: inner})
    return table


def with_changes(text, comments=None, **changes):
    old = problem_table(text, FILE)
    new = changed(old, **changes)
    fresh = toml_text(new, comments or {})
    kept = rewritten(text, fresh, changed_tables(old, new, PATHS), new)
    assert problem_table(kept, FILE) == new
    return kept, fresh


def test_what_does_not_change_is_the_same_letter_by_letter():
    assert with_changes(TEXT)[0] == TEXT


def test_of_a_table_that_changes_the_lines_stay_whose_values_do():
    kept, _ = with_changes(TEXT, data__preparation__motion_cutoff=5.0)
    before, after = TEXT.splitlines(), kept.splitlines()
    assert "motion_cutoff = 5.0" in after
    assert set(before) - set(after) == {"# Stamps jitter.", "motion_cutoff = 9.0"}
    assert [line for line in after if line in before and "cutoff" not in line] == [
        line for line in before if "Stamps" not in line and "cutoff" not in line
    ]


def test_a_reason_takes_the_place_of_the_comment_above_its_table():
    kept, _ = with_changes(TEXT, {"drive": "Because."})
    assert kept == TEXT.replace("# Found by hand.", "# Because.")
    apart = TEXT.replace(
        "# Found by hand.", "# Of the whole robot.\n\n# Found by hand."
    )
    kept, _ = with_changes(apart, {"drive": "Because."})
    assert kept == apart.replace("# Found by hand.", "# Because.")


def test_tables_go_and_come_where_they_belong():
    without, _ = with_changes(TEXT, joints={})
    assert "elbow]" not in without
    assert "# The end." in without
    joint = problem_table(TEXT, FILE).joints["elbow"]
    back, _ = with_changes(without, joints={"shoulder": joint})
    headers = [line for line in back.splitlines() if line.startswith("[")]
    assert headers[1:4] == ["[drive]", "[joints.shoulder]", "[data]"]
    plain = TEXT[: TEXT.index("# Stamps")] + TEXT[TEXT.index("# Two days") :]
    added, _ = with_changes(plain, data__preparation__motion_cutoff=5.0)
    assert added.index("[data]") < added.index("[data.preparation]")
    assert added.index("[data.preparation]") < added.index("# Two days")


@pytest.mark.parametrize(
    "form",
    [
        "preparation = { resample = 100.0, motion_cutoff = 9.0, torque_cutoff = 9.0 }",
        "preparation.resample = 100.0\npreparation.motion_cutoff = 9.0\n"
        "preparation.torque_cutoff = 9.0\n",
    ],
)
def test_a_table_without_a_header_changes_in_its_own_form(form):
    start, end = TEXT.index("# Stamps"), TEXT.index("# Two days")
    odd = TEXT[:start].rstrip() + "\n" + form + "\n" + TEXT[end:]
    kept, _ = with_changes(odd, data__preparation__motion_cutoff=5.0)
    assert kept == odd.replace("motion_cutoff = 9.0", "motion_cutoff = 5.0")


@pytest.mark.slow
def test_a_file_of_very_many_lines_is_written_anew_at_once():
    gains = "torque_gain = [\n" + "1.0,\n" * 20_000 + "]\n"
    long = TEXT.replace("[data]\n", "[data]\n" + gains)
    kept, fresh = with_changes(long, data__preparation__motion_cutoff=5.0)
    assert kept == fresh


def test_header_names_in_quotes_and_texts_over_lines_are_read_as_toml_does():
    quoted = TEXT.replace("[joints.elbow]", '[ joints . "elbow" ]  # left').replace(
        'name = "arm"', 'name = "arm"\ndescription = """\n[drive]\n# not a comment"""'
    )
    kept, _ = with_changes(quoted, data__preparation__motion_cutoff=5.0)
    assert '[ joints . "elbow" ]  # left\nspring = true' in kept
    assert '"""\n[drive]\n# not a comment"""' in kept


def test_tables_in_another_order_stay_in_it():
    start, end = TEXT.index("# Stamps"), TEXT.index("# Two days")
    preparation = TEXT[start:end]
    apart = TEXT.replace(preparation, "").replace("# Found", f"{preparation}# Found")
    kept, _ = with_changes(apart, data__preparation__motion_cutoff=5.0)
    without = apart.replace("# Stamps jitter.\n", "")
    assert kept == without.replace("motion_cutoff = 9.0", "motion_cutoff = 5.0")


def test_a_value_that_changes_has_the_comment_of_the_fresh_text():
    kept, _ = with_changes(TEXT, {"drive.viscous": "no oil"}, drive__viscous=False)
    assert "viscous = false  # no oil\n" in kept
    kept, _ = with_changes(TEXT, {"drive.viscous": ""}, drive__viscous=False)
    assert "viscous = false\n" in kept


def test_a_comment_above_the_next_table_stays_when_a_table_goes():
    remark = TEXT.replace("[data]\n", "# Of the data.\n[data]\n")
    kept, _ = with_changes(remark, joints={})
    assert kept == remark.replace("[joints.elbow]\nspring = true\n\n", "")


def test_ends_of_lines_of_another_system_are_read():
    kept, _ = with_changes(TEXT.replace("\n", "\r\n"), {"drive": "Because."})
    assert kept == TEXT.replace("# Found by hand.", "# Because.")


def test_a_line_of_an_array_that_looks_like_a_header_is_none():
    hull = """
[[constraints.density_on]]
link = "elbow"
hull = [
    # the corner
    [0.0, 0.0, 0.0],

    # and others
    [1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0]
]
"""
    kept, _ = with_changes(TEXT + hull, data__preparation__motion_cutoff=5.0)
    assert hull in kept
