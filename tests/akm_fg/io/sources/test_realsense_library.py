"""librealsense and the library it is linked to: found, brought along, or said to be missing."""

from __future__ import annotations

import ctypes
import importlib

import pytest

from akm_fg.errors import MissingDependency
from akm_fg.io.sources.realsense import library
from akm_fg.io.sources.realsense.library import load_librealsense, provide_libusb

PURPOSE = "a.bag: reading it"


@pytest.fixture
def loaded(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is loaded of libraries; the system has none."""
    names: list[str] = []

    def load(name: str, mode: int = 0) -> None:
        if name == library.LIBUSB:
            raise OSError("cannot open shared object file")
        assert mode == ctypes.RTLD_GLOBAL
        names.append(name)

    monkeypatch.setattr(library.ctypes, "CDLL", load)
    return names


def test_where_the_system_has_no_libusb_the_packages_is_loaded(loaded: list[str]) -> None:
    package = pytest.importorskip("libusb_package")
    provide_libusb()
    assert loaded == [str(package.get_library_path())]


def test_where_there_is_none_at_all_nothing_is_loaded(
    loaded: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(library.importlib.util, "find_spec", lambda _: None)
    provide_libusb()
    assert not loaded
    with pytest.raises(MissingDependency, match=r"not installed; install akm-fg\[realsense\]"):
        load_librealsense(PURPOSE, "realsense")


def test_what_does_not_load_is_said_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(name: str) -> None:
        raise ImportError("libusb-1.0.so.0: cannot open shared object file\nand more")

    monkeypatch.setattr(library, "provide_libusb", lambda: None)
    monkeypatch.setattr(library.importlib.util, "find_spec", lambda _: object())
    monkeypatch.setattr(library.importlib, "import_module", broken)
    with pytest.raises(MissingDependency) as raised:
        load_librealsense(PURPOSE, "realsense")
    assert str(raised.value) == (
        "a.bag: reading it needs pyrealsense2, which does not load: libusb-1.0.so.0: cannot open "
        "shared object file; install akm-fg[realsense] anew"
    )


def test_it_loads_here() -> None:
    pytest.importorskip("pyrealsense2")
    assert load_librealsense(PURPOSE, "realsense") is importlib.import_module("pyrealsense2")
