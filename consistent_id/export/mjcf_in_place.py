"""An MJCF file with the identified robot in its bytes; all else stays as it is.

Numbers of the compiled model are cut into the file that it is from; meshes and textures
are found from the folder where the new file is.  The numbers are exact: MuJoCo itself
prints six digits.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id._support.files import relative_path
from consistent_id.errors import ModelError
from consistent_id.export.export_formats import comment_edit, comment_text
from consistent_id.export.mjcf_assets import asset_files, path_edits, set_section
from consistent_id.export.mjcf_bodies import (
    inertia_settings,
    read_spec,
    require_mujoco,
)
from consistent_id.robot.loaders.mjcf import compiled_body
from consistent_id.robot.loaders.mjcf_spec import spec_of_file, stand_in
from consistent_id.robot.loaders.urdf_in_place import Edit, XmlText, joined, number
from consistent_id.robot.loaders.xml import Element


def exact_xml(spec: Any) -> bytes:
    """Compile a specification and return its XML.

    Frames, inertials and joints of named bodies, and gravity, have all their digits.
    """
    model = spec.compile()
    document = XmlText.of(spec.to_xml().encode())
    root, edits = document.root, []
    for option in root.all("option"):
        if "gravity" in option.attributes:
            edits += _set(document, option, gravity=model.opt.gravity)
    for tendon in (t for group in root.all("tendon") for t in group.all("fixed")):
        edits += _tendon(document, tendon, model) if tendon.name else []
    for world in root.all("worldbody"):
        for element in world.below():
            if element.tag == "body" and element.name:
                edits += _body(document, element, model, model.body(element.name).id)
            elif element.tag == "joint" and element.name:
                edits += _written_joint(
                    document, element, model, model.joint(element.name).id
                )
    return document.spliced(edits)


def _body(document: XmlText, element: Element, model: Any, b: int) -> list[Edit]:
    edits = _set(document, element, pos=model.body_pos[b], quat=model.body_quat[b])
    inertial = element.child("inertial")
    if inertial is None:
        return edits
    return edits + _set(
        document,
        inertial,
        pos=model.body_ipos[b],
        quat=model.body_iquat[b],
        mass=[model.body_mass[b]],
        diaginertia=model.body_inertia[b],
    )


def _written_joint(
    document: XmlText, element: Element, model: Any, j: int
) -> list[Edit]:
    """Return edits of a joint's own numbers; those of its class are left alone."""
    dof, place = int(model.jnt_dofadr[j]), int(model.jnt_qposadr[j])
    exact = {
        "pos": model.jnt_pos[j],
        "axis": model.jnt_axis[j],
        "range": model.jnt_range[j],
        "actuatorfrcrange": model.jnt_actfrcrange[j],
        "ref": [model.qpos0[place]],
        "springref": [model.qpos_spring[place]],
        "stiffness": [model.jnt_stiffness[j]],
        "damping": _damping(model, dof),
        "armature": [model.dof_armature[dof]],
        "frictionloss": [model.dof_frictionloss[dof]],
    }
    return _exact(document, element, exact)


def _damping(model: Any, dof: int) -> list[float]:
    """Return the damping, and coefficients of powers of the speed if there are any."""
    powers = getattr(model, "dof_dampingpoly", np.zeros((dof + 1, 0)))[dof]
    return [float(model.dof_damping[dof]), *np.trim_zeros(powers, "b").tolist()]


def _tendon(document: XmlText, element: Element, model: Any) -> list[Edit]:
    t = model.tendon(element.name).id
    exact = {
        name: [getattr(model, f"tendon_{name}")[t]]
        for name in ("damping", "frictionloss", "armature")
        if hasattr(model, f"tendon_{name}")
    }
    return _exact(document, element, exact)


def _exact(document: XmlText, element: Element, exact: dict[str, Any]) -> list[Edit]:
    """Return edits that give stated numbers all their digits."""
    stated = {
        name: value for name, value in exact.items() if _plain(element, name, value)
    }
    return _set(document, element, **stated)


def _plain(element: Element, name: str, value: Any) -> bool:
    """Return whether an attribute is stated, with as many numbers as the model has."""
    return len(element.attributes.get(name, "").split()) == len(value)


def _set(document: XmlText, element: Element, **values: Iterable[float]) -> list[Edit]:
    text = {k: " ".join(number(x) for x in v) for k, v in values.items()}
    return document.set(element, text)


_CLOSE = 1e-9  # of the largest; difference of values that are read back
_READ_BACK = (
    "dof_damping",
    "dof_dampingpoly",
    "dof_armature",
    "dof_frictionloss",
    "jnt_stiffness",
    "qpos_spring",
    "tendon_frictionloss",
)

