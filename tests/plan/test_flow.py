"""The flow design compared with posteriors of simulated measurements."""

import json
from dataclasses import replace

import numpy as np
import pytest

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.plan import LabErrors, flow_design, simulated_widths
from capsbayes.plan.lab import flow_rate
from capsbayes.plan.widths import WidthPredictor
from capsbayes.quantity import Quantity
from capsbayes.status import Status


@pytest.fixture(scope="module")
def design(known, errors, shipped):
    return flow_design(0.05, 24e-6, known, errors, shipped, seed=1)


def at(design, capillary_number):
    return min(design.points, key=lambda point: abs(np.log(point.capillary_number / capillary_number)))


@pytest.mark.parametrize("capillary_number", [0.03, 0.05, 0.08, None])
def test_the_predicted_width_is_that_of_simulated_measurements(design, known, errors, shipped, capillary_number):
    point = design.best if capillary_number is None else at(design, capillary_number)
    found = simulated_widths(0.05, 24e-6, known, errors, shipped, mean_velocity=point.mean_velocity, count=100, seed=5)
    assert point.relative == pytest.approx(found.mean, rel=0.10)
    assert point.sd == pytest.approx(float(found.sd.mean()), rel=0.10)
    assert found.standard_error < 0.04 * found.mean
    assert 0.5 < found.within.mean() < 0.85


def test_without_noise_the_width_near_a_snap_through_is_wrong(known, errors, shipped):
    size, ca = 1.05, 0.0242
    predicted = WidthPredictor(shipped, known, errors).at(ca, size)
    found = simulated_widths(
        0.05, size * 25e-6, known, errors, shipped, mean_velocity=ca * 0.05 / 0.85, count=150, seed=5
    )
    assert predicted.noise_free < 0.8 * found.mean
    assert predicted.relative == pytest.approx(found.mean, rel=0.15)


def test_the_best_is_below_the_limit_of_existence_by_the_margin(design, shipped):
    limit = shipped.domain.regions[0].borders(0.96)[1]
    assert design.limit.limit
    assert design.limit.highest == pytest.approx(limit, rel=2e-3)
    assert design.limit_velocity == pytest.approx(limit * 0.05 / 0.85, rel=2e-3)
    assert design.best.capillary_number <= 0.9 * limit
    assert design.best.relative == min(point.relative for point in design.points if point.allowed)
    assert design.good[0] <= design.best.mean_velocity <= design.good[1]
    assert design.status is Status.DONE
    ratio = shipped.at(capillary_number=design.best.capillary_number, size_ratio=0.96).velocity_ratio[0]
    assert design.best.capsule_velocity == pytest.approx(design.best.mean_velocity * ratio)
    assert design.best.capillary_number == pytest.approx(0.85 * design.best.mean_velocity / 0.05)


def test_a_spread_of_the_modulus_asks_for_a_slower_flow(design, known, errors, shipped):
    soft = flow_design(Quantity(0.05, 0.015), 24e-6, known, errors, shipped, seed=1, noises=3)
    assert soft.best.mean_velocity < 0.8 * design.best.mean_velocity
    assert 0.02 < soft.best.beyond_margin <= 0.05
    beyond = [point.beyond_limit for point in soft.points]
    assert all(np.diff(beyond) >= 0.0)
    assert beyond[-1] == pytest.approx(0.5, abs=0.03)
    again = flow_design(Quantity(0.05, 0.015), 24e-6, known, errors, shipped, seed=1, noises=3)
    assert json.dumps(again.as_dict()) == json.dumps(soft.as_dict())


def test_lengths_in_metres_are_predicted_as_well(experiment, model):
    errors = LabErrors(0.5e-6, 0.01, 0.5e-6, 0.5, over_half_width=False)
    predicted = WidthPredictor(model, experiment, errors, noises=5).at(0.06, 0.96)
    found = simulated_widths(0.05, 24e-6, experiment, errors, model, mean_velocity=0.06 * 0.05 / 0.85, count=30, seed=2)
    assert predicted.relative == pytest.approx(found.mean, rel=0.10)


def test_where_no_flow_rate_is_safe_or_the_rear_is_not_seen_that_is_said(known, errors, shipped):
    design = flow_design(Quantity(0.05, 0.01), 24e-6, known, errors, shipped, seed=1, noises=0, margin=0.99)
    assert design.status is Status.NO_FLOW_RATE
    assert (design.best, design.good, design.as_dict()["best"]) == (None, None, None)
    hidden = flow_design(0.05, 24e-6, known, replace(errors, axial_length=None), shipped, seed=1, noises=0)
    assert hidden.status is Status.LEANS_ON_BORDER


def test_a_size_that_the_model_has_not_is_refused(known, errors, shipped):
    with pytest.raises(InputError, match=r"a radius between 0\.7 and 1\.15 l, as .* got a/l = 1\.4"):
        flow_design(0.05, 35e-6, known, errors, shipped, seed=1)
    with pytest.raises(InputError, match=r"margin, risk: expected shares from 0 to below 1, got 2, 0\.05"):
        flow_design(0.05, 24e-6, known, errors, shipped, seed=1, margin=2.0)
    with pytest.raises(InputError, match="expected: capsule_radius: expected a positive finite number"):
        flow_design(0.05, -24e-6, known, errors, shipped, seed=1)
    with pytest.raises(InputError, match="a velocity at which square-neo-hookean has a shape of such capsules"):
        simulated_widths(0.05, 24e-6, known, errors, shipped, mean_velocity=1.0, count=2, seed=1)
    tube = Experiment(cross_section="circular", half_width=25e-6, viscosity=0.85)
    with pytest.raises(InputError, match='section: expected "square", that of the model, got "circular"'):
        flow_design(0.05, 24e-6, tube, errors, shipped, seed=1)


def test_the_flow_rate_is_that_of_the_section():
    assert flow_rate(2e-3, 25e-6, "square") == pytest.approx(2e-3 * 50e-6**2)
    assert flow_rate(2e-3, 25e-6, "circular") == pytest.approx(2e-3 * np.pi * 25e-6**2)


def test_errors_of_a_lab_are_those_of_a_capsule_and_positive(capsule):
    errors = LabErrors.of(capsule)
    assert (errors.axial_extent, errors.axial_length, errors.capsule_velocity) == pytest.approx((0.01, 0.01, 0.01))
    seen = errors.measured([2.0, 2.01], 4e-3)
    assert (seen.axial_length, seen.capsule_velocity_error) == pytest.approx((2.0, 4e-5))
    with pytest.raises(InputError, match="errors: capsule_velocity: expected a positive finite standard error"):
        LabErrors(axial_extent=0.02, axial_length=None, capsule_velocity=0.0)
