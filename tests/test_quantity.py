"""Quantities: whatever text is accepted means the same to others, whatever is refused is one line; distributions."""

import math
import time

import numpy as np
import pint
import pytest
import uncertainties
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import stats

from capsbayes.errors import InputError
from capsbayes.quantity import Quantity

UNITS = pint.UnitRegistry()
SPELLED = {
    "m": ("m", "um", "nm", "mm", "cm", "micrometer"),
    "Pa s": ("Pa s", "mPa s", "mPa.s", "mPa*s", "cP"),
    "m/s": ("m/s", "mm/s", "um/s", "cm/min", "mm s^-1"),
    "N/m": ("N/m", "mN/m", "dyn/cm"),
    "m^3/s": ("m^3/s", "uL/min", "mL/h", "mm**3/s"),
    "1/s": ("1/s", "Hz", "kHz"),
}
numbers = st.floats(1e-9, 1e9).map(lambda number: float(f"{number:.6g}"))
shares = st.floats(0.01, 90.0).map(lambda share: float(f"{share:.3g}"))
dimensions = st.sampled_from(sorted(SPELLED)).flatmap(
    lambda unit: st.tuples(st.just(unit), st.sampled_from(SPELLED[unit]), st.sampled_from(SPELLED[unit]))
)
few = settings(max_examples=60, deadline=None)


def read(text, *units, signed=False):
    return Quantity.read(text, where="x.toml", key="k", units=units, example="50.0 +/- 0.5 um", signed=signed)


def in_si(number, unit, si):
    unit = unit.replace("mPa.s", "mPa*s")
    return UNITS.Quantity(number, unit).to(si).magnitude


@few
@given(numbers, numbers, dimensions)
def test_numbers_and_units_mean_what_pint_reads(number, error, dimension):
    si, one, other = dimension
    assert read(f"{number!r} {one}", si).value == pytest.approx(in_si(number, one, si), rel=1e-12)
    for text in (f"{number!r} {one} +/- {error!r} {other}", f"{number!r} {one}±{error!r} {other}"):
        found = read(text, si)
        assert found.parameters == pytest.approx((in_si(number, one, si), in_si(error, other, si)), rel=1e-12)


@few
@given(numbers, shares, dimensions)
def test_a_per_cent_after_the_sign_is_a_share_of_the_value(number, share, dimension):
    si, unit, _ = dimension
    value = in_si(number, unit, si)
    for text in (
        f"{number!r} +/- {share!r}% {unit}",
        f"{number!r} ± {share!r} % {unit}",
        f"({number!r} +/- {share!r}%) {unit}",
        f"{number!r} {unit} +/- {share!r}%",
    ):
        assert read(text, si).parameters == pytest.approx((value, share / 100.0 * value), rel=1e-12)
    for text in (
        f"{number!r} % {unit}",
        f"{number!r}% +/- {share!r} {unit}",
        f"{number!r}% +/- {share!r}% {unit}",
        f"{number!r} +/- {share!r} {unit} %",
        f"{number!r} +/- {share!r}%",
        f"{number!r} {unit} +/- {share!r}% {unit}",
        f"{number!r} .. {share!r}% {unit}",
    ):
        with pytest.raises(InputError, match="got a per cent in"):
            read(text, si)


@few
@given(st.decimals(-999, 999, places=3), st.integers(1, 999))
def test_digits_in_parentheses_are_read_as_uncertainties_does(number, digits):
    text = f"{number}({digits})"
    known = uncertainties.ufloat_fromstr(text)
    if known.nominal_value:
        assert read(f"{text} m", "m", signed=True).parameters == pytest.approx((known.nominal_value, known.std_dev))


made = st.one_of(
    st.builds(Quantity, numbers, numbers, st.sampled_from(sorted(SPELLED))),
    st.builds(
        lambda low, ratio, unit: Quantity.uniform(low, low * ratio, unit), numbers, st.floats(1.01, 9), st.just("m")
    ),
    st.builds(lambda low, ratio: Quantity.log_uniform(low, low * ratio, "m"), numbers, st.floats(1.01, 9)),
    st.builds(lambda mean, share: Quantity.log_normal(mean, mean * share, "N/m"), numbers, st.floats(1e-5, 100)),
)


