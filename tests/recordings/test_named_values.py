"""Lines in which each value has its name are read as a table."""

import json
from functools import partial

import numpy as np
import pytest

from consistent_id.errors import RecordingError
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.readers import read_recording

JOINTS = ("axis_a", "axis_b")
TIME = np.arange(30) / 10.0
POSITION = np.round(np.column_stack([np.sin(TIME), 0.2 * TIME]), 6)
TORQUE = np.round(3.0 * POSITION + 1.0, 6)


def pairs(t, q, tau):
    each = [f"q{k}={q[k - 1]:.6f}, tau{k} = {tau[k - 1]:.6f}" for k in (1, 2)]
    return f"t={t:.4f}, " + ", ".join(each)


def stamped(t, q, tau):
    lists = "q=[{:.6f}, {:.6f}] tau=[{:.6f}, {:.6f}]".format(*q, *tau)
    return f"[INFO] [{1.7e9 + t:.6f}] [arm]: {lists}"


def of_numpy(t, q, tau):
    return f"t: {t:.4f} q: {q} tau: {tau}"


def objects(t, q, tau):
    return json.dumps({"t": t, "q": q.tolist(), "tau": tau.tolist()})


def read(file):
    guess = guess_columns(file, KnownColumns(JOINTS))
    return read_recording(file, guess.joints, guess.columns)


def lines(form):
    return [form(*row) for row in zip(TIME, POSITION, TORQUE, strict=True)]


@pytest.mark.parametrize("form", [pairs, stamped, of_numpy, objects])
def test_lines_of_names_and_values_are_read(tmp_path, form):
    file = tmp_path / "printed.log"
    file.write_text("\n".join(lines(form)) + "\n")
    log = read(file)
    np.testing.assert_allclose(log.time - log.time[0], TIME, atol=1e-6)
    np.testing.assert_allclose(log.position, POSITION)
    np.testing.assert_allclose(log.torque, TORQUE)


def test_a_last_line_that_is_cut_off_and_other_lines_are_left_out(tmp_path):
    file = tmp_path / "printed.log"
    printed = lines(pairs)
    printed.insert(7, "warning: retries=3")
    printed.insert(0, "controller started, rate=100")
    file.write_text("\n".join(printed)[:-3])  # its last number has other digits
    log = read(file)
    np.testing.assert_allclose(log.position, POSITION[:-1])
    np.testing.assert_allclose(log.torque, TORQUE[:-1])


def in_degrees(t, q, tau, unit="Nm"):
    each = [
        f"q{k}={np.degrees(q[k - 1]):.9f}deg tau{k}: {tau[k - 1]} {unit}"
        for k in (1, 2)
    ]
    return f"t={1e3 * t:.4f}ms " + " ".join(each)


@pytest.mark.slow
@pytest.mark.parametrize("unit", ["Nm", "N m", "N.m"])
def test_units_behind_values_are_those_of_their_columns(tmp_path, unit):
    file = tmp_path / "printed.log"
    file.write_text("\n".join(lines(partial(in_degrees, unit=unit))) + "\n")
    log = read(file)
    np.testing.assert_allclose(log.time, TIME, atol=1e-6)
    np.testing.assert_allclose(log.position, POSITION, atol=1e-9)
    np.testing.assert_allclose(log.torque, TORQUE)


def without_brackets(t, q, tau):
    return f"t: {t:.4f} q: {q[0]} {q[1]} tau: {tau[0]}, {tau[1]}"


def test_a_list_without_brackets_is_one_and_not_its_first_number(tmp_path):
    file = tmp_path / "printed.log"
    file.write_text("\n".join(lines(without_brackets)) + "\n")
    np.testing.assert_allclose(read(file).torque, TORQUE)
    with pytest.raises(RecordingError):
        guess_columns(file, KnownColumns(JOINTS[:1]))


def by_joint(t, q, tau):
    each = [f"joint{k}: pos={q[k - 1]} tau={tau[k - 1]}" for k in (1, 2)]
    return f"t={t:.4f} " + " ".join(each)


def nested(t, q, tau):
    each = [dict(zip(JOINTS, map(float, values), strict=True)) for values in (q, tau)]
    return json.dumps({"t": float(t), "q": each[0], "tau": each[1]})


def with_commas(t, q, tau):
    return f"t={t:.4f} q={q[0]:.6f} tau={tau[0]:.6f}".replace(".", ",")


@pytest.mark.parametrize("form", [by_joint, nested, with_commas])
def test_lines_whose_names_or_numbers_are_not_plain_are_not_read(tmp_path, form):
    """A name that stands twice would be that of the last joint."""
    file = tmp_path / "printed.log"
    file.write_text("\n".join(lines(form)) + "\n")
    with pytest.raises(RecordingError, match="no column is named time"):
        guess_columns(file, KnownColumns(JOINTS[:1]))
