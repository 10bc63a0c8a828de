"""``capsbayes app`` before its page is served."""

import importlib.util
import socket
import subprocess
import sys

import pytest
from command_line import mistake


def test_without_the_extra_one_line_says_how_to_install_it(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert 'pip install "capsbayes[app]"' in mistake(monkeypatch, capsys, "app")
    assert list(tmp_path.iterdir()) == []


def test_a_port_that_is_taken_is_one_line(monkeypatch, capsys, tmp_path):
    pytest.importorskip("nicegui", reason="the extra app is not installed")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        err = mistake(monkeypatch, capsys, "app", "--folder", tmp_path / "bench", "--port", port)
    assert f"--port: expected a port that is free, got {port}" in err


def test_neither_the_package_nor_the_command_line_nor_identification_imports_what_serves_the_page():
    code = (
        "import sys, capsbayes, capsbayes.cli, capsbayes.infer.identify\n"
        "sys.exit(any(name in sys.modules for name in ('nicegui', 'fastapi', 'uvicorn', 'starlette')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
