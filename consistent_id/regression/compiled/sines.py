"""Sine and cosine of many angles at once, several in each of the processor's steps.

NumPy calls the mathematical library angle by angle.  Here quarter turns are taken off
in two parts, after [Cody1980]_, and polynomials of FDLIBM do the rest: both results
come within 2e-16 of the exact ones.  As in `triangle`, what is used depends on the
number of angles and on the machine alone.
"""

import ctypes
from collections.abc import Callable
from functools import lru_cache
from threading import Lock

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id.regression.compiled.compiler import compiled, loaded, switched_on

LEAST = 2048
"""Angles from which on compiled code is used: fewer need not wait for a compiler."""

_NAME = "sines"
_ALIKE = 1e-15  # difference to NumPy's numbers that compiled code may have

_SOURCE = """\
enum { LANES = 8 };
typedef double lane __attribute__((vector_size(8 * LANES), aligned(8)));
typedef long long bits __attribute__((vector_size(8 * LANES), aligned(8)));
#define ALL(x) ((lane){0} + (x))
#define WHERE(mask, a, b) ((lane)(((bits)(a) & (mask)) | ((bits)(b) & ~(mask))))

/* Return 0 if an angle is so large, or not finite, that its quarter turns are lost. */
int sines(const double *x, double *sine, double *cosine, long count)
{
  const lane shift = ALL(0x1.8p52);
  bits lost = {0};
  for (long start = 0; start < count; start += LANES) {
    const long s = start + LANES <= count ? start : count - LANES;
    const lane angle = *(const lane *)(x + s);
    lost |= ~((angle < ALL(0x1p20)) & (angle > ALL(-0x1p20)));
    const lane shifted = angle * ALL(0x1.45f306dc9c883p-1) + shift;
    const bits turns = (bits)shifted;
    const lane n = shifted - shift;
    /* The first part of a quarter turn has 33 digits: its product is exact. */
    const lane r = (angle - n * ALL(0x1.921fb544p0)) - n * ALL(0x1.0b4611a626331p-34);
    const lane z = r * r, half = ALL(0.5) * z, w = ALL(1.0) - half;
    const lane u = r + r * z * (ALL(-0x1.5555555555549p-3)
      + z * (ALL(0x1.111111110f8a6p-7) + z * (ALL(-0x1.a01a019c161d5p-13)
      + z * (ALL(0x1.71de357b1fe7dp-19) + z * (ALL(-0x1.ae5e68a2b9cebp-26)
      + z * ALL(0x1.5d93a5acfd57cp-33))))));
    const lane v = w + (((ALL(1.0) - w) - half) + z * z * (ALL(0x1.555555555554cp-5)
      + z * (ALL(-0x1.6c16c16c15177p-10) + z * (ALL(0x1.a01a019cb1590p-16)
      + z * (ALL(-0x1.27e4f809c52adp-22) + z * (ALL(0x1.1ee9ebdb4b1c4p-29)
      + z * ALL(-0x1.8fae9be8838d4p-37)))))));
    const bits odd = (turns & 1) != 0;
    *(lane *)(sine + s) = (lane)((bits)WHERE(odd, v, u) ^ ((turns & 2) << 62));
    *(lane *)(cosine + s) = (lane)((bits)WHERE(odd, u, v) ^ (((turns + 1) & 2) << 62));
  }
  long long any = 0;
  for (int i = 0; i < LANES; i++)
    any |= lost[i];
  return any == 0;
}
"""

_lock = Lock()


def sine_and_cosine(x: Array, out: Array | None = None) -> Array:
    """Return sine and cosine of angles.

    Parameters
    ----------
    x : ndarray, shape (angles,), [rad]
    out : ndarray, shape (2, angles), optional
        Room for them, each side by side.
    """
    out = np.empty((2, len(x))) if out is None else out
    if len(x) >= LEAST and switched_on():
        with _lock:
            found = _found()
        if found is not None and found(x, out):
            return out
    np.sin(x, out=out[0])
    np.cos(x, out=out[1])
    return out


@lru_cache(maxsize=1)
def _found() -> Callable[[Array, Array], bool] | None:
    """Return what computes both, and says whether no angle was too large."""
    function = loaded(_SOURCE, _NAME) or compiled(_SOURCE, _NAME)
    if function is None:
        return None

    def both(x: Array, out: Array) -> bool:
        x = np.ascontiguousarray(x, dtype=np.float64)
        given = (ctypes.c_void_p(row.ctypes.data) for row in (x, *out))
        return bool(function(*given, ctypes.c_long(len(x))))

    x = np.concatenate([np.linspace(-50.0, 50.0, 9973), np.arange(-9, 9) * np.pi])
    found = np.empty((2, len(x)))
    alike = both(x, found) and abs(found - [np.sin(x), np.cos(x)]).max() <= _ALIKE
    return both if alike else None
