"""MuJoCo's reading of an MJCF file: files that it names, and unsupported parts.

MuJoCo opens what a file names, whatever it is: a pipe blocks for ever, and a device may
never end.  So `mjcf_elements` looks at these files first.  Meshes and textures that are
only for display may be missing.  `refuse_unsupported` names parts of a model that a
tree of hinges and slides cannot represent.
"""

import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from consistent_id._support.files import require_regular
from consistent_id.errors import ModelError
from consistent_id.robot.loaders.urdf_lint import read_bytes
from consistent_id.robot.loaders.xml import Element, XmlFault, parse

# A tetrahedron; it replaces a missing mesh that is only for display.
_CORNERS = (0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1)
_FACES = (0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3)
_GREY = (0.5, 0.5, 0.5)

# Effects of a tendon on the joints along it, by the arrays of MuJoCo's model.
_PULLS = (
    "stiffness",
    "stiffnesspoly",
    "damping",
    "dampingpoly",
    "frictionloss",
    "armature",
    "limited",
    "actfrclimited",
)
_INCLUDING = ("include", "model")  # elements that name other MJCF files
_FOLDERS = ("assetdir", "meshdir", "texturedir")  # attributes of <compiler>


def mjcf_elements(path: Path) -> tuple[Element, ...]:
    """Return all elements of an MJCF file and of those that it includes.

    Text that is not XML has none; MuJoCo itself reports it.

    Raises
    ------
    ModelError
        If a file is too large, is nested too deeply or has a document type, or if
        anything named in one is a device or a pipe.
    """
    elements: list[Element] = []
    waiting, seen = [path], set[Path]()
    while waiting:
        file = waiting.pop()
        if (place := file.resolve()) in seen:
            continue
        seen.add(place)
        own = tuple(_elements(file))
        elements += own
        for element in own:
            if element.tag in _INCLUDING:
                waiting += _found(element.attributes.get("file", ""), (path, file))
    _require_regular(elements, seen, path)
    return tuple(elements)


def _elements(file: Path) -> Iterator[Element]:
    try:
        root = parse(read_bytes(file))
    except XmlFault as fault:
        if fault.refused:
            raise ModelError(f"{file}, {fault}") from None
        return
    yield root
    yield from root.below()


def _found(name: str, files: tuple[Path, ...]) -> list[Path]:
    """Return the places of a name beside some files at which anything is."""
    places = {file.parent / name for file in files if name}
    return [place for place in sorted(places) if place.exists() and not place.is_dir()]


def _require_regular(elements: list[Element], files: set[Path], path: Path) -> None:
    """Refuse meshes, textures and the like that are no regular files."""
    folders = {
        element.attributes[key]
        for element in elements
        if element.tag == "compiler"
        for key in _FOLDERS
        if key in element.attributes
    }
    beside = {file.parent / folder for file in files for folder in ("", *folders)}
    for element in elements:
        for key, name in element.attributes.items():
            if not (key.startswith("file") and name):
                continue
            for place in beside:
                _require_no_device(place / name, f"{path}: <{element.tag} {key}>")


def _require_no_device(place: Path, where: str) -> None:
    try:
        mode = place.stat().st_mode
    except (OSError, ValueError):
        return  # not there: MuJoCo says so
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise ModelError(
            f"{where} names {place}, a device or a pipe, expected a regular file; copy "
            "it"
        )


def spec_of_file(path: Path, mujoco: Any) -> Any:
    """Return MuJoCo's specification of a file of any ending, ``robot.mjcf`` too.

    MuJoCo itself reads only files that end in ``.xml`` (or ``.urdf``).
    """
    if path.suffix.lower() in (".xml", ".urdf"):
        return mujoco.MjSpec.from_file(str(path))
    text = path.read_text(encoding="utf-8-sig")
    spec = mujoco.MjSpec.from_string(text, include=_included(path))
    spec.modelfiledir = str(path.absolute().parent)  # of meshes that it names
    return spec


def _included(path: Path) -> dict[str, bytes]:
    """Return the files that an MJCF file includes, by their names in it."""
    return {
        name: place.read_bytes()
        for element in mjcf_elements(path)
        if element.tag in _INCLUDING
        and (name := element.attributes.get("file", ""))
        and (place := path.parent / name).is_file()
    }


