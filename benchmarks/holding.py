"""Drift of arms that float on the gravity and friction of their identified models.

``python benchmarks/holding.py [--only holding c] [--write docs/control.md]``

MuJoCo simulates three arms with friction and rotors.  Each is identified from 20 s of
motion.  Then compensation alone holds it in 50 random poses for 5 s.  Beside it are
the bodies that the robot's file states, with the identified friction: masses are right
there, centres of mass and inertias are near.  The less dry friction there is, the more
depends on the bodies.  ``c`` compiles the functions of an arm of seven joints and times
them (needs gcc).
"""

import argparse
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from faults_robots import Robot, as_drawn, loaded, urdf
from pages import written_to
from payload import ARMS, VISCOUS, run_of, states, write_log
from threadpoolctl import threadpool_limits

import consistent_id as ci
from consistent_id.service import ControlModel, control_model

POSES, SECONDS, STEP = 50, 5.0, 2e-3
FRICTIONS = (0.03, 0.01, 0.003)  # of the effort limits: dry friction
HELD = 0.2  # degrees, within which an arm counts as held
ROTOR = 0.005  # kg m^2 for each N m of the effort limit, as of a UR10e
NOISE = 0.01  # of each joint's torque
DRIVE = ("viscous", "coulomb", "offset", "rotor_inertia")


def simulated(robot: Robot, friction: float) -> mujoco.MjModel:
    """Return the arm as MuJoCo simulates it, with friction and without contacts."""
    model = mujoco.MjModel.from_xml_string(urdf(robot))
    effort = np.array([part.effort for part in robot.parts])
    model.dof_frictionloss[:] = friction * effort
    model.dof_damping[:] = VISCOUS * friction * effort
    model.dof_armature[:] = ROTOR * effort
    mujoco.mj_setConst(model, mujoco.MjData(model))  # how soft dry friction is
    model.opt.timestep = STEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return model


def drift(
    model: mujoco.MjModel, control: ControlModel, poses: np.ndarray, seconds: float
) -> np.ndarray:
    """Return the largest angle by which the arm leaves each pose, in degrees.

    Parameters
    ----------
    model : mujoco.MjModel
        The real arm.
    control : ControlModel
        Whose gravity, springs and friction are applied.
    poses : ndarray, shape (poses, joints), [rad]
    seconds : float
    """
    states = []
    for q in poses:
        data = mujoco.MjData(model)
        data.qpos[:] = q
        states.append(data)
    for _ in range(round(seconds / model.opt.timestep)):
        q = np.array([data.qpos for data in states])
        dq = np.array([data.qvel for data in states])
        torque = control.gravity(q) + control.springs(q) + control.friction(dq, q)
        for data, tau in zip(states, torque, strict=True):
            data.qfrc_applied[:] = tau
            mujoco.mj_step(model, data)
    moved = np.array([data.qpos for data in states]) - poses
    return np.degrees(abs(moved).max(axis=1))


def row(name: str, robot: Robot, friction: float) -> str:
    """Identify an arm, and return its row of the table."""
    rng = np.random.default_rng(0)
    model, drawn = simulated(robot, friction), as_drawn(robot, rng)
    with tempfile.TemporaryDirectory() as folder:
        (file := Path(folder, "robot.urdf")).write_text(urdf(drawn))
        moved = states(robot, rng, 20.0, "random motion")
        run = run_of(robot, None, moved, friction=friction, offset=0.0, rotor=ROTOR)
        sigma = NOISE * np.sqrt(np.mean(run.torque**2, axis=0))
        log = write_log(Path(folder, "log.csv"), robot, run, sigma, rng)
        problem = ci.draft_problem(
            file, log, select=False, cutoff=8.0, drive=DRIVE
        ).problem()
        estimate = ci.run_study(problem).delivered
    reach = 0.8 * np.array([part.reach for part in robot.parts])
    poses = rng.uniform(-reach, reach, (POSES, len(reach)))
    found = drift(model, control_model(estimate, allow_refused=True), poses, SECONDS)
    parameters = estimate.parameters.copy()
    nominal = estimate.model.robot.nominal
    parameters[: len(nominal)] = nominal
    stated = replace(estimate, parameters=parameters)
    beside = drift(model, control_model(stated, allow_refused=True), poses, SECONDS)
    cells = [
        f"{np.median(d):.2f} | {d.max():.2f} | {np.mean(d <= HELD):.0%}"
        for d in (found, beside)
    ]
    return f"| `{name}` | {100.0 * friction:g} % | {' | '.join(cells)} |"


def held() -> None:
    """Print the table of arms that float."""
    print(
        "| arm | dry friction, of the effort limits | identified: median drift, "
        "degrees | largest | poses held | the file's bodies: median | largest | "
        "poses held |\n|---|--:|--:|--:|--:|--:|--:|--:|"
    )
    for friction in FRICTIONS:
        for name, robot in ARMS.items():
            print(row(name, robot, friction), flush=True)


def timed_c() -> None:
    """Print the time of a call of each function in C."""
    model = ci.TorqueModel(
        loaded(urdf(ARMS["seven_joints"])),
        ci.DriveTerms(viscous=True, coulomb="sign", offset=True, rotor_inertia=True),
    )
    rng = np.random.default_rng(0)
    time, q, dq, ddq = states(ARMS["seven_joints"], rng, 10.0, "random motion")
    motion = ci.Recording(
        model.robot.joint_names, time, q, velocity=dq, acceleration=ddq
    )
    bodies = model.robot.nominal
    truth = np.append(bodies, np.ones(len(model.layout) - len(bodies)))
    log = ci.simulate_torque(model, truth, motion, noise=0.1, rng=rng)
    estimate = ci.constrained_least_squares(model, ci.build_regression(model, log))
    control = control_model(estimate, allow_refused=True)
    with tempfile.TemporaryDirectory() as folder:
        control.c(name="arm").save(Path(folder, "arm.c"))
        Path(folder, "main.c").write_text(_TIMED)
        words = ["gcc", "-O2", "-o", "timed", "main.c", "arm.c", "-lm"]
        subprocess.run(words, cwd=folder, check=True)
        run = subprocess.run(
            [Path(folder, "timed")], check=True, capture_output=True, text=True
        )
    print("| function, 7 joints, gcc -O2 | CPU time of a call |\n|---|--:|")
    print(run.stdout.strip())


_TIMED = """#include "arm.h"
#include <stdio.h>
#include <time.h>
#define CALLS 200000
#define TIME(name, call) \\
  begun = clock(); \\
  for (k = 0; k < CALLS; ++k) { q[k % 7] += 1e-6; call; sum += out[k % 7]; } \\
  printf("| `" name "` | %.2f us |\\n", \\
         1e6 * (double)(clock() - begun) / CLOCKS_PER_SEC / CALLS);
int main(void) {
  double q[7] = {0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7}, dq[7] = {1, 1, 1, 1, 1, 1, 1};
  double ddq[7] = {1, 2, 3, 4, 5, 6, 7}, out[49], sum = 0.0;
  int k;
  clock_t begun;
  TIME("gravity", arm_gravity(q, out))
  TIME("bias", arm_bias(q, dq, out))
  TIME("friction", arm_friction(q, dq, out))
  TIME("torque", arm_torque(q, dq, ddq, out))
  TIME("mass_matrix", arm_mass_matrix(q, out))
  return sum == 0.0;
}
"""

PARTS = {"holding": held, "c": timed_c}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    for name in options.only:
        with threadpool_limits(1), written_to(options.write, name):
            PARTS[name]()


if __name__ == "__main__":
    main()
