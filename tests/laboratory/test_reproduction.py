"""The paper's experiments done again: tasks and laboratory from the file, tables."""

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest
from rx60 import PROBLEM, truth

from consistent_id import load_problem
from consistent_id.errors import ProblemError
from consistent_id.laboratory.curves import (
    bulb,
    circle,
    ellipse,
    ellipsoid,
    helix,
    through_points,
)
from consistent_id.laboratory.from_problem import (
    curve_of,
    laboratory_of,
    task_motion,
    task_path,
)
from consistent_id.laboratory.reproduction import reproduce_experiments
from consistent_id.laboratory.reproduction.paper_tables import (
    deviations_table,
    experiments_table,
)
from consistent_id.problems.task_tables import TaskTable

PEN = {"frame": "link3", "duration": 1.0, "rate": 100.0}
PLACE = {"centre": [0.3, 0.1, 0.4], "along": [0, 1, 0], "across": [0, 0, 1], "turns": 2}
POINTS = [[0.3, 0, 0.3], [0.35, 0.1, 0.25], [0.3, 0.15, 0.35]]


@cache
def _reproduced(friction):
    return reproduce_experiments(
        PROBLEM, truth(), friction=friction, experiments=("free", "circle")
    )


@pytest.mark.parametrize(
    ("shape", "keys", "expected"),
    [
        ("circle", {"radius": 0.1}, circle(0.1, **PLACE)),
        ("ellipse", {"semi_axes": [0.1, 0.2]}, ellipse((0.1, 0.2), **PLACE)),
        (
            "bulb",
            {"semi_axes": [0.1, 0.2], "taper": 0.3},
            bulb((0.1, 0.2), taper=0.3, **PLACE),
        ),
        (
            "ellipsoid",
            {"semi_axes": [0.1, 0.2, 0.3], "latitude_deg": 45.0},
            ellipsoid((0.1, 0.2, 0.3), latitude=np.pi / 4, **PLACE),
        ),
        ("helix", {"radius": 0.1, "height": 0.2}, helix(0.1, 0.2, **PLACE)),
        (
            "points",
            {"points": POINTS, "closed": True},
            through_points(POINTS, closed=1),
        ),
    ],
)
def test_a_shape_of_the_file_is_the_curve_of_that_name(shape, keys, expected):
    place = {} if shape == "points" else PLACE
    table = msgspec.convert({"shape": shape, **PEN, **place, **keys}, TaskTable)
    u = np.linspace(0.0, 1.0, 11)
    assert curve_of(table).evaluate(u) == pytest.approx(expected.evaluate(u))


@pytest.mark.slow
def test_a_task_or_a_laboratory_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ProblemError, match=r"no task 'cirlce'.*circle"):
        task_path(PROBLEM, "cirlce")
    bare = replace(
        PROBLEM, table=msgspec.structs.replace(PROBLEM.table, laboratory=None)
    )
    with pytest.raises(ProblemError, match=r"no \[laboratory\] table"):
        laboratory_of(bare, np.zeros(30))
    with pytest.raises(ProblemError, match="'square' is not among"):
        reproduce_experiments(PROBLEM, truth(), experiments=("square",))
    text = (PROBLEM.folder / "problem.toml").read_text()
    (tmp_path / "problem.toml").write_text(
        text.replace("radius = 0.15", "radus = 0.15")
    )
    with pytest.raises(
        ProblemError, match=r"tasks\.NAME has no key 'radus'; known: radius"
    ):
        load_problem(tmp_path)


@pytest.mark.slow
def test_the_six_experiments_of_the_rx60_are_on_their_curves():
    for name in PROBLEM.table.laboratory.experiments:
        path = task_path(PROBLEM, name)
        found = path.solve(np.linspace(0.0, path.duration, 101))
        assert found.error.max() < 1e-9, name
        assert found.condition.max() < 10.0, name
    motion = task_motion(PROBLEM, "circle")
    assert (motion.name, motion.rate) == ("circle", 1000.0)


@pytest.mark.slow
def test_without_friction_least_squares_finds_what_the_torque_depends_on():
    done = _reproduced(False)
    assert [e.excitation.rank for e in done.experiments] == [11, 11]
    published, constrained, *_ = done.tables
    # kg m^2.  Noise leaves 0.03 or so (the scatter over all six experiments), and the
    # cell's offset, which neither model knows, as much again.
    assert abs(done.errors(published)).max() < 0.1
    assert abs(done.errors(constrained)).max() < 0.1
    for experiment in done.experiments:
        assert experiment.synchronised_log.delay.seconds == pytest.approx(
            0.0137, abs=5e-4
        )
        assert experiment.estimates[1].certificate.verdict == "certified"


@pytest.mark.slow
def test_friction_spoils_least_squares_as_published_and_not_a_model_that_has_it():
    done = _reproduced(True)
    published, _, *with_friction = done.tables
    assert abs(done.errors(published)).max() > 0.5
    for table in with_friction:
        assert "friction" in table.method
        assert abs(done.errors(table)).max() < 0.1
        assert published.standard_deviation.max() > 5 * table.standard_deviation.max()


@pytest.mark.slow
def test_known_parameters_stay_where_the_datasheet_has_them():
    for table in _reproduced(True).tables:
        fixed = [table.names.index(f"alpha{k}") for k in (4, 15, 16)]
        assert table.standard_deviation[fixed] == pytest.approx(0.0, abs=1e-4)
        assert table.mean[fixed] == pytest.approx([0.1255, 24.775, 2.1197], abs=1e-3)


@pytest.mark.slow
def test_tables_hold_mean_and_sample_deviation():
    table = _reproduced(True).tables[0]
    assert table.vectors.shape == (2, 16)
    assert table.experiments == ("free", "circle")
    assert table.mean == pytest.approx((table.vectors[0] + table.vectors[1]) / 2)
    half = abs(table.vectors[0] - table.vectors[1]) / np.sqrt(2)
    assert table.standard_deviation == pytest.approx(half)


@pytest.mark.slow
def test_tables_are_printed_as_in_the_paper():
    done = _reproduced(True)
    first = done.tables[0]
    third = experiments_table(first)
    assert third.header == ("parameter", "free", "circle")
    assert third.rows[4] == ("alpha5", *(f"{v:.4f}" for v in first.vectors[:, 4]))
    fourth = deviations_table(done)
    assert len(fourth.rows) == 16
    assert fourth.rows[3][:4] == ("alpha4", "0.1255", "0.1255", "0.0000")
    assert fourth.rows[0][3] == f"{first.standard_deviation[0]:.4f}"
    assert "standard deviation" in fourth.markdown()


@pytest.mark.slow
def test_an_experiment_is_the_same_whatever_others_are_done():
    alone = reproduce_experiments(PROBLEM, truth(), experiments=("circle",))
    both = _reproduced(True)
    torque = [
        e.log.encoders.torque for e in (alone.experiments[0], both.experiments[1])
    ]
    assert (torque[0] == torque[1]).all()
