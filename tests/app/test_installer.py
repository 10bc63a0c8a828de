"""What the installer packs exists, and its program is the bench, the command line, and Python to what calls it so."""

import importlib.util
import runpy
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

import capsbayes
import capsbayes.cli
from capsbayes.database import shipped_folders

FOLDER = Path(__file__).parents[2] / "installer"
PROGRAM = FOLDER / "bench.py"


def printed_by(*words):
    return subprocess.run([sys.executable, PROGRAM, *words], check=True, capture_output=True, text=True).stdout


def test_the_recipe_packs_the_program_and_packages_that_exist(monkeypatch):
    pytest.importorskip("nicegui", reason="the bench is not installed")
    made = {}

    def analysis(scripts, **options):
        made.update(scripts=scripts, **options)
        return SimpleNamespace(pure=[], scripts=[], binaries=[], datas=[])

    hooks = ModuleType("PyInstaller.utils.hooks")
    hooks.collect_all = lambda name: ([(name, name)], [], [name])
    hooks.collect_data_files = lambda name: [(name, name)]
    hooks.collect_submodules = lambda name: [name]
    for name in ("PyInstaller", "PyInstaller.utils", hooks.__name__):
        monkeypatch.setitem(sys.modules, name, hooks)
    tools = {"Analysis": analysis, **dict.fromkeys(("PYZ", "EXE", "COLLECT"), lambda *parts, **options: None)}
    runpy.run_path(str(FOLDER / "bench.spec"), tools)
    assert [FOLDER / script for script in made["scripts"]] == [PROGRAM]
    assert all(importlib.util.find_spec(name) for name in made["hiddenimports"])
    assert [name for name, _ in made["datas"]] == ["capsbayes", "arviz", "nicegui"]
    assert all(any(folder.is_dir() for folder in shipped_folders(kind)) for kind in ("databases", "membranes"))


def test_a_word_is_a_command_and_code_is_run_as_by_python():
    assert printed_by("--version") == f"capsbayes {capsbayes.__version__}\n"
    assert printed_by("-c", "import sys; print(sys.argv[1:])", "one", "--two") == "['one', '--two']\n"


def test_a_double_click_opens_the_bench_with_a_folder_at_home(monkeypatch):
    asked = []
    monkeypatch.setattr(sys, "argv", [str(PROGRAM)])
    monkeypatch.setattr(capsbayes.cli, "main", lambda: asked.extend(sys.argv[1:]))
    runpy.run_path(str(PROGRAM), run_name="__main__")
    assert asked == ["app", "--folder", str(Path.home() / "capsbayes-bench")]
