"""A model with four further coordinates: the engine and emcee against a dense quadrature."""

from dataclasses import replace

import numpy as np
import pytest
from dense_membrane import DenseMembrane
from membrane_model import RANGES, STIFFER, MembraneModel
from scipy import stats
from simulated_capsules import measured_capsule, mistakes

from capsbayes.errors import InputError, NoShapeError
from capsbayes.infer import Posterior, Prior, identify, importance
from capsbayes.infer.importance import ImportanceSampling, exact_engine
from capsbayes.measurement import MeasuredOutline, OutlineNoise
from capsbayes.report.posterior import caveats
from capsbayes.status import Status
from capsbayes.surrogate import Surrogate

INPUT_ERRORS = (0.02 / 0.85, 0.01)  # of the viscosity and of the velocity
TOLD = ("area_dilation_modulus", "strain_hardening")


@pytest.fixture(scope="module")
def membrane():
    return MembraneModel()


@pytest.fixture(scope="module")
def strong():
    """Lengths that tell of K and h."""
    return MembraneModel(shorter=0.2, shallower=0.3)


@pytest.fixture(scope="module")
def engine(membrane, experiment):
    return ImportanceSampling(membrane, experiment)


@pytest.fixture(scope="module")
def posterior(strong, experiment, capsule):
    return ImportanceSampling(strong, experiment)(capsule)


@pytest.fixture(scope="module")
def dense(strong, capsule):
    return DenseMembrane(strong, capsule)


def test_the_shape_is_that_of_a_dense_quadrature(posterior, dense):
    assert all(gate.passed for gate in posterior.gates), [str(gate) for gate in posterior.gates]
    for name, values in (("size_ratio", np.log(dense.size)), ("velocity_ratio", np.log(dense.ratio))):
        mean, sd = dense.of_nodes(values)
        found = posterior.log_marginal(name)
        assert (found.mean, found.sd) == pytest.approx((mean, sd), abs=0.06 * sd), name
    assert posterior.log_marginal("surface_shear_modulus").sd == pytest.approx(
        dense.log_modulus_sd(INPUT_ERRORS), rel=0.05
    )


@pytest.mark.parametrize("name", TOLD)
def test_the_intervals_of_coordinates_are_those_of_a_dense_quadrature(posterior, dense, name):
    found, wanted = posterior.marginal(name), dense.ends_68(name)
    assert (found.lower_68, found.upper_68) == pytest.approx(tuple(wanted), abs=0.06 * float(np.diff(wanted)[0]))


@pytest.mark.parametrize("name", ["pre_inflation", "bending"])
def test_a_coordinate_that_the_lengths_do_not_tell_keeps_its_prior(posterior, name):
    """Bending does nothing, and inflation only moves Ca."""
    prior = posterior.density.prior.coordinates[name]
    found = posterior.marginal(name)
    ends = found.lower_95, found.lower_68, found.median, found.upper_68, found.upper_95
    assert prior.cdf(ends) == pytest.approx([0.025, 0.16, 0.5, 0.84, 0.975], abs=0.015)


def test_all_coordinates_together_take_away_what_a_dense_quadrature_says(posterior, dense):
    weights, means = dense.of_membrane, dense.mean_of_membrane
    of_shape = np.sum(weights * (means - np.sum(weights * means)) ** 2)
    inflation = np.linspace(0.0, RANGES["pre_inflation"].high, 2001)
    wanted = of_shape + np.var(np.log(1.0 + STIFFER * inflation))
    found = posterior.variance_given_all("surface_shear_modulus")
    assert found == pytest.approx(wanted, rel=0.1)
    alone = [posterior.variance_given(name, "surface_shear_modulus") for name in RANGES]
    assert found > 1.1 * max(alone)


