"""Meshes and textures of an MJCF file that are not there, and not needed."""

from pathlib import Path
from typing import Any

from consistent_id.errors import ModelError

# A tetrahedron; it stands in for a mesh that only would be looked at.
_CORNERS = (0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1)
_FACES = (0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3)
_GREY = (0.5, 0.5, 0.5)


def read_spec(path: Path, mujoco: Any) -> Any:
    """Return a file's ``mujoco.MjSpec``, with stand-ins for meshes that are missing.

    Raises
    ------
    ModelError
        If MuJoCo refuses the file, or the inertia of a body comes from a mesh that is
        not there.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"{path}: MuJoCo refuses it: {cause}") from None
    stand_in(spec, path, mujoco)
    return spec


def stand_in(spec: Any, path: Path, mujoco: Any) -> tuple[str, ...]:
    """Replace meshes and textures whose files are missing; return their names.

    The file is said to be at `path`.  What a link weighs does not depend on a mesh if
    its inertial is explicit; then the shape is only for looking at, and for contact.
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
                    f"{path}: mesh file {missing[geom.meshname]!r} is not there, and "
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
