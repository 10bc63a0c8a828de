import numpy as np
import pytest
from density_of_all_inputs import log_prior
from scipy import stats

from capsbayes.experiment import Experiment
from capsbayes.infer.density import PosteriorDensity, rejection_sample
from capsbayes.infer.likelihood import ModelAtPoints
from capsbayes.infer.prior import Inputs, Prior
from capsbayes.quantity import Quantity


def points_of(model, ca, size):
    prediction = model({"capillary_number": np.asarray(ca), "size_ratio": np.asarray(size)})
    return ModelAtPoints.of(prediction)


@pytest.mark.parametrize("modulus", [Quantity.log_uniform(0.03, 0.045), Quantity.uniform(1e-3, 1.0)])
@pytest.mark.parametrize("radius", [Quantity.uniform(23.8e-6, 30e-6), Quantity.log_uniform(1e-6, 1e-3)])
@pytest.mark.parametrize("in_metres", [False, True])
def test_integrating_the_inputs_by_hand_gives_the_factored_density(
    model, experiment, capsule, capsule_in_metres, modulus, radius, in_metres
):
    """The full density, prior term by term, averaged over draws of the inputs, against the factored one."""
    seen = capsule_in_metres if in_metres else capsule
    prior, inputs = Prior(modulus, radius), Inputs.of(seen, experiment)
    density = PosteriorDensity.of(seen, inputs, prior)
    ca, size = np.array([0.075, 0.082, 0.09]), np.array([0.955, 0.96, 0.962])
    points = points_of(model, ca, size)
    width = np.full(3, 25.1e-6) if in_metres else None
    factored = density.log_density(points, np.log(ca), size, width) + density.log_share(points, np.log(ca), size, width)

    rng, count = np.random.default_rng(4), 400_000
    drawn = {
        "viscosity": experiment.viscosity.drawn(rng, count),
        "capsule_velocity": rng.normal(seen.capsule_velocity, seen.capsule_velocity_error, count),
        "half_width": np.full(count, 25.1e-6) if in_metres else experiment.half_width.drawn(rng, count),
    }
    full = []
    for n in range(3):
        theta = drawn | {"capillary_number": np.full(count, ca[n]), "size_ratio": np.full(count, size[n])}
        at_prior = log_prior(prior, theta, np.full(count, points.velocity_ratio[n]))
        mass = np.exp(at_prior - 10.0).mean()
        likelihood = density.likelihood.log_density(points.taken(np.array([n])), 25.1e-6)[0]
        full.append(np.log(mass) + likelihood)
    np.testing.assert_allclose(np.array(full) - full[1], factored - factored[1], atol=0.02)


def test_completed_draws_stay_in_the_ranges_and_are_consistent(model, experiment, capsule):
    prior = Prior(Quantity.log_uniform(0.038, 0.041), Quantity.uniform(23.9e-6, 24.1e-6))
    density = PosteriorDensity.of(capsule, Inputs.of(capsule, experiment), prior)
    nodes = {"capillary_number": np.full(2000, 0.082), "size_ratio": np.full(2000, 0.96)}
    points = points_of(model, nodes["capillary_number"], nodes["size_ratio"])
    draws = density.completed(np.random.default_rng(5), nodes, points)
    assert np.all((draws["capsule_radius"] >= 23.9e-6) & (draws["capsule_radius"] <= 24.1e-6))
    by_mean_ratio = draws["viscosity"] * draws["capsule_velocity"] / (0.082 * points.velocity_ratio)
    assert np.all((by_mean_ratio >= 0.038) & (by_mean_ratio <= 0.041))
    flow = draws["capsule_velocity"] / draws["velocity_ratio"]
    np.testing.assert_allclose(draws["mean_velocity"], flow)
    np.testing.assert_allclose(draws["surface_shear_modulus"], draws["viscosity"] * flow / 0.082)
    np.testing.assert_allclose(draws["capsule_radius"], 0.96 * draws["half_width"])


def test_inputs_of_any_distribution_are_drawn_as_they_are(model, capsule):
    viscosity = stats.lognorm(0.2, scale=0.8)
    experiment = Experiment(cross_section="square", half_width=25e-6, viscosity=viscosity)
    density = PosteriorDensity.of(capsule, Inputs.of(capsule, experiment), Prior())
    nodes = {"capillary_number": np.full(5000, 0.082), "size_ratio": np.full(5000, 0.96)}
    points = points_of(model, nodes["capillary_number"], nodes["size_ratio"])
    draws = density.completed(np.random.default_rng(6), nodes, points)
    assert stats.kstest(draws["viscosity"], viscosity.cdf).pvalue > 1e-3
    assert np.ptp(draws["half_width"]) < 1e-15


def test_wide_ranges_cost_nothing(model, experiment, capsule):
    density = PosteriorDensity.of(capsule, Inputs.of(capsule, experiment), Prior())
    points = points_of(model, [0.082], [0.96])
    assert density.log_share(points, np.log([0.082]), np.array([0.96])) == 0.0


def test_only_lengths_in_metres_make_the_half_width_a_dimension(capsule, capsule_in_metres, experiment):
    known = Experiment(cross_section="square", half_width=25e-6, viscosity=Quantity(0.85, 0.02))
    for seen, channel, expected in (
        (capsule, experiment, False),
        (capsule_in_metres, experiment, True),
        (capsule_in_metres, known, False),
    ):
        assert PosteriorDensity.of(seen, Inputs.of(seen, channel), Prior()).shape_depends_on_half_width is expected


def test_a_model_without_an_answer_has_no_density(model, experiment, capsule):
    density = PosteriorDensity.of(capsule, Inputs.of(capsule, experiment), Prior())
    points = points_of(model, [0.3], [0.96])
    assert np.isnan(density.log_density(points, np.log([0.3]), np.array([0.96])))[0]
    assert isinstance(points, ModelAtPoints)


def test_rows_are_drawn_anew_until_they_are_accepted():
    """Uniform draws of which one half, or none, is accepted."""
    rng, draws = np.random.default_rng(1), {"x": np.full(1000, 2.0), "y": np.arange(1000.0)}
    rows = np.arange(0, 1000, 2)
    left = rejection_sample(
        draws,
        rows,
        lambda rows: {"x": rng.uniform(size=len(rows))},
        lambda again, rows: (again["x"] < 0.5) & (rows < 900),
    )
    assert left.tolist() == list(range(900, 1000, 2))
    assert np.all(draws["x"][1::2] == 2.0)
    assert np.all(draws["x"][left] == 2.0)
    assert stats.kstest(2.0 * draws["x"][:900:2], "uniform").pvalue > 1e-3
    assert draws["y"].tolist() == list(range(1000))
