"""The same question at several doors has one answer: of the study of the problem."""

import json
import os
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from logged import write_arm
from schemas import parsed
from shared_studies import shared_within, sharing

from consistent_id import Estimate, Recording, compare, load_problem
from consistent_id.cli import main
from consistent_id.estimation.method import FittedSpan, fitted_spans
from consistent_id.estimation.verdict import Reason, Verdict, confirmed
from consistent_id.problems.study import Study
from consistent_id.recordings.signals.filtered_rows import row_filter

ANSWER = (
    *("verdict", "method", "held_out_error", "held_out_recordings", "reasons"),
    *("accepted", "recommended", "expected_error", "findings"),
)
NOTHING_WRONG = ("arm", "rx60", "short kuka", "ur10e", "walker")
DOORS = {
    "identify": lambda problem, out: ["--dry-run"],
    "compare": lambda problem, out: ["--dry-run"],
    "report": lambda problem, out: ["--output", f"{out}/report.html"],
    "export": lambda problem, out: [
        *("--format", "json", "--output", f"{out}/robot.json", "--dry-run")
    ],
    "rollout": lambda problem, out: (
        ["--dry-run", "--stated"] if problem.gains else None
    ),
}


def arm(folder):
    """A problem file that init writes for a simulated arm."""
    problem = folder / "problem.toml"
    files = [*map(str, write_arm(folder))]
    assert main(["init", *files, "--cutoff", "10", "--output", str(problem)]) == 0


def commanded_leg(folder):
    """Commands of a simulated leg instead of torque."""
    pytest.importorskip("mujoco")
    from commanded_leg import write_leg

    write_leg(folder)


def short_kuka(folder):
    """Half of the KUKA's motion."""
    copytree("problems/kuka_kr300", folder, dirs_exist_ok=True)
    file = folder / "problem.toml"
    file.write_text(file.read_text().replace("[451, 2051]", "[451, 1251]"))


def own(name, *, data=False):
    """A problem of the repository; its recordings may be elsewhere."""

    def write(folder):
        if data and "CONSISTENT_ID_DATASETS" not in os.environ:
            pytest.skip("CONSISTENT_ID_DATASETS is not set")
        return Path("problems") / name

    return write


CASES = {
    "arm": arm,
    "commanded leg": commanded_leg,
    "rx60": own("rx60"),
    "short kuka": None,  # the fixture `kuka` has it
    "walker": own("walker"),
    "unitree_z1": own("unitree_z1", data=True),
    "ur10e": own("ur10e", data=True),
    "tiago": own("tiago", data=True),
}


studies = shared_within("function")


def said(capsys, *arguments):
    """Return what a command prints as JSON, and its exit code."""
    capsys.readouterr()
    code = main([*map(str, arguments), "--json", "--quiet"])
    return parsed(capsys.readouterr().out, "answer-1"), code


