"""What a page shows, renewed by what its commands print now."""

import sys

import pytest

from evidence import pages

SHOWN = """\
Radius and modulus
G_s [mN/m]  43.1  30 to 66
...
Status: Done.
"""
PRINTED = """\
Reading.
Radius and modulus
G_s [mN/m]   43.25   31 to 65
a [um]      24
Model: 12.
Status: Done.
"""


def test_numbers_are_renewed_and_what_is_left_out_stays_out(capsys):
    assert pages.renewed(SHOWN, PRINTED) == SHOWN.replace("  43.1  30 to 66", "   43.25   31 to 65")
    assert capsys.readouterr().out == "- G_s [mN/m]  43.1  30 to 66\n+ G_s [mN/m]   43.25   31 to 65\n"


def test_other_words_and_lines_that_are_gone_are_marked(capsys):
    other = PRINTED.replace("G_s", "G").replace("Status: Done.", "Status: Refused.")
    assert pages.renewed(SHOWN, other) == SHOWN.replace("G_s [mN/m]  43.1  30 to 66", "G [mN/m]   43.25   31 to 65")
    told = capsys.readouterr().out
    assert "+ G [mN/m]   43.25   31 to 65   !! other words" in told
    assert "!! not printed: Status: Done." in told


def test_the_commands_of_a_page_are_run_in_order(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    blocks = (
        '```sh\npython -c \'open("a", "w").write("7 ducks")\'\n```\n',
        "```sh\npython -c 'print(open(\"a\").read())'\n```\n",
    )
    page.write_text(f"{blocks[0]}and\n{blocks[1]}gives\n```text\n5 ducks\n```\n")
    monkeypatch.setattr(sys, "argv", ["pages", str(page)])
    with pytest.raises(SystemExit) as ended:
        pages.main()
    assert ended.value.code == 0
    assert page.read_text() == f"{blocks[0]}and\n{blocks[1]}gives\n```text\n7 ducks\n```\n"
