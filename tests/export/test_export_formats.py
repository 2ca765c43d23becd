"""The table of export formats is what is exported, offered and documented."""

import inspect
import shutil
import subprocess
import sys
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import numpy as np
import pytest
from estimates import estimate_of, random_estimate
from quadrupeds import quadruped_text
from robots import random_body, random_robot

import consistent_id
from consistent_id import DriveTerms, ModelError, ProblemError, TorqueModel, to_urdf
from consistent_id.estimation.verdict import Reason, Verdict
from consistent_id.export import export_formats, mjcf_export, to_json, urdf_export
from consistent_id.export.actuator_config import readme
from consistent_id.export.export_formats import (
    EXPORT_FORMATS,
    Export,
    ExportFormat,
    exported,
)
from consistent_id.export.format_cost import format_cost
from consistent_id.regression.drive.gear_coupling import GearCoupling
from consistent_id.robot import load_mjcf, load_urdf
from consistent_id.robot.chains import Selection
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders import DHRow, from_modified_dh
from consistent_id.robot.model import JointLimits

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def estimate():
    rng = np.random.default_rng(4)
    _, robot = random_robot(rng, 2)
    return random_estimate(rng, robot)


@pytest.mark.parametrize("known", EXPORT_FORMATS, ids=lambda known: known.name)
def test_every_entry_exports_and_takes_a_source_if_it_says_so(known, estimate):
    if known.name == "mjcf":
        pytest.importorskip("mujoco")
    export = exported(estimate, known.name)
    assert export.format == known.name and len(export.content) > 100
    module = import_module(f"consistent_id.export.{known.module}")
    signature = inspect.signature(getattr(module, known.function))
    assert ("source" in signature.parameters) == known.takes_source


@pytest.mark.slow
def test_a_format_says_the_same_by_name_and_by_its_function(estimate, tmp_path):
    assert exported(estimate, "json") == to_json(estimate)
    source = to_urdf(estimate).save(tmp_path / "robot.urdf")
    assert exported(estimate, "urdf", source=source) == to_urdf(estimate, source)


def test_a_source_for_other_formats_and_unknown_formats_are_refused(estimate):
    with pytest.raises(ProblemError, match="a source is for URDF and MJCF, not for c"):
        exported(estimate, "c", source=Path("robot.urdf"))
    with pytest.raises(ProblemError, match="no format 'jason'; known: json"):
        exported(estimate, "jason")


@pytest.fixture(scope="module")
def refused(estimate):
    reason = Reason("misfit", "do not use", "it does not fit", "check units")
    return replace(estimate, judged=Verdict("do not use", "constrained", (reason,)))


