import pytest

from capsbayes.infer import Marginal
from capsbayes.report.numbers import decimals, per_cent, rounded, together, value_words


def test_an_error_below_36_is_worth_two_digits():
    digits = {0.00101: 4, 0.0354: 3, 0.0356: 2, 0.9: 1, 1.0: 1, 3.5: 1, 4.0: 0, 40.0: -1, 0.0: 3}
    assert {error: decimals(error) for error in digits} == digits
    assert decimals(float("nan")) == 3
    assert rounded(5128.0, -2) == "5100"  # tens are left out where the error is hundreds
    assert rounded(float("nan"), 2) == "not known"
    assert together((0.02, -0.1, 0.14), 2) == ["0.02", "-0.10", "0.14"]  # what may be negative keeps its decimals


@pytest.mark.parametrize(
    ("name", "numbers", "words"),
    [
        ("surface_shear_modulus", (0.071, 0.067, 0.075, 0.0638, 0.0792), "G_s = 71 mN/m, 95 % [64, 79]"),
        ("surface_shear_modulus", (7.1, 6.7, 7.5, 6.38, 7.92), "G_s = 7100 mN/m, 95 % [6400, 7900]"),
        ("capsule_radius", (23.97e-6, 23.68e-6, 24.26e-6, 23.4e-6, 24.54e-6), "a = 23.97 µm, 95 % [23.40, 24.54]"),
        ("mean_velocity", (4.772e-3, 4.713e-3, 4.833e-3, 4.657e-3, 4.89e-3), "U = 4.77 mm/s, 95 % [4.66, 4.89]"),
        ("surface_shear_modulus", (0.296, 0.12, 0.84, 0.0314, 1.412), "G_s = 300 mN/m, 95 % [31, 1400]"),
        ("capillary_number", (0.0138, 0.005, 0.07, 0.003, 0.123), "Ca = 0.014, 95 % [0.0030, 0.12]"),
        ("capillary_number", (0.0811, 0.0726, 0.0895, 0.0649, 0.0982), "Ca = 0.081, 95 % [0.065, 0.098]"),
    ],
)
def test_a_headline_has_the_unit_people_speak_and_the_digits_of_its_error(name, numbers, words):
    middle, low_68, high_68, low_95, high_95 = numbers
    assert value_words(name, Marginal(middle, 0.5 * (high_68 - low_68), *numbers[:3], low_95, high_95)) == words


def test_shares():
    assert [per_cent(share) for share in (0.0042, 0.042, 0.0999, 0.42, -0.039)] == [
        "0.4 %", "4.2 %", "10 %", "42 %", "-3.9 %"
    ]  # fmt: skip
