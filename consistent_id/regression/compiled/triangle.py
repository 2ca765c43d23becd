"""Householder's QR of rows below a triangle, on blocks that stay in the cache.

LAPACK's `tpqrt` passes over all rows for each few columns.  Here a block of rows is
eliminated before the next one is touched, and the column that eliminates others stays
in the processor's registers: `benchmarks/compiled.py` measures what that saves.

Which of both is used depends on the rows' number and on the machine, never on what was
computed before; so bits do not depend on how work is divided among processes.
"""

import ctypes
import logging
from collections.abc import Callable
from functools import lru_cache
from threading import Lock

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.regression.compiled.compiler import compiled, loaded, switched_on

LEAST = 2048
"""Rows from which on compiled code is used: fewer need not wait for a compiler."""

_NAME = "extend"
_LARGEST = 128  # rows of a block, on the processors with the most registers
_ALIKE = 1e-12  # relative difference to LAPACK's numbers that compiled code may have
_FASTER = "-O3"  # unrolled, or else no column stays in registers

_SOURCE = """\
#if defined __AVX512F__
enum { WIDTH = 8, HEIGHT = 16 };
#elif defined __AVX__
enum { WIDTH = 4, HEIGHT = 8 };
#else
enum { WIDTH = 2, HEIGHT = 8 };
#endif
enum { ROWS = WIDTH * HEIGHT, SIDE = 4 };
typedef double lane __attribute__((vector_size(8 * WIDTH), aligned(8)));
#define AT(column, i) (*(lane *)((column) + (i) * WIDTH))

/* Reflect columns of a block and the entries r of the triangle's row above them. */
#define REFLECT(count)                                                        \\
  {                                                                           \\
    lane dot[count] = {{0}};                                                  \\
    for (int i = 0; i < HEIGHT; i++)                                          \\
      for (int c = 0; c < count; c++)                                         \\
        dot[c] += v[i] * AT(b + c * ROWS, i);                                 \\
    for (int c = 0; c < count; c++) {                                         \\
      double sum = r[c];                                                      \\
      for (int i = 0; i < WIDTH; i++)                                         \\
        sum += dot[c][i];                                                     \\
      const double t = tau * sum;                                             \\
      r[c] -= t;                                                              \\
      for (int i = 0; i < HEIGHT; i++)                                        \\
        AT(b + c * ROWS, i) -= t * v[i];                                      \\
    }                                                                         \\
  }

/* Eliminate a block, column by column, into the triangle R (row by row). */
static void eliminate(double *R, double *block, long width)
{
  for (long k = 0; k < width; k++) {
    lane v[HEIGHT], squares = {0};
    for (int i = 0; i < HEIGHT; i++) {
      v[i] = AT(block + k * ROWS, i);
      squares += v[i] * v[i];
    }
    double below = 0;
    for (int i = 0; i < WIDTH; i++)
      below += squares[i];
    if (below == 0)
      continue;
    const double head = R[k * width + k];
    const double norm = __builtin_sqrt(head * head + below);
    const double beta = head < 0 ? norm : -norm;
    const double tau = (beta - head) / beta, scale = 1 / (head - beta);
    for (int i = 0; i < HEIGHT; i++)
      v[i] *= scale;
    R[k * width + k] = beta;
    long j = k + 1;
    for (; j + SIDE <= width; j += SIDE) {
      double *b = block + j * ROWS, *r = R + k * width + j;
      REFLECT(SIDE)
    }
    for (; j < width; j++) {
      double *b = block + j * ROWS, *r = R + k * width + j;
      REFLECT(1)
    }
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
    function = loaded(_SOURCE, _NAME, _FASTER) or compiled(_SOURCE, _NAME, _FASTER)
    if function is None:
        return None

    def extended(R: Matrix, rows: Matrix) -> Matrix:
        signs = np.where(np.diagonal(R) < 0.0, 1.0, -1.0)  # LAPACK's
        R, rows = np.array(R, order="C"), np.asfortranarray(rows)
        height, width = rows.shape
        block = np.empty((width, _LARGEST))
        function(
            *(ctypes.c_void_p(x.ctypes.data) for x in (R, rows, block)),
            *(ctypes.c_long(number) for number in (width, height)),
        )
        return R * np.where(np.diagonal(R) * signs < 0.0, -1.0, 1.0)[:, None]

    rng = np.random.default_rng(0)
    R, rows = (
        np.triu(rng.normal(size=(11, 11))),
        rng.normal(size=(3 * _LARGEST + 5, 11)),
    )
    found = extended(R, rows)
    truth = reference(np.array(R, order="F"), np.array(rows, order="F"))
    if abs(found - truth).max() <= _ALIKE * abs(truth).max():
        return extended
    _log.debug("compiled QR differs from LAPACK's: not used")
    return None
