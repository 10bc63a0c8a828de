"""What the pages show: Python runs and prints what stands below it, commands and their options exist."""

from __future__ import annotations

import ast
import functools
import importlib.util
import re
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest
import typer.main
from command_line import run

import capsbayes
from capsbayes.cli import app
from evidence.pages import NUMBER, blocks, lines_of, width_of

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "evidence").rglob("*.md"))]
RUN = ("one-capsule.md", "many-capsules.md", "measuring.md")
"""Pages whose Python is run as a script, from a folder with the examples."""
PRINTED = (
    "index.md",
    "measuring.md",
    "membrane.md: identify",
    "one-capsule.md",
    "many-capsules.md",
    pytest.param("planning.md", marks=pytest.mark.slow),
    pytest.param("diagnosing.md", marks=pytest.mark.slow),
    pytest.param("membrane.md: membrane", marks=pytest.mark.slow),
)
"""Pages that show what their commands print, or of which one command does, after the colon."""
MARK = "-- next block --"

OWN = (("FOLDER/", "a published picture, which is not part of the library"), ("tube.toml", "stands above on the page"))
"""What the reader of docs/real-capsule.md has to bring."""
PATH = re.compile(r"[\w.-]+/[\w./-]*|[\w./-]+\.(?:toml|csv|nc|png|avi|rtdc|py|html)")
"""A word of a command that names a file or a folder."""


def commands():
    """Page and words of every ``capsbayes ...`` in a shell block."""
    for page in PAGES:
        for language, text in blocks(page):
            for words in lines_of(text) if language == "sh" else ():
                if "capsbayes" in words:
                    yield pytest.param(words[words.index("capsbayes") + 1 :], id=f"{page.name}: {' '.join(words)[:60]}")


@pytest.mark.parametrize("words", list(commands()))
def test_commands_and_options_on_the_pages_exist(words):
    command, rest = typer.main.get_command(app), iter(words)
    while hasattr(command, "commands"):
        command = command.commands[next(rest)]
    known = {name for parameter in command.params for name in parameter.opts}
    assert {word for word in words if word.startswith("--")} <= known | {"--help"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_the_files_that_commands_read_are_in_the_project_or_written_by_a_command_before(page):
    made = [word for word, _ in OWN]
    for language, text in blocks(page):
        for words in lines_of(text) if language == "sh" else ():
            named = {word for word in words if PATH.fullmatch(word)}
            written = {after for word, after in pairwise(words) if word in ("--out", "--plot", "-m", "--table")}
            for name in named - written:
                there = (ROOT / name).exists() or any(name.startswith(folder) for folder in made)
                assert there or name.startswith(".venv/"), f"{page.name}: {name}"
            made += written


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_what_a_page_imports_and_the_modules_that_it_runs_exist(page):
    for module in re.findall(r"python -m (evidence(?:\.[a-z_]+)*)", page.read_text()):
        assert importlib.util.find_spec(module), module
    for language, text in blocks(page):
        for node in ast.walk(ast.parse(text)) if language == "python" else ():
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("capsbayes"):
                module = importlib.import_module(node.module)
                assert all(hasattr(module, name.name) for name in node.names), node.module


@pytest.mark.parametrize("name", PRINTED)
def test_a_page_shows_what_its_commands_print(name, scripted, tmp_path, monkeypatch, capsys):
    """Each shell block followed by a text block, and the scripts and sets that make the input of the next one."""
    name, _, only = name.partition(": ")
    printed_by = work_in(tmp_path, monkeypatch, scripted(name))
    shown, compared = blocks(ROOT / "docs" / name), 0
    for (language, text), (after, printed) in pairwise([*shown, ("", "")]):
        if language != "sh":
            continue
        for words in lines_of(text):
            if words[0] == "python":
                out = printed_by[tuple(words)]
            elif only and words[1] != only:
                continue
            elif words[0] == "capsbayes" and (after == "text" or words[1] == "hide"):
                monkeypatch.setenv("COLUMNS", width_of(printed))
                _, out, _ = run(monkeypatch, capsys, *words[1:])
            else:
                continue
            if after == "text":
                contains(out, printed)
                compared += 1
    assert compared


@pytest.mark.parametrize("name", RUN)
def test_the_python_of_a_page_runs_as_a_script_and_prints_what_stands_below_it(name, scripted, tmp_path, monkeypatch):
    work_in(tmp_path, monkeypatch, scripted(name))
    shown, script, expected = blocks(ROOT / "docs" / name), [], []
    for (language, text), (after, printed) in pairwise([*shown, ("", "")]):
        if language == "python":
            script.append(text)
            expected.append(printed if after == "text" else None)
    (tmp_path / "page.py").write_text(f"print({MARK!r})\n".join(script))
    done = subprocess.run([sys.executable, "page.py"], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for printed, text in zip(done.stdout.split(MARK + "\n"), expected, strict=True):
        if text is not None:
            same(printed.splitlines(), text.splitlines())
    assert any(expected)


@pytest.fixture(scope="module")
def scripted(tmp_path_factory):
    """Return, for a page, a folder in which the scripts of its shell blocks have run once, and what they printed."""

    @functools.cache
    def made(name):
        folder, printed = tmp_path_factory.mktemp("page"), {}
        for there in ("examples", "data", "evidence"):
            (folder / there).symlink_to(ROOT / there)
        shown = (text for language, text in blocks(ROOT / "docs" / name) if language == "sh")
        for words in (words for text in shown for words in lines_of(text) if words[0] == "python"):
            command = [sys.executable, *words[1:]]
            done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
            printed[tuple(words)] = done.stdout
        return folder, printed

    return made


def work_in(folder, monkeypatch, begun):
    """Work in a folder that begins as a copy of another one; return what scripts printed there."""
    shutil.copytree(begun[0], folder, symlinks=True, dirs_exist_ok=True)
    monkeypatch.chdir(folder)
    return begun[1]


def contains(out, shown):
    """Compare what a page shows with what was printed; three dots stand for lines that the page omits."""
    printed = [line.rstrip() for line in out.splitlines()]
    for part in re.split(r"^\.\.\.\n", shown, flags=re.MULTILINE):
        lines = part.rstrip().splitlines()
        if not lines:  # after dots at the end
            continue
        begins = [i for i, line in enumerate(printed) if alike(line, lines[0])]
        assert begins, f"not printed: {lines[0]}"
        same(printed[begins[0] : begins[0] + len(lines)], lines)
        printed = printed[begins[0] + len(lines) :]


def alike(line, other):
    return NUMBER.sub("#", line) == NUMBER.sub("#", other)


def same(printed, shown):
    """Compare lines: words must be equal, numbers so to a unit of their last digit."""
    printed, shown = "\n".join(printed), "\n".join(shown)
    assert NUMBER.sub("#", printed) == NUMBER.sub("#", shown)
    for number, other in zip(NUMBER.findall(printed), NUMBER.findall(shown), strict=True):
        assert float(number) == pytest.approx(float(other), abs=1.01 * 10.0 ** -len(other.partition(".")[2])), shown


def test_every_public_name_is_in_the_reference():
    pages = "".join(page.read_text() for page in (ROOT / "docs" / "reference").glob("*.md"))
    documented = set(re.findall(r"^::: capsbayes\.(\w+)", pages, re.MULTILINE))  # of a room, by its members
    assert documented >= set(capsbayes.__all__) - {"__version__"}
