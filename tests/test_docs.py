"""The documentation keeps its promises: every command and every code block in it is run."""

from __future__ import annotations

import ast
import contextlib
import io
import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import NamedTuple

import pytest

from patu.main import COMMANDS, run

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = sorted(p for p in DOCS.rglob("*.md"))
FENCE = re.compile(r"^```(?P<kind>\w*)(?: title=\"(?P<title>[^\"]+)\")?\n(?P<body>.*?)^```$", re.MULTILINE | re.DOTALL)
#: fences that are shown and not run, such as equations
SHOWN = ("text",)
#: commands that share a search among processes, which start for seconds; here each core has tests of its own, and
#: `patu demo` searches in processes in tests/test_cli_runs.py
SEARCHES = ("diagnose", "improve", "learn")


class Block(NamedTuple):
    """One fenced block of a page."""

    kind: str
    title: str | None
    body: str
    line: int


def blocks(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    return [
        Block(m["kind"], m["title"], m["body"], text[: m.start()].count("\n") + 1)
        for m in FENCE.finditer(text)
        if m["kind"] not in SHOWN
    ]


def page_id(page: Path) -> str:
    return str(page.relative_to(DOCS))


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p)], ids=page_id)
def test_what_a_page_says_works(page, tmp_path, monkeypatch):
    """Blocks run one after the other in one empty folder; Python blocks of a page share their names."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "__main__"}
    for block in blocks(page):
        where = f"{page_id(page)}, line {block.line}"
        if block.title is not None:
            name, more, _ = block.title.partition(", continued")
            with Path(name).open("a" if more else "w", encoding="utf-8") as file:
                file.write(block.body)
        elif block.kind == "python":
            exec(compile(block.body, where, "exec"), names)
        elif block.kind == "console":
            run_console(block, where)
        else:
            assert block.kind == "sh", f"{where}: blocks of {block.kind!r} are not run; write console, python or text"


def run_console(block: Block, where: str) -> None:
    """Run the lines that start with "$ "; the lines below each must be in what it prints, numbers aside."""
    for part in re.split(r"^\$ ", block.body, flags=re.MULTILINE)[1:]:
        line, _, expected = part.partition("\n")
        status, said = call(shlex.split(line))
        assert status == 0, f"{where}: `{line}` ended with {status}:\n{said}"
        for wanted in filter(None, expected.splitlines()):
            assert without_numbers(wanted) in without_numbers(said), (
                f"{where}: `{line}` does not print {wanted!r}:\n{said}"
            )


def call(words: list[str]) -> tuple[int, str]:
    """Return exit status and output of a command; a new process only where an effect of one's own has to be compiled
    in.
    """
    if "--effects" in words:
        command = [sys.executable, "-m", *words]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return done.returncode, done.stdout + done.stderr
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), pytest.raises(SystemExit) as leaving:
        if words[0] == "python":
            runpy.run_path(*words[1:], run_name="__main__")
            sys.exit()
        assert words[0] == "patu", f"{words[0]} is not known to this test"
        run([*words[1:], *(("--jobs", "1") if words[1] in SEARCHES else ())])
    return leaving.value.code or 0, said.getvalue()


def without_numbers(text: str) -> str:
    return re.sub(r"[-−]?\d[\d.]*(e[-+]?\d+)?", "#", " ".join(text.split()))


def test_files_that_the_readme_types_are_written_before(patu, tmp_path, monkeypatch):
    """Every file that a line of the README reads comes from `patu sample`, or from a line above it."""
    monkeypatch.chdir(tmp_path)
    first, *lines = re.findall(r"^    patu ((?:sample|.*play/).*)", (ROOT / "README.md").read_text(), re.MULTILINE)
    patu(*shlex.split(first, comments=True))
    written = set()
    for words in (shlex.split(line, comments=True) for line in lines):
        files = {word for word in words if "/" in word or "." in word}
        written |= {words[words.index("-o") + 1]} if "-o" in words else set()
        assert all((tmp_path / file).is_file() or file in written for file in files), words
    assert len(lines) > 4


def test_shell_lines_name_what_exists():
    """Lines that install something are not run; what they name must be there."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for page in PAGES:
        for block in blocks(page):
            for line in block.body.splitlines() if block.kind == "sh" else ():
                installs = re.fullmatch(r"pip install '?(?:\.|crane-exudyn)(?:\[(\w+)\])?'?", line)
                makes = re.fullmatch(r"make (\w+)", line)
                assert (installs and (installs[1] is None or installs[1] in extras)) or (
                    makes and makes[1] in targets
                ), line


def test_commands_named_in_running_text_exist():
    for page in PAGES:
        for name, options in re.findall(r"`patu (\w+)([^`]*)`", page.read_text()):
            assert name in COMMANDS, f"{page_id(page)}: patu {name}"
            assert "\t" not in options


def test_every_page_is_in_the_navigation_and_every_picture_there():
    navigation = (ROOT / "mkdocs.yml").read_text()
    for page in PAGES:
        assert page_id(page) in navigation, page_id(page)
        for link in re.findall(r"\]\((?!http|#)([^)#]+)", page.read_text()):
            assert (page.parent / link).exists(), f"{page_id(page)}: {link}"


def test_api_reference_names_what_exists():
    import importlib

    for name in re.findall(r"^::: (\S+)$", (DOCS / "api.md").read_text(), re.MULTILINE):
        try:
            found = importlib.import_module(name)
        except ModuleNotFoundError:
            module, _, attribute = name.rpartition(".")
            found = getattr(importlib.import_module(module), attribute)
        assert found.__doc__, name


def test_sketches_are_those_of_the_crane_file(tmp_path):
    """The sketches are drawn from the crane file; drawn again they are the same but for the date."""
    subprocess.run([sys.executable, DOCS / "make_sketches.py", tmp_path], check=True)
    for name in ("crane.svg", "cylinder.svg"):
        old, new = (re.findall(r'<g id="(\w+)">', (f / name).read_text()) for f in (DOCS / "images", tmp_path))
        assert old == new  # what is drawn; the glyphs of its texts depend on the machine's fonts
        assert len(new) > 20


def test_python_blocks_are_formatted_as_code_is():
    for page in PAGES:
        for block in blocks(page):
            if block.kind == "python":
                ast.parse(block.body)
                assert all(len(line) <= 120 for line in block.body.splitlines()), f"{page_id(page)}, line {block.line}"


def test_the_site_is_built_without_a_warning(tmp_path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    pages = list((tmp_path / "site").rglob("*.html"))
    assert len(pages) > len(PAGES)
    for page in pages:  # nothing is fetched from elsewhere
        assert not re.search(
            r"<(script|link|img)[^>]*(src|href)=\"?https?://(?!(localhost|example))", page.read_text()
        ), page


def test_names_of_the_python_interface_are_what_they_say_in_any_order():
    """No function has the name of a module of its package, which would take its place once it is imported."""
    for first in ("import validation.comparison", "import patu.compare, patu.diagnose"):
        code = f"{first}\nfrom validation import compare, diagnose, improve, learn\nfrom ukf import Estimator\n"
        code += "from crane_exudyn import Crane, Recording, simulate\n"
        code += "assert all(map(callable, (compare, diagnose, improve, learn, Estimator, Crane, Recording, simulate)))"
        subprocess.run([sys.executable, "-c", code], check=True)
