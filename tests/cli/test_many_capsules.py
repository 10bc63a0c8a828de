"""The command ``membrane``; what ``batch`` and ``population`` find is tested where it is made."""

import json
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "shared_membrane"
TRUTH = {"area_dilation_modulus": 3.84, "strain_hardening": 0.326, "bending": 1.44e-4}


def test_the_membrane_of_ten_capsules_has_files_words_and_a_status(tmp_path, capsbayes):
    ten, out = tmp_path / "lengths.csv", tmp_path / "made"
    ten.write_text("".join((EXAMPLE / "lengths.csv").read_text().splitlines(keepends=True)[:11]))
    known = [word for name, value in TRUTH.items() for word in ("--membrane", f"{name}={value}")]
    where = ("--experiment", EXAMPLE / "experiment.toml", "--out", out)
    status, printed, _ = capsbayes("membrane", ten, *where, *known, "--no-laws")
    assert {path.name for path in out.iterdir()} >= {"membrane.nc", "membrane.json", "membrane.png"}
    summary = json.loads((out / "membrane.json").read_text())
    assert status == (0 if summary["status"] == "DONE" else 1)
    assert "10 capsules" in printed
    assert "alpha" in printed
    inflation = summary["quantities"]["pre_inflation"]
    assert inflation["lower_95"] < 0.0571 < inflation["upper_95"]
    assert len(summary["flows"]) == 4


@pytest.mark.slow
def test_states_that_were_added_to_the_model_are_said_and_found_again(tmp_path, monkeypatch, capsbayes):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    ten = tmp_path / "lengths.csv"
    ten.write_text("".join((EXAMPLE / "lengths.csv").read_text().splitlines(keepends=True)[:11]))
    known = [f"--membrane=strain_hardening={TRUTH['strain_hardening']}"]  # with one more, one state is enough

    def refined(name):
        out = ("--experiment", EXAMPLE / "experiment.toml", "--out", tmp_path / name)
        status, printed, _ = capsbayes("membrane", ten, *out, *known, "--no-laws", "--refine", "3")
        assert status in (0, 1)
        return " ".join(printed.split()), json.loads((tmp_path / name / "membrane.json").read_text())["refinement"]

    printed, refinement = refined("first")
    assert refinement["states"] == refinement["simulated"] == 3
    assert len(list((tmp_path / "cache" / "capsbayes" / "states").glob("square-12-*/state-*.part"))) == 3
    assert (
        "States of refinement 12 were added to the model where the posterior lies: 0 of earlier runs, 3 new" in printed
    )
    printed, refinement = refined("second")
    assert refinement["reused"] == 3
    assert ": 3 of earlier runs" in printed
