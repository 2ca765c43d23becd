"""``mujoco.sysid`` on the problems of ``benchmarks/rollout.py``.

``python benchmarks/rollout_rivals.py [PROBLEM ...] [--write PAGE]``

Same robot file, training log, drives, delay and sharing of motors as in the problem:
armature, damping, frictionloss of each joint (equal motors have one armature), and a
torque offset.  It starts at small equal values, as nothing is known of the drives; its
optimiser is the default.  Printed are the error of rollouts of the validation log,
seconds of the processor, and in how many parameters fits to the two halves of the
training log differ by no more than its 95 % intervals.  It needs the extra ``sysid`` of
MuJoCo; without that, ``mujoco.sysid`` is silently empty.
"""

import argparse
from collections.abc import Callable, Sequence
from time import process_time
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid
from pages import add_write, shown_on

import consistent_id as ci
from consistent_id.rollout.chosen_settings import motor_groups
from consistent_id.rollout.commanded_motion import drive_commands, replay, replayable
from consistent_id.rollout.replay_model import compiled_model, replay_spec, time_step
from consistent_id.rollout.settings import gains_of

PROBLEMS = ("problems/unitree_go2", "problems/unitree_z1")
PARAMETERS = {
    "armature": (0.01, 1e-4, 0.5),
    "damping": (0.1, 0.0, 10.0),
    "frictionloss": (0.1, 0.0, 10.0),
    "offset": (0.0, -10.0, 10.0),
}  # where each starts, and its bounds
STEPS = 30
"""Of its optimiser, whose default is more; on Z1 its objective stands still after 28 to
four digits, and 55 do not meet its own test of convergence."""

KEPT = 5  # of a log's samples one of so many is compared: 40 Hz


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problems", nargs="*", default=PROBLEMS)
    add_write(parser)
    options = parser.parse_args()
    used = [name.removeprefix("problems/") for name in options.problems]
    with shown_on(options.write, used):
        for name in options.problems:
            compare(ci.load_problem(name))


def compare(problem: ci.Problem) -> None:
    """Print what ``mujoco.sysid`` makes of a problem."""
    (log,) = problem.logs("training")
    started = process_time()
    found, _ = fitted(problem, log)
    seconds = process_time() - started
    print(
        f"{problem.name}: {len(found.as_vector())} parameters, {seconds:.0f} s, error "
        f"of rollouts {error(problem, found, problem.logs('validation')):.2f} mrad",
        flush=True,
    )
    half = len(log) // 2
    (a, wide_a), (b, wide_b) = (
        fitted(problem, log.samples(part)) for part in (slice(half), slice(half, None))
    )
    apart = abs(a.as_vector() - b.as_vector())
    inside = apart <= np.hypot(wide_a, wide_b)
    print(f"  of two halves inside its 95 % intervals: {inside.mean():.0%}", flush=True)


def error(problem: ci.Problem, found: Any, logs: Sequence[ci.Recording]) -> float:
    """Return the error of rollouts [mrad]."""
    errors = np.vstack(replay_errors(problem, found, logs))
    return float(1e3 * np.sqrt((errors**2).mean()))


def replay_errors(
    problem: ci.Problem, found: Any, logs: Sequence[ci.Recording]
) -> list[np.ndarray]:
    """Return the position errors of each log's rollout [rad], (samples, joints)."""
    joints, delay = problem.model.robot.joint_names, problem.delay_of_commands
    spec = specification(problem)
    for parameter in found.values():
        parameter.apply_modifier(spec)
    model = compiled_model(spec, "mujoco.sysid", joints, gains_of(problem))
    known = [replayable(log.of(joints)) for log in logs]
    return [replay(model, log, delay=delay).errors for log in known]


def specification(problem: ci.Problem) -> Any:
    """Return the robot's file under the log's drives, with sensors of its joints."""
    (file,) = (f for f in problem.model_files.values() if f is not None)
    (log,) = problem.logs("training")
    joints, gains = problem.model.robot.joint_names, gains_of(problem)
    spec = replay_spec(file, joints, gains, step=time_step(1.0 / log.rate))
    for joint in joints:
        sensor = spec.add_sensor(name=f"position of {joint}")
        sensor.type = mujoco.mjtSensor.mjSENS_JOINTPOS
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_JOINT, joint
    return spec


def setter(what: str, joints: Sequence[str]) -> Callable[[Any, Any], None]:
    """Return what puts a parameter's value into a specification."""

    def put(spec: Any, parameter: Any) -> None:
        value = float(np.ravel(parameter.value)[0])
        for joint in joints:
            if what == "offset":
                spec.actuator(f"drive of {joint}").biasprm[0] = value
            elif what == "damping":
                spec.joint(joint).damping = [value, 0.0, 0.0]
            else:
                setattr(spec.joint(joint), what, value)

    return put


def parameters(problem: ci.Problem) -> Any:
    """Return the parameters as ``mujoco.sysid`` has them."""
    joints = [(name,) for name in problem.model.robot.joint_names]
    found = sysid.ParameterDict()
    for what, (start, low, high) in PARAMETERS.items():
        for group in motor_groups(problem) if what == "armature" else joints:
            name = f"{what} of {' and '.join(group)}"
            put = setter(what, group)
            found.add(sysid.Parameter(name, start, low, high, modifier=put))
    return found


def fitted(problem: ci.Problem, log: ci.Recording) -> tuple[Any, Any]:
    """Return parameters and the half-widths of their intervals."""
    spec = specification(problem)
    joints, gains = problem.model.robot.joint_names, gains_of(problem)
    model = compiled_model(spec, "mujoco.sysid", joints, gains).compiled
    log, step = replayable(log.of(joints)), model.opt.timestep
    steps = round(log.duration / step)
    control = drive_commands(log, gains, step, steps, delay=problem.delay_of_commands)
    velocity = np.gradient(log.position, log.time, axis=0)[0]
    if log.velocity is not None:
        velocity = log.velocity[0]
    names = [(f"position of {joint}", sysid.SignalType.MjSensor) for joint in joints]
    sequences = sysid.ModelSequences(
        problem.name,
        spec,
        log.name,
        sysid.create_initial_state(model, log.position[0], velocity, np.zeros(0)),
        sysid.TimeSeries(np.arange(steps) * step, control),
        sysid.TimeSeries.from_names(
            (log.time - log.time[0])[:-1:KEPT], log.position[:-1:KEPT], model, names
        ),
    )
    residual = sysid.build_residual_fn(models_sequences=[sequences], n_threads=1)
    best, result = sysid.optimize(
        parameters(problem), residual, verbose=False, max_iters=STEPS
    )
    left, *_ = residual(best.as_vector(), best)
    _, wide = sysid.calculate_intervals(left, result.jac)
    return best, np.asarray(wide)


if __name__ == "__main__":
    main()
