"""Motion driven by white noise, filtered forwards and smoothed backwards.

Each joint's position and its first derivatives are a chain of integrators; what enters
the last one, the jerk or its rate, is white noise, and each reading of the position has
an error of its own:

    x[k+1] = F x[k] + w[k],       cov w = drive M
    z[k]   = first of x[k] + v[k],  var v = noise^2

The time step is taken as unit of time and the noise as unit of position, so that only
the ratio ``drive step^(2 order - 1) / noise^2`` remains.  All joints run side by side.
"""

from math import factorial
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector

_DIFFUSE = 1e6  # variance of what is not known at the start
STEADY = 1e-9
"""Relative change of covariances in a step, below which gains are kept."""


class Gains(NamedTuple):
    """Filter gains until they settle, then the last for ever.

    Shapes: gain (steps, order, columns), variance (steps, columns) of the innovations,
    covariance (steps, order, order, columns) of the predicted state,
    or the last alone.
    """

    gain: Array
    variance: Matrix
    covariance: Array


def transition(order: int) -> Matrix:
    """Return ``F`` of unit step: a Taylor series in each row."""
    return np.array(
        [
            [1.0 / factorial(j - i) if j >= i else 0.0 for j in range(order)]
            for i in range(order)
        ]
    )


def drive_covariance(order: int) -> Matrix:
    """Return ``M`` of unit step: what white noise gives after 1, 2, ... integrals."""
    top = order - 1
    return np.array(
        [
            [
                1.0 / (factorial(top - i) * factorial(top - j) * (2 * top + 1 - i - j))
                for j in range(order)
            ]
            for i in range(order)
        ]
    )


def gains(
    ratio: Vector,
    order: int,
    samples: int,
    *,
    steady: float = STEADY,
    covariances: bool = True,
) -> Gains:
    """Run the covariances, which do not depend on data, until they settle.

    Only `smoothed` needs them afterwards; they take memory.
    """
    F, M, one = transition(order), drive_covariance(order), np.eye(order)
    P = np.tile(_DIFFUSE * one, (len(ratio), 1, 1))
    gain, variance, covariance = [], [], []
    for _ in range(samples):
        S = P[:, 0, 0] + 1.0
        K = P[:, :, 0] / S[:, None]
        gain.append(K)
        variance.append(S)
        if covariances:
            covariance.append(P)
        kept = one - K[:, :, None] * one[0]
        # Joseph's form keeps covariances positive.
        updated = kept @ P @ kept.transpose(0, 2, 1) + K[:, :, None] * K[:, None, :]
        new = F @ updated @ F.T + ratio[:, None, None] * M
        new = 0.5 * (new + new.transpose(0, 2, 1))
        change = abs(new - P) <= steady * abs(new)
        P = new
        if change.all():
            break
    return Gains(
        gain=np.array(gain).transpose(0, 2, 1),
        variance=np.array(variance),
        covariance=np.moveaxis(np.array(covariance), 1, -1)
        if covariances
        else np.empty(0),
    )


def innovations(z: Matrix, found: Gains, states: Array | None = None) -> Matrix:
    """Return each reading less its prediction, shape (samples, columns).

    Readings are in units of the noise; predicted states are written to `states`, if
    given, shape (samples, order, columns).
    """
    order = found.gain.shape[1]
    F, steady = transition(order), len(found.gain) - 1
    innovation = np.empty(z.shape)
    x = _start(z, order)
    for k in range(len(z)):
        if states is not None:
            states[k] = x
        e = innovation[k] = z[k] - x[0]
        x = F @ (x + found.gain[min(k, steady)] * e)
    return innovation


def smoothed(z: Matrix, ratio: Vector, order: int) -> Array:
    """Return states given all readings, shape (samples, order, columns).

    The backward pass is that of Bryson and Frazier [Bierman1973]_: no inverse.
    """
    found = gains(ratio, order, len(z))
    P = found.covariance
    steady = len(found.gain) - 1
    states = np.empty((len(z), order, z.shape[1]))
    innovation = innovations(z, found, states)
    back = transition(order).T
    adjoint = np.empty(states.shape)
    a = np.zeros(states.shape[1:])
    for k in range(len(z) - 1, -1, -1):
        i = min(k, steady)
        a[0] -= (found.gain[i] * a).sum(axis=0) + innovation[k] / found.variance[i]
        adjoint[k] = a
        a = back @ a
    states[:steady] -= np.einsum("kijc,kjc->kic", P[:steady], adjoint[:steady])
    states[steady:] -= np.einsum("ijc,kjc->kic", P[-1], adjoint[steady:])
    return states


def _start(z: Matrix, order: int) -> Matrix:
    """Return the state before the first reading, from a polynomial through a few."""
    few = min(4 * order, len(z))
    powers = np.vander(np.arange(few, dtype=np.float64), order, increasing=True)
    coefficients = np.linalg.lstsq(powers, z[:few], rcond=None)[0]
    return np.asarray(coefficients * [[factorial(i)] for i in range(order)])
