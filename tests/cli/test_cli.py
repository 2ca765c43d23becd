"""The shell tool, run as a user would; files it writes are whole and readable."""

import json
import re
import subprocess
import sys
from contextlib import redirect_stdout
from io import StringIO
from xml.etree import ElementTree

import pytest
from schemas import parsed
from shared_studies import no_study_shared, shared_within

from consistent_id import ConsistentIdError, Estimate, Study, load_problem
from consistent_id.cli import main, tool

RX60 = "problems/rx60"
studies = shared_within("module")


@pytest.fixture(scope="module")
def compared(tmp_path_factory, studies):
    """A folder that compare wrote, and what it printed."""
    folder, out = tmp_path_factory.mktemp("compared"), StringIO()
    with redirect_stdout(out):
        assert main(["compare", RX60, "--output", str(folder), "--verbose"]) == 0
    return folder, out.getvalue()


@pytest.fixture(scope="module")
def identified(tmp_path_factory, studies):
    """A folder that identify wrote, and what it printed as JSON."""
    folder, out = tmp_path_factory.mktemp("identified"), StringIO()
    with redirect_stdout(out):
        assert main(["identify", RX60, "--json", "--output", str(folder)]) == 0
    return folder, parsed(out.getvalue())


@pytest.mark.slow
def test_compare_tells_the_story_of_the_rx60_and_draws_it(compared):
    folder, out = compared
    for fact in (
        "a2^2 m3 + m2 a2c^2 + B2",
        "alpha1 + alpha2 - alpha8 - alpha13",
        "impossible",
        "least squares as published",
        "certified",
    ):
        assert fact in out
    record = json.loads((folder / "comparison.json").read_text())
    assert [v["answer"] for v in record["published"]["vectors"]] == ["impossible"] * 7
    assert record["published"]["ranks"][1]["rank"] == 11
    methods = {e["method"]: e for e in record["estimates"]}
    error = {m: e["validation"][0]["stacked"] for m, e in methods.items()}
    assert error["constrained"] < error["least squares"]
    assert methods["constrained"]["verdict"] == "use"
    assert methods["constrained"]["certificate"]["verdict"] == "certified"
    assert "| parameter |" in (folder / "comparison.md").read_text()
    for name in ("motion", "torque_training_1", "torque_validation_1"):
        picture = (folder / f"{name}.svg").read_text()
        assert picture.startswith("<!-- consistent-id: ")
        assert ElementTree.fromstring(picture).tag.endswith("svg")
        assert len(picture) > 20_000  # an empty set of axes is smaller


@pytest.mark.slow
def test_results_are_the_same_for_the_same_seed(compared, tmp_path, capsys):
    with no_study_shared():
        assert main(["compare", RX60, "--output", str(tmp_path)]) == 0
    capsys.readouterr()
    first, second = (
        json.loads((folder / "comparison.json").read_text())
        for folder in (compared[0], tmp_path)
    )
    for estimates in zip(first["estimates"], second["estimates"], strict=True):
        for key in ("method", "parameters", "validation"):
            one, other = (estimate[key] for estimate in estimates)
            assert one == other


