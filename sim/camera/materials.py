"""How shiny a drawn surface is, by what its files are called.

An MTL's own Ks is not asked: exporters write one and the same for everything.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

# Share of the light that leaves a surface in the mirror direction instead of being scattered, by
# words in the names of its mesh, texture and materials. Classes, not measurements: satin metal
# scatters some of the light, polish and glass hardly any. A handle is metal or lacquer.
SPECULAR = {
    "mirror": 0.95,
    "chrome": 0.95,
    "glass": 0.9,
    "window": 0.9,
    "metal": 0.6,
    "steel": 0.6,
    "brushed": 0.6,
    "handle": 0.6,
}
MATT = 0.0


@cache
def specular_of(mesh: str) -> float:
    """Specular share 0..1 of a mesh file: the most that its name or its MTL's names say.

    An empty name, that of a primitive, is matt.
    """
    if not mesh:
        return MATT
    path = Path(mesh)
    names = [path.stem]
    try:
        text = path.with_suffix(".mtl").read_text(encoding="utf-8", errors="replace")
    except OSError:
        text = ""  # a mesh without materials
    for line in text.splitlines():
        key, *values = line.split() or [""]
        if key in ("newmtl", "map_Kd") and values:
            names.append(Path(values[-1]).stem)
    return max(_by_name(name.lower()) for name in names)


def _by_name(name: str) -> float:
    return max((share for word, share in SPECULAR.items() if word in name), default=MATT)
