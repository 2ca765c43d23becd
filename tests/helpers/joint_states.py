"""Messages of joint states, as tests write them."""

import numpy as np

JOINTS = ("elbow", "wrist")
START = 1_700_000_000_123_456_789  # ns
STEP = 2_000_001  # ns


def state(stamp, names, position, velocity=None, effort=None):
    """One message: stamp in ns, joints and values; velocity 10 q, effort 100 q."""
    q = np.asarray(position, float)
    velocity = 10 * q if velocity is None else velocity
    return stamp, names, q, velocity, 100 * q if effort is None else effort


def states(count=4, names=("wrist", "elbow", "finger"), start=START):
    return [
        state(start + k * STEP, names, np.arange(len(names)) + 0.5 * k)
        for k in range(count)
    ]


def logged(place):
    return START + 500_000_000 + place * STEP  # ns
