"""What values say of themselves, and the data frames that they become."""

import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from excited import arm, arm_limits
from experiments import experiment

from consistent_id import (
    ProblemError,
    build_regression,
    compare,
    constrained_least_squares,
    design_trajectory,
    least_squares,
    load_problem,
)
from consistent_id._support.tables import Table


@pytest.fixture(scope="module")
def found():
    model, _, log = experiment(3, joints=2, noise=0.01, samples=400)
    regression = build_regression(model, log)
    plain = least_squares(model, regression)
    bodily = constrained_least_squares(model, regression)
    return log, plain, bodily, compare([plain, bodily], [log])


class Reader(HTMLParser):
    """Collects text, and refuses tags that are left open."""

    def __init__(self):
        super().__init__()
        self.open, self.text = [], []

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def read(html):
    reader = Reader()
    reader.feed(html)
    assert reader.open == []
    return reader.text


def test_a_table_in_html_has_everything_and_escapes_it():
    table = Table("a < b", ("x", "y"), (("1", "<b>"),), ("so & so",))
    assert read(table.html()) == ["a < b", "x", "y", "1", "<b>", "so & so"]
    assert "&lt;b&gt;" in table.html()


@pytest.mark.slow
def test_an_estimate_says_its_verdict_first(found):
    _, plain, bodily, _ = found
    assert repr(bodily).endswith(f"{bodily.verdict.word})")
    assert "\n" not in repr(bodily)
    assert str(bodily).startswith("use: constrained\n")
    assert read(bodily._repr_html_())[0] == "use: constrained"
    assert "optimum certified" in str(bodily)
    assert "standard error" in str(plain)
    assert "determined by" in str(bodily)


def test_a_comparison_says_verdicts_and_held_out_errors(found):
    log, _, _, comparison = found
    assert "'constrained': use" in repr(comparison)
    lines = str(comparison).splitlines()
    assert "estimates may be used" in lines[0]
    assert lines[-1].strip() == f"held-out error 1: all joints, {log.name}"
    assert f"{comparison['constrained'].validation[0].stacked:.2%}" in lines[3]
    assert read(comparison._repr_html_())[0] == lines[0]


def test_why_an_estimate_is_not_to_be_used_is_said(found):
    log, _, bodily, _ = found
    light = bodily.parameters.copy()
    light[0] = -1.0
    wrong = replace(bodily, parameters=light, method="wrong")
    (report,) = compare([wrong], [log]).reports
    assert report.verdict.sentence.startswith("do not use: wrong, held-out")
    assert any("not physically consistent" in line for line in report.verdict.lines)


def test_a_recording_says_how_long_it_is_and_what_it_holds(found):
    log, *_ = found
    assert repr(log) == (
        f"Recording('{log.name}': 400 samples of 2 joints, 3.99 s at 100 Hz; "
        "position, velocity, acceleration, torque)"
    )
    assert log.joints[1] in read(log._repr_html_())
    bare = replace(log, velocity=None, acceleration=None, torque=None)
    assert repr(bare).endswith("; position)")


def test_a_problem_says_what_it_is_about():
    problem = load_problem("problems/rx60")
    assert repr(problem).startswith("Problem('rx60': robot 'rx60' with 3 joints")
    assert "simulated data" in repr(problem)
    assert "Problem rx60" in read(problem._repr_html_())


@pytest.mark.slow
def test_a_design_says_whether_its_limits_are_proven():
    robot = arm(1)
    design = design_trajectory(
        robot, limits=arm_limits(robot), starts=1, time_limit=0.1, workers=1
    )
    assert repr(design).startswith("ExcitationDesign('arm': all limits proven, ")
    assert read(design._repr_html_())[0] == repr(design)


def test_an_estimate_becomes_a_data_frame(found):
    pytest.importorskip("pandas")
    *_, bodily, _ = found
    frame = bodily.to_frame()
    assert list(frame.columns) == [
        "value",
        "standard_error",
        "half_interval",
        "unit",
        "determined_by",
    ]
    assert tuple(frame.index) == bodily.model.layout.names
    np.testing.assert_array_equal(frame["value"], bodily.parameters)
    np.testing.assert_array_equal(frame["standard_error"], bodily.parameter_errors)
    assert tuple(frame["determined_by"]) == bodily.origins
    assert frame.attrs == {"method": "constrained", "verdict": "use"}


def test_a_recording_becomes_a_data_frame(found):
    pytest.importorskip("pandas")
    log, *_ = found
    frame = log.to_frame()
    np.testing.assert_array_equal(frame.index, log.time)
    np.testing.assert_array_equal(frame["torque"][log.joints[1]], log.torque[:, 1])


@pytest.mark.slow
def test_a_recording_becomes_a_data_set(found):
    pytest.importorskip("xarray")
    log, *_ = found
    data = log.to_xarray()
    assert dict(data.sizes) == {"time": 400, "joint": 2}
    chosen = data["velocity"].sel(joint=log.joints[0])
    np.testing.assert_array_equal(chosen, log.velocity[:, 0])


@pytest.mark.parametrize("library", ["pandas", "xarray"])
def test_what_is_missing_is_said_with_how_to_install_it(found, library, monkeypatch):
    log, *_ = found
    monkeypatch.setitem(sys.modules, library, None)
    convert = {"pandas": log.to_frame, "xarray": log.to_xarray}[library]
    install = rf"{library}; install it .*pip install .*\[frames\]"
    with pytest.raises(ProblemError, match=install):
        convert()
