"""Where the mesh files of a URDF are, and that none is taken from elsewhere.

A URDF that was loaded from the net may name any file. A mesh is taken from the URDF's own folder
(from the one above, where the URDF's is called `urdf`), and from packages around it: folders
above it that hold a `package.xml` or are called as `package://` calls them.
"""

from __future__ import annotations

from pathlib import Path

from akm_fg.errors import InputError

SHOWN = 60  # characters of a name that no file can have
SCHEME = "package://"
NEAR = 2  # folders above the URDF's in which a package without package.xml is looked for


def mesh_path(urdf: Path, filename: str) -> Path:
    """The mesh file, or the first place where it should be.

    Raises:
        InputError: it lies outside the object's folder and packages, or no file has such a name.
    """
    try:
        places = _places(urdf, filename)
        inside = [place for place, root in places if place.resolve().is_relative_to(root)]
        there = [place for place in inside if place.is_file()]
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: links in a circle
        told = getattr(error, "strerror", None) or error
        wrong = f"mesh {filename[:SHOWN]!r} cannot be looked for ({told})"
        raise InputError(urdf, wrong, "the name of a file") from error
    if there:
        return there[0]
    if not inside:
        wrong = f"mesh {filename[:SHOWN]!r} lies outside the object's folder and packages"
        raise InputError(urdf, wrong, "it beside the URDF, or a package.xml above both")
    return inside[0]


def shown_mesh(mesh: Path, urdf: Path) -> str:
    """The mesh as seen from the URDF's folder, so that a note is true wherever both lie."""
    return str(mesh.relative_to(urdf.parent)) if mesh.is_relative_to(urdf.parent) else mesh.name


def _places(urdf: Path, filename: str) -> list[tuple[Path, Path]]:
    """Where the file may be, and the folder within which it must be then."""
    folder = urdf.parent
    if not filename.startswith(SCHEME):
        place = folder / filename.removeprefix("file://")
        return [(place, root) for root in _own_folders(folder.resolve())]
    whole = filename.removeprefix(SCHEME)
    package, _, after = whole.partition("/")
    around = (folder, *folder.resolve().parents)
    found = []
    for i, above in enumerate(around):
        if package not in ("", ".", ".."):
            found.append((above / whole, (above / package).resolve()))
        if i <= NEAR or above.name == package or _is_package(above):
            found.append((above / after, above.resolve()))
    return found


def _own_folders(folder: Path) -> list[Path]:
    above = [folder.parent] if folder.name == "urdf" else []
    return [folder, *above, *(path for path in folder.parents if _is_package(path))]


def _is_package(folder: Path) -> bool:
    return (folder / "package.xml").is_file()
