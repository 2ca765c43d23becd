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

from consistent_id._arrays import Array, Matrix, Vector

_DIFFUSE = 1e6  # variance of what is not known at the start
_SETTLED = 1e-10  # relative change of covariances from which gains are kept


class Gains(NamedTuple):
    """Filter gains until they settle, then the last for ever.

    Shapes: gain (steps, order, columns), variance (steps, columns) of the innovations,
    covariance (steps, order, order, columns) of the predicted state.
    """

    gain: Array
    variance: Matrix
    covariance: Array


class Filtered(NamedTuple):
    """Predicted states, shape (samples, order, columns), and innovations."""

    state: Array
    innovation: Matrix


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


def gains(ratio: Vector, order: int, samples: int) -> Gains:
    """Run the covariances, which do not depend on data, until they settle."""
    F, M, one = transition(order), drive_covariance(order), np.eye(order)
    P = np.tile(_DIFFUSE * one, (len(ratio), 1, 1))
    found = []
    for _ in range(samples):
        S = P[:, 0, 0] + 1.0
        K = P[:, :, 0] / S[:, None]
        found.append((K, S, P))
        kept = one - K[:, :, None] * one[0]
        # Joseph's form keeps covariances positive.
        updated = kept @ P @ kept.transpose(0, 2, 1) + K[:, :, None] * K[:, None, :]
        new = F @ updated @ F.T + ratio[:, None, None] * M
        new = 0.5 * (new + new.transpose(0, 2, 1))
        settled = (abs(new - P) <= _SETTLED * abs(new)).all()
        P = new
        if settled:
            break
    K, S, P = (np.array(part) for part in zip(*found, strict=True))
    return Gains(K.transpose(0, 2, 1), S, P.transpose(0, 2, 3, 1))


def filtered(z: Matrix, found: Gains) -> Filtered:
    """Run the filter over readings, shape (samples, columns), in units of the noise."""
    order = found.gain.shape[1]
    F, settled = transition(order), len(found.gain) - 1
    states = np.empty((len(z), order, z.shape[1]))
    innovation = np.empty(z.shape)
    x = _start(z, order)
    for k in range(len(z)):
        states[k] = x
        e = innovation[k] = z[k] - x[0]
        x = F @ (x + found.gain[min(k, settled)] * e)
    return Filtered(states, innovation)


def smoothed(z: Matrix, found: Gains) -> Array:
    """Return states given all readings, shape (samples, order, columns).

    The backward pass is that of Bryson and Frazier [Bierman1973]_: no inverse.
    """
    order, settled = found.gain.shape[1], len(found.gain) - 1
    states, innovation = filtered(z, found)
    back = transition(order).T
    adjoint = np.empty(states.shape)
    a = np.zeros(states.shape[1:])
    for k in range(len(z) - 1, -1, -1):
        i = min(k, settled)
        a = a.copy()
        a[0] -= (found.gain[i] * a).sum(axis=0) + innovation[k] / found.variance[i]
        adjoint[k] = a
        a = back @ a
    first = min(settled, len(z))
    states[:first] -= np.einsum(
        "kijc,kjc->kic", found.covariance[:first], adjoint[:first]
    )
    states[first:] -= np.einsum("ijc,kjc->kic", found.covariance[-1], adjoint[first:])
    return states


def _start(z: Matrix, order: int) -> Matrix:
    """Return the state before the first reading, from a polynomial through a few."""
    few = min(4 * order, len(z))
    powers = np.vander(np.arange(few, dtype=np.float64), order, increasing=True)
    coefficients = np.linalg.lstsq(powers, z[:few], rcond=None)[0]
    return np.asarray(coefficients * [[factorial(i)] for i in range(order)])