@pytest.fixture(scope="module")
def floating(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "quadruped.xml"
    path.write_text(quadruped_text())
    robot = load_mjcf(path, base="floating")
    links = [random_body(np.random.default_rng(0)) for _ in robot.links]
    model = TorqueModel(robot, DriveTerms(viscous=True))
    estimate = estimate_of(model, links, 0.1)
    return replace(estimate, judged=Verdict("use", "constrained", ()))


@pytest.fixture()
def unchecked(monkeypatch):
    """A new format: its function checks nothing, its entry states the least."""

    def export(estimate, *, allow_refused):
        return Export("new", b"written")

    module = ModuleType("consistent_id.export.unchecked")
    module.export = export
    monkeypatch.setitem(sys.modules, module.__name__, module)
    new = ExportFormat("new", "New", "unchecked", "export")
    monkeypatch.setattr(export_formats, "EXPORT_FORMATS", (*EXPORT_FORMATS, new))


def test_a_new_format_cannot_forget_the_gate(unchecked, estimate, refused, floating):
    with pytest.raises(ProblemError, match=r"it does not fit.*allow_refused"):
        exported(refused, "new")
    assert exported(refused, "new", allow_refused=True).content == b"written"
    with pytest.raises(ProblemError, match="base of 'quadruped' floats"):
        exported(floating, "new", allow_refused=True)


DIRECT = {
    "urdf": "to_urdf",
    "mjcf": "to_mjcf",
    "json": "to_json",
    "pin": "to_pinocchio",
    "numpy": "to_numpy",
    "casadi": "to_casadi",
    "c": "to_c",
    "isaaclab": "to_isaac_lab",
    "mjlab": "to_mjlab",
}


@pytest.mark.parametrize("known", EXPORT_FORMATS, ids=lambda known: known.name)
def test_by_name_and_directly_the_same_is_refused(known, refused, floating):
    if known.name == "mjcf":
        pytest.importorskip("mujoco")
    direct = getattr(consistent_id.export, DIRECT[known.name])
    for export in (direct, partial(exported, form=known.name)):
        with pytest.raises(ProblemError, match="it does not fit"):
            export(refused)
        assert export(refused, allow_refused=True)
        if known.floating:
            assert export(floating)
        else:
            with pytest.raises(ProblemError, match="base of 'quadruped' floats"):
                export(floating, allow_refused=True)


@pytest.mark.parametrize("known", EXPORT_FORMATS, ids=lambda known: known.name)
def test_every_format_is_documented(known):
    assert f"`{known.name}`" in (ROOT / "docs" / "exports.md").read_text()


@pytest.mark.slow
def test_the_table_imports_no_array_library():
    code = "import sys, consistent_id.export.export_formats; print(*sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "consistent_id.export.export_formats" in found.stdout.split()
    assert "numpy" not in found.stdout.split()


@pytest.mark.parametrize("form", [f.name for f in EXPORT_FORMATS])
def test_a_new_file_says_which_joints_it_has_and_which_links_are_in_others(
    form, tmp_path
):
    file = tmp_path / "arm.urdf"
    body = '<link name="{}"><inertial><mass value="{}"/><inertia ixx="1" iyy="1" ' + (
        'izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    joint = '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/>' + (
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )
    file.write_text(
        '<robot name="arm"><link name="table"/>'
        + "".join(body.format(name, 1) for name in ("boom", "gripper"))
        + joint.format("lift", "revolute", "table", "boom")
        + joint.format("grip", "revolute", "boom", "gripper")
        + "</robot>"
    )
    robot = load_urdf(file, locked={"grip": 0.2})
    held = random_estimate(np.random.default_rng(1), robot)
    notes = exported(held, form, allow_refused=True).notes
    assert (
        "the file has only the 1 joint that moves; links on fixed or locked joints are "
        "parts of the links that carry them: gripper"
    ) in notes
    if form == "urdf":  # in the robot's own file, all of them stay
        notes = exported(held, form, source=file, allow_refused=True).notes
        assert not any("joint that moves" in note for note in notes)


def test_a_new_file_of_a_robot_that_moves_as_a_whole_needs_no_such_note(estimate):
    notes = exported(estimate, "json", allow_refused=True).notes
    assert not any("that move" in note for note in notes)


def cost_of(estimate, form, log, **options):
    return format_cost(estimate, form, [log], selection=Selection(), **options)


@pytest.fixture(scope="module")
def driven():
    """An estimate with terms that not every format has, and its own torque."""
    rng = np.random.default_rng(7)
    _, robot = random_robot(rng, 2)
    terms = DriveTerms(
        viscous=True, coulomb="tanh", velocity_scale=0.1, rotor_inertia=True
    )
    estimate = random_estimate(rng, robot, terms)
    time = np.arange(400) / 100
    q = np.column_stack([np.sin(time * w) for w in (2.0, 3.0)])
    motion = consistent_id.differentiated(
        consistent_id.Recording(robot.joint_names, time, q)
    )
    log = consistent_id.simulate_torque(estimate.model, estimate.parameters, motion)
    return estimate, log


@pytest.mark.slow
@pytest.mark.parametrize("form", [known.name for known in EXPORT_FORMATS])
def test_a_file_is_as_wrong_as_the_terms_that_it_lacks(driven, form):
    if form in ("mjcf", "mjlab"):
        pytest.importorskip("mujoco")
    if form == "c" and shutil.which("cc") is None:
        pytest.skip("no C compiler")
    estimate, log = driven
    cost = cost_of(estimate, form, log)
    assert cost.own < 1e-12 and cost.recordings == (log.name,)
    assert cost.read_back
    if form == "urdf":
        rotor = [i for i, n in enumerate(estimate.model.layout.names) if "rotor" in n]
        x = estimate.parameters.copy()
        x[rotor] = 0.0
        left = consistent_id.simulate_torque(estimate.model, x, log).torque
        alone = np.linalg.norm(left - log.torque) / np.linalg.norm(log.torque)
        assert cost.error == pytest.approx(alone, rel=0.05)  # joints weigh alike
    else:
        assert cost.error < 1e-9


def test_a_file_with_another_mass_is_read_back_as_it_is(driven, monkeypatch):
    estimate, log = driven
    heavier = replace(estimate, parameters=estimate.parameters * 1.1)
    wrong = to_urdf(heavier)
    monkeypatch.setattr(urdf_export, "to_urdf", lambda *_, **__: wrong)
    whole = cost_of(estimate, "json", log).error
    assert cost_of(estimate, "urdf", log).error > max(whole, 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["numpy", "casadi", "c"])
def test_source_and_functions_are_run_as_they_are(driven, form, monkeypatch):
    """Their error is that of their torque along filtered rows that partly count."""
    if form == "c" and shutil.which("cc") is None:
        pytest.skip("no C compiler")
    estimate, log = driven
    counts = np.arange(len(log))[:, None] % 97 > 3
    known = replace(log, torque_known=counts & np.ones(log.torque.shape, dtype=bool))
    filtered = consistent_id.low_passed(known, motion_cutoff=8.0)
    cost = cost_of(estimate, form, filtered)  # the motion is filtered, too
    assert cost.error == pytest.approx(cost.own, rel=1e-9)
    heavier = replace(estimate, parameters=estimate.parameters * 1.1)
    known = export_formats.known_format(form)
    module = import_module(f"consistent_id.export.{known.module}")
    own = getattr(module, known.function)
    monkeypatch.setattr(module, known.function, lambda _, **more: own(heavier, **more))
    assert cost_of(estimate, form, filtered).error == pytest.approx(0.1, rel=1e-3)
    assert cost_of(heavier, "json", filtered).own == pytest.approx(0.1, rel=1e-3)


@pytest.mark.parametrize(
    ("compiler", "said"),
    [
        ("no-such-compiler", "no C compiler 'no-such-compiler'"),
        ("false", "'false' refuses the source: no message"),
    ],
)
def test_without_a_compiler_the_error_of_c_is_not_known(
    driven, monkeypatch, compiler, said
):
    monkeypatch.setenv("CC", compiler)
    with pytest.raises(ModelError, match=said):
        cost_of(driven[0], "c", driven[1])


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["cc -O1", "g++"])
def test_a_compiler_may_have_options_or_be_that_of_another_language(
    driven, monkeypatch, compiler
):
    if shutil.which(compiler.split()[0]) is None:
        pytest.skip("no such compiler")
    monkeypatch.setenv("CC", compiler)
    assert cost_of(driven[0], "c", driven[1]).error < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("form", ["mjcf", "mjlab"])
