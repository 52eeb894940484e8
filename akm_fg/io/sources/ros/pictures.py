"""Pictures and cameras of ROS messages.

sensor_msgs/Image and CompressedImage as REP 118 and `image_transport` write them: depth as 16UC1
in millimetres or 32FC1 in metres; compressed depth is a PNG after twelve bytes of header, of
inverse depth A / (v - B) where it stands for 32FC1.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from akm_fg.errors import InputError
from akm_fg.io.png import MAX_PIXELS
from akm_fg.io.sources.pictures import colour_of, depth_of
from akm_fg.io.sources.source import Lens, RawDepth
from akm_fg.records import PinholeCamera

COLOUR = {  # encoding: channels, and how OpenCV makes RGB of it
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "8UC3": (3, cv2.COLOR_BGR2RGB),
    "8UC1": (1, cv2.COLOR_GRAY2RGB),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2RGB),
}
DEPTH = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
CONFIG_BYTES = 12  # format (int32), A and B (float32) before a compressed depth PNG
BROWN = ("plumb_bob", "rational_polynomial", "")
FISHEYE = ("equidistant", "fisheye")


def is_compressed(message: Any) -> bool:
    """Whether it is a CompressedImage."""
    return hasattr(message, "format")


def is_depth(topic: str, message: Any) -> bool | None:
    """What a picture message shows; None where it is neither colour nor depth."""
    if is_compressed(message):
        told = f"{topic} {message.format}".lower()
        return "compresseddepth" in told or "16uc1" in told or "32fc1" in told
    if message.encoding in DEPTH:
        return True
    return False if message.encoding in COLOUR else None


def whole_units(message: Any) -> bool:
    """Whether depth is counted in millimetres."""
    told = message.format if is_compressed(message) else message.encoding
    return "32FC1" not in told


def colour_image(message: Any, place: Path) -> NDArray[np.uint8]:
    """RGB (H, W, 3).

    Raises:
        InputError: damaged, or of an encoding that is not known.
    """
    if is_compressed(message):
        return colour_of(bytes(message.data), place)
    channels, how = COLOUR[message.encoding]
    image = _pixels(message, np.dtype("u1"), channels, place)
    if how is None:
        return np.ascontiguousarray(image)
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), how), dtype=np.uint8)


def depth_image(message: Any, place: Path) -> RawDepth:
    """Depth (H, W): millimetres of 16 bits, or metres.

    Raises:
        InputError: damaged, or of an encoding that is not known.
    """
    if not is_compressed(message):
        dtype = np.dtype((">" if message.is_bigendian else "<") + DEPTH[message.encoding])
        return _pixels(message, dtype, 1, place)[..., 0].astype(dtype.newbyteorder("="))
    data = bytes(message.data)
    if "rvl" in message.format.lower():
        raise InputError(place, "holds depth compressed by RVL", "compressed as PNG, or raw")
    if "compresseddepth" not in message.format.lower():
        return depth_of(data, place)
    if len(data) <= CONFIG_BYTES:
        raise InputError(place, f"holds a depth picture of {len(data)} bytes", "a header and a PNG")
    raw = depth_of(data[CONFIG_BYTES:], place)
    if whole_units(message):
        return raw
    _, A, B = struct.unpack_from("<iff", data)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(raw > 0, A / (raw.astype(np.float64) - B), np.nan).astype(np.float32)


def _pixels(message: Any, dtype: np.dtype, channels: int, place: Path) -> NDArray[Any]:
    """(H, W, channels) of an uncompressed picture."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    if not 0 < height * width <= MAX_PIXELS:
        raise InputError(place, f"claims {width}x{height} pixels", f"1 to {MAX_PIXELS}")
    row, data = width * channels * dtype.itemsize, np.asarray(message.data, dtype=np.uint8)
    if step < row or len(data) < height * step:
        problem = f"holds a picture of {width}x{height} in {len(data)} bytes, {step} a row"
        raise InputError(place, problem, f"{height} rows of at least {row} bytes")
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row])
    return rows.view(dtype).reshape(height, width, channels)


def lens_of_info(info: Any, topic: str, rectified: bool, place: Path) -> Lens:
    """Of a CameraInfo; of pictures that are rectified already, its P, without distortion.

    Raises:
        InputError: it is not calibrated, or of a distortion that is not known.
    """
    K = np.asarray(info.k if hasattr(info, "k") else info.K, dtype=np.float64)
    P = np.asarray(info.p if hasattr(info, "p") else info.P, dtype=np.float64)
    D = np.asarray(info.d if hasattr(info, "d") else info.D, dtype=np.float64)
    use_P = rectified and P.size == 12 and P[0] > 0
    fx, fy, cx, cy = (P[0], P[5], P[2], P[6]) if use_P else (K[0], K[4], K[2], K[5])
    try:
        camera = PinholeCamera(
            int(info.width), int(info.height), float(fx), float(fy), float(cx), float(cy)
        )
    except ValueError as e:
        raise InputError(place, f"{topic}: {e}", "a calibrated camera (K with fx, fy > 0)") from e
    if rectified or not D.any():
        return Lens(camera)
    model = str(info.distortion_model)
    known = (model in BROWN and D.size in (4, 5, 8, 12, 14)) or (model in FISHEYE and D.size == 4)
    if not (known and np.isfinite(D).all()):
        problem = f"{topic}: distortion {model!r} with {D.size} coefficients"
        raise InputError(place, problem, "plumb_bob, rational_polynomial or equidistant")
    return Lens(camera, tuple(float(d) for d in D), model in FISHEYE)
