"""Regressions of logs that are read window by window."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from logged import DRIVE, HEAD, moved, write_arm

import consistent_id as ci
from consistent_id.cli import main
from consistent_id.errors import RecordingError
from consistent_id.estimation.estimate import torque_errors
from consistent_id.fleet import windows
from consistent_id.recordings.readers.recording_file import LogRows
from consistent_id.recordings.signals.filters import settling, zero_phase

_JITTER = np.random.default_rng(0)


@pytest.fixture(autouse=True)
def small_windows(monkeypatch):
    """Windows so small that a short log has many."""
    monkeypatch.setattr(windows, "WINDOW", 500)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A folder with a robot, and what it recorded."""
    folder = tmp_path_factory.mktemp("arm")
    urdf, _ = write_arm(folder)
    model = ci.TorqueModel(ci.robot.load_urdf(urdf), DRIVE)
    return folder, moved(model, seconds=60.0)


def _columns(recording, time):
    columns = {"time": time}
    for k, joint in enumerate(recording.joints):
        columns |= {f"q_{joint}": recording.position[:, k]}
        columns |= {f"tau_{joint}": recording.torque[:, k]}
    return columns


def _written(folder, form, columns):
    file = folder / f"log.{form}"
    if form == "csv":
        rows = np.column_stack(list(columns.values()))
        header = ",".join(columns)
        np.savetxt(file, rows, "%.17g", ",", header=header, comments="")
    elif form == "parquet":
        pq.write_table(pa.table(columns), file, row_group_size=1700)
    elif form == "feather":
        import pyarrow.feather

        pyarrow.feather.write_feather(pa.table(columns), file, chunksize=700)
    elif form == "mat":
        h5py = pytest.importorskip("h5py")
        with h5py.File(file, "w", userblock_size=512) as hdf:  # as MATLAB 7.3 does
            for name, values in columns.items():
                hdf[name] = np.atleast_2d(values)
                hdf[name].attrs["MATLAB_class"] = np.bytes_("double")
    else:
        h5py = pytest.importorskip("h5py")
        with h5py.File(file, "w") as hdf:
            for name, values in columns.items():
                hdf[name] = values
    return file.name


def _problem(folder, file, preparation, entry=""):
    text = f"""{HEAD}[data.columns]
position = "q_{{joint}}"
torque = "tau_{{joint}}"
[[data.recordings]]
file = "{file}"
role = "training"
{entry}
[data.preparation]
{preparation}
"""
    path = folder / f"{abs(hash(text))}.toml"
    path.write_text(text)
    return ci.load_problem(path)


def _difference(first, second):
    """Largest difference of the squared factors, columns of unit length."""
    worst = 0.0
    for F, G in zip(first.factors, second.factors, strict=True):
        H, K = F.T @ F, G.T @ G
        norms = np.sqrt(np.diag(H))
        norms = np.where(norms > 1e-9 * norms.max(), norms, np.inf)
        worst = max(worst, float(abs((H - K) / np.outer(norms, norms)).max()))
    return worst


UNIFORM = "motion_cutoff = 5.0\ntorque_cutoff = 8.0"
SPARSE = "motion_cutoff = 5.0\ntorque_cutoff = 3.0"
JITTERED = "resample = 100.0\nmotion_cutoff = 5.0"


