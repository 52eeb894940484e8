"""What a reader may type: every command, flag and import of README and of the site's pages."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import re
import shlex
import subprocess
from configparser import ConfigParser
from dataclasses import fields
from pathlib import Path

import pytest

from akm_fg.cli import main as cli

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    *sorted(p for p in (ROOT / "docs").rglob("*.md") if "_build" not in p.parts),
]
FENCE = re.compile(r"^( *)```(\w*)[^\n]*\n(.*?)^\1```", re.M | re.S)
INDENTED = re.compile(r"(?:\A|\n\n)((?: {4,}[^\n]*\n)+)")
COMMAND = re.compile(r"^\s*(?:\$ )?(?:\.venv/bin/)?((?:akm-fg|python -m|make|pip install) .*)$")


def blocks(text: str, language: str) -> list[str]:
    return [body for _, told, body in FENCE.findall(text) if told == language]


def lines_to_type(page: Path) -> list[str]:
    """Of blocks of code, fenced or indented, with lines that go on joined."""
    text = page.read_text()
    prose = FENCE.sub("\n", text)
    found = []
    for block in [*blocks(text, ""), *blocks(text, "bash"), *INDENTED.findall(prose)]:
        for line in block.replace("\\\n", " ").splitlines():
            match = COMMAND.match(line)
            found += [match[1]] if match else []
    return found


def words_of_code(page: Path) -> list[str]:
    """What stands in single quotes in the running text, commands without their folder."""
    prose = FENCE.sub("\n", page.read_text())
    found = [" ".join(code.split()) for code in re.findall(r"(?<!`)`([^`]+)`(?!`)", prose)]
    return [code.removeprefix(".venv/bin/") for code in found]


def typed(start: str) -> list[object]:
    """Each different line that begins so, with the page where it is met first."""
    found = {
        line: page.relative_to(ROOT)
        for page in reversed(PAGES)
        for line in [*lines_to_type(page), *(c for c in words_of_code(page) if "..." not in c)]
        if line.startswith(start) and not re.search(r"[|\[]", line)
    }
    return [pytest.param(line, id=f"{page}: {line}") for line, page in found.items()]


def flags_of(command: str) -> set[str]:
    kind = getattr(cli._module(command), f"{command.title()}Arguments")
    return {"--" + field.name.replace("_", "-") for field in fields(kind)}


def test_pages_and_commands_are_found() -> None:
    assert len(PAGES) > 30
    assert len(typed("akm-fg ")) > 60 and len(typed("python -m ")) > 10
    assert {"demo", "test"} <= {p.values[0].split()[1] for p in typed("make ")}


@pytest.mark.parametrize("line", typed("akm-fg "))
def test_a_command_is_one_that_the_program_takes(line: str, capfd: pytest.CaptureFixture) -> None:
    words = shlex.split(line, comments=True)[1:]
    if words == ["--version"] or words[:1] == ["--tyro-print-completion"]:
        return
    if words[-1].startswith("--"):  # of which the text speaks: its value is left open
        assert words[-1] in flags_of(words[0])
        words = words[:-1]
    if len(words) == 1:
        assert words[0] in cli._COMMANDS
        return
    try:
        cli.parsed(words)
    except SystemExit:
        pytest.fail(f"{line}\n{''.join(capfd.readouterr())}")


@pytest.mark.parametrize("line", typed("python -m "))
def test_an_experiment_exists_and_has_the_flags(line: str) -> None:
    module, *words = shlex.split(line, comments=True)[2:]
    if module.partition(".")[0] in ("experiments", "sim"):
        check_experiment(module, words)


def check_experiment(module: str, words: list[str]) -> None:
    found = importlib.util.find_spec(module)
    assert found is not None and found.origin is not None, f"there is no {module}"
    source = Path(found.origin).read_text()
    for word in words:
        assert not word.startswith("--") or f'"{word}"' in source, f"{module} has no {word}"


@pytest.mark.parametrize("line", typed("make "))
def test_a_target_of_make_exists(line: str) -> None:
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M)
    assert shlex.split(line, comments=True)[1] in targets


@pytest.mark.parametrize("line", typed("make "))
def test_what_a_target_of_make_types_can_be_typed(line: str) -> None:
    """`make test` itself is what CI runs, and `akm-fg demo` is run by test_typed_commands.py."""
    target = shlex.split(line, comments=True)[1]
    command = ["make", "-n", "--no-print-directory", target]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = re.findall(r"\.venv/bin/(.*)", done.stdout.replace("\\\n", " "))
    assert found, done.stdout
    for program, *words in map(shlex.split, found):
        if program == "akm-fg":
            cli.parsed(words)
        elif program == "python" and words[0] == "-m":
            assert importlib.util.find_spec(words[1]) is not None, f"there is no {words[1]}"
            if words[1].startswith("experiments."):
                check_experiment(words[1], words[2:])
        else:
            assert program in ("python", "ruff", "mypy"), program


@pytest.mark.parametrize("line", typed("pip install "))
def test_an_extra_exists(line: str) -> None:
    setup = ConfigParser()
    setup.read(ROOT / "setup.cfg")
    for names in re.findall(r"\[([\w,]+)\]", line):
        for name in names.split(","):
            assert name in setup["options.extras_require"]


def test_every_flag_in_the_text_is_one_of_some_command() -> None:
    known = {"--version", "--help"}
    for name in cli._COMMANDS:
        known |= flags_of(name)
    for room in ("experiments", "sim"):
        for file in (ROOT / room).rglob("*.py"):
            known |= set(re.findall(r'"(--[\w-]+)"', file.read_text()))
    for page in PAGES:
        for code in words_of_code(page):
            flag = re.match(r"--[\w-]+", code)
            assert flag is None or flag[0] in known, f"{page.name}: {code}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_python_of_a_page_is_python_and_its_imports_exist(page: Path) -> None:
    for block in blocks(page.read_text(), "python"):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.Import):
                for name in node.names:
                    importlib.import_module(name.name)
            elif isinstance(node, ast.ImportFrom) and node.module is not None:
                module = importlib.import_module(node.module)
                for name in node.names:
                    assert hasattr(module, name.name), f"{node.module} has no {name.name}"


def test_links_of_the_readme_lead_somewhere() -> None:
    links = re.findall(r"\]\(([^)#\s]+)", (ROOT / "README.md").read_text())
    assert len(links) > 5
    for link in links:
        assert link.startswith("https://") or (ROOT / link).exists(), link
