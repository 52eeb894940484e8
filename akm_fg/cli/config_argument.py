"""`--config FILE`, and the flags that name stages: one tree, which every run writes beside its own.

What a flag says goes before what the file says, and that before the defaults.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from akm_fg import __version__
from akm_fg.config import AkmConfig
from akm_fg.io.config_file import read_config, write_config

Tree = TypeVar("Tree", bound=AkmConfig)

# Tables of the tree that belong to one kind of command, and are left alone by the others.
SIMULATOR, HARDWARE = "sim", "hardware"
CONFIG = "config.toml"  # all settings of a run, in its folder
SUFFIX = ".config.toml"  # added to the name of a file of results


def chosen_config(
    default: Tree, path: Path | None, tracker: str | None = None, segmenter: str | None = None
) -> Tree:
    """The tree that a command works with.

    Args:
        default: without file and flags.
        path: `--config`.
        tracker: `--tracker`.
        segmenter: `--segmenter`.

    Raises:
        InputError: a file that cannot be used, see `akm_fg.io.config_file.read_config`.
    """
    others = tuple(name for name in (SIMULATOR, HARDWARE) if not hasattr(default, name))
    config = default if path is None else read_config(path, default, others)
    named = config.stages
    stages = replace(
        named, tracker=tracker or named.tracker, segmenter=segmenter or named.segmenter
    )
    return replace(config, stages=stages)


def write_beside(results: str | None, config: AkmConfig) -> None:
    """Write the tree beside a file of results; nothing beside standard output.

    Raises:
        OutputError: the disk refuses.
    """
    if results is not None and results != "-" and not _is_device(Path(results)):
        write_tree(Path(results + SUFFIX), config, f"All settings behind {results}.")


def _is_device(path: Path) -> bool:
    return path.exists() and not path.is_file()


def write_tree(path: Path, config: AkmConfig, of_what: str) -> None:
    """Write the whole tree under a line that says of what it is.

    Raises:
        OutputError: the disk refuses.
    """
    write_config(path, config, (of_what, f"akm-fg {__version__}; use again: --config {path}"))
