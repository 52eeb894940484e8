"""`pyrealsense2`, loaded with the library that its wheel is linked to and does not bring.

librealsense needs libusb, which no fresh Linux has to have. `libusb-package` brings a build of it;
loaded first, under the same name, it is the one that the linker takes. A library of the system is
taken before it.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
from types import ModuleType

from akm_fg.errors import MissingDependency

LIBUSB = "libusb-1.0.so.0"


def load_librealsense(purpose: str, extra: str) -> ModuleType:
    """The module `pyrealsense2`.

    Args:
        purpose: what needs it, first in the message.
        extra: of akm-fg, that installs it.

    Raises:
        MissingDependency: it is not installed, or does not load.
    """
    if importlib.util.find_spec("pyrealsense2") is None:
        needs = f"{purpose} needs pyrealsense2, which is not installed"
        raise MissingDependency(f"{needs}; install akm-fg[{extra}]")
    provide_libusb()
    try:
        return importlib.import_module("pyrealsense2")
    except (ImportError, OSError) as error:
        why = str(error).splitlines()[0]
        needs = f"{purpose} needs pyrealsense2, which does not load: {why}"
        raise MissingDependency(f"{needs}; install akm-fg[{extra}] anew") from error


def provide_libusb() -> None:
    """Load libusb: the system's, or that of `libusb-package`; nothing where there is neither."""
    try:
        ctypes.CDLL(LIBUSB)
    except OSError:
        if importlib.util.find_spec("libusb_package") is not None:
            path = importlib.import_module("libusb_package").get_library_path()
            if path is not None:
                ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
