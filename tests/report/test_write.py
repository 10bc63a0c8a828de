"""Any result becomes one file, whole or not at all; its file says what it is."""

import manufactured
import pytest
from results import population, posterior

import capsbayes as cb
from capsbayes.errors import InputError
from capsbayes.report import opened


def test_every_kind_of_result_has_a_page(tmp_path):
    for name, result, title in (
        ("capsule", posterior(), "<title>Capsule capsule.toml</title>"),
        ("run", population(), "<title>8 capsules</title>"),
        ("held", population().dataset, "<title>8 capsules</title>"),
        ("shapes", manufactured.database(2, 3), "<title>manufactured</title>"),
    ):
        path = cb.write_report(result, tmp_path / "pages" / f"{name}.html")
        assert title in path.read_text(encoding="utf-8")
    assert len(list((tmp_path / "pages").iterdir())) == 4


def test_files_and_folders_are_opened_as_what_they_are(tmp_path):
    posterior().write(tmp_path / "result" / "posterior.nc")
    population().write(tmp_path / "run.nc")
    manufactured.database(2, 3).write(tmp_path / "shapes.nc")
    found, source = opened(tmp_path / "result")
    assert (type(found), source) == (cb.Posterior, str(tmp_path / "result" / "posterior.nc"))
    assert len(opened(tmp_path / "run.nc")[0]) == 8
    assert len(opened(tmp_path / "shapes.nc")[0]) == 6
    assert opened("square-unsteadiness")[1] == "square-unsteadiness"


def test_what_has_no_page_is_said(tmp_path):
    with pytest.raises(InputError, match="result: expected a Posterior or a Population or a Study"):
        cb.write_report(3, tmp_path / "page.html")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="expected the name of a file to write, got a folder"):
        cb.write_report(population(), tmp_path / "folder")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]