# With these the file's elements are not the model's, one by one.
_MULTIPLYING = {"include", "replicate", "attach", "composite", "flexcomp", "model"}
_TURNED = ("axisangle", "xyaxes", "zaxis", "euler", "fullinertia")
_ROUNDED = 1e-13  # of the largest parameter
_TENDON = ("damping", "frictionloss", "armature")


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
        The new content of the file.
    comment : str
        For its first line.
    folder : Path, optional
        Where the file is to be written, if not beside the source.
    copies : bool
        Whether meshes and textures are to lie beside it, too.
    """
    home = source.parent
    folder = home if folder is None else folder
    document = XmlText.read(source)
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
    settings = inertia_settings(before_spec)
    undamped = _undamped(before_spec, spec)
    edits = number_edits(
        document,
        places,
        _CompiledPair(before, after, before_spec.compiler.degree, undamped),
        every_body=bool(settings),
    )
    if settings:
        edits += set_section(document, "compiler", settings)
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
    """Return MuJoCo's own output, for files whose elements are not the model's."""
    fresh = spec_of_file(source, require_mujoco())
    gone = stand_in(fresh, source, require_mujoco())
    urdf = XmlText.read(source).root.tag == "robot"
    what = "is a URDF" if urdf else "includes or repeats parts"
    if gone:
        raise ModelError(
            f"{source}: it {what}, so MuJoCo has to write it anew, and cannot without "
            f"{gone[0]!r}; put its meshes and textures beside it"
        )
    if not files:
        for name in ("meshdir", "texturedir"):
            place = source.parent / getattr(spec.compiler, name)
            setattr(spec.compiler, name, relative_path(place, folder))
    line = comment_text(comment).encode("ascii", "replace")
    note = f"{source.name} {what}, so MuJoCo wrote it anew: comments are lost"
    return InPlace(b"<!-- " + line + b" -->\n" + exact_xml(spec), files, (note,))


def compiled_content(content: bytes, source: Path | None = None) -> Any:
    """Return the ``mujoco.MjModel`` of a file's content, with the source's meshes.

    Raises
    ------
    ModelError
        If MuJoCo refuses it.
    """
    mujoco = require_mujoco()
    try:
        spec = mujoco.MjSpec.from_string(content.decode())
        spec.compiler.fusestatic = False
        if source is not None:
            original = read_spec(source)[0].compiler
            for name in ("meshdir", "texturedir"):
                place = (source.parent / getattr(original, name)).resolve()
                setattr(spec.compiler, name, str(place))
            stand_in(spec, source, mujoco)
        return spec.compile()
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"MuJoCo refuses the estimate: {cause}") from None


def _require_same(content: bytes, after: Any, source: Path) -> None:
    """Refuse to hand out a file that MuJoCo would read as another robot."""
    found = compiled_content(content, source)
    for name in ("bodies", *_READ_BACK):
        one, other = (
            _bodies_of(model) if name == "bodies" else getattr(model, name, np.zeros(0))
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


class Places(NamedTuple):
    """Bodies and joints of a file, in the order of the compiled model."""

    bodies: tuple[Element, ...]
    joints: tuple[Element, ...]


def places_in(root: Element, model: Any) -> Places | None:
    """Return the places of a model's bodies and joints; None if the file has none.

    Included files, replicated and attached bodies have no place of their own.
    """
    if any(element.tag in _MULTIPLYING for element in root.below()):
        return None
    bodies = [b for world in root.all("worldbody") for b in _bodies(world)]
    joints = [joint for body in bodies for joint in _joints(body)]
    if len(bodies) != model.nbody - 1 or len(joints) != model.njnt:
        return None
    named = [(body.name, model.body(k).name) for k, body in enumerate(bodies, 1)]
    named += [(joint.name, model.jnt(k).name) for k, joint in enumerate(joints)]
    if any(stated and stated != found for stated, found in named):
        return None
    return Places(tuple(bodies), tuple(joints))


class _CompiledPair(NamedTuple):
    """Models of the file as it is, and as it is to be.

    Parameters
    ----------
    before, after : mujoco.MjModel
    degree : bool
        Whether angles of the file are in degrees.
    undamped : set of int
        Joints whose ``springdamper`` is removed.
    """

    before: Any
    after: Any
    degree: bool
    undamped: frozenset[int]


def number_edits(
    document: XmlText,
    places: Places,
    change: _CompiledPair,
    *,
    every_body: bool,
) -> list[Edit]:
    """Return edits of inertials, joints and gravity that differ between two models.

    Parameters
    ----------
    every_body : bool
        Write all inertials, because before they were computed from shapes.
    """
    edits: list[Edit] = []
    before, after = change.before, change.after
    for b, element in enumerate(places.bodies, start=1):
        if every_body or not _same_body(before, after, b):
            edits += _inertial(document, element, after, b)
    for j, element in enumerate(places.joints):
        if element.tag != "freejoint":
            edits += _joint(document, element, change, j)
    if not np.array_equal(before.opt.gravity, after.opt.gravity):
        values = {"gravity": _text(after.opt.gravity)}
        edits += set_section(document, "option", values)
    return edits


def tendon_edits(document: XmlText, before: Any, after: Any) -> list[Edit]:
    """Return edits that add the tendons that only the later model has."""
    sections = []
    for t in range(before.ntendon, after.ntendon):
        tendon = after.tendon(t)
        shared = "".join(
            f' {name}="{number(value)}"'
            for name in _TENDON
            if hasattr(after, f"tendon_{name}")
            and (value := float(getattr(after, f"tendon_{name}")[t]))
        )
        first = int(after.tendon_adr[t])
        wraps = range(first, first + int(after.tendon_num[t]))
        kind = "spatial" if _is_site(after, first) else "fixed"
        ends = [_end(after, w) for w in wraps]
        whole = [f'<{kind} name="{tendon.name}"{shared}>', *ends, f"</{kind}>"]
        sections.append(["<tendon>", *whole, "</tendon>"])
    return [document.insert(document.root, [lines]) for lines in sections]


def site_edits(
    document: XmlText, places: Places, before: Any, after: Any
) -> list[Edit]:
    """Return edits that add the sites that only the later model has."""
    known = {before.site(s).name for s in range(before.nsite)}
    world = next(iter(document.root.all("worldbody")))
    edits = []
    for s in range(after.nsite):
        site = after.site(s)
        if site.name not in known:
            body = int(after.site_bodyid[s])
            holder = world if body == 0 else places.bodies[body - 1]
            stated = (
                f'<site name="{site.name}" pos="{_text(after.site_pos[s])}" '
                f'size="{number(after.site_size[s][0])}"/>'
            )
            edits.append(document.insert(holder, [[stated]]))
    return edits


def _is_site(model: Any, wrap: int) -> bool:
    return bool(model.wrap_type[wrap] == require_mujoco().mjtWrap.mjWRAP_SITE)


def _end(model: Any, wrap: int) -> str:
    """Return the elements that a tendon passes: joints or sites."""
    place = int(model.wrap_objid[wrap])
    if _is_site(model, wrap):
        return f'<site site="{model.site(place).name}"/>'
    joint, share = model.jnt(place).name, number(model.wrap_prm[wrap])
    return f'<joint joint="{joint}" coef="{share}"/>'


def _inertial(document: XmlText, body: Element, model: Any, b: int) -> list[Edit]:
    values = {
        "pos": _text(model.body_ipos[b]),
        "quat": _text(model.body_iquat[b]),
        "mass": number(model.body_mass[b]),
        "diaginertia": _text(model.body_inertia[b]),
    }
    inertial = body.child("inertial")
    if inertial is not None:
        return document.drop(inertial, _TURNED) + document.set(inertial, values)
    pairs = " ".join(f'{name}="{value}"' for name, value in values.items())
    return [document.insert(body, [[f"<inertial {pairs}/>"]])]


def _joint(
    document: XmlText,
    element: Element,
    change: _CompiledPair,
    j: int,
) -> list[Edit]:
    """Return edits of a joint's drive and spring values that changed."""
    after = change.after
    found, wanted = _drive(change.before, j), _drive(after, j)
    changed = {name: value for name, value in wanted.items() if value != found[name]}
    hinge = after.jnt_type[j] == require_mujoco().mjtJoint.mjJNT_HINGE
    if change.degree and hinge and "springref" in changed:
        changed["springref"] = [float(np.rad2deg(x)) for x in changed["springref"]]
    values = {name: _text(value) for name, value in changed.items()}
    if j in change.undamped:
        values["springdamper"] = "0 0"
    if not element.name:  # as `load_mjcf` calls it, so that it can be found
        values["name"] = after.jnt(j).name
    return document.set(element, values)


