"""Two effects at work together are measured without the bias that each has alone."""

import numpy as np
import pytest
from sessions import drawn_session

from capsbayes import MembraneSurrogate
from capsbayes.diagnosis.finding import _DESIGN, _parabola, score_jointly
from capsbayes.diagnosis.fits import fitted
from capsbayes.diagnosis.scores import Trial, log_likelihood, whitening
from capsbayes.effects import SIMULATED, Halo, MotionBlur
from capsbayes.model import FixedParameters

TRUTH = {"halo": 0.5e-6, "exposure": 5e-4}


def test_parabola_is_that_of_six_points():
    bend, top = np.array([[-2.0, 0.8], [0.8, -1.0]]), np.array([0.3, -0.7])
    totals = np.array([5.0 + 0.5 * (point - top) @ bend @ (point - top) for point in _DESIGN])
    found, curvature = _parabola(totals)
    np.testing.assert_allclose(found, top)
    np.testing.assert_allclose(curvature, bend)


@pytest.fixture(scope="module")
def scene(model):
    session, _ = drawn_session(model + Halo() + MotionBlur(), 30, seed=5, outline=True, sizes=TRUTH)
    white = whitening(model, session)
    first = Trial(model, Halo(), session, white, fitted(model, session, white)).explored().scores
    held = FixedParameters(model + Halo(), {"halo": first.size})
    alone = fitted(held, session, white)
    second = Trial(held, MotionBlur(), session, white, alone).explored().scores
    return model, session, white, first, second, alone


@pytest.fixture(scope="module")
def both(scene):
    model, session, white, first, second, alone = scene
    return score_jointly(model, first, second, session, white, alone, {})[:2]


def test_sizes_of_both_are_right_where_that_of_one_alone_is_not(scene, both):
    alone = scene[3]
    low, high = alone.interval(1.92)
    assert not low < TRUTH["halo"] < high
    for scores in both:
        low, high = scores.interval(1.92)
        assert low < TRUTH[scores.effect.parameter.name] < high


def test_no_sizes_around_are_likelier(scene, both):
    model, session, white, _, frozen, _ = scene
    top = np.array([one.size for one in both])
    errors = np.array([0.5 * np.ptp(one.interval()) for one in both])

    def total(sizes):
        held = FixedParameters(model + Halo() + MotionBlur(), dict(zip(TRUTH, sizes, strict=True)))
        return log_likelihood(fitted(held, session, white)).sum()

    around = [total(top + errors * np.array(one)) for one in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1))]
    assert total(top) > max(around)
    assert both[1].log_likelihood_ratio > frozen.log_likelihood_ratio
    assert both[1].total.max() == pytest.approx(total(top), abs=0.2)


def test_an_interval_with_an_unknown_other_is_wider(scene, both):
    frozen = scene[4]
    assert np.ptp(both[1].interval()) > 1.05 * np.ptp(frozen.interval())


def test_what_was_measured_elsewhere_counts(scene, both):
    model, session, white, first, second, alone = scene
    bead = {"halo": (0.52e-6, 1e-9)}
    halo, blur, *_ = score_jointly(model, first, second, session, white, alone, bead)
    assert halo.size == pytest.approx(0.52e-6, abs=5e-9)
    assert np.ptp(halo.interval()) < 5e-9 < np.ptp(both[0].interval())
    assert blur.size != both[1].size


@pytest.mark.slow
def test_two_effects_of_the_membrane_are_found_far_from_where_one_alone_is_likeliest(model):
    """The states over the whole membrane are the truth: alone, the inflation absorbs most of the hardening."""
    truth = {"pre_inflation": 0.04, "strain_hardening": 0.9}
    inflation, hardening = (SIMULATED[name] for name in truth)
    whole, held = MembraneSurrogate.open("square").fixed(**truth), []
    for seed in (5, 6, 7):
        session, known = drawn_session(whole, 20, seed=seed, outline=True)
        white = whitening(model, session)
        first = Trial(model, inflation, session, white, fitted(model, session, white)).explored().scores
        inflated = FixedParameters(model + inflation, {"pre_inflation": first.size})
        alone = fitted(inflated, session, white)
        second = Trial(inflated, hardening, session, white, alone).explored().scores
        assert first.size > 0.045
        assert second.size < 0.6
        found = score_jointly(model, first, second, session, white, alone, {})[:2]
        ends = [scores.interval(1.92) for scores in found]
        held += [low < truth[one.effect.parameter.name] < high for one, (low, high) in zip(found, ends, strict=True)]
        modulus, due = float(found[1].modulus[found[1].best]), float(np.exp(np.median(known["log_modulus"])))
        assert abs(np.log(modulus / due)) < 0.1 < np.log(float(second.modulus[second.best]) / due)
    assert sum(held) >= 5  # of six 95 % intervals: fewer in one of thirty such tests by chance
