"""An MJCF file with the identified robot in its bytes; all else stays as it is."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id._support.files import relative_path
from consistent_id.errors import ModelError
from consistent_id.export.mjcf_body import require_mujoco
from consistent_id.export.mjcf_paths import asset_files, path_edits
from consistent_id.export.mjcf_source import read_spec
from consistent_id.export.mjcf_splice import (
    number_edits,
    places_in,
    set_section,
    site_edits,
    tendon_edits,
)
from consistent_id.export.mjcf_text import exact_xml
from consistent_id.export.provenance import comment_edit
from consistent_id.robot.loaders.mjcf import compiled_body
from consistent_id.robot.loaders.mjcf_assets import stand_in
from consistent_id.robot.loaders.splice import Document, joined

_CLOSE = 1e-9  # of the largest; what is read back, beside what was to be written
_READ_BACK = (
    "dof_damping",
    "dof_armature",
    "dof_frictionloss",
    "jnt_stiffness",
    "qpos_spring",
    "tendon_frictionloss",
)


class InPlace(NamedTuple):
    """A file's new content, files that it needs beside it, and notes."""

    content: bytes
    files: tuple[tuple[Path, Path], ...]
    notes: tuple[str, ...]


def put_in_place(
    spec: Any, source: Path, comment: str, folder: Path | None, copies: bool
) -> InPlace:
    """Return the source with the numbers of a specification.

    Parameters
    ----------
    spec : mujoco.MjSpec
        What the file is to say.
    comment : str
        For its first line.
    folder : Path, optional
        Where the file is to be written, if not beside the source.
    copies : bool
        Whether meshes and textures are to lie beside it, too.
    """
    home = source.parent
    folder = home if folder is None else folder
    document = Document.read(source)
    files = tuple(dict.fromkeys(asset_files(document, home))) if copies else ()
    outside = [name for _, name in files if ".." in name.parts or name.is_absolute()]
    if outside:
        raise ModelError(
            f"{source}: {outside[0]} lies outside of the file's folder, so it cannot "
            "be copied; export without copies"
        )
    moved = [] if copies else path_edits(document, home, folder)
    before_spec, before = read_spec(source)
    after = spec.compile()
    places = places_in(document.root, after)
    if places is None:
        return _rewritten(spec, source, comment, folder, files)
    from_geoms = require_mujoco().mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    every = before_spec.compiler.inertiafromgeom == from_geoms
    edits = number_edits(
        document,
        places,
        before,
        after,
        degree=before_spec.compiler.degree,
        every_body=every,
    )
    if every:
        edits += set_section(document, "compiler", {"inertiafromgeom": "auto"})
    edits += site_edits(document, places, before, after)
    edits += tendon_edits(document, before, after)
    edits = [*edits, *moved, comment_edit(document, comment)]
    content = document.spliced(joined(edits))
    _require_same(content, after, source)
    return InPlace(content, files, ())


def _rewritten(
    spec: Any,
    source: Path,
    comment: str,
    folder: Path,
    files: tuple[tuple[Path, Path], ...],
) -> InPlace:
    """Return what MuJoCo writes, for files whose elements are not the model's."""
    fresh = require_mujoco().MjSpec.from_file(str(source))
    gone = stand_in(fresh, source, require_mujoco())
    if gone:
        raise ModelError(
            f"{source}: it includes or repeats parts, so MuJoCo has to write it anew, "
            f"and cannot without {gone[0]!r}; put its meshes and textures beside it"
        )
    if not files:
        for name in ("meshdir", "texturedir"):
            place = source.parent / getattr(spec.compiler, name)
            setattr(spec.compiler, name, relative_path(place, folder))
    line = comment.replace("--", "- -").encode("ascii", "replace")
    note = (
        f"{source.name} includes or repeats parts, so MuJoCo wrote it anew: comments "
        "are lost"
    )
    return InPlace(b"<!-- " + line + b" -->\n" + exact_xml(spec), files, (note,))


def _require_same(content: bytes, after: Any, source: Path) -> None:
    """Refuse to hand out a file that MuJoCo would read as another robot."""
    mujoco = require_mujoco()
    original = mujoco.MjSpec.from_file(str(source)).compiler
    try:
        spec = mujoco.MjSpec.from_string(content.decode())
        for name in ("meshdir", "texturedir"):
            place = (source.parent / getattr(original, name)).resolve()
            setattr(spec.compiler, name, str(place))
        stand_in(spec, source, mujoco)
        found = spec.compile()
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"MuJoCo refuses the estimate: {cause}") from None
    for name in ("bodies", *_READ_BACK):
        one, other = (
            _bodies_of(model) if name == "bodies" else getattr(model, name)
            for model in (found, after)
        )
        size = float(abs(other).max(initial=0.0))
        if one.shape != other.shape or abs(one - other).max(initial=0) > _CLOSE * size:
            raise ModelError(
                f"{source}: {name} would not read back as it was written; export "
                "without source"
            )


def _bodies_of(model: Any) -> Array:
    """Return the parameters of a model's bodies, shape (bodies, 10)."""
    return np.array([compiled_body(model, b).vector for b in range(1, model.nbody)])
