"""What every command prints: its result as text, as JSON, or nothing."""

import json
from pathlib import Path

import pytest
import typer.main
from command_line import run, written

from capsbayes.cli import app
from capsbayes.infer import Posterior

PICTURES = Path(__file__).parents[2] / "examples" / "pictures"
CAPSULE = Path(__file__).parents[2] / "examples" / "ovalbumin" / "capsule.toml"
KNOWN = ("--experiment", PICTURES / "experiment.toml")
MOVES = ("--velocity", "4.86 +/- 0.04 mm/s")
CONTOUR = (PICTURES / "contour.csv", *KNOWN, *MOVES, "--flow", "right", "--pixel-size", "0.417 +/- 0.003 um")


def all_commands(command, name="capsbayes"):
    if not hasattr(command, "commands"):
        yield pytest.param(command, id=name)
    for key, each in getattr(command, "commands", {}).items():
        yield from all_commands(each, key)


@pytest.mark.parametrize("command", list(all_commands(typer.main.get_command(app))))
def test_every_command_can_be_quiet_and_print_json(command):
    wanted = {"--quiet"} if command.name == "app" else {"--json", "--quiet"}  # a page in a browser is no result
    assert wanted <= {option for parameter in command.params for option in parameter.opts}


def test_a_measured_contour(monkeypatch, capsys, tmp_path):
    code, out, err = run(monkeypatch, capsys, "measure", *CONTOUR, "--json")
    found = json.loads(out)
    assert (code, err, found["status"]) == (0, "", "DONE")
    assert found["axial_extent"]["value"] == pytest.approx(1.95, abs=0.05)
    code, out, err = run(monkeypatch, capsys, "measure", *CONTOUR, "--quiet", "--out", tmp_path / "m")
    assert (code, out, err) == (0, "", "")
    assert "measurement.toml" in written(tmp_path / "m")


def test_what_is_wrong_is_printed_all_the_same(monkeypatch, capsys):
    code, out, err = run(monkeypatch, capsys, "measure", PICTURES / "none.csv", *CONTOUR[1:], "--quiet")
    assert (code, out) == (2, "")
    assert "none.csv" in err


def test_a_film_and_events_as_json(monkeypatch, capsys):
    film = json.loads(run(monkeypatch, capsys, "measure", PICTURES / "film.avi", *KNOWN, "--json")[1])
    assert [row["status"] for row in film["capsules"]] == ["DONE"]
    flows = ("--flow-rate", "0.5625 +/- 0.006 uL/min")
    events = (PICTURES / "cells.rtdc", *KNOWN, *flows, "--pixel-size", "0.680 +/- 0.006 um", "--json")
    assert json.loads(run(monkeypatch, capsys, "measure", *events)[1])["statuses"] == {"DONE": 3}


def test_how_much_emcee_samples(monkeypatch, capsys, tmp_path):
    size = ("--walkers", 32, "--steps", 600, "--ensembles", 5)
    code, out, _ = run(monkeypatch, capsys, "identify", CAPSULE, *size, "--quiet", "--out", tmp_path / "r")
    assert (code, out) == (0, "")
    assert len(Posterior.read(tmp_path / "r" / "posterior.nc").ensemble) == 5 * 32


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--engine", "quadrature", "--steps", "500"), "--engine: expected emcee with --walkers, --steps"),
        (("--steps", "500", "--most-steps", "400"), "--steps: expected at most --most-steps, 400, got 500"),
    ],
)
def test_a_size_that_means_nothing_is_refused(monkeypatch, capsys, options, message):
    code, _, err = run(monkeypatch, capsys, "identify", CAPSULE, *options)
    assert code == 2
    assert message in err
