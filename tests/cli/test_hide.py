"""``capsbayes hide``: a blind set, its truth next to it, mistakes in one line."""

import hashlib
import json

import pytest
from typer.testing import CliRunner

from capsbayes.cli import app
from capsbayes.diagnosis import Session


def hidden(*options):
    return CliRunner().invoke(app, ["hide", *options])


@pytest.mark.parametrize(
    ("effect", "size", "message"),
    [
        ("gravity", [], "effect: expected one of none, pre_inflation"),
        ("halo", ["3"], 'hide: --effect-size: expected a text in m like "0.4 um", got no unit'),
        ("halo", ["3 +/- 1 um"], "hide: --effect-size: expected a number without an error"),
        ("halo", ["5 m"], "hide: --effect-size: expected a size of at most 0.0001 m"),
        ("none", ["5 m"], "hide: --effect-size: expected nothing with --effect none"),
        ("swelling", ["5 m"], "hide: --effect-size: expected a text in s/m"),
    ],
)
def test_a_mistake_is_one_line(tmp_path, effect, size, message):
    given = [word for one in size for word in ("--effect-size", one)]
    result = hidden("--effect", effect, *given, "--out", str(tmp_path / "set"))
    assert message in str(result.exception)
    assert not (tmp_path / "set.truth").exists()


def test_a_folder_that_holds_files_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    assert "an empty folder" in str(hidden("--effect", "none", "--out", str(tmp_path)).exception)


@pytest.mark.slow
def test_a_set_is_blind_and_its_truth_sealed(tmp_path):
    options = ["--effect", "halo", "--effect-size", "0.4 um", "--capsules", "2", "--refinement", "4", "--workers", "1"]
    result = hidden(*options, "--out", str(tmp_path / "set"))
    assert result.exit_code == 0, result.output
    session = Session.read(tmp_path / "set")
    assert len(session) == 2
    assert all(one.outline is not None for one in session.measurements)
    told = (tmp_path / "set.truth" / "truth.json").read_text()
    assert json.loads(told)["effect"] == "halo"
    assert json.loads(told)["size"] == pytest.approx(4e-7)
    assert hashlib.sha256(told.encode()).hexdigest() in (tmp_path / "set" / "seal.txt").read_text()
    assert not any("halo" in path.read_text() for path in (tmp_path / "set").iterdir())