def test_one_coordinate_told_to_a_hundredth_and_another_not_at_all(experiment, capsule):
    model = MembraneModel(shorter=-60.0, shallower=0.0)
    long = replace(capsule, axial_extent=14.0)
    found, dense = ImportanceSampling(model, experiment)(long), DenseMembrane(model, long, (0.785, 0.825))
    assert all(gate.passed for gate in found.gates), [str(gate) for gate in found.gates]
    known, wanted = found.marginal("area_dilation_modulus"), dense.ends_68("area_dilation_modulus")
    assert np.log(wanted[1] / wanted[0]) < 0.02 * np.log(5.0)
    assert (known.lower_68, known.upper_68) == pytest.approx(tuple(wanted), abs=0.06 * float(np.diff(wanted)[0]))
    free = found.marginal("strain_hardening")
    assert (free.lower_68, free.upper_68) == pytest.approx((0.16, 0.84), abs=0.015)


def test_a_stated_prior_takes_the_place_of_the_default(membrane, experiment, capsule):
    prior = Prior(coordinates={"bending": "log-uniform 2e-5 .. 4e-5", "pre_inflation": "0.03 +/- 0.005"})
    found = ImportanceSampling(membrane, experiment, prior)(capsule)
    bending, inflation = found.marginal("bending"), found.marginal("pre_inflation")
    assert 2e-5 < bending.lower_95 < bending.upper_95 < 4e-5
    assert (inflation.mean, inflation.sd) == pytest.approx((0.03, 0.005), rel=0.05)
    assert found.density.prior.coordinates["strain_hardening"].high == 1.0


@pytest.mark.parametrize("what", ["half width in metres", "a flow rate"])
def test_draws_have_the_summaries_of_the_distributions(engine, capsule, capsule_in_metres, what):
    """Two routes: products of distributions on grids of logarithms, and draws of everything."""
    seen = capsule_in_metres
    if what == "a flow rate":
        rate = 4.0 * 25e-6**2 * 5e-3 / 1.3
        seen = replace(capsule, flow_rate=rate, flow_rate_error=0.02 * rate)
    found = engine(seen)
    draws = found.drawn(np.random.default_rng(4), 40_000)
    for name in ("surface_shear_modulus", "capsule_radius", "mean_velocity", "half_width"):
        logs, marginal = np.log(draws[name]), found.log_marginal(name)
        assert (logs.mean(), logs.std()) == pytest.approx((marginal.mean, marginal.sd), abs=0.05 * marginal.sd), name


def test_a_posterior_next_to_another_is_that_from_the_beginning(engine, capsule):
    sharper = replace(capsule, axial_length_error=0.5 * capsule.axial_length_error)
    anew, next_to = engine(sharper), engine(sharper, near=engine(capsule))
    assert all(gate.passed for gate in next_to.gates)
    for name in ("surface_shear_modulus", "capsule_radius"):
        other = anew.log_marginal(name)
        assert next_to.log_marginal(name).mean == pytest.approx(other.mean, abs=0.15 * other.sd)
        assert next_to.log_marginal(name).sd == pytest.approx(other.sd, rel=0.1)


def test_too_few_effective_draws_are_told_in_their_own_words(membrane, experiment, capsule, monkeypatch):
    monkeypatch.setattr(importance, "_LEAST_EFFECTIVE", 1e9)
    monkeypatch.setattr(importance, "_REPEATS", 0)
    found = identify(capsule, membrane, experiment, seed=1, engine="quadrature")
    assert found.status is Status.TOO_FEW_DRAWS


def test_lengths_of_no_shape_are_refused(engine, capsule):
    with pytest.raises(NoShapeError, match="a shape that a case of manufactured membrane has"):
        engine(replace(capsule, axial_extent=6.0))


def test_a_prior_that_holds_no_shape_is_refused_by_its_bound(membrane, experiment, capsule):
    with pytest.raises(InputError, match="2 µm as the upper end of its prior"):
        ImportanceSampling(membrane, experiment, Prior(capsule_radius="1 .. 2 um"))(capsule)


@pytest.fixture(scope="module")
def identified(membrane, experiment, capsule):
    return identify(capsule, membrane, experiment, seed=1, engine="emcee")


def test_quadrature_is_the_default_where_chains_take_minutes(membrane, experiment, capsule):
    assert identify(capsule, membrane, experiment, seed=1, error_budget=False).engine == "quadrature"


