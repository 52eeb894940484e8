"""akm-fg: active kinematic modelling of articulated objects as a factor graph.

    import akm_fg

    posterior = akm_fg.fit("my_cabinet")
    print(posterior.summary())

Importing this package is light; the rooms (`akm_fg.estimation`, `akm_fg.perception`,
`akm_fg.io`, ...) import what they need.
"""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from akm_fg.config import AkmConfig
    from akm_fg.io.read_options import LengthUnit, QuaternionOrder
    from akm_fg.model.records import ObjectModel
    from akm_fg.posterior import ArticulationPosterior
    from akm_fg.records import Recording

__version__ = "0.1.0"
__all__ = [
    "ArticulationPosterior",
    "ObjectModel",
    "Recording",
    "__version__",
    "fit",
    "model_schema",
    "posterior_schema",
    "read_model",
    "read_recording",
]


def fit(
    path: str | PathLike[str],
    *,
    seed: int = 0,
    frames: int | None = None,
    quaternion: QuaternionOrder | None = None,
    unit: LengthUnit | None = None,
    config: AkmConfig | None = None,
) -> ArticulationPosterior:
    """The joint of a recording (folder), of tracks (.npz) or of a pose log, as `akm-fg fit`.

    Args:
        path: of the input.
        seed: of whatever is sampled.
        frames: take so many from a recording's beginning; None: all.
        quaternion: order in a pose log, where it is not what the file's format says.
        unit: of positions in logs and tracks; None: found out from their size.
        config: all settings; the defaults if absent.

    Returns:
        Kind, axis, pivot and states, each with its uncertainty: `.summary()`, `.to_dict()`, and
        arrays in `.best.joint` and `.best.states`.

    Raises:
        InputError: the input is broken; the text says what is wrong and what is expected.
        InsufficientData: it is sound, but does not suffice.
    """
    from pathlib import Path

    from akm_fg.backends.registry import stages_of
    from akm_fg.config import AkmConfig
    from akm_fg.io.inputs import read_input
    from akm_fg.io.read_options import ReadOptions
    from akm_fg.pipeline import fit_input

    settings = config or AkmConfig()
    data = read_input(Path(path), frames, ReadOptions(quaternion, unit))
    stages = stages_of(settings)
    tuning = settings.fit, settings.perception, stages, settings.stream
    return fit_input(data, str(path), seed, *tuning)


def read_recording(path: str | PathLike[str]) -> Recording:
    """The frames of a recording in any format that `akm-fg convert` reads, without its truth.

    Args:
        path: of the recording's folder, or of its file.

    Raises:
        InputError: anything that is missing, damaged or contradicts itself, or no recording.
        MissingDependency: the library that reads its format is not installed.
    """
    from pathlib import Path

    from akm_fg.errors import InputError
    from akm_fg.io.inputs import read_input
    from akm_fg.records import Recording

    data = read_input(Path(path))
    if not isinstance(data, Recording):
        raise InputError(path, "holds no images", "a recording (akm_fg.fit takes tracks and logs)")
    return data


def read_model(path: str | PathLike[str]) -> ObjectModel:
    """The model of an object, as `fit --out` and explorations leave it (docs/model.md).

    Args:
        path: of `model.json`, or of the folder that holds it.

    Raises:
        InputError: missing, damaged, of another schema, or it contradicts itself.
    """
    from pathlib import Path

    from akm_fg.model.read import read_model as read

    return read(Path(path))


def posterior_schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a posterior: `akm_fg/schemas/posterior-1.schema.json`."""
    return _schema("posterior-1.schema.json")


def model_schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a model: `akm_fg/schemas/model-1.schema.json`."""
    return _schema("model-1.schema.json")


def _schema(file: str) -> dict[str, Any]:
    import json
    from importlib.resources import files

    text = files("akm_fg").joinpath("schemas", file).read_text("utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


def __getattr__(name: str) -> object:
    """The records' types, when they are asked for."""
    if name == "ArticulationPosterior":
        from akm_fg.posterior import ArticulationPosterior

        return ArticulationPosterior
    if name == "ObjectModel":
        from akm_fg.model.records import ObjectModel

        return ObjectModel
    if name == "Recording":
        from akm_fg.records import Recording

        return Recording
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