@few
@given(made)
def test_what_is_written_reads_back_to_the_same_numbers(quantity):
    back = read(str(quantity), quantity.unit)
    assert back == quantity
    assert str(back) == str(quantity)


@settings(max_examples=400, deadline=None)
@given(st.lists(st.sampled_from([*"0123456789.e+-±%/^*(), ", "+/-", "..", "um", "Pa", "s", "nan", "log-normal "])))
@example(["1e999(5)"])
def test_whatever_is_refused_is_one_line(parts):
    for units in (("m",), ("", "K"), ("Pa s",)):
        try:
            found = read("".join(parts), *units)
        except InputError as error:
            lines = str(error).splitlines()
        else:
            lines = [str(found)]
            assert all(map(math.isfinite, found.parameters))
            assert read(str(found), *units) == found
        assert len(lines) == 1


WRITTEN = [
    ("(50.0 +/- 0.5) micrometer", "m", 50e-6, 0.5e-6),
    ("8.5 P", "Pa s", 0.85, 0.0),
    ("6.20 +/- 1% mm/s", "m/s", 6.2e-3, 6.2e-5),
    ("50 +/- 20% mN/m", "N/m", 0.05, 0.01),
    ("-5 +/- 10% um", "m", -5e-6, 5e-7),
    ("25.0 um +/- 200 nm", "m", 25e-6, 2e-7),
    ("25.0 +- 0.2 \u00b5m", "m", 25e-6, 2e-7),
    ("25.0\u00a0\u00b1\u20090.2\u202f\u03bcm", "m", 25e-6, 2e-7),
    ("\u22125 um", "m", -5e-6, 0.0),
    ("0 +/- 0.1 um", "m", 0.0, 1e-7),
    ("-2e-3", "", -2e-3, 0.0),
    ("0.85 mPa\u00b7s", "Pa s", 8.5e-4, 0.0),
    ("6.2 mm s\u207b\u00b9", "m/s", 6.2e-3, 0.0),
    ("998 kg/m\u00b3", "kg/m^3", 998.0, 0.0),
    ("1000 cSt", "m^2/s", 1e-3, 0.0),
    ("23.0 +/- 0.5 degC", "K", 296.15, 0.5),
    ("23 \u00b0C +/- 1 K", "K", 296.15, 1.0),
    ("23 C", "K", 296.15, 0.0),
    ("\u221210 \u2103", "K", 263.15, 0.0),
]
AMBIGUOUS = [
    ("25,0 um", "m", "a decimal comma"),
    ("25,0 +/- 0,2 um", "m", "a decimal comma"),
    ("25 +0.3 -0.2 um", "m", "an asymmetric error"),
    ("25 +0.3/-0.2 um", "m", "an asymmetric error"),
    ("25 (-0.2, +0.3) um", "m", "an asymmetric error"),
    ("2.5 \u00d7 10^-5 m", "m", "a power of ten"),
    ("850 cSt", "Pa s", "a kinematic viscosity"),
    ("850 mm\u00b2/s", "Pa s", "a kinematic viscosity"),
    ("2.14 +/- 1%", "", "a per cent"),
    ("0.5% +/- 0.1%", "", "a per cent"),
    ("23 +/- 1% degC", "K", "a per cent of a number that may be zero"),
    ("0 +/- 1% um", "m", "a per cent of a number that may be zero"),
    ("25 um +/- 0.2", "m", "no unit after 0.2"),
    *(
        (text, "m", repr(text))
        for text in ("25 um +/- 1 s", "(25 um +/- 1) nm", "0.1\u20265 um", "inf(5) m", "1e999(5) m")
    ),
    *((f"{text} um", "m", f"'{text} um'") for text in ("1e-300 +/- 1e-301", "log-normal 1 +/- 1e200")),
    ("log-normal 1 +/- 1e-12 um", "m", "'log-normal 1 +/- 1e-12 um'"),
    ("nan(5)", "", "'nan(5)'"),
    ("1e307 km/s", "m/s", "'1e307 km/s'"),
    ("5 " + "mm " * 10_000, "m", "'5 mm mm"),
]


def test_what_people_write():
    for text, unit, value, error in WRITTEN:
        found = read(text, unit, signed=True)
        assert (found.value, found.error) == pytest.approx((value, error), rel=1e-14), text


