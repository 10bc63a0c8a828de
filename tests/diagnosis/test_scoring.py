"""Likelihood of fits against integrals over the shapes, and profiles of it against numbers worked out by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from capsbayes.diagnosis import scores as scoring
from capsbayes.diagnosis.scores import Scores, Trial, _about_the_best, log_likelihood, population
from capsbayes.diagnosis.session import FlowOffsets
from capsbayes.effects import catalogue

MISFIT = np.array([3.0, 9.5, 1.2, 6.0])
LOG_MODULUS = np.array([-3.0, -2.7, -3.2, -2.9])
ERRORS = np.array([[0.10, 0.010], [0.05, 0.004], [0.20, 0.012], [0.08, 0.009]])
CORRELATION = np.array([0.3, -0.5, 0.8, 0.0])
OF_VELOCITY = 0.04


def fits(known):
    covariance = ERRORS[:, :, None] * ERRORS[:, None, :]
    covariance[:, 0, 1] *= CORRELATION
    covariance[:, 1, 0] *= CORRELATION
    found = {"known": np.array(known), "misfit": MISFIT, "log_modulus": LOG_MODULUS, "by_picture": covariance}
    found |= {"covariance": covariance + np.diag([OF_VELOCITY**2, 0.0])}
    found |= {"log_volume": np.linalg.slogdet(covariance)[1]}
    return SimpleNamespace(**found, flow=without_flow_rates(len(known)))


def without_flow_rates(count):
    return FlowOffsets(np.full(count, np.nan), np.ones(count), np.zeros(count), np.ones(count))


def test_it_is_the_integral_over_all_shapes_of_a_capsule_of_the_population():
    """Of misfits that are quadratic about the best shape, with a flat prior of the size; but for a factor 2 pi.

    The error of the velocity adds to the spread of the population, not to what the picture leaves open.
    """
    given = fits([True] * 4)
    people = population(LOG_MODULUS, ERRORS[:, 0] ** 2 + OF_VELOCITY**2)
    spread = np.hypot(people.spread, OF_VELOCITY)
    assert people.spread > 0.01
    for i, found in enumerate(log_likelihood(given)):
        about = multivariate_normal([LOG_MODULUS[i], 0.0], given.by_picture[i])
        top = about.pdf([LOG_MODULUS[i], 0.0])

        def over_sizes(log_modulus, i=i, about=about, top=top):
            def shape(size):
                return np.exp(-0.5 * MISFIT[i]) * about.pdf([log_modulus, size]) / top

            return quad(shape, -0.1, 0.1, points=[0.0])[0] * norm.pdf(log_modulus, people.mean, spread)

        likelihood = quad(over_sizes, LOG_MODULUS[i] - 1.5, LOG_MODULUS[i] + 1.5, points=[LOG_MODULUS[i]])[0]
        assert found == pytest.approx(np.log(likelihood) - np.log(2.0 * np.pi), abs=1e-5)


def test_the_population_is_the_likeliest():
    people = population(LOG_MODULUS, ERRORS[:, 0] ** 2)

    def likelihood(mean, spread):
        return norm.logpdf(LOG_MODULUS, mean, np.hypot(ERRORS[:, 0], spread)).sum()

    best = likelihood(people.mean, people.spread)
    for mean, spread in ((0.01, 0.0), (-0.01, 0.0), (0.0, 0.01), (0.0, -0.01)):
        assert likelihood(people.mean + mean, people.spread + spread) < best


@pytest.mark.parametrize(
    ("values", "variances", "mean", "spread"),
    [
        ([1.0, 1.1, 0.9], 0.04, 1.0, 0.0),
        ([1.0, 1.3], [0.01, 0.04], (4.0 * 1.0 + 1.0 * 1.3) / 5.0, 0.0),  # better known values count more
        ([-2.0, -1.0, 0.0, 1.0, 2.0], 1e-6, 0.0, np.sqrt(2.0)),  # unlike by far
    ],
)
def test_a_population_has_the_spread_that_its_errors_do_not_explain(values, variances, mean, spread):
    people = population(np.array(values), np.broadcast_to(variances, len(values)))
    assert people.mean == pytest.approx(mean, abs=1e-9)
    assert people.spread == pytest.approx(spread, rel=1e-3, abs=0.0)


def test_a_capsule_without_a_shape_is_less_likely_than_any_other():
    found = log_likelihood(fits([True, False, True, True]))
    assert found[1] == pytest.approx(found[[0, 2, 3]].min() - 15.0)
    assert np.all(log_likelihood(fits([True, False, False, False])) < -1e5)


@pytest.fixture
def scores():
    """A parabola with its top of 8 at 0.03 and a standard error of 0.01, shared equally by two capsules."""
    effect = catalogue()["pre_inflation"]
    sizes = np.linspace(0.0, 0.1, 201)
    total = 8.0 - 0.5 * ((sizes - 0.03) / 0.01) ** 2
    each = np.stack([0.25 * total, 0.75 * total], axis=1)
    return Scores(effect, sizes, each, np.zeros(len(sizes)), np.ones(len(sizes)))


def test_a_profile_has_its_best_size_its_intervals_and_its_ratio(scores):
    assert scores.size == pytest.approx(0.03)
    assert scores.interval() == pytest.approx((0.02, 0.04), abs=1e-6)
    assert scores.interval(1.92) == pytest.approx((0.03 - 0.01 * 3.84**0.5, 0.03 + 0.01 * 3.84**0.5), abs=1e-5)
    assert scores.log_likelihood_ratio == pytest.approx(4.5)
    assert scores.log_likelihood_ratios == pytest.approx([0.25 * 4.5, 0.75 * 4.5])


def test_its_evidence_is_the_likelihood_averaged_over_the_prior(scores):
    prior = scores.effect.prior
    mean = quad(
        lambda size: prior.pdf(size) * np.exp(4.5 - 0.5 * ((size - 0.03) / 0.01) ** 2), 0.0, 0.1, points=[0.03]
    )[0]
    assert scores.evidence == pytest.approx(np.log(mean / quad(prior.pdf, 0.0, 0.1)[0]), abs=1e-4)


def test_the_size_and_its_interval_are_said_in_the_unit_of_the_parameter(scores):
    symbol = scores.effect.parameter.symbol
    assert str(scores) == f"{scores.effect.name}, {symbol} = 0.03 [0.02, 0.04]"


@pytest.mark.parametrize(
    ("null", "totals", "best"),
    [
        (0.0, [0.0, 0.0, 0.0, 0.0, 0.0], 0.0),
        (0.0, [3.0, 3.0, 0.0, 3.0, 3.0], -0.02),
        (0.0, [0.0, 0.0, 0.0, 1e-8, 1e-8], 0.0),
        (0.0, [0.0, 0.0, 0.0, 1e-4, 0.0], 0.03),
        (0.03, [4.0, 4.0, 4.0, 1.0, 4.0], 0.05),
    ],
)
def test_sizes_that_are_as_likely_are_the_nearest_to_nothing(null, totals, best):
    effect, sizes = SimpleNamespace(null_value=null), np.array([-0.04, -0.02, 0.0, 0.03, 0.05])
    scores = Scores(effect, sizes, np.array(totals)[:, None], np.zeros(5), np.ones(5))
    assert (scores.size, scores.sizes[scores.null]) == (best, null)
    assert scores.log_likelihood_ratio == pytest.approx(totals[sizes.tolist().index(best)] - totals[scores.null])


def test_an_interval_ends_where_the_sizes_do(scores):
    for total, ends in ((100.0 * scores.sizes, (0.095, 0.1)), (-100.0 * scores.sizes, (0.0, 0.005))):
        steep = Scores(scores.effect, scores.sizes, total[:, None], np.zeros(len(total)), np.ones(len(total)))
        assert steep.interval() == pytest.approx(ends, abs=1e-6)


class Doubled:
    """Model that can be added to; what it predicts is replaced."""

    def __add__(self, effect):
        return self


@pytest.fixture
def trial(monkeypatch):
    """Return how to try an effect whose misfit is a parabola of its size, and the sizes that were tried."""
    effect, tried = catalogue()["pixel_scale"], []

    def start(top, error, height=20.0, measured=None, curve=lambda away: away**2):
        def fits_at(size):
            tried.append((size, ()))
            misfit = np.array([0.25, 0.75]) * (height + curve((size - top) / error))
            covariance = np.tile(0.01 * np.eye(2), (2, 1, 1))
            return SimpleNamespace(
                known=np.ones(2, bool),
                misfit=misfit,
                log_modulus=np.zeros(2),
                covariance=covariance,
                log_volume=np.linalg.slogdet(covariance)[1],
                theta=np.full((2, 2), size),
                median_modulus=np.exp(size),
                flow=without_flow_rates(2),
            )

        def refitted(model, session, white, sizes, begin, *, everywhere):
            made = fits_at(sizes[effect.parameter.name])
            tried[-1] = (tried[-1][0], (float(begin[0, 0]), everywhere))
            return made

        tried.clear()
        monkeypatch.setattr(scoring, "fitted", refitted)
        return Trial(Doubled(), effect, None, None, fits_at(effect.null_value), measured).explored()

    return start, tried


@pytest.mark.parametrize(("top", "error"), [(0.013, 0.004), (-0.02, 0.002), (0.001, 0.01)])
def test_refining_a_profile_finds_its_top_its_error_and_its_height(trial, top, error):
    made = trial[0](top, error)
    made.refine()
    scores = made.scores
    assert scores.size == pytest.approx(top, abs=0.05 * error)
    assert scores.interval() == pytest.approx((top - error, top + error), abs=0.25 * error)
    assert scores.log_likelihood_ratio == pytest.approx(0.5 * (top / error) ** 2, rel=0.01)
    assert np.all(np.diff(scores.sizes) > 0.0)
    assert len(scores.sizes) < 25


def test_next_sizes_are_the_top_of_a_parabola_and_two_standard_errors_either_side():
    sizes = [0.0, 1.0, 2.5]
    totals = [-0.5 * ((size - 1.2) / 0.3) ** 2 for size in sizes]
    assert sorted(_about_the_best(sizes, totals)) == pytest.approx([0.6, 1.2, 1.8])
    assert _about_the_best(sizes, [0.0, 0.0, 0.0]) == [0.5]  # the first is as good as any


def test_each_fit_begins_where_the_nearest_size_ended(trial):
    trial[0](0.013, 0.004)
    done = [0.0]
    for size, (begin, _) in trial[1][1:]:
        assert abs(begin - size) == pytest.approx(min(abs(other - size) for other in done))
        done.append(size)
    first = [size for size, (_, everywhere) in trial[1][1:] if everywhere]
    assert not trial[1][-1][1][1]
    prior = catalogue()["pixel_scale"].prior
    quantiles = prior.distribution.cdf(first)
    assert set(quantiles.round(6)) <= {0.001, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 0.999}
    for side in (-1.0, 1.0):  # outwards on either side, as far as a size is likely
        away = side * np.array([size for size in first if side * size > 0.0])
        assert np.all(np.diff(away) > 0.0)


def test_an_effect_without_a_trace_is_tried_no_further(trial):
    made = trial[0](0.0, 1.0, curve=lambda away: 0.0)
    count = len(trial[1])
    made.refine(3)
    assert len(trial[1]) == count
    assert made.scores.size == 0.0


def test_a_profile_that_rises_to_its_end_is_halved_there(trial):
    made = trial[0](0.5, 0.1)
    last, end = made.scores.sizes[-3:-1], made.scores.sizes[-1]
    assert made.scores.size == end
    assert last[1] == pytest.approx(0.5 * (last[0] + end))
    made = trial[0](-0.5, 0.1)
    first, then = made.scores.sizes[0], made.scores.sizes[1:3]
    assert then[0] == pytest.approx(0.5 * (first + then[1]))


def test_a_measured_size_and_the_capsules_are_weighed_by_their_precision(trial):
    made = trial[0](0.02, 0.004).with_measured((0.01, 0.003))
    made.refine(3)
    weights = np.array([0.004, 0.003]) ** -2.0
    assert made.scores.size == pytest.approx(weights @ [0.02, 0.01] / weights.sum(), abs=2e-4)
    elsewhere = dict(zip(made.scores.sizes, made.scores.elsewhere, strict=True))
    assert elsewhere[0.0] == pytest.approx(norm.logpdf(0.0, 0.01, 0.003) - norm.logpdf(0.0, 0.0, 0.003))
    assert made.with_measured((0.01, 0.003)) is made
    for sigma in (-2.0, -1.0, 0.0, 1.0, 2.0):
        assert np.abs(made.scores.sizes - (0.01 + 0.003 * sigma)).min() < 1e-12
