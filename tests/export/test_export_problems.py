"""Real robots' estimates in their own URDFs, where recordings are present."""

import os

import numpy as np
import pinocchio as pin
import pytest
from estimates import rigid

from consistent_id import Study, load_problem, to_mjcf, to_urdf
from consistent_id.export.export_formats import exported
from consistent_id.robot import load_urdf

pytestmark = pytest.mark.skipif(
    "CONSISTENT_ID_DATASETS" not in os.environ,
    reason="CONSISTENT_ID_DATASETS does not name the folder of recordings",
)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["ur10e", "tiago"])
def test_the_estimates_torque_is_in_the_file_and_mujoco_loads_it(robot, tmp_path):
    problem = load_problem(f"problems/{robot}")
    estimate = Study(problem).constrained
    source = problem.model_files["urdf"]
    export = exported(estimate, "urdf", source=source)
    assert to_urdf(estimate, source) == export
    path = export.save(tmp_path / "robot.urdf")
    names = estimate.model.robot.joint_names
    model = pin.buildModelFromUrdf(str(path))
    others = [n for n in model.names[1:] if n not in names]
    places = [model.getJointId(name) for name in others]
    model = pin.buildReducedModel(model, places, pin.neutral(model))
    q, dq, ddq = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 5, len(names)))
    data = model.createData()
    found = [pin.rnea(model, data, *s).copy() for s in zip(q, dq, ddq, strict=True)]
    expected = rigid(estimate, (q, dq, ddq))
    assert np.allclose(found, expected, rtol=0, atol=1e-10 * abs(expected).max())
    again = load_urdf(path, joints=names)
    assert all(link.nominal.is_consistent(1e-9) for link in again.links)
    mujoco = pytest.importorskip("mujoco")
    built = mujoco.MjModel.from_xml_string(to_mjcf(estimate).content.decode())
    assert built.nv == len(names)
