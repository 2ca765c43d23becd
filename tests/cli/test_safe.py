"""The shell tool with anybody's files: nothing destroyed, nothing foreign raised."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from argparse import Namespace
from importlib.metadata import version

import pytest
from logged import write_arm
from shared_studies import shared_within

from consistent_id import ProblemError
from consistent_id._support.run import OutOfTime, kept_going
from consistent_id.cli import main
from consistent_id.cli.tool import run_to_its_end
from consistent_id.estimation.uncertainties import resampling

RX60 = "problems/rx60"
studies = shared_within("module")


@pytest.fixture
def arm(tmp_path):
    return write_arm(tmp_path)


def kept(path, arguments, capsys, says):
    """Run, and demand that a file stays what it was."""
    before = path.read_bytes()
    assert main([str(a) for a in arguments]) == 2
    assert re.search(says, capsys.readouterr().err)
    assert path.read_bytes() == before


@pytest.mark.slow
def test_a_report_does_not_overwrite_the_log(arm, capsys):
    urdf, log = arm
    kept(log, ["identify", urdf, log, "--report", log], capsys, "is an input")


@pytest.mark.slow
def test_a_report_does_not_overwrite_a_file_of_others(arm, tmp_path, capsys):
    page = tmp_path / "thesis.html"
    page.write_text("<h1>Thesis</h1>")
    arguments = ["identify", *arm, "--report", page]
    kept(page, arguments, capsys, "nothing in it says")


@pytest.mark.slow
@pytest.mark.usefixtures("studies")
def test_an_export_does_not_overwrite_the_model(tmp_path, capsys):
    model = tmp_path / "robot.urdf"
    assert main(["export", RX60, "--format", "urdf", "--output", str(model)]) == 0
    capsys.readouterr()
    arguments = ["export", RX60, "--format", "urdf", "--source", model]
    kept(model, [*arguments, "--output", model], capsys, "is an input")
    assert main([*map(str, arguments), "--output", str(model), "--force"]) == 0
    capsys.readouterr()


def test_a_repair_does_not_overwrite_what_it_repairs(arm, capsys):
    urdf, _ = arm
    kept(urdf, ["repair", urdf, "--output", urdf], capsys, "is an input")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("excite", "trajectory.csv"),
        ("compare", "comparison.md"),
        ("reproduce", "reproduction.html"),
    ],
)
def test_long_work_does_not_begin_if_its_files_would_be_refused(
    tmp_path, capsys, monkeypatch, command, name
):
    def begun(*_, **__):
        raise AssertionError("begun")

    for work in (
        "excitation.playable.playable_design",
        "problems.study.run_study",
        "laboratory.reproduction.paper_study.reproduce",
    ):
        monkeypatch.setattr(f"consistent_id.{work}", begun)
    (tmp_path / name).write_text("mine")
    arguments = [command, RX60, "--output", tmp_path]
    kept(tmp_path / name, arguments, capsys, "nothing in it says")


@pytest.mark.slow
@pytest.mark.parametrize("form", ["mjcf", "json", "numpy", "casadi", "c"])
@pytest.mark.usefixtures("studies")
def test_what_was_exported_may_be_exported_again(tmp_path, capsys, form):
    for problem in (RX60, "problems/rx60/problem.toml"):
        arguments = ["export", problem, "--format", form]
        assert main([*arguments, "--output", str(tmp_path / "robot")]) == 0
        with (tmp_path / "robot").open("ab") as file:
            file.write(b"\n")  # no longer what would be written
    capsys.readouterr()


@pytest.mark.slow
@pytest.mark.usefixtures("studies")
def test_every_file_of_a_study_may_be_written_again(arm, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ["identify", *map(str, arm), "--output", str(out)]
    arguments += ["--report", str(out / "report.html")]
    assert main(arguments) == 0
    written = [p for p in out.iterdir() if p.name != "problem.toml"]
    assert len(written) > 5
    for file in written:
        with file.open("ab") as end:
            end.write(b"\n")
    assert main(arguments) == 0
    capsys.readouterr()


@pytest.mark.slow
@pytest.mark.usefixtures("studies")
def test_an_estimate_with_a_list_for_a_number_is_refused(tmp_path, capsys):
    out = tmp_path / "out"
    main(["identify", RX60, "--output", str(out)])
    file = out / "constrained.json"
    record = json.loads(file.read_text())
    first = next(iter(record["parameters"]))
    record["parameters"][first]["value"] = [1.0, 2.0]
    file.write_text(json.dumps(record))
    arguments = ["export", RX60, "--format", "json", "--output", str(tmp_path / "x")]
    assert main([*arguments, "--estimate", str(file)]) == 2
    assert "expected `float`, got `array`" in capsys.readouterr().err.lower()
    file.write_text("[" * 100_000)
    assert main([*arguments, "--estimate", str(file)]) == 2
    assert "not JSON" in capsys.readouterr().err


@pytest.mark.parametrize("value", ["1e308", "-1e308", "1e31"])
def test_an_inertia_that_no_body_has_is_refused(arm, capsys, value):
    urdf, _ = arm
    urdf.write_text(urdf.read_text().replace('ixx="0.02"', f'ixx="{value}"'))
    assert main(["repair", str(urdf), "--dry-run"]) == 1
    assert f"<inertia ixx> is '{value}'" in capsys.readouterr().out


def test_a_bug_leaves_a_line_a_traceback_in_a_file_and_code_70(
    tmp_path, capsys, monkeypatch
):
    def broken(*_, **__):
        raise ZeroDivisionError("what nobody thought of")

    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr("consistent_id.problems.opening.open_problem", broken)
    assert main(["compare", RX60, "--dry-run"]) == 70
    (line,) = capsys.readouterr().err.splitlines()
    assert "this is a bug" in line and "what nobody thought of" in line
    (file,) = tmp_path.glob("consistent-id-*.txt")
    assert str(file) in line
    assert "Traceback" in file.read_text() and "in broken" in file.read_text()


@pytest.mark.parametrize(
    ("end", "code"), [(0, 70), (1, 70), (ProblemError("no"), 2), (OutOfTime(), 3)]
)
def test_a_part_that_fails_is_named_when_all_else_is_done(
    tmp_path, capsys, monkeypatch, end, code
):
    def work(options):
        with kept_going("figure 1"):
            raise ZeroDivisionError("what nobody thought of")
        print("all else")
        if isinstance(end, int):
            return end
        raise end

    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    assert run_to_its_end(Namespace(give_up_after=1.0), work) == code
    out, err = capsys.readouterr()
    assert out == "all else\n"
    line = err.splitlines()[-1]
    assert "figure 1 could not be made, all else was: this is a bug" in line
    (file,) = tmp_path.glob("consistent-id-*.txt")
    assert str(file) in line and "in work" in file.read_text()


@pytest.mark.parametrize(
    ("error", "code"), [(MemoryError(), 3), (PermissionError(13, "no", "x"), 2)]
)
def test_what_the_system_refuses_is_no_bug(capsys, monkeypatch, error, code):
    def refused(*_, **__):
        raise error

    monkeypatch.setattr("consistent_id.problems.opening.open_problem", refused)
    assert main(["compare", RX60, "--dry-run"]) == code
    assert "bug" not in capsys.readouterr().err


@pytest.mark.slow
def test_what_init_wrote_opens_again_and_may_be_written_again_until_it_is_edited(
    arm, tmp_path, capsys, monkeypatch
):
    monkeypatch.delenv("CONSISTENT_ID_DATASETS", raising=False)
    study = tmp_path / "study" / "problem.toml"
    init = ["init", *map(str, arm), "--no-select", "--cutoff", "10"]
    init += ["--output", str(study)]
    assert main(init) == 0
    shown = capsys.readouterr().out
    assert f"compare {study}" in shown and "--trust" not in shown
    assert main(init) == 0
    study.write_text(study.read_text().replace("viscous = true", "viscous = false"))
    assert main(["info", str(study)]) == 0
    kept(study, init, capsys, "was edited since consistent-id wrote it")
    assert main([*init, "--force"]) == 0
    capsys.readouterr()


def test_a_problem_file_of_others_may_name_files_only_with_trust(
    arm, tmp_path, capsys, monkeypatch
):
    monkeypatch.delenv("CONSISTENT_ID_DATASETS", raising=False)
    study = tmp_path / "study" / "problem.toml"
    plain = ["--no-select", "--cutoff", "10"]
    assert main(["init", *map(str, arm), *plain, "--output", str(study)]) == 0
    theirs = tmp_path / "theirs" / "problem.toml"
    theirs.parent.mkdir()
    theirs.write_text(study.read_text())
    assert main(["info", str(theirs)]) == 2
    assert "--trust" in capsys.readouterr().err
    assert main(["info", str(theirs), "--trust"]) == 0
    capsys.readouterr()


def test_init_says_trust_where_it_cannot_record_what_it_wrote(
    arm, tmp_path, capsys, monkeypatch
):
    monkeypatch.delenv("CONSISTENT_ID_DATASETS", raising=False)
    (tmp_path / "state").write_text("a file where a folder has to be")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    study = tmp_path / "study" / "problem.toml"
    plain = ["--no-select", "--cutoff", "10", "--output", str(study)]
    assert main(["init", *map(str, arm), *plain]) == 0
    shown = capsys.readouterr()
    assert f"compare {study} --trust" in shown.out
    assert f"{study} is not recorded as a file of your own" in shown.err


# Interrupts -------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stop", "code", "says"),
    [(KeyboardInterrupt, 130, "interrupted"), (OutOfTime, 3, "out of time")],
)
def test_a_bootstrap_that_is_stopped_shows_what_it_has(
    arm, capsys, monkeypatch, stop, code, says
):
    calls = iter(range(10**6))
    solve = resampling.penalised_fits

    def interrupted(*args, **options):
        if next(calls) == 7:
            raise stop
        return solve(*args, **options)

    monkeypatch.setattr(resampling, "_AT_ONCE", 1)
    monkeypatch.setattr(resampling, "penalised_fits", interrupted)
    assert main(["identify", *map(str, arm), "--uncertainty", "--verbose"]) == code
    shown = capsys.readouterr()
    assert "7 estimates from segments" in shown.out and "; interrupted" in shown.out
    assert f"{says}: this is the best so far" in shown.err


def started(arguments, tmp_path):
    return subprocess.Popen(
        [sys.executable, "-m", "consistent_id", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"TMPDIR": str(tmp_path)},
        start_new_session=True,
        preexec_fn=_heeds_interrupts,
    )


def _heeds_interrupts():
    """Undo what a shell does to work in the background: it ignores interrupts."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def interrupt(process):
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does


