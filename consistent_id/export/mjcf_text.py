"""A MuJoCo model as XML whose numbers are exact: MuJoCo itself prints six digits."""

from collections.abc import Iterable
from typing import Any

from consistent_id.robot.loaders.splice import Edit, XmlText
from consistent_id.robot.loaders.urdf_inertial import number
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
                edits += _joint(document, element, model, model.joint(element.name).id)
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


def _joint(document: XmlText, element: Element, model: Any, j: int) -> list[Edit]:
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
        "damping": [model.dof_damping[dof]],
        "armature": [model.dof_armature[dof]],
        "frictionloss": [model.dof_frictionloss[dof]],
    }
    return _exact(document, element, exact)


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
