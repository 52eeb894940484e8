"""Where the mesh files of a URDF are, and that none is taken from elsewhere.

A URDF that was loaded from the net may name any file. A mesh is taken from the URDF's own folder
(from the one above, where the URDF's is called `urdf`), and from packages around it: folders
above it that hold a `package.xml` or are called as `package://` calls them; and from one further
folder, where the caller allows it.
"""

from __future__ import annotations

from pathlib import Path

from akm_fg.errors import InputError

SHOWN = 60  # characters of a name that no file can have
SCHEME = "package://"
NEAR = 2  # folders above the URDF's in which a package without package.xml is looked for


def mesh_path(urdf: Path, filename: str, allowed: Path | None = None) -> Path:
    """The mesh file, or the first place where it should be.

    Args:
        urdf: that names it.
        filename: the name there.
        allowed: a folder, below which it may lie too.

    Raises:
        InputError: it lies outside the object's folder and packages, or no file has such a name.
    """
    try:
        places = [*_places(urdf, filename), *_allowed_places(urdf, filename, allowed)]
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
        where = "it beside the URDF, a package.xml above both, or --allow DIR"
        raise InputError(urdf, wrong, where)
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


def _allowed_places(urdf: Path, filename: str, allowed: Path | None) -> list[tuple[Path, Path]]:
    """The same below the folder that the caller allows; packages may be it or lie in it."""
    if allowed is None:
        return []
    root = allowed.resolve()
    if not filename.startswith(SCHEME):
        return [(urdf.parent / filename.removeprefix("file://"), root)]
    whole = filename.removeprefix(SCHEME)
    return [(root / whole, root), (root / whole.partition("/")[2], root)]


def _own_folders(folder: Path) -> list[Path]:
    above = [folder.parent] if folder.name == "urdf" else []
    return [folder, *above, *(path for path in folder.parents if _is_package(path))]


def _is_package(folder: Path) -> bool:
    return (folder / "package.xml").is_file()
