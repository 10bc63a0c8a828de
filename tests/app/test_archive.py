"""All capsules of a bench in one file, and back, without its page."""

import pytest

pytest.importorskip("nicegui", reason="the extra app is not installed")

import shutil
import zipfile
from pathlib import Path

from typer.testing import CliRunner

from capsbayes.app import archive
from capsbayes.app.archive import PACKED, packed, unpacked
from capsbayes.app.desk import MOST_BYTES, Bench, Desk
from capsbayes.app.stated import EXAMPLE_PICTURE, Stated
from capsbayes.cli import app
from capsbayes.errors import CapsbayesError
from capsbayes.experiment import Experiment
from capsbayes.files.output_file import RECORD, is_ours
from capsbayes.measurement import Measurement

EXAMPLES = Path(__file__).parents[2] / "examples" / "pictures"
CHANNEL = {"cross_section": "square", "half_width": "25 +/- 0.2 um", "viscosity": "0.8 +/- 0.02 Pa s"}
MEASUREMENT = "capsule/measurement.toml"
LINK = zipfile.ZipInfo("capsule/picture.png")
LINK.external_attr = 0o120777 << 16


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A bench with a film, a picture as it was stated, and files that no capsule needs."""
    bench = tmp_path / "one"
    for name in ("example", "film", "waiting"):
        (bench / name).mkdir(parents=True)
    shutil.copy(EXAMPLE_PICTURE, bench / "example")
    Desk(Bench(bench), Stated("example.png", walls="20, 140"), bench / "example", CHANNEL).keep()
    for name in ("film.avi", "experiment.toml"):
        shutil.copy(EXAMPLES / name, bench / "film")
    monkeypatch.chdir(bench / "film")
    words = ["measure", "film.avi", "--experiment", "experiment.toml", "--frame-rate", "400 Hz", "--out", "."]
    assert CliRunner().invoke(app, words).exit_code == 0
    for name in ("open-x.html", "population.nc", "waiting/other.png", "example/.lock"):
        (bench / name).write_text("not of a capsule")
    (bench / "example" / "link.png").symlink_to("/etc/passwd")
    return bench


def contents(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_capsules_are_packed_and_go_on_in_another_bench(bench, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    packed(str(bench), MOST_BYTES)
    (tmp_path / "kept").mkdir()
    kept = (bench / PACKED).replace(tmp_path / "kept" / "bench.zip")
    assert unpacked(str(other), str(kept)) == (2, 0)
    without = ("open-x.html", "population.nc", "waiting/other.png", "example/.lock", "example/link.png")
    before = {name: content for name, content in contents(bench).items() if name not in without}
    changed = {name for name, content in contents(other).items() if before.pop(name) != content}
    assert changed == {"film/capsule-1/measurement.toml", f"film/capsule-1/{RECORD}"}
    assert not before
    shutil.rmtree(bench)  # what was measured in a film names its experiment by its place
    measurement = Measurement.read(other / "film" / "capsule-1" / "measurement.toml")
    assert Experiment.read(measurement.experiment_file).source == str(other / "film" / "experiment.toml")
    assert is_ours(other / "film" / "capsule-1" / "measurement.toml")
    desk = Desk(Bench(other))
    desk.take_up(other / "example")
    assert (desk.stated.walls, desk.experiment["half_width"]) == ("20, 140", "25 +/- 0.2 um")
    assert not desk.keep()  # over what was written by the other bench
    before = contents(other)
    assert unpacked(str(other), str(kept)) == (0, 2)
    assert contents(other) == before


def test_nothing_is_overwritten(bench, tmp_path):
    packed(str(bench), MOST_BYTES)
    other = tmp_path / "other"
    (other / "example").mkdir(parents=True)
    (other / "example" / "example.png").write_text("another one")
    assert unpacked(str(other), str(bench / PACKED)) == (2, 0)
    assert (other / "example" / "example.png").read_text() == "another one"
    assert (other / "example-2" / "example.png").read_bytes() == EXAMPLE_PICTURE.read_bytes()


@pytest.mark.parametrize(
    ("hostile", "told"),
    [
        ("/etc/x.toml", "leads out"),
        ("../x.toml", "leads out"),
        ("capsule/../../x.toml", "leads out"),
        ("capsule\\..\\..\\x.toml", "leads out"),
        ("C:\\x.toml", "leads out"),
        ("C:x/x.toml", "leads out"),
        ("\\\\host\\share\\x.toml", "leads out"),
        ("x.toml", "leads out"),
        (LINK, "leads out"),
        ("capsule/measurement.toml/x", "cannot be read"),
    ],
    ids=str,
)
def test_hostile_names_are_refused_in_one_line_and_leave_nothing(hostile, told, tmp_path):
    with zipfile.ZipFile(tmp_path / "bad.zip", "w") as bad:
        bad.writestr(MEASUREMENT, "")
        bad.writestr(hostile, "x")
    refused(tmp_path, told)


def refused(folder, told):
    bench = folder / "bench"
    bench.mkdir()
    before = contents(folder)
    where = folder / "given"
    where.mkdir()
    shutil.copy(folder / "bad.zip", where)
    with pytest.raises(CapsbayesError, match=told) as error:
        unpacked(str(bench), str(where / "bad.zip"))
    assert "\n" not in str(error.value)
    assert str(error.value).startswith("bad.zip: expected ")
    shutil.rmtree(where)
    assert (contents(folder), list(bench.iterdir())) == (before, [])


def test_other_files_are_refused(tmp_path):
    (tmp_path / "bad.zip").write_bytes(b"no archive")
    refused(tmp_path, "cannot be read")
    (tmp_path / "bench").rmdir()
    with zipfile.ZipFile(tmp_path / "bad.zip", "w") as bad:
        bad.writestr("holiday/beach.png", "x")
    refused(tmp_path, "a file without capsules")


def test_a_damaged_file_leaves_nothing(tmp_path):
    with zipfile.ZipFile(tmp_path / "bad.zip", "w") as bad:
        bad.writestr(MEASUREMENT, "first")
        bad.writestr("other/measurement.toml", "second")
    content = (tmp_path / "bad.zip").read_bytes()
    (tmp_path / "bad.zip").write_bytes(content.replace(b"second", b"SECOND"))
    refused(tmp_path, "Bad CRC")


@pytest.mark.parametrize(("name", "most"), [("MOST_FILES", 1), ("MOST_UNPACKED", 100)])
def test_too_much_is_refused_before_anything_is_unpacked(name, most, tmp_path, monkeypatch):
    monkeypatch.setattr(archive, name, most)
    with zipfile.ZipFile(tmp_path / "bad.zip", "w", zipfile.ZIP_DEFLATED) as bad:
        bad.writestr(MEASUREMENT, "0" * 200)
        bad.writestr("other/measurement.toml", "")
    refused(tmp_path, "at most, got more")


@pytest.mark.parametrize("limit", ["the page", "MOST_FILES", "MOST_UNPACKED"])
def test_what_no_page_would_take_is_not_packed(limit, bench, monkeypatch):
    if limit != "the page":
        monkeypatch.setattr(archive, limit, 2)
    with pytest.raises(CapsbayesError, match="copy the folder itself"):
        packed(str(bench), 100 if limit == "the page" else MOST_BYTES)
    assert not (bench / PACKED).exists()


def test_without_capsules_nothing_is_packed(tmp_path):
    with pytest.raises(CapsbayesError, match="got none"):
        packed(str(tmp_path), MOST_BYTES)
