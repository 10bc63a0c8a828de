"""The report command: its file, and one line for each mistake."""

import pytest
from command_line import mistake, run, written
from results import population, posterior


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_folder_of_identify_becomes_a_page(here, monkeypatch, capsys):
    posterior().write(here / "result" / "posterior.nc")
    (here / "new").mkdir()
    status, printed, _ = run(monkeypatch, capsys, "report", "result", "--out", here / "new" / "capsule.html")
    assert (status, "capsule.html, 0." in printed) == (0, True)
    assert "Capsule capsule.toml" in (here / "new" / "capsule.html").read_text(encoding="utf-8")
    assert written(here / "new") == {"capsule.html"}


def test_a_population_becomes_a_page_of_at_most_so_many_rows(here, monkeypatch, capsys):
    population().write(here / "run.nc")
    assert run(monkeypatch, capsys, "report", "run.nc", "--rows", 3)[0] == 0
    assert "The 3 worst of 8 are shown; the others are in run.nc." in (here / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["moon"], "moon: expected the file of a result, or one of the databases"),
        (["empty"], "empty: expected a folder of capsbayes identify, with posterior.nc, got another folder"),
        (["text.nc"], "text.nc: expected a NetCDF file of a posterior, a population or a database"),
        (["run.nc", "--picture", "a.png"], "report: --picture: expected a posterior with a picture, got run.nc"),
        (["run.nc", "--out", "empty"], "--out: expected a file name that ends in .html or .htm"),
    ],
)
def test_a_mistake_is_one_line_and_exit_status_2(here, monkeypatch, capsys, arguments, message):
    (here / "empty").mkdir()
    (here / "text.nc").write_text("no numbers")
    population().write(here / "run.nc")
    assert message in mistake(monkeypatch, capsys, "report", *arguments)
    assert {path.name for path in here.iterdir()} == {"empty", "text.nc", "run.nc"}
