"""The result of identified servos: parameters, errors, and the verdict on them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from consistent_id._support.tables import Table, brief
from consistent_id.estimation.judgement import GENERALISATION_CARE
from consistent_id.estimation.verdict import Reason, Verdict, weighed
from consistent_id.rollout.servo_bounds import TORQUES, UNITS, scale_unknown


@brief
@dataclass(frozen=True, slots=True)
class ServoForm:
    """A form of friction fitted to one joint.

    Parameters
    ----------
    values : dict of str to float
        Parameters by name, in the units of `servo_bounds.UNITS`.
    half_intervals : dict of str to float
        Half widths of 95 % intervals, from leaving out each log in turn and from
        simulated copies of the logs; infinite of parameters that are not known
        (`SearchBox.unknown`), and those of the others then hold only if the values at
        a border are right.
    training, left_out : float, [rad]
        Mean absolute error of simulated positions, over whole logs: of the logs that
        were learnt from, and of each log simulated by a fit to the others.
    at_border : tuple of str
        Parameters at a border of the box of the search.
    """

    name: str
    values: Mapping[str, float]
    half_intervals: Mapping[str, float]
    training: float
    left_out: float
    at_border: tuple[str, ...] = ()


@brief
@dataclass(frozen=True, slots=True)
class JointServo:
    """One joint's servo.

    Parameters
    ----------
    forms : tuple of ServoForm
        All that were fitted; `chosen` has the least error of logs left out.
    gains : dict of str to float, [1/rad]
        The firmware's gain, duty over position error, of each log.
    deadband : float, [rad]
        Median of the training logs; zero if their duty shows none, or there is no duty.
        Each log is simulated with its own.
    validation : dict of str to dict of str to float, [rad]
        Errors by form, of each log that was not learnt from.
    goal_error : dict of str to float, [rad]
        Mean distance between goal and position in each log: the error of a servo that
        is assumed to be at its commanded position.
    """

    joint: str
    forms: tuple[ServoForm, ...]
    gains: Mapping[str, float]
    deadband: float
    validation: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    goal_error: Mapping[str, float] = field(default_factory=dict)

    @property
    def shown_error(self) -> tuple[float, float]:
        """Errors of the chosen form, and of taking the goal for the position [rad].

        On the logs that were not learnt from; without any, on each log left out.
        """
        chosen = self.chosen
        if not self.validation:
            return chosen.left_out, float(np.mean(list(self.goal_error.values())))
        errors = self.validation[chosen.name]
        goals = [self.goal_error[name] for name in errors]
        return float(np.mean(list(errors.values()))), float(np.mean(goals))

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Reasons against its use, the worst first."""
        return tuple(_reasons(self))

    @property
    def chosen(self) -> ServoForm:
        """The form with the least error of logs left out."""
        return min(self.forms, key=lambda form: form.left_out)

    def form(self, name: str) -> ServoForm:
        """Return the form of a name."""
        return next(form for form in self.forms if form.name == name)

    def table(self) -> Table:
        """Return the chosen form's parameters, for people."""
        form = self.chosen
        rows = tuple(
            (name, f"{value:.4g}", _half(form.half_intervals[name]), UNITS[name])
            for name, value in form.values.items()
        )
        notes = [
            f"friction {other.name}: error of logs left out {_mrad(other.left_out)}, "
            f"of training {_mrad(other.training)}"
            for other in self.forms
        ]
        if form.at_border:
            notes.append(
                f"the search ended at the border for {', '.join(form.at_border)}: the "
                "data do not determine it, and the other intervals hold only if this "
                "value is right"
            )
            if scale_unknown(form.at_border):
                torques = ", ".join(name for name in TORQUES if name in form.values)
                notes.append(
                    "the weight of the bodies does not show the scale of torques here; "
                    f"what is known are ratios of {torques}"
                )
        if self.deadband:
            notes.append(f"deadband of the firmware: {_mrad(self.deadband)}")
        title = f"Servo of {self.joint}, friction {form.name}"
        return Table(title, ("parameter", "value", "+-", "unit"), rows, tuple(notes))


