import numpy as np
import pint
import pytest
import uncertainties
from scipy import stats

from capsbayes.errors import InputError
from capsbayes.quantity import Quantity


def read(text, *units):
    return Quantity.read(text, where="x.toml", key="half_width", units=units or ("m",), example="50.0 +/- 0.5 um")


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
        ("50.0 Pa", "50.0 Pa"),
        ("50.0 furlong", "unknown unit"),
        ("50 l", "unknown unit"),
        ("50.0 +/- 0.5 %", "0.5 %"),
        ("-50 um", "-50 um"),
        ("0 um", "0 um"),
        ("nan um", "nan um"),
        ("inf um", "inf um"),
        ("50 +/- nan um", "nan"),
        ("50 +/- -1 um", "-1 um"),
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


def test_zero_and_negative_numbers_are_read_where_they_are_allowed():
    read = Quantity.read("0 +/- 0.1 um", where="x", key="y", units=("m",), example="0.3 um", signed=True)
    assert (read.value, read.error) == (0.0, pytest.approx(1e-7))
    assert Quantity.read("-2e-3", where="x", key="y", units=("",), example="0.1", signed=True).value == -2e-3
    with pytest.raises(InputError, match="positive finite number"):
        Quantity.read("0 um", where="x", key="y", units=("m",), example="0.3 um")


@pytest.mark.parametrize(
    "text",
    ["6.2 mm/s * (9**9**9)", "2 * 3 um", "2 um + 1 um", "1e3**2 um", "(1+1) um", "5 /s", "1 *um", "1 um**12", "m"],
)
def test_nothing_of_a_text_is_evaluated(text):
    with pytest.raises(InputError, match="expected a text in m"):
        read(text, "m")


@pytest.mark.parametrize(
    ("text", "shape", "low", "high"),
    [
        ("24.5 .. 25.5 um", "uniform", 24.5e-6, 25.5e-6),
        ("24.5..25.5 um", "uniform", 24.5e-6, 25.5e-6),
        ("log-uniform 1 .. 100 um", "log-uniform", 1e-6, 1e-4),
    ],
)
def test_a_range_is_uniform_or_log_uniform(text, shape, low, high):
    found = read(text)
    assert (found.shape, found.low, found.high) == (shape, pytest.approx(low), pytest.approx(high))
    assert found.ppf([0.0, 1.0]) == pytest.approx([low, high])
    assert (found.mean, found.sd) == pytest.approx((found.distribution.mean(), found.distribution.std()))


@pytest.mark.parametrize("text", ["0.9 .. 0.8 um", "1 .. 1 um", "log-uniform 1 um"])
def test_a_range_rises(text):
    with pytest.raises(InputError, match=r"low < high|a range after log-uniform"):
        read(text)


QUANTITIES = [
    Quantity(0.85, unit="Pa s"),
    Quantity(0.85, 0.02, "Pa s"),
    Quantity(0.1, 0.2, "m"),
    Quantity.uniform(0.8, 0.9, "Pa s"),
    Quantity.log_uniform(1e-4, 10.0, "N/m"),
]


@pytest.mark.parametrize("quantity", QUANTITIES, ids=str)
def test_the_text_and_the_record_of_a_quantity_are_read_back(quantity):
    assert Quantity.of(str(quantity)) == quantity
    assert str(quantity) in repr(quantity)
    back = Quantity.of_record(quantity.as_record(), quantity.unit)
    assert (back.mean, back.sd) == pytest.approx((quantity.mean, quantity.sd))


@pytest.mark.parametrize(
    "quantity", [*QUANTITIES[1:], Quantity.of(stats.gamma(9.0, scale=0.2)), Quantity(0.0, 1.0, low=-np.inf)], ids=str
)
def test_a_quantity_is_its_distribution(quantity):
    frozen = quantity.distribution
    values = frozen.ppf(np.linspace(0.01, 0.99, 9))
    np.testing.assert_allclose(quantity.logpdf(values), frozen.logpdf(values))
    np.testing.assert_allclose(quantity.pdf(values), frozen.pdf(values))
    np.testing.assert_allclose(quantity.cdf(values), np.linspace(0.01, 0.99, 9))
    assert (quantity.mean, quantity.sd) == pytest.approx((frozen.mean(), frozen.std()))
    draws = quantity.drawn(np.random.default_rng(1), 20_000)
    assert draws.mean() == pytest.approx(quantity.mean, abs=0.05 * quantity.sd)


def test_an_error_of_uncertainties_and_pint_is_kept():
    units = pint.UnitRegistry()
    width = Quantity.of(units.Quantity(uncertainties.ufloat(25.0, 0.2), "um"), "half_width")
    assert (width.value, width.error, width.unit) == (pytest.approx(25e-6), pytest.approx(2e-7), "m")


def test_a_negative_error_is_refused():
    with pytest.raises(InputError, match="quantity: error: expected a standard error that is not negative, got -1"):
        Quantity(1.0, -1.0)