def slow(*case):
    """A case all of whose parts are in others, in another mixture."""
    return pytest.param(*case, marks=pytest.mark.slow)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("form", "jitter", "preparation", "entry"),
    [
        ("csv", 2e-6, UNIFORM, ""),
        slow("parquet", 2e-6, f"{UNIFORM}\ndecimate = 3", ""),
        ("h5", 1e-3, JITTERED, "rows = [201, 5000]\nomit = [5, 900, 901]"),
        slow("mat", 2e-6, UNIFORM, "rows = [300, 5800]"),
        slow("feather", 1e-3, f"{JITTERED}\ntrim_standstill = true", ""),
        slow("parquet", 1e-3, f"{JITTERED}\nleast_speed = 0.2", "rows = [100, 5500]"),
        (
            "csv",
            2e-6,
            'method = "savitzky-golay"\nwindow = 0.2\ntrim_standstill = 0.01',
            "omit = [1]",
        ),
        (
            "parquet",
            1e-3,
            f"{JITTERED}\ndecimate = 2\ntrim_standstill = true\nleast_speed = 0.3\n"
            "delays = {torque = -0.013}",
            "",
        ),
        ("csv", 1e-3, f"{JITTERED}\nmax_gap = 0.0119\nshortest_part = 4.0", ""),
        ("parquet", 2e-6, f"{UNIFORM}\nleast_speed = 0.3", "rows = [100, 5900]"),
        # Of few rows: windows are rounded together, not each by itself.
        ("parquet", 2e-6, f"{SPARSE}\nleast_speed = 0.9\ndecimate = 3", ""),
        slow("h5", 2e-6, f"{UNIFORM}\ntrim_standstill = true", ""),
        slow("csv", 2e-6, f"{UNIFORM}\ndecimate = 3\nleast_speed = 0.3", ""),
        (
            "parquet",
            1e-3,
            f"{JITTERED}\ntorque_cutoff = 4.0\ntrim_standstill = 0.02\n"
            "least_speed = 0.8\ndecimate = 2",
            "omit = [900, 901]",
        ),
    ],
)
def test_streamed_regressions_are_those_of_memory(
    log, form, jitter, preparation, entry
):
    folder, recording = log
    time = recording.time + _JITTER.uniform(-jitter, jitter, len(recording))
    file = _written(folder, form, _columns(recording, time))
    problem = _problem(folder, file, preparation, entry)
    whole = ci.build_regression(problem.model, problem.training)
    streamed = ci.fleet.stream_regression(problem)
    assert streamed.counts == whole.counts
    assert _difference(streamed, whole) < 1e-12
    # Peaks are torques themselves: filters' rounding is some 1e-15 of some 50 N m.
    np.testing.assert_allclose(streamed.peaks, whole.peaks, rtol=1e-12)
    np.testing.assert_allclose(streamed.effective, whole.effective, rtol=1e-10)
    for one, other in zip(streamed.noise.scores, whole.noise.scores, strict=True):
        size = abs(other.T @ other).max()
        np.testing.assert_allclose(one.T @ one, other.T @ other, atol=1e-10 * size)


@pytest.mark.slow
@pytest.mark.parametrize("end", ["first", "last"])
def test_a_velocity_that_lacks_a_difference_is_mended_as_in_memory(log, end, caplog):
    folder, recording = log
    moving = recording.samples(slice(330, 4330))
    steps = np.diff(moving.position, axis=0) * 100.0
    parts = {"first": [0.0 * steps[:1], steps], "last": [steps, 0.0 * steps[:1]]}
    velocity = np.vstack(parts[end])
    columns = _columns(moving, moving.time)
    columns |= {f"dq_{j}": velocity[:, k] for k, j in enumerate(moving.joints)}
    file = _written(folder, "csv", columns)
    problem = _problem(folder, file, UNIFORM)
    plain = 'position = "q_{joint}"'
    text = problem.source.read_text()
    named = text.replace(plain, plain + '\nvelocity = "dq_{joint}"')
    problem.source.write_text(named)
    problem = ci.load_problem(problem.source)
    streamed = ci.fleet.stream_regression(problem)
    assert f"the {end} velocity is zero" in caplog.text
    whole = ci.build_regression(problem.model, problem.training)
    assert streamed.counts == whole.counts
    assert _difference(streamed, whole) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["processes:2", "dask:2"])
def test_regressions_are_the_same_wherever_they_are_made(log, executor, monkeypatch):
    if executor.startswith("dask"):
        pytest.importorskip("distributed")
    monkeypatch.setattr(windows, "_AT_ONCE", 2)
    folder, recording = log
    file = _written(folder, "parquet", _columns(recording, recording.time))
    problem = _problem(folder, file, f"{UNIFORM}\nleast_speed = 0.2")
    here = ci.fleet.stream_regression(problem)
    there = ci.fleet.stream_regression(problem, executor=executor)
    assert here.counts == there.counts
    for one, other in zip(here.factors, there.factors, strict=True):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(here.noise.scores, there.noise.scores, strict=True):
        np.testing.assert_array_equal(one, other)


def test_filters_have_forgotten_their_start_after_settling():
    rng = np.random.default_rng(1)
    values = np.cumsum(rng.normal(size=(60_000, 1)), axis=0)
    for order, cutoff in ((4, 0.5), (4, 20.0), (8, 2.0), (4, 45.0), (1, 3.0)):
        given = dict(cutoff=cutoff, rate=100.0, order=order, pad=100)
        reach = settling(cutoff=cutoff, rate=100.0, order=order)
        whole = zero_phase(values, **given)
        part = zero_phase(values[20_000 : 20_000 + 3 * reach], **given)
        inside = slice(20_000 + reach, 20_000 + 2 * reach)
        error = abs(part[reach : 2 * reach] - whole[inside]).max()
        # Rounding of the two passes, which start from different levels, remains.
        assert error < 1e-12 * abs(values).max()


