import pytest

from capsbayes.errors import InputError
from capsbayes.plan import LabErrors


def test_errors_of_a_lab_are_those_of_a_capsule(capsule):
    errors = LabErrors.of(capsule)
    assert (errors.axial_extent, errors.axial_length, errors.capsule_velocity) == pytest.approx((0.01, 0.01, 0.01))
    seen = errors.measured([2.0, 2.01], 4e-3)
    assert (seen.axial_length, seen.capsule_velocity_error) == pytest.approx((2.0, 4e-5))


def test_an_error_of_nothing_is_refused():
    with pytest.raises(InputError, match="errors: capsule_velocity: expected a positive finite standard error"):
        LabErrors(axial_extent=0.02, axial_length=None, capsule_velocity=0.0)
