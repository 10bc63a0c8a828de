import pytest

from capsbayes.errors import InputError
from capsbayes.quantity import Quantity, quantity


def read(text, *units):
    return quantity(text, where="x.toml", key="half_width", units=units or ("m",), example="50.0 +/- 0.5 um")


@pytest.mark.parametrize(
    ("text", "unit", "value", "error"),
    [
        ("50.0 +/- 0.5 um", "m", 50e-6, 0.5e-6),
        ("50.0 ± 0.5 µm", "m", 50e-6, 0.5e-6),
        ("(50.0 +/- 0.5) micrometer", "m", 50e-6, 0.5e-6),
        ("50.0(5) um", "m", 50e-6, 0.5e-6),
        ("0.05 mm", "m", 50e-6, 0.0),
        ("0.85 +/- 0.02 Pa s", "Pa s", 0.85, 0.02),
        ("850 +/- 20 mPa*s", "Pa s", 0.85, 0.02),
        ("8.5 P", "Pa s", 0.85, 0.0),
        ("6.2 +/- 0.06 mm/s", "m/s", 6.2e-3, 6e-5),
        ("40 dyn/cm", "N/m", 0.04, 0.0),
        ("2.14 +/- 0.01", "", 2.14, 0.01),
    ],
)
def test_text_becomes_si(text, unit, value, error):
    read_back = read(text, unit)
    assert read_back.value == pytest.approx(value)
    assert read_back.error == pytest.approx(error)
    assert read_back.unit == unit


def test_the_unit_tells_which_of_two_dimensions_is_meant():
    assert read("2.14 +/- 0.01", "", "m") == Quantity(2.14, 0.01, "")
    assert read("53.5 um", "", "m").unit == "m"


@pytest.mark.parametrize(
    ("text", "got"),
    [
        ("50.0 +/- 0.5", "no unit"),
        ("50.0 Pa", "pascal"),
        ("50.0 furlong", "unknown unit"),
        ("50 l", "unknown unit"),
        ("50.0 +/- 0.5 %", "percent"),
        ("-50 um", "-50 um"),
        ("0 um", "0 um"),
        ("nan um", "nan um"),
        ("inf um", "inf um"),
        ("50 +/- nan um", "nan"),
        ("50 +/- -1 um", "-1 um"),
        ("50 um +/- 1 um", "50 um +/- 1 um"),
        ("fifty um", "fifty um"),
        ("__import__('os')", "__import__"),
        ("", "nothing"),
        (None, "nothing"),
        (50e-6, "5e-05"),
        (["50 um"], "['50 um']"),
    ],
)
def test_a_mistake_is_named_with_what_would_have_been_right(text, got):
    with pytest.raises(InputError) as caught:
        read(text)
    assert str(caught.value).startswith("x.toml: half_width: expected ")
    assert "50.0 +/- 0.5 um" in caught.value.expected
    assert got in caught.value.got
    assert "\n" not in str(caught.value)


def test_a_percentage_is_no_ratio():
    with pytest.raises(InputError, match="percent"):
        read("2.14 +/- 0.5 %", "")


def test_zero_and_negative_numbers_are_read_where_they_are_allowed():
    read = quantity("0 +/- 0.1 um", where="x", key="y", units=("m",), example="0.3 um", signed=True)
    assert (read.value, read.error) == (0.0, pytest.approx(1e-7))
    assert quantity("-2e-3", where="x", key="y", units=("",), example="0.1", signed=True).value == -2e-3
    with pytest.raises(InputError, match="positive finite number"):
        quantity("0 um", where="x", key="y", units=("m",), example="0.3 um")
