"""Curves, time laws and what they make of each other."""

import numpy as np
import pytest
from scipy.special import ellipe

from consistent_id.errors import ProblemError
from consistent_id.laboratory.curves import (
    arc_length,
    bulb,
    circle,
    ellipse,
    ellipsoid,
    helix,
    through_points,
)
from consistent_id.laboratory.writing_tasks import Orientation, WritingTask, time_law

PLACE = {"centre": [0.3, 0.1, 0.4], "along": [0, 1, 0.2], "across": [0.3, 0, 1]}
POINTS = [[0.3, 0, 0.3], [0.35, 0.1, 0.25], [0.3, 0.15, 0.35], [0.25, 0.05, 0.4]]
CURVES = {
    "circle": circle(0.1, turns=2.5, **PLACE),
    "ellipse": ellipse((0.12, 0.08), **PLACE),
    "bulb": bulb((0.1, 0.07), taper=0.6, **PLACE),
    "ellipsoid": ellipsoid((0.1, 0.08, 0.06), **PLACE),
    "helix": helix(0.08, 0.1, **PLACE),
    "closed": through_points(POINTS, closed=True),
    "open": through_points(POINTS),
}


def _in_plane(curve, u):
    """Coordinates along the curve's own axes, about its centre."""
    p = curve.evaluate(u, 0)[0] - PLACE["centre"]
    x = np.array(PLACE["along"]) / np.linalg.norm(PLACE["along"])
    z = np.cross(PLACE["along"], PLACE["across"])
    z /= np.linalg.norm(z)
    return (p @ np.array([x, np.cross(z, x), z]).T).T


@pytest.mark.parametrize("name", CURVES)
def test_derivatives_of_a_curve_are_those_of_finite_differences(name):
    u, h = np.linspace(0.02, 0.97, 60), 1e-5
    c, dc, ddc = CURVES[name].evaluate(u)
    above, below = CURVES[name].evaluate(u + h), CURVES[name].evaluate(u - h)
    slope, bend = ((above - below) / (2 * h))[:2]
    # Central differences: h^2 / 6 of a third derivative of some 20^3 * 0.1 m.
    assert abs(dc - slope).max() < 1e-6 * max(abs(dc).max(), 1.0)
    # At a spline's knots the second derivative has a corner.
    assert abs(ddc - bend).max() < 1e-3 * max(abs(ddc).max(), 1.0)
    assert np.isfinite(c).all()


def test_the_points_lie_on_circle_ellipse_bulb_ellipsoid_and_helix():
    u = np.linspace(0.0, 1.0, 101)
    x, y, z = _in_plane(CURVES["circle"], u)
    assert np.hypot(x, y) == pytest.approx(0.1, rel=1e-12)
    assert abs(z).max() < 1e-15
    x, y, z = _in_plane(CURVES["ellipse"], u)
    assert (x / 0.12) ** 2 + (y / 0.08) ** 2 == pytest.approx(1.0, rel=1e-12)
    x, y, z = _in_plane(CURVES["bulb"], u)
    wide = 0.07 * (1 + 0.6 * x / 0.1)
    assert (x / 0.1) ** 2 + (y / wide) ** 2 == pytest.approx(1.0, rel=1e-9)
    x, y, z = _in_plane(CURVES["ellipsoid"], u)
    on = (x / 0.1) ** 2 + (y / 0.08) ** 2 + (z / 0.06) ** 2
    assert on == pytest.approx(1.0, rel=1e-12)
    assert z[[0, -1]] == pytest.approx(0.06 * np.sin(np.pi / 3) * np.array([-1, 1]))
    x, y, z = _in_plane(CURVES["helix"], u)
    assert np.hypot(x, y) == pytest.approx(0.08, rel=1e-12)
    assert z == pytest.approx(0.1 * (u - 0.5), abs=1e-15)


def test_arc_lengths_are_the_closed_forms():
    end = [1.0]
    assert arc_length(CURVES["circle"], end) == pytest.approx(2.5 * 0.2 * np.pi)
    turn = np.hypot(2 * np.pi * 0.08, 0.1 / 3)
    assert arc_length(CURVES["helix"], end) == pytest.approx(3 * turn)
    around = 4 * 0.12 * ellipe(1 - (0.08 / 0.12) ** 2)
    assert arc_length(CURVES["ellipse"], end) == pytest.approx(around, rel=1e-12)


