"""The grammar of quantities: whatever is accepted means the same to others, whatever is refused is one line."""

import math

import pint
import pytest
import uncertainties
from hypothesis import example, given, settings
from hypothesis import strategies as st

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
    return Quantity.read(text, where="x.toml", key="k", units=units, example="1", signed=signed)


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


@pytest.mark.parametrize(
    ("text", "unit", "value", "error"),
    [
        ("6.20 +/- 1% mm/s", "m/s", 6.2e-3, 6.2e-5),
        ("50 +/- 20% mN/m", "N/m", 0.05, 0.01),
        ("-5 +/- 10% um", "m", -5e-6, 5e-7),
        ("25.0 um +/- 200 nm", "m", 25e-6, 2e-7),
        ("25.0 +- 0.2 \u00b5m", "m", 25e-6, 2e-7),
        ("25.0\u00a0\u00b1\u20090.2\u202f\u03bcm", "m", 25e-6, 2e-7),
        ("\u22125 um", "m", -5e-6, 0.0),
        ("0.85 mPa\u00b7s", "Pa s", 8.5e-4, 0.0),
        ("6.2 mm s\u207b\u00b9", "m/s", 6.2e-3, 0.0),
        ("998 kg/m\u00b3", "kg/m^3", 998.0, 0.0),
        ("1000 cSt", "m^2/s", 1e-3, 0.0),
        ("23.0 +/- 0.5 degC", "K", 296.15, 0.5),
        ("23 \u00b0C +/- 1 K", "K", 296.15, 1.0),
        ("23 C", "K", 296.15, 0.0),
        ("\u221210 \u2103", "K", 263.15, 0.0),
    ],
)
def test_what_people_write(text, unit, value, error):
    found = read(text, unit, signed=True)
    assert (found.value, found.error) == pytest.approx((value, error), rel=1e-14)


@pytest.mark.parametrize(
    ("text", "units", "got"),
    [
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
        ("25 um +/- 1 s", "m", "'25 um +/- 1 s'"),
        ("(25 um +/- 1) nm", "m", "'(25 um +/- 1) nm'"),
        ("0.1\u20265 um", "m", "'0.1\u20265 um'"),
        ("nan(5)", "", "'nan(5)'"),
        ("inf(5) m", "m", "'inf(5) m'"),
        ("1e999(5) m", "m", "'1e999(5) m'"),
        ("1e307 km/s", "m/s", "'1e307 km/s'"),
        ("1e-300 +/- 1e-301 um", "m", "'1e-300 +/- 1e-301 um'"),
        ("log-normal 1 +/- 1e200 um", "m", "'log-normal 1 +/- 1e200 um'"),
        ("log-normal 1 +/- 1e-12 um", "m", "'log-normal 1 +/- 1e-12 um'"),
        ("5 " + "mm " * 10_000, "m", "'5 mm mm"),
    ],
)
def test_what_is_ambiguous_or_beyond_all_measure_is_refused_by_name(text, units, got):
    with pytest.raises(InputError) as caught:
        read(text, units, signed=True)
    assert caught.value.got.startswith(got)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("half_width", "25 +/- 30 um"),
        ("viscosity", "0.8 +/- 0.9 Pa s"),
        ("axial_extent", "2 +/- 3"),
        ("flow_rate", "1 +/- 120% uL/min"),
    ],
)
def test_an_error_larger_than_what_is_measured_is_refused(name, text):
    with pytest.raises(InputError, match="expected an error of at most the value"):
        Quantity.of(text, name)
    assert Quantity.of("50 +/- 60 mN/m", "surface_shear_modulus").error == pytest.approx(0.06)
