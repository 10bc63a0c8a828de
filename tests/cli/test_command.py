"""The command line as a whole: its version, groups and help, what it prints, and as ``python -m capsbayes``."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import typer.main
from command_line import mistake, run, written
from typer.testing import CliRunner

import capsbayes
from capsbayes.cli import COMMANDS, app

PICTURES = Path(__file__).parents[2] / "examples" / "pictures"
CAPSULE = Path(__file__).parents[2] / "examples" / "ovalbumin" / "capsule.toml"
KNOWN = ("--experiment", PICTURES / "experiment.toml")
MOVES = ("--velocity", "4.86 +/- 0.04 mm/s")
CONTOUR = (PICTURES / "contour.csv", *KNOWN, *MOVES, "--flow", "right", "--pixel-size", "0.417 +/- 0.003 um")


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
def test_without_a_command_it_shows_its_help(monkeypatch, capsys, command):
    status, out, err = run(monkeypatch, capsys, *command)
    assert status == 2
    assert "Usage: capsbayes" in out + err
    assert "(see" not in err


def test_an_unknown_command_is_one_line(monkeypatch, capsys):
    assert mistake(monkeypatch, capsys, "identfy")


def said_by(*arguments):
    return subprocess.run([sys.executable, "-m", "capsbayes", *arguments], check=False, capture_output=True, text=True)


def test_the_module_is_run_as_the_command_line():
    done = said_by("--version")
    assert (done.returncode, done.stdout) == (0, f"capsbayes {capsbayes.__version__}\n")
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


def test_a_measured_contour(monkeypatch, capsys, tmp_path):
    code, out, err = run(monkeypatch, capsys, "measure", *CONTOUR, "--json")
    found = json.loads(out)
    assert (code, err, found["status"]) == (0, "", "DONE")
    assert found["axial_extent"]["value"] == pytest.approx(1.95, abs=0.05)
    code, out, err = run(monkeypatch, capsys, "measure", *CONTOUR, "--quiet", "--out", tmp_path / "m")
    assert (code, out, err) == (0, "", "")
    assert "measurement.toml" in written(tmp_path / "m")
    assert "none.csv" in mistake(monkeypatch, capsys, "measure", PICTURES / "none.csv", *CONTOUR[1:], "--quiet")


def test_a_film_and_events_as_json(monkeypatch, capsys):
    film = json.loads(run(monkeypatch, capsys, "measure", PICTURES / "film.avi", *KNOWN, "--json")[1])
    assert [row["status"] for row in film["capsules"]] == ["DONE"]
    flows = ("--flow-rate", "0.5625 +/- 0.006 uL/min")
    events = (PICTURES / "cells.rtdc", *KNOWN, *flows, "--pixel-size", "0.680 +/- 0.006 um", "--json")
    assert json.loads(run(monkeypatch, capsys, "measure", *events)[1])["statuses"] == {"DONE": 3}
