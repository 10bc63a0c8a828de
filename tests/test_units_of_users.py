"""Every public door takes quantities of pint and texts with units where it takes a number."""

import numpy as np
import pandas as pd
import pint
import pytest

import capsbayes as cb
from capsbayes.errors import InputError
from capsbayes.experiment import capillary_number, capsule_radius, mean_velocity
from capsbayes.image import ByHand
from capsbayes.image.contour import ContourFile, measure_contour
from capsbayes.measurement_sets import MeasuredLengths

UNITS = pint.UnitRegistry()
MPS, UM = UNITS.mm / UNITS.s, UNITS.um
EXPERIMENT = cb.Experiment(cross_section="square", half_width="25.0 +/- 0.2 um", viscosity="0.85 +/- 0.02 Pa s")
NUMBERS = {
    "axial_extent_over_l": [2.14, 2.0],
    "axial_extent_error_over_l": [0.02, 0.01],
    "capsule_velocity_m_per_s": [6.2e-3, 6.0e-3],
    "capsule_velocity_error_m_per_s": [6e-5, 5e-5],
}


def test_an_experiment():
    stated = {"viscosity": 850.0 * UNITS.mPa * UNITS.s, "frame_rate": 2.0 * UNITS.kHz, "exposure": "20 us"}
    stated |= {"density": 1.0 * UNITS.g / UNITS.cm**3, "membrane_thickness": 600.0 * UNITS.nm}
    made = cb.Experiment(cross_section="square", half_width="25 um", **stated)
    assert [getattr(made, name).value for name in stated] == pytest.approx([0.85, 2000.0, 2e-5, 1000.0, 6e-7])
    tension = cb.Experiment(cross_section="square", half_width="25 um", viscous_tension=28.0 * UNITS.mN / UNITS.m)
    assert tension.viscous_tension.value == pytest.approx(0.028)
    assert made.reynolds_number(5.0 * MPS) == pytest.approx(made.reynolds_number(5e-3))


def test_a_measurement_with_its_errors_apart():
    lengths = {"axial_extent": 53.5 * UM, "axial_extent_error": 0.5 * UM, "axial_length": 45.25 * UM}
    velocity = {"capsule_velocity": 6.2 * MPS, "capsule_velocity_error": 0.06 * MPS}
    rate = {"flow_rate": 0.7 * UNITS.uL / UNITS.minute, "flow_rate_error": "0.01 uL/min"}
    conditions = {"half_width": 25.1 * UM, "viscosity": "0.8 Pa s"}
    pinted = cb.Measurement(**lengths, axial_length_error="0.25 um", **velocity, **rate, conditions=conditions)
    assert not pinted.over_half_width
    np.testing.assert_allclose(pinted.lengths, [53.5e-6, 45.25e-6])
    np.testing.assert_allclose(np.sqrt(np.diag(pinted.covariance)), [5e-7, 2.5e-7])
    assert (pinted.capsule_velocity, pinted.capsule_velocity_error) == pytest.approx((6.2e-3, 6e-5))
    assert (pinted.flow_rate, pinted.flow_rate_error) == pytest.approx((0.7e-9 / 60.0, 1e-11 / 60.0))
    assert dict(pinted.conditions) == pytest.approx({"half_width": 25.1e-6, "viscosity": 0.8})
    good = {"axial_extent": 2.14, "axial_extent_error": 0.02, "capsule_velocity": 6e-3, "capsule_velocity_error": 6e-5}
    for changes, message in (
        ({"axial_extent_error": 0.5 * UM}, "axial_extent_error: expected a quantity in"),
        ({"axial_extent": "53 +/- 1 um", "axial_extent_error": 1.0 * UM}, "axial_extent_error: expected one error"),
        ({"capsule_velocity": 6.2 * UM}, "capsule_velocity: expected a quantity in m/s"),
        ({"capsule_velocity": 6.2 * MPS, "capsule_velocity_error": np.nan}, "capsule_velocity: expected a standard"),
    ):
        with pytest.raises(InputError, match=message):
            cb.Measurement(**(good | changes))


def test_priors_and_what_is_known_of_a_membrane():
    prior = cb.Prior(
        surface_shear_modulus="20 .. 80 mN/m",
        capsule_radius=cb.Quantity.uniform(20e-6, 30e-6),
        coordinates={"membrane_thickness": 0.6 * UM},
    )
    assert prior.surface_shear_modulus.high == pytest.approx(0.08)
    assert prior.coordinates["membrane_thickness"].value == pytest.approx(6e-7)
    assert cb.Membrane(membrane_thickness=600.0 * UNITS.nm).membrane_thickness.value == pytest.approx(6e-7)