def test_tendons_of_a_file_count_with_what_they_carry(driven, form, monkeypatch):
    pytest.importorskip("mujoco")
    estimate, log = driven
    model = estimate.model
    first, second = model.robot.joint_names
    gear = GearCoupling(
        *(first, second), viscous=True, coulomb="tanh", velocity_scale=0.1
    )
    coupled = replace(model, couplings=(gear,))
    x = np.append(estimate.parameters, [0.2, 0.3])
    drives = [coupled.layout.index(f"{name}.viscous") for name in (first, second)]
    x[drives] = 1.0  # a tendon's damper takes its part of them
    both = replace(estimate, model=coupled, parameters=x)
    own = consistent_id.simulate_torque(coupled, x, log)
    cost = cost_of(both, form, own)
    assert cost.read_back and cost.error < 1e-9
    free = replace(both, parameters=np.append(x[:-2], [0.0, 0.0]))
    written = mjcf_export.to_mjcf(free, allow_refused=True)
    monkeypatch.setattr(mjcf_export, "to_mjcf", lambda *_, **__: written)
    assert cost_of(both, form, own).error == pytest.approx(
        cost_of(free, "json", own).own
    )


def test_friction_by_position_counts_with_the_arm_of_its_tendon():
    """Along the tendon it grows with a sine, nearly as along the joint."""
    pytest.importorskip("mujoco")
    terms = DriveTerms(coulomb="tanh", velocity_scale=0.1, friction_slope=True)
    arm = from_modified_dh("arm", [DHRow(0.0, 0.0, limits=JointLimits(-0.5, 0.5))])
    model = TorqueModel(arm, terms)
    body = InertialParameters.from_central(0.1, [0.1, 0.0, 0.0], 1e-3 * np.eye(3))
    estimate = estimate_of(model, [body], np.array([0.3, 0.15]))
    time = np.arange(400) / 100
    still = consistent_id.Recording(
        arm.joint_names, time, 0.5 * np.sin(2.0 * time)[:, None]
    )
    motion = consistent_id.differentiated(still)
    log = consistent_id.simulate_torque(model, estimate.parameters, motion)
    cost = cost_of(estimate, "mjcf", log)
    assert cost.read_back
    level = replace(estimate, parameters=estimate.parameters * ([1.0] * 11 + [0.0]))
    alone = cost_of(level, "json", log).own
    assert cost.error < 0.05 * alone