# A study of these takes several seconds: at two doors, which are others for each.
LONG_STUDIES = {
    "short kuka": ("identify", "compare"),
    "walker": ("identify", "export"),
    "unitree_z1": ("identify", "rollout"),
    "ur10e": ("compare", "report"),
    "tiago": ("report", "export"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_every_door_gives_the_same_answer(case, tmp_path, capsys, studies, request):
    folder = tmp_path / "problem"
    folder.mkdir()
    if case == "short kuka":
        study, place = request.getfixturevalue("kuka")
    else:
        place = CASES[case](folder) or folder
        study = Study(load_problem(place))
    study = studies.one(study).run(costs=False)
    expected = json.loads(json.dumps(study.answer()))
    assert list(expected) == ["method", "verdict", *ANSWER[2:]]
    assert expected["findings"] or case in NOTHING_WRONG
    for door in LONG_STUDIES.get(case, DOORS):
        given = DOORS[door](study.problem, tmp_path)
        if given is None:
            continue
        record, code = said(capsys, door, place, *given)
        assert {key: record[key] for key in ANSWER} == expected, door
        assert code == (not study.verdict.usable), door
    assert studies.made == 1  # a door that asks for another gets its own


@pytest.fixture(scope="module")
def kuka(tmp_path_factory):
    """A study, and the folder that identify wrote of it by a study of its own."""
    folder = tmp_path_factory.mktemp("kuka")
    short_kuka(folder)
    assert main(["identify", str(folder), "--output", str(folder / "out")]) == 0
    return Study(load_problem(folder)), folder


def exported(kuka, capsys, file):
    """Return what export says of an estimate in a file, by the study that is given."""
    study, place = kuka
    out = ("--format", "json", "--output", place / "robot.json", "--dry-run")
    with sharing(study) as studies:
        record, _ = said(capsys, "export", place, *out, "--estimate", file)
        assert studies.made == 1
    return record


def in_sample(study, estimate):
    """Return the error on validation torque, all joints: they all turn."""
    (recording,) = study.validation
    kept = recording.torque_filter.kept
    rows = np.flatnonzero(kept % row_filter(recording).step == 0)
    recording = recording.samples(rows)
    left = recording.torque - estimate.predict(recording)
    return np.linalg.norm(left) / np.linalg.norm(recording.torque)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["delivered", "constrained", "weighted_constrained", "least_squares"]
)
def test_an_estimate_in_a_file_is_answered_for_as_identify_did(name, kuka, capsys):
    file = kuka[1] / "out" / f"{name}.json"
    stated = json.loads(file.read_text())
    assert len(stated["fitted_to"]) == (2 if name == "delivered" else 1)
    record = exported(kuka, capsys, file)
    for key in ("verdict", "method", "held_out_error", "reasons", "accepted"):
        assert record[key] == stated[key], key
    as_stated = [note for note in record["notes"] if "as the file states it" in note]
    assert len(as_stated) == (name == "delivered")


def changed(folder, name, **changes):
    """Write an estimate with some keys of its record changed; return the file."""
    record = json.loads((folder / "out" / f"{name}.json").read_text())
    file = folder / "changed.json"
    file.write_text(json.dumps(record | changes))
    return file


PRAISE = {"verdict": "use", "reasons": [], "held_out_error": 0.001}


@pytest.mark.slow
def test_a_verdict_that_was_made_better_in_the_file_does_not_help(kuka, capsys):
    study, folder = kuka
    record = exported(kuka, capsys, changed(folder, "delivered", **PRAISE))
    assert record["held_out_error"] == study.verdict.held_out
    assert record["verdict"] == study.verdict.word == "use with care"
    assert any("which is too small" in note for note in record["notes"])


@pytest.mark.slow
def test_a_file_that_hides_what_it_was_fitted_to_is_not_better_than_it_says(
    kuka, capsys
):
    study, folder = kuka
    record = exported(kuka, capsys, changed(folder, "delivered", fitted_to=[]))
    assert record["held_out_error"] == study.verdict.held_out
    assert record["held_out_error"] > in_sample(study, study.delivered)
    assert any("does not name the recordings" in note for note in record["notes"])


@pytest.mark.slow
def test_a_bad_estimate_that_claims_to_know_all_data_is_refused(kuka, capsys):
    study, folder = kuka
    spans = [s._asdict() for s in fitted_spans((*study.training, *study.validation))]
    record = json.loads((folder / "out" / "constrained.json").read_text())
    for name, entry in record["parameters"].items():
        entry["value"] *= 3.0 if "inertia" in name or "coulomb" in name else 1.0
    fit = record["fit"] | {"misfit": 0.01}
    fit["joints"] = {j: own | {"misfits": 0.01} for j, own in fit["joints"].items()}
    lies = {"parameters": record["parameters"], "fit": fit, "fitted_to": spans}
    file = changed(folder, "constrained", **PRAISE, **lies)
    bad = Estimate.load(file, study.problem.model, study.base)
    assert bad.verdict.word == "use"  # as it says itself
    answer = exported(kuka, capsys, file)
    assert answer["held_out_error"] == pytest.approx(in_sample(study, bad), rel=1e-9)
    assert answer["verdict"] != "use"
    kinds = {reason["kind"] for reason in answer["reasons"]}
    assert {"misfit", "held-out error"} <= kinds


@pytest.mark.slow
def test_recordings_that_it_was_fitted_to_are_not_held_out(tmp_path):
    study = Study(load_problem("problems/rx60"))
    (first,), (second,) = fitted_spans(study.training), fitted_spans(study.validation)
    own = study.constrained
    assert own.fitted_to == (first,)
    assert study.unseen(own) == study.validation
    read = Estimate.load(own.save(tmp_path / "own.json"), own.model, own.base)
    assert read.fitted_to == own.fitted_to
    both = replace(own, fitted_to=(first, second))
    assert study.unseen(both) == ()
    assert study.verdict_on(both).held_out is None
    # A part of it is enough, whatever the preparation of today makes of its ends.
    part = second._replace(stop=0.5 * (second.start + second.stop))
    assert study.unseen(replace(own, fitted_to=(part,))) == ()
    # Logs of one name, as of two folders: training data go by themselves.
    same = Study(study.problem)
    same.__dict__["_recordings"] = (study.training, study.training)
    assert same.unseen(own) == same.validation
    assert same.unseen(replace(own, fitted_to=(first, first))) == ()
    # What is not known is taken for held out, unless the verdict says worse.
    nothing = replace(own, fitted_to=())
    error = compare([own], study.validation).reports[0].held_out_error
    assert study.verdict_on(nothing).held_out == study.verdict_on(own).held_out == error
    stated = replace(study.verdict_on(own), held_out=0.9)
    assert study.verdict_on(replace(nothing, judged=stated)).held_out == 0.9


def test_spans_overlap_in_more_than_an_instant_of_one_recording():
    spans = fitted_spans(
        [
            Recording(("a",), np.arange(10) + start, np.zeros((10, 1)), name="log.csv")
            for start in (0.0, 9.0, 5.0)
        ]
    )
    assert spans[0] == FittedSpan("log.csv", 0.0, 9.0)
    assert not spans[0].overlaps(spans[1])  # they share an instant
    assert spans[0].overlaps(spans[2]) and spans[2].overlaps(spans[1])
    assert not spans[0].overlaps(FittedSpan("other.csv", 0.0, 9.0))


def test_what_is_found_now_only_makes_a_stated_verdict_worse():
    care = Reason("misfit", "use with care", "13 %")
    known = Reason("boundary", "use", "link 3")
    refused = Reason("held-out error", "do not use", "none is no worse")
    stated = Verdict("use with care", "constrained", (care, known), (), 0.05)
    nothing = Verdict("use", "constrained", (), (), 0.03)
    assert confirmed(stated, nothing) == stated
    less = replace(nothing, reasons=(replace(care, statement="12 %"),))
    assert confirmed(stated, less) == stated
    worse = confirmed(stated, Verdict("do not use", "x", (refused, care), (), 0.4))
    assert worse.reasons == (refused, care, known)
    assert (worse.word, worse.held_out) == ("do not use", 0.4)
    praise = Verdict("use", "constrained", (), ("everything",), 0.001)
    assert confirmed(praise, stated) == replace(stated, reasons=(care,))
    accepted = confirmed(stated, replace(nothing, accepted=("misfit",)))
    assert accepted.word == "use"
    assert "accepted" in accepted.reasons[0].statement