def read_spec(path: Path, mujoco: Any) -> Any:
    """Return a file's ``mujoco.MjSpec``, with stand-ins for meshes that are missing.

    Bodies without joints stay bodies, also where the file lets MuJoCo fuse them with
    their parents: fused bodies have no name and no place.

    Raises
    ------
    ModelError
        If the file cannot be read, MuJoCo refuses it, or the inertia of a body comes
        from a mesh that is not there.
    """
    require_regular(path, ModelError)
    try:
        spec = spec_of_file(path, mujoco)
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"{path}: MuJoCo refuses it: {cause}") from None
    stand_in(spec, path, mujoco)
    spec.compiler.fusestatic = False
    return spec


def stand_in(spec: Any, path: Path, mujoco: Any) -> tuple[str, ...]:
    """Replace meshes and textures whose files are missing; return their names.

    The file is said to be at `path`.  The mass of a link does not depend on a mesh if
    its inertial is explicit; then the shape is only for display and contact.
    """
    missing = {
        mesh.name: mesh.file
        for mesh in spec.meshes
        if mesh.file and not _exists(path, spec.meshdir, mesh.file, spec)
    }
    for body in spec.bodies:
        for geom in body.geoms:
            if geom.meshname in missing and _weighs(spec, body, geom, mujoco):
                raise ModelError(
                    f"{path}: mesh file {missing[geom.meshname]!r} is missing, and "
                    f"the inertia of body {body.name!r} comes from it; give the body "
                    "an <inertial>, or put the file where the model looks for it"
                )
    for mesh in spec.meshes:
        if mesh.name in missing:
            mesh.file, mesh.uservert, mesh.userface = "", _CORNERS, _FACES
    textures = [t for t in spec.textures if _lacks(path, spec, t)]
    for texture in textures:
        texture.file = ""
        texture.cubefiles = [""] * len(texture.cubefiles)
        texture.builtin = mujoco.mjtBuiltin.mjBUILTIN_FLAT
        texture.rgb1, texture.width, texture.height = _GREY, 1, 1
        cube = texture.type != mujoco.mjtTexture.mjTEXTURE_2D
        texture.height = 6 if cube else 1
    return (*missing, *(texture.name for texture in textures))


class CompiledFile(NamedTuple):
    """MuJoCo's reading of an MJCF file.

    Parameters
    ----------
    spec, model : object
        MuJoCo's specification and its compiled model.
    blind : set of str
        Bodies whose meshes are missing, with stand-ins in their place.
    """

    spec: Any
    model: Any
    blind: set[str]


def compiled_file(path: Path, mujoco: Any) -> CompiledFile:
    """Compile an MJCF file, though meshes are missing.

    Raises
    ------
    ModelError
        If MuJoCo refuses the file.
    """
    try:
        spec = spec_of_file(path, mujoco)
        unseen = set(stand_in(spec, path, mujoco))
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"{path}: MuJoCo refuses it: {cause}") from None
    blind = {
        body.name
        for body in spec.bodies
        if any(geom.meshname in unseen for geom in body.geoms)
    }
    return CompiledFile(spec, model, blind)


def refuse_unsupported(model: Any, moving: set[int], path: Path) -> None:
    """Raise a `ModelError` if a joint of `moving` is not free to move by itself."""
    for sentence in _faults(model, moving):
        # Of a base that hangs still; if it moves, the sentence has the option.
        still = re.search(r"--base \S+(?= if this body stands still)", sentence)
        raise ModelError(
            f"{path}: {sentence}", options=still[0] if still is not None else ""
        )


def joint_name(model: Any, j: int) -> str:
    """Return a joint's name, or one after its number."""
    return model.jnt(j).name or f"joint{j}"


def _lacks(path: Path, spec: Any, texture: Any) -> bool:
    files = [file for file in (texture.file, *texture.cubefiles) if file]
    return any(not _exists(path, spec.texturedir, file, spec) for file in files)


def _exists(path: Path, folder: str, file: str, spec: Any) -> bool:
    """Return whether a file is where MuJoCo looks for it."""
    if file in (spec.assets or {}):
        return True
    return (path.parent / folder / file).is_file() or (path.parent / file).is_file()


def _weighs(spec: Any, body: Any, geom: Any, mujoco: Any) -> bool:
    """Return whether a shape counts in its body's inertia."""
    low, high = spec.compiler.inertiagrouprange
    kinds = mujoco.mjtInertiaFromGeom
    rule = spec.compiler.inertiafromgeom
    explicit = rule == kinds.mjINERTIAFROMGEOM_FALSE or (
        body.explicitinertial and rule != kinds.mjINERTIAFROMGEOM_TRUE
    )
    in_world = body.name == "world"
    empty = geom.mass == 0.0 or geom.density == 0.0
    return not (explicit or in_world or empty) and bool(low <= geom.group <= high)


