"""Tables of lengths as spreadsheets write them: read to the same numbers, or refused in one line."""

import datetime
import time

import numpy as np
import openpyxl
import pandas as pd
import pytest

from capsbayes.errors import InputError
from capsbayes.measurement_sets import MeasuredLengths

NAMES = [f"c{row}" for row in range(1, 7)]
COLUMNS = {
    "name": NAMES,
    "axial_extent_over_l": [1.48, 1.79, 1.77, 1.44, 1.53, 1.71],
    "axial_extent_error_over_l": [0.014, 0.015, 0.016, 0.014, 0.013, 0.014],
    "capsule_velocity_m_per_s": [7.083e-3, 6.737e-3, 5.321e-3, 3.713e-3, 4.2e-3, 5.05e-3],
    "capsule_velocity_error_m_per_s": [7e-05, 6e-05, 5e-05, 4e-05, 4.5e-05, 5.5e-05],
    "axial_length_over_l": [1.27, None, 1.55, 1.28, 1.31, 1.4],
    "axial_length_error_over_l": [0.014, None, 0.014, 0.014, 0.014, 0.014],
}
ROWS = [list(COLUMNS), *map(list, zip(*COLUMNS.values(), strict=True))]


def text(separator=",", decimal=".", rows=ROWS):
    shown = {type(None): lambda cell: "", float: lambda cell: str(cell).replace(".", decimal), str: str}
    cells = [[shown[type(cell)](cell) for cell in row] for row in rows]
    return "\n".join(separator.join(row) for row in cells) + "\n"


def read(tmp_path, content, name="t.csv"):
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return MeasuredLengths.read(tmp_path / name)


def book(tmp_path, rows, change=lambda made: None):
    made = openpyxl.Workbook()
    for row in rows:
        made.active.append(row)
    change(made)
    made.save(tmp_path / "t.xlsx")
    return MeasuredLengths.read(tmp_path / "t.xlsx")


BLANK = "," * (len(COLUMNS) - 1) + "\n"
FORMS = {
    "semicolons and decimal commas": text(";", ","),
    "semicolons and points": text(";"),
    "tabs and decimal commas": text("\t", ","),
    "bars": text("|", ","),
    "the first line of Excel": "sep=;\n" + text(";", ","),
    "UTF-16": text().encode("utf-16"),
    "UTF-16 without a mark, tabs, decimal commas": text("\t", ",").encode("utf-16-le"),
    "UTF-16, big end first, without a mark": text().encode("utf-16-be"),
    "UTF-8 with a mark, CRLF": text(";", ",").replace("\n", "\r\n").encode("utf-8-sig"),
    "old Macintosh": text().replace("\n", "\r"),
    "blank last rows": text() + BLANK + "\n" + BLANK,
    "empty columns": "".join(f"{line},,\n" for line in text().splitlines()),
    "a comma behind each row": text().replace("\n", ",\n").replace(",\n", "\n", 1),
    "quoted": "\n".join(",".join(f'"{cell}"' for cell in line.split(",")) for line in text().splitlines()),
}


def test_a_decimal_comma_next_to_a_unit_is_named(tmp_path):
    content = text().replace("capsule_velocity_m_per_s", "capsule_velocity").replace(",0.0062,", ',"6,2 mm/s",')
    content = content.replace(f",{COLUMNS['capsule_velocity_m_per_s'][0]},", ',"6,2 mm/s",')
    (refusal,) = set(read(tmp_path, content).refusals) - {""}
    assert refusal.startswith("capsule_velocity_m_per_s: expected a number, got a decimal comma in '6,2 mm/s'; write")


@pytest.mark.parametrize("form", FORMS)
def test_a_table_of_a_spreadsheet_has_the_same_numbers(tmp_path, form):
    found = read(tmp_path, FORMS[form])
    assert list(found.names) == NAMES
    assert set(found.refusals) == {""}
    for name, header in (("axial_extent", "axial_extent_over_l"), ("capsule_velocity", "capsule_velocity_m_per_s")):
        assert found.numbers[name].tolist() == COLUMNS[header]
    np.testing.assert_array_equal(found.numbers["axial_length"], np.array(COLUMNS["axial_length_over_l"], float))


