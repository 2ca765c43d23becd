"""Files that an MJCF file names: meshes and textures, and the folders they are in."""

from collections.abc import Iterator, Mapping
from pathlib import Path

from consistent_id._support.files import relative_path
from consistent_id.robot.loaders.urdf_in_place import Edit, XmlText
from consistent_id.robot.loaders.xml import Element

_FOLDERS = {"mesh": "meshdir", "hfield": "meshdir", "skin": "meshdir"}
_FILES = (
    "file",
    "fileright",
    "fileleft",
    "fileup",
    "filedown",
    "filefront",
    "fileback",
)


def path_edits(document: XmlText, home: Path, folder: Path) -> list[Edit]:
    """Return edits by which files that lie beside `home` are found from `folder`."""
    if home.resolve() == folder.resolve() or not any(asset_files(document, home)):
        return []
    compilers = list(document.root.all("compiler"))
    stated = {name for c in compilers for name in c.attributes}
    edits: list[Edit] = []
    for compiler in compilers:
        moved: dict[str, str] = {
            name: relative_path(home / compiler.attributes[name], folder)
            for name in ("assetdir", "meshdir", "texturedir")
            if name in compiler.attributes
        }
        edits += document.set(compiler, moved)
    whole = {"assetdir"} <= stated
    missing = {"meshdir", "texturedir"} - stated if not whole else set()
    default = {name: relative_path(home, folder) for name in sorted(missing)}
    return edits + (set_section(document, "compiler", default) if default else [])


def asset_files(document: XmlText, home: Path) -> Iterator[tuple[Path, Path]]:
    """Yield files that are there: where, and where as the MJCF file says it."""
    root = document.root
    settings: dict[str, str] = {}
    for compiler in root.all("compiler"):
        settings |= compiler.attributes
    strips = settings.get("strippath") == "true"
    for section in root.all("asset"):
        for element in section.children:
            for name in _named(element):
                key = _FOLDERS.get(element.tag, "texturedir")
                start = settings.get(key, settings.get("assetdir", ""))
                place = Path(start) / (Path(name).name if strips else name)
                if (home / place).is_file():
                    yield home / place, place


def _named(element: Element) -> Iterator[str]:
    return (element.attributes[k] for k in _FILES if element.attributes.get(k))


def set_section(
    document: XmlText, tag: str, attributes: Mapping[str, str]
) -> list[Edit]:
    """Return edits of a section's attributes; the section is added if it lacks."""
    found = list(document.root.all(tag))
    holding = [e for e in found if set(attributes) & set(e.attributes)]
    if holding or found:
        return document.set((holding or found)[-1], attributes)
    pairs = " ".join(f'{name}="{value}"' for name, value in attributes.items())
    return [document.insert(document.root, [[f"<{tag} {pairs}/>"]])]
