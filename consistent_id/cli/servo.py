"""``consistent-id servo``: hobby servos identified from position, goal and duty."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from consistent_id.cli.answers import Answer, show, shows_progress, tables_answer
from consistent_id.cli.options import OUTPUT, TIME_LIMIT, Option, add_command, positive

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from consistent_id._support.tables import Table
    from consistent_id.robot.model import RobotModel
    from consistent_id.rollout.servo_log import ServoLog, ServoSets
    from consistent_id.rollout.servo_result import ServoFit

_RECORD, _MODEL = "servo.json", "servo.xml"
_UNITS = ("rad", "deg", "ticks")
_ROLES = ("time", "position", "goal", "duty", "volts", "temperature", "enabled")
_MORE = """ROBOT is a URDF or MJCF file with the inertias of all links: they give the
scale of the torque, which a servo does not measure. Logs have the time, positions and
goals, and, if the servo reports them, duty (PWM, load), supply voltage, temperature and
torque enable. Printed are the torque at full duty, back-EMF, rotor inertia, friction,
delay and zero of each servo with 95 % intervals from leaving out each log in turn, and
the error of simulated positions on the logs of --validate. --output gets servo.json,
and servo.xml with MuJoCo's actuators."""
_EXAMPLES = """
consistent-id servo pendulum.urdf kp100.parquet kp800.parquet --validate kp200.parquet
consistent-id servo arm.urdf log.csv --angles ticks --zero 2048 --output results/servos
consistent-id servo arm.urdf log.csv --columns goal=cmd_{joint} duty=pwm_{joint}
"""


def _column(text: str) -> tuple[str, str]:
    role, equals, name = text.partition("=")
    if not equals or role not in _ROLES or not name:
        known = ", ".join(_ROLES)
        raise argparse.ArgumentTypeError(
            f"{text} is not ROLE=COLUMN with a role of {known}"
        )
    return role, name


def add_servo(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_servo,
        Option("robot", "URDF or MJCF file with the inertias of all links", Path),
        Option("log [...]", "logs to learn from", Path),
        Option(
            "--validate FILE ...",
            "logs to simulate, not used for training; the duty's gain and deadband "
            "are found in each of them by itself",
        ),
        *_log_options(),
        Option(
            "--friction FORM",
            "fit this form alone (default: both, chosen by logs left out)",
            choices=("plain", "load"),
        ),
        *OUTPUT,
        TIME_LIMIT,
        more=_MORE,
        examples=_EXAMPLES,
    )


def _log_options() -> tuple[Option, ...]:
    """Return the options that say what the columns of logs contain."""
    return (
        Option(
            "--columns ROLE=COLUMN ...",
            f"columns of {', '.join(_ROLES)}; {{joint}} stands for a joint's name "
            "(default: found by words in their names)",
            _column,
        ),
        Option(
            "--angles UNIT",
            "unit of positions and goals; ticks are those of 12 bits a turn",
            default="rad",
            choices=_UNITS,
        ),
        Option(
            "--times UNIT",
            "unit of the time, such as ms, us, ns, 100ns or day (default: that in the "
            "column's name, else s)",
        ),
        Option(
            "--zero NUMBER ...",
            "position in the log, in its unit, at the robot's zero: one number, or one "
            "for each joint (default: 0; ticks that are all positive need it, usually "
            "2048)",
            float,
        ),
        Option(
            "--full-duty NUMBER",
            "number that stands for full duty (default: the largest one, if the duty "
            "stays there while the position error grows, else the next of 1, 100, "
            "885, 1000, 1023)",
            positive,
        ),
        Option(
            "--gain NUMBER",
            "gain of the firmware, for logs without a duty: share of full duty over "
            "position error, 1/rad",
            positive,
        ),
    )


def run_servo(options: argparse.Namespace) -> int:
    """Identify servos; return the exit code."""
    return show(options, _answer(options))


