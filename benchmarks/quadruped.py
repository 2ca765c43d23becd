"""A quadruped's trunk from a simulated log of a robot that moves on its feet.

``CONSISTENT_ID_DATASETS=... python benchmarks/quadruped.py`` takes two minutes, for
three logs (``--logs``); ``--problem FOLDER`` writes a problem file and logs.  MuJoCo
simulates Go2 on four feet on the ground, its trunk swaying, with contact
and friction; on the trunk is a box that the model does not know.  Logged are encoders,
joint torques, a gyroscope, an accelerometer and the orientation, all with noise; no
force sensor.  Of the legs, bodies and rotor inertias are known, as from a log of the
robot hung up by its trunk; or nothing is.
"""

import argparse
import json
import os
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from time import process_time

import numpy as np

import consistent_id as ci
from consistent_id.robot.inertia import INERTIAL_NAMES
from consistent_id.robot.loaders.mjcf_assets import read_spec

LEGS = ("FL", "FR", "RL", "RR")
FOOT, RADIUS = (-0.002, 0.0, -0.213), 0.022  # in the calf's frame; of the ball
BOX = 2.0, (0.05, 0.02, 0.08), (0.02, 0.03, 0.04)  # mass, place and central moments
RATE, SECONDS, SETTLE = 500, 21, 1  # Hz, s, s before the log begins
SWAY = (  # of the trunk: frequency, Hz, and amplitudes of places, m, and turns, rad
    (0.7, 0.008, 0.06),
    (2.0, 0.003, 0.03),
    (4.5, 0.0003, 0.02),
)
HEIGHT = 0.27
GAINS = 200.0, 4.0  # N m/rad, N m s/rad
ENCODER, TORQUE, GYRO, ACCELEROMETER = 2e-5, 0.05, 0.002, 0.02  # rad, N m, rad/s, m/s^2
CUTOFF = 30.0  # Hz
REST, REACH = 0.1, 1.0 / CUTOFF  # rad/s, s: joints so slow, and samples around them


@dataclass(frozen=True, slots=True)
class Truth:
    """The simulated robot: its model with the box, and without."""

    with_box: ci.RobotModel
    nominal: ci.RobotModel


def robots(path: Path) -> Truth:
    nominal = ci.load_mjcf(path, base="floating")
    mass, place, moments = BOX
    box = ci.InertialParameters.from_central(mass, place, np.diag(moments))
    trunk, *legs = nominal.links
    heavier = replace(trunk, nominal=trunk.nominal + box)
    return Truth(replace(nominal, links=(heavier, *legs)), nominal)


def simulated(
    path: Path,
    seed: int = 0,
    seconds: float = SECONDS,
    *,
    dry_friction: bool = True,
    plan=None,
) -> ci.Recording:
    """Log the robot while its trunk sways over its feet, as a plan or by chance."""
    import mujoco

    spec = read_spec(path, mujoco)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1])
    mass, place, moments = BOX
    box = spec.body("base").add_body(
        name="box", pos=place, mass=mass, ipos=[0, 0, 0], inertia=moments
    )
    box.explicitinertial = True
    for joint in spec.joints:
        joint.frictionloss *= dry_friction
    spec.option.timestep = 1.0 / RATE / 4
    # Else damping acts on the next velocity, and accelerations are not those of qacc.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    model = spec.compile()
    data = mujoco.MjData(model)
    model.geom_friction[:, 0] = 0.9
    rng = np.random.default_rng(seed)
    n = model.nv - 6
    plan = _Sway(rng) if plan is None else plan
    joints = _planned(model, data, plan, seconds + SETTLE)
    mujoco.mj_resetData(model, data)
    data.qpos[:7] = [0, 0, HEIGHT, 1, 0, 0, 0]
    data.qpos[7:] = joints[0]
    rows, kp, kd = [], *GAINS
    slopes = np.gradient(joints, 1.0 / RATE, axis=0)
    for step in range(int((seconds + SETTLE) * RATE)):
        for part in range(4):
            t = part / 4  # steps that the log's clock does not see have no jumps
            wanted = (1 - t) * joints[step] + t * joints[step + 1]
            slope = (1 - t) * slopes[step] + t * slopes[step + 1]
            error = wanted - data.qpos[7:]
            data.ctrl[:] = kp * error + kd * (slope - data.qvel[6:])
            if part == 0 and step >= SETTLE * RATE:
                mujoco.mj_forward(model, data)  # all of it at one time
                rows.append(_sample(model, data, n))
            mujoco.mj_step(model, data)
    return _recording(model, np.array(rows), rng)


class _Sway:
    """Sums of three sinusoids of the trunk's six coordinates, from rest."""

    def __init__(self, rng: np.random.Generator) -> None:
        frequency, place, turn = np.array(SWAY).T
        self.frequencies = frequency[:, None] * rng.uniform(0.85, 1.15, (3, 6))
        self.phases = rng.uniform(0, 2 * np.pi, (3, 6))
        self.sizes = np.repeat(np.column_stack([place, turn]), 3, axis=1)

    def at(self, t: float) -> np.ndarray:
        waves = np.sin(2 * np.pi * self.frequencies * t + self.phases)
        return np.asarray(min(t, 1.0) * np.sum(self.sizes * waves, axis=0))