@pytest.mark.parametrize("form", ["csv", "parquet", "feather", "h5"])
def test_rows_are_read_from_anywhere(log, form):
    folder, recording = log
    file = _written(folder, form, _columns(recording, recording.time))
    columns = ci.Columns(torque="tau_{joint}")
    rows = LogRows(folder / file, recording.joints, columns, omit=(3, 2001))
    kept = np.delete(np.arange(len(recording)), [2, 2000])
    ranges = [(1690, 1710), (1700, 3600), (3600, 3602), (5990, 5998)]
    for (first, last), found in zip(ranges, rows.windows(ranges), strict=True):
        own = kept[first:last]
        np.testing.assert_array_equal(found.time, recording.time[own])
        np.testing.assert_array_equal(found.torque, recording.torque[own])


@pytest.mark.slow
def test_rows_of_a_text_that_is_not_tidy_are_counted(tmp_path, monkeypatch):
    monkeypatch.setattr("consistent_id.recordings.readers.table_text.PIECE", 64)
    lines = [f"{k},{k},{2 * k}" for k in range(40)]
    text = "# a log\ntime,q_a,tau_a\n" + "\n".join(lines[:20]) + "\n\r\n\n"
    (tmp_path / "log.csv").write_text(text + "\r\n".join(lines[20:]))
    columns = ci.Columns(torque="tau_{joint}")
    rows = LogRows(tmp_path / "log.csv", ("a",), columns)
    for first in range(38):
        (found,) = rows.windows([(first, 40)])
        assert found.time.tolist() == list(range(first, 40))


def test_columns_of_arrays_are_streamed(log):
    h5py = pytest.importorskip("h5py")
    folder, recording = log
    every = np.column_stack([recording.position, recording.torque])
    with h5py.File(folder / "arrays.h5", "w") as file:
        file["time"], file["all"] = recording.time, every
    columns = ci.Columns(
        position="all[0:2]", torque="all[2:]", array_joints=recording.joints
    )
    rows = LogRows(folder / "arrays.h5", recording.joints, columns)
    (found,) = rows.windows([(2000, 2600)])
    np.testing.assert_array_equal(found.position, recording.position[2000:2600])
    np.testing.assert_array_equal(found.torque, recording.torque[2000:2600])


def test_clock_faults_are_named_across_windows(log):
    folder, recording = log
    time = recording.time.copy()
    time[3000:] -= 0.02
    problem = _problem(
        folder, _written(folder, "parquet", _columns(recording, time)), UNIFORM
    )
    with pytest.raises(RecordingError, match=r"\(sample 2999\).*must increase"):
        ci.fleet.stream_regression(problem)
    time[3000:] += 0.5
    problem = _problem(
        folder, _written(folder, "parquet", _columns(recording, time)), UNIFORM
    )
    with pytest.raises(RecordingError, match="not uniform"):
        ci.fleet.stream_regression(problem)


@pytest.fixture
def divided(log):
    """A problem file whose log is learnt from in part, and judged by the rest."""
    folder, recording = log
    file = _written(folder, "parquet", _columns(recording, recording.time))
    held_out = f'[[data.recordings]]\nfile = "{file}"\nrole = "validation"'
    entry = f"rows = [1, 4000]\n{held_out}\nrows = [4100, 6000]"
    return _problem(folder, file, UNIFORM, entry)


@pytest.mark.slow
def test_an_estimate_is_that_of_the_whole_recordings_and_judged_by_others(divided):
    found = ci.fleet.stream_estimate(divided)
    model, regression = (
        divided.model,
        ci.build_regression(divided.model, divided.training),
    )
    whole = ci.constrained_least_squares(
        model,
        regression.weighted(ci.regression.joint_noise(model, regression)),
        constraints=divided.constraints,
        prior=divided.prior,
    )
    np.testing.assert_allclose(found.base_values, whole.base_values, rtol=1e-6)
    error = torque_errors([found], divided.validation[0])[0].stacked
    assert f"held-out recordings: {error:.2%}" in found.notes[0]
    assert found.verdict.word == "use" and found.certificate.verdict == "certified"


@pytest.mark.slow
def test_the_shell_identifies_piece_by_piece(divided, tmp_path, capsys):
    file = str(next(f for f in divided.files.values() if f.suffix == ".toml"))
    assert main(["identify", file, "--streamed", "--output", str(tmp_path)]) == 0
    assert "use" in capsys.readouterr().out
    base = ci.regression.base_parameters(divided.model)
    saved = ci.Estimate.load(tmp_path / "delivered.json", divided.model, base)
    np.testing.assert_array_equal(
        saved.parameters, ci.fleet.stream_estimate(divided).parameters
    )
    assert main(["identify", file, "--streamed", "--uncertainty"]) == 2
    assert "--streamed is for a problem file" in capsys.readouterr().err
