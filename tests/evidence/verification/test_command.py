from command_line import mistake
from typer.testing import CliRunner

import capsbayes.cli
from capsbayes.evidence.verification import TOPICS


def test_one_section_from_the_command_line(tmp_path):
    arguments = ["verify", "--out", str(tmp_path / "new" / "page"), "--only", "membrane-laws"]
    result = CliRunner().invoke(capsbayes.cli.app, arguments)
    assert result.exit_code == 0, result.output
    table = {line.split()[0]: line for line in result.stdout.splitlines()}
    assert "met" in table["membrane-laws"]
    assert all("not computed" in table[topic.name] for topic in TOPICS if topic.name != "membrane-laws")
    assert (tmp_path / "new" / "page" / "verification.md").is_file()


def test_a_mistake_is_one_line_and_exit_status_2(tmp_path, monkeypatch, capsys):
    line = mistake(monkeypatch, capsys, "verify", "--out", tmp_path, "--only", "none")
    assert line.startswith("capsbayes: verify: only: expected one of undisturbed-flow, ")