def _undamped(before: Any, after: Any) -> frozenset[int]:
    """Return joints whose ``springdamper`` is removed from a specification."""
    pairs = zip(before.joints, after.joints, strict=True)
    return frozenset(
        int(joint.id)
        for joint, changed in pairs
        if np.any(joint.springdamper) and not np.any(changed.springdamper)
    )


def _drive(model: Any, j: int) -> dict[str, list[float]]:
    dof, place = int(model.jnt_dofadr[j]), int(model.jnt_qposadr[j])
    return {
        "damping": _damping(model, dof),
        "frictionloss": [float(model.dof_frictionloss[dof])],
        "armature": [float(model.dof_armature[dof])],
        "stiffness": [float(model.jnt_stiffness[j])],
        "springref": [float(model.qpos_spring[place])],
    }


def _same_body(before: Any, after: Any, b: int) -> bool:
    """Return whether a body is the same but for rounding."""
    one, other = (compiled_body(model, b).vector for model in (before, after))
    return bool(np.allclose(one, other, rtol=0.0, atol=_ROUNDED * abs(one).max()))


def _bodies(parent: Element) -> Iterator[Element]:
    for child in parent.children:
        if child.tag == "body":
            yield child
        if child.tag in ("body", "frame"):
            yield from _bodies(child)


def _joints(body: Element) -> Iterator[Element]:
    for child in body.children:
        if child.tag in ("joint", "freejoint"):
            yield child


def _text(values: Any) -> str:
    return " ".join(number(value) for value in values)
