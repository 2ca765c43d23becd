"""Mass matrices by composite bodies, several poses in each of the processor's steps.

The same as `mass_matrix_entries`, of any robot: joints and bodies are numbers that the
code is given, so that it is compiled once for each machine.  As in `triangle`, what is
used depends on the number of poses and on the machine alone.
"""

import ctypes
from collections.abc import Callable
from functools import lru_cache
from threading import Lock
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, IntArray
from consistent_id.regression.compiled.compiler import compiled, loaded, switched_on

LEAST = 2048
"""Poses from which on compiled code is used: fewer need not wait for a compiler."""

_NAME = "masses"
_ALIKE = 1e-12  # relative difference to NumPy's numbers that compiled code may have
_OPTIONS = ("-O2", "-ffp-contract=fast")
_LANES = 8  # poses that one pass of the code computes
_WORK = 28  # numbers that it keeps of each joint and pose

_SOURCE = (
    f"enum {{ LANES = {_LANES}, WORK = {_WORK} }};"
    + """
typedef double lane __attribute__((vector_size(8 * LANES), aligned(8)));
#define AT(x) (*(lane *)(x))

static const int PAIRS[6][2] = {{0, 0}, {1, 1}, {2, 2}, {0, 1}, {0, 2}, {1, 2}};
static const int SYMMETRIC[3][3] = {{0, 3, 4}, {3, 1, 5}, {4, 5, 2}};

/* What is known of a joint at some poses: its link's rotation R (by rows) and origin p,
   its twist (e, v), and mass, first and second moments of all that it moves. */
typedef struct { lane R[9], p[3], e[3], v[3], m, h[3], S[6]; } state;

static inline lane dot(const lane *a, const lane *b)
{
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline void add_cross(lane *to, const lane *a, const lane *b)
{
  for (int i = 0; i < 3; i++) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    to[i] += a[j] * b[k] - a[k] * b[j];
  }
}

/* Place a link: g holds the parts of its pose [R p] in its parent's axes that are
   constant and that go with sine, cosine and position, then the axis in its own. */
static void place(state *x, const state *parent, const double *g, const double *q,
                  long count, int slides)
{
  lane own[12];
  for (int i = 0; i < 12; i++)
    own[i] = g[i] + g[12 + i] * AT(q + count) + g[24 + i] * AT(q + 2 * count)
      + g[36 + i] * AT(q);
  for (int i = 0; i < 3; i++) {
    for (int j = 0; j < 3; j++)
      x->R[3 * i + j] = parent ? parent->R[3 * i] * own[j]
        + parent->R[3 * i + 1] * own[3 + j] + parent->R[3 * i + 2] * own[6 + j]
        : own[3 * i + j];
    x->p[i] = parent ? parent->p[i] + dot(parent->R + 3 * i, own + 9) : own[9 + i];
  }
  for (int i = 0; i < 3; i++) {
    const lane axis = x->R[3 * i] * g[48] + x->R[3 * i + 1] * g[49]
      + x->R[3 * i + 2] * g[50];
    x->e[i] = slides ? (lane){0} : axis;
    x->v[i] = slides ? axis : (lane){0};
  }
  add_cross(x->v, x->p, x->e);
}

/* Move a body's mass, first and second moments to the base. */
static void load(state *x, const double *body)
{
  lane half[9], w[3];
  x->m = (lane){0} + body[0];
  for (int i = 0; i < 3; i++) {
    const lane *R = x->R + 3 * i;
    const lane h = R[0] * body[1] + R[1] * body[2] + R[2] * body[3];
    x->h[i] = h + x->m * x->p[i];
    w[i] = h + 0.5 * x->m * x->p[i];
    for (int j = 0; j < 3; j++)
      half[3 * i + j] = R[0] * body[4 + SYMMETRIC[0][j]]
        + R[1] * body[4 + SYMMETRIC[1][j]] + R[2] * body[4 + SYMMETRIC[2][j]];
  }
  for (int k = 0; k < 6; k++) {
    const int i = PAIRS[k][0], j = PAIRS[k][1];
    x->S[k] = dot(x->R + 3 * i, half + 3 * j) + w[i] * x->p[j] + w[j] * x->p[i];
  }
}

void masses(const long *parents, const long *slides, const double *joints,
            const double *bodies, const double *positions, double *work, double *out,
            long links, long count)
{
  state *const states = (state *)work;
  for (long start = 0; start < count; start += LANES) {
    /* The last pass repeats poses of the one before, instead of a shorter one. */
    const long s = start + LANES <= count ? start : count - LANES;
    for (long k = 0; k < links; k++) {
      state *const x = states + k;
      place(x, parents[k] < 0 ? 0 : states + parents[k], joints + 51 * k,
            positions + 3 * k * count + s, count, slides[k]);
      load(x, bodies + 10 * k);
    }
    double *to = out + s;
    for (long j = links - 1; j >= 0; j--) {
      const state *const x = states + j;
      lane n[3], f[3];
      const lane trace = x->S[0] + x->S[1] + x->S[2];
      for (int i = 0; i < 3; i++) {
        n[i] = trace * x->e[i];
        for (int k = 0; k < 3; k++)
          n[i] -= x->S[SYMMETRIC[i][k]] * x->e[k];
        f[i] = x->m * x->v[i];
      }
      add_cross(n, x->h, x->v);
      add_cross(f, x->e, x->h);
      for (long i = j; i >= 0; i = parents[i], to += count)
        AT(to) = dot(states[i].e, n) + dot(states[i].v, f);
      if (parents[j] < 0)
        continue;
      state *const behind = states + parents[j];
      behind->m += x->m;
      for (int i = 0; i < 3; i++)
        behind->h[i] += x->h[i];
      for (int i = 0; i < 6; i++)
        behind->S[i] += x->S[i];
    }
  }
}
"""
)

