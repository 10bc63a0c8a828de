"""Expected widths after one more measurement, compared with posteriors of simulated measurements."""

from dataclasses import replace

import numpy as np
import pytest
from membrane_model import MembraneModel

from capsbayes.infer.identify import OUTLINE_NOISE, expected_log_modulus_sds
from capsbayes.infer.importance import ImportanceSampling
from capsbayes.measurement import MeasuredOutline
from capsbayes.profile import vertex_normals

REPEATS = 6


@pytest.fixture(scope="module")
def model():
    """Lengths that tell of K and h."""
    return MembraneModel(shorter=0.2, shallower=0.3)


@pytest.fixture(scope="module")
def posterior(model, experiment, capsule):
    return ImportanceSampling(model, experiment)(capsule)


@pytest.fixture(scope="module")
def expected(posterior, capsule):
    return expected_log_modulus_sds(posterior, capsule)


def _mean_sd(posteriors):
    return np.sqrt(np.mean([found.log_marginal("surface_shear_modulus").sd ** 2 for found in posteriors]))


def test_the_narrowest_comes_first_and_none_is_wider_than_now(posterior, expected):
    values = list(expected.values())
    assert values == sorted(values)
    assert values[-1] < posterior.log_marginal("surface_shear_modulus").sd
    assert {"outline", "pre_inflation"} < set(expected)


def test_no_shape_narrows_what_viscosity_and_velocity_leave_open(posterior, expected):
    inputs = posterior.density.force_scale.log_marginal().sd
    assert min(value for name, value in expected.items() if name != "membrane_thickness") > inputs


def test_a_coordinate_known_leaves_the_mean_width_at_its_values(model, posterior, expected, experiment, capsule):
    """At the middles of six parts of equal probability of the inflation, which moves G_s most here."""
    shares = (np.arange(REPEATS) + 0.5) / REPEATS
    values = np.quantile(posterior.drawn(np.random.default_rng(1), 20_000)["pre_inflation"], shares)
    fixed = [ImportanceSampling(model.fixed(pre_inflation=float(value)), experiment)(capsule) for value in values]
    assert expected["pre_inflation"] == pytest.approx(_mean_sd(fixed), rel=0.1)


@pytest.mark.slow
def test_an_outline_narrows_as_simulated_ones_do(model, posterior, expected, experiment, capsule):
    rng = np.random.default_rng(3)
    draws = posterior.drawn(rng, REPEATS)
    found = []
    for number in range(REPEATS):
        there = model.at(outline=True, **{name: float(draws[name][number]) for name in model.names}).outline[0]
        errors = OUTLINE_NOISE.drawn(rng, there, 1)[0]
        outline = MeasuredOutline(there + errors[:, None] * vertex_normals(there), OUTLINE_NOISE)
        found.append(ImportanceSampling(model, experiment)(replace(capsule, outline=outline)))
    assert expected["outline"] == pytest.approx(_mean_sd(found), rel=0.3)
