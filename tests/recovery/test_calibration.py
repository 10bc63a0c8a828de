"""Simulate, hide, find again: does an interval of 95 % hold the truth 95 times in 100?"""

import numpy as np
import pytest
from polynomial_model import PolynomialDomain, PolynomialModel
from scipy.special import ndtr, ndtri
from simulated_capsules import mistakes, simulated_capsules

from capsbayes.experiment import Experiment
from capsbayes.infer import Quadrature
from capsbayes.quantity import Quantity

EXPERIMENT = Experiment(cross_section="square", half_width=Quantity(25e-6, 0.25e-6), viscosity=Quantity(0.85, 0.03))
MODEL = PolynomialModel(domain=PolynomialDomain(lowest=0.02))
CAPSULES = 2000
TRUTHS = ("surface_shear_modulus", "capsule_radius")


@pytest.fixture(scope="module")
def ranks():
    """Ranks of G_s and of a over many capsules, by quadrature : (2, n) array."""
    rng, engine = np.random.default_rng(2024), Quadrature(MODEL, EXPERIMENT)
    found = []
    for capsule in simulated_capsules(MODEL, EXPERIMENT, CAPSULES, rng):
        posterior = engine(capsule.seen)
        found.append([posterior.probability_below(name, getattr(capsule, name)) for name in TRUTHS])
    return np.array(found).T


@pytest.mark.parametrize(("row", "name"), [(0, "G_s"), (1, "a")])
def test_intervals_cover_as_often_as_they_say(ranks, row, name):
    assert mistakes(ranks[row]) == [], name


@pytest.mark.parametrize("row", [0, 1])
@pytest.mark.parametrize("factor", [0.93, 1.0 / 0.93])
def test_an_engine_seven_percent_too_narrow_or_too_wide_is_caught(ranks, row, factor):
    """The same ranks as an engine would give whose every posterior is drawn in about its median."""
    assert mistakes(ndtr(ndtri(ranks[row]) / factor)) != []