def test_what_is_ambiguous_or_beyond_all_measure_is_refused_by_name():
    for text, unit, got in AMBIGUOUS:
        with pytest.raises(InputError) as caught:
            read(text, unit, signed=True)
        assert caught.value.got.startswith(got), text
        assert "\n" not in str(caught.value)


def test_an_error_larger_than_what_is_measured_is_refused():
    for name, text in (
        ("half_width", "25 +/- 30 um"),
        ("viscosity", "0.8 +/- 0.9 Pa s"),
        ("axial_extent", "2 +/- 3"),
        ("flow_rate", "1 +/- 120% uL/min"),
    ):
        with pytest.raises(InputError, match="expected an error of at most the value"):
            Quantity.of(text, name)
    assert Quantity.of("50 +/- 60 mN/m", "surface_shear_modulus").error == pytest.approx(0.06)


def test_the_unit_tells_which_of_two_dimensions_is_meant():
    assert read("2.14 +/- 0.01", "", "m") == Quantity(2.14, 0.01, "")
    assert read("53.5 um", "", "m").unit == "m"


def test_a_mistake_is_named_with_what_would_have_been_right():
    for text, got in (
        ("50.0 +/- 0.5", "no unit"),
        ("50.0 Pa", "50.0 Pa"),
        ("50.0 furlong", "unknown unit"),
        ("50 l", "unknown unit"),
        ("50.0 +/- 0.5 %", "0.5 %"),
        *((text, text) for text in ("-50 um", "0 um", "nan um", "inf um", "fifty um")),
        ("50 +/- nan um", "nan"),
        ("50 +/- -1 um", "-1 um"),
        ("", "nothing"),
        (None, "nothing"),
        (50e-6, "5e-05"),
        (["50 um"], "['50 um']"),
    ):
        with pytest.raises(InputError) as caught:
            read(text, "m")
        assert str(caught.value).startswith("x.toml: k: expected ")
        assert "50.0 +/- 0.5 um" in caught.value.expected
        assert got in caught.value.got
        assert "\n" not in str(caught.value)
    for text in ("0.9 .. 0.8 um", "1 .. 1 um", "log-uniform 1 um"):
        with pytest.raises(InputError, match=r"low < high|a range after log-uniform"):
            read(text, "m")


EVALUATED = ("2 * 3 um", "2 um + 1 um", "1e3**2 um", "(1+1) um", "5 /s", "1 *um", "1 um**12", "m", "__import__('os')")


def test_nothing_of_a_text_is_evaluated():
    begin = time.perf_counter()
    for text in (*EVALUATED, "6.2 um * (9**9**9)", "6.2 +/- 0.06 um * (9**9**9)", "6.2 +/- 0.06 um * (1+1) ** 2"):
        with pytest.raises(InputError, match="expected a text in m"):
            read(text, "m")
    assert time.perf_counter() - begin < 5.0


def test_a_range_is_uniform_or_log_uniform():
    for text, shape, low, high in (
        ("24.5 .. 25.5 um", "uniform", 24.5e-6, 25.5e-6),
        ("24.5..25.5 um", "uniform", 24.5e-6, 25.5e-6),
        ("log-uniform 1 .. 100 um", "log-uniform", 1e-6, 1e-4),
    ):
        found = read(text, "m")
        assert (found.shape, found.low, found.high) == (shape, pytest.approx(low), pytest.approx(high))
        assert found.ppf([0.0, 1.0]) == pytest.approx([low, high])


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
    shares = np.array([0.0, 0.1, 0.77, 1.0, 1.1])
    np.testing.assert_allclose(quantity.ppf(shares), frozen.ppf(shares), rtol=1e-12)
    assert (quantity.mean, quantity.sd) == pytest.approx((frozen.mean(), frozen.std()))
    draws = quantity.drawn(np.random.default_rng(1), 20_000)
    assert draws.mean() == pytest.approx(quantity.mean, abs=0.05 * quantity.sd)


def test_an_error_of_uncertainties_and_pint_is_kept():
    width = Quantity.of(UNITS.Quantity(uncertainties.ufloat(25.0, 0.2), "um"), "half_width")
    assert (width.value, width.error, width.unit) == (pytest.approx(25e-6), pytest.approx(2e-7), "m")


def test_a_negative_error_is_refused():
    with pytest.raises(InputError, match="quantity: error: expected a standard error that is not negative, got -1"):
        Quantity(1.0, -1.0)
