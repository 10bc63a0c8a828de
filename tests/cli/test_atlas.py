"""The atlas command: its files, its list, and one line for each mistake."""

import json
from pathlib import Path

import manufactured
import pytest
from command_line import mistake, run

NAMES = ["cases", "shapes", "velocity", "velocity-surface", "lengths"]
PNG = b"\x89PNG\r\n\x1a\n"


def test_writes_a_picture_for_each_map_and_lists_them(monkeypatch, capsys, tmp_path):
    database = manufactured.database(9, 8, failed=(5,))
    database.write(tmp_path / "manufactured.nc")
    words = "atlas", tmp_path / "manufactured.nc", "--out", tmp_path / "atlas"
    status, printed, _ = run(monkeypatch, capsys, *words, "--json")
    told = json.loads(printed)
    assert (status, told["cases"], told["converged"], told["sha256"]) == (0, 72, 71, database.sha256)
    assert [Path(one["file"]) for one in told["files"]] == [tmp_path / "atlas" / f"{name}.png" for name in NAMES]
    for one in told["files"]:
        content = Path(one["file"]).read_bytes()
        assert (len(content), content[:8]) == (one["bytes"], PNG)


def test_prints_the_files_for_people(monkeypatch, capsys, tmp_path):
    manufactured.database(2, 3).write(tmp_path / "few.nc")
    status, printed, _ = run(monkeypatch, capsys, "atlas", tmp_path / "few.nc", "--out", tmp_path)
    assert status == 0
    assert "6 of 6 cases with a steady state" in printed
    assert str(tmp_path / "cases.png") in printed


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
    assert mistake(monkeypatch, capsys, "atlas", *arguments).startswith(f"capsbayes: {message}")
    assert [path.name for path in tmp_path.iterdir()] == ["few.nc"]
