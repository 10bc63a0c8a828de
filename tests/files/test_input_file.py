import pytest

from capsbayes.errors import InputError
from capsbayes.files.input_file import InputFile, number


def written(tmp_path, text):
    path = tmp_path / "file.toml"
    path.write_text(text)
    return path


def test_what_is_no_file_or_no_toml_is_said(tmp_path):
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    for given, message in (
        (tmp_path / "nowhere.toml", r"nowhere\.toml: expected a file, got nothing there"),
        (tmp_path, "expected a readable file"),
        (f"a = 1{400 * '0'}", "an integer of more than 64 bits"),
        ("a = = 1", r"expected a TOML file, got .*line 1"),
        (tmp_path / "binary.toml", "expected a text in UTF-8, UTF-16 or Windows-1252, got zero bytes"),
        (["a"], r"\['a'\]: expected the path of a file, got one of the type list"),
    ):
        with pytest.raises(InputError, match=message):
            InputFile.read(written(tmp_path, given) if isinstance(given, str) else given)


def test_a_file_of_another_editor_is_read(tmp_path):
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "cp1252"):
        (tmp_path / "x.toml").write_bytes('width = "25.0 ± 0.2 µm"\r\n'.encode(encoding))
        assert InputFile.read(tmp_path / "x.toml").content == {"width": "25.0 ± 0.2 µm"}


def test_a_number_is_finite(tmp_path):
    for value in ("inf", "-inf", "nan", "1" + 60 * "0" + "0.0", "1e61", "true", '"1"'):
        with pytest.raises(InputError, match=r"file.toml: correlation: expected a number from -1e\+60 to 1e\+60, got "):
            InputFile.read(written(tmp_path, f"correlation = {value}")).table(required={"correlation": number()})
