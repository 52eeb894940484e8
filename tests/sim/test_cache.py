"""What is kept between runs is whole, the same as when it was made, and made once."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import akm_fg.arm
from akm_fg.arm.body.kinematics import FrankaKinematics
from sim import cache
from sim.cache import (
    SCRATCH,
    STALE_S,
    UNUSED_S,
    YOUNG_S,
    cache_folder,
    code_digest,
    digest,
    digest_of,
    kept,
)
from sim.objects.object_record import RECORD, read_record, spec_text, write_record
from sim.objects.staging import build_and_place, find_spec, stage


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "akm-fg"


def test_a_user_chooses_the_folder_has_one_in_the_home_or_gets_a_temporary_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    assert cache_folder() == tmp_path / "akm-fg"  # XDG_CACHE_HOME
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_folder() == tmp_path / "home" / ".cache" / "akm-fg"
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    temporary = tmp_path / f"akm-fg-cache-{os.getuid()}"
    (tmp_path / "file").touch()
    monkeypatch.setenv("HOME", str(tmp_path / "file"))  # nothing can be made below it
    assert cache_folder() == temporary and temporary.is_dir()
    monkeypatch.delenv("HOME")
    monkeypatch.setattr(pwd, "getpwuid", lambda uid: {}[uid])  # a user without an entry
    assert cache_folder() == temporary


def test_a_folder_of_another_owner_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    assert cache_folder() == tmp_path / "akm-fg"
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    uid = os.getuid() + 1  # whose are neither the folder in XDG_CACHE_HOME nor that in /tmp
    monkeypatch.setattr(os, "getuid", lambda: uid)
    shared = tmp_path / f"akm-fg-cache-{uid}"
    shared.mkdir()
    found = cache_folder()
    assert (
        found.is_dir() and found.parent == tmp_path and found not in (shared, tmp_path / "akm-fg")
    )
    assert cache_folder() == found  # one for the whole process
    assert found.stat().st_mode & 0o077 == 0


def test_a_link_in_the_temporary_folder_is_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    link = tmp_path / f"akm-fg-cache-{os.getuid()}"
    link.symlink_to(elsewhere)
    cache._of_this_process.cache_clear()
    assert cache_folder() not in (link, elsewhere)
    cache._of_this_process.cache_clear()


def test_an_entry_is_made_once():
    made = []

    def make(folder: Path) -> None:
        made.append(folder)
        (folder / "file").write_text("x")

    first, again = kept("entry", make), kept("entry", make)
    assert first == again and (first / "file").read_text() == "x" and len(made) == 1
    assert [path.name for path in cache_folder().iterdir()] == ["entry"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_an_interruption_leaves_nothing(error: type[BaseException], own_cache: Path):
    def make(folder: Path) -> None:
        (folder / "half").write_text("x")
        raise error

    with pytest.raises(error):
        kept("entry", make)
    assert list(own_cache.iterdir()) == []


def test_the_first_of_two_that_make_the_same_wins_and_both_get_it_whole():
    both = threading.Barrier(2)
    found: list[Path] = []

    def make(folder: Path) -> None:
        both.wait(10.0)  # neither is there before both have begun
        (folder / "a").write_text("x")
        (folder / "b").write_text("x")

    threads = [threading.Thread(target=lambda: found.append(kept("e", make))) for _ in "12"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [cache_folder() / "e"] * 2
    assert sorted(f.name for f in found[0].iterdir()) == ["a", "b"]
    assert [path.name for path in cache_folder().iterdir()] == ["e"]


def test_what_killed_processes_left_is_removed_after_a_day(own_cache: Path):
    old, young = (cache_folder() / f"{SCRATCH}{age}" for age in ("old", "young"))
    old.mkdir()
    young.mkdir()
    yesterday = time.time() - STALE_S - 60.0
    os.utime(old, (yesterday, yesterday))
    kept("entry", lambda folder: None)
    assert sorted(p.name for p in own_cache.iterdir()) == sorted([young.name, "entry"])


def test_what_a_killed_process_left_goes_at_once_and_what_is_worked_on_stays(own_cache: Path):
    code = (
        "import os, time; from pathlib import Path; from sim.cache import kept\n"
        "kept('half', lambda folder: (print(folder, flush=True), time.sleep(60.0)))"
    )
    command = [sys.executable, "-c", code]
    workers = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    folders = [Path(worker.stdout.readline().strip()) for worker in workers]
    workers[0].kill()
    workers[0].wait()
    a_while_ago = time.time() - YOUNG_S - 1.0
    for folder in folders:
        os.utime(folder, (a_while_ago, a_while_ago))
    kept("entry", lambda folder: None)
    there = [folder.is_dir() for folder in folders]
    workers[1].kill()
    workers[1].wait()
    assert there == [False, True]


def test_what_nobody_used_for_long_goes_and_what_is_used_stays(own_cache: Path):
    long_ago = time.time() - UNUSED_S - 60.0
    for name in ("used", "unused"):
        os.utime(kept(name, lambda folder: None), (long_ago, long_ago))
    kept("used", lambda folder: None)
    kept("new", lambda folder: None)
    assert sorted(path.name for path in own_cache.iterdir()) == ["new", "used"]


def test_a_digest_tells_where_one_part_ends():
    assert digest("ab", "c") != digest("a", "bc")


def test_another_arm_makes_objects_anew(tmp_path: Path):
    """It decides where they stand: a place is one that the arm can open."""
    shutil.copytree(Path(akm_fg.arm.__file__).parent, tmp_path / "arm")
    rooms = (Path(cache.__file__).parent, tmp_path / "arm")
    assert digest_of(rooms) == code_digest()
    with (tmp_path / "arm" / "reaching.py").open("a") as file:
        file.write("# changed\n")
    assert digest_of(rooms) != code_digest()


def test_an_object_from_the_cache_is_the_one_that_was_built_bit_for_bit(tmp_path: Path):
    spec, kinematics = find_spec("furniture-dev/drawer-004", 2), FrankaKinematics()
    folder = tmp_path / "fresh"
    folder.mkdir()
    built, placement = build_and_place(spec, folder, kinematics)
    kept_built, kept_placement = stage(spec, kinematics)
    kept_folder = kept_built.urdf.parent
    assert {f.name for f in kept_folder.iterdir()} == {f.name for f in folder.iterdir()} | {RECORD}
    for file in folder.iterdir():
        assert (kept_folder / file.name).read_bytes() == file.read_bytes(), file
    for fresh, stored in ((built, kept_built), (placement, kept_placement)):
        for name in fresh.__dataclass_fields__:
            a, b = (_number(getattr(x, name)) for x in (fresh, stored))
            assert name == "urdf" or np.array_equal(a, b), name


def _number(value):
    return value.matrix() if hasattr(value, "matrix") else value


def test_the_cache_is_not_asked_twice_for_two_different_objects():
    texts = {spec_text(find_spec("furniture-dev/drawer-004", seed)) for seed in (0, 1)}
    assert len(texts) == 2
    assert spec_text(find_spec("door", 0)) != spec_text(find_spec("door", 1))


def test_a_record_reads_back(tmp_path: Path):
    spec = find_spec("furniture-dev/drawer-004", 0)
    built, placement = stage(spec, FrankaKinematics())
    write_record(built.urdf.parent, built, placement)
    again, _ = read_record(built.urdf.parent, spec)
    assert again.view_low is built.view_low
    assert again.T_object_handle.equals(built.T_object_handle, 0.0)
