import numpy as np
import pytest

from capsbayes.surrogate.effect import CardinalCubics

KNOTS = np.array([0.0, 0.01, 0.025, 0.05, 0.1])
ALL = np.ones(5, dtype=bool)


def parabola(x):
    return 2.0 - 30.0 * x + 700.0 * x**2


@pytest.mark.parametrize("known", [ALL, np.array([1, 1, 1, 1, 0], bool), np.array([0, 1, 0, 1, 1], bool)])
def test_a_parabola_comes_back_from_any_known_knots(known):
    cubics = CardinalCubics(KNOTS, known)
    for x in np.linspace(*KNOTS[known][[0, -1]], 37)[:-1]:
        weights = cubics.weights(x)
        assert weights @ parabola(KNOTS) == pytest.approx(parabola(x), abs=1e-12)
        np.testing.assert_array_equal(weights[~known], 0.0)
    if known.sum() > 3:  # three of the others give a parabola back as well
        np.testing.assert_allclose(cubics.left_out @ parabola(KNOTS), 0.0, atol=1e-12)


def test_on_a_knot_its_value_alone_counts_and_the_slopes_are_continuous():
    cubics, step = CardinalCubics(KNOTS, ALL), 1e-9
    for k, knot in enumerate(KNOTS[:-1]):
        np.testing.assert_array_equal(cubics.weights(knot), np.eye(5)[k])
        if k:
            before = (cubics.weights(knot) - cubics.weights(knot - step)) / step
            after = (cubics.weights(knot + step) - cubics.weights(knot)) / step
            np.testing.assert_allclose(before, after, atol=1e-3)


def test_no_weight_is_large():
    weights = np.array([CardinalCubics(KNOTS, ALL).weights(x) for x in np.linspace(0.0, 0.1, 201)])
    assert np.abs(weights).sum(axis=1).max() < 1.7


def test_what_is_missed_without_a_knot_is_its_value_less_that_of_the_others():
    cubics, values = CardinalCubics(KNOTS, ALL), np.cos(40.0 * KNOTS)
    rest = np.delete(np.arange(5), 2)
    others = CardinalCubics(KNOTS[rest], np.ones(4, dtype=bool))
    missed = others.weights(KNOTS[2]) @ values[rest] - values[2]
    assert cubics.left_out[1, 1] @ values == pytest.approx(missed / np.sqrt(2.0))
    assert cubics.left_out[2, 0] @ values == pytest.approx(missed / np.sqrt(2.0))
    np.testing.assert_array_equal(cubics.left_out[0, 0], 0.0)  # the first knot: others cannot give it
    alone = CardinalCubics(KNOTS[:3], np.ones(3, dtype=bool))
    assert np.abs(alone.left_out[0, 1]).max() == 1.0  # the only inner knot is not halved


def test_beyond_the_known_knots_there_is_nothing_and_two_are_too_few():
    cubics = CardinalCubics(KNOTS, np.array([0, 1, 1, 1, 0], bool))
    assert np.isnan(cubics.weights(0.005)).all()
    assert np.isnan(cubics.weights(0.07)).all()
    with pytest.raises(ValueError, match="at least 3 knots with a value, got 2"):
        CardinalCubics(KNOTS, np.array([1, 1, 0, 0, 0], bool))
