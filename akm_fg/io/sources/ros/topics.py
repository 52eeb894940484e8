"""Which topics of a bag are the colour and the depth of one camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from akm_fg.errors import InputError
from akm_fg.io.sources.ros.pictures import is_compressed, is_depth, lens_of_info
from akm_fg.io.sources.ros.transforms import frame_name
from akm_fg.io.sources.source import Lens

GOOD_COLOUR, BAD_COLOUR = ("color", "colour", "rgb"), ("infra", "/ir/", "left", "right", "fisheye")
GOOD_DEPTH, BAD_DEPTH = ("aligned", "registered", "rect"), ("confidence", "infra", "disparity")
REGISTERED = ("aligned_depth", "depth_registered", "registered/depth", "depth_to_rgb")


@dataclass(frozen=True, slots=True)
class PictureTopic:
    """A topic of pictures, and its first message."""

    topic: str
    first: Any
    number: int  # of messages

    @property
    def base(self) -> str:
        """Without what image_transport adds."""
        for added in ("/compressedDepth", "/compressed", "/theora"):
            if self.topic.endswith(added):
                return self.topic[: -len(added)]
        return self.topic

    @property
    def frame(self) -> str:
        """In which its pictures were taken."""
        return frame_name(self.first.header.frame_id)

    @property
    def rectified(self) -> bool:
        """Whether distortion was removed before."""
        return "rect" in self.base.rsplit("/", 1)[-1]

    @property
    def says_registered(self) -> bool:
        """Whether its name says that depth is at the colour's pixels."""
        return any(word in self.topic for word in REGISTERED)


def choose(
    path: Path, topics: Sequence[PictureTopic], depth: bool, said: str | None
) -> tuple[PictureTopic, tuple[str, ...]]:
    """The topic of colour or depth, and a note where there were several.

    Raises:
        InputError: there is none, or not the one that was said.
    """
    what = "depth" if depth else "colour"
    fits = [t for t in topics if is_depth(t.topic, t.first) is depth]
    names = ", ".join(t.topic for t in topics) or "no pictures at all"
    if said is not None:
        chosen = [t for t in topics if said in (t.topic, t.base)]
        if not chosen or is_depth(chosen[0].topic, chosen[0].first) is not depth:
            raise InputError(path, f"has no {what} topic {said!r}", f"one of {names}")
        return chosen[0], ()
    if not fits:
        raise InputError(path, f"has no {what} pictures", f"a topic of {what} (it holds {names})")
    good, bad = (GOOD_DEPTH, BAD_DEPTH) if depth else (GOOD_COLOUR, BAD_COLOUR)

    def merit(t: PictureTopic) -> tuple[int, int, bool, str]:
        name = t.topic.lower()
        words = sum(w in name for w in good) - 3 * sum(w in name for w in bad)
        return words, t.number, not is_compressed(t.first), t.topic

    ranked = sorted(fits, key=merit, reverse=True)
    others = sorted({t.base for t in ranked} - {ranked[0].base})
    if not others:
        return ranked[0], ()
    note = f"{what} taken from {ranked[0].topic}, not from {', '.join(others)} (--{what}-topic)"
    return ranked[0], (note,)


def lens_of_topic(
    path: Path, topic: PictureTopic, infos: Mapping[str, Any], size: tuple[int, int]
) -> Lens | None:
    """By the CameraInfo beside it, or that of the same frame and size; None if there is none.

    Raises:
        InputError: a CameraInfo that is not calibrated.
    """
    beside = topic.base.rsplit("/", 1)[0] + "/camera_info"
    names = [beside, f"{topic.base}/camera_info"]
    names += [
        name
        for name, info in sorted(infos.items())
        if frame_name(info.header.frame_id) == topic.frame
    ]
    for name in names:
        info = infos.get(name)
        if info is not None and (int(info.width), int(info.height)) == size:
            return lens_of_info(info, name, topic.rectified, path)
    return None
