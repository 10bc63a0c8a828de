import numpy as np
import pytest
from density_of_all_inputs import DensityOfAllInputs

from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.prior import Inputs, Prior
from capsbayes.infer.sampling import LogDensity
from capsbayes.prediction import Prediction


def density_of(model, experiment, seen, kind=LogDensity):
    return kind(model, PosteriorDensity.of(seen, Inputs.of(seen, experiment), Prior()))


def test_coordinates(model, experiment, capsule, capsule_in_metres):
    assert density_of(model, experiment, capsule).names == ("capillary_number", "size_ratio")
    in_metres = density_of(model, experiment, capsule_in_metres)
    assert in_metres.names == ("capillary_number", "size_ratio", "half_width")
    every = density_of(model, experiment, capsule, DensityOfAllInputs)
    assert every.names[2:] == ("viscosity", "half_width", "capsule_velocity")
    named = every.named(np.array([[np.log(0.08), 0.96, 0.8, 25e-6, 5e-3]]))
    assert named["capillary_number"][0] == pytest.approx(0.08)
    assert named["half_width"][0] == 25e-6


@pytest.mark.parametrize("name", ["capsule", "capsule_in_metres"])
def test_inputs_sampled_or_integrated_differ_by_their_own_densities(model, experiment, name, request):
    """At fixed inputs the two densities over the shape differ by a constant."""
    seen = request.getfixturevalue(name)
    shapes = np.array([[np.log(0.07), 0.95], [np.log(0.082), 0.96], [np.log(0.09), 0.97]])
    integrated = density_of(model, experiment, seen)
    width = np.full((3, 1), 25.05e-6)
    few = np.hstack([shapes, width]) if len(integrated.names) == 3 else shapes
    every = np.hstack([shapes, np.tile([0.84, 25.05e-6, 5.01e-3], (3, 1))])
    difference = integrated(few) - density_of(model, experiment, seen, DensityOfAllInputs)(every)
    np.testing.assert_allclose(difference, difference[0], atol=1e-8)


def test_outside_the_domain_is_impossible_and_not_counted(model, experiment, capsule):
    density = density_of(model, experiment, capsule)
    np.testing.assert_array_equal(density(np.array([[np.log(0.5), 0.96], [np.log(0.08), 2.0]])), -np.inf)
    assert density.not_a_number == 0


def test_negative_inputs_are_impossible(model, experiment, capsule):
    density = density_of(model, experiment, capsule, DensityOfAllInputs)
    assert density(np.array([[np.log(0.08), 0.96, -0.8, 25e-6, 5e-3]]))[0] == -np.inf


def test_not_a_number_inside_the_domain_is_impossible_and_counted(model, experiment, capsule):
    class Broken:
        name, sha256, domain = "broken", "", model.domain

        def __call__(self, theta, *, outline=False):
            prediction = model(theta)
            covariance = np.where(prediction.axial_extent[:, None, None] > 2.0, np.nan, prediction.covariance)
            fields = ("axial_extent", "axial_length", "velocity_ratio", "stretch_ratio")
            return Prediction(
                *(getattr(prediction, name) for name in fields), covariance=covariance, inside=prediction.inside
            )

    density = density_of(Broken(), experiment, capsule)
    values = density(np.array([[np.log(0.08), 0.96], [np.log(0.08), 0.80], [np.log(0.5), 0.96]]))
    assert np.isneginf(values[[0, 2]]).all()
    assert np.isfinite(values[1])
    assert density.not_a_number == 1
