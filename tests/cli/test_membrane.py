"""The command ``membrane``: its files, its words and its exit status."""

import json
from pathlib import Path

import pytest
from command_line import mistake, run

EXAMPLE = Path(__file__).parents[2] / "examples" / "shared_membrane"
TRUTH = {"area_dilation_modulus": 3.84, "strain_hardening": 0.326, "bending": 1.44e-4}


@pytest.fixture
def ten(tmp_path):
    """Ten capsules of the example."""
    lines = (EXAMPLE / "lengths.csv").read_text().splitlines()
    path = tmp_path / "lengths.csv"
    path.write_text("\n".join(lines[:11]) + "\n")
    return path


def test_files_words_and_status(ten, tmp_path, monkeypatch, capsys):
    out = tmp_path / "made"
    known = [word for name, value in TRUTH.items() for word in ("--membrane", f"{name}={value}")]
    where = "--experiment", EXAMPLE / "experiment.toml", "--out", out
    status, printed, _ = run(monkeypatch, capsys, "membrane", ten, *where, *known, "--no-laws")
    assert {path.name for path in out.iterdir()} >= {"membrane.nc", "membrane.json", "membrane.png"}
    summary = json.loads((out / "membrane.json").read_text())
    assert status == (0 if summary["status"] == "DONE" else 1)
    assert "10 capsules" in printed
    assert "alpha" in printed
    inflation = summary["quantities"]["pre_inflation"]
    assert inflation["lower_95"] < 0.0571 < inflation["upper_95"]
    assert len(summary["flows"]) == 4


def test_capsules_need_an_experiment(ten, monkeypatch, capsys):
    assert "experiment" in mistake(monkeypatch, capsys, "membrane", ten)
