"""``capsbayes hide``: a blind set, its truth next to it, mistakes in one line."""

import hashlib
import json

import pytest

from capsbayes.cli import app
from capsbayes.diagnosis import Session


def hidden(invoke, *options):
    return invoke(app, ["hide", *options])


@pytest.fixture
def invoke():
    from typer.testing import CliRunner

    return CliRunner().invoke


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--effect", "gravity"], "effect: expected one of none, pre_inflation"),
        (
            ["--effect", "halo", "--effect-size", "3"],
            'hide: --effect-size: expected a text in m like "0.4 um", got no unit',
        ),
        (
            ["--effect", "halo", "--effect-size", "3 +/- 1 um"],
            "hide: --effect-size: expected a number without an error",
        ),
        (["--effect", "halo", "--effect-size", "5 m"], "hide: --effect-size: expected a size of at most 0.0001 m"),
        (["--effect", "none", "--effect-size", "5 m"], "hide: --effect-size: expected nothing with --effect none"),
        (["--effect", "swelling", "--effect-size", "5 m"], "hide: --effect-size: expected a text in s/m"),
    ],
)
def test_a_mistake_is_one_line(invoke, tmp_path, options, message):
    result = hidden(invoke, *options, "--out", str(tmp_path / "set"))
    assert message in str(result.exception)
    assert not (tmp_path / "set.truth").exists()


def test_a_folder_that_holds_files_is_refused(invoke, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    result = hidden(invoke, "--effect", "none", "--out", str(tmp_path))
    assert "an empty folder" in str(result.exception)


@pytest.mark.slow
def test_a_set_is_blind_and_its_truth_sealed(invoke, tmp_path):
    options = ["--effect", "halo", "--effect-size", "0.4 um", "--capsules", "2", "--refinement", "4", "--workers", "1"]
    result = hidden(invoke, *options, "--out", str(tmp_path / "set"))
    assert result.exit_code == 0, result.output
    session = Session.read(tmp_path / "set")
    assert len(session) == 2
    assert all(one.outline is not None for one in session.measurements)
    told = (tmp_path / "set.truth" / "truth.json").read_text()
    assert json.loads(told)["effect"] == "halo"
    assert json.loads(told)["size"] == pytest.approx(4e-7)
    assert hashlib.sha256(told.encode()).hexdigest() in (tmp_path / "set" / "seal.txt").read_text()
    assert not any("halo" in path.read_text() for path in (tmp_path / "set").iterdir())
