"""Files are written whole or not at all, and replace neither inputs nor what another program wrote."""

import errno
import os
import pickle

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from capsbayes.errors import InputError
from capsbayes.files.csv_file import plain_cell, read_columns, read_numbers, safe_cell, text_of_table
from capsbayes.files.output_file import RECORD, guarded, note_input, together, write_dataset, write_file


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def full(*args, **kwargs):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_file_is_written_whole_with_its_folder_or_not_at_all(tmp_path, monkeypatch):
    for broken in ("os.replace", "pathlib.Path.write_bytes"):
        with monkeypatch.context() as patched:
            patched.setattr(broken, full)
            with pytest.raises(InputError, match=r"a/b.txt: expected room on the disk, got No space left on device"):
                write_file(tmp_path / "a" / "b.txt", "text")
        assert names(tmp_path) == []
    write_file(tmp_path / "a" / "b.txt", "text")
    assert (names(tmp_path / "a"), (tmp_path / "a" / "b.txt").read_text()) == (["b.txt"], "text")
    with pytest.raises(InputError, match="/dev"):
        write_dataset("/dev/full/x.nc", xr.Dataset({"x": ("n", np.arange(3.0))}))


def test_files_are_written_together_or_not_at_all(tmp_path):
    (tmp_path / "c").mkdir()

    def write(end):
        with together():
            write_file(tmp_path / "b", "1")
            end()

    def to_a_folder():
        write_file(tmp_path / "c", "2")

    with pytest.raises(InputError, match="c: expected the name of a file to write, got a folder"):
        write(to_a_folder)
    with pytest.raises(ZeroDivisionError):
        write(lambda: 1 / 0)
    assert names(tmp_path) == ["c"]


def test_what_was_written_under_guard_may_be_replaced_until_somebody_changes_it(tmp_path):
    path = tmp_path / "result.csv"
    with guarded():
        write_file(path, "1")
        write_file(path, "2")
    assert names(tmp_path) == [RECORD, "result.csv"]
    path.write_text("2, and a note")
    with guarded(), pytest.raises(InputError, match=r"did not write, or that was changed since; .*--overwrite"):
        write_file(path, "3")
    assert path.read_text() == "2, and a note"
    with guarded(overwrite=True):
        write_file(path, "3")
    assert path.read_text() == "3"


def test_an_input_or_a_link_to_a_file_of_somebody_is_never_replaced(tmp_path):
    source = tmp_path / "in.csv"
    source.write_text("x")
    (tmp_path / "out").symlink_to(source)
    (tmp_path / "hard").hardlink_to(source)
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    with guarded(overwrite=True):
        note_input(source)
        for name in ("in.csv", "out", "hard"):
            with pytest.raises(InputError, match="not read as well, got an input"):
                write_file(tmp_path / name, "y")
    for name in ("out", "dangling"):
        with guarded(), pytest.raises(InputError, match="did not write"):
            write_file(tmp_path / name, "y")
    assert source.read_text() == "x"


def test_cells_that_a_spreadsheet_would_run_are_text(tmp_path):
    cells = ["=1+1", "+1+1", "-a", "@SUM(1)", "\t=1", "a\r=1", "'=1", "-0.5", "plain", "it's"]
    text = text_of_table(pd.DataFrame({"name": cells, "x": -1.0}), index=False)
    (tmp_path / "t.csv").write_text(text)
    read = read_columns(tmp_path / "t.csv", texts=("name",))
    assert [plain_cell(cell) for cell in read["name"]] == [cell.replace("\r", " ") for cell in cells]
    assert all(safe_cell(cell)[0] not in "=+@\t\r" for cell in ["\r=1", *cells])
    assert read["x"].tolist() == [-1.0] * len(cells)


def test_numbers_of_a_table_are_read_to_the_last_digit(tmp_path):
    numbers = np.exp(np.linspace(-20.0, 20.0, 300)).tolist()
    (tmp_path / "t.csv").write_text("\n".join(["x", *map(repr, numbers)]))
    assert read_columns(tmp_path / "t.csv")["x"].tolist() == numbers


def test_a_bad_table_is_one_line(tmp_path):
    for text, message in (
        ("", "expected a table, got no names of columns"),
        ("\n\n", "no names of columns"),
        ("a,b\n1,2,3\n", "line 2: expected 2 cells, got 3"),
        ("a,b\n1,2\n1\n", "line 3: expected 2 cells, got 1"),
        ("a,a\n1,2\n", "a: expected one column of this name, got 2"),
        ("a,b\n1,2\na,b\n", "line 3: expected the names of the columns in the first line only"),
        ("a,b\n1,\0\n", "zero bytes"),
        ('a,b\n1,"2\n', "readable"),
        (b"a,b\n\xff,1\n", "line 2: expected numbers for a and b, got ÿ, 1"),
        ("a,b\n1,x\n", "line 2: expected numbers for a and b, got 1, x"),
        ("a,b\n\n1,inf\n", "line 3: expected numbers"),
        ("a,c\n1,2\n", "b: expected a column of that name, got columns a, c"),
    ):
        (tmp_path / "t.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
        with pytest.raises(InputError, match=message) as caught:
            read_numbers(tmp_path / "t.csv", ("a", "b"))
        assert "\n" not in str(caught.value)


def test_an_error_crosses_processes_whole():
    error = InputError("file", "key", "a number", "a word", "change it")
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.advice, again.key) == (str(error), "change it", "key")