def test_columns_may_be_headed_by_symbols_with_a_unit(tmp_path):
    heads = "name,L_z,L_z_error,L_a,v_o [mm/s],v_o_error [mm/s],Q [uL/min]"
    content = f"{heads}\na,2.14,0.02,1.81 +/- 0.03,6.2,0.06,0.6 +/- 0.01\n"
    numbers = read(tmp_path, content).numbers
    shown = {name: float(values[0]) for name, values in numbers.items() if np.isfinite(values[0])}
    assert shown == pytest.approx(
        {
            "axial_extent": 2.14,
            "axial_extent_error": 0.02,
            "axial_length": 1.81,
            "axial_length_error": 0.03,
            "capsule_velocity": 6.2e-3,
            "capsule_velocity_error": 6e-5,
            "flow_rate": 1e-11,
            "flow_rate_error": 0.01 / 6e10,
        }
    )
    with pytest.raises(InputError, match=r"v_o: expected a unit, as v_o \[mm/s\], got none"):
        read(tmp_path, "name,L_z,L_z_error,v_o,v_o_error\na,2.14,0.02,0.0062,6e-05\n")
    with pytest.raises(InputError, match="one statement of each number, got a second one of axial_extent_over_l"):
        read(tmp_path, content.replace("L_a", "axial_extent"))


def test_names_of_another_alphabet_and_missing_ones(tmp_path):
    found = read(
        tmp_path, text().replace("c1,", "Kapsel ä,").replace("c2,", "NA,").replace("c3,", ",").encode("latin-1")
    )
    assert list(found.names) == ["Kapsel ä", "NA", "3", "c4", "c5", "c6"]
    frame = pd.DataFrame(COLUMNS).assign(name=[1.0, None, 3.0, "", "NA", 6.0])
    frame.loc[6] = None
    assert list(MeasuredLengths.of_frame(frame).names) == ["1", "2", "3", "4", "NA", "6"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (text(decimal=","), "line 2: expected 7 cells, got 12, separated by ','; write decimal points, or separate"),
        (text(";", ",").replace("1,79", "1.79"), "expected one decimal mark, a comma or a point, got '1,48' in line 2"),
        (text().replace("1.4,0.014\n", "1.4,0.014,\n"), "line 7: expected 7 cells, got 8"),
        (text().replace("axial_length_over_l", "axial_extent_over_l"), "expected one column of this name, got 2"),
        (text() + '"c7,1.5\n', "unexpected end of data"),
        (text().encode() + b"\x81\x8d", "a text in UTF-8, UTF-16 or Windows-1252"),
        (
            "Experiment of 12 May, square channel\n" + text(),
            "expected 2 cells, got 7, separated by ','; start with the names",
        ),
        ("," + text().replace("\n", "\n,").removesuffix(","), "got a nameless one"),
        (
            text().replace("name,", "name [%],", 1),
            "name [%]: expected a column of a table of lengths, got an unknown one",
        ),
        (text().replace("capsule_velocity_m_per_s", "capsule_velocity [mm/s +/- 1%]"), "got 'mm/s +/- 1%'"),
        (text().replace("axial_length_over_l", "length_correlation [%]"), "got a per cent in '1 %'"),
    ],
)
def test_a_table_that_could_be_misread_is_refused(tmp_path, content, message):
    with pytest.raises(InputError) as caught:
        read(tmp_path, content)
    assert message in str(caught.value)


def test_a_hundred_thousand_columns_end_at_once(tmp_path):
    begin = time.process_time()
    with pytest.raises(InputError, match="at most 1000 columns"):
        read(tmp_path, ",".join(f"c{column}" for column in range(100_000)) + "\n" + "1," * 99_999 + "1\n")
    assert time.process_time() - begin < 1.0


def summary(label, function=np.mean):
    numbers = [function([cell for cell in values if cell is not None]) for values in list(COLUMNS.values())[1:]]
    return [label, *(float(f"{value:.6g}") for value in numbers)]


WORDS = ("count", "25%", "95 % CI", "n", "IQR", "90th percentile", "Gesamt", "mean", "Mittelwert (n = 6)", "S.D.")


@pytest.mark.parametrize(
    ("more", "message"),
    [
        *(([summary(word)], f"got {word!r}, a row of a spreadsheet's summary") for word in (*WORDS, "Grand mean")),
        ([summary("moyenne"), summary("écart-type", np.std)], "got 'moyenne', a row of a spreadsheet's summary"),
        ([summary("standard deviation", np.std)], "got 'standard deviation', a row of a spreadsheet's summary"),
        ([summary(None)], "got the mean of the rows above"),
        ([summary("x7", np.median)], "got the median of the rows above"),
        ([[None] * 7, [None, 1.6, 0.01, 5e-3, 5e-5, None, None]], "got one without a name below a blank row"),
    ],
)
def test_a_row_of_means_is_no_capsule(tmp_path, more, message):
    found = read(tmp_path, text(";", ",", [*ROWS, *more]))
    assert f"name: expected a capsule, {message}" in found.refusals[6]
    assert set(found.refusals[:6]) == {""}
    assert all(found.refusals[6:])
    with pytest.raises(InputError, match="expected a capsule"):
        found.measurement(6)