def _faults(model: Any, moving: set[int]) -> Iterator[str]:
    import mujoco

    words = {mujoco.mjtJoint.mjJNT_FREE: "free", mujoco.mjtJoint.mjJNT_BALL: "ball"}
    for j in sorted(moving):
        word = words.get(mujoco.mjtJoint(int(model.jnt_type[j])))
        if word is not None:
            body = model.body(model.jnt_bodyid[j]).name
            floats = ", --base floating if it moves" if word == "free" else ""
            yield (
                f"body {body!r} hangs on a {word} joint; only hinge and slide joints "
                "are supported, and a free one if the base is 'floating'. Choose: "
                f"--base {body} if this body stands still or hangs{floats}; or a "
                "--tip that the joint does not carry"
            )
    yield from _equalities(model, moving)
    for t in range(model.ntendon):
        pulled = _pulled(model, t, moving)
        if pulled and _pulls(model, t):
            yield (
                f"tendon {_name(model.tendon(t), t)!r} pulls at joint {pulled!r}; "
                "tendons are not supported. Remove it, or lock the joint"
            )


def _equalities(model: Any, moving: set[int]) -> Iterator[str]:
    import mujoco

    for e in range(model.neq):
        if not model.eq_active0[e]:
            continue
        kind = mujoco.mjtEq(int(model.eq_type[e]))
        name = _name(model.equality(e), e)
        first, second = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        if kind == mujoco.mjtEq.mjEQ_JOINT:
            if first in moving and model.eq_data[e, 2:5].any():
                yield (
                    f"equality {name!r}: joint {joint_name(model, first)!r} follows a "
                    "polynomial of degree 2 or more; only straight lines are "
                    "supported. Lock the joint, or change polycoef"
                )
        elif kind == mujoco.mjtEq.mjEQ_TENDON:
            for t in (first, second):
                pulled = _pulled(model, t, moving) if t >= 0 else ""
                if pulled:
                    yield f"equality {name!r} binds joint {pulled!r} by a tendon"
        elif kind in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
            yield from _tied(model, e, moving)


def _tied(model: Any, e: int, moving: set[int]) -> Iterator[str]:
    """Find bodies that move against each other, but are tied together."""
    import mujoco

    ends = [int(model.eq_obj1id[e]), int(model.eq_obj2id[e])]
    if mujoco.mjtObj(int(model.eq_objtype[e])) == mujoco.mjtObj.mjOBJ_SITE:
        ends = [int(model.site_bodyid[site]) for site in ends]
    carried = [_carrying(model, body, moving) for body in ends]
    if carried[0] != carried[1]:
        first, second = (model.body(body).name for body in ends)
        yield (
            f"equality {_name(model.equality(e), e)!r} ties bodies {first!r} and "
            f"{second!r}; closed loops are not supported. Remove the constraint, or "
            "choose a tip before it"
        )


def _pulled(model: Any, t: int, moving: set[int]) -> str:
    """Name of a moving joint that a tendon passes, if there is one."""
    import mujoco

    first = int(model.tendon_adr[t])
    passed: set[int] = set()
    fixed: set[int] | None = None  # joints that carry all of a spatial tendon
    for w in range(first, first + int(model.tendon_num[t])):
        kind = mujoco.mjtWrap(int(model.wrap_type[w]))
        place = int(model.wrap_objid[w])
        if kind == mujoco.mjtWrap.mjWRAP_JOINT:
            passed |= {place} & moving
        elif kind not in (mujoco.mjtWrap.mjWRAP_PULLEY, mujoco.mjtWrap.mjWRAP_NONE):
            sites = kind == mujoco.mjtWrap.mjWRAP_SITE
            body = model.site_bodyid[place] if sites else model.geom_bodyid[place]
            carrying = _carrying(model, int(body), moving)
            passed |= carrying
            fixed = carrying if fixed is None else fixed & carrying
    passed -= fixed or set()
    return joint_name(model, min(passed)) if passed else ""


def _pulls(model: Any, t: int) -> bool:
    import mujoco

    actuated = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON) & (
        model.actuator_trnid[:, 0] == t
    )
    acts = [getattr(model, f"tendon_{what}", None) for what in _PULLS]
    return bool(actuated.any() or any(a is not None and a[t].any() for a in acts))


def _carrying(model: Any, body: int, moving: set[int]) -> set[int]:
    """Joints of `moving` that carry a body."""
    joints: set[int] = set()
    while body > 0:
        first = int(model.body_jntadr[body])
        joints |= set(range(first, first + int(model.body_jntnum[body]))) & moving
        body = int(model.body_parentid[body])
    return joints


def _name(item: Any, number: int) -> str:
    return item.name or str(number)
