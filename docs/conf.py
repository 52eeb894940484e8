"""Settings of the documentation site; `make docs` builds it into docs/_build/html."""

from __future__ import annotations

import importlib
import pkgutil
import re
from collections.abc import Iterator, Sequence
from typing import Any

import akm_fg

project = "akm-fg"
author = "the authors of akm-fg"
copyright = author
release = version = akm_fg.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "akm-fg"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False

myst_heading_anchors = 4  # `conventions.md#recording-folder` finds the heading, as on GitHub
highlight_language = "none"  # of blocks that do not say theirs

autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autodoc_type_aliases = {"FloatArray": "FloatArray", "BoolArray": "BoolArray", "Array": "Array"}
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 110
# A thousand entries in every page's table of contents would take longer than all else.
toc_object_entries = False

_CODE = re.compile(r"`+([^`]+)`+")
_MARKUP = re.compile(r"([*|\\]|(?<=\w)_(?!\w))")
_PAGE = re.compile(r"docs/(\w+)\.md")
_SECTION = re.compile(r"[A-Z]\w+:$", re.M)  # Args:, Raises:, ...


def restructured(docstring: str) -> Iterator[str]:
    """A docstring of ours, paragraph by paragraph, as reStructuredText.

    Ours are text with `code`, blocks that are indented and stand as they are, and Google's
    sections. Stars, bars and final underscores are what they look like, not markup.
    """
    in_section = in_block = False
    for paragraph in docstring.split("\n\n"):
        in_section = in_section or _SECTION.match(paragraph) is not None
        was_in_block, in_block = in_block, paragraph.startswith("    ") and not in_section
        if in_block:
            yield paragraph if was_in_block else f"::\n\n{paragraph}"
        elif paragraph.startswith("Returns:\n"):
            # Napoleon would take all before a colon for a type.
            yield _as_text(paragraph.replace("Returns:\n    ", ":returns: ", 1))
        else:
            yield _as_text(paragraph)


def _as_text(paragraph: str) -> str:
    pieces = _CODE.split(paragraph)
    text = [_MARKUP.sub(r"\\\1", piece) for piece in pieces[::2]]
    pieces[::2] = [_PAGE.sub(r":doc:`/\1`", piece) for piece in text]
    pieces[1::2] = [f"``{piece}``" for piece in pieces[1::2]]
    return "".join(pieces)


def _docstring(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    lines[:] = "\n\n".join(restructured("\n".join(lines))).split("\n")


def _modules(room: str, left_out: Sequence[str]) -> Iterator[str]:
    """All modules below a room, but those that are named."""
    path = importlib.import_module(room).__path__
    for module in pkgutil.walk_packages(path, f"{room}."):
        if not module.ispkg and module.name.removeprefix(f"{room}.") not in left_out:
            yield module.name


def _section(module: str) -> str:
    return f"## `{module}`\n\n```{{eval-rst}}\n.. automodule:: {module}\n```\n"


def _public_names() -> Iterator[str]:
    """What `akm_fg.__all__` names: functions as they are, and where its types stand."""
    found = {name: getattr(akm_fg, name) for name in akm_fg.__all__ if not name.startswith("_")}
    functions = [name for name, value in found.items() if not isinstance(value, type)]
    yield "```{eval-rst}"
    yield from (f".. autofunction:: akm_fg.{name}" for name in functions)
    yield "```\n\nTypes, by these names too:\n"
    for name, value in found.items():
        if isinstance(value, type):
            place = f"{value.__module__}.{value.__name__}"
            yield f"- {{py:class}}`akm_fg.{name} <{place}>`"


def _with_modules(app: Any, page: str, source: list[str]) -> None:
    """Puts a page's modules where a comment asks for them, so that none has to be listed."""
    text = source[0].replace("<!-- public names -->", "\n".join(_public_names()))
    text = re.sub(r"<!-- module (\S+) -->", lambda found: _section(found[1]), text)
    source[0] = re.sub(
        r"<!-- modules of (\S+)(?: but ([^>]*))? -->",
        lambda found: "\n".join(map(_section, _modules(found[1], (found[2] or "").split()))),
        text,
    )


def setup(app: Any) -> None:
    """Docstrings are made safe before napoleon (priority 500) reads their sections."""
    app.connect("source-read", _with_modules)
    app.connect("autodoc-process-docstring", _docstring, priority=400)
