"""Files that are made once and kept in the user's cache folder between runs.

`$XDG_CACHE_HOME/akm-fg`, or `~/.cache/akm-fg` (other systems: where `platformdirs` says), or the
temporary folder where there is no home. A folder of another owner is not used.
An entry is a folder that is made beside its place and renamed into it when it is whole: an
interruption leaves no half entry, and of several processes that make the same one, the first
wins. Who makes one holds a lock on its folder, so that what a killed process left is known, and
removed when the next one is made. What nobody has used for a month goes then too. Entries name
no place outside themselves; the folder may be deleted at any time.
"""

from __future__ import annotations

import atexit
import errno
import fcntl
import functools
import hashlib
import importlib.metadata
import logging
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import platformdirs

import akm_fg.arm
from akm_fg.errors import OutputError

LOG = logging.getLogger(__name__)

SCRATCH = ".making-"  # names of entries that are not whole yet begin so
STALE_S = 24 * 3600.0  # what was not finished by then never will be
YOUNG_S = 60.0  # so soon after it was made, a folder may not have its lock yet
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
UNUSED_S = 30 * 24 * 3600.0  # an entry lives so long after its last use
# Besides our own code, what decides what an object's files and its place look like.
DEPENDENCIES = ("numpy", "scipy", "scene_synthesizer", "trimesh", "pin", "coacd", "gtsam")


def cache_folder() -> Path:
    """Where entries live; it exists, and is this user's own: others might put there anything."""
    try:
        base = platformdirs.user_cache_path("akm-fg", appauthor=False)
        base.mkdir(parents=True, exist_ok=True)
        if os.access(base, os.W_OK) and base.stat().st_uid == os.getuid():
            return base
    except (OSError, RuntimeError) as error:  # RuntimeError: nobody knows this user's home
        LOG.debug("no cache folder: %s", error)
    base = Path(tempfile.gettempdir()) / f"akm-fg-cache-{os.getuid()}"
    try:
        base.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = base.lstat()  # a link is somebody's trap
        if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid():
            return base
    except OSError as error:
        LOG.debug("no cache folder: %s", error)
    return _of_this_process()


@functools.cache
def _of_this_process() -> Path:
    """A folder that goes with the process."""
    base = Path(tempfile.mkdtemp(prefix="akm-fg-cache-"))
    atexit.register(shutil.rmtree, base, ignore_errors=True)
    return base


def kept(name: str, make: Callable[[Path], None]) -> Path:
    """The cache's folder `name`, filled by `make(folder)` where it is not there yet.

    Raises:
        OutputError: the disk is full.
        Exception: whatever `make` raises; nothing is kept then.
    """
    target = cache_folder() / name
    if _used(target):
        return target
    _sweep(target.parent)
    scratch = Path(tempfile.mkdtemp(prefix=SCRATCH, dir=target.parent))
    lock = _locked(scratch)
    try:
        make(scratch)
        scratch.rename(target)
    except OSError as error:
        if target.is_dir():  # another process was faster
            return target
        if error.errno in NO_ROOM:
            told = f"{target.parent}: cannot be written ({error.strerror})"
            raise OutputError(f"{told}; make room, or set XDG_CACHE_HOME") from error
        raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
        if lock is not None:
            os.close(lock)
    return target


def is_kept(name: str) -> bool:
    """Whether the cache's folder `name` is there; it counts as used now."""
    return _used(cache_folder() / name)


def _locked(folder: Path) -> int | None:
    """A descriptor that locks the folder until it is closed, or its process ends.

    None where another process holds the lock, or the file system has none.
    """
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def digest(*parts: str | bytes) -> str:
    """A short name for contents."""
    sha = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        sha.update(len(data).to_bytes(8, "little") + data)
    return sha.hexdigest()[:24]


@functools.cache
def code_digest() -> str:
    """Of everything that makes and places objects, and the versions of what that uses.

    All of this package, and the arm's, which says where it reaches.
    """
    return digest_of((Path(__file__).parent, Path(akm_fg.arm.__file__).parent))


def digest_of(rooms: Sequence[Path]) -> str:
    """Of all code in some folders, and the versions of what it uses."""
    sources = [path.read_bytes() for room in rooms for path in sorted(room.rglob("*.py"))]
    return digest(*(f"{name} {_version(name)}" for name in DEPENDENCIES), *sources)


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def _used(entry: Path) -> bool:
    """Whether there is such an entry; its time of last use is now."""
    try:
        os.utime(entry)
    except OSError:
        return entry.is_dir()  # there, but somebody else's
    return True


def _sweep(folder: Path) -> None:
    """Removes what killed processes left unfinished, and what has not been used for long."""
    for entry in folder.iterdir():
        try:
            age_s = time.time() - entry.stat().st_mtime
        except OSError:  # it was renamed or removed meanwhile
            continue
        if _is_dead(entry, age_s) if entry.name.startswith(SCRATCH) else age_s > UNUSED_S:
            shutil.rmtree(entry, ignore_errors=True)


def _is_dead(scratch: Path, age_s: float) -> bool:
    """Whether nobody works on an entry that is not whole."""
    if age_s < YOUNG_S or age_s > STALE_S:
        return age_s > STALE_S
    lock = _locked(scratch)
    if lock is not None:
        os.close(lock)
    return lock is not None