def test_info_shows_the_robot_and_its_base_parameters(capsys):
    assert main(["info", RX60]) == 0
    out = capsys.readouterr().out
    assert "15 of 30 (structural rank)" in out
    assert "link1.m" in out  # without effect on torque
    assert main(["info", RX60, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["header"][0] == "joint"


@pytest.mark.slow
def test_identify_writes_estimates_that_can_be_read_back(identified):
    folder, record = identified
    printed = record["estimates"]
    assert "constrained" in [e["method"] for e in printed]
    from consistent_id.regression import base_parameters

    model = load_problem(RX60).model
    estimate = Estimate.load(folder / "constrained.json", model, base_parameters(model))
    (record,) = [e for e in printed if e["method"] == "constrained"]
    assert estimate["link2.m"] == record["parameters"]["link2.m"]["value"]
    assert estimate.certificate.verdict == "certified"


@pytest.mark.parametrize("content", ["{", "[]", '{"parameters": {"a": 1}}', "null"])
def test_a_damaged_estimate_is_refused(tmp_path, content):
    from consistent_id import ProblemError
    from consistent_id.regression import base_parameters

    file = tmp_path / "estimate.json"
    file.write_text(content)
    model = load_problem(RX60).model
    with pytest.raises(ProblemError, match=r"estimate\.json"):
        Estimate.load(file, model, base_parameters(model))


def test_wrong_input_ends_with_2_and_says_what_to_do(tmp_path, capsys):
    (tmp_path / "problem.toml").write_text('name = "x"\n[model]\nurfd = "a.urdf"\n')
    assert main(["info", str(tmp_path)]) == 2
    message = capsys.readouterr().err
    assert "urfd" in message
    assert "line 3: model has no key" in message
    assert main(["info", str(tmp_path / "nowhere")]) == 2


def test_wrong_usage_ends_with_2(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["frobnicate"])
    assert ended.value.code == 2
    said = "'frobnicate'; consistent-id --help lists the commands"
    assert said in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        main(["identifi", "robot.urdf"])
    assert ended.value.code == 2
    assert "did you mean identify?" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        main(["export", "results"])
    assert ended.value.code == 2
    message = capsys.readouterr().err
    assert "required: --format, --output; consistent-id export --help" in message
    assert message.count("\n") == 1


@pytest.mark.parametrize("command", ["select", "compress", "excite", "rehearse"])
def test_a_log_beside_a_robot_is_answered_with_the_command_that_reads_it(
    capsys, command
):
    output = ["--output", "r.json"] if command == "compress" else []
    with pytest.raises(SystemExit) as ended:
        main([command, "robot.urdf", "log.csv", *output])
    assert ended.value.code == 2
    shown = capsys.readouterr().err
    assert "consistent-id init robot.urdf log.csv --output problem.toml" in shown
    assert f"consistent-id {command} problem.toml" in shown


def test_no_line_of_any_help_is_wider_than_100_columns(capsys):
    for command in ("export", "excite", "identify", "rollout", "servo"):
        with pytest.raises(SystemExit):
            main([command, "--help"])
        assert max(map(len, capsys.readouterr().out.splitlines())) <= 100


def test_no_word_at_all_lists_the_commands(capsys):
    with pytest.raises(SystemExit) as ended:
        main([])
    assert ended.value.code == 2
    assert "identify" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--validation", "b.csv"], "--validation; did you mean --validate? "),
        (["--tourque=tau"], "--tourque=tau; did you mean --torque? "),
        (["--held-out", "b.csv"], "--held-out; consistent-id check --help"),
    ],
)
def test_an_unknown_option_is_answered_with_the_nearest(capsys, words, said):
    with pytest.raises(SystemExit) as ended:
        main(["check", "robot.urdf", "a.csv", *words])
    assert ended.value.code == 2
    shown = capsys.readouterr().err
    assert f"consistent-id check: there is no option {said}" in shown
    assert shown.count("\n") == 1


@pytest.mark.parametrize(
    "words",
    [
        ["robot.urdf", "--no-select", "a.csv", "b.csv"],
        ["robot.urdf", "a.csv", "--no-select", "b.csv"],
        ["--no-select", "robot.urdf", "--quiet", "a.csv", "b.csv"],
        ["robot.urdf", "--torque", "tau{number}", "a.csv", "--no-select", "b.csv"],
    ],
)
def test_logs_may_follow_an_option(words):
    options = tool.parsed(["identify", *words])
    files = [word for word in options.words if word.endswith((".urdf", ".csv"))]
    assert files == ["robot.urdf", "a.csv", "b.csv"]
    assert [str(log) for log in options.log] == ["a.csv", "b.csv"]


def test_an_interrupt_ends_with_130_and_leaves_nothing_half_written(
    tmp_path, capsys, monkeypatch
):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("consistent_id.problems.study.Study.run", interrupted)
    assert main(["compare", RX60, "--output", str(tmp_path / "out")]) == 130
    assert not (tmp_path / "out").exists()
    capsys.readouterr()


