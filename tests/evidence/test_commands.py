"""The commands of the evidence: what they print, and what they refuse in one line with exit status 2."""

import importlib
import sys

import pytest

from capsbayes.run import only_run
from evidence.verification import TOPICS

EXAM = ("exam", "--out", "made", "--pools", "pools")
REFUSED = (
    (("verification",), "--out"),
    (("verification", "--out", ""), "expected a path"),
    (("verification", "--out", "file"), "expected a folder"),
    (("verification", "--out", "made", "--only", "none"), "expected one of undisturbed-flow, "),
    (("verification", "--out", "made", "--on", "walls"), "unrecognized"),
    (("verification", "--out", "somebodys"), "a file that capsbayes did not write"),
    ((*EXAM, "--half", "x"), "--half"),
    ((*EXAM, "--half", "locked"), "freeze it first with --freeze"),
    ((*EXAM, "--only", "no such cell"), "expected part of one of nothing, "),
    ((*EXAM, "--sessions", "0"), "--sessions: expected a whole number of at least 1, got '0'"),
    ((*EXAM, "--workers", "1.5"), "--workers"),
    ((*EXAM, "--effects", "file"), "expected an effect"),
    (("exam", "--out", "somebodys", "--pools", "pools"), "a file that capsbayes did not write"),
    (("rebuild", "../x", "--out", "made.nc"), "expected one of square-neo-hookean, "),
    (("rebuild", "membrane-oval", "--out", "made.nc"), "membrane-circular, got 'membrane-oval'"),
    (("rebuild", "square-neo-hookean", "--out", "made.txt"), "ends in .nc"),
    (("rebuild", "square-neo-hookean", "--out", "nowhere/made.nc"), "expected a folder that exists"),
    (("rebuild", "square-neo-hookean", "--out", "there.nc"), "a file that capsbayes did not write"),
    (("rebuild", "membrane-square", "--out", "there.nc"), "a file that capsbayes did not write"),
)


@pytest.fixture
def place(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("x = 1\n")
    (tmp_path / "there.nc").write_text("of somebody")
    (tmp_path / "somebodys").mkdir()
    for name in ("verification.md", "exam.md"):
        (tmp_path / "somebodys" / name).write_text("of somebody")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def ended(monkeypatch, capsys, name, *words):
    """Run a command; return its exit status and what it printed."""
    home = importlib.import_module("evidence.rebuild" if name == "rebuild" else f"evidence.{name}.__main__")
    monkeypatch.setattr(sys, "argv", [name, *words])
    with pytest.raises(SystemExit) as end:
        home.main()
    return end.value.code, *capsys.readouterr()


@pytest.mark.parametrize(("words", "said"), REFUSED)
def test_a_mistake_is_one_line_and_nothing_is_written(place, monkeypatch, capsys, words, said):
    before = {file: file.stat().st_mtime_ns for file in place.rglob("*")}
    status, printed, error = ended(monkeypatch, capsys, *words)
    assert (status, printed) == (2, "")
    assert error.startswith(f"python -m evidence.{words[0]}: ")
    assert said in error
    assert len(error.splitlines()) == 1
    assert before == {file: file.stat().st_mtime_ns for file in place.rglob("*")}


@pytest.mark.parametrize("words", [("verification", "--out", "made"), (*EXAM, "--only", "swelling 0.01")])
def test_a_second_run_is_refused(place, monkeypatch, capsys, words):
    out = place / "made" / ("development" if words[0] == "exam" else "")
    out.mkdir(parents=True)
    if words[0] == "exam":
        monkeypatch.setattr("evidence.exam.__main__.build_pools", lambda *_, **__: {})  # which takes minutes
    with only_run(out):
        status, _, error = ended(monkeypatch, capsys, *words)
    assert status == 2
    assert "expected no other run that writes it" in error


def test_one_topic_is_verified(tmp_path, monkeypatch, capsys):
    out = tmp_path / "new" / "page"
    status, printed, _ = ended(monkeypatch, capsys, "verification", "--out", str(out), "--only", "membrane-laws")
    assert status == 0
    table = {line.split()[0]: line for line in printed.splitlines()}
    assert "met" in table["membrane-laws"]
    assert all("not computed" in table[topic.name] for topic in TOPICS if topic.name != "membrane-laws")
    assert printed.endswith(f"{out / 'verification.md'}\n")
    assert (out / "verification.md").is_file()
    status, *_ = ended(monkeypatch, capsys, "verification", "--out", str(out), "--only", "membrane-laws")
    assert status == 0  # its own page is replaced
