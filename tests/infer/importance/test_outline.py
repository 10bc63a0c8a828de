"""An outline with the membrane unknown: the posterior does not depend on the shape at which its errors are computed."""

from dataclasses import replace

import numpy as np
import pytest

from capsbayes.infer.importance import ImportanceSampling
from capsbayes.measurement import MeasuredOutline, OutlineNoise
from capsbayes.profile import vertex_normals
from capsbayes.surrogate import MembraneSurrogate

TRUTH = {
    "capillary_number": 0.07,
    "size_ratio": 0.96,
    "pre_inflation": 0.015,
    "area_dilation_modulus": 2.0,
    "strain_hardening": 0.4,
    "bending": 2e-4,
}
NOISE = OutlineNoise(0.005, 0.2)


@pytest.fixture(scope="module")
def engine(experiment):
    return ImportanceSampling(MembraneSurrogate.open("square"), experiment)


@pytest.fixture(scope="module")
def seen(engine, capsule):
    shape = engine.model.at(outline=True, **TRUTH)
    points = shape.outline[0][::2]
    moved = points + NOISE.drawn(np.random.default_rng(4), points, 1)[0][:, None] * vertex_normals(points)
    lengths = {"axial_extent": float(shape.axial_extent[0]), "axial_length": float(shape.axial_length[0])}
    return replace(capsule, **lengths, outline=MeasuredOutline(moved, NOISE))


@pytest.fixture(scope="module")
def posterior(engine, seen):
    return engine(seen)


def test_the_membrane_is_found_again(posterior):
    assert all(gate.passed for gate in posterior.gates), [str(gate) for gate in posterior.gates]
    for name, value in TRUTH.items():
        assert 0.001 < posterior.probability_below(name, value) < 0.999, name


def test_errors_averaged_over_the_posterior_lead_to_the_same_posterior(engine, seen, posterior):
    """They are drawn from it anew."""
    again = engine(seen, near=posterior)
    for name in ("surface_shear_modulus", "capsule_radius", "pre_inflation"):
        first, second = posterior.log_marginal(name), again.log_marginal(name)
        assert second.mean == pytest.approx(first.mean, abs=0.35 * first.sd), name
        assert second.sd == pytest.approx(first.sd, rel=0.12), name
