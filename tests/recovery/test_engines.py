"""The two engines on the same capsules: means to 0.1 standard deviations, standard deviations to 2 %, quantiles."""

from dataclasses import replace

import numpy as np
import pytest
from polynomial_model import PolynomialDomain, PolynomialModel
from simulated_capsules import simulated_capsules

from capsbayes.experiment import Experiment
from capsbayes.infer import identify
from capsbayes.quantity import Quantity
from capsbayes.status import Status

EXPERIMENT = Experiment(cross_section="square", half_width=Quantity(25e-6, 0.25e-6), viscosity=Quantity(0.85, 0.03))
MODEL = PolynomialModel(domain=PolynomialDomain(lowest=0.02))
SEEN = [capsule.seen for capsule in simulated_capsules(MODEL, EXPERIMENT, 3, np.random.default_rng(5))]


def in_metres(seen):
    lengths = ("axial_extent", "axial_extent_error", "axial_length", "axial_length_error")
    return replace(seen, **{name: 25e-6 * getattr(seen, name) for name in lengths}, over_half_width=False)


@pytest.mark.parametrize("seen", [*SEEN, in_metres(SEEN[0])], ids=["first", "second", "third", "in metres"])
def test_emcee_and_quadrature_give_the_same_posterior(seen):
    posterior = identify(seen, MODEL, EXPERIMENT, seed=11)
    assert posterior.status in (Status.DONE, Status.LEANS_ON_BORDER), [str(gate) for gate in posterior.gates]
    for name, exact in posterior.reference.items():
        values = np.ravel(posterior.draws[name])
        assert values.mean() == pytest.approx(exact.mean, abs=0.1 * exact.sd)
        assert np.log(values).std() == pytest.approx(np.sqrt(np.log1p((exact.sd / exact.mean) ** 2)), rel=0.05)
        for end, level in (("lower_95", 0.025), ("lower_68", 0.16), ("upper_68", 0.84), ("upper_95", 0.975)):
            assert np.mean(values <= getattr(exact, end)) == pytest.approx(level, abs=0.015)
    assert posterior.agreement.mean <= 0.1
    assert posterior.agreement.sd <= 0.02