def _answer(options: argparse.Namespace) -> Answer:
    from consistent_id._support.progress import begun

    names = ", ".join(path.name for path in (options.robot, *options.log))
    begun(f"reading {names}", shows_progress(options))
    from consistent_id._support.files import require_writable
    from consistent_id._support.tables import Table
    from consistent_id.robot.loaders.robot_file import load_robot
    from consistent_id.robot.model import followers_at
    from consistent_id.rollout.servo_columns import logged_joints
    from consistent_id.rollout.servo_fit import FORMS, identify_servos

    folder = options.output
    if folder is not None and not options.dry_run:
        require_writable(folder, [_RECORD, _MODEL])
    columns = dict(options.columns or ())
    robot = whole = load_robot(options.robot)
    logged = logged_joints(options.log[:1], robot.joint_names, columns)
    still = dict.fromkeys(set(robot.joint_names) - set(logged), 0.0)
    robot = load_robot(options.robot, locked=still) if still else robot
    training, validation = _logs(options, robot, columns)
    forms = tuple(FORMS) if options.friction is None else (options.friction,)
    fit = identify_servos(
        robot,
        training,
        validation,
        forms=forms,
        gain=options.gain,
        progress=shows_progress(options),
    )
    tables, record = fit.tables(), fit.to_dict()
    if still:
        names = ", ".join(sorted(still))
        tables.append(Table("Joints without columns", (), (), (f"{names}: held at 0",)))
    held = still | followers_at(whole.joints, still)
    made = _simulator(options.robot, held, fit, validation or training)
    if made is not None:
        tables.append(made[0])
        record["mujoco"] = made[1]

    def write() -> list[Path]:
        from consistent_id._support.files import write_atomically, write_json

        paths = [write_json(folder / _RECORD, record)]
        if made is not None and made[2]:
            paths.append(write_atomically(folder / _MODEL, made[2]))
        return paths

    usable = fit.verdict.usable
    wanted = None if folder is None else write
    return tables_answer(tables, record, usable=usable, write=wanted)


def _logs(
    options: argparse.Namespace, robot: "RobotModel", columns: "Mapping[str, str]"
) -> "ServoSets":
    """Read the logs of training and of validation."""
    from consistent_id.rollout.servo_log import read_servo_sets

    return read_servo_sets(
        options.log,
        options.validate or (),
        robot.joint_names,
        columns=columns,
        units=options.angles,
        zero=options.zero or None,
        times=options.times,
        full_duty=options.full_duty,
    )


def _simulator(
    file: Path,
    held: "Mapping[str, float]",
    fit: "ServoFit",
    logs: "Sequence[ServoLog]",
) -> "tuple[Table, dict[str, float], str] | None":
    """Return MuJoCo's errors and its file; None if MuJoCo or the form is not there."""
    from consistent_id._support.tables import Table
    from consistent_id.errors import ModelError
    from consistent_id.rollout.servo_export import (
        FORM,
        replayed_file,
        replayed_in_mujoco,
        servo_mjcf,
    )

    if FORM not in (form.name for form in fit.joints[0].forms):
        return None

    def gains(log: "ServoLog") -> list[float]:
        return [servo.gains[log.name] for servo in fit.joints]

    try:
        errors = {
            log.name: float(replayed_in_mujoco(file, fit, log, gains(log), held).mean())
            for log in logs
        }
        text = servo_mjcf(file, fit, gains(logs[0]), held, log=logs[0])
        own = [1e3 * float(replayed_file(text, fit, log).mean()) for log in logs]
    except ModelError as cause:  # such as: MuJoCo is not installed
        return Table("No MuJoCo file", (), (), (str(cause),)), {}, ""
    mean, alone = (sum(some) / len(logs) for some in (errors.values(), own))
    notes = (
        f"error of the actuators replayed in MuJoCo: {1e3 * mean:.1f} mrad with each "
        f"log's gain, supply and temperature; {alone:.1f} mrad of the file, read back",
        f"gain, supply and temperature of the file: those of {logs[0].name}",
    )
    return Table("MuJoCo actuators, friction plain", (), (), notes), errors, text