def test_formulas_of_an_experiment():
    speeds = np.array([4.0, 5.0]) * MPS
    modulus = 40.0 * UNITS.mN / UNITS.m
    ca = capillary_number(viscosity=1000.0 * UNITS.mPa * UNITS.s, mean_velocity=speeds, surface_shear_modulus=modulus)
    np.testing.assert_allclose(ca, [0.1, 0.125])
    assert capsule_radius(size_ratio=0.9, half_width="25 um") == pytest.approx(22.5e-6)
    with pytest.raises(InputError, match="capsule_velocity: expected a quantity in m/s"):
        mean_velocity(capsule_velocity=5.0 * UM, velocity_ratio=1.3)


def test_errors_of_a_lab():
    errors = cb.LabErrors(axial_extent=0.5 * UM, axial_length="0.4 um", capsule_velocity=0.01)
    assert not errors.over_half_width
    np.testing.assert_allclose(np.sqrt(np.diag(errors.covariance)), [5e-7, 4e-7])
    with pytest.raises(InputError, match="both over l or both in metres"):
        cb.LabErrors(axial_extent=0.01, axial_length="0.4 um", capsule_velocity=0.01)


def test_a_contour_and_what_is_stated_by_hand():
    angle = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    points = np.stack([60.0 * np.cos(angle), 45.0 * np.sin(angle)], axis=1)
    contour = ContourFile(points, "px", "contour.csv", "")
    plain = {"capsule_velocity": "6.2 +/- 0.1 mm/s", "edge_error": "0.2 um", "pixel_size": "0.40 +/- 0.01 um"}
    quantities = {name: cb.Quantity.of(text) for name, text in plain.items()}
    as_texts, as_quantities = (measure_contour(contour, EXPERIMENT, flow="right", **how) for how in (plain, quantities))
    np.testing.assert_array_equal(as_texts.lengths, as_quantities.lengths)
    pinted = measure_contour(contour, EXPERIMENT, flow="right", **plain | {"edge_error": 0.2 * UM})
    np.testing.assert_allclose(pinted.covariance, as_texts.covariance)
    assert ByHand(pixel_size="0.40 +/- 0.01 um").pixel_size == quantities["pixel_size"]


FRAMES = {
    "unit in the heading": {
        "axial_extent": NUMBERS["axial_extent_over_l"],
        "axial_extent_error [l]": NUMBERS["axial_extent_error_over_l"],
        "capsule_velocity [mm/s]": [6.2, 6.0],
        "capsule_velocity_error (um/s)": [60.0, 50.0],
    },
    "texts": {
        "axial_extent": ["2.14 +/- 0.02", "2.00 +/- 0.01"],
        "capsule_velocity": ["6.20 +/- 0.06 mm/s", "0.600 +/- 0.005 cm/s"],
    },
    "pint": {
        "axial_extent_over_l": NUMBERS["axial_extent_over_l"],
        "axial_extent_error_over_l": NUMBERS["axial_extent_error_over_l"],
        "capsule_velocity": [6.2 * MPS, 0.006 * UNITS.m / UNITS.s],
        "capsule_velocity_error": [0.06 * MPS, 50.0 * UM / UNITS.s],
    },
}


def test_a_data_frame():
    usual = MeasuredLengths.of_frame(pd.DataFrame(NUMBERS))
    for form, columns in FRAMES.items():
        found = MeasuredLengths.of_frame(pd.DataFrame(columns))
        for name, values in usual.numbers.items():
            np.testing.assert_allclose(found.numbers[name], values, err_msg=f"{name}, {form}")
        assert list(found.refusals) == ["", ""]
    comma = FRAMES["texts"] | {"capsule_velocity": ["6,2 mm/s", "6.0 +/- 0.1 mm/s"]}
    first, second = MeasuredLengths.of_frame(pd.DataFrame(comma)).refusals  # a row alone is refused
    assert "expected a number, got a decimal comma in '6,2 mm/s'" in first
    assert second == ""
    for heading, message in (
        ("capsule_velocity [mm]", "expected a unit of capsule velocity, as m/s, got '1 mm'"),
        ("capsule_velocity [furlong/h]", "expected a unit of capsule velocity, as m/s, got an unknown unit"),
        ("capsule_velocity []", "expected a unit of capsule velocity, as m/s, got ''"),
        ("axial_length [um]", "expected a unit of axial length: none, as it is over l, got '1 um'"),
        ("capsule_velocity", "expected one statement of each number, got a second one of capsule_velocity_m_per_s"),
    ):
        with pytest.raises(InputError) as caught:
            MeasuredLengths.of_frame(pd.DataFrame(NUMBERS | {heading: [6.2, 6.0]}))
        assert message in str(caught.value)