def test_a_capsule_below_a_blank_row_has_its_name(tmp_path):
    found = read(tmp_path, text(rows=[*ROWS[:4], [None] * 7, *ROWS[4:]]))
    assert list(found.names) == NAMES
    assert set(found.refusals) == {""}


def test_a_row_without_a_number_gets_its_reason(tmp_path):
    found = read(tmp_path, text().replace("1.79", "NaN").replace("1.77", '"1,770"').replace("1.44", "1. May"))
    assert [bool(why) for why in found.refusals] == [False, True, True, True, False, False]
    assert found.refusals[1] == "axial_extent: expected a positive finite number, got nan"
    assert "expected a number, got a decimal comma in '1,770'; write a decimal point, and no" in found.refusals[2]


def test_a_sheet_is_read(tmp_path):
    found = book(tmp_path, [*ROWS, [None] * 7, summary("mean")], lambda made: made.create_sheet("empty"))
    assert list(found.names) == [*NAMES, "mean"]
    assert [bool(why) for why in found.refusals] == [False] * 6 + [True]
    np.testing.assert_allclose(found.numbers["axial_extent"][:6], COLUMNS["axial_extent_over_l"], rtol=1e-14)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (datetime.datetime(2024, 5, 1), "expected a number, got '2024-05-01 00:00:00, a date'"),
        ("=1+0.5", "expected a number, got '=1+0.5, a formula without its value'"),
        ("#DIV/0!", "expected a number, got '#DIV/0!'"),
    ],
)
def test_a_cell_of_a_sheet_without_a_number_is_refused_with_its_row(tmp_path, value, message):
    found = book(tmp_path, ROWS, lambda made: made.active.__setitem__("B3", value))
    assert found.refusals[1] == f"axial_extent_over_l: {message}"
    assert not any(np.delete(found.refusals, 1))


@pytest.mark.parametrize(
    ("rows", "change", "message"),
    [
        (ROWS, lambda made: made.create_sheet("B").append([1]), "one sheet with a table, got Sheet, B"),
        ([], lambda made: None, "one sheet with a table, got none"),
        (
            [["a", "b"], [1, 2]],
            lambda made: None,
            "a: expected a column of a table of lengths, got an unknown one; rename or",
        ),
    ],
)
def test_another_book_is_refused(tmp_path, rows, change, message):
    with pytest.raises(InputError, match=message):
        book(tmp_path, rows, change)


def test_without_its_reader_a_sheet_is_one_line(tmp_path, monkeypatch):
    book(tmp_path, ROWS)
    monkeypatch.setitem(__import__("sys").modules, "openpyxl", None)
    with pytest.raises(InputError, match=r"pip install 'capsbayes\[xlsx\]', or save the table as .csv"):
        MeasuredLengths.read(tmp_path / "t.xlsx")


def test_the_mean_of_capsules_with_one_error_is_no_capsule(tmp_path):
    rows = [[cell if column != 2 else 0.014 for column, cell in enumerate(row)] for row in ROWS[1:]]
    mean = [None, *(float(np.mean([row[column] for row in rows if row[column]])) for column in range(1, 7))]
    found = read(tmp_path, text(rows=[ROWS[0], *rows, mean]))
    assert found.refusals[:-1].tolist() == [""] * 6
    assert found.refusals[-1] == "name: expected a capsule, got the mean of the rows above"


def test_a_per_cent_of_a_spreadsheet_is_no_number_of_its_column(tmp_path):
    def in_per_cent(made):
        made.active["E2"] = 0.01
        made.active["E2"].number_format = "0%"

    found = book(tmp_path, ROWS, in_per_cent)
    assert found.refusals[0] == "capsule_velocity_error_m_per_s: expected a number, got '1%'"
    assert set(found.refusals[1:]) == {""}


def test_cells_with_errors_under_a_unit(tmp_path):
    head = "axial_extent,capsule_velocity [mm/s],viscosity [Pa s]\n"
    rows = "2.14 ± 0.01,6.20 ± 1%,0.8\n53.5 ± 0.3 um,6.20 ± 0.06,0.8\n2.14 ± 0.01,6.20 ± 0.06,0.8 ± 0.02\n"
    found = read(tmp_path, head + rows)
    assert found.numbers["capsule_velocity"][0] == pytest.approx(6.2e-3)
    assert found.numbers["capsule_velocity_error"][0] == pytest.approx(6.2e-5)
    assert found.refusals.tolist() == [
        "",
        "axial_extent_over_l: expected a number, got '53.5 ± 0.3 um'",
        "viscosity_pa_s: expected a number, got '0.8 ± 0.02'",
    ]
