"""The contact detector as C without allocation: one header, one source.

The same steps as `ContactDetector.step`, with a memory of fixed size.
"""

from collections.abc import Iterable
from math import ceil
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id.errors import ProblemError
from consistent_id.export.casadi_functions import identifier
from consistent_id.export.export_formats import Export, SideFile
from consistent_id.service.residual_spread import SLACK, SLOW, ResidualSpread

_SPARE = 2  # samples beyond those that a rate has in the memory

_HEAD = """/* Contacts of a robot of {n} joints, found by a short memory; 64-bit floats.
 * {rate:g} false alarms an hour are stated, from {minutes:.1f} min of logs.
 * Joints, in the order of all arrays:
{joints}
 * {name}_start takes the time of the first sample [s].
 * {name}_step takes a sample: time [s], torque from outside [N m or N]{channels}.
 * It returns 1 where a contact begins, changes or ends, which {in_a_row} sample(s) in a
 * row have to show, 0 elsewhere; -1 if a number,
 * or the time of the start, is not finite or the time goes back, -2 if there are
 * more than {most} samples in {oldest:g} s: the sample is then left out, and the
 * state is as it was.
 */
"""

_HEADER = """#ifndef {guard}_H
#define {guard}_H

#define {guard}_JOINTS {n}
#define {guard}_SAMPLES {most}
#define {guard}_SIGNALS {width}
#define {guard}_IN_A_ROW {in_a_row}

#ifdef __cplusplus
extern "C" {{
#endif

typedef struct {{
  int contact;                 /* 1 if the distance is above 1 */
  double distance;             /* of the torque from its mean, over the threshold: the
                                  least of the samples in a row */
  double change[{n}];            /* torque less its mean [N m or N] */
  double threshold[{n}];         /* change of one joint alone that is found */
  int count, first;            /* the memory: samples in it, place of the oldest */
  double begun, time;
  double recent[{in_a_row}];           /* distances of the samples in a row */
  double times[{most}];
  double rows[{most}][{width}];
}} {name}_contacts;

void {name}_start({name}_contacts *state, double time);
int {name}_step({name}_contacts *state, double time, const double *torque,
                const double *velocity, const double *acceleration,
                const double *expected);

#ifdef __cplusplus
}}
#endif

#endif
"""

_SOURCE = """#include <math.h>

/* As in the header, so that the file's name does not matter. */
{header}
enum {{ N = {n}, M = {most}, W = {width}, K = {in_a_row} }};
{tables}
/* Take a sample's distance: a contact is K in a row above 1. */
static int {name}_found({name}_contacts *state, double distance) {{
  double least = distance;
  int k;
  for (k = 0; k + 1 < K; ++k) {{
    state->recent[k] = state->recent[k + 1];
    if (state->recent[k] < least) least = state->recent[k];
  }}
  state->recent[K - 1] = distance;
  state->distance = least;
  state->contact = least > 1.0;
  return state->contact;
}}

static int {name}_known(const double *values, int used) {{
  int j;
  if (used && !values) return 0;
  for (j = 0; used && j < N; ++j)
    if (!isfinite(values[j])) return 0;
  return 1;
}}

void {name}_start({name}_contacts *state, double time) {{
  int j;
  state->contact = state->count = state->first = 0;
  state->distance = 0.0;
  state->begun = state->time = time;
  for (j = 0; j < K; ++j) state->recent[j] = 0.0;
  for (j = 0; j < N; ++j) {{
    state->change[j] = 0.0;
    state->threshold[j] = HUGE_VAL;
  }}
}}

/* Standard deviation of one joint's change, times the level of its state. */
static double {name}_deviation(const double *now, const double *mean, int state, int j,
                               double everywhere) {{
  double squares[9], total = 0.0;
  int k;
  for (k = 0; k < 9; ++k) squares[k] = 0.0;
  squares[0] = 1.0;
  squares[7] = 1.0;
  squares[5] = everywhere;
  if (state > 0) {{
    for (k = 0; k < 4; ++k) {{
      const double change = now[(k + 1) * N + j] - mean[(k + 1) * N + j];
      squares[k + 1] = change * change;
    }}
    squares[6] = now[5 * N + j] - mean[5 * N + j];
    squares[6] *= squares[6];
    squares[7] = now[2 * N + j];
    squares[8] = now[3 * N + j] * now[3 * N + j];
  }}
  for (k = 0; k < 9; ++k) {{
    const double most = largest[j][k];
    total += coefficients[j][k] * (squares[k] < most ? squares[k] : most);
  }}
  return sqrt(total) * levels[j][state];
}}

int {name}_step({name}_contacts *state, double time, const double *torque,
                const double *velocity, const double *acceleration,
                const double *expected) {{
  double mean[W], scaled[N], everywhere = 0.0, square = 0.0, *now;
  int i, j, k, first = state->first, count = state->count, before = 0, states[N];
  if (!isfinite(time) || !isfinite(state->begun) || !{name}_known(torque, 1) ||
      !{name}_known(velocity, {velocity}) ||
      !{name}_known(acceleration, {acceleration}) ||
      !{name}_known(expected, {expected}))
    return -1;
  if (count && !(time >= state->time)) return -1;
  while (count && !(state->times[first] >= time - {oldest} - {slack})) {{
    first = (first + 1) % M;
    --count;
  }}
  if (count == M) return -2;
  i = (first + count) % M;
  now = state->rows[i];
  state->times[i] = time;
  for (j = 0; j < N; ++j) {{
    const double rate = {velocity} ? velocity[j] : 0.0;
    const double direction = tanh(rate / {slow});
    now[j] = torque[j];
    now[N + j] = direction;
    now[2 * N + j] = 1.0 - direction * direction;
    now[3 * N + j] = rate;
    now[4 * N + j] = {acceleration} ? acceleration[j] : 0.0;
    now[5 * N + j] = {expected} ? expected[j] : 0.0;
  }}
  state->first = first;
  state->count = count + 1;
  state->time = time;
  for (k = 0; k < W; ++k) mean[k] = 0.0;
  for (i = 0; i < state->count; ++i) {{
    const int at = (first + i) % M;
    if (!(state->times[at] <= time - {newest} + {slack})) continue;
    for (k = 0; k < W; ++k) mean[k] += state->rows[at][k];
    ++before;
  }}
  if (!before || !(time >= state->begun + {oldest})) {{
    for (j = 0; j < N; ++j) {{
      state->change[j] = 0.0;
      state->threshold[j] = HUGE_VAL;
    }}
    return {name}_found(state, 0.0);
  }}
  for (k = 0; k < W; ++k) mean[k] /= before;
  for (j = 0; j < N; ++j) {{
    int slow = 0;
    for (i = 0; i < state->count; ++i)
      slow += fabs(state->rows[(first + i) % M][3 * N + j]) < {slow};
    states[j] = slow == state->count ? 0 : slow ? 1 : 2;
    if (states[j]) {{
      const double change = now[4 * N + j] - mean[4 * N + j];
      everywhere += change * change;
    }}
  }}
  for (j = 0; j < N; ++j) {{
    const double sigma = {name}_deviation(now, mean, states[j], j, everywhere);
    state->change[j] = now[j] - mean[j];
    scaled[j] = state->change[j] / sigma;
    state->threshold[j] = {limit} * sigma / sqrt(weights[j][j]);
  }}
  for (i = 0; i < N; ++i)
    for (j = 0; j < N; ++j) square += scaled[i] * weights[i][j] * scaled[j];
  return {name}_found(state, sqrt(square) / {limit});
}}
"""


