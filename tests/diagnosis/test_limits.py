"""Intervals by the scatter of capsules, sizes that could hide, and G_s with all that is not known of it."""

from dataclasses import replace

import numpy as np
import pytest
from sessions import drawn_session

from capsbayes.diagnosis.finding import TWO_SIGMA, UnknownChange, limits_table, session_modulus
from capsbayes.diagnosis.fits import fitted
from capsbayes.diagnosis.scores import Scores, Trial, whitening
from capsbayes.effects import Halo, PixelScale

SIZES = np.linspace(-0.05, 0.05, 401)


def scores_of(estimates, error, modulus_slope=0.0, own_error=0.0):
    """Scores of capsules (n,), each of which estimates the size with the same stated error."""
    each = -0.5 * ((SIZES[:, None] - estimates) / error) ** 2
    nothing = np.zeros(len(SIZES))
    return Scores(PixelScale(), SIZES, each, nothing, 0.05 * np.exp(modulus_slope * SIZES), own_error)


def test_the_interval_is_that_of_the_scatter_where_it_exceeds_the_stated_error():
    """For a mean of n estimates the sandwich variance is their sample variance over n."""
    estimates = 0.01 + 0.02 * np.random.default_rng(2).standard_normal(40)
    estimates += 0.01 - estimates.mean()
    scores = scores_of(estimates, 0.005)
    low, high = scores.interval()
    due = estimates.std(ddof=1) / np.sqrt(40)
    assert scores.sandwich == pytest.approx((due / (0.005 / np.sqrt(40))) ** 2, rel=1e-6)
    assert 0.5 * (high - low) == pytest.approx(due, rel=0.1)
    stated = scores_of(estimates, 0.1)
    assert stated.sandwich == 1.0
    assert stated.interval() == pytest.approx(stated.profile_interval())


def test_the_models_own_error_does_not_average_away():
    scores = scores_of(np.full(4000, 0.01), 0.05, own_error=0.01)
    low, high = scores.interval(TWO_SIGMA)
    assert 0.5 * (high - low) == pytest.approx(1.96 * 0.01, rel=0.05)


def test_the_session_modulus_holds_size_effect_and_viscosity():
    apparent = np.full(20, 0.05)
    certain = session_modulus([(1.0, ())], apparent, 0.0, 0.0, 1)
    assert (certain.low, certain.median, certain.high) == pytest.approx((0.05, 0.05, 0.05))
    viscous = session_modulus([(1.0, ())], apparent, 0.0, 0.1, 1)
    assert np.log(viscous.high / viscous.low) == pytest.approx(2.0 * 1.96 * 0.1, rel=0.1)
    scores = scores_of(np.full(20, 0.02), 0.002, modulus_slope=-20.0)
    with_effect = session_modulus([(1.0, (scores,))], apparent, 0.0, 0.0, 1)
    assert with_effect.median == pytest.approx(0.05 * np.exp(-20.0 * 0.02), rel=0.02)
    either = session_modulus([(1.0, (scores,)), (1.0, ())], apparent, 0.0, 0.0, 1)
    assert either.low < 1.05 * with_effect.low
    assert either.high == pytest.approx(0.05)
    assert np.isnan(session_modulus([(1.0, ())], np.full(3, np.nan), 0.0, 0.0, 1).median)


def test_what_is_not_known_changes_the_modulus_as_effects_that_are_as_visible(model):
    apparent, unknown = np.full(20, 0.05), UnknownChange(np.array([0.005]), np.ones(1))
    found = session_modulus([(1.0, (unknown,))], apparent, 0.0, 0.0, 1)
    assert found.median == pytest.approx(0.05, rel=0.1)
    low, high = np.log(np.array([found.low, found.high]) / 0.05)
    assert low == pytest.approx(-high, abs=0.1)
    assert 0.1 < high < 1.96 * 0.8  # some 20 times the displacement, up to twelve times as much
    rarely = session_modulus([(0.02, (unknown,)), (0.98, ())], apparent, 0.0, 0.0, 1)
    assert (rarely.low, rarely.high) == pytest.approx((0.05, 0.05))


def test_what_could_hide_is_limited_by_the_capsules_and_by_what_was_measured_elsewhere(model):
    session, _ = drawn_session(model, 14, seed=4, outline=True)
    white = whitening(model, session)
    made = session, white, fitted(model, session, white)
    scores = Trial(model, Halo(), *made).explored().scores
    table = limits_table({"halo": scores})
    row = table.loc["halo"]
    assert -5e-7 < row["low"] < 0.0 < row["high"] < 5e-7
    assert row["modulus_at_low"] > 1.0 > row["modulus_at_high"]
    assert not row["unbounded"]
    bead = Trial(model, Halo(), *made, (0.0, 2e-8)).explored().scores.interval(TWO_SIGMA)
    assert np.ptp(bead) < 0.5 * np.ptp(scores.interval(TWO_SIGMA))
    assert bead[0] < 0.0 < bead[1]


def test_changes_of_the_modulus_are_counted_from_the_null_value_or_from_what_is_given():
    sizes = np.linspace(0.0, 0.4, 5)
    scores = Scores(Halo(), sizes, np.zeros((5, 1)), np.zeros(5), 0.05 * np.exp(-2.0 * sizes))
    assert scores.log_modulus_change([0.1, 0.4, 0.9]) == pytest.approx([-0.2, -0.8, -0.8])
    assert replace(scores, without=0.1).log_modulus_change([0.1]) == pytest.approx(-0.2 + np.log(0.5))
    assert np.isnan(replace(scores, modulus=np.full(5, np.nan)).log_modulus_change([0.1])).all()
