import json

import pytest
from command_line import written
from sessions import drawn_session
from typer.testing import CliRunner

from capsbayes import Surrogate
from capsbayes.cli import app
from capsbayes.effects import MotionBlur
from capsbayes.errors import InputError

RESULTS = {"study.html", "study.json"}


@pytest.fixture(scope="module")
def lengths(tmp_path_factory):
    """A folder of capsules that were drawn from the model, without outlines."""
    folder = tmp_path_factory.mktemp("lengths") / "set"
    drawn_session(Surrogate.open("square-neo-hookean"), 24, seed=7)[0].write(folder)
    return folder


def run(*arguments):
    return CliRunner(env={"COLUMNS": "160"}).invoke(app, ["diagnose", *map(str, arguments)])


def said(result):
    return " ".join(result.output.split())


def test_a_right_model_is_not_accused(lengths, tmp_path):
    result = run(lengths, "--out", tmp_path / "study")
    assert result.exit_code == 0, result.output
    for words in ("No disagreement was found between the capsules and square-neo-hookean.", "Lengths alone were given",
                  "Deviations of 12 capsules from the model", "trend of ln G_s", "p-value"):  # fmt: skip
        assert words in said(result)
    assert "model square-neo-hookean, sha256" in said(result)
    assert "study.html, study.json" in said(result)
    assert written(tmp_path / "study") == RESULTS
    stored = json.loads((tmp_path / "study" / "study.json").read_text())
    assert (stored["verdict"], stored["capsules"]) == ("NONE", 24)
    assert set(map(len, stored["files"].values())) == {64}
    assert (tmp_path / "study" / "study.html").read_text().startswith("<!DOCTYPE html>")


def test_candidates_are_tried_at_another_level(lengths):
    result = run(lengths, "--level", "1", "--candidates", "halo, motion blur", "--seed", "2", "--json")
    assert result.exit_code == 0, result.output
    stored = json.loads(result.stdout)
    assert (stored["seed"], stored["level"]) == (2, 1.0)
    assert {one["parameter"] for one in stored["candidates"]} == {"halo", "exposure"}
    shown = said(run(lengths, "--level", "1", "--candidates", "halo"))
    assert "Effects that were tried" in shown
    assert "delta =" in shown


def test_a_table_with_an_experiment_and_what_is_left_out(lengths, tmp_path):
    table = tmp_path / "set.csv"
    drawn_session(Surrogate.open("square-neo-hookean"), 12, seed=7)[0].write(table)
    columns = table.read_text().splitlines()[0].count(",")
    with table.open("a") as file:
        file.write(f"[bad],2.1{',' * (columns - 1)}\n")
    result = run(table, "--experiment", lengths / "experiment.toml")
    assert result.exit_code == 0, result.output
    assert "1 capsules were left out: " in said(result)
    assert "capsule [bad]" in said(result)


@pytest.mark.slow
def test_an_effect_is_named_and_pictured(tmp_path):
    model = Surrogate.open("square-neo-hookean")
    session, _ = drawn_session(model + MotionBlur(), 24, seed=7, outline=True, sizes={"exposure": 4e-4})
    session.write(tmp_path / "set")
    result = run(tmp_path / "set", "--candidates", "exposure,halo", "--seed", "3", "--out", tmp_path / "study")
    assert result.exit_code == 0, result.output
    assert "motion blur explains it: t_e =" in said(result)
    assert "12 held-out capsules" in said(result)
    assert "gap: rms distance of measured and predicted edge" in said(result)
    assert (tmp_path / "study" / "study.html").read_text().count("data:image/svg+xml") == 6


def test_bad_input_is_one_line(lengths, tmp_path):
    for words, message in (
        ((lengths, "--candidates", "glow"), "diagnose: --candidates: expected one of"),
        ((lengths, "--experiment", "missing.toml"), "missing.toml: expected a file, got nothing there"),
        ((lengths, "--out", __file__), "--out: expected a folder, got the file"),
        ((tmp_path / "missing",), "expected a folder of measurement files"),
    ):
        result = run(*words)
        assert isinstance(result.exception, InputError)
        assert message in str(result.exception)
