"""The command line run as from a terminal."""

import sys

import pytest

from capsbayes.cli import main
from capsbayes.files.output_file import RECORD


def run(monkeypatch, capsys, *arguments):
    """Exit status, standard output and standard error of ``capsbayes`` with these arguments."""
    monkeypatch.setattr(sys, "argv", ["capsbayes", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        main()
    captured = capsys.readouterr()
    return end.value.code, captured.out, captured.err


def mistake(monkeypatch, capsys, *arguments):
    """Return the line that the command says of a mistake; it must be all, and the exit status 2."""
    status, out, err = run(monkeypatch, capsys, *arguments)
    assert (status, out, err.count("\n")) == (2, "", 1), err
    return err


def written(folder):
    """Names of what is in a folder, without the record of what a command wrote there."""
    return {path.name for path in folder.iterdir()} - {RECORD}
