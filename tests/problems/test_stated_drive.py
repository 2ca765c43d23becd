"""Drive terms in words: of all joints, and of some joints in place of these."""

import pytest
from logged import write_arm

from consistent_id import DriveTerms, ProblemError, draft_problem, load_problem
from consistent_id.problems.overrides import stated_drive

JOINTS = ("shoulder", "elbow", "wrist")
USUAL = {"coulomb": "tanh", "velocity_scale": 0.02}


def test_a_joint_has_its_own_terms_in_place_of_those_of_all():
    words = ["viscous", "coulomb", "offset", "elbow=viscous,spring", "wrist="]
    assert stated_drive(words, JOINTS).terms(JOINTS) == (
        DriveTerms(viscous=True, offset=True, **USUAL),
        DriveTerms(viscous=True, spring=True),
        DriveTerms(),
    )


def test_a_width_is_that_of_every_joint_that_has_dry_friction():
    words = ["viscous", "elbow=coulomb,asymmetric"]
    first, second, _ = stated_drive(words, JOINTS, width=0.1).terms(JOINTS)
    assert first == DriveTerms(viscous=True)
    assert second == DriveTerms(coulomb="tanh", velocity_scale=0.1, asymmetric=True)


def test_without_words_no_joint_has_drive_terms():
    assert stated_drive([], JOINTS).terms(JOINTS) == (DriveTerms(),) * 3


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["elbow=viscous"], "expected those of all joints before"),
        (["viscous", "elbw=viscous"], "no joint 'elbw'; known: elbow"),
        (["viscous", "elbow=viscos"], "no drive term 'viscos'; "),
    ],
)
def test_a_word_that_is_unknown_is_refused_with_those_known(words, said):
    with pytest.raises(ProblemError, match=said):
        stated_drive(words, JOINTS)


@pytest.mark.parametrize("select", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_file_says_what_was_stated(tmp_path, select):
    words = ["viscous", "coulomb", "offset", "elbow=viscous"]
    cutoff = None if select else 10.0
    draft = draft_problem(
        *write_arm(tmp_path), drive=words, select=select, cutoff=cutoff
    )
    (tmp_path / "problem.toml").write_text(draft.text(tmp_path))
    for problem in (draft.problem(), load_problem(tmp_path)):
        shoulder, elbow = problem.model.terms
        assert shoulder.names == ("viscous", "coulomb", "offset")
        assert elbow.names == ("viscous",)
