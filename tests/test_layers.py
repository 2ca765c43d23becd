"""Imports run one way, and heavy libraries are imported where they are used."""

import ast
from pathlib import Path

import consistent_id

PACKAGE = Path(consistent_id.__file__).parent

# Each module may import only from those before it.
ORDER = """
errors _newton_euler _files _arrays _threads inertia log_cholesky parameters model
chains loaders.findings loaders._xml loaders._urdf_tree loaders._urdf_parts
loaders._urdf_lint loaders.urdf loaders._mjcf_checks loaders.mjcf loaders.dh loaders
_joint_geometry scaling conic constraints.solids priors cones cone_program
second_opinion certificate feasibility conflict estimators.body_variables
estimators.smooth_fit estimators diagnosis.findings tables readers.mat_lint
readers.merging readers.units readers.columns correlation drive_terms friction regressor
base constraints._rows constraints.datasheet constraints.parameters constraints.shape
constraints.symmetry distances link_condition mass_matrix constraints.motors constraints
base_bodies estimators.constraint_variables shapes signals.kalman diagnosis.tell
excitation excitation._callbacks excitation.criteria kinematics curves frame_motion
writing_tasks path_refusals writer laboratory.robot laboratory.sensors file_tables
excitation_file laboratory_file problem_file problem_constraints problem_folder
problem_model row_filter export._numpy_template export.exported export.shares
loaders._splice loaders._urdf_inertial export._mjcf_text repair.nearest repair.statement
repair.account repair.tell repair.link repair.urdf repair export._mjcf_tree
diagnosis.jackknife collisions collisions.bodies collisions.pieces collisions.scene
collisions.reach collisions.separation collisions.scene_building collisions.urdf_bodies
collisions.scene_file motion motion.bernstein motion.limits excitation.kernels
motion.polynomial_path proofs proofs.grids proofs.interval proofs.jets proofs.peaks
cli.options _face readers.names _extras recording diagnosis.clock diagnosis.corrections
readers.arrays readers.csv readers.frames readers.hdf5 readers.jointstate readers.bag
readers.mat readers.npz readers.parquet readers.files simulation estimate figures
comparison signals.clocks signals.differences signals.filters signals.resolution
signals.masks signals.cuts signals.savitzky_golay signals.smoother signals.track
signals.alignment signals.delay sinusoids paths trajectory signals.fourier
signals.period trajectory_files.content trajectory_files.ros trajectory_files.urscript
inverse_kinematics laboratory.control laboratory.closed_loop laboratory.experiment
laboratory.one_clock laboratory signals.folds signals preparation readers.tracks readers
trajectory_files.tables problem problem_laboratory problem_list regression
estimators.least_squares estimators.robust segments parametrisation
estimators.scaled_fit estimators.best_fit estimators.penalised estimators.nearest
estimators.contradiction estimators.settled estimators.constrained estimators.smooth
fit_cross_check cross_validation segment_bootstrap intervals sensitivity
parameter_uncertainty fit_costs constraint_prices diagnosis.explain
estimators.gain_search loaded_robot estimators.gains loaded_constraints
estimators.payload shaped_regression shape_misfit shape_profile shape_fit cutoff
excitation.aims excitation.accuracy published published_estimate published_summary
export.drive_values export.pedigree export.casadi_functions export.c_source
export.numpy_source export.pinocchio_model export._mjcf_body export.record
export._mjcf_source export.new_urdf export.urdf export._mjcf_gears export.mjcf export
diagnosis.linearise diagnosis.small_shifts diagnosis.repeats collisions.clearance
excitation.basis excitation.information excitation.guards motion.motion_state
motion.move trajectory_files.document trajectory_files.files trajectory_files
motion.transfers motion.approaches motion.move_along excitation.limit_rows
excitation.programme excitation.asked_scene excitation.asked excitation.clear_starts
_progress cli.colour cli.answers cli.repair cli.completion cli.time_limit log_columns
problem_draft drafting cli.log_options cli.init study commands_export cli.export
diagnosis.coverage diagnosis.diagnose diagnosis record summary commands cli.check
cli.compare cli.info commands_draft excitation.drawings excitation.replay
reproduction.experiments reproduction.budget reproduction.assumptions
reproduction.inertia reproduction.tables reproduction.tempo reproduction.verification
_interrupts report.advice report.markup report.findings report.certificate report.costs
report.health report.parameters report.plot report.friction report.projection
report.published report.reproduce report.residual_figures report.residuals
report.robot_scene report.robot_view report.links report.thinning report.excitation
report.torque report.verdict report.page report.html report cli.identify commands_report
cli.report reproduction.accounts proofs.seams proofs.extremes proofs.friction_bounds
proofs.torque_motion proofs.torque_bounds proofs.margins excitation.clearance_guard
excitation.verification excitation.search_task excitation.search excitation.asked_tables
excitation.starts excitation.designed excitation.validating excitation.figure
excitation.record excitation.workshop excitation.design excite cli.excite
reproduction.exciting reproduction.study reproduction reproduction.section_tables
reproduction.figures reproduction.sections reproduction.page reproduction.record
cli.reproduce cli.tool cli
""".split()

HEAVY = {
    "cvxpy",
    "casadi",
    "pinocchio",
    "scipy",
    "matplotlib",
    "pyarrow",
    "h5py",
    "rosbags",
    "apsw",
    "sqlite3",
    "pandas",
    "xarray",
    "clarabel",
    "coal",
    "mujoco",
    "viser",
    "trimesh",
}


# Subclasses of a heavy library's classes; imported inside functions alone.
LAZY = {"excitation._callbacks"}


def _modules() -> dict[str, ast.Module]:
    found = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        name = ".".join(p for p in parts if p != "__init__")
        found[name] = ast.parse(path.read_text())
    return found


def _imported(tree: ast.AST) -> list[str]:
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level == 0:
            names.append(node.module or "")
        elif isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
    return names


def test_every_module_has_its_place_and_imports_only_from_those_before_it():
    modules = _modules()
    assert set(modules) - {"", "__main__"} == set(ORDER)
    for name, tree in modules.items():
        if name in ("", "__main__"):
            continue
        for imported in _imported(tree):
            if imported.startswith("consistent_id."):
                target = imported.removeprefix("consistent_id.")
                assert ORDER.index(target) < ORDER.index(name), f"{name} -> {target}"


def test_heavy_libraries_are_not_imported_at_the_top_of_a_module():
    for name, tree in _modules().items():
        if name in LAZY:
            continue
        top = [
            node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)
        ]
        for imported in _imported(ast.Module(body=top, type_ignores=[])):
            assert imported.split(".")[0] not in HEAVY, f"{name} imports {imported}"
            assert imported.removeprefix("consistent_id.") not in LAZY, name


def test_estimators_do_not_know_casadi():
    for name, tree in _modules().items():
        if name.startswith("estimators"):
            assert "casadi" not in _imported(tree)
