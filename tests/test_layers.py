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
_joint_geometry recording scaling conic constraints.solids priors cones cone_program
second_opinion certificate feasibility conflict estimators.body_variables
estimators.smooth_fit estimators diagnosis.findings diagnosis.clock
diagnosis.corrections tables readers.mat_lint readers.merging readers.units
readers.columns readers.arrays readers.csv readers.frames readers.hdf5
readers.jointstate readers.bag readers.mat readers.npz readers.parquet readers.files
readers correlation drive_terms friction regressor base regression simulation
constraints._rows constraints.datasheet constraints.parameters constraints.shape
constraints.symmetry distances estimate link_condition mass_matrix
estimators.least_squares estimators.robust segments parametrisation
diagnosis.small_shifts figures constraints.motors constraints base_feasibility
estimators.scaled_fit estimators.best_fit estimators.penalised estimators.nearest
estimators.contradiction estimators.settled estimators.constrained
estimators.constraint_variables estimators.smooth cross_check cross_validation bootstrap
intervals sensitivity uncertainty constraint_costs shadow_prices comparison
diagnosis.explain estimators.gain_search loaded_robot estimators.gains
loaded_constraints estimators.payload shapes shaped_regression shape_misfit
shape_profile shape_fit signals.clocks signals.differences signals.filters
signals.kalman signals.resolution signals.masks signals.cuts signals.savitzky_golay
signals.smoother signals.track signals.alignment signals.delay diagnosis.tell sinusoids
excitation excitation.limits paths trajectory signals.fourier signals.period signals
cutoff excitation._callbacks excitation.basis excitation.criteria excitation.kernels
excitation.information excitation.limit_rows excitation.programme excitation.aims
excitation.grids excitation.interval excitation.jets excitation.peaks
excitation.extremes excitation.friction_bounds excitation.torque_motion
excitation.torque_bounds excitation.margins excitation.accuracy excitation.bernstein
excitation.polynomial_path excitation.move trajectory_files.content
trajectory_files.document trajectory_files.ros trajectory_files.tables
trajectory_files.urscript trajectory_files.files trajectory_files
excitation.motion_state excitation.transfers excitation.approaches excitation.move_along
excitation.bodies excitation.pieces excitation.urdf_bodies kinematics excitation.scene
excitation.reach excitation.separation excitation.guards excitation.search_task
excitation.clearance excitation.verification excitation.scene_building
excitation.scene_file excitation_file problem_file problem_constraints preparation
problem published published_estimate study diagnosis.coverage diagnosis.diagnose
diagnosis published_summary summary record commands excitation.clear_starts
excitation.search excitation.starts excitation.design excitation.validating
excitation.figure excitation.record excitation.asked_scene excitation.asked
excitation.drawings excitation.replay excitation.asked_tables excite
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
    assert set(modules) - {"", "cli"} == set(ORDER)
    for name, tree in modules.items():
        if name in ("", "cli"):
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
