"""Trees of frozen dataclasses as TOML: any leaf set by its dotted path, the whole tree written.

A file holds what differs from the defaults, as tables or as dotted keys (`fit.dof = 4.0`). TOML
has no null: None is written "none". pydantic checks types and lets each dataclass check itself.
"""

from __future__ import annotations

import dataclasses
import json
import math
import tomllib
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from akm_fg.errors import InputError
from akm_fg.io.files.config_refusals import NONE, at, refused, unknown
from akm_fg.io.png import replace_file

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    Tree = TypeVar("Tree", bound=DataclassInstance)


def read_config(path: Path, default: Tree, others: Collection[str] = ()) -> Tree:
    """The default tree with what a file changes.

    Args:
        path: of the TOML file.
        default: the tree; its values are kept where the file says nothing.
        others: top-level tables that are other commands' and left alone.

    Raises:
        InputError: no such file, no TOML, a name that is not in the tree, or a value that is of
            the wrong type or refused by its dataclass. It names the key, what was given and what
            is expected.
    """
    try:
        given = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", "a TOML file") from error
    except ValueError as error:  # not UTF-8, or not TOML: the error says where
        raise InputError(path, f"is not TOML: {error}", "lines such as fit.dof = 4.0") from error
    except RecursionError as error:
        raise _too_deep(path) from error
    try:
        return with_changes(default, {k: v for k, v in given.items() if k not in others}, str(path))
    except RecursionError as error:
        raise _too_deep(path) from error


def _too_deep(path: Path) -> InputError:
    return InputError(path, "is nested too deeply", "lines such as fit.dof = 4.0")


def with_changes(default: Tree, changes: Mapping[str, Any], place: str) -> Tree:
    """The default tree with nested changes; `place` is where they were written, for messages.

    Raises:
        InputError: as `read_config`.
    """
    from pydantic import ConfigDict, TypeAdapter, ValidationError

    merged = _merged(dataclasses.asdict(default), changes, place, default)
    # A tuple around it: pydantic takes settings from around a dataclass, not for one.
    around: Any = tuple[type(default)]  # type: ignore[misc]
    adapter = TypeAdapter(around, config=ConfigDict(extra="forbid", strict=True))
    try:
        (tree,) = adapter.validate_json(json.dumps([merged], default=str))
    except ValidationError as error:
        raise refused(place, error.errors(include_url=False)[0], changes, default) from error
    return tree  # type: ignore[no-any-return]


def config_as_dict(config: DataclassInstance) -> dict[str, Any]:
    """The whole tree as TOML and JSON can hold it: tuples as lists, None as "none"."""
    return {key: _plain(value) for key, value in dataclasses.asdict(config).items()}


def config_as_toml(config: DataclassInstance, heading: Iterable[str] = ()) -> str:
    """The whole tree as a file that `read_config` reads back to the last digit.

    Args:
        config: the tree.
        heading: lines of comment above it.
    """
    import tomli_w

    lines = "".join(f"# {line}\n" for line in heading)
    return f"{lines}\n{tomli_w.dumps(config_as_dict(config))}"


def write_config(path: Path, config: DataclassInstance, heading: Iterable[str] = ()) -> None:
    """Write the whole tree in one step, see `config_as_toml`.

    Raises:
        OutputError: the disk refuses.
    """
    replace_file(path, config_as_toml(config, heading).encode())


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    return NONE if value is None else value


def _merged(
    base: Mapping[str, Any],
    changes: Mapping[str, Any],
    place: str,
    default: DataclassInstance,
    above: tuple[str, ...] = (),
) -> dict[str, Any]:
    """The tree as dictionaries, changes put in; names that it does not have are refused."""
    out = dict(base)
    for key, value in changes.items():
        keys = (*above, key)
        if base and key not in base:
            raise unknown(place, keys, value, default)
        known = base.get(key)
        if isinstance(known, dict) and isinstance(value, dict):
            out[key] = _merged(known, value, place, default, keys)
        else:
            out[key] = _leaf(known, value, place, keys)
    return out


def _leaf(known: Any, value: Any, place: str, keys: tuple[str, ...]) -> Any:
    if isinstance(value, dict):
        return {key: _leaf(None, item, place, (*keys, key)) for key, item in value.items()}
    if isinstance(value, list):
        return [_leaf(None, item, place, keys) for item in value]
    if isinstance(value, float) and math.isnan(value):
        raise InputError(at(place, keys, value), "is no value", "a number")
    return None if value == NONE and not isinstance(known, str) else value
