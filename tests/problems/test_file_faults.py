"""Faults of problem files: the line, the key, and what could stand there."""

import pytest

from consistent_id import ProblemError, load_problem

HEAD = """name = "arm"  # line 1

[model]  # line 3
urdf = "arm.urdf"
"""
RECORDINGS = """
[[data.recordings]]  # line 6
file = "a.csv"
role = "training"

[[data.recordings]]
file = "b.csv"
"""

FAULTS = {
    "key": (
        "[drive]\nviscos = true\n",
        r"line 6: drive has no key 'viscos'; known: viscous",
    ),
    "key of a joint": (
        "[joints.hip]\nspring = true\n\n[joints.knee]\nviscous = true\nofset = true\n",
        r"line 10: joints.NAME has no key 'ofset'; known: offset",
    ),
    "table": (
        "[constrants]\nmasses = 'free'\n",
        r"line 5: the file has no key 'constrants'; known: constraints",
    ),
    "word": (
        "[drive]\nviscous = true\ncoulomb = 'tan'\n",
        r'line 7: drive.coulomb has "tan", expected one of .*"tanh"',
    ),
    "word of the second joint": (
        "[joints.hip]\ncoulomb = 'sign'\n[joints.knee]\ncoulomb = 'tan'\n",
        r'line 8: joints.NAME.coulomb has "tan", expected one of .*"sign"',
    ),
    "word in a list": (
        "[constraints]\nmasses = 'free'\nsymmetric = {upper = ['w']}\n",
        r'line 7: constraints.symmetric.NAME.0 has "w", expected one of "x", "y", "z"',
    ),
    "channel": (
        RECORDINGS.strip()
        + "\nrole = 'validation'\n[data.preparation]\ndelays = {tourque = 1.0}\n",
        r'line 13: data.preparation.delays has the key "tourque", expected .*"torque"',
    ),
    "role": (
        RECORDINGS + "role = 'validate'\n",
        r'line 12: data.recordings.1.role has "validate", expected .*"validation"',
    ),
    "missing key": (RECORDINGS, r"line 10: data.recordings.1 needs the key 'role'"),
    "type": (
        "[drive]\n\nvelocity_scale = 'small'\n",
        r"line 7: drive.velocity_scale: Expected `float",
    ),
    "number": (
        "[drive]\nvelocity_scale = -1.0\n",
        r"line 6: drive.velocity_scale: Expected `float` > 0.0",
    ),
    "inline": (
        "[constraints]\ncentre_of_mass_in = [{link = 'a', bux = 1}]\n",
        r"line 6: constraints.centre_of_mass_in.0 has no key 'bux'; known: box",
    ),
    "quoted": (
        '[joints."a.b"]\nviscos = true\n',
        r"line 6: joints.NAME has no key 'viscos'",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_with_its_line_and_what_could_stand_there(fault, tmp_path):
    text, says = FAULTS[fault]
    file = tmp_path / "problem.toml"
    file.write_text(HEAD + text)
    with pytest.raises(ProblemError, match=rf"problem\.toml, {says}"):
        load_problem(file)


def test_a_file_without_a_name_says_so(tmp_path):
    file = tmp_path / "problem.toml"
    file.write_text('[model]\nurdf = "arm.urdf"\n')
    with pytest.raises(ProblemError, match="the file needs the key 'name'"):
        load_problem(file)


EXCHANGED = {
    "log for problem": (["identify", "log.csv"], "identify ROBOT.urdf log.csv"),
    "robot for problem": (["compare", "arm.urdf"], "identify arm.urdf LOG"),
    "log before robot": (
        ["identify", "log.csv", "arm.urdf"],
        "first: arm.urdf log.csv",
    ),
    "problem before log": (["check", "problem.toml", "log.csv"], "leave log.csv out"),
    "two robots": (["identify", "arm.urdf", "arm.urdf"], "is a robot, expected a log"),
    "two logs": (
        ["identify", "log.csv", "log.csv"],
        "log.csv is a log, expected a robot",
    ),
}


@pytest.mark.parametrize("case", EXCHANGED)
def test_exchanged_arguments_are_recognised(case, tmp_path, monkeypatch, capsys):
    from consistent_id.cli import main

    arguments, says = EXCHANGED[case]
    monkeypatch.chdir(tmp_path)
    for name in ("arm.urdf", "log.csv", "problem.toml"):
        (tmp_path / name).write_text("")
    assert main(arguments) == 2
    assert says in capsys.readouterr().err
