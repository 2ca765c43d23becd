"""Figures in files: each is an SVG of its own, and its curves are where they belong."""

from dataclasses import replace
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np

import consistent_id as ci
from consistent_id.report.plot import motion_figure, torque_figure, write_figure

ARM = ci.from_modified_dh("arm <2>", [ci.DHRow(0, 0, 0.3), ci.DHRow(-np.pi / 2, 0)])
TIME = np.linspace(0.0, 2.0, 201)
RAMP = np.column_stack([TIME, -TIME])
LOG = ci.Recording(ARM.joint_names, TIME, RAMP, 0 * RAMP, 0 * RAMP, 3.0 * RAMP)
SVG = "{http://www.w3.org/2000/svg}"


def curves(figure, style):
    """Return the points of all curves of a style, in the order of panels."""
    root = ElementTree.fromstring(figure)
    return [
        np.array([p.split(" ") for p in path.get("d")[1:].split("L")], dtype=float)
        for path in root.iter(f"{SVG}path")
        if path.get("class") == style
    ]


def test_joints_are_drawn_over_time_one_below_another(tmp_path):
    figure = motion_figure(ARM, replace(LOG, name="a < b & c"))
    rising, falling = curves(figure, "c0")
    assert len(rising) == len(TIME)
    assert (np.diff(rising[:, 0]) > 0.0).all()
    assert (np.diff(rising[:, 1]) < 0.0).all()  # pixels go down
    np.testing.assert_allclose(rising[:, 1] + falling[:, 1], 108.0, atol=0.11)
    assert "a &lt; b &amp; c" in figure
    file = write_figure(figure, tmp_path / "motion.svg")
    assert ElementTree.parse(file).getroot().tag == f"{SVG}svg"


def test_torque_is_drawn_with_each_prediction_and_what_is_left():
    model = ci.TorqueModel(ARM)
    good, poor = (
        SimpleNamespace(
            method=name, model=model, predict=lambda log, k=k: k * log.torque
        )
        for name, k in (("good", 1.0), ("poor", 0.0))
    )
    figure = torque_figure([good, poor], LOG)
    assert len(curves(figure, "measured")) == 2
    assert [len(curves(figure, style)) for style in ("c0", "c1")] == [4, 4]
    # Of joint 1, the panel of the torque, then that of what is left of it.
    measured, (right, nothing), (none, all_of_it) = (
        curves(figure, style)[:2] for style in ("measured", "c0", "c1")
    )
    np.testing.assert_array_equal(right, measured[0])
    assert np.ptp(nothing[:, 1]) == np.ptp(none[:, 1]) == 0.0
    np.testing.assert_array_equal(all_of_it, measured[0])
    for name in ("good", "poor", "measured"):
        assert f">{name}</text>" in figure
