"""Householder's QR of rows below a triangle, on blocks that stay in the cache.

LAPACK's `tpqrt` passes over all rows for each few columns.  Here a block of rows is
eliminated before the next one is touched, two columns at a time, so that the others are
read and written half as often: `benchmarks/compiled.py` measures what that saves.

Which of both is used depends on the rows' number and on the machine, never on what was
computed before; so bits do not depend on how work is divided among processes.
"""

import ctypes
import logging
from collections.abc import Callable
from functools import lru_cache
from threading import Lock

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.regression.compiled.compiler import compiled, loaded, switched_on

LEAST = 2048
"""Rows from which on compiled code is used: fewer need not wait for a compiler."""

_NAME = "extend"
_ROWS = 128  # of a block, whose columns stay in the nearest caches
_LINE = 64  # bytes of a line of the cache, at which blocks begin
_ALIKE = 1e-12  # relative difference to LAPACK's numbers that compiled code may have
_OPTIONS = ("-O3", "-ffp-contract=fast")  # unrolled, and sums fused with products

_SOURCE = (
    f"enum {{ ROWS = {_ROWS} }};"
    + """
#if defined __AVX512F__
enum { WIDTH = 8 };
#elif defined __AVX__
enum { WIDTH = 4 };
#else
enum { WIDTH = 2 };
#endif
enum { HEIGHT = ROWS / WIDTH, SIDE = 4 };
typedef double lane __attribute__((vector_size(8 * WIDTH), aligned(8)));
#define AT(column, i) (*(lane *)((column) + (i) * WIDTH))

static inline double total(lane x)
{
  for (int half = WIDTH / 2; half; half /= 2)
    for (int i = 0; i < half; i++)
      x[i] += x[i + half];
  return x[0];
}

static inline double dot(const double *v, const double *w)
{
  lane even = {0}, odd = {0};
  for (int i = 0; i < HEIGHT; i += 2) {
    even += AT(v, i) * AT(w, i);
    odd += AT(v, i + 1) * AT(w, i + 1);
  }
  return total(even + odd);
}

/* Reflect a column v into the entry `head` above it, and return tau of the reflection
   by 1 - tau (1, v) (1, v)^T; v is scaled to that. */
static inline double reflection(double *head, double *v)
{
  const double below = dot(v, v);
  if (below == 0)
    return 0;
  const double norm = __builtin_sqrt(*head * *head + below);
  const double beta = *head < 0 ? norm : -norm;
  const double tau = (beta - *head) / beta, scale = 1 / (*head - beta);
  for (int i = 0; i < HEIGHT; i++)
    AT(v, i) *= scale;
  *head = beta;
  return tau;
}

/* Reflect columns b by v, then by w, and the entries r and s of the triangle's rows
   above them; `between` is v^T w. */
#define REFLECT(count)                                                        \\
  {                                                                           \\
    lane dv[count] = {{0}}, dw[count] = {{0}};                                \\
    for (int i = 0; i < HEIGHT; i++)                                          \\
      for (int c = 0; c < count; c++) {                                       \\
        dv[c] += AT(v, i) * AT(b + c * ROWS, i);                              \\
        dw[c] += AT(w, i) * AT(b + c * ROWS, i);                              \\
      }                                                                       \\
    for (int c = 0; c < count; c++) {                                         \\
      const double x = tau * (r[c] + total(dv[c]));                           \\
      const double y = sigma * (s[c] + total(dw[c]) - between * x);           \\
      r[c] -= x;                                                              \\
      s[c] -= y;                                                              \\
      dv[c] = (lane){0} + x;                                                  \\
      dw[c] = (lane){0} + y;                                                  \\
    }                                                                         \\
    for (int i = 0; i < HEIGHT; i++)                                          \\
      for (int c = 0; c < count; c++)                                         \\
        AT(b + c * ROWS, i) -= dv[c] * AT(v, i) + dw[c] * AT(w, i);           \\
  }

/* Eliminate a block, two columns at a time, into the triangle R (row by row). */
static void eliminate(double *R, double *block, long width)
{
  for (long k = 0; k < width; k += 2) {
    double *v = block + k * ROWS, *w = v + ROWS, *b = w + ROWS;
    double *r = R + k * width + k, *s = r + width;
    const double tau = reflection(r++, v);
    if (k + 1 == width)
      return;
    const double x = tau * (*r + dot(v, w));
    *r++ -= x;
    for (int i = 0; i < HEIGHT; i++)
      AT(w, i) -= x * AT(v, i);
    const double sigma = reflection(++s, w), between = dot(v, w);
    s++;
    long left = width - k - 2;
    for (; left >= SIDE; left -= SIDE, b += SIDE * ROWS, r += SIDE, s += SIDE)
      REFLECT(SIDE)
    for (; left; left--, b += ROWS, r++, s++)
      REFLECT(1)
  }
}

void extend(double *R, const double *rows, double *block, long width, long height)
{
  for (long start = 0; start < height; start += ROWS) {
    const long left = height - start, count = left < ROWS ? left : ROWS;
    for (long j = 0; j < width; j++) {
      const double *from = rows + j * height + start;
      double *to = block + j * ROWS;
      for (long i = 0; i < count; i++)
        to[i] = from[i];
      for (long i = count; i < ROWS; i++)
        to[i] = 0;
    }
    eliminate(R, block, width);
  }
}
"""
)

_log = logging.getLogger(__name__)
_lock = Lock()


def eliminator(
    rows: int, reference: Callable[[Matrix, Matrix], Matrix]
) -> Callable[[Matrix, Matrix], Matrix] | None:
    """Return what computes the triangle of a square triangle above so many rows.

    It is None where the rows are few, or where nothing compiled agrees with the
    `reference`, which computes the same and may destroy its arguments.
    """
    if rows < LEAST or not switched_on():
        return None
    with _lock:
        return _found(reference)


@lru_cache(maxsize=1)
def _found(
    reference: Callable[[Matrix, Matrix], Matrix],
) -> Callable[[Matrix, Matrix], Matrix] | None:
    function = loaded(_SOURCE, _NAME, _OPTIONS) or compiled(_SOURCE, _NAME, _OPTIONS)
    if function is None:
        return None

    def extended(R: Matrix, rows: Matrix) -> Matrix:
        signs = np.where(np.diagonal(R) < 0.0, 1.0, -1.0)  # LAPACK's
        R, rows = np.array(R, order="C"), np.asfortranarray(rows)
        height, width = rows.shape
        block = _aligned(width * _ROWS)
        function(
            *(ctypes.c_void_p(x.ctypes.data) for x in (R, rows, block)),
            *(ctypes.c_long(number) for number in (width, height)),
        )
        return R * np.where(np.diagonal(R) * signs < 0.0, -1.0, 1.0)[:, None]

    rng = np.random.default_rng(0)
    R, rows = (
        np.triu(rng.normal(size=(11, 11))),
        rng.normal(size=(3 * _ROWS + 5, 11)),
    )
    found = extended(R, rows)
    truth = reference(np.array(R, order="F"), np.array(rows, order="F"))
    if abs(found - truth).max() <= _ALIKE * abs(truth).max():
        return extended
    _log.debug("compiled QR differs from LAPACK's: not used")
    return None


def _aligned(size: int) -> Vector:
    """Return room for numbers that begins at a line of the cache."""
    room = np.empty(size + _LINE // 8)
    return room[-room.ctypes.data % _LINE // 8 :]
