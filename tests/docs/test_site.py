"""The documentation site, built as `make docs` builds it."""

from __future__ import annotations

import importlib
import pkgutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

import akm_fg

ROOT = Path(__file__).resolve().parents[2]
ROOMS = {
    "factors": "reference/factors.html",
    "akm_fg.exploration": "reference/exploration.html",
    "akm_fg.relocalization": "reference/relocalization.html",
    "akm_fg.arm": "reference/arm.html",
}
# Pictures of reports and results as JSON: what a person reads is documented elsewhere.
LEFT_OUT = {"page", "explore_json", "belief_picture", "stretch_plot", "processor_time"}


class Links(HTMLParser):
    """What a page points at, and what can be pointed at in it."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.anchors: set[str] = set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        for name, value in attributes:
            if name == "id" and value:
                self.anchors.add(value)
            if name in ("href", "src") and value:
                self.targets.append(value)


def test_the_site_builds_without_a_warning_and_its_links_lead_somewhere(tmp_path: Path) -> None:
    for package in ("sphinx", "furo", "myst_parser"):
        pytest.importorskip(package)
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "docs", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    pages = {page: Links(page) for page in tmp_path.rglob("*.html")}
    assert len(pages) > 40
    broken = []
    for page, links in pages.items():
        for target in links.targets:
            url = urlsplit(target)
            if url.scheme or url.netloc:
                continue
            place = (page.parent / unquote(url.path)).resolve() if url.path else page
            if not place.exists():
                broken.append(f"{page.name}: {target}")
            elif url.fragment and place in pages:
                if unquote(url.fragment) not in pages[place].anchors:
                    broken.append(f"{page.name}: {target} has no such place")
    assert not broken, "\n".join(sorted(set(broken)))
    public = pages[tmp_path / "reference" / "public.html"]
    functions = {name for name in akm_fg.__all__ if name[0].islower()}
    types = {getattr(akm_fg, name) for name in set(akm_fg.__all__) - functions if name[0].isupper()}
    assert {f"akm_fg.{name}" for name in functions} <= public.anchors
    assert {f"{kind.__module__}.{kind.__name__}" for kind in types} <= public.anchors
    for room, page in ROOMS.items():
        path = importlib.import_module(room).__path__
        modules = {m.name for m in pkgutil.walk_packages(path, f"{room}.") if not m.ispkg}
        missing = modules - {a.removeprefix("module-") for a in pages[tmp_path / page].anchors}
        assert {m.rpartition(".")[2] for m in missing} <= LEFT_OUT