@pytest.mark.slow
@pytest.mark.parametrize(("drag", "noted"), [(-0.5, True), (0.5, False)])
def test_a_speed_beyond_which_friction_would_drive_a_joint_is_stated(drag, noted):
    rng = np.random.default_rng(7)
    _, robot = random_robot(rng, 2)
    estimate = random_estimate(rng, robot, DriveTerms(viscous=True, drag=True))
    x, layout = estimate.parameters.copy(), estimate.model.layout
    joint = robot.joint_names[1]
    x[list(layout.drive_indices("drag"))] = 0.0
    x[layout.index(f"{joint}.viscous")] = 1.2
    x[layout.index(f"{joint}.drag")] = drag
    dragged = replace(estimate, parameters=x)
    for form, holds in (("json", True), ("numpy", True), ("urdf", False)):
        notes = " ".join(exported(dragged, form).notes)
        assert (f"stay below: {joint} 2.4" in notes) == (noted and holds)


def test_the_page_beside_a_file_says_what_to_add(driven):
    estimate, _ = driven
    text = readme(
        estimate, "urdf", "arm.urdf", ["a note"], delay=0.004
    ).content.decode()
    assert "- a note" in text and "deque" in text and "4 ms" in text
    name = f"{estimate.model.robot.joint_names[0]}.rotor_inertia"
    layout = estimate.model.layout
    value = f"{estimate[name]:.6g} {layout.units[layout.index(name)]}"
    assert f"rotor_inertia | {value} | `rotor_inertia ddq` |" in text
    text = readme(estimate, "isaaclab", "arm.py", delay=0.004).content.decode()
    assert "has every drive term" in text and "deque" not in text


@pytest.mark.parametrize("form", ["urdf", "mjcf"])
def test_a_comment_is_well_formed_whatever_the_robot_is_called(estimate, form):
    model = estimate.model
    robot = replace(model.robot, name="arm---left -->")
    named = replace(estimate, model=replace(model, robot=robot))
    root = ElementTree.fromstring(exported(named, form).content)
    assert root.get("name", root.get("model")) == robot.name


def test_a_file_is_not_written_over_the_one_beside_it(estimate, tmp_path):
    with pytest.raises(ProblemError, match=r"arm\.h: .*, such as arm\.c"):
        exported(estimate, "c").save(tmp_path / "arm.h")
    assert not any(tmp_path.iterdir())