@pytest.mark.parametrize("closed", [False, True])
def test_a_path_through_points_meets_them_at_their_arc_lengths(closed):
    path = CURVES["closed" if closed else "open"]
    knots = path.spline.x
    wanted = np.array([*POINTS, POINTS[0]]) if closed else np.array(POINTS)
    assert path.evaluate(knots, 0)[0] == pytest.approx(wanted, abs=1e-15)
    length = arc_length(path, knots)
    # Refitted until the knots are lengths, to about a thousandth of the whole.
    assert length / length[-1] == pytest.approx(knots, abs=1e-3)
    if closed:
        ends = path.evaluate([0.0, 1.0])
        assert ends[:, 0] == pytest.approx(ends[:, 1], abs=1e-9)


@pytest.mark.parametrize("law", ["quintic", "septic", "cycloidal"])
def test_a_time_law_goes_from_rest_to_rest_and_never_back(law):
    s = np.linspace(-0.2, 1.2, 2801)
    x, v, a, j = time_law(law, s, 3)
    assert (x[0], x[-1]) == (0.0, 1.0)
    assert (v >= 0.0).all()
    at_ends = time_law(law, [0.0, 1.0, 1e-7, 1 - 1e-7], 2)
    assert abs(at_ends[1:]).max() < 1e-5  # of order 60 times 1e-7
    inside = (s > 0.001) & (s < 0.999)
    step = s[1] - s[0]
    for lower, upper in ((x, v), (v, a), (a, j)):
        slope = np.gradient(lower, step)
        # step^2 / 6 of derivatives up to the fifth, some 3e4 at most.
        assert abs(slope - upper)[inside].max() < 5e-3


def test_speed_and_acceleration_along_a_task_are_those_of_finite_differences():
    task = WritingTask(CURVES["ellipsoid"], 4.0, "septic", start=1.0)
    t, h = np.linspace(1.1, 4.9, 80), 1e-5
    x, v, a = task.evaluate(t)
    above, below = task.evaluate(t + h), task.evaluate(t - h)
    assert v == pytest.approx(((above - below) / (2 * h))[0], abs=1e-8)
    assert a == pytest.approx(((above - below) / (2 * h))[1], abs=1e-7)
    assert np.isfinite(x).all()
    still = task.evaluate([0.0, 1.0, 5.0, 7.0])
    assert abs(still[1:]).max() == 0.0
    assert still[0, 0] == pytest.approx(task.curve.evaluate([0.0])[0, 0])


def test_time_at_undoes_progress():
    task = WritingTask(CURVES["circle"], 3.0, "cycloidal", start=-1.0)
    for t in (-0.9, 0.3, 1.8):
        assert task.time_at(task.progress([t])[0, 0]) == pytest.approx(t, abs=1e-9)
    assert (task.time_at(0.0), task.time_at(1.0)) == (-1.0, 2.0)


def test_an_orientation_turns_about_its_axis_from_its_start():
    held = Orientation(np.eye(3), axis=[0, 0, 2], angle=np.pi / 2)
    start, end = held.at(np.array([0.0, 1.0]))
    assert start == pytest.approx(np.eye(3))
    assert end @ [1, 0, 0] == pytest.approx([0, 1, 0], abs=1e-15)


def test_curves_and_tasks_that_make_no_sense_are_refused():
    centre = [0.0, 0.0, 0.0]
    refusals = {
        "semi-axis is 0": lambda: circle(0, centre=centre),
        "turns is -1": lambda: circle(1, centre=centre, turns=-1),
        "taper is 1": lambda: bulb((1, 1), taper=1, centre=centre),
        "latitude is 2": lambda: ellipsoid((1, 1, 1), centre=centre, latitude=2),
        "height is 0": lambda: helix(1, 0, centre=centre),
        "span no plane": lambda: circle(1, centre=centre, across=[2, 0, 0]),
        "path through 2 points": lambda: through_points([[0, 0, 0], [1, 0, 0]]),
        "shortest step of which is 0": lambda: through_points([[0, 0, 0]] * 4),
        "duration is 0": lambda: WritingTask(CURVES["circle"], 0.0),
        "law is 'cubic'": lambda: WritingTask(CURVES["circle"], 1.0, "cubic"),
        "start is inf": lambda: WritingTask(CURVES["circle"], 1.0, start=np.inf),
        "start is no rotation": lambda: Orientation(2 * np.eye(3)),
        "axis is zero": lambda: Orientation(np.eye(3), axis=[0, 0, 0]),
    }
    for message, call in refusals.items():
        with pytest.raises(ProblemError, match=message):
            call()
