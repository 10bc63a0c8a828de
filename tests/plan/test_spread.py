import pytest

from capsbayes.errors import InputError
from capsbayes.plan import LabErrors, Spread


def test_a_range_is_read_in_any_unit():
    assert Spread.of_text("24.5..25.5 um", name="half_width").first == pytest.approx(24.5e-6)
    assert Spread.of_text("6.2 +/- 0.06 mm/s", name="capsule_velocity").second == pytest.approx(6e-5)
    assert Spread.of_text("1.7 .. 1.9", name="axial_length").sd == pytest.approx(0.2 / 12**0.5)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("viscosity", "0.9 .. 0.8 Pa s", "--range: viscosity: expected low < high"),
        ("viscosity", "0.8 .. 0.9 m", "--range: viscosity: expected a text in Pa s"),
        ("viscosity", "0.8 Pa s", "--range: viscosity: expected a range like"),
        ("colour", "1 .. 2", "--range: colour: expected one of viscosity, half_width"),
        ("half_width", "1 +/- 0.5 um", "range: expected"),
    ],
)
def test_a_mistake_is_one_line(name, text, message):
    with pytest.raises(InputError, match=message) as caught:
        Spread.of_text(text, name=name)
    assert "\n" not in str(caught.value)


def test_errors_of_a_lab_are_those_of_a_capsule(capsule):
    errors = LabErrors.of(capsule)
    assert (errors.axial_extent, errors.axial_length, errors.capsule_velocity) == pytest.approx((0.01, 0.01, 0.01))
    seen = errors.measured([2.0, 2.01], 4e-3)
    assert (seen.axial_length, seen.capsule_velocity_error) == pytest.approx((2.0, 4e-5))


def test_an_error_of_nothing_is_refused():
    with pytest.raises(InputError, match="errors: capsule_velocity: expected a positive finite standard error"):
        LabErrors(axial_extent=0.02, axial_length=None, capsule_velocity=0.0)
