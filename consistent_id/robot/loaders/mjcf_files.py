"""The files that an MJCF file names, looked at before MuJoCo opens them.

MuJoCo opens what a file names, whatever it is: a pipe blocks for ever, and a device may
never end.
"""

import stat
from collections.abc import Iterator
from pathlib import Path

from consistent_id.errors import ModelError
from consistent_id.robot.loaders.urdf_lint import read_bytes
from consistent_id.robot.loaders.xml import Element, XmlFault, parse

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
            if element.tag in ("include", "model"):
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