def test_emcee_agrees_and_says_what_the_data_tell(identified, tmp_path):
    assert identified.status is Status.DONE
    assert identified.agreement.passed
    widths = identified.widths_over_prior()
    assert list(widths) == list(RANGES)
    assert widths["bending"] == pytest.approx(1.0, abs=0.03)
    assert identified.log_modulus_sd_if_known < 0.7 * identified.log_modulus_sd
    assert list(identified.summary()["width_over_prior"].dropna().index) == list(RANGES)
    sentences = caveats(identified)
    assert sum("kept its prior" in sentence for sentence in sentences) == len(RANGES)
    assert not any("generalised Hooke" in sentence for sentence in sentences)
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    circle = MeasuredOutline(np.stack([np.cos(angle), np.sin(angle)], axis=1), OutlineNoise(0.005, 0.2))
    outlined = replace(identified, measurement=replace(identified.measurement, outline=circle))
    assert any("generalised Hooke" in sentence for sentence in caveats(outlined))
    again = Posterior.read(identified.write(tmp_path / "posterior.nc"))
    assert again.widths_over_prior() == pytest.approx(widths)
    assert again.log_modulus_sd_if_known == identified.log_modulus_sd_if_known
    assert again.prior.coordinates == identified.prior.coordinates


def test_shares_of_the_variance_name_every_coordinate(identified):
    shares = identified.shares
    assert set(RANGES) < set(shares)
    assert abs(shares["bending"]) < 0.02 < shares["pre_inflation"]
    assert sum(shares.values()) == pytest.approx(1.0)


def test_sampled_coordinates_are_those_of_a_dense_quadrature(strong, experiment, capsule, dense):
    found = identify(capsule, strong, experiment, seed=3)
    for name in TOLD:
        wanted = dense.ends_68(name)
        ends = found.marginals[name].lower_68, found.marginals[name].upper_68
        assert ends == pytest.approx(tuple(wanted), abs=0.06 * float(np.diff(wanted)[0])), name


@pytest.mark.slow
def test_intervals_cover_as_often_as_they_say(experiment):
    """Capsules from the whole of the prior; the ranks of the truth are uniform."""
    model = MembraneModel(shorter=0.2, shallower=0.3)
    engine, rng, ranks = ImportanceSampling(model, experiment), np.random.default_rng(11), []
    (ca_low, ca_high), (size_low, size_high) = model.domain.bounds
    while len(ranks) < 60:
        ca, size = np.exp(rng.uniform(np.log(ca_low), np.log(ca_high))), rng.uniform(size_low, size_high)
        further = {each.name: float(each.values(rng.uniform())) for each in engine.coordinates}
        truth = {"capillary_number": ca, "size_ratio": size, **further}
        there = model({name: np.array([value]) for name, value in truth.items()})
        if not there.inside[0]:
            continue
        shape = rng.multivariate_normal(there.values[0], there.covariance[0])
        seen = measured_capsule(experiment, shape, (ca, size), rng, (0.01, 0.01), 0.01)
        if seen is not None:
            found = engine(seen.seen)
            truths = {name: getattr(seen, name) for name in ("surface_shear_modulus", "capsule_radius")} | further
            ranks.append([found.probability_below(name, value) for name, value in truths.items()])
    ranks = np.array(ranks).T
    for row in ranks:
        assert mistakes(row) == []
        inside = np.count_nonzero(np.abs(row - 0.5) < 0.34)
        assert stats.binom.cdf(inside, len(row), 0.68) > 1e-3
        assert stats.binom.sf(inside - 1, len(row), 0.68) > 1e-3


def test_one_further_coordinate_is_sampled_too_and_the_engines_agree(experiment, capsule):
    """Of lengths alone chains take no minutes: they are the default, and nothing is said of what to measure next."""
    model = Surrogate.open("square-pre-inflation")
    assert isinstance(exact_engine(model, experiment), ImportanceSampling)
    posterior = identify(capsule, model, experiment, seed=1)
    assert posterior.engine == "emcee"
    assert posterior.agreement.passed, str(posterior.agreement)
    assert list(posterior.marginals)[-1] == "pre_inflation"
    assert posterior.shares["pre_inflation"] > 0.0
    assert posterior.log_modulus_sd_if_known is None
    assert posterior.expected_log_modulus_sds == {}
