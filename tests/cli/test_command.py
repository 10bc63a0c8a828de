"""The command line as a whole: its version, groups and help, and as ``python -m capsbayes``."""

import subprocess
import sys

import pytest
import typer.main
from typer.testing import CliRunner

from capsbayes import __version__
from capsbayes.cli import COMMANDS, app


def test_help_lists_every_command_in_its_group(monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    lines = CliRunner().invoke(app, ["--help"]).output.splitlines()
    for group, commands in COMMANDS.items():
        start = next(k for k, line in enumerate(lines) if group in line)
        panel = lines[start + 1 : next(k for k in range(start, len(lines)) if lines[k].startswith("╰"))]
        found = [line.split()[1] for line in panel if line[2:3] != " "]
        assert found == list(commands)
    assert any("--install-completion" in line for line in lines)


@pytest.mark.parametrize("command", [[], ["sensitivity"]])
def test_without_a_command_it_shows_its_help(capsbayes, command):
    status, out, err = capsbayes(*command)
    assert status == 2
    assert "Usage: capsbayes" in out + err
    assert "(see" not in err


def said_by(*arguments):
    return subprocess.run([sys.executable, "-m", "capsbayes", *arguments], check=False, capture_output=True, text=True)


def test_the_module_is_run_as_the_command_line():
    done = said_by("--version")
    assert (done.returncode, done.stdout) == (0, f"capsbayes {__version__}\n")
    done = said_by("identify", "absent.toml")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "capsbayes: absent.toml: expected a file, got nothing there\n"


@pytest.mark.parametrize(
    ("closed", "arguments", "status"),
    [
        (">&-", "--version", 0),
        (">&- 2>&-", "--version", 0),
        ("| exec true", "--help", 1),
        (">&-", "identify absent.toml", 2),
    ],
)
def test_nobody_need_read_what_is_printed(closed, arguments, status):
    command = f"set -o pipefail; (sleep 1; exec {sys.executable} -m capsbayes {arguments}) {closed}"
    done = subprocess.run(["bash", "-c", command], check=False, capture_output=True, text=True)
    assert done.returncode == status
    assert len(done.stderr.splitlines()) == (status == 2)


def all_commands(command, name="capsbayes"):
    if not hasattr(command, "commands"):
        yield command
    for key, each in getattr(command, "commands", {}).items():
        yield from all_commands(each, key)


def test_every_command_can_be_quiet_and_print_json():
    for command in all_commands(typer.main.get_command(app)):
        wanted = {"--quiet"} if command.name == "app" else {"--json", "--quiet"}  # a page in a browser is no result
        assert wanted <= {option for parameter in command.params for option in parameter.opts}, command.name