def _planned(model, data, plan, seconds):
    """Joint positions that keep the feet in place, by Newton's method."""
    import mujoco

    feet = [model.body(f"{leg}_foot").id for leg in LEGS]
    data.qpos[:7] = [0, 0, HEIGHT, 1, 0, 0, 0]
    data.qpos[7:] = model.key("home").qpos[7:]
    mujoco.mj_kinematics(model, data)
    places = data.xpos[feet].copy()
    places[:, 2] = RADIUS
    found, J = [], np.zeros((3, model.nv))
    for step in range(int(seconds * RATE) + 2):
        x = plan.at(step / RATE)
        data.qpos[:3] = x[:3] + np.array([0, 0, HEIGHT])
        angle = np.linalg.norm(x[3:])
        data.qpos[3] = np.cos(angle / 2)
        data.qpos[4:7] = x[3:] * np.sinc(angle / 2 / np.pi) / 2
        for _ in range(20 if step == 0 else 3):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            for leg, foot in enumerate(feet):
                mujoco.mj_jacBody(model, data, J, None, foot)
                own = slice(6 + 3 * leg, 9 + 3 * leg)
                off = places[leg] - data.xpos[foot]
                data.qpos[7 + 3 * leg : 10 + 3 * leg] += np.linalg.solve(J[:, own], off)
        found.append(data.qpos[7:].copy())
    return np.array(found)


def _sample(model, data, n):
    """Positions, torques, and what an IMU at the base's origin measures, exactly."""
    R = np.zeros(9)
    import mujoco

    mujoco.mju_quat2Mat(R, data.qpos[3:7])
    felt = R.reshape(3, 3).T @ (data.qacc[:3] + np.array([0, 0, 9.81]))
    closed = [
        any(
            model.geom(f"{leg}").id in (data.contact[c].geom1, data.contact[c].geom2)
            for c in range(data.ncon)
        )
        for leg in LEGS
    ]
    joints = data.qpos[7:], data.qfrc_actuator[6:]
    return np.concatenate([*joints, data.qvel[3:6], felt, data.qpos[3:7], closed])


def _recording(model, rows, rng):
    """Return what was logged, noise and all."""
    n = model.nv - 6
    time = np.arange(len(rows)) / RATE
    cuts = np.cumsum([n, n, 3, 3, 4])
    q, torque, gyro, felt, quaternion, closed = np.split(rows, cuts, axis=1)

    def noisy(values, level):
        return values + level * rng.normal(size=values.shape)

    base = ci.base_from_imu(
        time,
        noisy(gyro, GYRO),
        noisy(felt, ACCELEROMETER),
        cutoff=None,
        rotation=ci.rotations(quaternion, "wxyz"),
    )
    flags = tuple(
        ci.ContactFlags(f"{leg}_calf", closed[:, i] > 0.5, FOOT, radius=RADIUS)
        for i, leg in enumerate(LEGS)
    )
    return ci.Recording(
        tuple(model.joint(j).name for j in range(1, model.njnt)),
        time,
        noisy(q, ENCODER),
        torque=noisy(torque, TORQUE),
        name="sway",
        base=base,
        contacts=flags,
    )


def prepared(log: ci.Recording) -> ci.Recording:
    """Return a log with derivatives, filtered, without its ends."""
    smooth = ci.low_passed(log, motion_cutoff=CUTOFF, torque_cutoff=CUTOFF)
    return ci.differentiated(smooth).samples(slice(50, -50))


def known_of_legs(truth: Truth, path: Path) -> dict[str, float]:
    """Return what a hanging robot's log tells of its legs: bodies, rotor inertias."""
    import mujoco

    model = read_spec(path, mujoco).compile()
    links, joints = truth.nominal.links[1:], truth.nominal.joint_names
    known = {
        f"{link.name}.{name}": float(value)
        for link in links
        for name, value in zip(INERTIAL_NAMES, link.nominal.vector, strict=True)
    }
    armature = model.dof_armature[6:]
    rotors = (f"{joint}.rotor_inertia" for joint in joints)
    return known | dict(zip(rotors, armature.tolist(), strict=True))


def trunk_errors(found: ci.Estimate, truth: Truth) -> tuple[float, float, np.ndarray]:
    """Relative error of mass, distance of centres of mass [m], relative moments."""
    trunk = ci.InertialParameters(found.links[0])
    true = truth.with_box.links[0].nominal
    moments, right = (
        np.linalg.eigvalsh(body.central_inertia) for body in (trunk, true)
    )
    apart = float(np.linalg.norm(trunk.com - true.com))
    return trunk.mass / true.mass - 1.0, apart, moments / right - 1.0


