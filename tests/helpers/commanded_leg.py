"""A problem whose log is MuJoCo's own, of a leg with drives that are known."""

from functools import cache
from io import StringIO

import mujoco
import numpy as np

ROBOT = """
<mujoco model="leg">
  <compiler angle="radian"/>
  <option gravity="0 0 -9.81" timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="trunk">
      <freejoint/>
      <inertial pos="0 0 0" mass="5" diaginertia="0.1 0.1 0.1"/>
      <body name="thigh" pos="0 0 0">
        <joint name="hip" axis="0 1 0" range="-1.5 1.5" {hip}/>
        <inertial pos="0 0 -0.1" mass="1" diaginertia="0.005 0.005 0.001"/>
        <body name="shank" pos="0 0 -0.2">
          <joint name="knee" axis="0 1 0" range="-1.5 1.5" {knee}/>
          <inertial pos="0 0 -0.1" mass="0.3" diaginertia="0.001 0.001 0.0002"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
TRUTH = {
    "hip": 'damping="0.3" frictionloss="0.4" armature="0.02"',
    "knee": 'damping="0.2" frictionloss="0.25" armature="0.015"',
}
PROBLEM = """
name = "leg"
[model]
mjcf = "leg.xml"
joints = ["hip", "knee"]
[drive]
viscous = true
coulomb = "tanh"
velocity_scale = 0.05
rotor_inertia = true
[constraints]
bodies = "model"
[data.columns]
position = "q{number}"
position_command = "qdes{number}"
[data.gains]
kp = 25.0
kd = 1.0
[data.preparation]
motion_cutoff = 20.0
torque_cutoff = 20.0
[[data.recordings]]
file = "log.csv"
role = "training"
rows = [1, 1200]
[[data.recordings]]
file = "log.csv"
role = "validation"
rows = [1220, 1900]
"""


def write_leg(folder, delay=0.0, stribeck=0.0, stop=1.5):
    """Write ``leg.xml``, ``true.xml``, ``log.csv`` and ``problem.toml``.

    Commands act with a delay [s].  Dry friction at rest is larger by a share, which
    fades at 0.3 rad/s.  The knee has a stop [rad].
    """
    (folder / "leg.xml").write_text(ROBOT.format(hip="", knee=""))
    (folder / "true.xml").write_text(ROBOT.format(**TRUTH))
    (folder / "problem.toml").write_text(PROBLEM)
    (folder / "log.csv").write_text(_log(delay, stribeck, stop))


@cache
def _log(delay, stribeck, stop):
    true = ROBOT.format(**TRUTH).replace("<freejoint/>", "")
    model = mujoco.MjModel.from_xml_string(true)
    model.joint("knee").range[1] = stop
    model.opt.timestep = 1e-4  # of first order, by the robot's own drives
    data, rows, late = mujoco.MjData(model), [], round(delay / 1e-4)
    level = model.dof_frictionloss.copy()
    commands = [_told(k) for k in range(1900)]
    for k in range(1900):
        rows.append([k / 200.0, *data.qpos, *commands[k]])
        for step in range(50 * k - late, 50 * (k + 1) - late):
            told = commands[max(step // 50, 0)]
            if stribeck:
                more = stribeck * np.exp(-((data.qvel / 0.3) ** 2))
                model.dof_frictionloss[:] = level * (1.0 + more)
            data.qfrc_applied = 25.0 * (told - data.qpos) - 1.0 * data.qvel
            mujoco.mj_step(model, data)
    head, text = "time,q1,q2,qdes1,qdes2", StringIO()
    np.savetxt(text, rows, delimiter=",", header=head, comments="")
    return text.getvalue()


def _told(k):
    t = k / 200.0
    phase = np.array([1.0, 1.4]) * t * 2.0 + 0.7 * t**2
    return 0.5 * np.sin(phase)
