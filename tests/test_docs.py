"""What the pages show: Python runs and prints what stands below it, commands and their options exist."""

from __future__ import annotations

import io
import re
import shlex
from contextlib import redirect_stdout
from pathlib import Path

import pytest
import typer.main

import capsbayes
from capsbayes.cli import app

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
RUN = ("index.md", "tutorials/one-capsule.md")
"""Pages whose Python is run, from the folder of the project."""

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def blocks(page):
    return BLOCK.findall(page.read_text())


def commands():
    """Page and words of every ``capsbayes ...`` in a shell block."""
    for page in PAGES:
        for language, text in blocks(page):
            if language == "sh":
                for line in text.replace("\\\n", " ").splitlines():
                    words = shlex.split(line, comments=True)
                    if "capsbayes" in words:
                        yield pytest.param(words[words.index("capsbayes") + 1 :], id=f"{page.name}: {line[:60]}")


@pytest.mark.parametrize("words", list(commands()))
def test_commands_and_options_on_the_pages_exist(words):
    command, rest = typer.main.get_command(app), iter(words)
    while hasattr(command, "commands"):
        command = command.commands[next(rest)]
    known = {name for parameter in command.params for name in parameter.opts}
    assert {word for word in words if word.startswith("--")} <= known | {"--help"}


@pytest.mark.parametrize("name", RUN)
def test_python_on_a_page_prints_what_stands_below_it(name, monkeypatch):
    monkeypatch.chdir(ROOT)
    shown, namespace, compared = blocks(ROOT / "docs" / name), {}, 0
    for (language, code), (after, text) in zip(shown, [*shown[1:], ("", "")], strict=True):
        if language != "python":
            continue
        with redirect_stdout(io.StringIO()) as printed:
            exec(compile(code, name, "exec"), namespace)
        if after == "text":
            same(printed.getvalue(), text)
            compared += 1
    assert compared


def same(printed, text):
    """Words must be equal, numbers so to a unit of their last digit."""
    assert NUMBER.sub("#", printed) == NUMBER.sub("#", text)
    for one, other in zip(NUMBER.findall(printed), NUMBER.findall(text), strict=True):
        assert float(one) == pytest.approx(float(other), abs=1.01 * 10.0 ** -len(other.partition(".")[2]))


def test_every_public_name_is_in_the_reference():
    pages = "".join(page.read_text() for page in (ROOT / "docs" / "reference").glob("*.md"))
    documented = set(re.findall(r"^::: capsbayes\.(\w+)", pages, re.MULTILINE))  # of a room, by its members
    assert documented >= set(capsbayes.__all__) - {"__version__"}
