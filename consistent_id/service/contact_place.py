"""Where an arm is touched and how hard, from the torque that the force causes.

A force `F` at a point of link `k` causes ``tau = J_k(q)^T F``, on that link's joint and
those before it.  Among points along the links, the one that explains the torque best is
found, with the force there [Haddadin2017]_.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    IntArray,
    Matrix,
    Vector,
    checked,
)
from consistent_id.errors import ProblemError
from consistent_id.robot.kinematics import ancestors, link_places
from consistent_id.robot.model import RobotModel

POINTS = 11  # on each line between two joints of a link
RADIUS = 0.05  # m, of the links
_CLOSE = 3.84  # 95 % of chi-squared with one degree of freedom: the place on the arm
_SHORT = 1e-6  # m; a shorter line is its first point
_ROUNDS = 3  # in which the torque of the force's unknown lever settles
_SHORT_STEP = 1e-3  # m of line that a single point stands for
_DRAWN = 4000  # forces from which the interval of their size is taken
_OPEN = 1e-8  # of the largest eigenvalue: a direction that the torque does not show


@dataclass(frozen=True, slots=True, eq=False)
class ContactPlace:
    """A force on a link, found from torque from outside.

    Attributes
    ----------
    link : str
        Link whose line has the point that explains the torque best.
    possible : tuple of str
        Links with points that explain it nearly as well (95 %).
    point : ndarray, shape (3,), [m]
        In the base frame.
    force : ndarray, shape (3,), [N]
        In the base frame.
    covariance : ndarray, shape (3, 3), [N^2]
        Covariance of the force: by the torque's covariance, and by the points that are
        possible.
    strengths : tuple of float, [N]
        95 % interval of `strength`: from zero to infinity if no direction is known.
        With open directions it is the known part's; the whole force may be larger.
    open_directions : ndarray, shape (directions, 3)
        Unit vectors along which a force at the point causes no torque; the force along
        them is not known and given as zero.
    misfit : float
        Squared, weighted torque that the force does not explain.
    freedom : int
        Its degrees of freedom; the misfit of a single force is about as large.
    """

    link: str
    possible: tuple[str, ...]
    point: Vector
    force: Vector
    covariance: Matrix
    strengths: tuple[float, float]
    open_directions: Matrix
    misfit: float
    freedom: int

    @property
    def strength(self) -> float:
        """Size of the force [N]."""
        return float(np.linalg.norm(self.force))

    @property
    def strength_error(self) -> float:
        """Standard error of `strength` [N], as if it were normally distributed.

        Several possible places make it too small: `strengths` counts them all.  It is
        infinite if no direction of the force is known.  With open directions,
        `strength` is the size of the known part.
        """
        if len(self.open_directions) == 3:
            return np.inf
        along = self.force / max(self.strength, 1e-12)
        return float(np.sqrt(along @ self.covariance @ along))


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """Points along the links: link, place, Jacobian, axes of the joints that move it.

    Shapes (points,), (points, 3), (points, 3, joints), (points, joints, 3); `steps` are
    the distances to the next points, (points,).
    """

    link: IntArray
    place: Array
    jacobian: Array
    axes: Array
    steps: Vector


def contact_place(
    robot: RobotModel,
    q: ArrayLike,
    external: ArrayLike,
    covariance: ArrayLike,
    *,
    radius: float = RADIUS,
) -> ContactPlace:
    """Return the place and the force; see `MomentumObserver.place`.

    Raises
    ------
    ProblemError
        If the covariance is not positive definite, the base floats, or joints follow
        others.
    """
    n = len(robot)
    _require_arm(robot)
    if not radius >= 0.0:
        raise ProblemError(f"the links' radius is {radius} m, expected 0 or more")
    pose = checked(q, (n,), "positions")
    torque = checked(external, (n,), "torque from outside")
    spread = checked(covariance, (n, n), "covariance of the torque")
    least = float(np.linalg.eigvalsh(0.5 * (spread + spread.T))[0])
    if least <= 0.0:
        raise ProblemError(
            f"the covariance of the torque has the eigenvalue {least:.3g}, expected "
            "positive ones; `ContactDetector.covariance` is one"
        )
    points = _points(robot, pose)
    # The force acts on the surface, and between two points: by how far is not known.
    aside = 0.5 * radius**2 + points.steps**2 / 12.0
    spreads = np.broadcast_to(spread, (len(aside), n, n))
    for _ in range(_ROUNDS):
        force, inverse, known, misfit, score = _fitted(points.jacobian, torque, spreads)
        lever = np.cross(force[:, None], points.axes)
        spreads = spread + aside[:, None, None] * lever @ lever.transpose(0, 2, 1)
    best = int(score.argmin())
    close = np.flatnonzero(score - score[best] < _CLOSE)
    # Each possible point counts by its likelihood.
    shares = np.exp(0.5 * (score[best] - score[close]))
    apart = force[close] - force[best]
    between = np.einsum("c,ci,cj->ij", shares / shares.sum(), apart, apart)
    vectors = np.linalg.eigh(inverse[best])[1]
    names = [robot.link_names[k] for k in points.link[close]]
    return ContactPlace(
        link=robot.link_names[points.link[best]],
        possible=tuple(dict.fromkeys(names)),
        point=points.place[best],
        force=force[best],
        covariance=inverse[best] + between,
        strengths=_strengths(force, inverse, known, score, points.steps),
        open_directions=vectors[:, : 3 - known[best]].T,
        misfit=float(misfit[best]),
        freedom=n - int(known[best]),
    )


def _require_arm(robot: RobotModel) -> None:
    """Refuse a robot whose base floats, or some of whose joints follow others."""
    if robot.floating:
        raise ProblemError(
            f"the base of {robot.name!r} floats; a contact is placed on robots whose "
            "base stands still"
        )
    if len(robot.joints) != len(robot):
        raise ProblemError(
            f"joints of {robot.name!r} follow others; contacts are not placed on such "
            "robots: lock these joints"
        )


def _strengths(
    force: Array, inverse: Array, known: IntArray, score: Vector, steps: Vector
) -> tuple[float, float]:
    """Return the 95 % interval of the force's size, over all points.

    A point counts by its length of line and by the likelihood of all forces there;
    before the torque is seen, all sizes and all directions are as likely.
    """
    if not known.any():
        return 0.0, np.inf
    values, axes = np.linalg.eigh(inverse)
    values = np.maximum(values, 0.0)
    shown = np.arange(3) >= 3 - known[:, None]
    volume = np.log(np.where(shown, values, 1.0)).sum(axis=1)
    chance = np.maximum(steps, _SHORT_STEP) * np.exp(
        0.5 * ((volume - score) - (volume - score).max())
    )
    rng = np.random.default_rng(0)  # the same interval for the same torque
    drawn = rng.choice(len(chance), _DRAWN, p=chance / chance.sum())
    normal = np.sqrt(values[drawn]) * rng.normal(size=(_DRAWN, 3))
    sizes = np.linalg.norm(
        force[drawn] + np.einsum("nij,nj->ni", axes[drawn], normal), axis=1
    )
    order = np.argsort(sizes)
    # All sizes are as likely: of forces in a plane or in space, a shell has its radius,
    # or the square of it.
    shell = np.maximum(sizes, 1e-12) ** (1.0 - known[drawn])
    share = np.cumsum(shell[order])
    low, high = np.interp([0.025, 0.975], share / share[-1], sizes[order])
    return float(low), float(high)


def _points(robot: RobotModel, pose: Vector) -> _Points:
    """Return points along the links."""
    places = link_places(robot, pose[None])
    turned, origin, axis = places.rotation[0], places.translation[0], places.axis[0]
    links, ends, steps = [], [], []
    for link in range(len(robot)):
        for end in _ends(robot, link):
            line = np.linspace(0.0, 1.0, POINTS)[:, None] * end
            links += [link] * POINTS
            ends.append(origin[link] + line @ turned[link].T)
            steps += [float(np.linalg.norm(end)) / (POINTS - 1)] * POINTS
    place = np.concatenate(ends)
    jacobian = np.zeros((len(place), 3, len(robot)))
    axes = np.zeros((len(place), len(robot), 3))
    for k, link in enumerate(links):
        for j in ancestors(robot, link):
            slides = robot.joints[j].kind == "prismatic"
            arm = np.cross(axis[j], place[k] - origin[j])
            jacobian[k, :, j] = axis[j] if slides else arm
            axes[k, j] = 0.0 if slides else axis[j]
    return _Points(np.array(links), place, jacobian, axes, np.array(steps))


def _ends(robot: RobotModel, link: int) -> list[Vector]:
    """Return where a link's lines end, in its frame: next joints, or fixed frames."""
    ends = [joint.translation for joint in robot.joints if joint.parent == link]
    if not ends:
        ends = [frame.translation for frame in robot.links[link].merged]
    if any(np.linalg.norm(end) > _SHORT for end in ends):
        return [end for end in ends if np.linalg.norm(end) > _SHORT]
    body = robot.links[link].nominal
    if ends or body is None:
        return [*ends[:1]] or [np.zeros(3)]
    return [2.0 * body.com]


def _fitted(
    jacobian: Array, torque: Vector, spreads: Array
) -> tuple[Array, Array, IntArray, Vector, Vector]:
    """Return forces, covariances, numbers of known directions, misfits, scores.

    A score is a misfit less twice the logarithm of the whitening's determinant, which
    makes misfits of different spreads comparable.
    """
    root = np.linalg.inv(np.linalg.cholesky(spreads))  # whitens
    rows = root @ jacobian.transpose(0, 2, 1)
    white = root @ torque
    values, vectors = np.linalg.eigh(rows.transpose(0, 2, 1) @ rows)
    known = values > _OPEN * np.maximum(values[:, -1:], 1e-300)
    scale = np.where(known, 1.0 / np.where(known, values, 1.0), 0.0)
    inverse = (vectors * scale[:, None]) @ vectors.transpose(0, 2, 1)
    force = np.einsum("cij,ckj,ck->ci", inverse, rows, white)
    rest = white - np.einsum("cki,ci->ck", rows, force)
    misfit = (rest**2).sum(axis=1)
    score = misfit - 2.0 * np.log(np.linalg.det(root))
    return force, inverse, known.sum(axis=1), misfit, score
