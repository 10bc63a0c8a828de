"""The command line as a whole: its version, its groups, and what it says without a command."""

import pytest
from command_line import run
from typer.testing import CliRunner

import capsbayes
from capsbayes.cli import COMMANDS, app


def test_prints_its_version():
    assert CliRunner().invoke(app, ["--version"]).output == f"capsbayes {capsbayes.__version__}\n"


def test_help_lists_every_command_in_its_group(monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    lines = CliRunner().invoke(app, ["--help"]).output.splitlines()
    for group, commands in COMMANDS.items():
        start = next(k for k, line in enumerate(lines) if group in line)
        panel = lines[start + 1 : next(k for k in range(start, len(lines)) if lines[k].startswith("╰"))]
        found = [line.split()[1] for line in panel if line[2:3] != " "]
        assert found == list(commands)


@pytest.mark.parametrize("command", [[], ["sensitivity"]])
def test_without_a_command_it_shows_its_help(monkeypatch, capsys, command):
    status, out, err = run(monkeypatch, capsys, *command)
    assert status == 2
    assert "Usage: capsbayes" in out + err
    assert "(see" not in err


def test_an_unknown_command_is_one_line(monkeypatch, capsys):
    status, _, err = run(monkeypatch, capsys, "identfy")
    assert status == 2
    assert err.count("\n") == 1


def test_completion_can_be_installed():
    assert "--install-completion" in CliRunner().invoke(app, ["--help"]).output
