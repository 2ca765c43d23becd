"""Logs of a known arm with one fault of a known size."""

from dataclasses import replace

import numpy as np

from consistent_id.diagnosis.factor_logs import (
    FactorLogs,
    factors_of,
    leaning,
)


def faulty(log, model, kind, place, size):
    """Return a log from which a factor of that size has to be taken out."""
    if kind == "clock":
        speed = np.exp(-size)
        log = replace(
            log,
            velocity=speed * log.velocity,
            acceleration=speed**2 * log.acceleration,
        )
    elif kind == "masses or gain":
        log = replace(log, torque=np.exp(size) * log.torque)
    elif kind == "torque gain":
        log = replace(log, torque=np.exp(size * (np.arange(4) == place)) * log.torque)
    elif kind == "offset zero":
        log = replace(log, position=log.position - size * (np.arange(4) == place))
    else:
        axis = [f.axis for f in factors_of(model) if f.kind == "gravity"][place]
        model = leaning(model, axis, -size)
    return model, log


LITTLE = (0.2, 0.2, 0.0)
GAIN_OF_ALL = ("masses or gain", 0, np.log(1.4))
FAULTS = [
    ("clock", 0, np.log(2.0)),
    ("clock", 0, np.log(0.7)),
    GAIN_OF_ALL,
    ("masses or gain", 0, np.log(0.6)),
    ("offset zero", 1, np.radians(15.0)),
    ("offset zero", 2, np.radians(-20.0)),
    ("gravity", 0, np.radians(12.0)),
    ("gravity", 1, np.radians(-12.0)),
    ("torque gain", 1, np.log(1.3)),
    ("torque gain", 0, np.log(0.75)),
]


def accusing(found):
    """Return the findings that are no notes."""
    return [finding for finding in found if finding.severity != "note"]


def factor_logs(model, log, *, masses_known=True):
    return FactorLogs.of(model, [log], masses_known=masses_known)