PROBLEM = """# Go2 with a box on its trunk, simulated by benchmarks/quadruped.py.
name = "trunk"

[model]
mjcf = "${{CONSISTENT_ID_DATASETS}}/unitree_go2/go2.xml"
base = "floating"

[drive]
viscous = true
rotor_inertia = true
coulomb = "tanh"
velocity_scale = 0.02

[constraints]
masses = "free"
known_links = {legs}  # from a log of the robot hung up by its trunk
fixed = {{ {rotors} }}

[data]
recordings = [
  {{ file = "training.csv", role = "training", rows = [50, {last}] }},
  {{ file = "validation.csv", role = "validation", rows = [50, {last}] }},
]

[data.columns]
torque = "tau_{{joint}}"

[data.base]
angular_velocity = ["gyro_x", "gyro_y", "gyro_z"]
acceleration = ["acc_x", "acc_y", "acc_z"]
orientation = ["q_w", "q_x", "q_y", "q_z"]
order = "wxyz"

[data.preparation]
motion_cutoff = {cutoff}
torque_cutoff = {cutoff}
least_joint_speed = {rest}
"""


def write_problem(folder: Path, path: Path, truth: Truth) -> None:
    """Write a problem file and its logs."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed, name in enumerate(("training", "validation")):
        log = simulated(path, seed)
        columns = {"time": log.time}
        columns |= {f"q_{j}": log.position[:, i] for i, j in enumerate(log.joints)}
        columns |= {f"tau_{j}": log.torque[:, i] for i, j in enumerate(log.joints)}
        for what in ("angular_velocity", "specific_force"):
            short = {"angular_velocity": "gyro", "specific_force": "acc"}[what]
            values = getattr(log.base, what)
            columns |= {f"{short}_{c}": values[:, i] for i, c in enumerate("xyz")}
        turned = _quaternions(log.base.rotation)
        columns |= {f"q_{c}": turned[:, i] for i, c in enumerate("wxyz")}
        columns |= {f"contact_{c.frame}": 1.0 * c.closed for c in log.contacts}
        rows = np.column_stack(list(columns.values()))
        header = ",".join(columns)
        file = folder / f"{name}.csv"
        np.savetxt(file, rows, "%.9g", ",", header=header, comments="")
    known = known_of_legs(truth, path).items()
    rotors = [f'"{k}" = {v:g}' for k, v in known if k.endswith("rotor_inertia")]
    text = PROBLEM.format(
        legs=json.dumps(list(truth.nominal.link_names[1:])),
        rotors=", ".join(rotors),
        last=len(log) - 50,
        cutoff=CUTOFF,
        rest=REST,
    )
    for flags in log.contacts:
        text += (
            f'\n[[data.contacts]]\nframe = "{flags.frame}"\n'
            f'closed = "contact_{flags.frame}"\npoint = {list(FOOT)}\n'
            f"radius = {RADIUS}\n"
        )
    (folder / "problem.toml").write_text(text)
    print(f"written: {folder / 'problem.toml'}")


def _quaternions(rotation):
    import mujoco

    found = np.zeros((len(rotation), 4))
    for quaternion, R in zip(found, rotation, strict=True):
        mujoco.mju_mat2Quat(quaternion, R.ravel())
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=3, help="simulated, each its seed")
    parser.add_argument("--problem", type=Path, help="folder for a problem file")
    options = parser.parse_args()
    path = Path(os.environ["CONSISTENT_ID_DATASETS"]) / "unitree_go2" / "go2.xml"
    truth = robots(path)
    if options.problem is not None:
        write_problem(options.problem, path, truth)
        return
    drive = ci.DriveTerms(
        rotor_inertia=True, viscous=True, coulomb="tanh", velocity_scale=0.02
    )
    model = ci.contact_free_model(ci.TorqueModel(truth.nominal, drive))
    signs = [ci.PhysicalConsistency(), ci.NonNegativeDrive()]
    legs = [*signs, ci.FixedParameters(known_of_legs(truth, path))]
    for seed, dry in product(range(options.logs), (False, True)):
        log = prepared(simulated(path, seed, dry_friction=dry))
        moving = ci.without_rests(log, REST, reach=REACH)
        print(f"log {seed}, {len(log)} samples, dry friction in the joints: {dry}")
        for label, constraints, used in (
            ("legs known", legs, log),
            ("legs known, joints at rest left out", legs, moving),
            ("nothing known", signs, log),
        ):
            started = process_time()
            regression = ci.contact_free_regression(model, used)
            base = ci.contact_free_base(model, log.contacts)
            found = ci.constrained_least_squares(
                model, regression, constraints=constraints, base=base
            )
            mass, apart, moments = trunk_errors(found, truth)
            print(
                f"  {label}: {regression.counts[0]} rows, "
                f"{found.certificate.verdict}, mass {mass:+.2%}, centre "
                f"{1e3 * apart:.2f} mm, moments "
                f"{', '.join(f'{m:+.1%}' for m in moments)}, misfit "
                f"{found.fit.misfit:.1%}, {process_time() - started:.2f} CPU s"
            )


if __name__ == "__main__":
    main()