@pytest.mark.slow
def test_help_does_not_load_solvers():
    code = (
        "import sys; from consistent_id.cli.tool import tool_parser;"
        "tool_parser().format_help();"
        "heavy = {'cvxpy', 'casadi', 'pinocchio', 'scipy', 'matplotlib'};"
        "sys.exit(bool(heavy & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "most"),
    [
        (["--help"], 20),
        (["lint", "problems/kuka_kr300/robot.urdf"], 80),
        (["info", RX60], 120),
    ],
)
def test_a_command_imports_few_modules(words, most):
    code = (
        "import atexit, sys; from consistent_id.cli import main;"
        "own = lambda: [m for m in sys.modules if m.startswith('consistent_id')];"
        "atexit.register(lambda: print(len(own()), file=sys.stderr));"
        f"main({words})"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], check=False, capture_output=True, text=True
    )
    assert 5 < int(run.stderr.split()[-1]) <= most


def test_every_error_of_the_package_has_one_root():
    import consistent_id

    errors = [getattr(consistent_id, n) for n in consistent_id.__all__ if "Error" in n]
    assert len(errors) == 8
    assert all(issubclass(error, ConsistentIdError) for error in errors)


@pytest.mark.slow
@pytest.mark.parametrize(
    "form", ["mjcf", "urdf", "json", "pin", "numpy", "casadi", "c"]
)
def test_an_estimate_is_exported_for_other_programmes(
    form, rx60_estimate, capsys, studies
):
    if form == "mjcf":
        pytest.importorskip("mujoco")
    file = rx60_estimate.with_name("rx60.out")
    arguments = ["export", RX60, "--format", form, "--output", str(file), "--json"]
    assert main([*arguments, "--estimate", str(rx60_estimate)]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["verdict"], record["written"]) == ("use", str(file))
    assert file.stat().st_size > 1000


@pytest.mark.slow
def test_what_is_exported_is_what_identify_delivers(identified, tmp_path, capsys):
    file = identified[0] / "delivered.json"
    delivered = json.loads(file.read_text())["parameters"]
    arguments = ["export", RX60, "--verbose", "--format", "json", "--output"]
    assert main([*arguments, str(tmp_path / "robot.json")]) == 0
    assert "fitted again, after its verdict" in capsys.readouterr().out
    links = json.loads((tmp_path / "robot.json").read_text())["links"]
    for link in links:
        assert link["mass"] == delivered[f"{link['name']}.m"]["value"]


@pytest.mark.slow
def test_a_source_is_for_formats_that_have_one(rx60_estimate, capsys, studies):
    arguments = ["--format", "c", "--output", "x", "--estimate", str(rx60_estimate)]
    assert main(["export", RX60, *arguments, "--source", "robot.urdf"]) == 2
    assert "a source is for URDF and MJCF" in capsys.readouterr().err


@pytest.mark.slow
def test_what_is_refused_is_not_exported_unless_told(rx60_estimate, capsys, studies):
    record = json.loads(rx60_estimate.read_text())
    record["parameters"]["link3.Ixx"]["value"] = -1.0
    rx60_estimate.write_text(json.dumps(record))
    file = rx60_estimate.with_name("rx60.c")
    arguments = ["export", RX60, "--format", "c", "--output", str(file)]
    arguments += ["--estimate", str(rx60_estimate)]
    assert main(arguments) == 1
    assert not file.exists()
    error = capsys.readouterr().err
    assert error.startswith("do not use: constrained")
    accepted = []
    for kind in re.findall("--accept '(.*?)'", error):
        accepted += ["--accept", kind]
    assert main([*arguments, *accepted, "--dry-run"]) == 0
    assert not file.exists()
    assert main([*arguments, *accepted]) == 0
    assert "accepted: " in file.read_text()
    assert f"written: {file}, {file.with_suffix('.h')}, " in capsys.readouterr().out


@pytest.fixture(scope="module")
def _rx60_estimate(tmp_path_factory, studies):
    estimate = studies.one(Study(load_problem(RX60))).constrained
    return estimate.save(tmp_path_factory.mktemp("rx60") / "estimate.json")


@pytest.fixture
def rx60_estimate(_rx60_estimate, tmp_path):
    """The constrained estimate of the RX-60, in a file of its own."""
    file = tmp_path / "estimate.json"
    file.write_bytes(_rx60_estimate.read_bytes())
    return file
