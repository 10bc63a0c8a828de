"""The atlas command: its files, its list, and one line for each mistake."""

import json
import sys
from pathlib import Path

import manufactured
import pytest
from typer.testing import CliRunner

import capsbayes.cli

NAMES = ["cases", "shapes", "velocity", "velocity-surface", "lengths"]
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    path = tmp_path_factory.mktemp("database") / "manufactured.nc"
    manufactured.database(9, 8, failed=(5,)).write(path)
    return path


def run(*arguments):
    return CliRunner().invoke(capsbayes.cli.app, ["atlas", *map(str, arguments)])


def test_writes_a_picture_for_each_map_and_lists_them(database, tmp_path):
    result = run(database, "--out", tmp_path / "atlas", "--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert (told["cases"], told["converged"]) == (72, 71)
    assert told["sha256"] == manufactured.database(9, 8, failed=(5,)).sha256
    assert [Path(one["file"]) for one in told["files"]] == [tmp_path / "atlas" / f"{name}.png" for name in NAMES]
    for one in told["files"]:
        content = Path(one["file"]).read_bytes()
        assert len(content) == one["bytes"]
        assert content.startswith(PNG)


def test_prints_the_files_for_people(tmp_path):
    manufactured.database(2, 3).write(tmp_path / "few.nc")
    result = run(tmp_path / "few.nc", "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert "6 of 6 cases with a steady state" in result.stdout
    assert str(tmp_path / "cases.png") in result.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["moon"], "no database 'moon' comes with the library"),
        (["none.nc"], "none.nc: no such file"),
        (["few.nc", "--out", "few.nc"], "--out: expected a folder, got the file few.nc"),
    ],
)
def test_a_mistake_is_one_line_and_exit_status_2(tmp_path, monkeypatch, capsys, arguments, message):
    manufactured.database(2, 3).write(tmp_path / "few.nc")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["capsbayes", "atlas", *arguments])
    with pytest.raises(SystemExit) as caught:
        capsbayes.cli.main()
    assert caught.value.code == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1].startswith(f"capsbayes: {message}")
    assert [path.name for path in tmp_path.iterdir()] == ["few.nc"]