@brief
@dataclass(frozen=True, slots=True)
class ServoFit:
    """Servos of a robot.

    Parameters
    ----------
    volts : float, optional, [V]
        The nominal supply, at which `stall` is the torque at full duty.
    not_moved : dict of str to float, [rad]
        Joints that do not move in the training logs, at their median positions; their
        servos are not identified.
    """

    robot: str
    joints: tuple[JointServo, ...]
    volts: float | None
    not_moved: Mapping[str, float] = field(default_factory=dict)

    @property
    def verdict(self) -> Verdict:
        """Whether the servos may be used in a simulation, and why."""
        reasons = [r for servo in self.joints for r in servo.reasons]
        reasons += [
            Reason(
                "not moved",
                "use with care",
                f"{joint} does not move in these logs: its servo is not identified",
                "record a motion of some tenths of a radian of it",
            )
            for joint in self.not_moved
        ]
        logs = dict.fromkeys(
            log for servo in self.joints for by in _by_form(servo) for log in by
        )
        return weighed("servo", reasons, (), None, tuple(logs))

    def validation_error(self, form: str | None = None) -> float:
        """Return the mean error of logs not learnt from, over joints [rad].

        NaN if there are none.
        """
        errors = [
            servo.validation[form or servo.chosen.name].values()
            for servo in self.joints
            if servo.validation
        ]
        found = [value for values in errors for value in values]
        return float(np.mean(found)) if found else float("nan")

    def tables(self) -> list[Table]:
        """Return the results for people."""
        shown, verdict = self.validation_error(), self.verdict
        kinds = ", ".join(dict.fromkeys(reason.kind for reason in verdict.grounds))
        said = f"{verdict.word}: servo" + (f"; {kinds}" if kinds else "")
        if np.isfinite(shown):
            first = f"Error of simulated position, logs not used: {_mrad(shown)}"
        else:
            first = "No log was left unused; the error is that of logs left out in turn"
        rows = tuple(
            (servo.joint, log, *(f"{1e3 * by[log]:.1f}" for by in _by_form(servo)))
            for servo in self.joints
            for log in next(iter(servo.validation.values()), {})
        )
        names = tuple(form.name for form in self.joints[0].forms)
        notes = ["mean absolute error in mrad, from the start to the end of each log"]
        if self.volts is not None:
            notes.append(f"stall: torque at full duty and {self.volts:.2f} V")
        if len(self.joints) > 1:
            notes.append("each joint is simulated while the others move as measured")
        notes += [
            f"{joint} does not move in these logs: its servo cannot be identified"
            for joint in self.not_moved
        ]
        head = ("joint", "log", *names) if rows else ()
        return [
            Table(said, (), (), verdict.lines),
            Table(first, head, rows, tuple(notes)),
            *(servo.table() for servo in self.joints),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return the results by name, for JSON."""
        return {
            "format": "consistent_id servo 1",
            "robot": self.robot,
            **self.verdict.to_dict(),
            "volts": self.volts,
            "validation_error": _number(self.validation_error()),
            "not_moved": dict(self.not_moved),
            "joints": {
                servo.joint: {
                    "friction": servo.chosen.name,
                    "gains": dict(servo.gains),
                    "deadband": servo.deadband,
                    "validation": {k: dict(v) for k, v in servo.validation.items()},
                    "goal_error": dict(servo.goal_error),
                    "forms": {
                        form.name: {
                            "values": dict(form.values),
                            "half_intervals": {
                                name: _number(value)
                                for name, value in form.half_intervals.items()
                            },
                            "training_error": form.training,
                            "left_out_error": form.left_out,
                            "at_border": list(form.at_border),
                        }
                        for form in servo.forms
                    },
                }
                for servo in self.joints
            },
        }


def _reasons(servo: JointServo) -> Iterator[Reason]:
    error, goal = servo.shown_error
    if not error < goal:
        yield Reason(
            "position error",
            "do not use",
            f"{servo.joint}: simulated positions are {_mrad(error)} off, the goals "
            f"themselves {_mrad(goal)}",
            "check gains, units and the bodies that the servo moves",
        )
    chosen = servo.chosen
    if error > GENERALISATION_CARE * chosen.training:
        yield Reason(
            "generalisation",
            "use with care",
            f"{servo.joint}: simulated positions are {_mrad(error)} off, in training "
            f"{_mrad(chosen.training)}",
            "learn from logs of more gains and motions",
        )
    if chosen.at_border:
        yield Reason(
            "undetermined",
            "use with care",
            f"{servo.joint}: the search ended at the border for "
            f"{', '.join(chosen.at_border)}; the intervals of the others hold only if "
            "this value is right",
            "add logs of faster and slower motion, or state --friction plain",
        )
    if not servo.validation:
        yield Reason(
            "not held out",
            "use",
            f"{servo.joint}: no log was left unused; the error is that of logs left "
            "out in turn",
        )


def _half(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else "not known"


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _by_form(servo: JointServo) -> list[Mapping[str, float]]:
    if not servo.validation:
        return []
    return [servo.validation[form.name] for form in servo.forms]


def _mrad(value: float) -> str:
    return f"{1e3 * value:.1f} mrad"
