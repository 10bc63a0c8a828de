"""The command ``membrane``; what ``batch`` and ``population`` find is tested where it is made."""

import json
from pathlib import Path

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