def when_searching(tmp_path):
    end = time.monotonic() + 100.0
    while not list(tmp_path.glob("excitation-*/*.npz")):
        assert time.monotonic() < end
        time.sleep(0.02)


EXCITE = ("excite", RX60, "--time-limit", "600", "--starts", "5000", "--workers")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("workers", "executor"),
    [("1", None), ("2", None), ("2", "serial"), ("2", "processes:2"), ("2", "dask:2")],
)
def test_the_first_interrupt_of_a_design_keeps_the_best(tmp_path, workers, executor):
    if executor == "dask:2":
        pytest.importorskip("distributed")
    where = [] if executor is None else ["--executor", executor]
    call = [*EXCITE, workers, *where, "--output", str(tmp_path / "out")]
    process = started(call, tmp_path)
    when_searching(tmp_path)
    interrupt(process)
    out, err = process.communicate(timeout=100)
    assert process.returncode == 130, err
    assert "interrupted: the user ended the search" in out
    record = (tmp_path / "out" / "excitation.json").read_text()
    assert "interrupted: the user ended the search" in record


def test_in_python_a_command_gives_signals_back(capsys):
    at_start = {
        signal.SIGINT: signal.default_int_handler,
        signal.SIGTERM: signal.SIG_DFL,
    }
    for number, handler in at_start.items():
        signal.signal(number, handler)
    with pytest.raises(SystemExit):
        main(["--version"])
    assert {n: signal.getsignal(n) for n in at_start} == at_start