_lock = Lock()


class Tree(NamedTuple):
    """Joints as the code takes them, those before others that they carry.

    Parameters
    ----------
    parents : ndarray, shape (joints,)
        Places of the joints that carry them; -1 for the base.
    slides : ndarray, shape (joints,)
        One for joints that slide, else zero.
    parts : ndarray, shape (joints, 4, 12)
        Rotation by rows, then origin, of the link in its parent's axes: what is
        constant, and what goes with sine, cosine and position.
    axes : ndarray, shape (joints, 3)
        In the link's own axes.
    """

    parents: IntArray
    slides: IntArray
    parts: Array
    axes: Array

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """``(i, j)``, ``i`` on the way from the base to ``j``, in the code's order."""
        found = []
        for j in reversed(range(len(self.parents))):
            i = j
            while i >= 0:
                found.append((i, j))
                i = int(self.parents[i])
        return found


MassEntries = Callable[[Tree, Array, Array], Array]
"""Entries of `Tree.pairs`, shape (pairs, poses), of a tree, the moments of its links,
shape (joints, 10), and ``q, sin q, cos q``, shape (joints, 3, poses)."""


def mass_entries(poses: int, reference: MassEntries) -> MassEntries:
    """Return what computes the entries of so many poses.

    It is the `reference` where poses are few, or nothing compiled agrees with it.
    Moments are ``m, hx, hy, hz`` and second ones ``xx, yy, zz, xy, xz, yz``.
    """
    if poses < LEAST or not switched_on():
        return reference
    with _lock:
        return _found(reference) or reference


@lru_cache(maxsize=1)
def _found(reference: MassEntries) -> MassEntries | None:
    function = loaded(_SOURCE, _NAME, _OPTIONS) or compiled(_SOURCE, _NAME, _OPTIONS)
    if function is None:
        return None

    def entries(tree: Tree, moments: Array, positions: Array) -> Array:
        links, _, count = positions.shape
        flat = tree.parts.reshape(links, 48)
        arrays = (
            tree.parents.astype(np.int_),
            tree.slides.astype(np.int_),
            np.hstack([flat, tree.axes]),
            np.ascontiguousarray(moments, dtype=np.float64),
            np.ascontiguousarray(positions, dtype=np.float64),
            np.empty(_WORK * _LANES * links),
            np.empty((len(tree.pairs), count)),
        )
        function(
            *(ctypes.c_void_p(array.ctypes.data) for array in arrays),
            ctypes.c_long(links),
            ctypes.c_long(count),
        )
        return arrays[-1]

    rng = np.random.default_rng(0)
    tree = Tree(
        np.array([-1, 0, 1, 0, -1]),
        np.array([0, 1, 0, 0, 1]),
        rng.normal(size=(5, 4, 12)),
        rng.normal(size=(5, 3)),
    )
    case = tree, rng.normal(size=(5, 10)), rng.normal(size=(5, 3, 3 * _LANES + 1))
    truth = reference(*case)
    return (
        entries
        if abs(entries(*case) - truth).max() <= _ALIKE * abs(truth).max()
        else None
    )