class DetectorValues(NamedTuple):
    """The values of a `ContactDetector`."""

    joints: tuple[str, ...]
    spread: ResidualSpread
    limit: float
    false_alarms: float
    memory: tuple[float, float]
    hours: float
    in_a_row: int


def detector_c(detector: DetectorValues, name: str, rate: float) -> Export:
    """Return a detector as C: a source, and a header beside it.

    Parameters
    ----------
    detector : DetectorValues
    name : str
        Prefix of the functions.
    rate : float, [Hz]
        Most samples a second, for which the memory has room.

    Raises
    ------
    ProblemError
        If the rate is too low for the memory, or not a number.
    """
    spread, n = detector.spread, len(detector.joints)
    newest, oldest = detector.memory
    common = {
        "name": identifier(name),
        "n": n,
        "most": _room(detector.memory, rate),
        "in_a_row": detector.in_a_row,
    }
    tables = {
        "coefficients": spread.coefficients,
        "largest": spread.largest,
        "levels": spread.levels,
        "weights": spread.weights,
    }
    guard = identifier(name).upper()
    header = _HEADER.format(guard=guard, width=6 * n, **common)
    source = _SOURCE.format(
        header=header,
        width=6 * n,
        tables="".join(_table(*item) for item in tables.items()),
        velocity=int(spread.signals.velocity),
        acceleration=int(spread.signals.acceleration),
        expected=int(spread.signals.expected),
        newest=repr(float(newest)),
        oldest=repr(float(oldest)),
        slack=repr(SLACK),
        slow=repr(SLOW),
        limit=repr(float(detector.limit)),
        **common,
    )
    head = _head(detector, common)
    return Export(
        "c", (head + source).encode(), side=SideFile(".h", (head + header).encode())
    )


def _room(memory: tuple[float, float], rate: float) -> int:
    """Return the most samples in the memory; refuse rates that are too low for it."""
    newest, oldest = memory
    if not 1.0 / max(oldest - newest, 1e-9) < rate < np.inf:
        raise ProblemError(
            f"the rate is {rate} Hz, expected that of the robot's samples: more than "
            f"one in the {oldest - newest:g} s of the memory"
        )
    return ceil(oldest * rate) + _SPARE


def _head(detector: DetectorValues, common: dict[str, Any]) -> str:
    """Return the comment at the top of both files: what the functions take."""
    used = detector.spread.signals
    channels = [
        words
        for words, has in (
            ("velocity", used.velocity),
            ("acceleration", used.acceleration),
            ("torque that the model expects", used.expected),
        )
        if has
    ]
    names = [f" *   {k} {joint}" for k, joint in enumerate(detector.joints)]
    return _HEAD.format(
        rate=detector.false_alarms,
        minutes=60.0 * detector.hours,
        joints="\n".join(names).replace("*/", "* /"),
        channels="".join(f", {c}" for c in channels) + "; others may be null",
        oldest=detector.memory[1],
        **common,
    )


def _table(name: str, values: Array) -> str:
    rows = ",\n".join(f"  {{{_numbers(row)}}}" for row in values)
    shape = f"[{values.shape[0]}][{values.shape[1]}]"
    return f"static const double {name}{shape} = {{\n{rows}}};\n"


def _numbers(row: Iterable[float]) -> str:
    return ", ".join(repr(float(x)) for x in row)
