"""The build command: what it makes, and one line for each mistake."""

from __future__ import annotations

import json

import pytest
from analytic_simulator import AnalyticSimulator
from command_line import mistake
from typer.testing import CliRunner

import capsbayes.cli
import capsbayes.physics.simulator
from capsbayes.database import Database
from capsbayes.physics.build import default_grid

CSV = "size_ratio,capillary_number,note\n0.9,0.05,middle\n0.9,0.06,\n0.8,0.5,too high\n"


@pytest.fixture
def build(tmp_path, monkeypatch):
    """The command with a simulator in closed form; it returns exit status, output and error lines."""

    def simulator(*, refinement, **others):
        return AnalyticSimulator(refinement=refinement)

    monkeypatch.setattr(capsbayes.physics.simulator, "Simulator", simulator, raising=False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cases.csv").write_text(CSV)

    def run(*arguments):
        return CliRunner().invoke(
            capsbayes.cli.app, ["build", "--out", "shapes.nc", "--scheduler", "synchronous", *arguments]
        )

    return run


def test_builds_the_cases_of_a_file(build, tmp_path):
    result = build("--cases", "cases.csv", "--refinement", "12")
    assert result.exit_code == 0, result.output
    database = Database.read(tmp_path / "shapes.nc")
    assert list(database["capillary_number"]) == [0.5, 0.05, 0.06]
    assert set(database["refinement"]) == {12}
    assert "3 cases in" in result.output
    assert "     2  Done." in result.output
    assert database.sha256 in result.output


def test_builds_an_effect_database(build, tmp_path):
    result = build("--cases", "cases.csv", "--effect", "limit", "--values", "0.16,0.175,0.2")
    assert result.exit_code == 0, result.output
    database = Database.read(tmp_path / "shapes.nc")
    assert (database.effect, database.null_value, list(database.values)) == ("limit", 0.175, [0.16, 0.175, 0.2])
    assert "cases in" in result.output


def test_prints_json_and_ends_with_1_when_nothing_converged(build, tmp_path):
    outcome = json.loads(build("--cases", "cases.csv", "--json").output)
    assert outcome["statuses"] == {"DONE": 2, "NO_STEADY_STATE": 1}
    (tmp_path / "cases.csv").write_text("capillary_number,size_ratio\n0.9,0.9\n")
    assert build("--cases", "cases.csv").exit_code == 1
    assert (tmp_path / "shapes.nc").exists()


LAWS = ("neo-hookean", "skalak:hardening=1.0", "hooke:poisson_ratio=0.5", "evans-skalak:area_dilation_modulus=3.0")


@pytest.mark.parametrize(
    ("arguments", "messages"),
    [
        ("", ["build: --cases, --grid: expected one of the two, got neither"]),
        ("--cases cases.csv --grid default", ["build: --cases, --grid: expected one of the two, got both"]),
        ("--grid fine", ["build: --grid: expected one of default, got 'fine'"]),
        ("--cases none.csv", ["none.csv: expected a table of cases, got nothing there"]),
        ("--cases bad.csv", ["capillary_number: expected a column of that name, got columns Ca, size_ratio"]),
        ("--grid default --law rubber", ["law: expected one of ", *LAWS, "got 'rubber'"]),
        ("--grid default --effect bending", ["build: --effect, --values: expected both or neither, got only one"]),
        ("--grid default --effect bending --values 0,few", ["--values: expected numbers with commas", "got '0,few'"]),
        ("--grid default --effect bending --values 0,1 --compare 12", ["build: --compare: expected nothing with"]),
        (
            "--grid default --effect bending --values 0,1e-4",
            ["expected at least 3 values of bending"],
        ),
        ("--grid default --bending -1", ["capsbayes: Simulator: bending: expected a number from 0 to 1, got -1.0"]),
        ("--grid default --bending nan", ["capsbayes: --bending: expected a finite number, got nan"]),
        ("--grid default --workers 0", ["capsbayes build: Invalid value for '--workers'"]),
        ("--grid default --speed 1", ["capsbayes build: No such option: --speed"]),
    ],
)
def test_a_mistake_is_one_line_and_exit_status_2(tmp_path, monkeypatch, capsys, arguments, messages):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cases.csv").write_text(CSV)
    (tmp_path / "bad.csv").write_text("Ca,size_ratio\n0.1,0.9\n")
    line = mistake(monkeypatch, capsys, "build", "--out", "shapes.nc", *arguments.split())
    assert all(message in line for message in messages)
    assert {path.name for path in tmp_path.iterdir()} == {"bad.csv", "cases.csv"}


def test_default_grid_covers_the_plane_and_is_denser_at_low_ca():
    grid = default_grid()
    capillary_numbers, size_ratios = (sorted(set(values)) for values in zip(*grid, strict=True))
    assert len(grid) == len(set(grid)) == len(capillary_numbers) * len(size_ratios)
    assert (size_ratios[0], size_ratios[-1]) == (0.7, 1.15)
    assert (capillary_numbers[0], capillary_numbers[-1]) == (0.003, 0.15)
    assert capillary_numbers[1] - capillary_numbers[0] < capillary_numbers[-1] - capillary_numbers[-2]
