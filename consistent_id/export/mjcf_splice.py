"""Numbers of a compiled MuJoCo model cut into the bytes of the MJCF file it is from."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from consistent_id.export.mjcf_body import require_mujoco
from consistent_id.robot.loaders.mjcf import compiled_body
from consistent_id.robot.loaders.splice import Document, Edit
from consistent_id.robot.loaders.urdf_inertial import number
from consistent_id.robot.loaders.xml import Element

# With these the file's elements are not the model's, one by one.
_MULTIPLYING = {"include", "replicate", "attach", "composite", "flexcomp", "model"}
_TURNED = ("axisangle", "xyaxes", "zaxis", "euler", "fullinertia")
_ROUNDED = 1e-13  # of the largest parameter
_TENDON = ("damping", "frictionloss", "armature")


class Places(NamedTuple):
    """Bodies and joints of a file, in the order of the compiled model."""

    bodies: tuple[Element, ...]
    joints: tuple[Element, ...]


def places_in(root: Element, model: Any) -> Places | None:
    """Return where a model's bodies and joints stand; None if that is not in the file.

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


def number_edits(
    document: Document,
    places: Places,
    before: Any,
    after: Any,
    *,
    degree: bool,
    every_body: bool,
) -> list[Edit]:
    """Return edits of inertials, joints and gravity that differ between two models.

    Parameters
    ----------
    before, after : mujoco.MjModel
        Of the file as it is, and as it is to be.
    degree : bool
        Whether angles of the file are in degrees.
    every_body : bool
        Write all inertials, because before they were computed from shapes.
    """
    edits: list[Edit] = []
    for b, element in enumerate(places.bodies, start=1):
        if every_body or not _same_body(before, after, b):
            edits += _inertial(document, element, after, b)
    for j, element in enumerate(places.joints):
        if element.tag != "freejoint":
            edits += _joint(document, element, before, after, j, degree)
    if not np.array_equal(before.opt.gravity, after.opt.gravity):
        values = {"gravity": _text(after.opt.gravity)}
        edits += set_section(document, "option", values)
    return edits


def tendon_edits(document: Document, before: Any, after: Any) -> list[Edit]:
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
    document: Document, places: Places, before: Any, after: Any
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
    """Return what a tendon passes: a joint, or a site."""
    place = int(model.wrap_objid[wrap])
    if _is_site(model, wrap):
        return f'<site site="{model.site(place).name}"/>'
    joint, share = model.jnt(place).name, number(model.wrap_prm[wrap])
    return f'<joint joint="{joint}" coef="{share}"/>'


def set_section(
    document: Document, tag: str, attributes: Mapping[str, str]
) -> list[Edit]:
    """Return edits of a section's attributes; the section is added if it lacks."""
    found = list(document.root.all(tag))
    holding = [e for e in found if set(attributes) & set(e.attributes)]
    if holding or found:
        return document.set((holding or found)[-1], attributes)
    pairs = " ".join(f'{name}="{value}"' for name, value in attributes.items())
    return [document.insert(document.root, [[f"<{tag} {pairs}/>"]])]


def _inertial(document: Document, body: Element, model: Any, b: int) -> list[Edit]:
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
    document: Document, element: Element, before: Any, after: Any, j: int, degree: bool
) -> list[Edit]:
    """Return edits of what a joint has of drives and springs, where it changed."""
    found, wanted = _drive(before, j), _drive(after, j)
    changed = {name: value for name, value in wanted.items() if value != found[name]}
    hinge = after.jnt_type[j] == require_mujoco().mjtJoint.mjJNT_HINGE
    if degree and hinge and "springref" in changed:
        changed["springref"] = float(np.rad2deg(changed["springref"]))
    values = {name: number(value) for name, value in changed.items()}
    if not element.name:  # as `load_mjcf` calls it, so that it can be found
        values["name"] = after.jnt(j).name
    return document.set(element, values)


def _drive(model: Any, j: int) -> dict[str, float]:
    dof, place = int(model.jnt_dofadr[j]), int(model.jnt_qposadr[j])
    return {
        "damping": float(model.dof_damping[dof]),
        "frictionloss": float(model.dof_frictionloss[dof]),
        "armature": float(model.dof_armature[dof]),
        "stiffness": float(model.jnt_stiffness[j]),
        "springref": float(model.qpos_spring[place]),
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
