"""What can go wrong with an experiment, by name."""

from dataclasses import replace

import numpy as np
from faults_channels import (
    another_log,
    channel,
    clipped,
    clocks,
    collision,
    command,
    currents,
    degrees,
    drift,
    drive_filter,
    exchanged,
    filtered,
    gap,
    late,
    noise,
    of_one,
    part_of_torque,
    second_half,
    spikes,
    stepped,
    together,
    without_velocity,
    wrapped,
    zeros,
)
from faults_experiment import Fault, with_channels
from faults_robots import RATE
from faults_setup import (
    coupled,
    drawn,
    held,
    leaning,
    moved,
    one_part,
    one_still,
    parts,
    periodic,
    placeholders,
    real,
    robot_has,
    short,
    spring,
    units,
)

SIGN = ("torque sign", "torque channel")
ORDER = ("channel order", "channel exchange", "exchanged channels")
# About a level axis, the zero of the first joint and a leaning base are the same.
ZERO = ("offset zero", "joint zero offset", "gravity")
GAIN = ("torque gain", "torque unit", "torque channel", "masses or gain")
CHANNEL = ("torque channel", "gravity", *GAIN)
LAG = ("lag", "delay", "drive filter")
ROBOT = ("model", "robot", "geometry", "datasheet", "placeholder inertials")