LATE = """
import atexit, os, signal, sys
from consistent_id.cli import run
sys.argv = ["consistent-id", "--version"]
atexit.register(os.kill, os.getpid(), signal.SIGINT)
sys.exit(run())
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_an_interrupt_while_python_ends_ends_it():
    ended = subprocess.run(
        [sys.executable, "-c", LATE],
        capture_output=True,
        text=True,
        preexec_fn=_heeds_interrupts,
        check=False,
    )
    assert ended.returncode == 130
    assert ended.stderr == "consistent-id: interrupted\n"
    assert ended.stdout == f"{version('consistent-id')}\n"


SELDOM = """
import gc, sys
from consistent_id.cli import run
sys.argv = ["consistent-id", "--version"]
try:
    run()
except SystemExit:
    print(gc.get_threshold()[0] > 10_000, gc.get_freeze_count() > 10_000)
"""


@pytest.mark.slow
def test_a_process_of_the_tool_seldom_looks_for_garbage_and_not_at_its_end():
    call = [sys.executable, "-c", SELDOM]
    ended = subprocess.run(call, capture_output=True, text=True, check=True)
    assert ended.stdout == f"{version('consistent-id')}\nTrue True\n"


@pytest.mark.slow
def test_the_second_interrupt_stops_at_once(tmp_path):
    process = started([*EXCITE, "2", "--output", str(tmp_path / "out")], tmp_path)
    when_searching(tmp_path)
    for _ in range(100):  # two that come before Python has seen the first are one
        interrupt(process)
        time.sleep(0.2)
        if process.poll() is not None:
            break
    process.communicate(timeout=30)
    # A third one may come while Python ends; for a shell, 130 is both.
    assert process.returncode in (130, -signal.SIGINT)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_an_interrupt_ends_a_reproduced_study(tmp_path):
    process = started(
        ["reproduce", RX60, "--quick", "--output", str(tmp_path / "out")], tmp_path
    )
    when_searching(tmp_path)
    interrupt(process)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert err.splitlines()[-1] == "consistent-id: interrupted"
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_sigterm_ends_a_search_and_its_workers(tmp_path):
    process = started([*EXCITE, "2", "--output", str(tmp_path / "out")], tmp_path)
    when_searching(tmp_path)
    process.terminate()
    _, err = process.communicate(timeout=30)
    assert process.returncode == 143
    assert "terminated" in err
    assert not list(tmp_path.glob("excitation-*"))
