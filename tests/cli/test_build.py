"""The build command: what it makes, and one line for each mistake."""

from __future__ import annotations

import json

import pytest
from analytic_simulator import AnalyticSimulator
from command_line import run
from typer.testing import CliRunner

import capsbayes.cli
import capsbayes.physics.simulator
from capsbayes.database import Database
from capsbayes.physics.build import default_grid, read_cases

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


def test_prints_json(build):
    outcome = json.loads(build("--cases", "cases.csv", "--json").output)
    assert outcome["statuses"] == {"DONE": 2, "NO_STEADY_STATE": 1}


def test_exit_status_is_1_when_nothing_converged(build, tmp_path):
    (tmp_path / "cases.csv").write_text("capillary_number,size_ratio\n0.9,0.9\n")
    assert build("--cases", "cases.csv").exit_code == 1
    assert (tmp_path / "shapes.nc").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "build: --cases, --grid: expected one of the two, got neither"),
        (["--cases", "cases.csv", "--grid", "default"], "build: --cases, --grid: expected one of the two, got both"),
        (["--grid", "fine"], "build: --grid: expected one of default, got 'fine'"),
        (["--cases", "none.csv"], "none.csv: expected a table of cases, got nothing there"),
        (
            ["--grid", "default", "--law", "rubber"],
            "law: expected one of neo-hookean, skalak:hardening=1.0, hooke:poisson_ratio=0.5, "
            "strain-hardening:strain_hardening=0.0, hooke-share:hooke_share=0.0, "
            "general:area_dilation_modulus=3.0,strain_hardening=0.0, "
            "evans-skalak:area_dilation_modulus=3.0, got 'rubber'",
        ),
        (
            ["--grid", "default", "--effect", "bending"],
            "build: --effect, --values: expected both or neither, got only one",
        ),
        (
            ["--grid", "default", "--effect", "bending", "--values", "0,few"],
            "build: --values: expected numbers with commas between them, got '0,few'",
        ),
        (
            ["--grid", "default", "--effect", "bending", "--values", "0,1", "--compare", "12"],
            "build: --compare: expected nothing with --effect, got 12",
        ),
        (
            ["--grid", "default", "--effect", "limit", "--values", "0.175,0.2"],
            "build: values: expected at least 3 values of limit, the simulator's own 0.175 among them, got 0.175, 0.2",
        ),
    ],
)
def test_a_mistake_is_one_line_and_exit_status_2(build, tmp_path, monkeypatch, capsys, arguments, message):
    assert mistake(monkeypatch, capsys, arguments) == f"capsbayes: {message}\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cases.csv"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--cross-section", "star"],
            "capsbayes: cross_section: expected one of square, rectangular, circular, got 'star'",
        ),
        (["--refinement", "1"], "capsbayes: Simulator: refinement: expected at least 4, got 1"),
        (["--bending", "-1"], "capsbayes: Simulator: bending: expected a number from 0 to 1, got -1.0"),
        (["--bending", "nan"], "capsbayes: --bending: expected a finite number, got nan"),
        (["--workers", "0"], "capsbayes build: Invalid value for '--workers'"),
        (["--speed", "1"], "capsbayes build: No such option: --speed"),
    ],
)
def test_a_wrong_option_is_one_line_and_exit_status_2(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    line = mistake(monkeypatch, capsys, ["--grid", "default", *arguments])
    assert line.startswith(message)
    assert line.count("\n") == 1
    assert not list(tmp_path.iterdir())


def mistake(monkeypatch, capsys, arguments):
    """What the command says on the terminal when it ends with exit status 2."""
    status, _, err = run(monkeypatch, capsys, "build", "--out", "shapes.nc", *arguments)
    assert status == 2
    return err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Ca,size_ratio\n0.1,0.9\n", "capillary_number: expected a column of that name, got columns Ca, size_ratio"),
        (
            "capillary_number,size_ratio\n0.1,0.9\n0.2,large\n",
            "line 3: expected numbers for .*, got 0.2, large",
        ),
        ("capillary_number,size_ratio\n0.1\n", "line 2: expected 2 cells, got 1"),
    ],
)
def test_a_bad_table_of_cases_names_the_line(tmp_path, text, message):
    path = tmp_path / "cases.csv"
    path.write_text(text)
    with pytest.raises(capsbayes.errors.InputError, match=message):
        read_cases(path)


def test_default_grid_covers_the_plane_and_is_denser_at_low_ca():
    grid = default_grid()
    capillary_numbers, size_ratios = (sorted(set(values)) for values in zip(*grid, strict=True))
    assert len(grid) == len(set(grid)) == len(capillary_numbers) * len(size_ratios)
    assert (size_ratios[0], size_ratios[-1]) == (0.7, 1.15)
    assert (capillary_numbers[0], capillary_numbers[-1]) == (0.003, 0.15)
    assert capillary_numbers[1] - capillary_numbers[0] < capillary_numbers[-1] - capillary_numbers[-2]