CATALOGUE: dict[str, tuple[tuple[str, ...], Fault]] = {
    # The clock
    "clock in ms": (("clock",), clocks(1e3)),
    "clock in us": (("clock",), clocks(1e6)),
    "clock in ns": (("clock",), clocks(1e9)),
    "clock runs at half": (("clock",), clocks(2.0)),
    "clock runs twice as fast": (("clock",), clocks(0.5)),
    "clock 20 % fast": (("clock",), clocks(0.8)),
    "clock counts samples": (("clock",), clocks(RATE)),
    "a tenth of the rows lost": (("clock", "gap", "outliers"), gap),
    # Positions
    "positions and velocities in degrees": (
        ("degrees",),
        degrees("position", "velocity"),
    ),
    "positions in degrees": (("degrees",), degrees("position")),
    "velocities in degrees": (("degrees", "clock"), degrees("velocity")),
    "one joint in degrees": (
        ("degrees", "encoder scale"),
        together(
            of_one("position", lambda v, _: v * np.degrees(1)),
            of_one("velocity", lambda v, _: v * np.degrees(1)),
        ),
    ),
    "one encoder reversed": (
        ("position sign", *SIGN),
        together(
            of_one("position", lambda v, _: -v), of_one("velocity", lambda v, _: -v)
        ),
    ),
    "motion of two joints exchanged": (ORDER, exchanged("position", "velocity")),
    "positions of two joints exchanged": (ORDER, exchanged("position")),
    "velocities of two joints exchanged": (ORDER, exchanged("velocity")),
    "torques of two joints exchanged": (ORDER, exchanged("torque")),
    "two joints exchanged altogether": (
        (*ORDER, *ROBOT),
        exchanged("position", "velocity", "torque"),
    ),
    "zero off by 90 degrees": (ZERO, zeros(90.0)),
    "zero off by 25 degrees": (ZERO, zeros(25.0)),
    "zero off by 10 degrees": (ZERO, zeros(10.0)),
    "zeros of all off by 6 degrees": (ZERO, zeros(6.0, every=True)),
    "encoder scale 10 % off": (
        ("encoder scale", "degrees"),
        together(
            of_one("position", lambda v, _: 1.1 * v),
            of_one("velocity", lambda v, _: 1.1 * v),
        ),
    ),
    "position at the motor, gear 100": (
        ("encoder scale", "degrees"),
        together(
            of_one("position", lambda v, _: 100 * v),
            of_one("velocity", lambda v, _: 100 * v),
        ),
    ),
    "encoder counts": (
        ("encoder scale", "degrees"),
        channel("position", lambda q: q / 1e-4),
    ),
    "encoder wraps": (("wrapped encoder", "outliers"), of_one("position", wrapped)),
    "encoder stuck for half the log": (
        ("dead channel", "frozen channel", "clock"),
        of_one("position", second_half(lambda v: 0 * v + v[0])),
    ),
    "encoder dead": (("dead channel", "rank"), of_one("position", lambda v, _: 0 * v)),
    "encoder steps of 0.02 rad": (
        ("encoder resolution", "noise"),
        channel("position", lambda q: np.round(q / 0.02) * 0.02),
    ),
    "position late by 50 to 100 ms": (LAG, late("position", 0.05, 0.10)),
    # Velocities
    "velocity reversed": (
        ("velocity sign", "clock", *ORDER),
        of_one("velocity", lambda v, _: -v),
    ),
    "velocity twice too large": (
        ("clock", "velocity"),
        channel("velocity", lambda v: 2 * v),
    ),
    "velocity zero": (
        ("dead channel", "clock", "velocity"),
        channel("velocity", lambda v: 0 * v),
    ),
    "velocity late by 50 to 100 ms": ((*LAG, "velocity"), late("velocity", 0.05, 0.10)),
    # Torque
    "one torque reversed": (SIGN, of_one("torque", lambda t, _: -t)),
    "all torques reversed": (SIGN, channel("torque", lambda t: -t)),
    "torque in kN m": (GAIN, channel("torque", lambda t: t / 1e3)),
    "torque in N mm": (GAIN, channel("torque", lambda t: 1e3 * t)),
    "torque times 100": (GAIN, channel("torque", lambda t: 100 * t)),
    "torque at the motor, gear 100": (GAIN, channel("torque", lambda t: t / 100)),
    "one gain a fifth too small": (GAIN, of_one("torque", lambda t, _: 0.8 * t)),
    "one gain half": (GAIN, of_one("torque", lambda t, _: 0.5 * t)),
    "one gain twice": (GAIN, of_one("torque", lambda t, _: 2 * t)),
    "all gains 1.3": (GAIN, channel("torque", lambda t: 1.3 * t)),
    "all gains 0.7": (GAIN, channel("torque", lambda t: 0.7 * t)),
    "motor currents": (CHANNEL, currents),
    "torque without gravity": (
        CHANNEL,
        part_of_torque(gravity=False, inertial=True, friction=True),
    ),
    "torque without friction": (
        CHANNEL,
        part_of_torque(gravity=True, inertial=True, friction=False),
    ),
    "external torque only": (
        CHANNEL,
        part_of_torque(gravity=False, inertial=False, friction=False),
    ),
    "friction only": (
        CHANNEL,
        part_of_torque(gravity=False, inertial=False, friction=True),
    ),
    "gravity only": (
        CHANNEL,
        part_of_torque(gravity=True, inertial=False, friction=False),
    ),
    "command of a PD controller": (CHANNEL, command),
    "all torques zero": (("dead channel",), channel("torque", lambda t: 0 * t)),
    "one torque zero": (("dead channel",), of_one("torque", lambda t, _: 0 * t)),
    "one torque is noise": (
        ("dead channel", "torque channel"),
        of_one("torque", noise),
    ),
    "all torques are noise": (
        CHANNEL,
        lambda case, rng: with_channels(case, torque=noise(case.log.torque, rng)),
    ),
    "torque of another run": ((*CHANNEL, *LAG), another_log),
    "torque of another joint": (
        ORDER,
        lambda case, rng: with_channels(
            case, torque=np.roll(case.log.torque, 1, axis=1)
        ),
    ),
    "one torque clipped": (("saturation",), of_one("torque", clipped)),
    "outliers": (("outliers",), of_one("torque", spikes)),
    "torque late by 20 to 40 ms": (LAG, late("torque", 0.02, 0.04)),
    "torque late by 50 to 100 ms": (LAG, late("torque", 0.05, 0.10)),
    "torque late by 150 to 250 ms": (LAG, late("torque", 0.15, 0.25)),
    "torque through a 1 Hz filter": (LAG, filtered("torque", 1.0, causal=True)),
    "torque smoothed at 0.2 Hz": (LAG, filtered("torque", 0.2, causal=False)),
    "torque drifts": (("drift", "torque channel"), of_one("torque", drift)),
    "one torque stops half-way": (
        ("dead channel", "frozen channel"),
        of_one("torque", second_half(lambda v: 0 * v)),
    ),
    "torque in coarse steps": (
        ("torque resolution", "noise"),
        of_one("torque", stepped),
    ),
    "torque without its sign": (SIGN, of_one("torque", lambda t, _: abs(t))),
    "torque very noisy": (
        ("noise", "torque channel"),
        lambda case, rng: with_channels(
            case, torque=case.log.torque + noise(case.log.torque, rng)
        ),
    ),
    # The robot is not its URDF's
    "URDF in mm": (("model", "units", *ROBOT), units(1e3, 1.0)),
    "URDF in g": (("model", "units", *ROBOT, *GAIN), units(1.0, 1e3)),
    "base leans by 90 degrees": (ZERO, leaning(90.0)),
    "base upside down": (("gravity",), leaning(180.0)),
    "base leans by 30 degrees": (ZERO, leaning(30.0)),
    "placeholder inertials": ((*ROBOT, *GAIN), drawn(parts(placeholders))),
    "masses doubled": (
        (*ROBOT, *GAIN),
        drawn(parts(lambda p, _: {"mass": 2 * p.mass})),
    ),
    "a mass ten times too small": (  # of a last link: another load
        (*ROBOT, *GAIN, "load"),
        drawn(one_part(lambda p, _: {"mass": 0.1 * p.mass})),
    ),
    "a link 30 % too long": (
        ROBOT,
        drawn(one_part(lambda p, _: {"xyz": tuple(np.multiply(1.3, p.xyz).tolist())})),
    ),
    "an axis reversed": (
        ("position sign", *SIGN, *ROBOT),
        drawn(one_part(lambda p, _: {"axis": tuple(-a for a in p.axis)})),
    ),
    "a frame turned by 90 degrees": (
        (*ROBOT, *ZERO, *SIGN),
        drawn(one_part(lambda p, _: {"rpy": (np.pi / 2, 0.0, 0.0)})),
    ),
    "a load that the model lacks": (
        (*ROBOT, *GAIN, "load"),
        real(
            lambda robot, rng: replace(
                robot,
                parts=(
                    *robot.parts[:-1],
                    replace(robot.parts[-1], mass=robot.parts[-1].mass + 4.0),
                ),
            )
        ),
    ),
    # The experiment
    "half of it at rest": (("standstill",), held(0.5)),
    "nothing moves": (("standstill", "rank"), held(0.98)),
    "one joint does not move": (("rank",), moved(one_still)),
    "very small motion": (
        ("small motion", "rank", "noise", "standstill", "encoder resolution"),
        moved(lambda m, _: replace(m, amplitude=0.01 * m.amplitude)),
    ),
    "very slow motion": (
        ("slow motion", "rank", "standstill"),
        moved(lambda m, _: replace(m, frequency=0.03 * m.frequency)),
    ),
    "two seconds": (("rank", "short"), short(2.0)),
    "a collision": (("outliers", "contact"), channel("torque", collision)),
    "a spring that the model lacks": (("spring", *ROBOT), robot_has(spring)),
    "coupled joints": (("coupling", *ROBOT), robot_has(coupled)),
    # Logs of positions alone
    "clock runs at half, no velocities": (
        ("clock",),
        together(without_velocity, clocks(2.0)),
    ),
    "clock 1.5 times as fast, no velocities": (
        ("clock",),
        together(without_velocity, clocks(1 / 1.5)),
    ),
    "position late by 50 to 100 ms, no velocities": (
        LAG,
        together(without_velocity, late("position", 0.05, 0.10)),
    ),
    "torque through a drive's filter of 1 Hz": (LAG, drive_filter(1.0)),
}
"""Label -> the kinds as which it may be named, and what does it."""

CLEAN: dict[str, Fault] = {
    "clean": lambda case, rng: case,
    "clean, periodic": moved(periodic),
}
