"""A flow rate as second source of the mean velocity: intervals cover, false alarms are rare, conflicts are found."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_populations import rows_of
from polynomial_model import PolynomialDomain, PolynomialModel
from scipy import stats
from simulated_capsules import mistakes, simulated_capsules

from capsbayes.experiment import Experiment, mean_velocity
from capsbayes.infer import Quadrature
from capsbayes.infer.batch import Run
from capsbayes.infer.checks import REFUSED_P
from capsbayes.infer.prior import Prior
from capsbayes.infer.verdict import PREDICTED, p_values
from capsbayes.quantity import Quantity

EXPERIMENT = Experiment(cross_section="square", half_width=Quantity(25e-6, 0.25e-6), viscosity=Quantity(0.85, 0.03))
MODEL = PolynomialModel(domain=PolynomialDomain(lowest=0.02))
TRUTHS = ("surface_shear_modulus", "capsule_radius", "mean_velocity")
ERRORS = {"speed_error": 0.03, "rate_error": 0.02}


@pytest.fixture(scope="module")
def capsules():
    return list(simulated_capsules(MODEL, EXPERIMENT, 600, np.random.default_rng(7), **ERRORS))


@pytest.mark.parametrize("name", TRUTHS)
def test_intervals_with_a_flow_rate_cover_as_often_as_they_say(capsules, name):
    engine = Quadrature(MODEL, EXPERIMENT)
    ranks = [engine(capsule.seen).probability_below(name, getattr(capsule, name)) for capsule in capsules]
    assert mistakes(np.array(ranks)) == []


def p_values_of(capsules, prior=None):
    engine = Quadrature(MODEL, EXPERIMENT, prior)
    found = [p_values(engine, capsule.seen, engine(capsule.seen)) for capsule in capsules]
    return {name: np.array([of_one[name] for of_one in found]) for name in PREDICTED}


def test_p_values_are_uniform(capsules):
    for name, found in p_values_of(capsules[:300]).items():
        assert stats.kstest(found, "uniform").pvalue > 1e-3, name


@pytest.mark.slow
@pytest.mark.parametrize("spread", [0.02, 0.1, 0.4])
def test_p_values_are_uniform_under_an_informative_prior(spread):
    modulus = stats.lognorm(spread, scale=0.05)
    capsules = list(simulated_capsules(MODEL, EXPERIMENT, 1000, np.random.default_rng(3), modulus=modulus, **ERRORS))
    for name, found in p_values_of(capsules, Prior(surface_shear_modulus=modulus)).items():
        low, high = stats.binom.interval(0.999, len(found), 0.01)
        assert stats.kstest(found, "uniform").pvalue > 1e-3, name
        assert low <= np.count_nonzero(found < 0.01) <= high, name


@pytest.mark.slow
def test_false_alarms_and_conflicts_of_twenty_thousand_rows():
    """The figures of docs/method.md."""
    capsules = list(simulated_capsules(MODEL, EXPERIMENT, 20_000, np.random.default_rng(11), **ERRORS))
    seen = [capsule.seen for capsule in capsules]
    run = Run(MODEL, EXPERIMENT, Prior(), 1)
    level, rows = REFUSED_P / len(PREDICTED), rows_of(seen, run)
    alarms = {name: rows[f"p_value_{name}"] < level for name in PREDICTED}
    alarms["any of them"] = np.isin(rows["status"], ["LENGTHS_MISFIT", "FLOW_CONFLICT"])
    for name, raised in alarms.items():
        flagged = int(np.count_nonzero(raised))
        low, high = stats.binom.interval(0.999, len(seen), REFUSED_P if name == "any of them" else level)
        print(f"{name}: {flagged} of {len(seen)} flagged, nominal {low:.0f} to {high:.0f}")
        assert low <= flagged <= high
    some = seen[:1000]
    for factor in (0.5, 0.8, 1.2, 2.0, 10.0):
        wrong = [replace(m, flow_rate=Quantity(factor * m.flow_rate, factor * m.flow_rate_error)) for m in some]
        flagged = np.mean(rows_of(wrong, run)["p_value_flow_rate"] < level)
        print(f"flow rate times {factor:g}: {flagged:.3f} flagged")
        assert flagged > (0.99 if abs(np.log(factor)) > 0.5 else 0.5)


@pytest.mark.parametrize("over_half_width", [True, False])
def test_the_posterior_is_that_without_the_flow_rate_weighted_by_its_likelihood(capsules, over_half_width):
    """Second route, without the approximation that inputs are log-normal."""
    measurement, rng, count = capsules[0].seen, np.random.default_rng(5), 200_000
    if not over_half_width:
        scale = EXPERIMENT.half_width.value
        names = ("axial_extent", "axial_extent_error", "axial_length", "axial_length_error")
        inside = {name: scale * getattr(measurement, name) for name in names}
        measurement = replace(measurement, **inside, over_half_width=False)
    posterior = Quadrature(MODEL, EXPERIMENT)(replace(measurement, flow_rate=None))
    nodes = posterior.drawn(rng, count)  # all but the flow rate
    flow = mean_velocity(capsule_velocity=nodes["capsule_velocity"], velocity_ratio=nodes["velocity_ratio"])
    rate = 4.0 * nodes["half_width"] ** 2 * flow
    weights = stats.norm.pdf(measurement.flow_rate, rate, measurement.flow_rate_error)
    exact = Quadrature(MODEL, EXPERIMENT)(measurement)
    for name in (*TRUTHS, "half_width", "capsule_velocity", "velocity_ratio", "size_ratio"):
        logs = np.log(nodes[name])
        mean = np.average(logs, weights=weights)
        sd = np.sqrt(np.average((logs - mean) ** 2, weights=weights))
        marginal = exact.log_marginal(name)
        assert marginal.mean == pytest.approx(mean, abs=0.05 * sd), name
        assert marginal.sd == pytest.approx(sd, rel=0.04), name
        drawn = np.log(exact.drawn(rng, 100_000)[name])
        assert (drawn.mean(), drawn.std()) == pytest.approx((mean, sd), abs=0.05 * sd), name
