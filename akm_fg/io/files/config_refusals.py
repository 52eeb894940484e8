"""What is said of a configuration that cannot be used: one line, with the key and what to write."""

from __future__ import annotations

import dataclasses
import difflib
import json
import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

from akm_fg.errors import InputError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

NONE = "none"  # what stands for None in a file
NEAR_NAMES = 3  # suggested at most, where a name is not known
SHOWN = 60  # characters of a value that is refused
WANTED = {  # pydantic's names of errors -> what is expected instead
    "float_type": "a number",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "string_type": "text in quotes",
    "tuple_type": "a list in brackets",
    "dataclass_type": "a table of settings",
    "dict_type": "a table of settings",
}


def at(place: str, keys: tuple[str, ...], given: Any) -> str:
    """Where in which file something was given, and what."""
    text = json.dumps(NONE if given is None else given, default=str)
    shown = text if len(text) <= SHOWN else f"{text[:SHOWN]}..."
    return f"{place}: {'.'.join(keys)} = {shown}"


def unknown(
    place: str, keys: tuple[str, ...], given: Any, default: DataclassInstance
) -> InputError:
    """The name is not in the tree: say what is like it, or else what is there."""
    wanted, known = ".".join(keys), sorted(_names(type(default), default))
    tables = {name.rpartition(".")[0] for name in known}
    like = [name for name in known if (name in tables) == isinstance(given, dict)]
    near = [name for name in like if name.split(".")[-1] == keys[-1]]  # elsewhere in the tree
    near += [
        name for name in difflib.get_close_matches(wanted, like, NEAR_NAMES) if name not in near
    ]
    above = "".join(f"{key}." for key in keys[:-1])
    beside = [name for name in known if re.fullmatch(rf"{re.escape(above)}[^.]+", name)]
    expected = " or ".join(near[:NEAR_NAMES]) or f"one of {', '.join(beside)}"
    return InputError(at(place, keys, given), "is no setting", expected)


def refused(
    place: str, error: Mapping[str, Any], changes: Mapping[str, Any], default: DataclassInstance
) -> InputError:
    """The line for one of pydantic's errors, whose path begins inside a tuple of one tree."""
    kind, given = error["type"], error["input"]
    keys = tuple(str(key) for key in error["loc"][1:])
    if kind == "unexpected_keyword_argument":
        return unknown(place, keys, given, default)
    if kind == "value_error":  # a dataclass' own check: it saw all its fields, the file set some
        below: Any = changes
        for key in keys:
            below = below[key]
        said = ", ".join(at("", (*keys, *path), value)[2:] for path, value in _leaves(below))
        words = re.split(r"[,;:]? expected ", str(error["ctx"]["error"]), maxsplit=1)
        wanted = words[1] if len(words) > 1 else "a value that is allowed"
        return InputError(f"{place}: {said}", words[0], wanted)
    if kind == "literal_error":
        return InputError(at(place, keys, given), "is no choice", error["ctx"]["expected"])
    if kind == "too_long":
        wanted = f"a list of {error['ctx']['max_length']}"
        return InputError(at(place, keys, given), "is too long", wanted)
    if kind == "missing":  # an entry of a list, whose number ends the path
        return InputError(at(place, keys[:-1], given), "is too short", f"an entry {keys[-1]}")
    return InputError(at(place, keys, given), "is of the wrong type", WANTED.get(kind, kind))


def _leaves(tree: Any, above: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    if not isinstance(tree, dict):
        yield above, tree
        return
    for key, value in tree.items():
        yield from _leaves(value, (*above, key))


def _names(cls: type, value: Any, above: tuple[str, ...] = ()) -> Iterator[str]:
    """Dotted names of all that can be set, those of tables that are absent by default too."""
    hints = get_type_hints(cls)
    for field in dataclasses.fields(cls):
        keys = (*above, field.name)
        yield ".".join(keys)
        below, hint = getattr(value, field.name, None), hints[field.name]
        nested = [each for each in (hint, *get_args(hint)) if _is_config(each)]
        if nested:
            yield from _names(nested[0], below, keys)
        elif isinstance(below, dict):
            yield from (".".join((*keys, *path)) for path, _ in _leaves(below) if path)


def _is_config(hint: Any) -> bool:
    return isinstance(hint, type) and dataclasses.is_dataclass(hint)
