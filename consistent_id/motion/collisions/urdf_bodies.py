"""Bodies from a URDF: its collision shapes, or visual ones where it has no others.

A mesh is replaced by its hull, or cut into a few convex pieces. A forearm with a wrist
at its end is much smaller than its hull.  If it is cut by planes, the hulls of the
pieces still cover the body, since each cross-section lies in the hull of its rim, but
their volume is smaller.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.errors import ModelError, ProblemError
from consistent_id.motion.collisions.bodies import (
    Body,
    Box,
    Capsule,
    Cylinder,
    Hull,
    Shape,
    Sphere,
)
from consistent_id.robot.loaders.urdf_in_place import rotation_of
from consistent_id.robot.loaders.urdf_lint import read_bytes
from consistent_id.robot.loaders.xml import Element, XmlFault, parse
from consistent_id.robot.solids import mesh_triangles

Elements = Literal["collision", "visual"]

_PLACES = np.arange(1, 8) / 8.0  # positions on an axis of the bounding box for cuts
_MASSLESS = 0.02  # [kg]; a link with less that has no shape is a frame
_ENOUGH = 1500  # triangles by which cuts are chosen; the pieces have all of them


def urdf_bodies(
    path: Path,
    package_dirs: Iterable[str | Path] = (),
    elements: Elements = "collision",
    pieces: int = 1,
) -> tuple[Body, ...]:
    """Return the shapes of a URDF's links; meshes as their convex hulls.

    For a link without shapes of the required kind, those of the other kind are read: a
    coarse or large shape is better than none.

    Parameters
    ----------
    package_dirs : iterable of str or Path
        Folders in which ``package://name/...`` is looked for as ``name/...``.  So are
        the folders above the file.
    elements : {"collision", "visual"}
    pieces : int
        Most convex pieces of a mesh.

    Raises
    ------
    ModelError
        If the file, or a mesh, cannot be read, or a shape is unknown; with the line.
    """
    shapes = urdf_shapes(path, package_dirs, elements, pieces)
    if shapes.unread:
        raise shapes.unread[0].cause
    return shapes.bodies


@dataclass(frozen=True, slots=True)
class UnreadLink:
    """A link whose shapes cannot be read.

    Parameters
    ----------
    name : str
    cause : ModelError
        With the file and the line.
    reason : str
        The same without them.
    """

    name: str
    cause: ModelError
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class UrdfShapes:
    """The shapes of a URDF.

    Parameters
    ----------
    root : Element
        Root of the file.
    bodies : tuple of Body
    unread : tuple of UnreadLink
    bare : tuple of (str, str)
        Links that have a mass and no shape, and the sentence that says so.
    """

    root: Element
    bodies: tuple[Body, ...]
    unread: tuple[UnreadLink, ...]
    bare: tuple[tuple[str, str], ...]


def urdf_shapes(
    path: Path,
    package_dirs: Iterable[str | Path] = (),
    elements: Elements = "collision",
    pieces: int = 1,
) -> UrdfShapes:
    """Return the shapes of a URDF's links, and the links whose shapes are unknown.

    See `urdf_bodies` for the parameters.

    Raises
    ------
    ModelError
        If the file cannot be read.
    """
    if elements not in ("collision", "visual"):
        raise ModelError(f"elements {elements!r}: expected 'collision' or 'visual'")
    folders = [Path(folder) for folder in package_dirs] + list(path.absolute().parents)
    root = urdf_root(path)
    bodies: list[Body] = []
    unread, bare = [], []
    for link in root.all("link"):
        try:
            found = link_bodies(path, link, folders, elements, pieces)
        except ModelError as cause:
            reason = str(cause).partition(f"link {link.name!r}: ")[2] or str(cause)
            unread.append(UnreadLink(link.name, cause, reason))
            continue
        bodies += found
        mass = _mass(link)
        if not found and mass > _MASSLESS:
            bare.append((link.name, f"no shape, though its mass is {mass:.3g} kg"))
    return UrdfShapes(root, tuple(bodies), tuple(unread), tuple(bare))


def _mass(link: Element) -> float:
    inertial = link.child("inertial")
    mass = None if inertial is None else inertial.child("mass")
    return 0.0 if mass is None else float(mass.attributes.get("value", "0"))


def has_collision_shapes(path: Path) -> bool:
    """Return whether any link of a URDF has a ``<collision>``."""
    links = urdf_root(path).all("link")
    return any(link.child("collision") is not None for link in links)


def urdf_root(path: Path) -> Element:
    """Return the root element of a URDF file.

    Raises
    ------
    ModelError
        If the file cannot be read.
    """
    try:
        return parse(read_bytes(path))
    except XmlFault as fault:
        raise ModelError(f"{path}, {fault}") from None


def link_bodies(
    path: Path,
    link: Element,
    folders: Sequence[Path] | None = None,
    elements: Elements = "collision",
    pieces: int = 1,
) -> tuple[Body, ...]:
    """Return the shapes of one link; see `urdf_bodies`.

    Packages are searched for in `folders`, by default those above the file.
    """
    folders = list(path.absolute().parents) if folders is None else list(folders)
    other = "visual" if elements == "collision" else "collision"
    bodies: list[Body] = []
    found: list[tuple[Shape, Element]] = []
    for element in list(link.all(elements)) or list(link.all(other)):
        with _naming(f"{path}, line {element.line}: link {link.name!r}"):
            shapes = _shapes(element, path, folders, pieces)
            found += [(shape, element) for shape in shapes]
    for k, (shape, element) in enumerate(found):
        name = link.name if len(found) == 1 else f"{link.name}:{k + 1}"
        with _naming(f"{path}, line {element.line}: link {link.name!r}"):
            bodies.append(Body(name, shape, link.name, *_origin(element)))
    return tuple(bodies)


@contextmanager
def _naming(where: str) -> Iterator[None]:
    """Add the position in the file to errors."""
    try:
        yield
    except (ModelError, ProblemError) as cause:
        raise ModelError(f"{where}: {cause}") from None


def _shapes(
    element: Element, path: Path, folders: list[Path], pieces: int
) -> list[Shape]:
    geometry = element.child("geometry")
    if geometry is None or not geometry.children:
        raise ModelError(f"<{element.tag}> has no shape")
    shape = geometry.children[0]
    if shape.tag == "mesh":
        name = shape.attributes.get("filename", "")
        scale = _numbers(shape, "scale", 3, "1 1 1")
        triangles = mesh_triangles(_found(name, path, folders)) * scale
        return [Hull(points) for points in convex_pieces(triangles, pieces)]
    if shape.tag not in _PRIMITIVES:
        known = ", ".join(("mesh", *_PRIMITIVES))
        raise ModelError(f"shape <{shape.tag}>, expected one of {known}")
    return [_PRIMITIVES[shape.tag](shape)]


def _origin(element: Element) -> tuple[Matrix, Vector]:
    origin = element.child("origin") or Element("origin", {}, element.line)
    angles = _numbers(origin, "rpy", 3, "0 0 0")
    return rotation_of(angles.tolist()), _numbers(origin, "xyz", 3, "0 0 0")


def _box(shape: Element) -> Shape:
    x, y, z = _numbers(shape, "size", 3).tolist()
    return Box((x, y, z))


def _round(kind: Callable[[float, float], Shape]) -> Callable[[Element], Shape]:
    def made(shape: Element) -> Shape:
        radius, length = (
            _numbers(shape, key, 1).item() for key in ("radius", "length")
        )
        return kind(radius, length)

    return made


_PRIMITIVES: dict[str, Callable[[Element], Shape]] = {
    "box": _box,
    "sphere": lambda shape: Sphere(_numbers(shape, "radius", 1).item()),
    "cylinder": _round(Cylinder),
    "capsule": _round(Capsule),
}


def _found(name: str, path: Path, folders: list[Path]) -> Path:
    """Return the file of a mesh, whose name may begin with a scheme."""
    scheme, separator, rest = name.rpartition("://")
    if not separator or scheme == "file":
        places = [path.parent / rest]
    else:
        package, _, inside = rest.partition("/")
        places = [folder / rest for folder in folders]
        places += [folder / inside for folder in folders if folder.name == package]
    for place in places:
        if place.is_file():
            return place
    above = set(path.absolute().parents)
    given = [str(folder) for folder in folders if folder not in above]
    looked = ", ".join([*given, "the folders above the file"])
    raise ModelError(
        f"mesh {name!r} was not found in {looked if separator else path.parent}; give "
        "the folder that contains its package in package_dirs (--package-dirs)"
    )


def _numbers(
    element: Element, name: str, count: int, default: str | None = None
) -> Vector:
    text = element.attributes.get(name, default)
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all():
        numbers = "a number" if count == 1 else f"{count} numbers"
        raise ModelError(f"<{element.tag}> has {name} {text!r}, expected {numbers}")
    return values


def convex_pieces(triangles: Array, most: int, gain: float = 0.1) -> list[Array]:
    """Return point sets whose convex hulls together cover a mesh.

    The cut, perpendicular to an axis, that saves most volume is made first; the cutting
    ends when no cut saves `gain` of the first hull's volume.

    Parameters
    ----------
    triangles : ndarray, shape (triangles, 3, 3), [m]
        Corners of the faces of a closed surface.
    most : int
        Largest number of pieces.
    """
    if most < 1:
        raise ProblemError(f"pieces: {most} at most, expected 1 or more")
    pieces = [np.asarray(triangles, dtype=np.float64)]
    if most == 1:
        return [triangles.reshape(-1, 3)]
    whole = _volume(triangles.reshape(-1, 3))
    cuts = [_best_cut(pieces[0])]
    while len(pieces) < most:
        k = int(np.argmax([cut[0] for cut in cuts]))
        saved, axis, height = cuts[k]
        if saved < gain * whole:
            break
        parts = _below(pieces[k], axis, height), -_below(-pieces[k], axis, -height)
        pieces[k : k + 1] = parts
        cuts[k : k + 1] = [_best_cut(part) for part in parts]
    return [piece.reshape(-1, 3) for piece in pieces]


def _best_cut(triangles: Array) -> tuple[float, int, float]:
    """Volume saved by the best plane, its axis and its place on that axis.

    For fine meshes, it is computed from some of the triangles.
    """
    triangles = triangles[:: 1 + len(triangles) // _ENOUGH]
    whole = _volume(triangles.reshape(-1, 3))
    best = (0.0, 0, 0.0)
    for axis, height in _planes(triangles):
        parts = (
            _volume(_rim(triangles, axis, height, 1.0)),
            _volume(_rim(triangles, axis, height, -1.0)),
        )
        saved = whole - sum(parts)
        if min(parts) > 0.0 and saved > best[0]:
            best = (saved, axis, height)
    return best


def _planes(triangles: Array) -> Iterator[tuple[int, float]]:
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    for axis in range(3):
        for share in _PLACES:
            yield axis, float(low[axis] + share * (high[axis] - low[axis]))


def _rim(triangles: Array, axis: int, height: float, side: float) -> Array:
    """Points of one side of a plane, and where the edges meet it."""
    start, end = triangles.reshape(-1, 3), np.roll(triangles, -1, axis=1).reshape(-1, 3)
    a, b = start[:, axis] - height, end[:, axis] - height
    cross = a * b < 0.0
    share = (a[cross] / (a[cross] - b[cross]))[:, None]
    met = start[cross] + share * (end[cross] - start[cross])
    return np.concatenate([start[side * a <= 0.0], met])


def _below(triangles: Array, axis: int, height: float) -> Array:
    """Return the part of a surface below a plane, as triangles."""
    under = triangles[:, :, axis] <= height
    count = under.sum(axis=1)
    kept = [triangles[count == 3]]
    for inside in (1, 2):
        cut = triangles[count == inside]
        # The corner that is alone on its side first.
        alone = (under[count == inside] == (inside == 1)).argmax(axis=1)
        order = (alone[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(cut, order[:, :, None], axis=1).transpose(1, 0, 2)
        ab, ac = _met(a, b, axis, height), _met(a, c, axis, height)
        if inside == 1:
            kept.append(np.stack([a, ab, ac], axis=1))
        else:
            kept += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(kept)


def _met(a: Array, b: Array, axis: int, height: float) -> Array:
    share = (height - a[:, axis]) / (b[:, axis] - a[:, axis])
    return np.asarray(a + share[:, None] * (b - a))


def _volume(points: Array) -> float:
    """Volume of the hull of points; 0 if they lie in a plane."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return 0.0
